"""Small-strain linear elasticity, for comparison with finite strain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from palpate.tissue.materials import ShearLaw


@dataclass(frozen=True, kw_only=True)
class LinearElastic(ShearLaw):
    """Small-strain linear elasticity (Landau, Lifshitz, Theory of Elasticity, section 4).

    W = mu e : e + lame / 2 (tr e)^2,  e = sym(F - I),  P = dW/dF = 2 mu e + lame tr e I.

    The law is not objective: a rotation by an angle t strains the body by 1 - cos t. All other laws
    with these moduli reduce to it at small displacement gradients. The pressure is lame tr e and
    acts on undeformed areas.

    Parameters
    ----------
    mu : float [Pa]
        Shear modulus; positive.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.LinearElastic(mu=2e3, density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (2000.0, 19333.333)
    """

    variables: ClassVar[str] = "small strain"

    @staticmethod
    def energy(square, trace, volume, c):
        """Return W_s of e : e; the other two arguments complete the signature."""
        return c[0] * square

    @staticmethod
    def first(square, trace, volume, c):
        return c[0], 0.0, 0.0

    @staticmethod
    def second(square, trace, volume, c):
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0

    def shear_energy(self, F: NDArray[np.float64], coefficients: tuple[Any, ...] | None = None) -> NDArray[np.float64]:
        mu = (coefficients or self.coefficients)[0]
        return np.asarray(mu * np.sum(_strain(F) ** 2, axis=(-2, -1)))

    def shear_stress(self, F: NDArray[np.float64], coefficients: tuple[Any, ...] | None = None) -> NDArray[np.float64]:
        mu = np.asarray((coefficients or self.coefficients)[0])
        return np.asarray(2 * mu[..., None, None] * _strain(F))

    def cofactor(self, F: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.broadcast_to(np.eye(3), F.shape).copy()

    def _dilatation(self, F: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.trace(F, axis1=-2, axis2=-1) - 3)


def _strain(F: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((F + np.swapaxes(F, -1, -2)) / 2 - np.eye(3))
