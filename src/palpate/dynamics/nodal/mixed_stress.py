"""Tangent moduli of a body, with stresses of their own.

Newton's method on displacements alone takes short steps in nearly incompressible or slender bodies. A
linear step has second-order strains, and the law's stiff moduli turn these into large spurious stresses,
which the tangent contains. The mixed Newton method takes the stresses of the tangent from the linear
step itself (Magisano, Leonetti and Garcea, Comput. Methods Appl. Mech. Eng. 313, 2017). Residuals and
solutions do not change.

The stress is split as P = p cof F + F S, with the mean Cauchy stress p. Both p and S are extrapolated
linearly along a step. The moduli with the stresses p' and S' differ from those of the law by

    (p' - p) d(cof F)/dF + 1 x (S' - S).
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from palpate.core.arrays import Floats
from palpate.dynamics.nodal.coarse_grid import stress_free_points
from palpate.dynamics.nodal.equilibrium_residual import EquilibriumResidual

STRAIN_DIFFERENCE = 1e-5  # change of F for differences of stresses
DIFFERENCE_SPACINGS = 1e-6  # largest displacement for differences along a step, in spacings
LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


class SplitStress(NamedTuple):
    """Nodal stresses in two parts."""

    pressure: Floats  # (n,) array [Pa]: p, the mean Cauchy stress; zero in a sheet
    second: Floats  # (n, d, d) array [Pa]: s, the rest of the second Piola-Kirchhoff stress


def split_stress(equations: EquilibriumResidual, displacements: Floats) -> SplitStress:
    """Return the stresses of displacements (n, 3) [m] by the body's law."""
    F, P = equations.model.deformation_gradient(displacements), equations.stress(displacements)
    if F.shape[2] == 2:
        return SplitStress(np.zeros(len(F)), np.asarray(_left_inverse(F) @ P))
    J = np.linalg.det(F)
    pressure = np.sum(P * F, axis=(1, 2)) / (3 * J)
    inverse = np.linalg.inv(F)
    rest = P - (pressure * J)[:, None, None] * inverse.transpose(0, 2, 1)
    return SplitStress(pressure, np.asarray(inverse @ rest))


def _left_inverse(F: Floats) -> Floats:
    transposed = F.transpose(0, 2, 1)
    return np.asarray(np.linalg.inv(transposed @ F) @ transposed)


def extrapolated_stress(
    equations: EquilibriumResidual, displacements: Floats, present: SplitStress, step: Floats
) -> SplitStress:
    """Return the stresses after a step (n, 3) [m], linear in it."""
    scale = DIFFERENCE_SPACINGS * equations.model.cloud.spacing / max(float(np.abs(step).max()), 1e-300)
    ahead = split_stress(equations, displacements + scale * step)
    return SplitStress(*(now + (later - now) / scale for now, later in zip(present, ahead, strict=True)))


def tangent_moduli(equations: EquilibriumResidual, displacements: Floats) -> Floats:
    """Return the moduli dP_ck / dF_em (n, 3 d, 3 d) [Pa] by differences, rows d c + k and columns d e + m.

    An affine displacement changes F equally at all nodes, so 3 d of them yield all moduli.
    """
    points = stress_free_points(equations.model)
    n, d = points.shape
    arms = points - points.mean(axis=0)
    before = equations.stress(displacements).reshape(n, 3 * d)
    moduli = np.empty((n, 3 * d, 3 * d))
    for c, k in product(range(3), range(d)):
        field = np.zeros((n, 3))
        field[:, c] = STRAIN_DIFFERENCE * arms[:, k]
        moduli[:, :, d * c + k] = (
            equations.stress(displacements + field).reshape(n, 3 * d) - before
        ) / STRAIN_DIFFERENCE
    return moduli


def added_moduli(F: Floats, present: SplitStress, mixed: SplitStress) -> Floats:
    """Return the moduli (n, 3 d, 3 d) [Pa] with given stresses, minus those with the law's stresses."""
    n, _, d = F.shape
    second = mixed.second - present.second
    moduli = np.einsum("ab,nkl->nakbl", np.eye(3), (second + second.transpose(0, 2, 1)) / 2)
    if d == 3:
        slope = np.einsum("cab,kmn,ibn->ickam", LEVI_CIVITA, LEVI_CIVITA, F, optimize=True)  # d(cof F)/dF
        moduli = moduli + (mixed.pressure - present.pressure)[:, None, None, None, None] * slope
    return np.asarray(moduli.reshape(n, 3 * d, 3 * d))
