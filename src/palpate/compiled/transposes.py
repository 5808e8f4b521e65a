"""Transposes in registers: from the numbers of a node next to each other to those of a block in lanes, and back.

A node has three vectors of four numbers, such as the derivatives of a displacement component and its residual. The
material law requires one number of all `LANES` nodes of a block in one register.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from palpate.compiled.lanes import LANES

LINE_NUMBERS = {"float64": 12, "float32": 16}  # from a node to the next; those in single precision fill a cache line
COMPONENT_COUNT, COMPONENT_NUMBERS, HALF_LANES = 3, 4, LANES // 2
LOW_NUMBERS, HIGH_NUMBERS = (
    [0, 8, 1, 9, 4, 12, 5, 13],
    [2, 10, 3, 11, 6, 14, 7, 15],
)  # interleave the numbers of two vectors ...
FIRST_PAIRS, SECOND_PAIRS = [0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15]  # ... then pairs, in each half


def shuffled(builder: Any, first: Any, second: Any, places: list[int]) -> Any:
    """Return the numbers at some places of two vectors, one after the other."""
    return builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(ir.IntType(32), len(places)), places))


def _transposed(builder: Any, vectors: list[Any]) -> list[Any]:
    """Return four vectors of eight numbers with both of their 4 x 4 halves transposed."""
    a, b = (shuffled(builder, vectors[0], vectors[1], places) for places in (LOW_NUMBERS, HIGH_NUMBERS))
    c, d = (shuffled(builder, vectors[2], vectors[3], places) for places in (LOW_NUMBERS, HIGH_NUMBERS))
    return [shuffled(builder, x, y, places) for x, y in ((a, c), (b, d)) for places in (FIRST_PAIRS, SECOND_PAIRS)]


def _lane_rows(component: int) -> list[int]:
    """Return the rows of a component's four numbers: derivatives row by row, then the residuals."""
    return [*(3 * component + d for d in range(3)), 9 + component]


class _Block:
    """Pointers to the numbers of the nodes of a block, and to its rows of lanes in double precision."""

    def __init__(self, context: Any, builder: Any, nodes_kind: Any, nodes: Any, rows_kind: Any, rows: Any) -> None:
        self.builder, self.single, self.i64 = builder, nodes_kind.dtype == types.float32, ir.IntType(64)
        number = ir.FloatType() if self.single else ir.DoubleType()
        self.line = LINE_NUMBERS[str(nodes_kind.dtype)]
        self.four, self.eight = ir.VectorType(number, COMPONENT_NUMBERS), ir.VectorType(number, LANES)
        self.wide = ir.VectorType(ir.DoubleType(), LANES)
        self.nodes, self.rows = (
            builder.ptrtoint(context.make_array(kind)(context, builder, array).data, self.i64)
            for kind, array in ((nodes_kind, nodes), (rows_kind, rows))
        )
        self.bytes = 4 if self.single else 8

    def node(self, first: Any, lane: int, component: int) -> Any:
        """Return the pointer to a component of the node of a lane, after a first node."""
        number = self.builder.mul(first, ir.Constant(self.i64, self.line * self.bytes))
        offset = ir.Constant(self.i64, (self.line * lane + COMPONENT_NUMBERS * component) * self.bytes)
        return self.builder.inttoptr(
            self.builder.add(self.builder.add(self.nodes, number), offset), self.four.as_pointer()
        )

    def row(self, number: int) -> Any:
        """Return the pointer to a row of lanes."""
        offset = ir.Constant(self.i64, 8 * LANES * number)
        return self.builder.inttoptr(self.builder.add(self.rows, offset), self.wide.as_pointer())


@intrinsic
def nodes_to_lanes(typing_context, nodes, rows):
    """Copy the numbers (LANES, 3, 4) of a block's nodes, in lines, to rows of lanes (12 * LANES,)."""

    def codegen(context, builder, signature, args):
        block = _Block(context, builder, signature.args[0], args[0], signature.args[1], args[1])
        zero = ir.Constant(block.i64, 0)
        for component in range(COMPONENT_COUNT):
            loaded = [builder.load(block.node(zero, lane, component), align=8) for lane in range(LANES)]
            joined = [
                shuffled(builder, loaded[lane], loaded[lane + HALF_LANES], list(range(LANES)))
                for lane in range(HALF_LANES)
            ]
            for vector, row in zip(_transposed(builder, joined), _lane_rows(component), strict=True):
                value = builder.fpext(vector, block.wide) if block.single else vector
                builder.store(value, block.row(row), align=8)
        return context.get_dummy_value()

    return types.void(nodes, rows), codegen


@intrinsic
def lanes_to_nodes(typing_context, rows, nodes, first):
    """Copy rows of lanes (12 * LANES,) to the numbers (n, 3, 4), in lines, of the LANES nodes from a first one on."""

    def codegen(context, builder, signature, args):
        block = _Block(context, builder, signature.args[1], args[1], signature.args[0], args[0])
        for component in range(COMPONENT_COUNT):
            loaded = [builder.load(block.row(row), align=8) for row in _lane_rows(component)]
            if block.single:
                loaded = [builder.fptrunc(vector, block.eight) for vector in loaded]
            for lane, vector in enumerate(_transposed(builder, loaded)):
                for half in range(2):
                    part = shuffled(builder, vector, vector, list(range(HALF_LANES * half, HALF_LANES * (half + 1))))
                    builder.store(part, block.node(args[2], lane + HALF_LANES * half, component), align=8)
        return context.get_dummy_value()

    return types.void(rows, nodes, types.intp), codegen
