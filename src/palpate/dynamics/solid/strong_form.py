"""The compiled internal force of a collocated solid (equations 3 and 4).

At every node, with F = I + du/dX and H = d2u/dX2,

    rho a = Div P_s + cof(F) grad p  -  P b,      P = P_s + p cof(F),

with P_s the shear part's first Piola-Kirchhoff stress, differentiated directly with the second
derivatives, and p the pressure, smoothed and then differentiated (cof(F) has no divergence: Piola's
identity). b is the boundary vector of the half-cell balance, (area / volume) times normal summed over
the node's faces, zero at interior nodes.

The force requires three passes over blocks of nodes: deformation and shear force; smoothing of the
pressure; its gradient. Each node's result is independent of the others, so the bits are equal for any
number of threads.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import get_thread_id, prange
from numpy.typing import NDArray

from palpate.compiled.jit import inline, kernel_njit, law_digest, law_njit
from palpate.compiled.lanes import LANES, Lanes, Weights, lane_sums_1x3, lane_sums_3x3, lane_sums_3x6
from palpate.compiled.mirror import fill_scalars, fill_vectors
from palpate.compiled.passes import Formulation, combine, lift_passes, smooth_field, weights_address
from palpate.dynamics.material.invariants import cofactor_of, first_invariants, right_cauchy_green
from palpate.dynamics.material.principal_stretches import make_principal_response
from palpate.dynamics.material.small_strain import make_linear_response
from palpate.meshfree.mirror import Mirror
from palpate.tissue.materials import Material
from palpate.tissue.volumetric import QUADRATIC, volumetric_form


class Body(NamedTuple):
    """Constants of a body for the compiled passes."""

    lanes: Lanes
    first: Weights
    second: Weights
    smoothing: Lanes
    value: Weights
    own: NDArray[np.float64]  # (n,) own weight in the smoothing
    boundary: NDArray[np.float64]  # (b, 3, LANES) boundary vectors [1/m]
    coefficients: tuple[float, ...]
    lame: float
    mirror: Mirror  # images at planes of symmetry


class Workspace(NamedTuple):
    """Scratch arrays of the passes."""

    fields: NDArray[np.float64]  # (threads, k, 3, LANES) neighbours' differences
    derivatives: NDArray[np.float64]  # (threads, 39, LANES) first (3, 3), second (3, 6), then a law's twelve slopes
    cofactor: NDArray[np.float64]  # (b, 9, LANES)
    shear: NDArray[np.float64]  # (b, 3, LANES) shear force density
    pressure: NDArray[np.float64]  # (n,)
    smooth: NDArray[np.float64]  # (n + g,), then those of g images
    reflected: NDArray[np.float64]  # (n + g, 3) displacements of nodes and images; empty without images


def workspace(nodes: int, blocks: int, longest: int, threads: int, images: int = 0) -> Workspace:
    """Allocate scratch arrays for `nodes` in `blocks` with at most `longest` neighbours, and for images of some."""
    return Workspace(
        np.zeros((threads, longest, 3, LANES)),
        np.zeros((threads, 39, LANES)),
        np.zeros((blocks, 9, LANES)),
        np.zeros((blocks, 3, LANES)),
        np.zeros(nodes),
        np.zeros(nodes + images),
        np.zeros((nodes + images if images else 0, 3)),
    )


_lift, _differentiate = lift_passes("solid", lane_sums_3x3, lane_sums_3x6, 9)


@kernel_njit(inner=True, parallel=True, fastmath={"contract"})
def _add_pressure(lanes, first, boundary, fields, derivatives, cofactor, shear, smooth, force):
    """Write shear + cof(F) (grad p - p b) with the smoothed pressure p into `force`."""
    for b in prange(lanes.nodes.shape[0]):
        field = fields[get_thread_id()].reshape(-1, LANES)
        gradient = derivatives[get_thread_id()]
        begin, end = lanes.start[b], lanes.stop[b]
        for k in range(begin, end):
            for lane in range(LANES):
                field[k - begin, lane] = smooth[lanes.neighbours[k, lane]] - smooth[lanes.nodes[b, lane]]
        lane_sums_1x3(
            weights_address(first, lanes, b), field.ctypes.data, gradient.ctypes.data, end - begin, lanes.shared[b]
        )
        for lane in range(LANES):
            i = lanes.nodes[b, lane]
            for c in range(3):
                value = shear[b, c, lane]
                for d in range(3):
                    value += cofactor[b, 3 * c + d, lane] * (gradient[d, lane] - smooth[i] * boundary[b, d, lane])
                force[i, c] = value


@kernel_njit(inner=True)
def _finish(body, work, force):
    """Smooth the pressure of the deformation pass, and write the force by node."""
    smooth_field(body.smoothing, body.value, body.own, work.derivatives, work.pressure, work.smooth)
    fill_scalars(body.mirror, work.smooth)
    _add_pressure(body.lanes, body.first, body.boundary, work.fields, work.derivatives, work.cofactor,
                  work.shear, work.smooth, force)  # fmt: skip


def _make_response(digest: str, law_first: Any, law_second: Any, volume: Any) -> Any:
    """Compile the response of one block: stress divergence, cofactor and pressure from F and H.

    `volume` is the compiled function of J - 1 that returns U'(J) over lame first.
    """
    first_of, second_of = (inline(digest, f) for f in (law_first, law_second))

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"}, forceinline=True)
    def shear_force(d, v, b, coefficients):
        """Return Div P_s - P_s b of a lane with the boundary vector b, cof(F) and J."""
        F = 1.0 + d[0, v], d[1, v], d[2, v], d[3, v], 1.0 + d[4, v], d[5, v], d[6, v], d[7, v], 1.0 + d[8, v]
        H = _second_derivatives(d, v)
        c, C = cofactor_of(F), right_cauchy_green(F)
        J = F[0] * c[0] + F[1] * c[1] + F[2] * c[2]
        I1, I2 = first_invariants(C)
        g = _half_slope_of_second_invariant(F, C, I1)
        gradients = _contraction(F, H), _contraction(g, H), _contraction(c, H)
        slopes = first_of(I1, I2, J, coefficients)
        vectors = _gradients_of_slopes(gradients, slopes, second_of(I1, I2, J, coefficients), b)
        force = _divergence(F, C, I1, H, gradients[0], 2.0 * slopes[0], 2.0 * slopes[1])
        return _add_products(force, F, g, c, vectors), c, J

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"}, forceinline=True)
    def respond(b, nodes, d, boundary, coefficients, lame, cofactor, shear, pressure):
        for v in range(LANES):
            normal = boundary[b, 0, v], boundary[b, 1, v], boundary[b, 2, v]
            f, c, J = shear_force(d, v, normal, coefficients)
            shear[b, 0, v], shear[b, 1, v], shear[b, 2, v] = f[0], f[1], f[2]
            cofactor[b, 0, v], cofactor[b, 1, v], cofactor[b, 2, v] = c[0], c[1], c[2]
            cofactor[b, 3, v], cofactor[b, 4, v], cofactor[b, 5, v] = c[3], c[4], c[5]
            cofactor[b, 6, v], cofactor[b, 7, v], cofactor[b, 8, v] = c[6], c[7], c[8]
            d[0, v] = J - 1.0
        for v in range(LANES):  # a separate loop: logarithms are not vectorised
            pressure[nodes[b, v]] = lame * volume(d[0, v])[0]

    return respond


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _second_derivatives(d, v):
    """Return H = d2u_i/dX2 of the three components of a lane, each in the order 00 11 22 01 02 12."""
    return (
        (d[9, v], d[10, v], d[11, v], d[12, v], d[13, v], d[14, v]),
        (d[15, v], d[16, v], d[17, v], d[18, v], d[19, v], d[20, v]),
        (d[21, v], d[22, v], d[23, v], d[24, v], d[25, v], d[26, v]),
    )


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _half_slope_of_second_invariant(F, C, I1):
    """Return I1 F - F C, half the derivative of I2 by F."""
    C00, C11, C22, C01, C02, C12 = C
    return (
        I1 * F[0] - F[0] * C00 - F[1] * C01 - F[2] * C02,
        I1 * F[1] - F[0] * C01 - F[1] * C11 - F[2] * C12,
        I1 * F[2] - F[0] * C02 - F[1] * C12 - F[2] * C22,
        I1 * F[3] - F[3] * C00 - F[4] * C01 - F[5] * C02,
        I1 * F[4] - F[3] * C01 - F[4] * C11 - F[5] * C12,
        I1 * F[5] - F[3] * C02 - F[4] * C12 - F[5] * C22,
        I1 * F[6] - F[6] * C00 - F[7] * C01 - F[8] * C02,
        I1 * F[7] - F[6] * C01 - F[7] * C11 - F[8] * C12,
        I1 * F[8] - F[6] * C02 - F[7] * C12 - F[8] * C22,
    )


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _contraction(T, H):
    """Return the vector T : dF/dX_k: half the gradients of I1 and I2, or that of J, by their T."""
    p, q, r = H
    return (
        T[0] * p[0] + T[1] * p[3] + T[2] * p[4] + T[3] * q[0] + T[4] * q[3] + T[5] * q[4]
        + T[6] * r[0] + T[7] * r[3] + T[8] * r[4],
        T[0] * p[3] + T[1] * p[1] + T[2] * p[5] + T[3] * q[3] + T[4] * q[1] + T[5] * q[5]
        + T[6] * r[3] + T[7] * r[1] + T[8] * r[5],
        T[0] * p[4] + T[1] * p[5] + T[2] * p[2] + T[3] * q[4] + T[4] * q[5] + T[5] * q[2]
        + T[6] * r[4] + T[7] * r[5] + T[8] * r[2],
    )  # fmt: skip


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _gradients_of_slopes(gradients, slopes, second, b):
    """Return the vectors by which F, g and cof(F) are multiplied: grad 2 W1, grad 2 W2 and grad WJ, less those times b.

    The gradients of the energy's derivatives and the boundary term act on the same tensors.
    """
    h, e, j = gradients
    W1, W2, WJ = slopes
    W11, W12, W22, W1J, W2J, WJJ = second
    A, B = 2.0 * W1, 2.0 * W2
    s0 = 2.0 * (W11 * 2.0 * h[0] + W12 * 2.0 * e[0] + W1J * j[0])
    s1 = 2.0 * (W11 * 2.0 * h[1] + W12 * 2.0 * e[1] + W1J * j[1])
    s2 = 2.0 * (W11 * 2.0 * h[2] + W12 * 2.0 * e[2] + W1J * j[2])
    t0 = 2.0 * (W12 * 2.0 * h[0] + W22 * 2.0 * e[0] + W2J * j[0])
    t1 = 2.0 * (W12 * 2.0 * h[1] + W22 * 2.0 * e[1] + W2J * j[1])
    t2 = 2.0 * (W12 * 2.0 * h[2] + W22 * 2.0 * e[2] + W2J * j[2])
    z0 = W1J * 2.0 * h[0] + W2J * 2.0 * e[0] + WJJ * j[0]
    z1 = W1J * 2.0 * h[1] + W2J * 2.0 * e[1] + WJJ * j[1]
    z2 = W1J * 2.0 * h[2] + W2J * 2.0 * e[2] + WJJ * j[2]
    return (
        (s0 - A * b[0], s1 - A * b[1], s2 - A * b[2]),
        (t0 - B * b[0], t1 - B * b[1], t2 - B * b[2]),
        (z0 - WJ * b[0], z1 - WJ * b[1], z2 - WJ * b[2]),
    )


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _divergence(F, C, I1, H, h, A, B):
    """Return A Div F + B (Div (I1 F - F C)): the force of the present slopes A = 2 W1 and B = 2 W2."""
    p, q, r = H
    C00, C11, C22, C01, C02, C12 = C
    L0, L1, L2 = p[0] + p[1] + p[2], q[0] + q[1] + q[2], r[0] + r[1] + r[2]
    # k = divergence of C
    k0 = h[0] + F[0] * L0 + F[3] * L1 + F[6] * L2
    k1 = h[1] + F[1] * L0 + F[4] * L1 + F[7] * L2
    k2 = h[2] + F[2] * L0 + F[5] * L1 + F[8] * L2
    m0 = C00 * p[0] + C11 * p[1] + C22 * p[2] + 2.0 * (C01 * p[3] + C02 * p[4] + C12 * p[5])
    m1 = C00 * q[0] + C11 * q[1] + C22 * q[2] + 2.0 * (C01 * q[3] + C02 * q[4] + C12 * q[5])
    m2 = C00 * r[0] + C11 * r[1] + C22 * r[2] + 2.0 * (C01 * r[3] + C02 * r[4] + C12 * r[5])
    x0, x1, x2 = 2.0 * h[0] - k0, 2.0 * h[1] - k1, 2.0 * h[2] - k2
    return (
        A * L0 + B * (F[0] * x0 + F[1] * x1 + F[2] * x2 + I1 * L0 - m0),
        A * L1 + B * (F[3] * x0 + F[4] * x1 + F[5] * x2 + I1 * L1 - m1),
        A * L2 + B * (F[6] * x0 + F[7] * x1 + F[8] * x2 + I1 * L2 - m2),
    )


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _add_products(f, F, g, c, vectors):
    """Return f + F s + g t + c z."""
    (s0, s1, s2), (t0, t1, t2), (z0, z1, z2) = vectors
    return (
        f[0] + (F[0] * s0 + F[1] * s1 + F[2] * s2 + g[0] * t0 + g[1] * t1 + g[2] * t2
                + c[0] * z0 + c[1] * z1 + c[2] * z2),
        f[1] + (F[3] * s0 + F[4] * s1 + F[5] * s2 + g[3] * t0 + g[4] * t1 + g[5] * t2
                + c[3] * z0 + c[4] * z1 + c[5] * z2),
        f[2] + (F[6] * s0 + F[7] * s1 + F[8] * s2 + g[6] * t0 + g[7] * t1 + g[8] * t2
                + c[6] * z0 + c[7] * z1 + c[8] * z2),
    )  # fmt: skip


@cache
def solid(law: type[Material], volumetric: str = QUADRATIC) -> Formulation:
    """Compile the passes of a solid with the functions of a law, without its parameters, and a form of U(J)."""
    pressure_of = volumetric_form(volumetric).pressure
    digest = law_digest(__name__, "solid", law.variables, law.first, law.second, pressure_of)
    make = {
        "invariants": _make_response, "stretches": make_principal_response, "small strain": make_linear_response,
    }[law.variables]  # fmt: skip
    volume = inline(digest, pressure_of)
    node_response = make(digest, law.first, law.second, volume)

    @law_njit(digest, inner=True, parallel=True, fastmath={"contract"})
    def each(u, lanes, first, second, boundary, coefficients, lame, fields, derivatives, cofactor, shear, pressure):
        for block in prange(lanes.nodes.shape[0]):
            b = np.int64(block)
            out = derivatives[get_thread_id()]
            _lift(b, u, lanes, first, second, fields[get_thread_id()], out)
            node_response(b, lanes.nodes, out, boundary, coefficients, lame, cofactor, shear, pressure)

    @law_njit(digest, inner=True)
    def respond(u, body, work):
        field = u
        if body.mirror.source.shape[0] > 0:
            fill_vectors(u, body.mirror, work.reflected)
            field = work.reflected
        each(field, body.lanes, body.first, body.second, body.boundary, body.coefficients, body.lame,
             work.fields, work.derivatives, work.cofactor, work.shear, work.pressure)  # fmt: skip

    @law_njit(digest, inner=True, parallel=True, fastmath={"contract"})
    def each_column(columns, table, lanes, boundary, coefficients, lame, derivatives, cofactor, shear, pressure):
        for block in prange(table.shape[0]):
            b = np.int64(block)
            out = derivatives[get_thread_id()]
            combine(b, columns, table, out)
            node_response(b, lanes.nodes, out, boundary, coefficients, lame, cofactor, shear, pressure)

    @law_njit(digest, inner=True)
    def respond_to_columns(columns, table, body, work):
        each_column(columns, table, body.lanes, body.boundary, body.coefficients, body.lame,
                    work.derivatives, work.cofactor, work.shear, work.pressure)  # fmt: skip

    @law_njit(digest, inner=True)
    def finish(body, work, force):
        _finish(body, work, force)

    return Formulation(digest, 27, respond, respond_to_columns, _differentiate, finish)
