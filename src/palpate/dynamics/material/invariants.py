"""Tensors of a deformation gradient at a point, compiled: cof(F), C = F' F, and the invariants I1 and I2 of C.

F has nine numbers row by row, symmetric tensors have six in the order 00 11 22 01 02 12.
"""

from __future__ import annotations

from palpate.compiled.jit import kernel_njit


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def cofactor_of(F):
    """Return cof(F), row by row."""
    return (
        F[4] * F[8] - F[5] * F[7], F[5] * F[6] - F[3] * F[8], F[3] * F[7] - F[4] * F[6],
        F[2] * F[7] - F[1] * F[8], F[0] * F[8] - F[2] * F[6], F[1] * F[6] - F[0] * F[7],
        F[1] * F[5] - F[2] * F[4], F[2] * F[3] - F[0] * F[5], F[0] * F[4] - F[1] * F[3],
    )  # fmt: skip


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def right_cauchy_green(F):
    """Return C = F' F."""
    return (
        F[0] * F[0] + F[3] * F[3] + F[6] * F[6],
        F[1] * F[1] + F[4] * F[4] + F[7] * F[7],
        F[2] * F[2] + F[5] * F[5] + F[8] * F[8],
        F[0] * F[1] + F[3] * F[4] + F[6] * F[7],
        F[0] * F[2] + F[3] * F[5] + F[6] * F[8],
        F[1] * F[2] + F[4] * F[5] + F[7] * F[8],
    )


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def first_invariants(C):
    """Return I1 and I2 of C."""
    C00, C11, C22, C01, C02, C12 = C
    return C00 + C11 + C22, C00 * C11 + C00 * C22 + C11 * C22 - C01 * C01 - C02 * C02 - C12 * C12
