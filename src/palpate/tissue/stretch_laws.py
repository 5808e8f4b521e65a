"""Laws of the principal stretches l1, l2, l3: equations (14), (18) and (19), with their constants as printed.

The printed laws are for incompressible tissue. Their sum of powers l1^a + l2^a + l3^a - 3 is
replaced by

    q(a) = l1^a + l2^a + l3^a - 3 - a ln J,

which is the same at constant volume. It is convex in the logarithms of the stretches, and its
minimum, zero, is at rest for either sign of a. So rest is free of stress, and W_s grows with every
deformation.

The stress is a sum over the principal directions N_i of C,

    S = sum of s_i N_i N_i^T,      s_i = (dW/dl_i) / l_i,

which has no differences of stretches, so equal stretches are not a special case. Its derivative has
them:

    dS = N D N^T,   D_ii = sum over j of ds_i/dx_j K_jj,   D_ij = (s_i - s_j)/(x_i - x_j) K_ij,   K = N^T dC N,

with x_i = l_i^2. At equal stretches the quotient becomes ds_i/dx_i - ds_i/dx_j (Ogden, Non-Linear
Elastic Deformations, 1984, section 6.1). The compiled forces use both
(`palpate.dynamics.material.principal_stretches`).

Powers are exponentials of logarithms that all terms of a law share, at half the cost of powers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from palpate.core.faults import InputError
from palpate.core.parameters import parameter
from palpate.tissue.materials import Material

MAX_EXPONENT = 100.0  # powers of ordinary stretches overflow beyond it
MAX_TERMS = 16  # of Ogden's law; each number of terms is compiled separately, and many terms compile slowly


@dataclass(frozen=True, kw_only=True)
class StretchLaw(Material):
    """Law of the principal stretches.

    Its three static functions take (l1, l2, l3, coefficients). `energy` returns W_s, `first` the
    derivatives by l1, l2 and l3, `second` the derivatives by (l1 l1), (l2 l2), (l3 l3), (l1 l2),
    (l1 l3), (l2 l3).

    Examples
    --------
    >>> import palpate as pt
    >>> issubclass(pt.materials.Ogden, pt.materials.StretchLaw), pt.materials.Ogden.variables
    (True, 'stretches')
    """

    variables: ClassVar[str] = "stretches"

    @property
    def shear_bulk_modulus(self) -> float:
        return 2 / 3 * self.shear_modulus

    def shear_energy(self, F: NDArray[np.float64], coefficients: tuple[Any, ...] | None = None) -> NDArray[np.float64]:
        l1, l2, l3 = np.moveaxis(np.linalg.svd(F, compute_uv=False), -1, 0)
        valid = np.where(np.linalg.det(F) > 0, 1.0, np.nan)  # inverted bodies have no energy
        return np.asarray(valid * self.law.energy(l1, l2, l3, coefficients or self.coefficients))

    def shear_stress(self, F: NDArray[np.float64], coefficients: tuple[Any, ...] | None = None) -> NDArray[np.float64]:
        left, stretches, directions = np.linalg.svd(F)
        l1, l2, l3 = np.moveaxis(stretches, -1, 0)
        slopes = self.law.first(l1, l2, l3, coefficients or self.coefficients)
        return np.asarray((left * np.stack(np.broadcast_arrays(*slopes), axis=-1)[..., None, :]) @ directions)


@dataclass(frozen=True, kw_only=True)
class Ogden(StretchLaw):
    """Ogden's law, equation (14), of 1 to 16 terms (Ogden, Proc. R. Soc. A 326, 565, 1972).

    W = sum of C_i (l1^alpha_i + l2^alpha_i + l3^alpha_i - 3 - alpha_i ln J) + lame / 2 (J - 1)^2,
    shear modulus 1/2 sum of C_i alpha_i^2. In Ogden's own notation C_i is mu_i / alpha_i.

    Parameters
    ----------
    C : float or sequence of float [Pa]
        Coefficient of each term; positive. At most 16 terms.
    alpha : float or sequence of float
        Exponent of each term; nonzero, from -100 to 100.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.Ogden(C=(800.0, 120.0), alpha=(4.0, -7.5), density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (9775.0, 94491.667)
    """

    C: tuple[float, ...] = parameter("Pa", above=0.0, most=MAX_TERMS)
    alpha: tuple[float, ...] = parameter(low=-MAX_EXPONENT, high=MAX_EXPONENT, most=MAX_TERMS)

    def _check_parameters(self) -> None:
        super()._check_parameters()
        if len(self.C) != len(self.alpha) or not self.C:
            raise InputError(f"C and alpha must have equal, non-zero length, got {len(self.C)} and {len(self.alpha)}")
        for i, exponent in enumerate(self.alpha):
            _check_nonzero(f"alpha[{i}]", exponent)

    @property
    def shear_modulus(self) -> float:
        return 0.5 * sum(C * a * a for C, a in zip(self.C, self.alpha, strict=True))

    @property
    def coefficients(self) -> tuple[float, ...]:
        return tuple(number for term in zip(self.C, self.alpha, strict=True) for number in term)

    @staticmethod
    def energy(l1, l2, l3, c):
        h1, h2, h3, total = np.log(l1), np.log(l2), np.log(l3), 0.0
        for k in range(0, len(c), 2):
            a = c[k + 1]
            total += c[k] * (np.exp(a * h1) + np.exp(a * h2) + np.exp(a * h3) - 3.0 - a * (h1 + h2 + h3))
        return total

    @staticmethod
    def first(l1, l2, l3, c):
        h1, h2, h3, w1, w2, w3 = np.log(l1), np.log(l2), np.log(l3), 0.0, 0.0, 0.0
        for k in range(0, len(c), 2):
            C, a = c[k] * c[k + 1], c[k + 1]
            w1 += C * (np.exp(a * h1) - 1.0)
            w2 += C * (np.exp(a * h2) - 1.0)
            w3 += C * (np.exp(a * h3) - 1.0)
        return w1 / l1, w2 / l2, w3 / l3

    @staticmethod
    def second(l1, l2, l3, c):
        h1, h2, h3, w1, w2, w3 = np.log(l1), np.log(l2), np.log(l3), 0.0, 0.0, 0.0
        for k in range(0, len(c), 2):
            C, a = c[k] * c[k + 1], c[k + 1]
            w1 += C * ((a - 1.0) * np.exp(a * h1) + 1.0)
            w2 += C * ((a - 1.0) * np.exp(a * h2) + 1.0)
            w3 += C * ((a - 1.0) * np.exp(a * h3) + 1.0)
        return w1 / (l1 * l1), w2 / (l2 * l2), w3 / (l3 * l3), 0.0, 0.0, 0.0


@dataclass(frozen=True, kw_only=True)
class _Stiffening(StretchLaw):
    """Base of equations (18) and (19): C1 g(C2 q(alpha1)) + C3 q(alpha2), with g'(0) = 1."""

    C1: float = parameter("Pa", above=0.0)
    C2: float = parameter(above=0.0)
    C3: float = parameter("Pa", low=0.0)
    alpha1: float = parameter(low=-MAX_EXPONENT, high=MAX_EXPONENT)
    alpha2: float = parameter(low=-MAX_EXPONENT, high=MAX_EXPONENT)

    def _check_parameters(self) -> None:
        super()._check_parameters()
        _check_nonzero("alpha1", self.alpha1)
        _check_nonzero("alpha2", self.alpha2)

    @property
    def shear_modulus(self) -> float:
        return 0.5 * (self.C1 * self.C2 * self.alpha1**2 + self.C3 * self.alpha2**2)


@dataclass(frozen=True, kw_only=True)
class Exponential(_Stiffening):
    """Exponential law of soft tissue, equation (18) (Gao, Lister, Desai, Ann. Biomed. Eng. 38, 505, 2010).

    W = C1 [exp(C2 q(alpha1)) - 1] + C3 q(alpha2) + lame / 2 (J - 1)^2,  q(a) = l1^a + l2^a + l3^a - 3 - a ln J,
    shear modulus (C1 C2 alpha1^2 + C3 alpha2^2) / 2.

    From C2 q(alpha1) = 20, where it is 5e8, the exponential is continued by its parabola.

    Parameters
    ----------
    C1 : float [Pa]
        Positive.
    C2 : float
        Rate of stiffening; positive.
    C3 : float [Pa]
        Coefficient of the term without stiffening; not negative.
    alpha1, alpha2 : float
        Exponents; nonzero, from -100 to 100.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.Exponential(
    ...     C1=100.0, C2=2.0, C3=500.0, alpha1=3.0, alpha2=2.0, density=1060, poisson=0.45
    ... )
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (1900.0, 18366.667)
    """

    @staticmethod
    def energy(l1, l2, l3, c):
        a, b, h1, h2, h3 = c[3], c[4], np.log(l1), np.log(l2), np.log(l3)
        y = c[1] * (np.exp(a * h1) + np.exp(a * h2) + np.exp(a * h3) - 3.0 - a * (h1 + h2 + h3))
        z = np.minimum(y, 20.0)
        g = np.exp(z) * (1.0 + (y - z) * (1.0 + 0.5 * (y - z))) - 1.0
        return c[0] * g + c[2] * (np.exp(b * h1) + np.exp(b * h2) + np.exp(b * h3) - 3.0 - b * (h1 + h2 + h3))

    @staticmethod
    def first(l1, l2, l3, c):
        a, b, h1, h2, h3 = c[3], c[4], np.log(l1), np.log(l2), np.log(l3)
        p1, p2, p3, r1, r2, r3 = (
            np.exp(a * h1), np.exp(a * h2), np.exp(a * h3), np.exp(b * h1), np.exp(b * h2), np.exp(b * h3)
        )  # fmt: skip
        y = c[1] * (p1 + p2 + p3 - 3.0 - a * (h1 + h2 + h3))
        z = np.minimum(y, 20.0)
        g, h = c[0] * c[1] * a * np.exp(z) * (1.0 + (y - z)), c[2] * b
        return (
            (g * (p1 - 1.0) + h * (r1 - 1.0)) / l1,
            (g * (p2 - 1.0) + h * (r2 - 1.0)) / l2,
            (g * (p3 - 1.0) + h * (r3 - 1.0)) / l3,
        )

    @staticmethod
    def second(l1, l2, l3, c):
        a, b, h1, h2, h3 = c[3], c[4], np.log(l1), np.log(l2), np.log(l3)
        p1, p2, p3, r1, r2, r3 = (
            np.exp(a * h1), np.exp(a * h2), np.exp(a * h3), np.exp(b * h1), np.exp(b * h2), np.exp(b * h3)
        )  # fmt: skip
        y = c[1] * (p1 + p2 + p3 - 3.0 - a * (h1 + h2 + h3))
        z = np.minimum(y, 20.0)
        rise = c[0] * c[1] * a * np.exp(z)
        g, h, k = rise * (1.0 + (y - z)), c[2] * b, rise * c[1] * a
        d1, d2, d3 = (p1 - 1.0) / l1, (p2 - 1.0) / l2, (p3 - 1.0) / l3
        return (
            k * d1 * d1 + (g * ((a - 1.0) * p1 + 1.0) + h * ((b - 1.0) * r1 + 1.0)) / (l1 * l1),
            k * d2 * d2 + (g * ((a - 1.0) * p2 + 1.0) + h * ((b - 1.0) * r2 + 1.0)) / (l2 * l2),
            k * d3 * d3 + (g * ((a - 1.0) * p3 + 1.0) + h * ((b - 1.0) * r3 + 1.0)) / (l3 * l3),
            k * d1 * d2,
            k * d1 * d3,
            k * d2 * d3,
        )


@dataclass(frozen=True, kw_only=True)
class Logarithmic(_Stiffening):
    """Logarithmic law of soft tissue, equation (19), of limited stretch (Gao, Lister, Desai, as above).

    W = -C1 ln(1 - C2 q(alpha1)) + C3 q(alpha2) + lame / 2 (J - 1)^2,  q(a) = l1^a + l2^a + l3^a - 3 - a ln J,
    shear modulus (C1 C2 alpha1^2 + C3 alpha2^2) / 2.

    From 95 % of the limit C2 q(alpha1) = 1 the logarithm is continued by its parabola, 400 times as
    stiff as at rest, so that energy and stress are finite everywhere.

    Parameters
    ----------
    C1 : float [Pa]
        Positive.
    C2 : float
        Reciprocal of the limit of q(alpha1); positive.
    C3 : float [Pa]
        Coefficient of the term without stiffening; not negative.
    alpha1, alpha2 : float
        Exponents; nonzero, from -100 to 100.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.Logarithmic(
    ...     C1=100.0, C2=0.5, C3=500.0, alpha1=3.0, alpha2=2.0, density=1060, poisson=0.45
    ... )
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (1225.0, 11841.667)
    """

    @staticmethod
    def energy(l1, l2, l3, c):
        a, b, h1, h2, h3 = c[3], c[4], np.log(l1), np.log(l2), np.log(l3)
        y = c[1] * (np.exp(a * h1) + np.exp(a * h2) + np.exp(a * h3) - 3.0 - a * (h1 + h2 + h3))
        z = np.minimum(y, 0.95)
        beyond = (y - z) / (1.0 - z)
        g = beyond * (1.0 + 0.5 * beyond) - np.log(1.0 - z)
        return c[0] * g + c[2] * (np.exp(b * h1) + np.exp(b * h2) + np.exp(b * h3) - 3.0 - b * (h1 + h2 + h3))

    @staticmethod
    def first(l1, l2, l3, c):
        a, b, h1, h2, h3 = c[3], c[4], np.log(l1), np.log(l2), np.log(l3)
        p1, p2, p3, r1, r2, r3 = (
            np.exp(a * h1), np.exp(a * h2), np.exp(a * h3), np.exp(b * h1), np.exp(b * h2), np.exp(b * h3)
        )  # fmt: skip
        y = c[1] * (p1 + p2 + p3 - 3.0 - a * (h1 + h2 + h3))
        z = np.minimum(y, 0.95)
        r = 1.0 / (1.0 - z)
        g, h = c[0] * c[1] * a * r * (1.0 + (y - z) * r), c[2] * b
        return (
            (g * (p1 - 1.0) + h * (r1 - 1.0)) / l1,
            (g * (p2 - 1.0) + h * (r2 - 1.0)) / l2,
            (g * (p3 - 1.0) + h * (r3 - 1.0)) / l3,
        )

    @staticmethod
    def second(l1, l2, l3, c):
        a, b, h1, h2, h3 = c[3], c[4], np.log(l1), np.log(l2), np.log(l3)
        p1, p2, p3, r1, r2, r3 = (
            np.exp(a * h1), np.exp(a * h2), np.exp(a * h3), np.exp(b * h1), np.exp(b * h2), np.exp(b * h3)
        )  # fmt: skip
        y = c[1] * (p1 + p2 + p3 - 3.0 - a * (h1 + h2 + h3))
        z = np.minimum(y, 0.95)
        r = 1.0 / (1.0 - z)
        g, h = c[0] * c[1] * a * r * (1.0 + (y - z) * r), c[2] * b
        d1, d2, d3, k = (p1 - 1.0) / l1, (p2 - 1.0) / l2, (p3 - 1.0) / l3, c[0] * (c[1] * a * r) ** 2
        return (
            k * d1 * d1 + (g * ((a - 1.0) * p1 + 1.0) + h * ((b - 1.0) * r1 + 1.0)) / (l1 * l1),
            k * d2 * d2 + (g * ((a - 1.0) * p2 + 1.0) + h * ((b - 1.0) * r2 + 1.0)) / (l2 * l2),
            k * d3 * d3 + (g * ((a - 1.0) * p3 + 1.0) + h * ((b - 1.0) * r3 + 1.0)) / (l3 * l3),
            k * d1 * d2,
            k * d1 * d3,
            k * d2 * d3,
        )


def _check_nonzero(name: str, exponent: float) -> None:
    if exponent == 0:
        raise InputError(f"{name} must be nonzero and in [{-MAX_EXPONENT:g}, {MAX_EXPONENT:g}], got 0")
