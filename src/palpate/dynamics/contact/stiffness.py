"""Limits of a contact stiffness: symmetric, without negative eigenvalues, and at most that of the tissue, compiled."""

from __future__ import annotations

from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.material.principal_stretches import principal


@kernel_njit(inner=True)
def limit_stiffness(matrix, largest):
    """Replace a matrix (3, 3) [N/m] by its symmetric part with eigenvalues from 0 to the largest.

    A symmetric matrix within these limits is unchanged.
    """
    if largest == 0.0:
        matrix[:] = 0.0
        return
    for i in range(3):
        for j in range(i):
            mean = 0.5 * (matrix[i, j] + matrix[j, i])
            matrix[i, j], matrix[j, i] = mean, mean
    values, n = principal(matrix[0, 0], matrix[1, 1], matrix[2, 2], matrix[0, 1], matrix[0, 2], matrix[1, 2])
    if min(values) >= 0.0 and max(values) <= largest:
        return
    matrix[:] = 0.0
    _add_eigenvalue(matrix, min(max(values[0], 0.0), largest), n[0], n[3], n[6])
    _add_eigenvalue(matrix, min(max(values[1], 0.0), largest), n[1], n[4], n[7])
    _add_eigenvalue(matrix, min(max(values[2], 0.0), largest), n[2], n[5], n[8])


@kernel_njit(inner=True)
def _add_eigenvalue(matrix, value, x, y, z):
    """Add an eigenvalue with its eigenvector to a symmetric matrix."""
    matrix[0, 0] += value * x * x
    matrix[1, 1] += value * y * y
    matrix[2, 2] += value * z * z
    matrix[0, 1] += value * x * y
    matrix[0, 2] += value * x * z
    matrix[1, 2] += value * y * z
    matrix[1, 0], matrix[2, 0], matrix[2, 1] = matrix[0, 1], matrix[0, 2], matrix[1, 2]
