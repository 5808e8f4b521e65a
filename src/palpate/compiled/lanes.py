"""Stencil sums for several nodes in the vector lanes of the processor.

Nodes are processed in blocks of `LANES`. A block whose nodes share one arrangement of neighbours (the
interior of a lattice) stores one number per weight and broadcasts it. Any other block stores one
number per weight and lane. The accumulators of a block are in vector registers. The compiler does not
do so for loops in Python, which requires the intrinsic.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

LANES = 8


class Lanes(NamedTuple):
    """Neighbours of one family of stencils, in blocks of `LANES` nodes."""

    nodes: NDArray[np.int32]  # (b, LANES) int32: nodes of every block; the last node of an unfilled block is repeated
    # start, stop: (b,) int64: first entry of every block in `neighbours`, and the one after its last
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    neighbours: NDArray[np.int32]  # (t, LANES) int32: neighbours of every lane
    shared: NDArray[np.bool_]  # (b,) bool: True for blocks whose nodes share their weights
    # (b,) int64: first entry of every block in the table of shared weights or of those by lane
    weight_start: NDArray[np.int64]


class Weights(NamedTuple):
    """Weights of `Lanes`: shared ones (s, r), and those by lane (t, r, LANES)."""

    one: NDArray[np.float64]
    lanes: NDArray[np.float64]


def lane_table(
    near: NDArray[np.int32], row: NDArray[np.integer[Any]], *tables: NDArray[np.float64]
) -> tuple[Lanes, tuple[Weights, ...]]:
    """Lay out stencils in blocks, with tables of weights (s, k) or (s, k, w) by row.

    `near` (n, k) and `row` (n,) are `Stencils.neighbours` and `Stencils.row`; padding is at the end of every row.
    """
    n, k = near.shape
    nodes, shared = _blocks(row)
    padding = near == np.arange(n)[:, None]
    length = (k - padding.sum(axis=1))[nodes].max(axis=1)
    start = np.concatenate([[0], np.cumsum(length)])
    block = np.repeat(np.arange(len(nodes)), length)
    position = np.arange(start[-1]) - start[block]
    separate = ~shared[block]

    # shared weights are stored once for every row that a block uses
    rows, first_block = np.unique(row[nodes[shared, 0]], return_index=True)
    row_length = length[shared][first_block]
    row_start = np.concatenate([[0], np.cumsum(row_length)]).astype(np.int64)
    r = np.repeat(np.arange(len(rows)), row_length)
    row_position = np.arange(row_start[-1]) - row_start[r]
    weight_start = np.zeros(len(nodes), dtype=np.int64)
    weight_start[shared] = row_start[np.searchsorted(rows, row[nodes[shared, 0]])]
    weight_start[~shared] = np.cumsum(length[~shared]) - length[~shared]

    weights = []
    for table in tables:
        table = table.reshape(len(table), k, -1)
        by_lane = np.empty((int(separate.sum()), table.shape[2], LANES))
        for lane in range(LANES):  # lane by lane, to store one copy only
            by_lane[:, :, lane] = table[row[nodes[block[separate], lane]], position[separate]]
        weights.append(Weights(np.ascontiguousarray(table[rows[r], row_position]), by_lane))
    neighbours = np.ascontiguousarray(near[nodes[block], position[:, None]])
    bounds = start[:-1].astype(np.int64), start[1:].astype(np.int64)
    return Lanes(nodes.astype(np.int32), *bounds, neighbours, shared, weight_start), tuple(weights)


def ranges(start: NDArray[np.int64], stop: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the row and the entry of all entries of rows that begin at `start` and end before `stop`."""
    count = stop - start
    row = np.repeat(np.arange(len(count)), count)
    return row, np.arange(len(row)) + np.repeat(start - np.cumsum(count) + count, count)


def transpose(
    neighbours: NDArray[np.int32], weights: NDArray[np.float64], volumes: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return the transposed stencils: the nodes whose stencils contain a node (n, t), and their weights (n, t, w).

    Rows are padded with the node itself. The weights are those of sums weighted by nodal volumes (areas
    of a sheet), per volume of the node.
    """
    node, position = np.nonzero(neighbours != np.arange(len(neighbours))[:, None])
    return gather_rows(node, neighbours[node, position], weights[node, position], volumes)


def gather_rows(
    node: NDArray[np.integer[Any]],
    receiver: NDArray[np.integer[Any]],
    weights: NDArray[np.float64],
    volumes: NDArray[np.float64],
    name: NDArray[np.integer[Any]] | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return rows of weights (n, t, w) for what nodes receive, and the names of the senders (n, t).

    Every entry has a `node` and a `receiver` (e,), and weights (e, w) of sums weighted by the volumes (n,) of the node.
    The name (e,) of a sender is by default the node.
    """
    n, name = len(volumes), node if name is None else name
    order = np.lexsort((name, receiver))
    node, name, receiver = node[order], name[order], receiver[order]
    count = np.bincount(receiver, minlength=n)
    column = np.arange(len(receiver)) - np.repeat(np.cumsum(count) - count, count)
    near = np.tile(np.arange(n, dtype=np.int32)[:, None], (1, count.max()))
    near[receiver, column] = name
    back = np.zeros((n, count.max(), weights.shape[1]))
    back[receiver, column] = weights[order] * (volumes[node] / volumes[receiver])[:, None]
    return near, back


def with_blocks(
    lanes: Lanes, weights: Weights, blocks: NDArray[np.integer[Any]], near: NDArray[np.int32], values: Any
) -> tuple[Lanes, Weights]:
    """Return stencils with one weight a neighbour, and other entries for some blocks, none of which shares weights.

    `blocks` (m,) get the neighbours `near` (m, k, LANES), padded with the node itself, and weights `values`
    (m, k, LANES).
    """
    lengths = lanes.stop - lanes.start
    lengths[blocks] = 0
    _, entry = ranges(lanes.start, lanes.start + lengths)
    _, weight_entry = ranges(lanes.weight_start, lanes.weight_start + lengths)
    start = np.cumsum(lengths) - lengths
    start[blocks] = len(entry) + near.shape[1] * np.arange(len(blocks))
    lengths[blocks] = near.shape[1]
    neighbours = np.concatenate([lanes.neighbours[entry], near.reshape(-1, LANES)])
    table = np.concatenate([weights.lanes[weight_entry], values.reshape(-1, 1, LANES)])
    changed = lanes._replace(start=start, stop=start + lengths, neighbours=neighbours, weight_start=start.copy())
    return changed, Weights(weights.one, table)


def _blocks(row: NDArray[np.integer[Any]]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Blocks of nodes, and whether each shares one row of weights: rows with fewer than LANES nodes go mixed."""
    large = (np.bincount(row) >= LANES)[row]
    mixed = np.flatnonzero(~large)
    together = np.lexsort((np.arange(len(row)), row))
    together = together[large[together]]
    groups = np.split(together, np.flatnonzero(np.diff(row[together])) + 1) if len(together) else []
    blocks, shared = [], []
    for group, is_shared in [(mixed, False)] * bool(len(mixed)) + [(g, True) for g in groups]:
        padded = np.concatenate([group, np.repeat(group[-1], -len(group) % LANES)])
        blocks.append(padded.reshape(-1, LANES))
        shared.append(np.full(len(blocks[-1]), is_shared))
    return np.concatenate(blocks), np.concatenate(shared)


def _lane_sums(fields: int, weights: int, name: str) -> Any:
    """Make the intrinsic out[f, w, :] = sum over k of weight[k, w, :] * field[k, f, :].

    Arguments are the addresses of the weights, the fields (k, fields, LANES) and the result, the number of
    neighbours, and whether the weights have one number (k, weights) or one a lane (k, weights, LANES).
    """

    def sums(typingctx, weight_at, field_at, out_at, count, shared):
        signature = types.void(types.intp, types.intp, types.intp, types.intp, types.boolean)

        def codegen(context, builder, signature, args):
            with builder.if_else(builder.trunc(args[4], ir.IntType(1))) as (then, otherwise):
                with then:
                    _emit_loop(builder, args[:4], fields, weights, broadcast=True)
                with otherwise:
                    _emit_loop(builder, args[:4], fields, weights, broadcast=False)
            return context.get_dummy_value()

        return signature, codegen

    sums.__name__ = sums.__qualname__ = name
    return intrinsic(sums)


def _emit_loop(builder: Any, args: list[Any], fields: int, weights: int, broadcast: bool) -> None:
    """Emit the loop over neighbours, with sums in vector registers."""
    weight_at, field_at, out_at, count = args
    i64, scalar = ir.IntType(64), ir.DoubleType()
    vector = ir.VectorType(scalar, LANES)
    weight_ptr = builder.inttoptr(weight_at, (scalar if broadcast else vector).as_pointer())
    field_ptr = builder.inttoptr(field_at, vector.as_pointer())
    out_ptr = builder.inttoptr(out_at, vector.as_pointer())
    zero = ir.Constant(vector, [0.0] * LANES)
    undefined = ir.Constant(vector, ir.Undefined)
    lane_zero = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)

    entry = builder.block
    loop = builder.append_basic_block("neighbour")
    end = builder.append_basic_block("sums.end")
    builder.branch(loop)
    builder.position_at_end(loop)
    k = builder.phi(i64)
    k.add_incoming(ir.Constant(i64, 0), entry)
    sums = [[builder.phi(vector) for _ in range(weights)] for _ in range(fields)]
    row = builder.mul(k, ir.Constant(i64, fields))
    at_field = [builder.gep(field_ptr, [builder.add(row, ir.Constant(i64, f))]) for f in range(fields)]
    load = [builder.load(at, align=8) for at in at_field]
    for w in range(weights):
        at = builder.add(builder.mul(k, ir.Constant(i64, weights)), ir.Constant(i64, w))
        weight = builder.load(builder.gep(weight_ptr, [at]), align=8)
        if broadcast:
            first = builder.insert_element(undefined, weight, ir.Constant(ir.IntType(32), 0))
            weight = builder.shuffle_vector(first, undefined, lane_zero)
        for f in range(fields):
            phi = sums[f][w]
            phi.add_incoming(zero, entry)
            product = builder.fmul(weight, load[f], flags=("contract",))
            phi.next_value = builder.fadd(product, phi, flags=("contract",))
    for row in sums:
        for phi in row:
            phi.add_incoming(phi.next_value, loop)
    following = builder.add(k, ir.Constant(i64, 1))
    k.add_incoming(following, loop)
    builder.cbranch(builder.icmp_signed("<", following, count), loop, end)
    builder.position_at_end(end)
    for f in range(fields):
        for w in range(weights):
            builder.store(sums[f][w].next_value, builder.gep(out_ptr, [ir.Constant(i64, f * weights + w)]), align=8)


@intrinsic
def lane_gather(typingctx, weight_at, neighbours, begin, values, out_at, count, shared):
    """out[:] = sum over k of weight[k, :] * values[neighbours[begin + k, :]], for one block.

    Arguments are the address of the weights, the neighbours (t, LANES) with the first entry of the block, the
    nodal values (n,), the address of the result, the number of neighbours, and whether the weights have one
    number (k,) or one a lane (k, LANES).
    """
    integers = (types.intp,) * 4
    signature = types.void(integers[0], neighbours, integers[1], values, integers[2], integers[3], types.boolean)

    def codegen(context, builder, signature, args):
        near, field = (context.make_array(signature.args[k])(context, builder, args[k]).data for k in (1, 3))
        index = builder.gep(near, [builder.mul(args[2], ir.Constant(ir.IntType(64), LANES))])
        with builder.if_else(builder.trunc(args[6], ir.IntType(1))) as (then, otherwise):
            with then:
                _emit_gather(builder, args[0], index, field, args[4], args[5], broadcast=True)
            with otherwise:
                _emit_gather(builder, args[0], index, field, args[4], args[5], broadcast=False)
        return context.get_dummy_value()

    return signature, codegen


def _emit_gather(
    builder: Any, weight_at: Any, index: Any, values: Any, out_at: Any, count: Any, broadcast: bool
) -> None:
    """Emit the loop over neighbours, whose values are loaded into the lanes of a register."""
    i64, scalar = ir.IntType(64), ir.DoubleType()
    vector = ir.VectorType(scalar, LANES)
    weight_ptr = builder.inttoptr(weight_at, (scalar if broadcast else vector).as_pointer())
    undefined = ir.Constant(vector, ir.Undefined)
    entry, loop = builder.block, builder.append_basic_block("neighbour")
    end = builder.append_basic_block("gather.end")
    builder.branch(loop)
    builder.position_at_end(loop)
    k, total = builder.phi(i64), builder.phi(vector)
    k.add_incoming(ir.Constant(i64, 0), entry)
    total.add_incoming(ir.Constant(vector, [0.0] * LANES), entry)
    weight = builder.load(builder.gep(weight_ptr, [k]), align=8)
    if broadcast:
        first = builder.insert_element(undefined, weight, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        weight = builder.shuffle_vector(first, undefined, zeros)
    near, row = undefined, builder.mul(k, ir.Constant(i64, LANES))
    for lane in range(LANES):
        at = builder.gep(index, [builder.add(row, ir.Constant(i64, lane))])
        value = builder.load(builder.gep(values, [builder.sext(builder.load(at, align=4), i64)]), align=8)
        near = builder.insert_element(near, value, ir.Constant(ir.IntType(32), lane))
    following = builder.fadd(builder.fmul(weight, near, flags=("contract",)), total, flags=("contract",))
    total.add_incoming(following, loop)
    after = builder.add(k, ir.Constant(i64, 1))
    k.add_incoming(after, loop)
    builder.cbranch(builder.icmp_signed("<", after, count), loop, end)
    builder.position_at_end(end)
    builder.store(following, builder.inttoptr(out_at, vector.as_pointer()), align=8)


def _column_pass(single: bool, back: bool, rows: int, name: str) -> Any:
    """Return an intrinsic for sums over the nine derivatives (m, 9, LANES) of basis vectors at one block.

    Its arguments are the addresses of the derivatives, of the coordinates (m,) of every row, and of the
    result (9, LANES) of every row, the sum over the basis vectors. With `back` they are those of the
    derivatives, of nine vectors (9, LANES) of every row, and of the result (m, LANES) of every row, to which
    the products with every basis vector's derivatives are added. The last argument is the number of basis vectors.
    """

    def codegen(context, builder, signature, args):
        inputs, out = args[1 : 1 + rows], args[1 + rows : 1 + 2 * rows]
        _emit_column_loop(builder, args[0], inputs, out, args[-1], single, back)
        return context.get_dummy_value()

    def sums(typingctx, table_at, given_at, out_at, count):
        return types.void(*(types.intp,) * 4), codegen

    def sums_2(typingctx, table_at, given_at, given_2_at, out_at, out_2_at, count):
        return types.void(*(types.intp,) * 6), codegen

    def sums_3(typingctx, table_at, given_at, given_2_at, given_3_at, out_at, out_2_at, out_3_at, count):
        return types.void(*(types.intp,) * 8), codegen

    of_rows: Any = {1: sums, 2: sums_2, 3: sums_3}[rows]
    of_rows.__name__ = of_rows.__qualname__ = name
    return intrinsic(of_rows)


def _emit_column_loop(
    builder: Any, table_at: Any, given_at: list[Any], out_at: list[Any], count: Any, single: bool, back: bool
) -> None:
    """Emit the loop over basis vectors, with the nine vectors of every row in registers."""
    i64, i32, scalar = ir.IntType(64), ir.IntType(32), ir.DoubleType()
    vector = ir.VectorType(scalar, LANES)
    stored = ir.VectorType(ir.FloatType(), LANES) if single else vector
    table_ptr = builder.inttoptr(table_at, stored.as_pointer())
    given_ptr = [builder.inttoptr(at, (vector if back else scalar).as_pointer()) for at in given_at]
    out_ptr = [builder.inttoptr(at, vector.as_pointer()) for at in out_at]
    undefined, lane_zero = ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(i32, LANES), [0] * LANES)
    nine = [ir.Constant(i64, q) for q in range(9)]
    factors = [[builder.load(builder.gep(at, [q]), align=8) for q in nine] if back else [] for at in given_ptr]
    entry, loop = builder.block, builder.append_basic_block("column")
    end = builder.append_basic_block("columns.end")
    builder.branch(loop)
    builder.position_at_end(loop)
    m = builder.phi(i64)
    m.add_incoming(ir.Constant(i64, 0), entry)
    totals = [[] if back else [builder.phi(vector) for _ in nine] for _ in given_ptr]
    row = builder.mul(m, ir.Constant(i64, 9))
    values = [builder.load(builder.gep(table_ptr, [builder.add(row, q)]), align=4) for q in nine]
    if single:
        values = [builder.fpext(value, vector) for value in values]
    sums: list[list[Any]] = []
    for k, pointer in enumerate(given_ptr):
        if back:
            at = builder.gep(out_ptr[k], [m])
            total, other = builder.load(at, align=8), ir.Constant(vector, [0.0] * LANES)
            for q in range(9):  # two independent chains of additions
                product = builder.fmul(values[q], factors[k][q], flags=("contract",))
                total, other = other, builder.fadd(product, total, flags=("contract",))
            builder.store(builder.fadd(total, other), at, align=8)
            continue
        first = builder.insert_element(undefined, builder.load(builder.gep(pointer, [m])), ir.Constant(i32, 0))
        coordinate = builder.shuffle_vector(first, undefined, lane_zero)
        sums.append([])
        for q in range(9):
            product = builder.fmul(values[q], coordinate, flags=("contract",))
            sums[k].append(builder.fadd(product, totals[k][q], flags=("contract",)))
        for phi, value in zip(totals[k], sums[k], strict=True):
            phi.add_incoming(ir.Constant(vector, [0.0] * LANES), entry)
            phi.add_incoming(value, loop)
    following = builder.add(m, ir.Constant(i64, 1))
    m.add_incoming(following, loop)
    builder.cbranch(builder.icmp_signed("<", following, count), loop, end)
    builder.position_at_end(end)
    for k, row_sums in enumerate(sums):
        for q in range(9):
            builder.store(row_sums[q], builder.gep(out_ptr[k], [nine[q]]), align=8)


column_sums, column_work = (
    {single: _column_pass(single, back, 1, name + "_single" * single) for single in (False, True)}
    for back, name in ((False, "column_sums"), (True, "column_work"))
)
column_sums_2 = {
    single: _column_pass(single, False, 2, "column_sums_2" + "_single" * single) for single in (False, True)
}
column_work_3 = {
    single: _column_pass(single, True, 3, "column_work_3" + "_single" * single) for single in (False, True)
}
lane_sums_3x3 = _lane_sums(3, 3, "lane_sums_3x3")
lane_sums_3x6 = _lane_sums(3, 6, "lane_sums_3x6")
lane_sums_1x3 = _lane_sums(1, 3, "lane_sums_1x3")
lane_sums_3x2 = _lane_sums(3, 2, "lane_sums_3x2")
