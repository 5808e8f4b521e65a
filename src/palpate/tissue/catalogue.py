"""All laws, with what a list of them says."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from palpate.tissue.invariant_laws import ArrudaBoyce, Fung, Gent, StVenantKirchhoff, Yeoh
from palpate.tissue.materials import Material, MooneyRivlin, NeoHookean
from palpate.tissue.small_strain import LinearElastic
from palpate.tissue.stretch_laws import Exponential, Logarithmic, Ogden

__all__ = ["LAWS", "Law", "Parameter"]


@dataclass(frozen=True)
class Parameter:
    """A parameter of a law.

    Parameters
    ----------
    name, unit : str
        The unit is empty for a pure number.
    range : str
        Which values are allowed, such as ``"(0, inf)"``.
    """

    name: str
    unit: str
    range: str


@dataclass(frozen=True)
class Law:
    """What a list of laws says about one.

    Parameters
    ----------
    kind : type
        The material.
    formula : str
        Its energy, but for the volumetric part U(J), with x = I1 - 3 - 2 ln J and
        q(a) = l1^a + l2^a + l3^a - 3 - a ln J.
    shear_modulus : str
        At rest.
    reference : str
    example : dict
        Parameters of a soft tissue with a shear modulus near 10 kPa, without density and Poisson's ratio.
    note : str
        What its parameters obey beyond their ranges.
    """

    kind: type[Material]
    formula: str
    shear_modulus: str
    reference: str
    example: dict[str, Any]
    note: str = ""

    @property
    def name(self) -> str:
        """Name of the class, as `palpate` exports it."""
        return self.kind.__name__

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The law's own parameters, in order."""
        own = (f for f in fields(self.kind) if f.metadata)
        return tuple(Parameter(f.name, f.metadata["unit"], _range(f.metadata)) for f in own)


def _range(metadata: Any) -> str:
    low, high = metadata["low"], metadata["high"]
    left = "(" if metadata["open_low"] or low == -float("inf") else "["
    return f"{left}{low:g}, {high:g}{')' if high == float('inf') else ']'}"


LAWS: tuple[Law, ...] = (
    Law(
        NeoHookean, "C1 x", "2 C1",
        "Banihani, Rabczuk, Almomani, Math. Probl. Eng. 2013, equation (17)", {"C1": 5e3},
    ),
    Law(
        MooneyRivlin, "C1/2 (I1 - 3) + C2/2 (I2 - 3) - (C1 + 2 C2) ln J", "C1 + C2",
        "Mooney, J. Appl. Phys. 11, 582, 1940; equation (16)", {"C1": 8e3, "C2": 2e3},
    ),
    Law(
        Ogden, "sum of C_i q(alpha_i)", "1/2 sum of C_i alpha_i^2",
        "Ogden, Proc. R. Soc. A 326, 565, 1972; equation (14)", {"C": (800.0, 120.0), "alpha": (4.0, -7.5)},
        "any number of terms; alpha_i is not zero",
    ),
    Law(
        Exponential, "C1 [exp(C2 q(alpha1)) - 1] + C3 q(alpha2)", "1/2 (C1 C2 alpha1^2 + C3 alpha2^2)",
        "Gao, Lister, Desai, Ann. Biomed. Eng. 38, 505, 2010; equation (18)",
        {"C1": 2e3, "C2": 1.5, "C3": 3e3, "alpha1": 2.0, "alpha2": 1.5}, "alpha1 and alpha2 are not zero",
    ),
    Law(
        Logarithmic, "-C1 ln(1 - C2 q(alpha1)) + C3 q(alpha2)", "1/2 (C1 C2 alpha1^2 + C3 alpha2^2)",
        "Gao, Lister, Desai, Ann. Biomed. Eng. 38, 505, 2010; equation (19)",
        {"C1": 10e3, "C2": 0.35, "C3": 3e3, "alpha1": 2.0, "alpha2": 1.5},
        "alpha1 and alpha2 are not zero; from C2 q(alpha1) = 0.95 on continued by a parabola",
    ),
    Law(
        Yeoh, "C1 x + C2 x^2 + C3 x^3", "2 C1", "Yeoh, Rubber Chem. Technol. 63, 792, 1990",
        {"C1": 5e3, "C2": 1e3, "C3": 200.0}, "C2 is more than -sqrt(3 C1 C3), or not negative",
    ),
    Law(
        Gent, "-mu/2 Jm ln(1 - x/Jm)", "mu", "Gent, Rubber Chem. Technol. 69, 59, 1996", {"mu": 10e3, "Jm": 3.0},
        "from x = 0.95 Jm on continued by a parabola",
    ),
    Law(
        ArrudaBoyce, "five terms of the eight chains' series in 3 + x", "mu (1 + 3/(5N) + 99/(175N^2) + ...)",
        "Arruda, Boyce, J. Mech. Phys. Solids 41, 389, 1993", {"mu": 7.5e3, "N": 2.5},
    ),
    Law(
        Fung, "mu/(2b) [exp(b x) - 1]", "mu",
        "Fung, Am. J. Physiol. 213, 1532, 1967; Demiray, J. Biomech. 5, 309, 1972", {"mu": 10e3, "b": 0.6},
    ),
    Law(
        StVenantKirchhoff, "mu tr E^2,  E = (C - I) / 2", "mu", "Holzapfel, Nonlinear Solid Mechanics, Wiley 2000",
        {"mu": 10e3}, "softens in compression",
    ),
    Law(
        LinearElastic, "mu e : e,  e = sym(F - I), with lame/2 (tr e)^2 for the bulk term", "mu",
        "Landau, Lifshitz, Theory of Elasticity, section 4", {"mu": 10e3},
        "small strains only, not objective; for solids by the full model, not for membranes",
    ),
)  # fmt: skip
