"""The compiled stresses of a membrane with a law of the principal stretches.

With l3 = 1 / (l1 l2) the law is w(l1, l2) = W(l1, l2, l3), in a wrinkled state w(l1) = W(l1, m, m) with the width
m = l1^(-1/2) of simple tension. The second Piola-Kirchhoff stress has the principal values s_a = (dw/dl_a) / l_a, so

    P = F (s1 N1 N1^T + s2 N2 N2^T) = a F + g F adj(C),    g = -(s1 - s2) / (x1 - x2),    a = s1 - g x2,

x_a = l_a^2 the eigenvalues of C, x1 the larger.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.dynamics.compiled.cache import inline, kernel_njit, law_njit
from palpate.dynamics.compiled.lanes import LANES
from palpate.dynamics.material.principal_stretches import EQUAL_STRETCH_TOLERANCE

__all__ = ["axes", "make_principal_moduli", "make_principal_strong"]

MIN_SQUARE_GAP = 1e-30  # least difference of squared stretches in quotients, whose numerators vanish too


def make_principal_moduli(digest: str, energy_of: Any, law_first: Any, law_second: Any, relaxed: bool) -> Any:
    """Compile the function of C for energy, a and g (`make_moduli`) of a law of the stretches."""
    energy, first_of = (inline(digest, f) for f in (energy_of, law_first))
    plane, _ = _make_slopes(digest, law_first, law_second)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def moduli(C00, C11, C01, coefficients):  # type: ignore[no-untyped-def]
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


def _make_slopes(digest: str, law_first: Any, law_second: Any) -> tuple[Any, Any]:
    """Compile the derivatives of the stress by the squared stretches, for taut and wrinkled states."""
    first_of, second_of = (inline(digest, f) for f in (law_first, law_second))

    @law_njit(digest, cached=False, fastmath={"contract"})
    def plane(l1, l2, coefficients):  # type: ignore[no-untyped-def]
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

    @law_njit(digest, cached=False, fastmath={"contract"})
    def wrinkled(l1, coefficients):  # type: ignore[no-untyped-def]
        """Return s1 and ds1/dx1 of a state in simple tension."""
        m = 1.0 / np.sqrt(l1)
        k = m / l1
        w1, w2, _ = first_of(l1, m, m, coefficients)
        w11, w22, _, w12, _, w23 = second_of(l1, m, m, coefficients)
        s1 = (w1 - w2 * k) / l1
        t1 = w11 - 2.0 * w12 * k + 0.5 * k * k * (w22 + w23) + 1.5 * w2 * k / l1
        return s1, 0.5 * (t1 - s1) / (l1 * l1)

    return plane, wrinkled


def make_principal_strong(digest: str, law_first: Any, law_second: Any, moduli: Any, relaxed: bool, normal: Any) -> Any:
    """Compile the strong form's response of one block, Div P - P b from F and H, in the principal axes of C.

    Div P = sum of s_a H_aa + F_a v_a over two axes (`palpate.dynamics.material.principal_stretches`).
    """
    plane, wrinkled = _make_slopes(digest, law_first, law_second)

    @law_njit(digest, cached=False, fastmath={"contract"})
    def slopes(x1, x2, coefficients):  # type: ignore[no-untyped-def]
        """Return s1, s2, ds1/dx1, ds2/dx2, ds1/dx2 and (s1 - s2) / (x1 - x2)."""
        if relaxed:
            l1 = np.sqrt(max(x1, 1.0))
            if x2 < 1.0 / l1:
                s1, s11 = wrinkled(l1, coefficients)
                return s1, 0.0, s11 if x1 > 1.0 else 0.0, 0.0, 0.0, s1 / max(x1 - x2, MIN_SQUARE_GAP)
        s1, s2, s11, s22, s12 = plane(np.sqrt(x1), np.sqrt(x2), coefficients)
        if x1 - x2 <= 0.5 * EQUAL_STRETCH_TOLERANCE * (x1 + x2):
            return s1, s2, s11, s22, s12, 0.5 * (s11 + s22) - s12
        return s1, s2, s11, s22, s12, (s1 - s2) / (x1 - x2)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def node_response(b, nodes, d, boundary, radius, coefficients, prestretch, extras, cofactor, flux, energy):  # type: ignore[no-untyped-def]
        for v in range(LANES):
            i = nodes[b, v]
            C00, C11, C01 = 0.0, 0.0, 0.0
            for c in range(3):
                F0 = d[2 * c, v] + (prestretch if c == 0 else 0.0)
                F1 = d[2 * c + 1, v] + (prestretch if c == 1 else 0.0)
                C00, C11, C01 = C00 + F0 * F0, C11 + F1 * F1, C01 + F0 * F1
            energy[i] = moduli(C00, C11, C01, coefficients)[0]
            x1, x2, p, q = axes(C00, C11, C01)
            s1, s2, s11, s22, s12, k = slopes(x1, x2, coefficients)
            b0, b1 = boundary[b, 0, v], boundary[b, 1, v]
            v1, v2 = -s1 * (p * b0 + q * b1), -s2 * (p * b1 - q * b0)
            for c in range(3):
                f1, f2, h11, h22, h12 = _in_principal_axes(c, v, d, prestretch, p, q)
                flux[i, c, 0] = s1 * h11 + s2 * h22
                v1 += 2.0 * (s11 * f1 * h11 + s12 * f2 * h12) + k * (h12 * f2 + f1 * h22)
                v2 += 2.0 * (s12 * f1 * h12 + s22 * f2 * h22) + k * (h12 * f1 + f2 * h11)
            for c in range(3):
                f1, f2, _, _, _ = _in_principal_axes(c, v, d, prestretch, p, q)
                flux[i, c, 0] += f1 * v1 + f2 * v2
            normal(b, v, d, prestretch, cofactor)

    return node_response


@kernel_njit(forceinline=True)
def axes(C00, C11, C01):  # type: ignore[no-untyped-def]
    """Return the eigenvalues of C, the larger first, and the direction (p, q) of the larger one."""
    mean, gap = 0.5 * (C00 + C11), 0.5 * (C00 - C11)
    radius = np.sqrt(gap * gap + C01 * C01)
    p, q = (gap + radius, C01) if gap >= 0.0 else (C01, radius - gap)
    size = np.sqrt(p * p + q * q)
    if size == 0.0:
        return mean, mean, 1.0, 0.0
    return mean + radius, mean - radius, p / size, q / size


@kernel_njit(inner=True, forceinline=True)
def _in_principal_axes(c, v, d, prestretch, p, q):  # type: ignore[no-untyped-def]
    """Return component c of F and of the second derivatives 11, 22 and 12 of a lane in the principal axes."""
    F0 = d[2 * c, v] + (prestretch if c == 0 else 0.0)
    F1 = d[2 * c + 1, v] + (prestretch if c == 1 else 0.0)
    H00, H11, H01 = d[6 + 3 * c, v], d[7 + 3 * c, v], d[8 + 3 * c, v]
    h11 = p * p * H00 + q * q * H11 + 2.0 * p * q * H01
    h22 = q * q * H00 + p * p * H11 - 2.0 * p * q * H01
    h12 = p * q * (H11 - H00) + (p * p - q * q) * H01
    return p * F0 + q * F1, p * F1 - q * F0, h11, h22, h12
