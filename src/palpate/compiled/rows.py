"""Stencil sums one node at a time, with the numbers of a node next to each other.

The weights of a neighbour are one vector, and so are the fluxes of a node's displacement component.
A neighbour then requires one load per component instead of a copy into lanes number by number. The sums
of a node are in vector registers, which requires intrinsics (`palpate.compiled.lanes`).
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import prange, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from palpate.compiled.jit import law_digest, law_njit
from palpate.compiled.lanes import LANES, ranges
from palpate.compiled.transposes import LINE_NUMBERS, shuffled

SUM_CHAINS = 2  # independent sums of a node in double precision, as an addition takes some cycles
ROW_MULTIPLE = 4  # entries of a row are a multiple: neighbours at a time in single precision
ALIGNMENT_BYTES = 64  # bytes of a cache line
PREFETCH_BYTES = 4096  # bytes by which weights are loaded in advance: some three nodes
ROW_WIDTHS = (4, 8)  # numbers of a row of weights, and of the fluxes of a component
GROWTH_FACTOR, GROWTH_ENTRIES = 1.5, 4096  # entries of larger arrays, over those in use, and in addition
_APPEND_LOCK = Lock()  # two threads can cut one body


class Rows(NamedTuple):
    """Stencils in compressed rows: a node's neighbours are next to each other, and so are their weights.

    The number of entries of a row is a multiple of `ROW_MULTIPLE`. The last can be the node itself with zero weights.
    """

    # (b, LANES) int32: nodes in blocks for the material law; the last node of an unfilled block is repeated
    nodes: NDArray[np.int32]
    # start, stop: (n,) int64: first entry of every node in `neighbours`, and the one after its last
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    neighbours: NDArray[np.int32]  # (t,) int32
    # (n,) int64: first entry of every node in `weights`. Nodes with equal weights share them.
    weight_start: NDArray[np.int64]
    weights: NDArray[Any]  # (s, w) float64 or float32: of one of the `ROW_WIDTHS`, padded with zeros
    # (2,) int64: entries of `neighbours` and of `weights` that some layout reads. Layouts share arrays (`with_rows`).
    used: NDArray[np.int64]


def aligned_zeros(*shape: int, dtype: type[np.floating[Any]] = np.float64) -> NDArray[Any]:
    """Return zeros that start at a cache line, with another one behind them."""
    size, number = int(np.prod(shape)), np.dtype(dtype).itemsize
    data = np.zeros(size + 2 * ALIGNMENT_BYTES // number, dtype)
    first = -data.ctypes.data % ALIGNMENT_BYTES // number
    return data[first : first + size].reshape(shape)


def row_table(
    near: NDArray[np.int32],
    row: NDArray[np.integer[Any]],
    table: NDArray[np.float64],
    diagonal: NDArray[np.float64] | None = None,
) -> Rows:
    """Lay out stencils in compressed rows, with weights `table` (s, k, w) by row.

    `near` (n, k) and `row` (n,) are `Stencils.neighbours` and `Stencils.row`. `diagonal` (s, w) are the weights of a
    node on itself, by default 0.
    """
    n = len(near)
    every = np.arange(n, dtype=np.int32)
    count = np.sum(near != every[:, None], axis=1)
    entries = count + (diagonal is not None)
    entries += -entries % ROW_MULTIPLE
    start = np.concatenate([[0], np.cumsum(entries)])
    neighbours = np.repeat(every, entries)
    node, place = ranges(np.zeros_like(count), count)
    neighbours[start[node] + place] = near[node, place]

    used, first_node, which = np.unique(row, return_index=True, return_inverse=True)
    row_start = np.concatenate([[0], np.cumsum(entries[first_node])])
    numbers = table.shape[2]
    weights = aligned_zeros(int(row_start[-1]), next(width for width in ROW_WIDTHS if width >= numbers))
    each, place = ranges(np.zeros_like(first_node), count[first_node])
    weights[row_start[each] + place, :numbers] = table[used[each], place]
    if diagonal is not None:
        weights[row_start[:-1] + count[first_node], :numbers] = diagonal[used]
    nodes = np.concatenate([every, np.repeat(every[-1:], -n % LANES)]).reshape(-1, LANES)
    used = np.array([len(neighbours), len(weights)])
    return Rows(nodes, start[:-1].copy(), start[1:].copy(), neighbours, row_start[which], weights, used)


def rows_in_single(rows: Rows) -> Rows:
    """Return the same stencils with weights in single precision."""
    used = rows.weights[: rows.used[1]]
    weights = aligned_zeros(*used.shape, dtype=np.float32)
    weights[...] = used
    return rows._replace(weights=weights)


def with_rows(
    rows: Rows, nodes: NDArray[np.integer[Any]], count: NDArray[np.int64], near: NDArray[np.int32], weights: Any
) -> Rows:
    """Return stencils with other entries for nodes (m,), of which each has a `count` (m,) of entries.

    `near` (t,) and `weights` (t, w) are the neighbours and weights, node by node. The entries of all other nodes are
    shared with `rows`. The new ones are appended to the same arrays, whose spare part no earlier layout reads; full
    arrays are copied to larger ones.
    """
    padded = np.maximum(count + -count % ROW_MULTIPLE, ROW_MULTIPLE)  # the loop of the sums runs at least once
    begin = np.concatenate([[0], np.cumsum(padded)])
    with _APPEND_LOCK:
        if (rows.used + begin[-1] > (len(rows.neighbours), len(rows.weights))).any():
            rows = _with_room(rows, int(begin[-1]))
        first, first_weight = (int(used) for used in rows.used)
        rows.used[:] += begin[-1]
    row, place = ranges(np.zeros_like(count), count)
    entry = begin[row] + place
    rows.neighbours[first : first + begin[-1]] = np.repeat(nodes, padded)  # the node itself fills a row
    rows.neighbours[first + entry] = near
    rows.weights[first_weight : first_weight + begin[-1]] = 0.0
    rows.weights[first_weight + entry, : weights.shape[1]] = weights
    start, stop, weight_start = rows.start.copy(), rows.stop.copy(), rows.weight_start.copy()
    start[nodes], stop[nodes], weight_start[nodes] = first + begin[:-1], first + begin[1:], first_weight + begin[:-1]
    return rows._replace(start=start, stop=stop, weight_start=weight_start)


def _with_room(rows: Rows, needed: int) -> Rows:
    """Return the same stencils in larger arrays, without entries that no node uses."""
    _row, entry = ranges(rows.start, rows.stop)
    neighbours = np.zeros(int(GROWTH_FACTOR * len(entry)) + GROWTH_ENTRIES + needed, dtype=np.int32)
    neighbours[: len(entry)] = rows.neighbours[entry]
    count = rows.stop - rows.start
    stop = np.cumsum(count)
    _, first, which = np.unique(rows.weight_start, return_index=True, return_inverse=True)
    weight_stop = np.cumsum(count[first])
    _, weight_entry = ranges(rows.weight_start[first], rows.weight_start[first] + count[first])
    weights = aligned_zeros(int(GROWTH_FACTOR * len(weight_entry)) + GROWTH_ENTRIES + needed, rows.weights.shape[1])
    weights[: len(weight_entry)] = rows.weights[weight_entry]
    return Rows(
        rows.nodes, stop - count, stop, neighbours, (weight_stop - count[first])[which], weights,
        np.array([len(entry), len(weight_entry)]),
    )  # fmt: skip


def _row_sums(width: int, name: str, of_differences: bool) -> Any:
    """Make the intrinsic for the sums of node i over its neighbours j, for three components c.

    With `of_differences` it is ``sums(u, rows, i, out, lane)``, which stores the sums of weight[j, :]
    (u[j, c] - u[i, c]) in out[lane, c, :]. Otherwise it is ``sums(flux, rows, i, out, i)``, which stores minus
    the sum of weight[j, :] . flux[j, c, :] in out[i, c].

    Weights in single precision have width 4. The values u (n, 4), the lines of differences in `out` and those of the
    fluxes (`LINE_NUMBERS`) are then in single precision, too.
    """

    def sums(typingctx, values, rows, node, out, place):
        signature = types.void(values, rows, types.intp, out, types.intp)
        single = rows[rows.fields.index("weights")].dtype == types.float32
        if single != (values.dtype == types.float32):
            return None

        def codegen(context, builder, signature, args):
            emit = (_SingleEmitter if single else _Emitter)(context, builder, width)
            values_at, out_at = emit.data(signature.args[0], args[0]), emit.data(signature.args[3], args[3])
            row = emit.row(signature.args[1], args[1], args[2])
            if of_differences:
                totals = emit.loop(row, emit.differences(values_at, args[2]))
                emit.store_vectors(totals, emit.at(out_at, args[4], emit.line, emit.size))
            else:
                totals = emit.loop(row, emit.fluxes(values_at))
                emit.store_negative_totals(totals, emit.at(out_at, args[4], 3))
            return context.get_dummy_value()

        return signature, codegen

    sums.__name__ = sums.__qualname__ = name
    return intrinsic(sums)


class _Row(NamedTuple):
    """Addresses of a node's neighbours and weights, and their number, as instructions."""

    neighbours: Any
    weights: Any
    count: Any


Products = list[list[tuple[Any, Any]]]  # factors of every chain of sums


class _Emitter:
    """Emits instructions for sums in vectors of `width` numbers in double precision."""

    size = 8  # bytes of a weight, and of a number of sums and fluxes
    together = SUM_CHAINS  # neighbours in an iteration of the loop

    def __init__(self, context: Any, builder: Any, width: int) -> None:
        self.context, self.builder, self.width, self.line = context, builder, width, 3 * width
        self.vector, self.scalar, self.i64 = ir.VectorType(ir.DoubleType(), width), ir.DoubleType(), ir.IntType(64)

    def data(self, kind: Any, array: Any) -> Any:
        """Return the address of an array's numbers."""
        return self.builder.ptrtoint(self.context.make_array(kind)(self.context, self.builder, array).data, self.i64)

    def row(self, kind: Any, rows: Any, node: Any) -> _Row:
        """Return the row of a node in `Rows`."""
        field = {
            name: self.data(kind.types[k], self.builder.extract_value(rows, k)) for k, name in enumerate(Rows._fields)
        }
        begin, end, first = (
            self.load(self.i64, self.at(field[name], node, 1)) for name in ("start", "stop", "weight_start")
        )
        neighbours = self.at(field["neighbours"], begin, 1, size=4)
        weights = self.at(field["weights"], first, self.width, self.size)
        return _Row(neighbours, weights, self.builder.sub(end, begin))

    def at(self, base: Any, index: Any, count: int, size: int = 8) -> Any:
        """Return the address of entry `index` of `count` numbers of `size` bytes."""
        offset = self.builder.mul(index, ir.Constant(self.i64, count * size))
        return self.builder.add(base, offset)

    def load(self, kind: Any, address: Any, offset: int = 0, align: int = 8) -> Any:
        """Load a value at an address plus an offset [bytes]."""
        place = self.builder.add(address, ir.Constant(self.i64, offset)) if offset else address
        return self.builder.load(self.builder.inttoptr(place, kind.as_pointer()), align=align)

    def store(self, value: Any, address: Any, offset: int = 0) -> None:
        """Store a value at an address plus an offset [bytes]."""
        place = self.builder.add(address, ir.Constant(self.i64, offset)) if offset else address
        self.builder.store(value, self.builder.inttoptr(place, value.type.as_pointer()), align=8)

    def prefetch(self, address: Any, offset: int) -> None:
        """Load the cache line at an address plus an offset [bytes] in advance; it need not exist."""
        pointer, i32 = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer, i32, i32, i32])
        function = self.builder.module.declare_intrinsic("llvm.prefetch", [pointer], kind)
        place = self.builder.inttoptr(self.builder.add(address, ir.Constant(self.i64, offset)), pointer)
        read, keep, data = i32(0), i32(3), i32(1)  # for reading, into the nearest cache, of numbers
        self.builder.call(function, [place, read, keep, data])

    def shuffle(self, first: Any, second: Any, places: list[int]) -> Any:
        """Return the numbers at some places of two vectors, one after the other."""
        return shuffled(self.builder, first, second, places)

    def broadcast(self, value: Any) -> Any:
        """Return a vector of equal numbers."""
        undefined = ir.Constant(self.vector, ir.Undefined)
        first = self.builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
        return self.shuffle(first, undefined, [0] * self.width)

    def weights(self, address: Any) -> list[Any]:
        """Return the weights of the neighbours of an iteration."""
        return [self.load(self.vector, address, self.size * self.width * chain) for chain in range(self.together)]

    def fluxes(self, values: Any) -> Callable[[Any, Any], Products]:
        """Return the function for the products of weights and fluxes, one vector per component."""

        def terms(near: Any, weights: Any) -> Products:
            places = [self.at(values, j, 3 * self.width) for j in near]
            return [
                [(factor, self.load(self.vector, place, 8 * self.width * c)) for c in range(3)]
                for factor, place in zip(self.weights(weights), places, strict=True)
            ]

        return terms

    def differences(self, values: Any, node: Any) -> Callable[[Any, Any], Products]:
        """Return the function for the products of weights and differences from the node."""
        address = self.at(values, node, 3)
        center = [self.broadcast(self.load(self.scalar, address, 8 * c)) for c in range(3)]

        def terms(near: Any, weights: Any) -> Products:
            products = []
            for factor, j in zip(self.weights(weights), near, strict=True):
                address = self.at(values, j, 3)
                value = [self.broadcast(self.load(self.scalar, address, 8 * c)) for c in range(3)]
                products.append([(factor, self.builder.fsub(value[c], center[c])) for c in range(3)])
            return products

        return terms

    def loop(self, row: _Row, terms: Callable[[Any, Any], Products]) -> list[Any]:
        """Emit the loop over some neighbours at a time; return the sums of the products over all chains."""
        builder = self.builder
        entry, loop = builder.block, builder.append_basic_block("neighbours")
        end = builder.append_basic_block("neighbours.end")
        builder.branch(loop)
        builder.position_at_end(loop)
        k = builder.phi(self.i64)
        k.add_incoming(ir.Constant(self.i64, 0), entry)
        sums: list[list[Any]] = []
        index = self.at(row.neighbours, k, 1, size=4)
        weight = self.at(row.weights, k, self.width, self.size)
        self.prefetch(weight, PREFETCH_BYTES)
        near = [builder.sext(self.load(ir.IntType(32), index, 4 * e, align=4), self.i64) for e in range(self.together)]
        for products in terms(near, weight):
            sums.append([])
            for factor, value in products:
                product, total = builder.fmul(factor, value, flags=("contract",)), self.first_phi(loop, value.type)
                total.add_incoming(ir.Constant(value.type, [0.0] * value.type.count), entry)
                sums[-1].append(builder.fadd(product, total, flags=("contract",)))
                total.add_incoming(sums[-1][-1], loop)
        following = builder.add(k, ir.Constant(self.i64, self.together))
        k.add_incoming(following, loop)
        builder.cbranch(builder.icmp_signed("<", following, row.count), loop, end)
        builder.position_at_end(end)
        while len(sums) > 1:
            half = len(sums) // 2
            pairs = zip(sums[:half], sums[half:], strict=True)
            sums = [[builder.fadd(a, b) for a, b in zip(*pair, strict=True)] for pair in pairs]
        return sums[0]

    def first_phi(self, block: Any, kind: Any) -> Any:
        """Return a new phi at the start of a block; instructions are emitted at its end as before."""
        self.builder.position_at_start(block)
        phi = self.builder.phi(kind)
        self.builder.position_at_end(block)
        return phi

    def total(self, vector: Any) -> Any:
        """Return the sum of a vector's numbers, halves first."""
        width = self.width
        while width > 1:
            width //= 2
            halves = [self.shuffle(vector, vector, list(range(first, first + width))) for first in (0, width)]
            vector = self.builder.fadd(*halves)
        return self.builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))

    def store_vectors(self, sums: list[Any], out: Any) -> None:
        """Store the sums, one vector per component."""
        for c, vector in enumerate(sums):
            self.store(vector, out, 8 * self.width * c)

    def store_negative_totals(self, sums: list[Any], out: Any) -> None:
        """Store minus the sum of every component's vector."""
        for c, vector in enumerate(sums):
            self.store(self.builder.fneg(self.total(vector)), out, 8 * c)


class _SingleEmitter(_Emitter):
    """Emits instructions for sums with weights of width 4 in single precision, two neighbours in a vector."""

    size = 4
    together = ROW_MULTIPLE

    def __init__(self, context: Any, builder: Any, width: int) -> None:
        super().__init__(context, builder, width)
        self.line, self.four = LINE_NUMBERS["float32"], ir.VectorType(ir.FloatType(), width)
        self.eight = ir.VectorType(ir.FloatType(), 2 * width)

    def differences(self, values: Any, node: Any) -> Callable[[Any, Any], Products]:
        center = self.load(self.four, self.at(values, node, 4, 4))
        center = self.shuffle(center, center, 2 * [0, 1, 2, 3])

        def terms(near: Any, weights: Any) -> Products:
            products = []
            for first in range(0, self.together, 2):
                pair = [self.load(self.four, self.at(values, j, 4, 4)) for j in near[first : first + 2]]
                difference = self.builder.fsub(self.shuffle(pair[0], pair[1], list(range(8))), center)
                factor = self.load(self.eight, weights, 16 * first)
                products.append(
                    [(factor, self.shuffle(difference, difference, [c] * 4 + [4 + c] * 4)) for c in range(3)]
                )
            return products

        return terms

    def fluxes(self, values: Any) -> Callable[[Any, Any], Products]:
        line = ir.VectorType(ir.FloatType(), self.line)

        def terms(near: Any, weights: Any) -> Products:
            products = []
            for e, j in enumerate(near):
                factor = self.load(self.four, weights, 16 * e)
                value = self.load(line, self.at(values, j, self.line, 4), align=64)
                products.append([(self.shuffle(factor, factor, 4 * [0, 1, 2, 3]), value)])
            return products

        return terms

    def store_vectors(self, sums: list[Any], out: Any) -> None:
        for c, pair in enumerate(sums):
            halves = [self.shuffle(pair, pair, list(range(first, first + 4))) for first in (0, 4)]
            self.store(self.builder.fadd(*halves), out, 16 * c)

    def store_negative_totals(self, sums: list[Any], out: Any) -> None:
        """Store minus the sums of the four numbers of every component, pairs in single precision."""
        (line,) = sums
        pairs = self.builder.fadd(*(self.shuffle(line, line, list(range(first, 16, 2))) for first in (0, 1)))
        wide = self.builder.fpext(pairs, ir.VectorType(ir.DoubleType(), 8))
        totals = self.builder.fadd(*(self.shuffle(wide, wide, list(range(first, 8, 2))) for first in (0, 1)))
        for c in range(3):
            total = self.builder.extract_element(totals, ir.Constant(ir.IntType(32), c))
            self.store(self.builder.fneg(total), out, 8 * c)


difference_sums = _row_sums(4, "difference_sums", of_differences=True)


def _gather(width: int) -> Any:
    """Compile the gather of fluxes of `width` numbers per component."""
    flux_sums = _row_sums(width, f"flux_sums_{width}", of_differences=False)

    @law_njit(law_digest(__name__, "gather fluxes", width), parallel=True, fastmath={"contract"})
    def gather(rows, flux, force):
        """Compute the force [N/m^3], minus the transposed derivatives of the fluxes (n, 3, width)."""
        for i in prange(force.shape[0]):
            flux_sums(flux, rows, i, force, i)

    return gather


gather_fluxes = {width: _gather(width) for width in ROW_WIDTHS}
