"""The compiled stress of laws of the principal stretches, by the eigenvectors of C."""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.compiled.eigenvectors import principal
from palpate.compiled.jit import inline, kernel_njit, law_njit
from palpate.compiled.lanes import LANES

EQUAL_STRETCH_TOLERANCE = 1e-5  # relative difference of squared stretches below which quotients use their limit


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _quotient(x, y, s, t, slope):
    """Return (s - t) / (x - y), or its limit `slope` for equal x and y."""
    near = abs(x - y) <= EQUAL_STRETCH_TOLERANCE * (x + y)
    return slope if near else (s - t) / (1.0 if near else x - y)


def make_principal_stress(digest: str, law_first: Any) -> Any:
    """Compile the shear stress of one point for a law of the stretches, as `energy_form.make_stress`."""
    first_of = inline(digest, law_first)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        F00, F01, F02, F10, F11, F12, F20, F21, F22 = 1.0 + d0, d1, d2, d3, 1.0 + d4, d5, d6, d7, 1.0 + d8
        c00, c01, c02 = F11 * F22 - F12 * F21, F12 * F20 - F10 * F22, F10 * F21 - F11 * F20
        c10, c11, c12 = F02 * F21 - F01 * F22, F00 * F22 - F02 * F20, F01 * F20 - F00 * F21
        c20, c21, c22 = F01 * F12 - F02 * F11, F02 * F10 - F00 * F12, F00 * F11 - F01 * F10
        J = F00 * c00 + F01 * c01 + F02 * c02
        (x0, x1, x2), (n00, n01, n02, n10, n11, n12, n20, n21, n22) = principal(
            F00 * F00 + F10 * F10 + F20 * F20,
            F01 * F01 + F11 * F11 + F21 * F21,
            F02 * F02 + F12 * F12 + F22 * F22,
            F00 * F01 + F10 * F11 + F20 * F21,
            F00 * F02 + F10 * F12 + F20 * F22,
            F01 * F02 + F11 * F12 + F21 * F22,
        )
        l0, l1, l2 = np.sqrt(x0), np.sqrt(x1), np.sqrt(x2)
        w0, w1, w2 = first_of(l0, l1, l2, coefficients)
        s0, s1, s2 = w0 / l0, w1 / l1, w2 / l2
        S00, S01 = s0 * n00 * n00 + s1 * n01 * n01 + s2 * n02 * n02, s0 * n00 * n10 + s1 * n01 * n11 + s2 * n02 * n12
        S11, S02 = s0 * n10 * n10 + s1 * n11 * n11 + s2 * n12 * n12, s0 * n00 * n20 + s1 * n01 * n21 + s2 * n02 * n22
        S22, S12 = s0 * n20 * n20 + s1 * n21 * n21 + s2 * n22 * n22, s0 * n10 * n20 + s1 * n11 * n21 + s2 * n12 * n22
        P = (
            F00 * S00 + F01 * S01 + F02 * S02, F00 * S01 + F01 * S11 + F02 * S12, F00 * S02 + F01 * S12 + F02 * S22,
            F10 * S00 + F11 * S01 + F12 * S02, F10 * S01 + F11 * S11 + F12 * S12, F10 * S02 + F11 * S12 + F12 * S22,
            F20 * S00 + F21 * S01 + F22 * S02, F20 * S01 + F21 * S11 + F22 * S12, F20 * S02 + F21 * S12 + F22 * S22,
        )  # fmt: skip
        return P, (c00, c01, c02, c10, c11, c12, c20, c21, c22), J - 1.0

    return stress


def make_principal_response(digest: str, law_first: Any, law_second: Any, volume: Any) -> Any:
    """Compile the response of one block for a law of the stretches, as in `strong_form`.

    In the principal axes N of C, where S is diagonal, column a of P and its divergence are

        P_a = s_a F_a,   Div P = sum of s_a H_aa + F_a v_a,
        v_a = sum over j of ds_a/dx_j G_jj,a + sum over b of g_ab G_ab,b,

    with G_ij,b = dC_ij/dX_b and the quotients g = (s_a - s_b)/(x_a - x_b). The law is called in a
    separate loop because of its powers and logarithms; the other loops are vectorised.
    """
    slopes = _make_slopes(digest, law_first, law_second)

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"}, forceinline=True)
    def respond(b, nodes, d, boundary, coefficients, lame, cofactor, shear, pressure):
        axes, squares = cofactor[b], shear[b]
        for v in range(LANES):
            _principal_axes(v, d, axes, squares)
        for v in range(LANES):
            slopes(v, squares, d, coefficients)
        for v in range(LANES):
            _divergence(b, v, d, boundary, axes, squares)
        for v in range(LANES):
            d[0, v] = _cofactor(v, d, axes)
        for v in range(LANES):
            pressure[nodes[b, v]] = lame * volume(d[0, v])[0]

    return respond


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _principal_axes(v, d, axes, squares):
    """Write the principal axes (9) and squared stretches (3) of a lane."""
    F00, F01, F02 = 1.0 + d[0, v], d[1, v], d[2, v]
    F10, F11, F12 = d[3, v], 1.0 + d[4, v], d[5, v]
    F20, F21, F22 = d[6, v], d[7, v], 1.0 + d[8, v]
    x, n = principal(
        F00 * F00 + F10 * F10 + F20 * F20,
        F01 * F01 + F11 * F11 + F21 * F21,
        F02 * F02 + F12 * F12 + F22 * F22,
        F00 * F01 + F10 * F11 + F20 * F21,
        F00 * F02 + F10 * F12 + F20 * F22,
        F01 * F02 + F11 * F12 + F21 * F22,
    )
    squares[0, v], squares[1, v], squares[2, v] = x[0], x[1], x[2]
    axes[0, v], axes[1, v], axes[2, v] = n[0], n[1], n[2]
    axes[3, v], axes[4, v], axes[5, v] = n[3], n[4], n[5]
    axes[6, v], axes[7, v], axes[8, v] = n[6], n[7], n[8]


def _make_slopes(digest: str, law_first: Any, law_second: Any) -> Any:
    """Compile the function that writes s_a, ds_a/dx_b and the quotients of a lane into rows 27 to 38."""
    first_of, second_of = (inline(digest, f) for f in (law_first, law_second))

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def slopes(v, squares, d, coefficients):
        x0, x1, x2 = squares[0, v], squares[1, v], squares[2, v]
        l0, l1, l2 = np.sqrt(x0), np.sqrt(x1), np.sqrt(x2)
        w0, w1, w2 = first_of(l0, l1, l2, coefficients)
        w00, w11, w22, w01, w02, w12 = second_of(l0, l1, l2, coefficients)
        s0, s1, s2 = w0 / l0, w1 / l1, w2 / l2
        s00, s11, s22 = 0.5 * (w00 - s0) / x0, 0.5 * (w11 - s1) / x1, 0.5 * (w22 - s2) / x2
        s01, s02, s12 = 0.5 * w01 / (l0 * l1), 0.5 * w02 / (l0 * l2), 0.5 * w12 / (l1 * l2)
        d[27, v], d[28, v], d[29, v] = s0, s1, s2
        d[30, v], d[31, v], d[32, v], d[33, v], d[34, v], d[35, v] = s00, s11, s22, s01, s02, s12
        d[36, v] = _quotient(x0, x1, s0, s1, 0.5 * (s00 + s11) - s01)
        d[37, v] = _quotient(x0, x2, s0, s2, 0.5 * (s00 + s22) - s02)
        d[38, v] = _quotient(x1, x2, s1, s2, 0.5 * (s11 + s22) - s12)

    return slopes


@kernel_njit(fastmath={"contract"}, forceinline=True)
def _divergence(b, v, d, boundary, axes, force):
    """Write Div P - P b of a lane from the results of `_principal_axes` and the slopes."""
    n00, n01, n02 = axes[0, v], axes[1, v], axes[2, v]
    n10, n11, n12 = axes[3, v], axes[4, v], axes[5, v]
    n20, n21, n22 = axes[6, v], axes[7, v], axes[8, v]
    s0, s1, s2 = d[27, v], d[28, v], d[29, v]
    s00, s11, s22, s01, s02, s12 = d[30, v], d[31, v], d[32, v], d[33, v], d[34, v], d[35, v]
    g01, g02, g12 = d[36, v], d[37, v], d[38, v]
    b0, b1, b2 = boundary[b, 0, v], boundary[b, 1, v], boundary[b, 2, v]
    v0 = -s0 * (n00 * b0 + n10 * b1 + n20 * b2)
    v1 = -s1 * (n01 * b0 + n11 * b1 + n21 * b2)
    v2 = -s2 * (n02 * b0 + n12 * b1 + n22 * b2)
    for c in range(3):
        F0 = d[3 * c, v] + (1.0 if c == 0 else 0.0)
        F1 = d[3 * c + 1, v] + (1.0 if c == 1 else 0.0)
        F2 = d[3 * c + 2, v] + (1.0 if c == 2 else 0.0)
        f0, f1, f2 = F0 * n00 + F1 * n10 + F2 * n20, F0 * n01 + F1 * n11 + F2 * n21, F0 * n02 + F1 * n12 + F2 * n22
        h00, h11, h22, h01, h02, h12 = _in_principal_axes(c, v, d, axes)
        force[c, v] = s0 * h00 + s1 * h11 + s2 * h22
        v0 += 2.0 * (s00 * f0 * h00 + s01 * f1 * h01 + s02 * f2 * h02)
        v1 += 2.0 * (s01 * f0 * h01 + s11 * f1 * h11 + s12 * f2 * h12)
        v2 += 2.0 * (s02 * f0 * h02 + s12 * f1 * h12 + s22 * f2 * h22)
        v0 += g01 * (h01 * f1 + f0 * h11) + g02 * (h02 * f2 + f0 * h22)
        v1 += g01 * (h01 * f0 + f1 * h00) + g12 * (h12 * f2 + f1 * h22)
        v2 += g02 * (h02 * f0 + f2 * h00) + g12 * (h12 * f1 + f2 * h11)
    y0, y1, y2 = n00 * v0 + n01 * v1 + n02 * v2, n10 * v0 + n11 * v1 + n12 * v2, n20 * v0 + n21 * v1 + n22 * v2
    force[0, v] += (1.0 + d[0, v]) * y0 + d[1, v] * y1 + d[2, v] * y2
    force[1, v] += d[3, v] * y0 + (1.0 + d[4, v]) * y1 + d[5, v] * y2
    force[2, v] += d[6, v] * y0 + d[7, v] * y1 + (1.0 + d[8, v]) * y2


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _in_principal_axes(c, v, d, axes):
    """Return the second derivatives of component c of a lane in the principal axes, 00 11 22 01 02 12."""
    n00, n01, n02 = axes[0, v], axes[1, v], axes[2, v]
    n10, n11, n12 = axes[3, v], axes[4, v], axes[5, v]
    n20, n21, n22 = axes[6, v], axes[7, v], axes[8, v]
    k = 9 + 6 * c
    p0, p1, p2, p3, p4, p5 = d[k, v], d[k + 1, v], d[k + 2, v], d[k + 3, v], d[k + 4, v], d[k + 5, v]
    a0, a1, a2 = p0 * n00 + p3 * n10 + p4 * n20, p3 * n00 + p1 * n10 + p5 * n20, p4 * n00 + p5 * n10 + p2 * n20
    e0, e1, e2 = p0 * n01 + p3 * n11 + p4 * n21, p3 * n01 + p1 * n11 + p5 * n21, p4 * n01 + p5 * n11 + p2 * n21
    i0, i1, i2 = p0 * n02 + p3 * n12 + p4 * n22, p3 * n02 + p1 * n12 + p5 * n22, p4 * n02 + p5 * n12 + p2 * n22
    return (
        n00 * a0 + n10 * a1 + n20 * a2, n01 * e0 + n11 * e1 + n21 * e2, n02 * i0 + n12 * i1 + n22 * i2,
        n01 * a0 + n11 * a1 + n21 * a2, n02 * a0 + n12 * a1 + n22 * a2, n02 * e0 + n12 * e1 + n22 * e2,
    )  # fmt: skip


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _cofactor(v, d, cofactor):
    """Write cof(F) of a lane, and return its J - 1."""
    F00, F01, F02 = 1.0 + d[0, v], d[1, v], d[2, v]
    F10, F11, F12 = d[3, v], 1.0 + d[4, v], d[5, v]
    F20, F21, F22 = d[6, v], d[7, v], 1.0 + d[8, v]
    c00, c01, c02 = F11 * F22 - F12 * F21, F12 * F20 - F10 * F22, F10 * F21 - F11 * F20
    cofactor[0, v], cofactor[1, v], cofactor[2, v] = c00, c01, c02
    cofactor[3, v], cofactor[4, v] = F02 * F21 - F01 * F22, F00 * F22 - F02 * F20
    cofactor[5, v], cofactor[6, v] = F01 * F20 - F00 * F21, F01 * F12 - F02 * F11
    cofactor[7, v], cofactor[8, v] = F02 * F10 - F00 * F12, F00 * F11 - F01 * F10
    return F00 * c00 + F01 * c01 + F02 * c02 - 1.0
