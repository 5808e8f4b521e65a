"""Compiled stress and energy at one cubature point, of a solid or a membrane.

The functions take the derivatives of the displacement, nine numbers row by row of du/dX. They return
the stress, cof(F) and J - 1, or the energy density and J - 1. The pressure of nearly incompressible
solids is not included: it follows from moments of J - 1, or of another measure g(J) of the volume
(`palpate.tissue.volumetric`). A membrane has no such pressure, because its thickness follows, and
uses only the first two columns of du/dX.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from palpate.compiled.jit import inline, law_digest, law_njit
from palpate.core.faults import InputError
from palpate.dynamics.material.fibres import NO_FIBRES, FibrePoints, fibre_points
from palpate.dynamics.material.kinematics import Kinematics
from palpate.dynamics.material.material_fields import NO_FIELDS, parameters_at
from palpate.dynamics.material.principal_point import make_principal_point
from palpate.dynamics.membrane.passes import make_moduli
from palpate.dynamics.solid.energy_form import make_stress
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.materials import Material
from palpate.tissue.volumetric import QUADRATIC, volumetric_form

MIN_VOLUME_RATIO = 0.1  # J below which the energy continues as a parabola


@dataclass(frozen=True)
class MaterialPoint:
    """Compiled functions of one cubature point."""

    digest: str  # of all sources of the functions
    stress: Any  # ``stress(d0, ..., d8, coefficients)`` returns P and cof(F), nine numbers each, and J - 1
    density: Any  # ``density(d0, ..., d8, coefficients)`` returns the energy density [J/m^3] and J - 1
    # ``measure(x)`` returns g and g' of x = J - 1, continued linearly where the point is crushed. None where g(x) = x.
    measure: Any = None
    fibres: FibrePoints = NO_FIBRES  # stress and energy of the fibres
    parameter_count: int = NO_FIELDS  # number of the law's parameters if they differ from point to point
    relaxing: bool = False  # True for tissue with a Prony series; other points have no history variables

    @property
    def at(self) -> Any:
        """Function ``at(coefficients, b, v)`` of a block and a lane that returns the law's parameters."""
        return parameters_at(self.parameter_count)


def material_point(
    material: Material, kinematics: Kinematics, fibres: FibreLaw | None = None, by_point: bool = False
) -> tuple[MaterialPoint, tuple[float, ...]]:
    """Return the compiled law of a body's points, and its coefficients.

    With `by_point` the parameters may differ from point to point.
    """
    compiled, coefficients = _law_without_fibres(material, kinematics)
    if material.prony is not None:
        compiled = replace(compiled, digest=law_digest(__name__, compiled.digest, "relaxing"), relaxing=True)
    if by_point:
        count = len(coefficients)
        compiled = replace(
            compiled, digest=law_digest(__name__, compiled.digest, "varied", count), parameter_count=count
        )
    if fibres is None:
        return compiled, coefficients
    fibre_point = fibre_points(fibres)
    return replace(
        compiled, digest=law_digest(__name__, compiled.digest, fibre_point.digest), fibres=fibre_point
    ), coefficients


def _law_without_fibres(material: Material, kinematics: Kinematics) -> tuple[MaterialPoint, tuple[float, ...]]:
    law = type(material) if kinematics.sheet else material.law
    if kinematics.sheet:
        compiled = _sheet_point(law, kinematics.relaxed)
        return compiled, (kinematics.prestretch, *material.coefficients)
    if law.variables == "small strain":
        raise InputError(
            f"material must be a law of finite strain for a reduced model, got {law.__name__} for small strain; "
            "use Mooney-Rivlin's or another law of finite strain"
        )
    make = _stretched_point if law.variables == "stretches" else _solid_point
    return _with_volume_measure(make(law.energy, law.first, law.second), material.volumetric), material.coefficients


@cache
def _with_volume_measure(law: MaterialPoint, volumetric: str) -> MaterialPoint:
    """Return a law with the measure of its volumetric form."""
    if volumetric == QUADRATIC:
        return law
    measure_of = volumetric_form(volumetric).measure
    digest = law_digest(__name__, law.digest, measure_of)
    measure_below_limit = inline(digest, measure_of)

    @law_njit(digest, cached=False)
    def measure(x):
        value, slope = measure_below_limit(max(x, MIN_VOLUME_RATIO - 1.0))
        return value + slope * min(x - (MIN_VOLUME_RATIO - 1.0), 0.0), slope

    return replace(law, digest=digest, measure=measure)


@cache
def _solid_point(energy_of: Any, first_of: Any, second_of: Any) -> MaterialPoint:
    """Compile the points of a solid, with W_s continued as a parabola in J below MIN_VOLUME_RATIO."""
    digest = law_digest(__name__, "solid point", energy_of, first_of, second_of)
    energy_density, first_derivatives, second_derivatives = (
        inline(digest, f) for f in (energy_of, first_of, second_of)
    )

    def extended(I1, I2, J, coefficients):
        """Return the law's first derivatives, continued below MIN_VOLUME_RATIO."""
        W1, W2, WJ = first_derivatives(I1, I2, max(J, MIN_VOLUME_RATIO), coefficients)
        if J < MIN_VOLUME_RATIO:
            _, _, _, W1J, W2J, _ = second_derivatives(I1, I2, MIN_VOLUME_RATIO, coefficients)
            _, _, _, _, _, curvature = second_derivatives(3.0, 3.0, MIN_VOLUME_RATIO, coefficients)
            excess = J - MIN_VOLUME_RATIO
            return W1 + W1J * excess, W2 + W2J * excess, WJ + curvature * excess
        return W1 + 0.0, W2 + 0.0, WJ + 0.0

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def density(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        F00, F01, F02, F10, F11, F12, F20, F21, F22 = 1.0 + d0, d1, d2, d3, 1.0 + d4, d5, d6, d7, 1.0 + d8
        J = F00 * (F11 * F22 - F12 * F21) + F01 * (F12 * F20 - F10 * F22) + F02 * (F10 * F21 - F11 * F20)
        C00, C11 = F00 * F00 + F10 * F10 + F20 * F20, F01 * F01 + F11 * F11 + F21 * F21
        C22, C01 = F02 * F02 + F12 * F12 + F22 * F22, F00 * F01 + F10 * F11 + F20 * F21
        C02, C12 = F00 * F02 + F10 * F12 + F20 * F22, F01 * F02 + F11 * F12 + F21 * F22
        I1 = C00 + C11 + C22
        I2 = C00 * C11 + C00 * C22 + C11 * C22 - C01 * C01 - C02 * C02 - C12 * C12
        W = energy_density(I1, I2, max(J, MIN_VOLUME_RATIO), coefficients)
        if J < MIN_VOLUME_RATIO:
            _, _, slope = first_derivatives(I1, I2, MIN_VOLUME_RATIO, coefficients)
            _, _, _, _, _, curvature = second_derivatives(3.0, 3.0, MIN_VOLUME_RATIO, coefficients)
            W += (slope + 0.5 * curvature * (J - MIN_VOLUME_RATIO)) * (J - MIN_VOLUME_RATIO)
        return W, J - 1.0

    return MaterialPoint(digest, make_stress(digest, extended), density)


@cache
def _stretched_point(energy_of: Any, first_of: Any, second_of: Any) -> MaterialPoint:
    """Compile the points of a solid whose law depends on the principal stretches."""
    digest = law_digest(__name__, "stretched point", energy_of, first_of, second_of)
    return MaterialPoint(digest, *make_principal_point(digest, energy_of, first_of, second_of, MIN_VOLUME_RATIO))


@cache
def _sheet_point(law: type[Material], relaxed: bool) -> MaterialPoint:
    """Compile the points of a membrane; the first coefficient is the prestretch."""
    digest = law_digest(__name__, "sheet point", law.variables, law.energy, law.first, law.second, relaxed)
    moduli = make_moduli(digest, law.energy, law.first, law.second, relaxed, law.variables)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        F00, F01, F10, F11, F20, F21 = coefficients[0] + d0, d1, d3, coefficients[0] + d4, d6, d7
        C00, C11 = F00 * F00 + F10 * F10 + F20 * F20, F01 * F01 + F11 * F11 + F21 * F21
        C01 = F00 * F01 + F10 * F11 + F20 * F21
        _, a, g = moduli(C00, C11, C01, coefficients[1:])
        l00, l01, l11 = a + g * C11, -g * C01, a + g * C00
        P = (
            F00 * l00 + F01 * l01, F00 * l01 + F01 * l11, 0.0,
            F10 * l00 + F11 * l01, F10 * l01 + F11 * l11, 0.0,
            F20 * l00 + F21 * l01, F20 * l01 + F21 * l11, 0.0,
        )  # fmt: skip
        return P, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def density(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        F00, F01, F10, F11, F20, F21 = coefficients[0] + d0, d1, d3, coefficients[0] + d4, d6, d7
        C00, C11 = F00 * F00 + F10 * F10 + F20 * F20, F01 * F01 + F11 * F11 + F21 * F21
        W, _, _ = moduli(C00, C11, F00 * F01 + F10 * F11 + F20 * F21, coefficients[1:])
        return W, 0.0

    return MaterialPoint(digest, stress, density)
