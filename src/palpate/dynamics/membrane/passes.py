"""The compiled internal force of a membrane.

With F = dx/dX (3, 2) and C = F^T F, the thickness stretch of the incompressible sheet is
1 / sqrt(det C). Plane stress yields the first Piola-Kirchhoff stress of any isotropic law W(I1, I2),

    P = a F + g F adj(C),    I1 = tr C + 1 / det C,    I2 = det C + tr C / det C.

A sheet without bending stiffness wrinkles instead of carrying compression. Its relaxed energy (Pipkin, IMA J. Appl.
Math. 36, 1986) follows from the principal stretches l1 >= l2: where l2 < l1^(-1/2), the width that simple tension
leaves, the sheet is wrinkled, l2 drops out of the energy and P is uniaxial. Where l1 <= 1 it is slack,
and P = 0.

The force is the derivative of an energy. With the first and second derivatives H of the displacement at nodes,

    rho a V = -d/du sum of V mean of W(F + H xi) over six points xi about the node.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import get_thread_id, prange
from numpy.typing import NDArray

from palpate.compiled.jit import inline, kernel_njit, law_digest, law_njit
from palpate.compiled.lanes import LANES, Lanes, Weights, lane_sums_3x2, lane_sums_3x3
from palpate.compiled.passes import Formulation, add_blocks, combine, lift_passes
from palpate.compiled.rows import Rows, aligned_zeros, gather_fluxes
from palpate.dynamics.material.fibres import Families
from palpate.dynamics.material.relaxation import HistoryVariables, Relaxation, after, history, prepare
from palpate.dynamics.membrane.additional_stress import NO_ADDITIONAL_STRESS, AdditionalStress, flatten_additional
from palpate.dynamics.membrane.principal_moduli import make_principal_moduli
from palpate.tissue.materials import Material

FLUX_WIDTH = 8  # numbers of a component's flux: two stresses, three moments and padding
NODE_DERIVATIVES = 15  # derivatives per node: x_c,0 and x_c,1, then x_c,00 x_c,11 x_c,01, for three components c
NODE_POINTS = 6  # integration points around a node, with the symmetry of a triangular lattice
# Distance of the points from the node, in roots of its area. In a hexagonal cell 0.4 would integrate
# exactly. The fitted gradient is too small in short waves; points at 1.0 cancel this leading error.
POINT_RADIUS = 1.0
POINT_COSINES, POINT_SINES = (f(np.arange(NODE_POINTS) * (2 * np.pi / NODE_POINTS)) for f in (np.cos, np.sin))
MIN_SQUARE_GAP = 1e-30  # least difference of squared stretches in quotients, whose numerators vanish too


class SheetBody(NamedTuple):
    """Constants of a membrane for the compiled passes."""

    lanes: Lanes
    first: Weights
    second: Weights
    transposed: Rows  # of every node, the nodes whose stencils contain it, and itself; times the ratio of volumes
    radius: NDArray[np.float64]  # (n,) distance of the points from their node [m]
    coefficients: tuple[float, ...]
    prestretch: float
    relaxation: Relaxation
    families: Families  # of fibres


class SheetWork(NamedTuple):
    """Scratch arrays of the passes."""

    fields: NDArray[np.float64]  # (threads, k, 3, LANES) neighbours' differences
    derivatives: NDArray[np.float64]  # (threads, 15, LANES)
    cofactor: NDArray[np.float64]  # (b, 9, LANES): the last of every three is the deformed normal's component
    flux: NDArray[np.float64]  # (n, 3, 8) stress and its first moments
    energy: NDArray[np.float64]  # (n,) [J/m^3]
    history: HistoryVariables  # of viscoelastic tissue; point q of block b at POINTS b + q


def sheet_work(nodes: int, blocks: int, longest: int, threads: int, branches: int = 0) -> SheetWork:
    """Allocate scratch arrays for `nodes` in `blocks` with at most `longest` neighbours."""
    return SheetWork(
        np.zeros((threads, longest, 3, LANES)),
        np.zeros((threads, NODE_DERIVATIVES, LANES)),
        np.zeros((blocks, 9, LANES)),
        aligned_zeros(nodes, 3, FLUX_WIDTH),
        np.zeros(nodes),
        history(branches, NODE_POINTS * blocks, 0),
    )


_lift, _differentiate = lift_passes("sheet", lane_sums_3x2, lane_sums_3x3, 6)
_gather_fluxes = gather_fluxes[FLUX_WIDTH]


@kernel_njit(inner=True, parallel=True, fastmath={"contract"})
def _virtual_work(table, nodes, flux, volumes, partial):
    """Write minus the work [J] of every block's fluxes on the derivatives of every vector, (b, m)."""
    for b in prange(table.shape[0]):
        for m in range(table.shape[1]):
            total = 0.0
            for lane in range(LANES):
                i = nodes[b, lane]
                if lane > 0 and i == nodes[b, lane - 1]:
                    break  # the last node of an unfilled block is repeated
                work = 0.0
                for c in range(3):
                    work += flux[i, c, 0] * table[b, m, 2 * c, lane] + flux[i, c, 1] * table[b, m, 2 * c + 1, lane]
                    for w in range(3):
                        work += flux[i, c, 2 + w] * table[b, m, 6 + 3 * c + w, lane]
                total -= volumes[i] * work
            partial[b, m] = total


@kernel_njit()
def _project(table, body, work, volumes, partial, result):
    _virtual_work(table, body.lanes.nodes, work.flux, volumes, partial)
    add_blocks(partial, result)


@kernel_njit(fastmath={"contract"}, forceinline=True)
def _principal(C00, C11, C01):
    """Return the eigenvalues of C, and the squared lateral stretch in simple tension."""
    mean, radius = 0.5 * (C00 + C11), np.sqrt(0.25 * (C00 - C11) ** 2 + C01 * C01)
    return mean + radius, mean - radius, 1.0 / np.sqrt(max(mean + radius, 1.0))


def make_moduli(
    digest: str, energy_of: Any, law_first: Any, law_second: Any, relaxed: bool, variables: str = "invariants"
) -> Any:
    """Compile the function of C for energy, a and g in P = a F + g F adj(C).

    In a wrinkled state P = h F N N^T, N the direction of tension, is of the same form: by the theorem of Cayley and
    Hamilton F N N^T (c1 - c2) = c1 F - F adj(C), c1 > c2 the eigenvalues of C.
    """
    if variables == "stretches":
        return make_principal_moduli(digest, energy_of, law_first, law_second, relaxed)
    energy, first_of = (inline(digest, f) for f in (energy_of, law_first))

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def moduli(C00, C11, C01, coefficients):
        """Return the energy, a and g; the relaxed energy of a wrinkled state is that of simple tension."""
        t, D = C00 + C11, C00 * C11 - C01 * C01
        if relaxed:
            c1, c2, width = _principal(C00, C11, C01)
            if c2 < width:
                I1, I2 = 1.0 / (width * width) + 2.0 * width, 2.0 / width + width * width
                W1, W2, _ = first_of(I1, I2, 1.0, coefficients)
                h = 2.0 * (W1 * (1.0 - width**3) + W2 * (width - width**4)) / max(c1 - c2, MIN_SQUARE_GAP)
                return energy(I1, I2, 1.0, coefficients), h * c1, -h
        I1, I2 = t + 1.0 / D, D + t / D
        W1, W2, _ = first_of(I1, I2, 1.0, coefficients)
        a, g = 2.0 * (W1 + W2 / D), 2.0 * (W2 * (1.0 - t / (D * D)) - W1 / (D * D))
        return energy(I1, I2, 1.0, coefficients), a, g

    return moduli


def _make_response(digest: str, moduli: Any, added: Any) -> Any:
    """Compile the response of one block: mean stress at a node, its moments with xi, the energy."""
    has_additional = added is not None

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"}, forceinline=True)
    def node_response(b, nodes, d, radius, coefficients, prestretch, extras, cofactor, flux, energy):
        for v in range(LANES):
            i = nodes[b, v]
            total = 0.0
            for c in range(3):
                for w in range(FLUX_WIDTH):
                    flux[i, c, w] = 0.0
            for q in range(NODE_POINTS):
                x, y = radius[i] * POINT_COSINES[q], radius[i] * POINT_SINES[q]
                F00 = prestretch + d[0, v] + d[6, v] * x + d[8, v] * y
                F10 = d[2, v] + d[9, v] * x + d[11, v] * y
                F20 = d[4, v] + d[12, v] * x + d[14, v] * y
                F01 = d[1, v] + d[8, v] * x + d[7, v] * y
                F11 = prestretch + d[3, v] + d[11, v] * x + d[10, v] * y
                F21 = d[5, v] + d[14, v] * x + d[13, v] * y
                C00 = F00 * F00 + F10 * F10 + F20 * F20
                C11 = F01 * F01 + F11 * F11 + F21 * F21
                C01 = F00 * F01 + F10 * F11 + F20 * F21
                W, a, g = moduli(C00, C11, C01, coefficients)
                l00, l01, l11 = (a + g * C11) / NODE_POINTS, -g * C01 / NODE_POINTS, (a + g * C00) / NODE_POINTS
                if has_additional:
                    w, S00, S11, S01 = added(C00, C11, C01, b, NODE_POINTS * b + q, v, extras)
                    W, l00, l01, l11 = W + w, l00 + S00 / NODE_POINTS, l01 + S01 / NODE_POINTS, l11 + S11 / NODE_POINTS
                total += W
                P00, P01 = F00 * l00 + F01 * l01, F00 * l01 + F01 * l11
                P10, P11 = F10 * l00 + F11 * l01, F10 * l01 + F11 * l11
                P20, P21 = F20 * l00 + F21 * l01, F20 * l01 + F21 * l11
                flux[i, 0, 0] += P00
                flux[i, 1, 0] += P10
                flux[i, 2, 0] += P20
                flux[i, 0, 1] += P01
                flux[i, 1, 1] += P11
                flux[i, 2, 1] += P21
                flux[i, 0, 2] += P00 * x
                flux[i, 1, 2] += P10 * x
                flux[i, 2, 2] += P20 * x
                flux[i, 0, 3] += P01 * y
                flux[i, 1, 3] += P11 * y
                flux[i, 2, 3] += P21 * y
                flux[i, 0, 4] += P00 * y + P01 * x
                flux[i, 1, 4] += P10 * y + P11 * x
                flux[i, 2, 4] += P20 * y + P21 * x
            energy[i] = total / NODE_POINTS
            _normal(b, v, d, prestretch, cofactor)

    return node_response


@kernel_njit(fastmath={"contract"}, forceinline=True)
def _normal(b, v, d, prestretch, cofactor):
    """Write the deformed normal times the ratio of areas into `cofactor`, for `surface_force`."""
    F00, F01, F10 = prestretch + d[0, v], d[1, v], d[2, v]
    F11, F20, F21 = prestretch + d[3, v], d[4, v], d[5, v]
    cofactor[b, 2, v] = F10 * F21 - F20 * F11
    cofactor[b, 5, v] = F20 * F01 - F00 * F21
    cofactor[b, 8, v] = F00 * F11 - F10 * F01


@cache
def sheet(law: type[Material], relaxed: bool, added: AdditionalStress = NO_ADDITIONAL_STRESS) -> Formulation:
    """Compile the passes of a membrane with the functions of a law, without its parameters.

    The energy is the `relaxed` one of wrinkled and slack states, or not. `added` has fibres and viscoelastic branches.
    """
    digest = law_digest(__name__, "sheet", law.variables, law.energy, law.first, law.second, relaxed, added.digest)
    has_additional = added.response is not None
    moduli = make_moduli(digest, law.energy, law.first, law.second, relaxed, law.variables)
    node_response = _make_response(digest, moduli, added.response)

    @law_njit(digest, inner=True, parallel=True, fastmath={"contract"})
    def each(
        u, lanes, first, second, radius, coefficients, prestretch, extras, fields, derivatives,
        cofactor, flux, energy,
    ):  # fmt: skip
        for block in prange(lanes.nodes.shape[0]):
            b = np.int64(block)
            out = derivatives[get_thread_id()]
            _lift(b, u, lanes, first, second, fields[get_thread_id()], out)
            node_response(b, lanes.nodes, out, radius, coefficients, prestretch, extras, cofactor, flux, energy)

    @law_njit(digest, inner=True)
    def respond(u, body, work):
        if has_additional:
            prepare(body.relaxation, work.history)
        each(u, body.lanes, body.first, body.second, body.radius, body.coefficients, body.prestretch,
             flatten_additional(body.families, body.relaxation, work.history),
             work.fields, work.derivatives, work.cofactor, work.flux, work.energy)  # fmt: skip

    @law_njit(digest, inner=True, parallel=True, fastmath={"contract"})
    def each_column(
        columns, table, lanes, radius, coefficients, prestretch, extras, derivatives, cofactor, flux, energy,
    ):  # fmt: skip
        for block in prange(table.shape[0]):
            b = np.int64(block)
            out = derivatives[get_thread_id()]
            combine(b, columns, table, out)
            node_response(b, lanes.nodes, out, radius, coefficients, prestretch, extras, cofactor, flux, energy)

    @law_njit(digest, inner=True)
    def respond_to_columns(columns, table, body, work):
        if has_additional:
            prepare(body.relaxation, work.history)
        each_column(columns, table, body.lanes, body.radius, body.coefficients, body.prestretch,
                    flatten_additional(body.families, body.relaxation, work.history),
                    work.derivatives, work.cofactor, work.flux, work.energy)  # fmt: skip

    @law_njit(digest, inner=True)
    def finish(body, work, force):
        _gather_fluxes(body.transposed, work.flux, force)

    return Formulation(digest, NODE_DERIVATIVES, respond, respond_to_columns, _differentiate, finish, _project, after)
