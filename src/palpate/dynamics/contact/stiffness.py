"""Limits of a contact stiffness: symmetric, without negative eigenvalues, and at most that of the tissue, compiled."""

from __future__ import annotations

from palpate.compiled.eigenvectors import principal
from palpate.compiled.jit import kernel_njit


@kernel_njit(inner=True)
def limited_stiffness(xx, yy, zz, xy, xz, yz, largest):
    """Return the entries of a symmetric matrix [N/m] with eigenvalues from 0 to the largest.

    One within these limits is unchanged.
    """
    if largest == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    (a, b, c), n = principal(xx, yy, zz, xy, xz, yz)
    if min(a, b, c) >= 0.0 and max(a, b, c) <= largest:
        return xx, yy, zz, xy, xz, yz
    a, b, c = min(max(a, 0.0), largest), min(max(b, 0.0), largest), min(max(c, 0.0), largest)
    return (
        a * n[0] * n[0] + b * n[1] * n[1] + c * n[2] * n[2],
        a * n[3] * n[3] + b * n[4] * n[4] + c * n[5] * n[5],
        a * n[6] * n[6] + b * n[7] * n[7] + c * n[8] * n[8],
        a * n[0] * n[3] + b * n[1] * n[4] + c * n[2] * n[5],
        a * n[0] * n[6] + b * n[1] * n[7] + c * n[2] * n[8],
        a * n[3] * n[6] + b * n[4] * n[7] + c * n[5] * n[8],
    )


@kernel_njit(inner=True)
def limit_stiffness(rows, largest):
    """Replace a matrix, by its rows (3,) [N/m], by its symmetric part with eigenvalues from 0 to the largest."""
    x, y, z = rows
    xx, yy, zz, xy, xz, yz = limited_stiffness(
        x[0], y[1], z[2], 0.5 * (x[1] + y[0]), 0.5 * (x[2] + z[0]), 0.5 * (y[2] + z[1]), largest
    )
    x[0], x[1], x[2] = xx, xy, xz
    y[0], y[1], y[2] = xy, yy, yz
    z[0], z[1], z[2] = xz, yz, zz
