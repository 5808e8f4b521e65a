"""The compiled internal force of a solid as the derivative of an energy.

With F = I + du/dX at the nodes, J = det F, V the nodal weights,

    E(u) = sum over nodes of V k [ W_s(F) + lame/2 theta^2 + s/2 |e|^2 ],      rho V a = -dE/du.

W_s includes the energy of fibres (`palpate.tissue.fibres`). k is 1 or a node's stiffness factor. The
law's parameters, lame and s can differ from node to node
(`palpate.dynamics.material.material_fields`). theta is J - 1, or another form's measure g(J)
(`palpate.tissue.volumetric`), smoothed over about 27 nodes with its integral preserved. The pressure
lame theta, times g', neither locks nor oscillates, and a uniform pressure moves no interior node.

e is the hourglass residual: the node's displacement minus that of an evenly weighted quadratic fit.
Nodal gradients vanish in the shortest waves, which would have no energy. The residual does not. It is
zero in every quadratic field, and so changes neither stretching nor bending (hourglass control as in
Ganzenmueller, Comput. Methods Appl. Mech. Eng. 286, 2015, of second order).

The force requires four passes over blocks of nodes: deformation and shear stress; smoothing of g;
the transposed smoothing, which yields the pressure; the transposed derivatives of the stresses. Each
node's result is independent of the others, so the bits are equal for any number of threads.

The first and the last pass sum node by node (`palpate.compiled.rows`). The flux of a node is
what its weights multiply: the nine stresses and the three forces s e of the residual. Between them the
numbers of a block are in lanes.

In single precision (`body_in_single`) weights, differences, their sums and fluxes are rounded to 24 bits. The law, the
smoothing and the forces stay in double precision. Displacements are relative to an affine motion that four nodes
define, so that the force of a body that is moved and turned has no larger error.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import get_thread_id, prange
from numpy.typing import NDArray

from palpate.compiled.jit import inline, kernel_njit, law_digest, law_njit
from palpate.compiled.lanes import LANES, Lanes, Weights, lane_gather
from palpate.compiled.mirror import fill_fluxes, fill_vectors
from palpate.compiled.passes import (
    Formulation,
    add_blocks,
    combine,
    smooth_field,
    weights_address,
    without_history,
)
from palpate.compiled.rows import Rows, aligned_zeros, difference_sums, gather_fluxes, rows_in_single
from palpate.compiled.transposes import lanes_to_nodes, nodes_to_lanes
from palpate.dynamics.material.fibres import NO_FIBRES, Families, FibrePoints
from palpate.dynamics.material.material_fields import NO_FIELDS, parameters_at
from palpate.dynamics.material.principal_stretches import make_principal_stress
from palpate.dynamics.material.relaxation import HistoryVariables, Relaxation, after, history, overstress, relax_volume
from palpate.dynamics.material.small_strain import make_linear_stress
from palpate.meshfree.mirror import Mirror
from palpate.tissue.materials import Material
from palpate.tissue.volumetric import QUADRATIC, volumetric_form

NODE_NUMBERS = 12  # per node: du_c/dX_d as 3 c + d, then the residuals e_c
WEIGHT_WIDTH = 4  # weights per neighbour
# first rows in the array of a block's response, (ROWS * LANES,): after derivatives, in their place total stresses
STRESS, COFACTOR = NODE_NUMBERS, 2 * NODE_NUMBERS
DILATATION = COFACTOR + 9
PRESSURE_ROW, FACTOR_ROWS, ROWS = DILATATION, DILATATION + 1, DILATATION + 3  # the pressure in place of the dilatation


class SmoothingSums(NamedTuple):
    """Stencil sums that smooth a nodal field, and the transposed ones."""

    lanes: Lanes
    weights: Weights
    own: NDArray[np.float64]  # (n,) weight of a node itself
    transposed: Lanes
    transposed_weights: Weights


class EnergyBody(NamedTuple):
    """Constants of a body for the compiled passes."""

    lanes: Rows  # stencils of du/dX and of the residual e, four weights per neighbour
    transposed: Rows  # of every node, the nodes whose stencils contain it, and itself; times the ratio of volumes
    smoothing: SmoothingSums  # of the volumetric measure
    coefficients: tuple[float, ...] | NDArray[np.float64]  # by lane if they differ
    lame: float
    hourglass: float  # s [Pa/m^2]
    relaxation: Relaxation
    stiffness: NDArray[np.float64]  # (n, 3) factors of the law, of s and of lame; empty if all are 1
    families: Families  # of fibres
    mirror: Mirror  # images at planes of symmetry
    flux_mirror: Mirror  # reflected fluxes, which stencils with images cause
    places: NDArray[np.float64]  # (n + g, 3) reference positions of nodes and images, from the first anchor [m]
    anchors: NDArray[np.int64]  # (4,) nodes whose displacements define an affine motion
    inverse: NDArray[np.float64]  # (3, 3) inverse of the columns `places` of the last three of them [1/m]


class EnergyWork(NamedTuple):
    """Scratch arrays of the passes."""

    sums: NDArray[Any]  # (threads, LANES, 3, 4) derivatives du_c/dX_d and residual e_c of a block's nodes, in lines
    derivatives: NDArray[np.float64]  # (threads, 12, LANES)
    response: NDArray[np.float64]  # (b, ROWS * LANES) derivatives, shear stress [Pa], s e_c, cof F and J - 1
    cofactor: NDArray[np.float64]  # (b, 9, LANES)
    flux: NDArray[Any]  # (n + h, 3, 4): P_cd [Pa] and s e_c, then h reflected ones; in lines
    dilatation: NDArray[np.float64]  # (n,) J - 1, or g(J)
    slope: NDArray[np.float64]  # (n,) g'(J); empty if it is 1
    smooth: NDArray[np.float64]  # (n,) theta
    pressure: NDArray[np.float64]  # (n,) [Pa]
    history: HistoryVariables  # of viscoelastic tissue
    scaled: NDArray[np.float64]  # (n,) theta times its stiffness factor
    least: NDArray[np.float64]  # (1,) least dilatation of all evaluations in a call of the step
    reflected: NDArray[np.float64]  # (n + g, 3) displacements of nodes and images; empty without images
    frame: NDArray[np.float64]  # (9,) gradient of the affine motion, row by row; 0 in double precision
    anchored: NDArray[np.float32]  # (n + g, 4) displacements from the affine motion; empty in double precision


def energy_work(
    nodes: int, blocks: int, threads: int, branches: int, volumetric: str = QUADRATIC, images: tuple[int, int] = (0, 0)
) -> EnergyWork:
    """Allocate scratch arrays for `nodes` in `blocks`, with numbers of images and of reflected fluxes."""
    return EnergyWork(
        aligned_zeros(threads, LANES, 3, 4),
        aligned_zeros(threads, NODE_NUMBERS, LANES),
        aligned_zeros(blocks, ROWS * LANES),
        aligned_zeros(blocks, 9, LANES),
        _flux_lines(nodes + images[1], blocks, 3, np.float64),
        np.zeros(nodes),
        np.zeros(0 if volumetric == QUADRATIC else nodes),
        np.zeros(nodes),
        np.zeros(nodes),
        history(branches, blocks, nodes),
        np.zeros(nodes),
        np.zeros(1),
        np.zeros((nodes + images[0] if images[0] else 0, 3)),
        np.zeros(9),
        aligned_zeros(0, 4, dtype=np.float32),
    )


def _flux_lines(count: int, blocks: int, rows: int, dtype: type[np.floating[Any]]) -> NDArray[Any]:
    """Return zeros (count, rows, 4), with room behind them for the repeated nodes of the last of some blocks."""
    return aligned_zeros(max(count, blocks * LANES), rows, 4, dtype=dtype)[:count]


def body_in_single(body: EnergyBody) -> EnergyBody:
    """Return the constants of passes in single precision."""
    return body._replace(lanes=rows_in_single(body.lanes), transposed=rows_in_single(body.transposed))


def work_in_single(body: EnergyBody, work: EnergyWork) -> EnergyWork:
    """Return the scratch arrays of passes in single precision; all but those that are rounded are shared."""
    return work._replace(
        sums=aligned_zeros(len(work.sums), LANES, 4, 4, dtype=np.float32),
        flux=_flux_lines(len(work.flux), len(work.cofactor), 4, np.float32),
        frame=np.zeros(9),
        anchored=aligned_zeros(len(body.places), 4, dtype=np.float32),
    )


_gather_fluxes = gather_fluxes[WEIGHT_WIDTH]


@kernel_njit(inner=True, cached=False, fastmath={"contract"})
def _lift(b, u, rows, sums, response):
    """Write the derivatives and residuals at the nodes of one block into the first rows of `response`."""
    for lane in range(LANES):
        difference_sums(u, rows, rows.nodes[b, lane], sums, lane)
    nodes_to_lanes(sums, response)


@kernel_njit(inner=True, parallel=True)
def _lift_columns(modes, rows, sums, response, table):
    for block in prange(rows.nodes.shape[0]):
        b = np.int64(block)
        derivatives = response[b]
        for m in range(modes.shape[0]):
            _lift(b, modes[m], rows, sums[get_thread_id()], derivatives)
            for q in range(NODE_NUMBERS):
                for lane in range(LANES):
                    table[b, m, q, lane] = derivatives[LANES * q + lane]


@kernel_njit(nogil=True)
def _differentiate(modes, body, work, table):
    _lift_columns(modes, body.lanes, work.sums, work.response, table)


@kernel_njit(inner=True, fastmath={"contract"})
def _anchor(u, body, frame, anchored):
    """Write the displacements of nodes and images from the affine motion of the anchors, and its gradient."""
    places, anchors, inverse, first = body.places, body.anchors, body.inverse, body.anchors[0]
    x, y, z = u[first, 0], u[first, 1], u[first, 2]
    for c in range(3):
        for d in range(3):
            total = 0.0
            for k in range(3):
                total += (u[anchors[k + 1], c] - u[first, c]) * inverse[k, d]
            frame[3 * c + d] = total
    xx, xy, xz, yx, yy, yz, zx, zy, zz = frame
    for i in range(anchored.shape[0]):
        a, b, c = places[i, 0], places[i, 1], places[i, 2]
        anchored[i, 0] = u[i, 0] - x - (xx * a + xy * b + xz * c)
        anchored[i, 1] = u[i, 1] - y - (yx * a + yy * b + yz * c)
        anchored[i, 2] = u[i, 2] - z - (zx * a + zy * b + zz * c)


@kernel_njit(inner=True, parallel=True, fastmath={"contract"})
def _add_pressure(lanes, value, diagonal, lame, theta, slope, stiffness, overstress, sums, response, pressure, flux):
    """Compute p, g' times the transposed smoothing of theta, and the fluxes: shear, overstress and lame p cof(F).

    The overstresses (b, 9, LANES) scale like the shear modulus. Blocks of the smoothing have all nodes in order, as
    those of the response.
    """
    for block in prange(lanes.nodes.shape[0]):
        b = np.int64(block)
        total, r = sums[get_thread_id()], response[b]
        begin, end = lanes.start[b], lanes.stop[b]
        lane_gather(weights_address(value, lanes, b), lanes.neighbours, begin, theta, total.ctypes.data, end - begin,
                    lanes.shared[b])  # fmt: skip
        for v in range(LANES):
            i = lanes.nodes[b, v]
            p = total[0, v] + diagonal[i] * theta[i]
            if slope.shape[0] > 0:
                p *= slope[i]
            pressure[i] = p
            r[LANES * PRESSURE_ROW + v] = lame * p
            r[LANES * FACTOR_ROWS + v] = stiffness[i, 0] if stiffness.shape[0] > 0 else 1.0
            r[LANES * (FACTOR_ROWS + 1) + v] = stiffness[i, 1] if stiffness.shape[0] > 0 else 1.0
        _sum_stresses(r)
        if overstress.shape[0] > 0:
            for q in range(9):
                for v in range(LANES):
                    r[LANES * q + v] += r[LANES * (FACTOR_ROWS + 1) + v] * overstress[b, q, v]
        lanes_to_nodes(r, flux, LANES * b)


@kernel_njit(inner=True, cached=False, fastmath={"contract"}, forceinline=True)
def _sum_stresses(r):
    """Write the stresses and residual forces of a block, times their stiffness factors, into its first rows."""
    for v in range(LANES):
        p, law, shear = r[LANES * PRESSURE_ROW + v], r[LANES * FACTOR_ROWS + v], r[LANES * (FACTOR_ROWS + 1) + v]
        r[v] = law * r[LANES * STRESS + v] + p * r[LANES * COFACTOR + v]
        r[LANES + v] = law * r[LANES * (STRESS + 1) + v] + p * r[LANES * (COFACTOR + 1) + v]
        r[2 * LANES + v] = law * r[LANES * (STRESS + 2) + v] + p * r[LANES * (COFACTOR + 2) + v]
        r[3 * LANES + v] = law * r[LANES * (STRESS + 3) + v] + p * r[LANES * (COFACTOR + 3) + v]
        r[4 * LANES + v] = law * r[LANES * (STRESS + 4) + v] + p * r[LANES * (COFACTOR + 4) + v]
        r[5 * LANES + v] = law * r[LANES * (STRESS + 5) + v] + p * r[LANES * (COFACTOR + 5) + v]
        r[6 * LANES + v] = law * r[LANES * (STRESS + 6) + v] + p * r[LANES * (COFACTOR + 6) + v]
        r[7 * LANES + v] = law * r[LANES * (STRESS + 7) + v] + p * r[LANES * (COFACTOR + 7) + v]
        r[8 * LANES + v] = law * r[LANES * (STRESS + 8) + v] + p * r[LANES * (COFACTOR + 8) + v]
        r[9 * LANES + v] = shear * r[LANES * (STRESS + 9) + v]
        r[10 * LANES + v] = shear * r[LANES * (STRESS + 10) + v]
        r[11 * LANES + v] = shear * r[LANES * (STRESS + 11) + v]


@kernel_njit(inner=True)
def _scale_by_stiffness(stiffness, theta, scaled):
    """Multiply theta of every node by its stiffness factor."""
    for i in range(stiffness.shape[0]):
        scaled[i] = stiffness[i, 2] * theta[i]


@kernel_njit(inner=True)
def _update_least(values, least):
    """Update the least value; NaN counts as -inf."""
    for value in values:
        if not value >= least[0]:
            least[0] = value if value == value else -np.inf


@cache
def _completion(relaxing: bool) -> Any:
    """Compile ``complete(body, work)``: the total stresses from the results of the deformation pass."""

    @law_njit(law_digest(__name__, "completion", relaxing), inline="always")
    def complete(body, work):
        _update_least(work.dilatation, work.least)
        smoothing = body.smoothing
        smooth_field(smoothing.lanes, smoothing.weights, smoothing.own, work.derivatives, work.dilatation, work.smooth)
        effective = work.smooth
        if relaxing:
            overstress(body.relaxation, work.history, work.cofactor)
            relax_volume(body.relaxation, work.history, work.smooth)
            effective = work.history.effective
        if body.stiffness.shape[0] > 0:
            _scale_by_stiffness(body.stiffness, effective, work.scaled)
            effective = work.scaled
        _add_pressure(smoothing.transposed, smoothing.transposed_weights, smoothing.own, body.lame, effective,
                      work.slope, body.stiffness, work.history.stress, work.derivatives, work.response, work.pressure,
                      work.flux)  # fmt: skip

    return complete


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
                    work += flux[i, c, 3] * table[b, m, 9 + c, lane]
                    for d in range(3):
                        work += flux[i, c, d] * table[b, m, 3 * c + d, lane]
                total -= volumes[i] * work
            partial[b, m] = total


@cache
def _projection(relaxing: bool) -> Any:
    """Compile `Formulation.project`."""
    complete = _completion(relaxing)

    @law_njit(law_digest(__name__, "projection", relaxing))
    def project(table, body, work, volumes, partial, result):
        complete(body, work)
        _virtual_work(table, body.lanes.nodes, work.flux, volumes, partial)
        add_blocks(partial, result)

    return project


@kernel_njit(inner=True, cached=False, forceinline=True)
def _store_row_major(values, response, row, v):
    """Store nine numbers in nine rows of a lane."""
    response[LANES * row + v] = values[0]
    response[LANES * (row + 1) + v] = values[1]
    response[LANES * (row + 2) + v] = values[2]
    response[LANES * (row + 3) + v] = values[3]
    response[LANES * (row + 4) + v] = values[4]
    response[LANES * (row + 5) + v] = values[5]
    response[LANES * (row + 6) + v] = values[6]
    response[LANES * (row + 7) + v] = values[7]
    response[LANES * (row + 8) + v] = values[8]


def make_stress(digest: str, law_first: Any, variables: str = "invariants") -> Any:
    """Compile the shear stress of one point: P, cof(F) and J - 1 as functions of F - I.

    `law_first` are the first derivatives of the law's energy by its variables (`Material.variables`), or a compiled
    function in their place. ``stress(d0, ..., d8, coefficients)`` takes F - I row by row, and returns two tuples of
    nine numbers, row by row, and J - 1.
    """
    if variables == "stretches":
        return make_principal_stress(digest, law_first)
    if variables == "small strain":
        return make_linear_stress(digest)
    first_of = inline(digest, law_first)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        F00, F01, F02, F10, F11, F12, F20, F21, F22 = 1.0 + d0, d1, d2, d3, 1.0 + d4, d5, d6, d7, 1.0 + d8
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
        W1, W2, WJ = first_of(I1, I2, J, coefficients)
        B = 2.0 * W2
        A = 2.0 * W1 + B * I1
        P = (
            A * F00 - B * (F00 * C00 + F01 * C01 + F02 * C02) + WJ * c00,
            A * F01 - B * (F00 * C01 + F01 * C11 + F02 * C12) + WJ * c01,
            A * F02 - B * (F00 * C02 + F01 * C12 + F02 * C22) + WJ * c02,
            A * F10 - B * (F10 * C00 + F11 * C01 + F12 * C02) + WJ * c10,
            A * F11 - B * (F10 * C01 + F11 * C11 + F12 * C12) + WJ * c11,
            A * F12 - B * (F10 * C02 + F11 * C12 + F12 * C22) + WJ * c12,
            A * F20 - B * (F20 * C00 + F21 * C01 + F22 * C02) + WJ * c20,
            A * F21 - B * (F20 * C01 + F21 * C11 + F22 * C12) + WJ * c21,
            A * F22 - B * (F20 * C02 + F21 * C12 + F22 * C22) + WJ * c22,
        )
        return P, (c00, c01, c02, c10, c11, c12, c20, c21, c22), J - 1.0

    return stress


def _make_node_response(digest: str, law: type[Material], volumetric: str, fibres: FibrePoints, varied: int) -> Any:
    """Compile the response of one block: shear stress, residual forces, cofactor and volumetric measure."""
    stress, add_stress, at = make_stress(digest, law.first, law.variables), fibres.add_stress, parameters_at(varied)
    curved, measure = volumetric != QUADRATIC, inline(digest, volumetric_form(volumetric).measure)

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"}, forceinline=True)
    def node_response(b, nodes, r, coefficients, hourglass, families, cofactor, dilatation, slope):
        for v in range(LANES):
            d0, d1, d2 = r[v], r[LANES + v], r[2 * LANES + v]
            d3, d4, d5 = r[3 * LANES + v], r[4 * LANES + v], r[5 * LANES + v]
            d6, d7, d8 = r[6 * LANES + v], r[7 * LANES + v], r[8 * LANES + v]
            P, c, volume = stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, at(coefficients, b, v))
            P = add_stress(P, d0, d1, d2, d3, d4, d5, d6, d7, d8, b, v, families)
            _store_row_major(P, r, STRESS, v)
            _store_row_major(c, r, COFACTOR, v)
            for w in range(3):
                r[LANES * (STRESS + 9 + w) + v] = hourglass * r[LANES * (9 + w) + v]
            r[LANES * DILATATION + v] = volume
        for q in range(9):
            for v in range(LANES):
                cofactor[b, q, v] = r[LANES * (COFACTOR + q) + v]
        for v in range(LANES):
            i = nodes[b, v]
            if curved:
                dilatation[i], slope[i] = measure(r[LANES * DILATATION + v])
            else:
                dilatation[i] = r[LANES * DILATATION + v]

    return node_response


def _make_responses(digest: str, node_response: Any) -> tuple[Any, Any]:
    """Compile the deformation passes for displacements, in double and in single precision."""

    @law_njit(digest, inner=True, parallel=True, fastmath={"contract"})
    def each(u, rows, frame, law, hourglass, families, sums, response, cofactor, dilatation, slope):
        for block in prange(rows.nodes.shape[0]):
            b = np.int64(block)
            out = response[b]
            _lift(b, u, rows, sums[get_thread_id()], out)
            for q in range(9):
                for v in range(LANES):
                    out[LANES * q + v] += frame[q]
            node_response(b, rows.nodes, out, law, hourglass, families, cofactor, dilatation, slope)

    @law_njit(digest, inline="always")
    def respond(u, body, work):
        field = u
        if body.mirror.source.shape[0] > 0:
            fill_vectors(u, body.mirror, work.reflected)
            field = work.reflected
        each(field, body.lanes, work.frame, body.coefficients, body.hourglass, body.families,
             work.sums, work.response, work.cofactor, work.dilatation, work.slope)  # fmt: skip

    @law_njit(digest, inline="always")
    def respond_in_single(u, body, work):
        field = u
        if body.mirror.source.shape[0] > 0:
            fill_vectors(u, body.mirror, work.reflected)
            field = work.reflected
        _anchor(field, body, work.frame, work.anchored)
        each(work.anchored, body.lanes, work.frame, body.coefficients, body.hourglass, body.families,
             work.sums, work.response, work.cofactor, work.dilatation, work.slope)  # fmt: skip

    return respond, respond_in_single


def _make_response_to_columns(digest: str, node_response: Any) -> Any:
    """Compile the deformation pass for combinations of vectors with known derivatives."""

    @law_njit(digest, inner=True, parallel=True, fastmath={"contract"})
    def each_column(
        columns, table, nodes, law, hourglass, families, derivatives, response, cofactor, dilatation, slope
    ):
        for block in prange(table.shape[0]):
            b = np.int64(block)
            gradient, out = derivatives[get_thread_id()], response[b]
            combine(b, columns, table, gradient)
            for q in range(NODE_NUMBERS):
                for v in range(LANES):
                    out[LANES * q + v] = gradient[q, v]
            node_response(b, nodes, out, law, hourglass, families, cofactor, dilatation, slope)

    @law_njit(digest, inline="always")
    def respond_to_columns(columns, table, body, work):
        each_column(columns, table, body.lanes.nodes, body.coefficients, body.hourglass, body.families,
                    work.derivatives, work.response, work.cofactor, work.dilatation, work.slope)  # fmt: skip

    return respond_to_columns


@cache
def solid_energy(
    law: type[Material],
    volumetric: str = QUADRATIC,
    fibres: FibrePoints = NO_FIBRES,
    varied: int = NO_FIELDS,
    relaxing: bool = False,
) -> Formulation:
    """Compile the passes of a solid with the functions of a law, without its parameters.

    `volumetric` is the form of U(J); `varied` is the number of parameters that differ from node to node. `relaxing`
    tissue has a Prony series. The passes of other tissue compute no history variables.
    """
    measure_of = volumetric_form(volumetric).measure
    digest = law_digest(__name__, "solid energy", law.variables, law.first, measure_of, fibres.digest, varied, relaxing)
    node_response, complete = _make_node_response(digest, law, volumetric, fibres, varied), _completion(relaxing)
    respond, respond_in_single = _make_responses(digest, node_response)
    respond_to_columns = _make_response_to_columns(digest, node_response)
    following = after if relaxing else without_history

    @law_njit(digest, inline="always")
    def finish(body, work, force):
        complete(body, work)
        fill_fluxes(body.flux_mirror, work.flux)
        _gather_fluxes(body.transposed, work.flux, force)

    of_steps = law_digest(__name__, digest, "in single precision")
    single = Formulation(of_steps, NODE_NUMBERS, respond_in_single, None, None, finish, None, following)
    return Formulation(
        digest, NODE_NUMBERS, respond, respond_to_columns, _differentiate, finish, _projection(relaxing), following,
        single,
    )  # fmt: skip
