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
    def respond(b, nodes, d, boundary, coefficients, lame, cofactor, shear, pressure):
        for v in range(LANES):
            F00, F01, F02 = 1.0 + d[0, v], d[1, v], d[2, v]
            F10, F11, F12 = d[3, v], 1.0 + d[4, v], d[5, v]
            F20, F21, F22 = d[6, v], d[7, v], 1.0 + d[8, v]
            # second derivatives of component i, in the order 00 11 22 01 02 12
            p0, p1, p2, p3, p4, p5 = d[9, v], d[10, v], d[11, v], d[12, v], d[13, v], d[14, v]
            q0, q1, q2, q3, q4, q5 = d[15, v], d[16, v], d[17, v], d[18, v], d[19, v], d[20, v]
            r0, r1, r2, r3, r4, r5 = d[21, v], d[22, v], d[23, v], d[24, v], d[25, v], d[26, v]

            c00, c01, c02 = F11 * F22 - F12 * F21, F12 * F20 - F10 * F22, F10 * F21 - F11 * F20
            c10, c11, c12 = F02 * F21 - F01 * F22, F00 * F22 - F02 * F20, F01 * F20 - F00 * F21
            c20, c21, c22 = F01 * F12 - F02 * F11, F02 * F10 - F00 * F12, F00 * F11 - F01 * F10
            J = F00 * c00 + F01 * c01 + F02 * c02
            C00 = F00 * F00 + F10 * F10 + F20 * F20
            C11 = F01 * F01 + F11 * F11 + F21 * F21
            C22 = F02 * F02 + F12 * F12 + F22 * F22
            C01 = F00 * F01 + F10 * F11 + F20 * F21
            C02 = F00 * F02 + F10 * F12 + F20 * F22
            C12 = F01 * F02 + F11 * F12 + F21 * F22
            I1 = C00 + C11 + C22
            I2 = C00 * C11 + C00 * C22 + C11 * C22 - C01 * C01 - C02 * C02 - C12 * C12
            # G = I1 F - F C, half the derivative of I2 by F
            g00, g01, g02 = (
                I1 * F00 - F00 * C00 - F01 * C01 - F02 * C02,
                I1 * F01 - F00 * C01 - F01 * C11 - F02 * C12,
                I1 * F02 - F00 * C02 - F01 * C12 - F02 * C22,
            )
            g10, g11, g12 = (
                I1 * F10 - F10 * C00 - F11 * C01 - F12 * C02,
                I1 * F11 - F10 * C01 - F11 * C11 - F12 * C12,
                I1 * F12 - F10 * C02 - F11 * C12 - F12 * C22,
            )
            g20, g21, g22 = (
                I1 * F20 - F20 * C00 - F21 * C01 - F22 * C02,
                I1 * F21 - F20 * C01 - F21 * C11 - F22 * C12,
                I1 * F22 - F20 * C02 - F21 * C12 - F22 * C22,
            )
            # halves of the gradients of I1 and I2, and the gradient of J
            h0 = F00 * p0 + F01 * p3 + F02 * p4 + F10 * q0 + F11 * q3 + F12 * q4 + F20 * r0 + F21 * r3 + F22 * r4
            h1 = F00 * p3 + F01 * p1 + F02 * p5 + F10 * q3 + F11 * q1 + F12 * q5 + F20 * r3 + F21 * r1 + F22 * r5
            h2 = F00 * p4 + F01 * p5 + F02 * p2 + F10 * q4 + F11 * q5 + F12 * q2 + F20 * r4 + F21 * r5 + F22 * r2
            e0 = g00 * p0 + g01 * p3 + g02 * p4 + g10 * q0 + g11 * q3 + g12 * q4 + g20 * r0 + g21 * r3 + g22 * r4
            e1 = g00 * p3 + g01 * p1 + g02 * p5 + g10 * q3 + g11 * q1 + g12 * q5 + g20 * r3 + g21 * r1 + g22 * r5
            e2 = g00 * p4 + g01 * p5 + g02 * p2 + g10 * q4 + g11 * q5 + g12 * q2 + g20 * r4 + g21 * r5 + g22 * r2
            j0 = c00 * p0 + c01 * p3 + c02 * p4 + c10 * q0 + c11 * q3 + c12 * q4 + c20 * r0 + c21 * r3 + c22 * r4
            j1 = c00 * p3 + c01 * p1 + c02 * p5 + c10 * q3 + c11 * q1 + c12 * q5 + c20 * r3 + c21 * r1 + c22 * r5
            j2 = c00 * p4 + c01 * p5 + c02 * p2 + c10 * q4 + c11 * q5 + c12 * q2 + c20 * r4 + c21 * r5 + c22 * r2

            W1, W2, WJ = first_of(I1, I2, J, coefficients)
            W11, W12, W22, W1J, W2J, WJJ = second_of(I1, I2, J, coefficients)
            # gradients of the energy's derivatives, doubled if they multiply a doubled tensor
            s0 = 2.0 * (W11 * 2.0 * h0 + W12 * 2.0 * e0 + W1J * j0)
            s1 = 2.0 * (W11 * 2.0 * h1 + W12 * 2.0 * e1 + W1J * j1)
            s2 = 2.0 * (W11 * 2.0 * h2 + W12 * 2.0 * e2 + W1J * j2)
            t0 = 2.0 * (W12 * 2.0 * h0 + W22 * 2.0 * e0 + W2J * j0)
            t1 = 2.0 * (W12 * 2.0 * h1 + W22 * 2.0 * e1 + W2J * j1)
            t2 = 2.0 * (W12 * 2.0 * h2 + W22 * 2.0 * e2 + W2J * j2)
            z0 = W1J * 2.0 * h0 + W2J * 2.0 * e0 + WJJ * j0
            z1 = W1J * 2.0 * h1 + W2J * 2.0 * e1 + WJJ * j1
            z2 = W1J * 2.0 * h2 + W2J * 2.0 * e2 + WJJ * j2
            L0, L1, L2 = p0 + p1 + p2, q0 + q1 + q2, r0 + r1 + r2
            # k = divergence of C
            k0 = h0 + F00 * L0 + F10 * L1 + F20 * L2
            k1 = h1 + F01 * L0 + F11 * L1 + F21 * L2
            k2 = h2 + F02 * L0 + F12 * L1 + F22 * L2
            b0, b1, b2 = boundary[b, 0, v], boundary[b, 1, v], boundary[b, 2, v]
            A, B = 2.0 * W1, 2.0 * W2
            m0 = C00 * p0 + C11 * p1 + C22 * p2 + 2.0 * (C01 * p3 + C02 * p4 + C12 * p5)
            m1 = C00 * q0 + C11 * q1 + C22 * q2 + 2.0 * (C01 * q3 + C02 * q4 + C12 * q5)
            m2 = C00 * r0 + C11 * r1 + C22 * r2 + 2.0 * (C01 * r3 + C02 * r4 + C12 * r5)
            x0, x1, x2 = 2.0 * h0 - k0, 2.0 * h1 - k1, 2.0 * h2 - k2
            f0 = A * L0 + B * (F00 * x0 + F01 * x1 + F02 * x2 + I1 * L0 - m0)
            f1 = A * L1 + B * (F10 * x0 + F11 * x1 + F12 * x2 + I1 * L1 - m1)
            f2 = A * L2 + B * (F20 * x0 + F21 * x1 + F22 * x2 + I1 * L2 - m2)
            # the gradients of the coefficients and the boundary term act on the same tensors
            s0, s1, s2 = s0 - A * b0, s1 - A * b1, s2 - A * b2
            t0, t1, t2 = t0 - B * b0, t1 - B * b1, t2 - B * b2
            z0, z1, z2 = z0 - WJ * b0, z1 - WJ * b1, z2 - WJ * b2
            f0 += F00 * s0 + F01 * s1 + F02 * s2 + g00 * t0 + g01 * t1 + g02 * t2 + c00 * z0 + c01 * z1 + c02 * z2
            f1 += F10 * s0 + F11 * s1 + F12 * s2 + g10 * t0 + g11 * t1 + g12 * t2 + c10 * z0 + c11 * z1 + c12 * z2
            f2 += F20 * s0 + F21 * s1 + F22 * s2 + g20 * t0 + g21 * t1 + g22 * t2 + c20 * z0 + c21 * z1 + c22 * z2
            shear[b, 0, v], shear[b, 1, v], shear[b, 2, v] = f0, f1, f2
            cofactor[b, 0, v], cofactor[b, 1, v], cofactor[b, 2, v] = c00, c01, c02
            cofactor[b, 3, v], cofactor[b, 4, v], cofactor[b, 5, v] = c10, c11, c12
            cofactor[b, 6, v], cofactor[b, 7, v], cofactor[b, 8, v] = c20, c21, c22
            d[0, v] = J - 1.0
        for v in range(LANES):  # a separate loop: logarithms are not vectorised
            pressure[nodes[b, v]] = lame * volume(d[0, v])[0]

    return respond


@cache
def solid(law: type[Material], volumetric: str = QUADRATIC) -> Formulation:
    """Compile the passes of a solid.

    Parameters
    ----------
    law : type
        Material whose functions are compiled, without its parameters.
    volumetric : str
        Form of U(J).
    """
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
