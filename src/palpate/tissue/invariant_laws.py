"""Laws of the invariants: Yeoh, Gent, Arruda-Boyce, Fung and St. Venant-Kirchhoff.

Laws printed for incompressible tissue as W = f(I1 - 3) become compressible by

    W_s = f(x),      x = I1 - 3 - 2 ln J.

x equals I1 - 3 at constant volume. It is a convex function of the logarithms of the stretches, and
its minimum, zero, is at rest. So rest is free of stress, and W_s grows with every deformation if f
does. For every f, mu = 2 f'(0), and the shear part contributes 2/3 mu to the bulk modulus. f(x) =
mu/2 x gives the neo-Hookean law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core.faults import number_in_range
from palpate.core.parameters import parameter
from palpate.tissue.materials import Material, ShearLaw


@dataclass(frozen=True, kw_only=True)
class Yeoh(Material):
    """Yeoh's law (Rubber Chem. Technol. 63, 792, 1990).

    W = C1 x + C2 x^2 + C3 x^3 + lame / 2 (J - 1)^2,  x = I1 - 3 - 2 ln J,  shear modulus 2 C1.

    Parameters
    ----------
    C1 : float [Pa]
        Positive.
    C2 : float [Pa]
        Above -sqrt(3 C1 C3), so that the stress increases with stretch; or zero.
    C3 : float [Pa]
        Not negative.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.Yeoh(C1=1e3, C2=200.0, C3=50.0, density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (2000.0, 19333.333)
    """

    C1: float = parameter("Pa", above=0.0)
    C2: float = parameter("Pa")
    C3: float = parameter("Pa", low=0.0)

    def _check_parameters(self) -> None:
        super()._check_parameters()
        least = -float(np.sqrt(3 * self.C1 * self.C3)) or 0.0
        number_in_range("C2", self.C2, least, open_low=least < 0, unit="Pa, from -sqrt(3 C1 C3)")

    @property
    def shear_modulus(self) -> float:
        return 2 * self.C1

    @property
    def shear_bulk_modulus(self) -> float:
        return 2 / 3 * self.shear_modulus

    @staticmethod
    def energy(I1, I2, J, c):
        x = I1 - 3.0 - 2.0 * np.log(J)
        return x * (c[0] + x * (c[1] + x * c[2]))

    @staticmethod
    def first(I1, I2, J, c):
        x = I1 - 3.0 - 2.0 * np.log(J)
        f1 = c[0] + x * (2.0 * c[1] + x * 3.0 * c[2])
        return f1, 0.0, -2.0 * f1 / J

    @staticmethod
    def second(I1, I2, J, c):
        x = I1 - 3.0 - 2.0 * np.log(J)
        f1 = c[0] + x * (2.0 * c[1] + x * 3.0 * c[2])
        f2 = 2.0 * c[1] + 6.0 * c[2] * x
        return f2, 0.0, 0.0, -2.0 * f2 / J, 0.0, (4.0 * f2 + 2.0 * f1) / (J * J)


@dataclass(frozen=True, kw_only=True)
class Gent(ShearLaw):
    """Gent's law of limited stretch (Rubber Chem. Technol. 69, 59, 1996).

    W = -mu/2 Jm ln(1 - x/Jm) + lame / 2 (J - 1)^2,  x = I1 - 3 - 2 ln J,  shear modulus mu.

    From 95 % of the limit x = Jm the logarithm is continued by its parabola, 400 times as stiff as
    at rest, so that energy and stress are finite everywhere.

    Parameters
    ----------
    mu : float [Pa]
        Positive.
    Jm : float
        I1 - 3 at the limit; positive.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.Gent(mu=2e3, Jm=3.0, density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (2000.0, 19333.333)
    """

    Jm: float = parameter(above=0.0)

    @staticmethod
    def energy(I1, I2, J, c):
        y = (I1 - 3.0 - 2.0 * np.log(J)) * (1.0 / c[1])
        z = np.minimum(y, 0.95)
        r = 1.0 / (1.0 - z)
        beyond = (y - z) * r
        return 0.5 * c[0] * c[1] * (beyond * (1.0 + 0.5 * beyond) - np.log(1.0 - z))

    @staticmethod
    def first(I1, I2, J, c):
        y = (I1 - 3.0 - 2.0 * np.log(J)) * (1.0 / c[1])
        z = np.minimum(y, 0.95)
        r = 1.0 / (1.0 - z)
        f1 = 0.5 * c[0] * r * (1.0 + (y - z) * r)
        return f1, 0.0, -2.0 * f1 / J

    @staticmethod
    def second(I1, I2, J, c):
        y = (I1 - 3.0 - 2.0 * np.log(J)) * (1.0 / c[1])
        z = np.minimum(y, 0.95)
        r = 1.0 / (1.0 - z)
        f1 = 0.5 * c[0] * r * (1.0 + (y - z) * r)
        f2 = 0.5 * c[0] / c[1] * r * r
        return f2, 0.0, 0.0, -2.0 * f2 / J, 0.0, (4.0 * f2 + 2.0 * f1) / (J * J)


@dataclass(frozen=True, kw_only=True)
class ArrudaBoyce(Material):
    """Arruda and Boyce's eight-chain law (J. Mech. Phys. Solids 41, 389, 1993), its series to five terms.

    W = mu [x/2 + (I^2 - 9)/(20 N) + 11 (I^3 - 27)/(1050 N^2) + 19 (I^4 - 81)/(7000 N^3) + 519 (I^5 - 243)/(673750 N^4)]
        + lame / 2 (J - 1)^2,  I = 3 + x,  x = I1 - 3 - 2 ln J.

    Parameters
    ----------
    mu : float [Pa]
        Modulus of the chains; positive. `shear_modulus` is mu (1 + 3/(5N) + ...).
    N : float
        Links of a chain; at least 1. A chain is straight at a stretch of sqrt(N).
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.ArrudaBoyce(mu=2e3, N=8.0, density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (2170.273, 20979.31)
    """

    mu: float = parameter("Pa", above=0.0)
    N: float = parameter(low=1.0)

    @property
    def shear_modulus(self) -> float:
        n = 1 / self.N
        return self.mu * (1 + n * (3 / 5 + n * (99 / 175 + n * (513 / 875 + n * (42039 / 67375)))))

    @property
    def shear_bulk_modulus(self) -> float:
        return 2 / 3 * self.shear_modulus

    @staticmethod
    def energy(I1, I2, J, c):
        a, n = I1 - 2.0 * np.log(J), 1.0 / c[1]
        # each term is a difference of powers of I and 3, with the factor I - 3
        s2, s3 = a + 3.0, a * a + 3.0 * a + 9.0
        s4, s5 = s2 * (a * a + 9.0), a * a * s3 + 27.0 * s2
        series = 519 / 673750 * n * s5 + 19 / 7000 * s4
        return c[0] * (a - 3.0) * (0.5 + n * (s2 / 20.0 + n * (11 / 1050 * s3 + n * series)))

    @staticmethod
    def first(I1, I2, J, c):
        a, n = I1 - 2.0 * np.log(J), 1.0 / c[1]
        p = a * n
        f1 = c[0] * (0.5 + p * (1 / 10 + p * (11 / 350 + p * (19 / 1750 + p * (519 / 134750)))))
        return f1, 0.0, -2.0 * f1 / J

    @staticmethod
    def second(I1, I2, J, c):
        a, n = I1 - 2.0 * np.log(J), 1.0 / c[1]
        p = a * n
        f1 = c[0] * (0.5 + p * (1 / 10 + p * (11 / 350 + p * (19 / 1750 + p * (519 / 134750)))))
        f2 = c[0] * n * (1 / 10 + p * (11 / 175 + p * (57 / 1750 + p * (1038 / 67375))))
        return f2, 0.0, 0.0, -2.0 * f2 / J, 0.0, (4.0 * f2 + 2.0 * f1) / (J * J)


@dataclass(frozen=True, kw_only=True)
class Fung(ShearLaw):
    """Isotropic exponential law of Fung and Demiray (Fung, Am. J. Physiol. 213, 1532, 1967; Demiray, J. Biomech. 5, 309, 1972).

    W = mu/(2b) [exp(b x) - 1] + lame / 2 (J - 1)^2,  x = I1 - 3 - 2 ln J,  shear modulus mu.

    From b x = 20, where it is 5e8, the exponential is continued by its parabola.

    Parameters
    ----------
    mu : float [Pa]
        Positive.
    b : float
        Rate of stiffening; positive.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.Fung(mu=2e3, b=5.0, density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (2000.0, 19333.333)
    """  # noqa: E501

    b: float = parameter(above=0.0)

    @staticmethod
    def energy(I1, I2, J, c):
        y = c[1] * (I1 - 3.0 - 2.0 * np.log(J))
        z = np.minimum(y, 20.0)
        return 0.5 * c[0] / c[1] * (np.exp(z) * (1.0 + (y - z) * (1.0 + 0.5 * (y - z))) - 1.0)

    @staticmethod
    def first(I1, I2, J, c):
        y = c[1] * (I1 - 3.0 - 2.0 * np.log(J))
        z = np.minimum(y, 20.0)
        f1 = 0.5 * c[0] * np.exp(z) * (1.0 + (y - z))
        return f1, 0.0, -2.0 * f1 / J

    @staticmethod
    def second(I1, I2, J, c):
        y = c[1] * (I1 - 3.0 - 2.0 * np.log(J))
        z = np.minimum(y, 20.0)
        rise = 0.5 * c[0] * np.exp(z)
        f1, f2 = rise * (1.0 + (y - z)), c[1] * rise
        return f2, 0.0, 0.0, -2.0 * f2 / J, 0.0, (4.0 * f2 + 2.0 * f1) / (J * J)


@dataclass(frozen=True, kw_only=True)
class StVenantKirchhoff(ShearLaw):
    """St. Venant-Kirchhoff law: Hooke's law of the Green strain E = (C - I) / 2 (Holzapfel, Nonlinear Solid Mechanics, 2000).

    W = mu tr E^2 + lame / 2 (J - 1)^2,  tr E^2 = (I1^2 - 2 I2 - 2 I1 + 3) / 4,  shear modulus mu.

    The bulk term is that of all laws here. The printed law has lame / 2 (tr E)^2, which is the same
    at small strain. Like the printed law it softens in compression, and loses stability below 0.58
    of the length along one axis.

    Parameters
    ----------
    mu : float [Pa]
        Positive.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.StVenantKirchhoff(mu=2e3, density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (2000.0, 19333.333)
    """  # noqa: E501

    @staticmethod
    def energy(I1, I2, J, c):
        return 0.25 * c[0] * ((I1 - 3.0) * (I1 + 1.0) - 2.0 * (I2 - 3.0))

    @staticmethod
    def first(I1, I2, J, c):
        return 0.5 * c[0] * (I1 - 1.0), -0.5 * c[0], 0.0

    @staticmethod
    def second(I1, I2, J, c):
        return 0.5 * c[0], 0.0, 0.0, 0.0, 0.0, 0.0
