"""Fibres in tissue: strain energies of directions, beside the isotropic law of the tissue that they lie in.

A law of fibres is an energy per reference volume [J/m^3] of the isochoric strain and of unit directions a,

    W_f = sum over families of w(C̄, a),      C̄ = J^(-2/3) C,

so that a change of volume alone does not strain them: it is the tissue's. In nearly incompressible tissue, where the
two agree, that keeps the pressure apart; in clearly compressible tissue it makes fibres give way to a pull from all
sides (Vergori, Destrade, McGarry, Ogden, Comput. Mech. 52, 2013). The stress is

    P = J^(-2/3) (F S - (S : C) / (3 J) cof F),      S = sum of 2 dw/dC̄.

Where tissue is crushed to less than `LEAST` of its volume, J^(-2/3) goes on along its tangent: C̄ and W_f are finite and
smooth for every F, inside out too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.faults import InputError, check_names, first_few, number_in_range
from palpate.tissue.materials import ShearLaw, parameter

__all__ = ["LEAST", "FibreLaw", "Fibres", "Guccione", "VolumeOnly"]


LEAST = 0.1  # volume ratio below which J^(-2/3) goes on along its tangent
UNIT = 1e-6  # by which the length of a direction may miss 1


@dataclass(frozen=True, kw_only=True, eq=False)
class FibreLaw(Described, ABC):
    """An energy of the isochoric strain and of directions.

    A law of one's own has its parameters, as a `Material` has, and `respond`, which is compiled as it is: plain
    arithmetic and NumPy functions.

    Parameters
    ----------
    directions : array or function
        Unit vectors at rest: (3,) for one family that runs straight through the body, (2, 3) for two; (n, 3) and
        (2, n, 3) with a vector for every node; or a function that makes any of these of the points (n, 3).

    Attributes
    ----------
    most : int
        How many families the law allows.
    """

    most: ClassVar[int] = 2

    directions: Any = field(repr=False)

    def __new__(cls, *unnamed: Any, **given: Any) -> Self:
        check_names(cls.__name__, given, {f.name: f.metadata.get("unit", "") for f in fields(cls)})
        return super().__new__(cls)

    def _facts(self) -> list[Fact]:
        placed = None if callable(self.directions) else self.directions
        return [
            *((f.name, getattr(self, f.name), f.metadata["unit"]) for f in fields(self) if f.metadata),
            ("families", None if placed is None else len(placed), ""),
            ("directions", "a function of the points" if placed is None else "one everywhere"
             if placed.ndim == 2 else f"at {placed.shape[1]:,} nodes", ""),
        ]  # fmt: skip

    def __post_init__(self) -> None:
        for each in fields(self):
            if each.metadata:
                number_in_range(each.name, getattr(self, each.name), **each.metadata)
        if not callable(self.directions):
            object.__setattr__(self, "directions", self._checked(self.directions))

    def _checked(self, given: Any) -> Floats:
        """Return directions as (families, 3) or (families, n, 3)."""
        name = "directions of fibres"
        try:
            array = np.array(given, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{name} must be numbers") from None
        if array.ndim == 1 or (array.ndim == 2 and len(array) > 2):
            array = array[None]
        if array.ndim not in (2, 3) or array.shape[-1] != 3 or not 1 <= len(array) <= 2:
            raise InputError(f"{name} have shape {np.shape(given)}: allowed are (3,), (2, 3), (n, 3) and (2, n, 3)")
        if len(array) > self.most:
            raise InputError(f"{type(self).__name__} has one family of fibres, not {len(array)}")
        with np.errstate(all="ignore"):
            lengths = np.linalg.norm(array, axis=-1)
            wrong = ~(np.abs(lengths - 1) < UNIT)
        if wrong.any():
            where = f" at nodes {first_few(np.flatnonzero(wrong.any(axis=0)))}" if array.ndim == 3 else ""
            raise InputError(f"{name} must be unit vectors; one{where} has length {lengths[wrong][0]:g}")
        return array

    def at(self, points: Floats) -> Self:
        """Return these fibres with directions (families, n, 3), one for each of some points (n, 3).

        Raises
        ------
        InputError
            Directions for another number of points, or not of unit length.
        """
        array = self._checked(self.directions(points)) if callable(self.directions) else self.directions
        if array.ndim == 2:
            array = np.repeat(array[:, None], len(points), axis=1)
        if array.shape[1] != len(points):
            raise InputError(
                f"directions of fibres are given for {array.shape[1]} nodes, and the body has {len(points)}"
            )
        return replace(self, directions=array)

    def of(self, nodes: Any) -> Self:
        """Return these fibres, placed by `at`, with the directions of some nodes."""
        return replace(self, directions=self.directions[:, nodes])

    @property
    def coefficients(self) -> tuple[float, ...]:
        """What `respond` takes: the law's own parameters, in the order of its fields, and 0."""
        return (*(float(getattr(self, f.name)) for f in fields(self) if f.name != "directions"), 0.0)

    @staticmethod
    @abstractmethod
    def respond(C: tuple[Any, ...], a: tuple[Any, Any, Any], c: tuple[float, ...]) -> tuple[Any, tuple[Any, ...]]:
        """Return w [J/m^3] and 2 dw/dC̄ of C̄ and one direction; tensors as 00 11 22 01 02 12.

        The last of the coefficients is 1 where a stable step is sought: fibres that carry no compression then carry as
        much of it as of a small tension, because what is slack now may be taut in a moment.
        """

    def energy(self, F: Floats) -> Floats:
        """Return W_f [J/m^3] for deformation gradients (..., 3, 3) where the directions are."""
        return self._answer(F)[0]

    def stress(self, F: Floats) -> Floats:
        """Return the first Piola-Kirchhoff stress dW_f/dF [Pa], (..., 3, 3)."""
        return self._answer(F)[1]

    def _answer(self, F: Floats) -> tuple[Floats, Floats]:
        C, J = np.swapaxes(F, -1, -2) @ F, np.linalg.det(F)
        scale, slope = _scale(J)
        six = tuple(scale * C[..., i, j] for i, j in PLACES)
        energy, S = np.zeros_like(J), np.zeros_like(C)
        for family in self.directions:
            density, found = self.respond(six, (family[..., 0], family[..., 1], family[..., 2]), self.coefficients)
            energy += density
            for (i, j), value in zip(PLACES, found, strict=True):
                S[..., i, j] += value
                if i != j:
                    S[..., j, i] += value
        rows = [F[..., i, :] for i in range(3)]
        cofactor = np.stack([np.cross(rows[1], rows[2]), np.cross(rows[2], rows[0]), np.cross(rows[0], rows[1])], -2)
        pressure = 0.5 * slope * np.einsum("...ij,...ij", S, C)
        return energy, scale[..., None, None] * F @ S + pressure[..., None, None] * cofactor


PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _scale(J: Floats) -> tuple[Floats, Floats]:
    """J^(-2/3) and its derivative, along the tangent below `LEAST`."""
    large = np.maximum(J, LEAST)
    slope = -2 / 3 * large ** (-5 / 3)
    return large ** (-2 / 3) + slope * (J - large), slope


@dataclass(frozen=True, kw_only=True, eq=False)
class Fibres(FibreLaw):
    """One or two families of dispersed fibres (Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3, 15, 2006).

    w = k1/(2 k2) [exp(k2 <E>^2) - 1],  E = dispersion (I1bar - 3) + (1 - 3 dispersion) (I4bar - 1),
    I1bar = tr C̄,  I4bar = a . C̄ a.

    <E> is E where it is positive and 0 elsewhere: fibres carry no compression. E is the mean square stretch of the
    family's fibres less 1. With no dispersion it is the square of the stretch along a, less 1; with dispersion 1/3
    fibres run evenly in all directions. The paper drops a family where I4bar <= 1, which with dispersion is a jump in
    the stress; the positive part of E, as finite-element codes have it, is not. From k2 <E>^2 = 20 on the exponential,
    5e8 then, goes on as its parabola.

    At rest the stiffness of the fibres begins all at once: a small stretch along a meets 4 k1 (1 - 3 dispersion)^2,
    a small squeeze nothing.

    Parameters
    ----------
    k1 : float [Pa]
        Positive.
    k2 : float
        How fast fibres stiffen; positive.
    dispersion : float
        The paper's kappa, 0 to 1/3.
    directions
        As for `FibreLaw`.
    """

    k1: float = parameter("Pa", above=0.0)
    k2: float = parameter(above=0.0)
    dispersion: float = field(default=0.0, metadata=dict(parameter(low=0.0, high=1 / 3).metadata))

    @staticmethod
    def respond(C, a, c):  # type: ignore[no-untyped-def]
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
    """The transversely isotropic law of the heart (Guccione, McCulloch, Waldman, J. Biomech. Eng. 113, 42, 1991).

    w = C/2 [exp(Q) - 1],  Q = bf E11^2 + bt (E22^2 + E33^2 + 2 E23^2) + 2 bfs (E12^2 + E13^2),  E = (C̄ - I) / 2,

    1 along the one direction. It resists every deformation, compression too; the shear modulus at rest is C bt / 2
    across and C bfs / 2 along the fibres. `VolumeOnly` is a material for tissue that has no other energy. From Q = 20
    on the exponential goes on as its parabola.

    Parameters
    ----------
    C : float [Pa]
        Positive.
    bf, bt, bfs : float
        Positive.
    directions
        As for `FibreLaw`; one family.
    """

    most: ClassVar[int] = 1

    C: float = parameter("Pa", above=0.0)
    bf: float = parameter(above=0.0)
    bt: float = parameter(above=0.0)
    bfs: float = parameter(above=0.0)

    @staticmethod
    def respond(C, a, c):  # type: ignore[no-untyped-def]
        scale, bf, bt, bfs = c[0], c[1], c[2], c[3]
        E0, E1, E2 = 0.5 * (C[0] - 1.0), 0.5 * (C[1] - 1.0), 0.5 * (C[2] - 1.0)
        E3, E4, E5 = 0.5 * C[3], 0.5 * C[4], 0.5 * C[5]
        g0, g1, g2 = (  # E a
            E0 * a[0] + E3 * a[1] + E4 * a[2], E3 * a[0] + E1 * a[1] + E5 * a[2], E4 * a[0] + E5 * a[1] + E2 * a[2],
        )  # fmt: skip
        along = g0 * a[0] + g1 * a[1] + g2 * a[2]
        both = g0 * g0 + g1 * g1 + g2 * g2
        whole = E0 * E0 + E1 * E1 + E2 * E2 + 2.0 * (E3 * E3 + E4 * E4 + E5 * E5)
        y = bt * whole + 2.0 * (bfs - bt) * both + (bf + bt - 2.0 * bfs) * along * along
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
    """A material that resists a change of volume alone, W = bulk / 2 (J - 1)^2: the law of its fibres is the tissue's.

    Parameters
    ----------
    mu : float [Pa]
        Shear modulus at rest of the law of its fibres; positive. The material has none of its own: this says what
        `poisson` means, and how firmly a body is held against waves that its stencils do not see.
    density, poisson, bulk
        As for `Material`.
    """

    @property
    def shear_bulk_modulus(self) -> float:
        return 0.0

    @staticmethod
    def energy(I1, I2, J, c):  # type: ignore[no-untyped-def]
        return 0.0 * I1

    @staticmethod
    def first(I1, I2, J, c):  # type: ignore[no-untyped-def]
        return 0.0 * I1, 0.0, 0.0

    @staticmethod
    def second(I1, I2, J, c):  # type: ignore[no-untyped-def]
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
