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
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import get_thread_id, prange
from numpy.typing import NDArray

from palpate.dynamics.compiled.cache import inline, kernel_njit, law_digest, law_njit
from palpate.dynamics.compiled.lanes import LANES, Lanes, Weights, lane_sums_3x1, lane_sums_3x3
from palpate.dynamics.compiled.passes import Formulation, add_blocks, combine, gather_fluxes, lift_passes, smooth_field
from palpate.dynamics.material.fibres import NO_FIBRES, Families, FibrePoints
from palpate.dynamics.material.material_fields import EVERYWHERE, parameters_at
from palpate.dynamics.material.principal_stretches import make_principal_stress
from palpate.dynamics.material.relaxation import HistoryVariables, Relaxation, after, history, overstress, relax_volume
from palpate.dynamics.material.small_strain import make_linear_stress
from palpate.tissue.materials import Material
from palpate.tissue.volumetric import QUADRATIC, volumetric_form

__all__ = ["EnergyBody", "EnergyWork", "energy_work", "make_stress", "solid_energy"]

NUMBERS = 12  # per node: du_c/dX_d as 3 c + d, then the residuals e_c


class EnergyBody(NamedTuple):
    """Constants of a body for the compiled passes."""

    lanes: Lanes
    first: Weights
    second: Weights  # of the residuals e
    transposed: Lanes  # of every node, the nodes whose stencils contain it
    back: Weights  # their four weights on it, times the ratio of the volumes
    own: NDArray[np.float64]  # (n, 4) own weights
    smoothing: Lanes
    value: Weights
    smoothing_own: NDArray[np.float64]  # (n,)
    transposed_smoothing: Lanes
    transposed_value: Weights
    coefficients: tuple[float, ...] | NDArray[np.float64]  # by lane if they differ
    lame: float
    hourglass: float  # s [Pa/m^2]
    relaxation: Relaxation
    stiffness: NDArray[np.float64]  # (n, 3) factors of the law, of s and of lame; empty if all are 1
    families: Families  # of fibres


class EnergyWork(NamedTuple):
    """Scratch arrays of the passes."""

    fields: NDArray[np.float64]  # (threads, k, 3, LANES) neighbours' differences, or their fluxes
    derivatives: NDArray[np.float64]  # (threads, 12, LANES)
    cofactor: NDArray[np.float64]  # (b, 9, LANES)
    flux: NDArray[np.float64]  # (n, 12): P_cd [Pa] as 3 d + c, then s e_c
    dilatation: NDArray[np.float64]  # (n,) J - 1, or g(J)
    slope: NDArray[np.float64]  # (n,) g'(J); empty if it is 1
    smooth: NDArray[np.float64]  # (n,) theta
    pressure: NDArray[np.float64]  # (n,) [Pa]
    history: HistoryVariables  # of viscoelastic tissue
    scaled: NDArray[np.float64]  # (n,) theta times its stiffness factor
    least: NDArray[np.float64]  # (1,) least dilatation of all evaluations in a call of the step


def energy_work(
    nodes: int, blocks: int, longest: int, threads: int, branches: int, volumetric: str = QUADRATIC
) -> EnergyWork:
    """Allocate scratch arrays for `nodes` in `blocks` with at most `longest` neighbours."""
    return EnergyWork(
        np.zeros((threads, longest, 3, LANES)),
        np.zeros((threads, NUMBERS, LANES)),
        np.zeros((blocks, 9, LANES)),
        np.zeros((nodes, NUMBERS)),
        np.zeros(nodes),
        np.zeros(0 if volumetric == QUADRATIC else nodes),
        np.zeros(nodes),
        np.zeros(nodes),
        history(branches, blocks, nodes),
        np.zeros(nodes),
        np.zeros(1),
    )


_lift, _differentiate = lift_passes("solid energy", lane_sums_3x3, lane_sums_3x1, 9)


@kernel_njit(parallel=True, fastmath={"contract"})
def _add_pressure(lanes, cofactor, pressure, lame, flux):  # type: ignore[no-untyped-def]
    """Add lame p cof(F) to the stresses, with p the result of the transposed smoothing."""
    for b in prange(lanes.nodes.shape[0]):
        for lane in range(LANES):
            i = lanes.nodes[b, lane]
            if lane > 0 and i == lanes.nodes[b, lane - 1]:
                break  # the last node of an unfilled block is repeated
            for c in range(3):
                for d in range(3):
                    flux[i, 3 * d + c] += lame * pressure[i] * cofactor[b, 3 * c + d, lane]


@kernel_njit(parallel=True)
def _add_overstress(lanes, stress, stiffness, flux):  # type: ignore[no-untyped-def]
    """Add the overstresses (b, 9, LANES), scaled like the shear modulus, to the stresses."""
    for b in prange(lanes.nodes.shape[0]):
        for lane in range(LANES):
            i = lanes.nodes[b, lane]
            if lane > 0 and i == lanes.nodes[b, lane - 1]:
                break  # the last node of an unfilled block is repeated
            factor = stiffness[i, 1] if stiffness.shape[0] > 0 else 1.0
            for c in range(3):
                for d in range(3):
                    flux[i, 3 * d + c] += factor * stress[b, 3 * c + d, lane]


@kernel_njit()
def _scale_by_stiffness(stiffness, flux, theta, scaled):  # type: ignore[no-untyped-def]
    """Multiply the fluxes and theta of every node by its stiffness factors."""
    for i in range(stiffness.shape[0]):
        for q in range(NUMBERS):
            flux[i, q] *= stiffness[i, 0] if q < 9 else stiffness[i, 1]
        scaled[i] = stiffness[i, 2] * theta[i]


@kernel_njit()
def _update_least(values, least):  # type: ignore[no-untyped-def]
    """Update the least value; NaN counts as -inf."""
    for value in values:
        if not value >= least[0]:
            least[0] = value if value == value else -np.inf


@kernel_njit(inner=True)
def _complete(body, work):  # type: ignore[no-untyped-def]
    """Compute the total stresses from the results of the deformation pass."""
    _update_least(work.dilatation, work.least)
    smooth_field(
        body.smoothing, body.value, body.smoothing_own, work.fields, work.derivatives, work.dilatation, work.smooth
    )
    effective = work.smooth
    if body.relaxation.times.shape[0] > 0:
        overstress(body.relaxation, work.history, work.cofactor)
        relax_volume(body.relaxation, work.history, work.smooth)
        effective = work.history.effective
    if body.stiffness.shape[0] > 0:
        _scale_by_stiffness(body.stiffness, work.flux, effective, work.scaled)
        effective = work.scaled
    if body.relaxation.times.shape[0] > 0:
        _add_overstress(body.lanes, work.history.stress, body.stiffness, work.flux)
    smooth_field(body.transposed_smoothing, body.transposed_value, body.smoothing_own, work.fields, work.derivatives,
            effective, work.pressure)  # fmt: skip
    for i in range(work.slope.shape[0]):
        work.pressure[i] *= work.slope[i]
    _add_pressure(body.lanes, work.cofactor, work.pressure, body.lame, work.flux)


@kernel_njit(parallel=True, fastmath={"contract"})
def _virtual_work(table, nodes, flux, volumes, partial):  # type: ignore[no-untyped-def]
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
                    work += flux[i, 9 + c] * table[b, m, 9 + c, lane]
                    for d in range(3):
                        work += flux[i, 3 * d + c] * table[b, m, 3 * c + d, lane]
                total -= volumes[i] * work
            partial[b, m] = total


@kernel_njit()
def _project(table, body, work, volumes, partial, result):  # type: ignore[no-untyped-def]
    _complete(body, work)
    _virtual_work(table, body.lanes.nodes, work.flux, volumes, partial)
    add_blocks(partial, result)


def make_stress(digest: str, law_first: Any, variables: str = "invariants") -> Any:
    """Compile the shear stress of one point: P, cof(F) and J - 1 as functions of F - I.

    Parameters
    ----------
    digest : str
    law_first : function
        First derivatives of the law's energy, or a compiled function in their place.
    variables : str
        Variables of the derivatives (`Material.variables`).

    Returns
    -------
    function
        ``stress(d0, ..., d8, coefficients)`` takes F - I row by row, and returns two tuples of nine
        numbers, row by row, and J - 1.
    """
    if variables == "stretches":
        return make_principal_stress(digest, law_first)
    if variables == "small strain":
        return make_linear_stress(digest)
    first_of = inline(digest, law_first)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):  # type: ignore[no-untyped-def]
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


@cache
def solid_energy(
    law: type[Material], volumetric: str = QUADRATIC, fibres: FibrePoints = NO_FIBRES, varied: int = EVERYWHERE
) -> Formulation:
    """Compile the passes of a solid.

    Parameters
    ----------
    law : type
        Material whose functions are compiled, without its parameters.
    volumetric : str
        Form of U(J).
    fibres : FibrePoints
    varied : int
        Number of parameters that differ from node to node.
    """
    measure_of, curved = volumetric_form(volumetric).measure, volumetric != QUADRATIC
    digest = law_digest(__name__, "solid energy", law.variables, law.first, measure_of, fibres.digest, varied)
    stress, add_stress, at = make_stress(digest, law.first, law.variables), fibres.add_stress, parameters_at(varied)
    measure = inline(digest, measure_of)

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"}, forceinline=True)
    def node_response(b, nodes, d, coefficients, hourglass, families, cofactor, flux, dilatation, slope):  # type: ignore[no-untyped-def]
        for v in range(LANES):
            P, c, volume = stress(
                d[0, v], d[1, v], d[2, v], d[3, v], d[4, v], d[5, v], d[6, v], d[7, v], d[8, v],
                at(coefficients, b, v),
            )  # fmt: skip
            P = add_stress(
                P, d[0, v], d[1, v], d[2, v], d[3, v], d[4, v], d[5, v], d[6, v], d[7, v], d[8, v], b, v, families
            )
            i = nodes[b, v]
            flux[i, 0], flux[i, 3], flux[i, 6] = P[0], P[1], P[2]
            flux[i, 1], flux[i, 4], flux[i, 7] = P[3], P[4], P[5]
            flux[i, 2], flux[i, 5], flux[i, 8] = P[6], P[7], P[8]
            for w in range(3):
                flux[i, 9 + w] = hourglass * d[9 + w, v]
                cofactor[b, w, v], cofactor[b, 3 + w, v], cofactor[b, 6 + w, v] = c[w], c[3 + w], c[6 + w]
            if curved:
                d[0, v] = volume
            else:
                dilatation[i] = volume
        if curved:
            for v in range(LANES):
                i = nodes[b, v]
                dilatation[i], slope[i] = measure(d[0, v])

    @law_njit(digest, inner=True, parallel=True, fastmath={"contract"})
    def each(u, lanes, first, second, law, hourglass, families, fields, derivatives, cofactor, flux, dilatation, slope):  # type: ignore[no-untyped-def]
        for b in prange(lanes.nodes.shape[0]):
            out = derivatives[get_thread_id()]
            _lift(b, u, lanes, first, second, fields[get_thread_id()], out)
            node_response(b, lanes.nodes, out, law, hourglass, families, cofactor, flux, dilatation, slope)

    @law_njit(digest, inner=True)
    def respond(u, body, work):  # type: ignore[no-untyped-def]
        each(u, body.lanes, body.first, body.second, body.coefficients, body.hourglass, body.families,
             work.fields, work.derivatives, work.cofactor, work.flux, work.dilatation, work.slope)  # fmt: skip

    @law_njit(digest, inner=True, parallel=True, fastmath={"contract"})
    def each_column(columns, table, lanes, law, hourglass, families, derivatives, cofactor, flux, dilatation, slope):  # type: ignore[no-untyped-def]
        for b in prange(table.shape[0]):
            out = derivatives[get_thread_id()]
            combine(b, columns, table, out)
            node_response(b, lanes.nodes, out, law, hourglass, families, cofactor, flux, dilatation, slope)

    @law_njit(digest, inner=True)
    def respond_to_columns(columns, table, body, work):  # type: ignore[no-untyped-def]
        each_column(columns, table, body.lanes, body.coefficients, body.hourglass, body.families,
                    work.derivatives, work.cofactor, work.flux, work.dilatation, work.slope)  # fmt: skip

    @law_njit(digest, inner=True)
    def finish(body, work, force):  # type: ignore[no-untyped-def]
        _complete(body, work)
        gather_fluxes(body.transposed, body.back, body.own, work.fields, work.derivatives, work.flux, force)

    return Formulation(digest, NUMBERS, respond, respond_to_columns, _differentiate, finish, _project, after)
