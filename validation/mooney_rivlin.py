"""Compressible Mooney-Rivlin material for FElupe, with explicit stress and elasticity.

All quantities are in SI units.
"""

import numpy as np

SHEAR_1, SHEAR_2 = 60e3, 1.2e3  # Pa


class MooneyRivlin:
    """Part of the compressible Mooney-Rivlin energy, as a FElupe material.

    W = c1/2 (I1 - 3) + c2/2 (I2 - 3) - (c1 + 2 c2) ln J + lam/2 (J - 1)^2.

    Parameters
    ----------
    c1, c2, lam : float
        Coefficients of the energy [Pa].
    """

    def __init__(self, c1=0.0, c2=0.0, lam=0.0):
        self.c1, self.c2, self.lam = c1, c2, lam
        self.x = [np.eye(3), np.zeros(0)]  # shapes of the variables, read by FElupe

    def energy(self, F):
        """Return the energy density [J/m^3] at F of shape (3, 3, ...)."""
        C = np.einsum("kI...,kJ...->IJ...", F, F)
        J = np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1)))
        if np.any(J <= 0):
            return np.full_like(J, np.nan)
        I1 = np.einsum("II...->...", C)
        I2 = (I1**2 - np.einsum("IJ...,IJ...->...", C, C)) / 2
        isochoric = self.c1 / 2 * (I1 - 3) + self.c2 / 2 * (I2 - 3)
        return isochoric - (self.c1 + 2 * self.c2) * np.log(J) + self.lam / 2 * (J - 1) ** 2

    def _volumetric(self, F):
        """Return F^-T, J, and J dw/dJ [Pa] of the terms which depend on J only."""
        matrix = np.moveaxis(F, (0, 1), (-2, -1))
        J = np.linalg.det(matrix)
        cofactor = np.moveaxis(np.linalg.inv(matrix), (-2, -1), (1, 0))
        return cofactor, J, self.lam * J * (J - 1) - (self.c1 + 2 * self.c2)

    def gradient(self, x):
        """Return [P, statevars], P = dW/dF the first Piola-Kirchhoff stress [Pa]."""
        F = x[0]
        G, _, pressure = self._volumetric(F)
        C = np.einsum("kI...,kJ...->IJ...", F, F)
        I1 = np.einsum("II...->...", C)
        P = (self.c1 + self.c2 * I1) * F + pressure * G
        if self.c2:
            P = P - self.c2 * np.einsum("iK...,KJ...->iJ...", F, C)
        return [P, x[-1]]

    def hessian(self, x):
        """Return [A], A_iJkL = d2W / dF_iJ dF_kL [Pa]."""
        F = x[0]
        G, J, pressure = self._volumetric(F)
        A = (self.lam * J * (2 * J - 1)) * np.einsum("iJ...,kL...->iJkL...", G, G)
        A -= pressure * np.einsum("iL...,kJ...->iJkL...", G, G)
        if not self.c1 and not self.c2:
            return [A]
        C = np.einsum("kI...,kJ...->IJ...", F, F)
        B = np.einsum("iK...,kK...->ik...", F, F)
        diagonal = self.c1 + self.c2 * np.einsum("II...->...", C)
        A += self.c2 * (2 * np.einsum("iJ...,kL...->iJkL...", F, F) - np.einsum("iL...,kJ...->iJkL...", F, F))
        for i in range(3):
            A[i, :, i, :] -= self.c2 * C
            A[:, i, :, i] -= self.c2 * B
            for j in range(3):
                A[i, j, i, j] += diagonal
        return [A]


def check_material(step=1e-6, tolerance=1e-6):
    """Compare stress and elasticity with central differences at a random state."""
    material = MooneyRivlin(SHEAR_1, SHEAR_2, 1e6)
    F = np.eye(3) + 0.3 * np.random.default_rng(1).uniform(-1, 1, (3, 3))
    stress = np.zeros((3, 3))
    elasticity = np.zeros((3, 3, 3, 3))
    for k, L in np.ndindex(3, 3):
        d = np.zeros((3, 3))
        d[k, L] = step
        stress[k, L] = (material.energy(F + d) - material.energy(F - d)) / (2 * step)
        plus, minus = (material.gradient([F + s * d, None])[0] for s in (1, -1))
        elasticity[:, :, k, L] = (plus - minus) / (2 * step)
    for name, found, expected in (
        ("stress", material.gradient([F, None])[0], stress),
        ("elasticity", material.hessian([F, None])[0], elasticity),
    ):
        error = abs(found - expected).max() / abs(expected).max()
        print(f"{name}: relative error to finite differences {error:.1e}", flush=True)
        if error > tolerance:
            raise RuntimeError(f"{name} disagrees with finite differences")


def first_lame(poisson):
    """Return lam [Pa] from kappa = lam + 2/3 mu + 2 c2 and the Poisson ratio."""
    mu = SHEAR_1 + SHEAR_2
    kappa = 2 * mu * (1 + poisson) / (3 * (1 - 2 * poisson))
    return kappa - 2 / 3 * mu - 2 * SHEAR_2
