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
    (a, b, c), n = principal(matrix[0, 0], matrix[1, 1], matrix[2, 2], matrix[0, 1], matrix[0, 2], matrix[1, 2])
    _change_eigenvalue(matrix, a, largest, n[0], n[3], n[6])
    _change_eigenvalue(matrix, b, largest, n[1], n[4], n[7])
    _change_eigenvalue(matrix, c, largest, n[2], n[5], n[8])


@kernel_njit(inner=True)
def _change_eigenvalue(matrix, value, largest, x, y, z):
    """Limit an eigenvalue of a symmetric matrix, with its eigenvector, to the interval from 0 to the largest."""
    change = min(max(value, 0.0), largest) - value
    if change == 0.0:
        return
    matrix[0, 0] += change * x * x
    matrix[1, 1] += change * y * y
    matrix[2, 2] += change * z * z
    matrix[0, 1] += change * x * y
    matrix[0, 2] += change * x * z
    matrix[1, 2] += change * y * z
    matrix[1, 0], matrix[2, 0], matrix[2, 1] = matrix[0, 1], matrix[0, 2], matrix[1, 2]
