"""Fibre laws: anisotropic strain energies, in addition to the isotropic law of the tissue.

A fibre law is an energy per reference volume [J/m^3] of the isochoric strain and of unit directions
a,

    W_f = sum over families of w(C̄, a),      C̄ = J^(-2/3) C,

so a pure change of volume does not strain fibres. In nearly incompressible tissue this separates
the pressure. In compressible tissue fibres do not resist a hydrostatic tension (Vergori, Destrade,
McGarry, Ogden, Comput. Mech. 52, 2013). The stress is

    P = J^(-2/3) (F S - (S : C) / (3 J) cof F),      S = sum of 2 dw/dC̄.

Below a volume ratio of `MIN_VOLUME_RATIO`, J^(-2/3) is continued by its tangent: C̄ and W_f are
finite and smooth for every F, including inverted ones.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, brief, check_arguments, check_names, first_few
from palpate.core.parameters import check_parameters, parameter
from palpate.tissue.materials import ShearLaw

MIN_VOLUME_RATIO = 0.1  # J below which J^(-2/3) is continued by its tangent
LENGTH_TOLERANCE = 1e-6  # largest deviation of the length of a direction from 1


@dataclass(frozen=True, kw_only=True, eq=False)
class FibreLaw(Described, ABC):
    """Strain energy of fibres, a function of the isochoric strain and of directions.

    A subclass defines its parameters, like a `Material`, and `respond`. `respond` is compiled, so
    it is limited to arithmetic and NumPy functions.

    Parameters
    ----------
    directions : array or function
        Unit vectors at rest: (3,) for one straight family, (2, 3) for two; (n, 3) and (2, n, 3) for
        one vector per node; or a function of the points (n, 3) that returns one of these.

    Attributes
    ----------
    max_families : int
        Largest number of families.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.Fibres(directions=[(1, 0, 0), (0, 1, 0)], k1=2e3, k2=5.0)
    >>> isinstance(law, pt.materials.FibreLaw), law.max_families
    (True, 2)
    """

    max_families: ClassVar[int] = 2

    directions: Any = field(repr=False)

    def __new__(cls, *unnamed: Any, **parameters: Any) -> Self:
        check_names(cls.__name__, parameters, {f.name: f.metadata.get("unit", "") for f in fields(cls)})
        return super().__new__(cls)

    def _facts(self) -> list[Fact]:
        placed = None if callable(self.directions) else self.directions
        return [
            *super()._facts(),
            ("families", None if placed is None else len(placed), ""),
            ("directions", "a function of the points" if placed is None else "one everywhere"
             if placed.ndim == 2 else f"at {placed.shape[1]:,} nodes", ""),
        ]  # fmt: skip

    def __post_init__(self) -> None:
        check_parameters(self)
        if callable(self.directions):
            check_arguments(self.directions, ("points",), "directions of fibres")
        else:
            object.__setattr__(self, "directions", self._check_directions(self.directions))

    def _check_directions(self, value: Any) -> Floats:
        """Return directions of shape (families, 3) or (families, n, 3)."""
        name = "directions of fibres"
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{name} must be an array of numbers, got {brief(value)}") from None
        if array.ndim == 1 or (array.ndim == 2 and len(array) > 2):
            array = array[None]
        if array.ndim not in (2, 3) or array.shape[-1] != 3 or not 1 <= len(array) <= 2:
            raise InputError(f"{name} must have shape (3,), (2, 3), (n, 3) or (2, n, 3), got {np.shape(value)}")
        if len(array) > self.max_families:
            raise InputError(f"{name} of {type(self).__name__} must be one family, got {len(array)}")
        with np.errstate(all="ignore"):
            lengths = np.linalg.norm(array, axis=-1)
            wrong = ~(np.abs(lengths - 1) < LENGTH_TOLERANCE)
        if wrong.any():
            where = f" at nodes {first_few(np.flatnonzero(wrong.any(axis=0)))}" if array.ndim == 3 else ""
            raise InputError(
                f"{name} must be unit vectors, got a length of {lengths[wrong][0]:g}{where}; normalise them"
            )
        return array

    def at(self, points: Floats) -> Self:
        """Return the fibres with directions (families, n, 3) at points (n, 3).

        Raises
        ------
        InputError
            The number of directions differs from that of points, or a direction is not of unit
            length.
        """
        array = self._check_directions(self.directions(points)) if callable(self.directions) else self.directions
        if array.ndim == 2:
            array = np.repeat(array[:, None], len(points), axis=1)
        if array.shape[1] != len(points):
            raise InputError(f"directions of fibres must have {len(points)} nodes, as the body, got {array.shape[1]}")
        return replace(self, directions=array)

    def of(self, nodes: Any) -> Self:
        """Return the fibres with the directions of some nodes; call `at` first."""
        return replace(self, directions=self.directions[:, nodes])

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients of `respond`: the parameters of the law in the order of its fields, and 0."""
        return (*(float(getattr(self, f.name)) for f in fields(self) if f.name != "directions"), 0.0)

    @staticmethod
    @abstractmethod
    def respond(C: tuple[Any, ...], a: tuple[Any, Any, Any], c: tuple[float, ...]) -> tuple[Any, tuple[Any, ...]]:
        """Return w [J/m^3] and 2 dw/dC̄ for C̄ and one direction; tensors as 00 11 22 01 02 12.

        The last coefficient is 1 in the estimate of the stable step. Fibres without compressive
        stiffness then resist compression like a small tension, because a slack fibre may become
        taut before the next estimate.
        """

    def energy(self, F: Floats) -> Floats:
        """Return W_f [J/m^3] for deformation gradients (..., 3, 3) at the points of the directions."""
        return self._energy_and_stress(F)[0]

    def stress(self, F: Floats) -> Floats:
        """Return the first Piola-Kirchhoff stress dW_f/dF [Pa], (..., 3, 3)."""
        return self._energy_and_stress(F)[1]

    def _energy_and_stress(self, F: Floats) -> tuple[Floats, Floats]:
        C, J = np.swapaxes(F, -1, -2) @ F, np.linalg.det(F)
        scale, slope = _scale(J)
        six = tuple(scale * C[..., i, j] for i, j in TENSOR_COMPONENTS)
        energy, S = np.zeros_like(J), np.zeros_like(C)
        for family in self.directions:
            density, components = self.respond(six, (family[..., 0], family[..., 1], family[..., 2]), self.coefficients)
            energy += density
            for (i, j), value in zip(TENSOR_COMPONENTS, components, strict=True):
                S[..., i, j] += value
                if i != j:
                    S[..., j, i] += value
        rows = [F[..., i, :] for i in range(3)]
        cofactor = np.stack([np.cross(rows[1], rows[2]), np.cross(rows[2], rows[0]), np.cross(rows[0], rows[1])], -2)
        pressure = 0.5 * slope * np.einsum("...ij,...ij", S, C)
        return energy, scale[..., None, None] * F @ S + pressure[..., None, None] * cofactor


TENSOR_COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _scale(J: Floats) -> tuple[Floats, Floats]:
    """Return J^(-2/3) and its derivative, continued by the tangent below `MIN_VOLUME_RATIO`."""
    large = np.maximum(J, MIN_VOLUME_RATIO)
    slope = -2 / 3 * large ** (-5 / 3)
    return large ** (-2 / 3) + slope * (J - large), slope


@dataclass(frozen=True, kw_only=True, eq=False)
class Fibres(FibreLaw):
    """One or two families of dispersed fibres (Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3, 15, 2006).

    w = k1/(2 k2) [exp(k2 <E>^2) - 1],  E = dispersion (I1bar - 3) + (1 - 3 dispersion) (I4bar - 1),
    I1bar = tr C̄,  I4bar = a . C̄ a.

    <E> = max(E, 0): fibres carry no compression. E is the mean square stretch of the family's
    fibres minus 1. Without dispersion it is the squared stretch along a, minus 1; dispersion 1/3 is
    an isotropic distribution. The paper drops a family where I4bar <= 1, so with dispersion its
    stress jumps. The positive part of E, usual in finite-element codes, is continuous. From k2
    <E>^2 = 20, where it is 5e8, the exponential is continued by its parabola.

    The stiffness of the fibres jumps at rest: it is 4 k1 (1 - 3 dispersion)^2 in tension along a,
    and zero in compression.

    Parameters
    ----------
    k1 : float [Pa]
        Positive.
    k2 : float
        Rate of stiffening; positive.
    dispersion : float
        Dispersion kappa, 0 to 1/3.
    directions
        As for `FibreLaw`.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> fibres = pt.materials.Fibres(directions=(1, 0, 0), k1=2e3, k2=5.0).at(np.zeros((1, 3)))
    >>> stretched = np.diag([1.1, 1.1**-0.5, 1.1**-0.5])[None]
    >>> bool(fibres.stress(stretched)[0, 0, 0] > 0)
    True
    >>> float(fibres.energy(np.linalg.inv(stretched))[0])
    0.0
    """

    k1: float = parameter("Pa", above=0.0)
    k2: float = parameter(above=0.0)
    dispersion: float = parameter("", 0.0, low=0.0, high=1 / 3)

    @staticmethod
    def respond(C, a, c):
        k1, k2, kappa = c[0], c[1], c[2]
        I1 = C[0] + C[1] + C[2]
        I4 = a[0] * a[0] * C[0] + a[1] * a[1] * C[1] + a[2] * a[2] * C[2]
        I4 += 2.0 * (a[0] * a[1] * C[3] + a[0] * a[2] * C[4] + a[1] * a[2] * C[5])
        one = 1.0 - 3.0 * kappa
        strain = kappa * (I1 - 3.0) + one * (I4 - 1.0)
        E, slack = np.maximum(strain, 0.0), c[3] * np.minimum(strain, 0.0)
        y = k2 * E * E
        z = np.minimum(y, 20.0)
        rise, more = np.expm1(z), y - z
        w = 0.5 * k1 * ((rise + (rise + 1.0) * more * (1.0 + 0.5 * more)) / k2 + slack * slack)
        slope = 2.0 * k1 * (E * (rise + 1.0) * (1.0 + more) + slack)
        even, along = slope * kappa, slope * one
        return w, (
            even + along * a[0] * a[0], even + along * a[1] * a[1], even + along * a[2] * a[2],
            along * a[0] * a[1], along * a[0] * a[2], along * a[1] * a[2],
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Guccione(FibreLaw):
    """Transversely isotropic law of the heart (Guccione, McCulloch, Waldman, J. Biomech. Eng. 113, 42, 1991).

    w = C/2 [exp(Q) - 1],  Q = bf E11^2 + bt (E22^2 + E33^2 + 2 E23^2) + 2 bfs (E12^2 + E13^2),  E = (C̄ - I) / 2,

    axis 1 along the fibres. It resists every deformation, including compression. The shear modulus
    at rest is C bt / 2 across and C bfs / 2 along the fibres. Use the material `VolumeOnly` if the
    tissue has no other energy. From Q = 20 the exponential is continued by its parabola.

    Parameters
    ----------
    C : float [Pa]
        Positive.
    bf, bt, bfs : float
        Positive.
    directions
        As for `FibreLaw`; one family.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> law = pt.materials.Guccione(directions=(1, 0, 0), C=2e3, bf=8.0, bt=2.0, bfs=4.0)
    >>> heart = law.at(np.zeros((1, 3)))
    >>> along = np.diag([1.1, 1.1**-0.5, 1.1**-0.5])[None]
    >>> across = np.diag([1.1**-0.5, 1.1, 1.1**-0.5])[None]
    >>> bool(heart.energy(along)[0] > heart.energy(across)[0])
    True
    """

    max_families: ClassVar[int] = 1

    C: float = parameter("Pa", above=0.0)
    bf: float = parameter(above=0.0)
    bt: float = parameter(above=0.0)
    bfs: float = parameter(above=0.0)

    @staticmethod
    def respond(C, a, c):
        scale, bf, bt, bfs = c[0], c[1], c[2], c[3]
        E0, E1, E2 = 0.5 * (C[0] - 1.0), 0.5 * (C[1] - 1.0), 0.5 * (C[2] - 1.0)
        E3, E4, E5 = 0.5 * C[3], 0.5 * C[4], 0.5 * C[5]
        g0, g1, g2 = (  # E a
            E0 * a[0] + E3 * a[1] + E4 * a[2], E3 * a[0] + E1 * a[1] + E5 * a[2], E4 * a[0] + E5 * a[1] + E2 * a[2],
        )  # fmt: skip
        along = g0 * a[0] + g1 * a[1] + g2 * a[2]
        both = g0 * g0 + g1 * g1 + g2 * g2
        squares = E0 * E0 + E1 * E1 + E2 * E2 + 2.0 * (E3 * E3 + E4 * E4 + E5 * E5)
        y = bt * squares + 2.0 * (bfs - bt) * both + (bf + bt - 2.0 * bfs) * along * along
        z = np.minimum(y, 20.0)
        rise, more = np.expm1(z), y - z
        w = 0.5 * scale * (rise + (rise + 1.0) * more * (1.0 + 0.5 * more))
        slope = scale * (rise + 1.0) * (1.0 + more)
        p, q, r = slope * bt, slope * (bfs - bt), slope * (bf + bt - 2.0 * bfs) * along
        return w, (
            p * E0 + a[0] * (2.0 * q * g0 + r * a[0]), p * E1 + a[1] * (2.0 * q * g1 + r * a[1]),
            p * E2 + a[2] * (2.0 * q * g2 + r * a[2]), p * E3 + q * (a[0] * g1 + a[1] * g0) + r * a[0] * a[1],
            p * E4 + q * (a[0] * g2 + a[2] * g0) + r * a[0] * a[2],
            p * E5 + q * (a[1] * g2 + a[2] * g1) + r * a[1] * a[2],
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class VolumeOnly(ShearLaw):
    """Material with a volumetric energy only, W = bulk / 2 (J - 1)^2, for tissue whose fibre law is its whole energy.

    Parameters
    ----------
    mu : float [Pa]
        Shear modulus at rest of the fibre law; positive. It defines `poisson` and scales the
        hourglass stabilisation; the material itself has no shear stiffness.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> base = pt.materials.VolumeOnly(mu=2e3, bulk=1e5, density=1060)
    >>> round(base.bulk_modulus), base.shear_modulus
    (100000, 2000.0)
    """

    @property
    def shear_bulk_modulus(self) -> float:
        return 0.0

    @staticmethod
    def energy(I1, I2, J, c):
        return 0.0 * I1

    @staticmethod
    def first(I1, I2, J, c):
        return 0.0 * I1, 0.0, 0.0

    @staticmethod
    def second(I1, I2, J, c):
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
