"""The common passes of the compiled forces of solids and membranes.

A *formulation* computes forces from displacements, or from few coordinates, in two passes over blocks
of `LANES` nodes. The first computes the derivatives and the material response of every node, the
second the force at every node. Each node's result is independent of the others, so the bits are equal
for any number of threads.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from numba import get_thread_id, prange

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.lanes import LANES, lane_gather


@kernel_njit(inline="always")
def without_history(work, interval):
    """Do nothing: `Formulation.after` of a body without history variables."""


class Formulation(NamedTuple):
    """The compiled passes of a body, for one material law."""

    digest: str  # digest of all sources of the passes
    numbers: int  # derivatives per node: 27 in a solid (12 in its energy form), 15 in a membrane
    respond: Any  # ``respond(u, body, work)`` computes the responses of all nodes to displacements (n, 3)
    # ``respond_to_columns(columns, table, body, work)`` does so for the coordinates (m,) of basis vectors, whose
    # derivatives are in a table (b, m, numbers, LANES)
    respond_to_columns: Any
    differentiate: Any  # ``differentiate(modes, body, work, table)`` writes that table for basis vectors (m, n, 3)
    finish: Any  # ``finish(body, work, force)`` computes the nodal forces [N/m^3] from the responses
    # ``project(table, body, work, volumes, partial, result)`` computes the virtual work of the responses on the basis
    # vectors, with partial sums (b, m). None unless the forces are the derivative of an energy.
    project: Any = None
    # ``after(work, interval)`` sets the interval [s] after which the next evaluation updates the history variables; 0
    # for no update
    after: Any = without_history
    # passes of the steps in single precision, for other constants and scratch arrays; see
    # `palpate.dynamics.solid.energy_form.body_in_single`
    single: Any = None

    @property
    def of_steps(self) -> Formulation:
        """The passes of explicit steps: in single precision where there are such."""
        return self if self.single is None else self.single


@kernel_njit(inner=True, forceinline=True)
def weights_address(weights, lanes, b):
    """Return the address of the weights of block b."""
    if lanes.shared[b]:
        return weights.one[lanes.weight_start[b] :].ctypes.data
    return weights.lanes[lanes.weight_start[b] :].ctypes.data


@kernel_njit(fastmath={"contract"}, forceinline=True)
def differences(b, u, lanes, fields):
    """Gather u_J - u_I of the neighbours J of the nodes I of a block; return the number of neighbours."""
    begin, end = lanes.start[b], lanes.stop[b]
    for k in range(begin, end):
        for lane in range(LANES):
            i, j = lanes.nodes[b, lane], lanes.neighbours[k, lane]
            for c in range(3):
                fields[k - begin, c, lane] = u[j, c] - u[i, c]
    return end - begin


@kernel_njit(inner=True, fastmath={"contract"})
def combine(b, columns, table, out):
    """Compute the derivatives of one block from the coordinates of basis vectors."""
    for q in range(table.shape[2]):
        for lane in range(LANES):
            out[q, lane] = table[b, 0, q, lane] * columns[0]
    for m in range(1, table.shape[1]):
        for q in range(table.shape[2]):
            for lane in range(LANES):
                out[q, lane] += table[b, m, q, lane] * columns[m]


@kernel_njit(parallel=True, fastmath={"contract"})
def smooth_field(lanes, value, diagonal, sums, values, smooth):
    """Compute the fitted value of a nodal field (n,) at every node."""
    for b in prange(lanes.nodes.shape[0]):
        total = sums[get_thread_id()]
        begin, end = lanes.start[b], lanes.stop[b]
        lane_gather(weights_address(value, lanes, b), lanes.neighbours, begin, values, total.ctypes.data, end - begin,
                    lanes.shared[b])  # fmt: skip
        for lane in range(LANES):
            i = lanes.nodes[b, lane]
            smooth[i] = total[0, lane] + diagonal[i] * values[i]


@kernel_njit(inner=True)
def add_blocks(partial, result):
    """Sum partial results (b, m) over the blocks, in an order independent of the number of threads."""
    result[:] = 0.0
    for b in range(partial.shape[0]):
        for m in range(partial.shape[1]):
            result[m] += partial[b, m]


def lift_passes(name: str, first_sums: Any, second_sums: Any, first_numbers: int) -> tuple[Any, Any]:
    """Compile the passes that differentiate displacements: `lift`, and `differentiate` (see `Formulation`).

    ``lift(b, u, lanes, first, second, fields, out)`` writes the derivatives at the nodes of one block into out
    (numbers, LANES), the first `first_numbers` of which are first derivatives.
    """
    digest = law_digest(__name__, "lift", name, first_numbers)

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"})
    def lift(b, u, lanes, first, second, fields, out):
        count, shared = differences(b, u, lanes, fields), lanes.shared[b]
        rest = out[first_numbers:]
        first_sums(weights_address(first, lanes, b), fields.ctypes.data, out.ctypes.data, count, shared)
        second_sums(weights_address(second, lanes, b), fields.ctypes.data, rest.ctypes.data, count, shared)

    @law_njit(digest, inner=True, parallel=True)
    def lift_columns(modes, lanes, first, second, fields, table):
        for b in prange(lanes.nodes.shape[0]):
            for m in range(modes.shape[0]):
                lift(b, modes[m], lanes, first, second, fields[get_thread_id()], table[b, m])

    @law_njit(digest, nogil=True)
    def differentiate(modes, body, work, table):
        lift_columns(modes, body.lanes, body.first, body.second, work.fields, table)

    return lift, differentiate


@cache
def internal_force(formulation: Formulation) -> Any:
    """Compile ``internal_force(u, body, work, force)``, the force density [N/m^3] of displacements (n, 3)."""
    respond, finish = formulation.respond, formulation.finish

    @law_njit(formulation.digest, nogil=True)
    def internal_force(u, body, work, force):
        respond(u, body, work)
        finish(body, work, force)

    return internal_force
