"""Replacement of the stencils of cut nodes in the compiled tables of a body; all other entries are shared."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.lanes import LANES, Lanes, Weights, ranges, with_blocks
from palpate.compiled.rows import Rows, with_rows
from palpate.core.arrays import Floats, Ints
from palpate.dynamics.solid.energy_form import EnergyBody, SmoothingSums
from palpate.dynamics.solid.layout import Smoothing
from palpate.meshfree.cut.stencils import FittedRows
from palpate.meshfree.stencils import Stencils


class Entries(NamedTuple):
    """Weights (t, w) of neighbours (t,) in the rows of nodes (t,), without those of nodes on themselves."""

    node: Ints
    near: Ints
    weights: Floats

    def selected(self, mask: NDArray[np.bool_]) -> Entries:
        """Return some of the entries."""
        return Entries(self.node[mask], self.near[mask], self.weights[mask])

    def sums(self, volumes: Floats) -> Floats:
        """Return the sums over the nodes of their volumes times their weights, at every neighbour and node, (n, w)."""
        shares = volumes[self.node, None] * self.weights
        result = np.zeros((len(volumes), self.weights.shape[1]))
        np.add.at(result, self.near, shares)
        np.subtract.at(result, self.node, shares)
        return result


def row_entries(rows: Rows, nodes: Ints) -> Entries:
    """Return the entries of some nodes."""
    row, entry = ranges(rows.start[nodes], rows.stop[nodes])
    place = entry - rows.start[nodes][row] + rows.weight_start[nodes][row]
    node, near = nodes[row], rows.neighbours[entry].astype(np.int64)
    off_diagonal = near != node
    return Entries(node[off_diagonal], near[off_diagonal], rows.weights[place[off_diagonal]])


def smoothing_entries(lanes: Lanes, weights: Weights, nodes: Ints) -> Entries:
    """Return the entries of some nodes; block b has the nodes from b times `LANES` on."""
    block, lane = nodes // LANES, nodes % LANES
    row, entry = ranges(lanes.start[block], lanes.stop[block])
    place = entry - lanes.start[block][row] + lanes.weight_start[block][row]
    node, near = nodes[row], lanes.neighbours[entry, lane[row]].astype(np.int64)
    off_diagonal = near != node
    return Entries(
        node[off_diagonal], near[off_diagonal], weights.lanes[place[off_diagonal], :, lane[row[off_diagonal]]]
    )


def fitted_entries(rows: FittedRows) -> tuple[Entries, Entries]:
    """Return the entries of derivatives and residual, and those of the smoothing."""
    node = np.repeat(rows.nodes, np.diff(rows.start))
    both = np.column_stack([rows.first, rows.residual])
    used, smoothed = np.any(both != 0.0, axis=1), rows.smoothing != 0.0
    return (
        Entries(node[used], rows.near[used], both[used]),
        Entries(node[smoothed], rows.near[smoothed], rows.smoothing[smoothed, None]),
    )


def stencils_of(body: EnergyBody, n: int) -> Stencils:
    """Return the stencils of a body without images, one row of weights a node."""
    near, weights = _table(row_entries(body.lanes, np.arange(n)), n)
    first, nothing = np.ascontiguousarray(weights[..., :3]), np.zeros((0, 0, 0))
    return Stencils(
        neighbours=near, row=np.arange(n, dtype=np.int32), value=np.ascontiguousarray(weights[..., 3]), first=first,
        second=nothing, own=np.ones(n), own_first=-first.sum(axis=1), own_second=np.zeros((n, 0)),
        condition=np.zeros(0),
    )  # fmt: skip


def smoothing_of(body: EnergyBody, n: int) -> Smoothing:
    """Return the smoothing of a body."""
    near, weights = _table(smoothing_entries(body.smoothing.lanes, body.smoothing.weights, np.arange(n)), n)
    return Smoothing(near, np.ascontiguousarray(weights[..., 0]), body.smoothing.own)


def _table(entries: Entries, n: int) -> tuple[NDArray[np.int32], Floats]:
    """Return entries in the order of their nodes as padded rows of neighbours (n, k) and weights (n, k, w)."""
    count = np.bincount(entries.node, minlength=n)
    place = np.arange(len(entries.node)) - np.repeat(np.cumsum(count) - count, count)
    near = np.tile(np.arange(n, dtype=np.int32)[:, None], (1, int(count.max())))
    weights = np.zeros((*near.shape, entries.weights.shape[1]))
    near[entries.node, place], weights[entries.node, place] = entries.near, entries.weights
    return near, weights


def with_stencils(body: EnergyBody, nodes: Ints, stencils: Entries, smoothing: Entries, volumes: Floats) -> EnergyBody:
    """Return the constants of a body without images whose nodes (m,), in ascending order, have other stencils.

    `stencils` and `smoothing` are entries of these nodes, in their order; `volumes` are (n,) [m^3].
    """
    n, sums = len(volumes), body.smoothing
    changed = np.zeros(n, dtype=np.bool_)
    changed[nodes] = True
    before = row_entries(body.lanes, nodes)
    receivers = np.unique(np.concatenate([nodes, before.near, stencils.near]))
    lanes = with_rows(body.lanes, nodes, *_counted(stencils, nodes))
    transposed = with_rows(
        body.transposed, receivers, *_transposed(body.transposed, receivers, changed, stencils, volumes)
    )
    smooth_before = smoothing_entries(sums.lanes, sums.weights, nodes)
    smooth_receivers = np.unique(np.concatenate([smooth_before.near, smoothing.near]))
    smoothing_lanes, value = _with_smoothing(sums.lanes, sums.weights, nodes, smoothing)
    back = smoothing_entries(sums.transposed, sums.transposed_weights, smooth_receivers)
    unchanged = back.selected(~changed[back.near])
    back_lanes, back_value = _with_smoothing(
        sums.transposed, sums.transposed_weights, smooth_receivers,
        _merged([unchanged, _turned(smoothing, volumes)]),
    )  # fmt: skip
    diagonal = sums.own.copy()
    diagonal[nodes] = 1.0
    np.subtract.at(diagonal, smoothing.node, smoothing.weights[:, 0])
    smoothing_sums = SmoothingSums(smoothing_lanes, value, diagonal, back_lanes, back_value)
    return body._replace(lanes=lanes, transposed=transposed, smoothing=smoothing_sums)


def _turned(entries: Entries, volumes: Floats) -> Entries:
    """Return the transposed entries: of a neighbour's row, with the node as its neighbour."""
    ratio = volumes[entries.node] / volumes[entries.near]
    return Entries(entries.near, entries.node, entries.weights * ratio[:, None])


def _merged(parts: list[Entries]) -> Entries:
    """Return the entries of all parts, each once, in the order of their nodes and neighbours."""
    node, near, weights = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(node * (np.int64(near.max(initial=0)) + 1) + near)
    return Entries(node[order], near[order], weights[order])


def _counted(entries: Entries, nodes: Ints) -> tuple[NDArray[np.int64], NDArray[np.int32], Floats]:
    """Return the number of entries of every node, their neighbours and their weights."""
    count = np.bincount(np.searchsorted(nodes, entries.node), minlength=len(nodes))
    return count, entries.near.astype(np.int32), entries.weights


def _transposed(
    rows: Rows, receivers: Ints, changed: NDArray[np.bool_], stencils: Entries, volumes: Floats
) -> tuple[NDArray[np.int64], NDArray[np.int32], Floats]:
    """Return the transposed rows of nodes, with the weights of a node on itself."""
    row, entry = ranges(rows.start[receivers], rows.stop[receivers])
    place = entry - rows.start[receivers][row] + rows.weight_start[receivers][row]
    node, near = receivers[row], rows.neighbours[entry].astype(np.int64)
    itself, width = near == node, stencils.weights.shape[1]
    weights = rows.weights[place, :width]
    diagonal = np.zeros((len(changed), width))
    np.add.at(diagonal, node[itself], weights[itself])
    diagonal[changed] = 0.0
    np.subtract.at(diagonal, stencils.node, stencils.weights)
    unchanged = ~itself & ~changed[near]
    parts = [Entries(node[unchanged], near[unchanged], weights[unchanged]), _turned(stencils, volumes)]
    return _counted(_merged([*parts, Entries(receivers, receivers, diagonal[receivers])]), receivers)


def _with_smoothing(lanes: Lanes, weights: Weights, nodes: Ints, entries: Entries) -> tuple[Lanes, Weights]:
    """Return smoothing stencils with other entries for some nodes."""
    blocks = np.unique(nodes // LANES)
    other = np.setdiff1d((blocks[:, None] * LANES + np.arange(LANES)).ravel(), nodes)
    other = other[other <= lanes.nodes[-1, -1]]
    total = _merged([smoothing_entries(lanes, weights, other), entries])
    block, lane = np.searchsorted(blocks, total.node // LANES), total.node % LANES
    first = np.concatenate([[True], np.diff(total.node) != 0]) if len(total.node) else np.zeros(0, dtype=bool)
    place = np.arange(len(total.node)) - np.flatnonzero(first)[np.cumsum(first) - 1]
    longest = max(int(place.max(initial=-1)) + 1, 1)  # the loop of the sums runs at least once
    near = np.broadcast_to(lanes.nodes[blocks][:, None], (len(blocks), longest, LANES)).copy()
    values: Any = np.zeros((len(blocks), longest, LANES))
    near[block, place, lane], values[block, place, lane] = total.near, total.weights[:, 0]
    return with_blocks(lanes, weights, blocks, near, values)
