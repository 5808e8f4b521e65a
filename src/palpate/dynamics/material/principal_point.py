"""The compiled stress and energy of one point for laws of the principal stretches, also if inverted.

Sampled bodies require an energy for crushed and inverted states. With l1 and l2 the two largest
stretches and J = det F the law is W_s(l1, l2, J / (l1 l2)). Below J = c it continues as a parabola in J,

    E = W + S (J - c) + R/2 (J - c)^2,   W and S = dW/dJ at (l1, l2, c),   R = d2W/dJ2 at (1, 1, c),

which is bounded from below for every sign of J. The stress is the derivative of that energy,

    P = sum over a = 1, 2 of (dE/dl_a) / l_a F N_a N_a^T + dE/dJ cof(F),

without division by the smallest stretch.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.compiled.eigenvectors import principal
from palpate.compiled.jit import inline, kernel_njit, law_njit
from palpate.dynamics.material.invariants import cofactor_of, right_cauchy_green
from palpate.dynamics.material.principal_stretches import make_principal_stress


def make_principal_point(
    digest: str, energy_of: Any, law_first: Any, law_second: Any, crushed: float
) -> tuple[Any, Any]:
    """Compile the stress and the energy of a point, for the functions of a `palpate.tissue.stretch_laws.StretchLaw`.

    Both take F - I (nine numbers, row by row) and the coefficients. The stress returns P, cof(F) and J - 1; the density
    E [J/m^3] and J - 1. `crushed` is the volume ratio c.
    """
    energy, first_of, second_of = (inline(digest, f) for f in (energy_of, law_first, law_second))
    regular_stress = make_principal_stress(digest, law_first)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def slopes(l1, l2, J, coefficients):
        """Return dE/dl1, dE/dl2 and dE/dJ of a crushed point."""
        l3 = crushed / (l1 * l2)
        w1, w2, w3 = first_of(l1, l2, l3, coefficients)
        _, _, w33, _, w13, w23 = second_of(l1, l2, l3, coefficients)
        area, below = l1 * l2, J - crushed
        S1 = (w13 - (w33 * l3 + w3) / l1) / area
        S2 = (w23 - (w33 * l3 + w3) / l2) / area
        _, _, R, _, _, _ = second_of(1.0, 1.0, crushed, coefficients)
        return w1 - w3 * l3 / l1 + S1 * below, w2 - w3 * l3 / l2 + S2 * below, w3 / area + R * below

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"}, forceinline=True)
    def crushed_stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        F = 1.0 + d0, d1, d2, d3, 1.0 + d4, d5, d6, d7, 1.0 + d8
        c = cofactor_of(F)
        J = F[0] * c[0] + F[1] * c[1] + F[2] * c[2]
        l1, l2, n, m = _two_largest(F)
        e1, e2, eJ = slopes(l1, l2, J, coefficients)
        return _stress_of_two(F, c, n, m, e1 / l1, e2 / l2, eJ), c, J - 1.0

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        F = 1.0 + d0, d1, d2, d3, 1.0 + d4, d5, d6, d7, 1.0 + d8
        c = cofactor_of(F)
        if F[0] * c[0] + F[1] * c[1] + F[2] * c[2] < crushed:
            return crushed_stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients)
        return regular_stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients)

    @law_njit(digest, cached=False, fastmath={"contract"})
    def density(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        F = 1.0 + d0, d1, d2, d3, 1.0 + d4, d5, d6, d7, 1.0 + d8
        c = cofactor_of(F)
        J = F[0] * c[0] + F[1] * c[1] + F[2] * c[2]
        l1, l2, _, _ = _two_largest(F)
        E = energy(l1, l2, max(J, crushed) / (l1 * l2), coefficients)
        below = J - crushed
        if below < 0.0:
            _, _, slope = slopes(l1, l2, crushed, coefficients)
            _, _, R, _, _, _ = second_of(1.0, 1.0, crushed, coefficients)
            E += (slope + 0.5 * R * below) * below
        return E, J - 1.0

    return stress, density


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _two_largest(F):
    """Return the two largest stretches, at least a thousandth, and their directions."""
    x, n = principal(*right_cauchy_green(F))
    a, b, c = (n[0], n[3], n[6]), (n[1], n[4], n[7]), (n[2], n[5], n[8])
    if x[0] <= x[1] and x[0] <= x[2]:
        y, z, first, second = x[1], x[2], b, c
    elif x[1] <= x[2]:
        y, z, first, second = x[0], x[2], a, c
    else:
        y, z, first, second = x[0], x[1], a, b
    return np.sqrt(max(y, 1e-6)), np.sqrt(max(z, 1e-6)), first, second


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _stress_of_two(F, c, n, m, g, h, eJ):
    """Return g F n n' + h F m m' + eJ c, row by row."""
    S00, S11 = g * n[0] * n[0] + h * m[0] * m[0], g * n[1] * n[1] + h * m[1] * m[1]
    S22, S01 = g * n[2] * n[2] + h * m[2] * m[2], g * n[0] * n[1] + h * m[0] * m[1]
    S02, S12 = g * n[0] * n[2] + h * m[0] * m[2], g * n[1] * n[2] + h * m[1] * m[2]
    return (
        F[0] * S00 + F[1] * S01 + F[2] * S02 + eJ * c[0],
        F[0] * S01 + F[1] * S11 + F[2] * S12 + eJ * c[1],
        F[0] * S02 + F[1] * S12 + F[2] * S22 + eJ * c[2],
        F[3] * S00 + F[4] * S01 + F[5] * S02 + eJ * c[3],
        F[3] * S01 + F[4] * S11 + F[5] * S12 + eJ * c[4],
        F[3] * S02 + F[4] * S12 + F[5] * S22 + eJ * c[5],
        F[6] * S00 + F[7] * S01 + F[8] * S02 + eJ * c[6],
        F[6] * S01 + F[7] * S11 + F[8] * S12 + eJ * c[7],
        F[6] * S02 + F[7] * S12 + F[8] * S22 + eJ * c[8],
    )
