"""The compiled stresses of a membrane with a law of the principal stretches.

With l3 = 1 / (l1 l2) the law is w(l1, l2) = W(l1, l2, l3), in a wrinkled state w(l1) = W(l1, m, m) with the width
m = l1^(-1/2) of simple tension. The second Piola-Kirchhoff stress has the principal values s_a = (dw/dl_a) / l_a, so

    P = F (s1 N1 N1^T + s2 N2 N2^T) = a F + g F adj(C),    g = -(s1 - s2) / (x1 - x2),    a = s1 - g x2,

x_a = l_a^2 the eigenvalues of C, x1 the larger.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.compiled.jit import inline, kernel_njit, law_njit
from palpate.dynamics.material.principal_stretches import EQUAL_STRETCH_TOLERANCE

MIN_SQUARE_GAP = 1e-30  # least difference of squared stretches in quotients, whose numerators vanish too


def make_principal_moduli(digest: str, energy_of: Any, law_first: Any, law_second: Any, relaxed: bool) -> Any:
    """Compile the function of C for energy, a and g (`make_moduli`) of a law of the stretches."""
    energy, first_of = (inline(digest, f) for f in (energy_of, law_first))
    plane = _make_slopes(digest, law_first, law_second)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def moduli(C00, C11, C01, coefficients):
        mean, radius = 0.5 * (C00 + C11), np.sqrt(0.25 * (C00 - C11) ** 2 + C01 * C01)
        x1, x2 = mean + radius, mean - radius
        if relaxed:
            l1 = np.sqrt(max(x1, 1.0))
            m = 1.0 / np.sqrt(l1)
            if x2 < m * m:
                w1, w2, _ = first_of(l1, m, m, coefficients)
                h = (w1 - w2 * m / l1) / (l1 * max(x1 - x2, MIN_SQUARE_GAP))
                return energy(l1, m, m, coefficients), h * x1, -h
        l1, l2 = np.sqrt(x1), np.sqrt(x2)
        l3 = 1.0 / (l1 * l2)
        w1, w2, w3 = first_of(l1, l2, l3, coefficients)
        s1, s2 = (w1 - w3 * l3 / l1) / l1, (w2 - w3 * l3 / l2) / l2
        if x1 - x2 <= EQUAL_STRETCH_TOLERANCE * mean:
            _, _, s11, s22, s12 = plane(l1, l2, coefficients)
            g = s12 - 0.5 * (s11 + s22)
        else:
            g = (s2 - s1) / (x1 - x2)
        return energy(l1, l2, l3, coefficients), s1 - g * x2, g

    return moduli


def _make_slopes(digest: str, law_first: Any, law_second: Any) -> Any:
    """Compile the derivatives of the stress by the squared stretches."""
    first_of, second_of = (inline(digest, f) for f in (law_first, law_second))

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def plane(l1, l2, coefficients):
        """Return s1, s2, then ds1/dx1, ds2/dx2, ds1/dx2."""
        l3 = 1.0 / (l1 * l2)
        w1, w2, w3 = first_of(l1, l2, l3, coefficients)
        w11, w22, w33, w12, w13, w23 = second_of(l1, l2, l3, coefficients)
        k1, k2 = l3 / l1, l3 / l2  # minus the derivatives of l3
        s1, s2 = (w1 - w3 * k1) / l1, (w2 - w3 * k2) / l2
        t1 = w11 - 2.0 * w13 * k1 + w33 * k1 * k1 + 2.0 * w3 * k1 / l1
        t2 = w22 - 2.0 * w23 * k2 + w33 * k2 * k2 + 2.0 * w3 * k2 / l2
        t12 = w12 - w13 * k2 - w23 * k1 + w33 * k1 * k2 + w3 * l3 * l3
        return s1, s2, 0.5 * (t1 - s1) / (l1 * l1), 0.5 * (t2 - s2) / (l2 * l2), 0.5 * t12 * l3

    return plane


@kernel_njit(fastmath={"contract"}, forceinline=True)
def axes(C00, C11, C01):
    """Return the eigenvalues of C, the larger first, and the direction (p, q) of the larger one."""
    mean, gap = 0.5 * (C00 + C11), 0.5 * (C00 - C11)
    radius = np.sqrt(gap * gap + C01 * C01)
    p, q = (gap + radius, C01) if gap >= 0.0 else (C01, radius - gap)
    size = np.sqrt(p * p + q * q)
    if size == 0.0:
        return mean, mean, 1.0, 0.0
    return mean + radius, mean - radius, p / size, q / size
