"""Stencil sums one node at a time, with the numbers of a node next to each other.

The weights of a neighbour are one vector, and so are the fluxes of a node's displacement component.
A neighbour then requires one load per component instead of a copy into lanes number by number. The sums
of a node are in vector registers, which requires intrinsics (`palpate.dynamics.compiled.lanes`).
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

from palpate.dynamics.compiled.cache import law_digest, law_njit
from palpate.dynamics.compiled.lanes import LANES, ranges

__all__ = ["Rows", "aligned_zeros", "difference_sums", "gather_fluxes", "row_table", "with_rows"]

SUM_CHAINS = 2  # independent sums of a node, as an addition takes some cycles
ALIGNMENT_BYTES = 64  # bytes of a cache line
PREFETCH_BYTES = 4096  # bytes by which weights are loaded in advance: some three nodes
ROW_WIDTHS = (4, 8)  # numbers of a row of weights, and of the fluxes of a component
GROWTH_FACTOR, GROWTH_ENTRIES = 1.5, 4096  # entries of larger arrays, over those in use, and in addition
_APPEND_LOCK = Lock()  # two threads can cut one body


class Rows(NamedTuple):
    """Stencils in compressed rows: a node's neighbours are next to each other, and so are their weights.

    A row has an even number of entries, at least two. The last can be the node itself with zero weights.

    Parameters
    ----------
    nodes : (b, LANES) int32
        Nodes in blocks for the material law; the last node of an unfilled block is repeated.
    start, stop : (n,) int64
        First entry of every node in `neighbours`, and the one after its last.
    neighbours : (t,) int32
    weight_start : (n,) int64
        First entry of every node in `weights`. Nodes with equal weights share them.
    weights : (s, w) float64
        Of one of the `ROW_WIDTHS`, padded with zeros.
    used : (2,) int64
        Entries of `neighbours` and of `weights` that some layout reads. Layouts share arrays (`with_rows`).
    """

    nodes: NDArray[np.int32]
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    neighbours: NDArray[np.int32]
    weight_start: NDArray[np.int64]
    weights: NDArray[np.float64]
    used: NDArray[np.int64]

    @classmethod
    def none(cls) -> Rows:
        """Return an empty layout."""
        nodes, empty = np.zeros((0, LANES), dtype=np.int32), np.zeros(0, dtype=np.int64)
        return cls(
            nodes,
            empty,
            empty.copy(),
            np.zeros(0, dtype=np.int32),
            empty.copy(),
            np.zeros((0, 1)),
            np.zeros(2, dtype=np.int64),
        )


def aligned_zeros(*shape: int) -> NDArray[np.float64]:
    """Return zeros that start at a cache line."""
    size = int(np.prod(shape))
    spare = ALIGNMENT_BYTES // 8
    data = np.zeros(size + spare)
    first = -data.ctypes.data % ALIGNMENT_BYTES // 8
    return data[first : first + size].reshape(shape)


def row_table(
    near: NDArray[np.int32],
    row: NDArray[np.integer[Any]],
    table: NDArray[np.float64],
    diagonal: NDArray[np.float64] | None = None,
) -> Rows:
    """Lay out stencils in compressed rows.

    Parameters
    ----------
    near, row : (n, k) and (n,) int arrays
        `Stencils.neighbours` and `Stencils.row`.
    table : (s, k, w) array
        Weights, by row.
    diagonal : (s, w) array, optional
        Weights of a node on itself, by row; by default 0.
    """
    n = len(near)
    every = np.arange(n, dtype=np.int32)
    count = np.sum(near != every[:, None], axis=1)
    entries = count + (diagonal is not None)
    entries += -entries % SUM_CHAINS
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


def with_rows(
    rows: Rows, nodes: NDArray[np.integer[Any]], count: NDArray[np.int64], near: NDArray[np.int32], weights: Any
) -> Rows:
    """Return stencils with other entries for some nodes.

    The entries of all other nodes are shared with `rows`. The new ones are appended to the same arrays, whose spare
    part no earlier layout reads; full arrays are copied to larger ones.

    Parameters
    ----------
    rows : Rows
    nodes : (m,) int array
    count : (m,) int array
        Number of entries of every node.
    near, weights : (t,) and (t, w) arrays
        Neighbours and weights, node by node.
    """
    padded = np.maximum(count + count % SUM_CHAINS, SUM_CHAINS)  # the loop of the sums runs at least once
    begin = np.concatenate([[0], np.cumsum(padded)])
    with _APPEND_LOCK:
        if (rows.used + begin[-1] > (len(rows.neighbours), len(rows.weights))).any():
            rows = _with_room(rows, int(begin[-1]))
        first, first_weight = (int(used) for used in rows.used)
        rows.used[:] += begin[-1]
    row, place = ranges(np.zeros_like(count), count)
    entry = begin[row] + place
    rows.neighbours[first : first + begin[-1]] = np.repeat(nodes, padded)  # the node itself fills an odd row
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
    _, kept = ranges(rows.weight_start[first], rows.weight_start[first] + count[first])
    weights = aligned_zeros(int(GROWTH_FACTOR * len(kept)) + GROWTH_ENTRIES + needed, rows.weights.shape[1])
    weights[: len(kept)] = rows.weights[kept]
    return Rows(
        rows.nodes, stop - count, stop, neighbours, (weight_stop - count[first])[which], weights,
        np.array([len(entry), len(kept)]),
    )  # fmt: skip


def _row_sums(width: int, name: str, of_differences: bool) -> Any:
    """Make the intrinsic for the sums of node i over its neighbours j, for three components c.

    With `of_differences` it is ``sums(u, rows, i, out, lane)``, which stores the sums of weight[j, :]
    (u[j, c] - u[i, c]) in out[lane, c, :]. Otherwise it is ``sums(flux, rows, i, out, i)``, which stores minus
    the sum of weight[j, :] . flux[j, c, :] in out[i, c].
    """

    def sums(typingctx, values, rows, node, out, place):  # type: ignore[no-untyped-def]
        signature = types.void(values, rows, types.intp, out, types.intp)

        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            emit = _Emitter(context, builder, width)
            values_at, out_at = emit.data(signature.args[0], args[0]), emit.data(signature.args[3], args[3])
            row = emit.row(signature.args[1], args[1], args[2])
            if of_differences:
                total_vectors = emit.loop(row, emit.differences(values_at, args[2]))
                emit.store_vectors(total_vectors, emit.at(out_at, args[4], 3 * width))
            else:
                total_vectors = emit.loop(row, emit.fluxes(values_at))
                emit.store_negative_totals(total_vectors, emit.at(out_at, args[4], 3))
            return context.get_dummy_value()

        return signature, codegen

    sums.__name__ = sums.__qualname__ = name
    return intrinsic(sums)


class _Row(NamedTuple):
    """Addresses of a node's neighbours and weights, and their number, as instructions."""

    neighbours: Any
    weights: Any
    count: Any


class _Emitter:
    """Emits instructions for sums in vectors of `width` numbers."""

    def __init__(self, context: Any, builder: Any, width: int) -> None:
        self.context, self.builder, self.width = context, builder, width
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
        return _Row(neighbours, self.at(field["weights"], first, self.width), self.builder.sub(end, begin))

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

    def broadcast(self, value: Any) -> Any:
        """Return a vector of equal numbers."""
        undefined = ir.Constant(self.vector, ir.Undefined)
        first = self.builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), self.width), [0] * self.width)
        return self.builder.shuffle_vector(first, undefined, zeros)

    def fluxes(self, values: Any) -> Callable[[Any], list[Any]]:
        """Return the function for the fluxes of a node, one vector per component."""

        def term(j: Any) -> list[Any]:
            address = self.at(values, j, 3 * self.width)
            return [self.load(self.vector, address, 8 * self.width * c) for c in range(3)]

        return term

    def differences(self, values: Any, node: Any) -> Callable[[Any], list[Any]]:
        """Return the function for the differences of a neighbour's values from the node's."""
        address = self.at(values, node, 3)
        center = [self.broadcast(self.load(self.scalar, address, 8 * c)) for c in range(3)]

        def term(j: Any) -> list[Any]:
            address = self.at(values, j, 3)
            near = [self.broadcast(self.load(self.scalar, address, 8 * c)) for c in range(3)]
            return [self.builder.fsub(near[c], center[c]) for c in range(3)]

        return term

    def loop(self, row: _Row, term: Callable[[Any], list[Any]]) -> list[Any]:
        """Emit the loop over pairs of neighbours; return the sums of the components."""
        builder = self.builder
        entry, loop = builder.block, builder.append_basic_block("pair")
        end = builder.append_basic_block("pairs.end")
        builder.branch(loop)
        builder.position_at_end(loop)
        k = builder.phi(self.i64)
        k.add_incoming(ir.Constant(self.i64, 0), entry)
        totals = [[builder.phi(self.vector) for _ in range(3)] for _ in range(SUM_CHAINS)]
        index, weight = self.at(row.neighbours, k, 1, size=4), self.at(row.weights, k, self.width)
        self.prefetch(weight, PREFETCH_BYTES)
        for chain in range(SUM_CHAINS):
            j = builder.sext(self.load(ir.IntType(32), index, 4 * chain, align=4), self.i64)
            factor = self.load(self.vector, weight, 8 * self.width * chain)
            for c, value in enumerate(term(j)):
                product = builder.fmul(factor, value, flags=("contract",))
                total = totals[chain][c]
                total.add_incoming(ir.Constant(self.vector, [0.0] * self.width), entry)
                total.add_incoming(builder.fadd(product, total, flags=("contract",)), loop)
        following = builder.add(k, ir.Constant(self.i64, SUM_CHAINS))
        k.add_incoming(following, loop)
        builder.cbranch(builder.icmp_signed("<", following, row.count), loop, end)
        builder.position_at_end(end)
        last = [[total.incomings[1][0] for total in chain] for chain in totals]
        return [builder.fadd(a, b) for a, b in zip(*last, strict=True)]

    def total(self, vector: Any) -> Any:
        """Return the sum of a vector's numbers, halves first."""
        width = self.width
        while width > 1:
            width //= 2
            indices = ir.VectorType(ir.IntType(32), width)
            halves = [
                self.builder.shuffle_vector(vector, vector, ir.Constant(indices, list(range(first, first + width))))
                for first in (0, width)
            ]
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


difference_sums = _row_sums(4, "difference_sums", of_differences=True)


def _gather(width: int) -> Any:
    """Compile the gather of fluxes of `width` numbers per component."""
    flux_sums = _row_sums(width, f"flux_sums_{width}", of_differences=False)

    @law_njit(law_digest(__name__, "gather fluxes", width), parallel=True, fastmath={"contract"})
    def gather(rows, flux, force):  # type: ignore[no-untyped-def]
        """Compute the force [N/m^3], minus the transposed derivatives of the fluxes (n, 3, width)."""
        for i in prange(force.shape[0]):
            flux_sums(flux, rows, i, force, i)

    return gather


gather_fluxes = {width: _gather(width) for width in ROW_WIDTHS}
