"""The memory of an exported model, and its file.

A model is one block of memory without pointers: a header, a table of named arrays, and the arrays, which functions
address by constant offsets. Arrays that share memory share it here. Arrays of zeros are last, and not in the file.
"""

from __future__ import annotations

import ctypes
import hashlib
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from palpate.export.lowering import LoweredFunction

FILE_MAGIC, FORMAT_VERSION = b"PALPATE\0", 1
HEADER_FORMAT = struct.Struct("<8sIIQQ32s")  # magic, version, named arrays, bytes of memory and file, digest
ENTRY_FORMAT = struct.Struct("<24sQIIII")  # name, offset, type, rows, columns, zero
HEADER_BYTES, DIGEST_PLACE, ALIGNMENT_BYTES = HEADER_FORMAT.size, 32, 64
TYPE_CODES = {"f8": 0, "f4": 1, "i8": 2, "u4": 3, "b1": 4, "u1": 5, "i4": 6}


class _Range(NamedTuple):
    """Addresses of this process from low to high, and where they are in the memory of the model."""

    low: int
    high: int
    place: int


class Memory:
    """Places of all arrays of some functions.

    A program reads and writes the `named` arrays, of at most two dimensions. `size` and `stored` are the bytes of the
    memory, and of the file.
    """

    def __init__(self, functions: Sequence[LoweredFunction], named: Mapping[str, NDArray[Any]]) -> None:
        self.named, self.stored = dict(named), 0
        leaves = [leaf for function in functions for leaf in function.leaves if isinstance(leaf, np.ndarray)]
        order = [np.lib.array_utils.byte_bounds(a) for a in (*leaves, *self.named.values()) if a.size]
        joined: list[list[int]] = []
        for low, high in sorted(order):
            if joined and low < joined[-1][1]:
                joined[-1][1] = max(high, joined[-1][1])
            else:
                joined.append([low, high])
        # in the order of their first use, so that every export of a model is equal
        starts = np.array([low for low, _ in joined])
        used = dict.fromkeys(int(np.searchsorted(starts, low, side="right")) - 1 for low, _ in order)
        ranges = [joined[k] for k in used]
        filled = [any(ctypes.string_at(low, high - low)) for low, high in ranges]
        at, self._ranges = HEADER_BYTES + ENTRY_FORMAT.size * len(self.named), []
        for is_filled in (True, False):
            for (low, high), this in zip(ranges, filled, strict=True):
                if this is is_filled:
                    at = -(-at // ALIGNMENT_BYTES) * ALIGNMENT_BYTES
                    self._ranges.append(_Range(low, high, at))
                    at += high - low
            at = -(-at // ALIGNMENT_BYTES) * ALIGNMENT_BYTES
            self.stored = at if is_filled else self.stored
        self.size = at

    def offset(self, array: NDArray[Any]) -> int:
        """Return the place of an array [B]; 0 for an empty one."""
        low = np.lib.array_utils.byte_bounds(array)[0]
        return next((place + low - first for first, last, place in self._ranges if first <= low < last), 0)

    def image(self) -> bytes:
        """Return the content of the file, with its digest (SHA-256, of the content with zeros in its place)."""
        data = bytearray(self.stored)
        for k, (name, array) in enumerate(self.named.items()):
            rows, columns = (*array.shape, 1, 1)[:2]
            entry = ENTRY_FORMAT.pack(
                name.encode(), self.offset(array), TYPE_CODES[array.dtype.str[1:]], rows, columns, 0
            )
            data[HEADER_BYTES + ENTRY_FORMAT.size * k : HEADER_BYTES + ENTRY_FORMAT.size * (k + 1)] = entry
        for low, high, place in self._ranges:
            if place < self.stored:
                data[place : place + high - low] = ctypes.string_at(low, high - low)
        header = (FILE_MAGIC, FORMAT_VERSION, len(self.named), self.size, self.stored)
        data[:HEADER_BYTES] = HEADER_FORMAT.pack(*header, bytes(32))
        digest = hashlib.sha256(data).digest()
        data[:HEADER_BYTES] = HEADER_FORMAT.pack(*header, digest)
        return bytes(data)

    def entry_point(self, name: str, function: LoweredFunction) -> str:
        """Return the module of ``int32_t NAME(void *memory)``, which returns the result of a function, or -1."""
        module, byte, i32, i64 = ir.Module(name), ir.IntType(8).as_pointer(), ir.IntType(32), ir.IntType(64)
        callee = ir.Function(module, function.function_type, function.callee)
        entry = ir.Function(module, ir.FunctionType(i32, [byte]), name)
        entry.args[0].add_attribute("noalias")
        builder = ir.IRBuilder(entry.append_basic_block())
        kinds = function.function_type.args
        result, exception = (builder.alloca(kind.pointee) for kind in kinds[:2])
        arguments = []
        for leaf, kind in zip(function.leaves, kinds[2:], strict=True):
            if leaf is None:
                arguments.append(ir.Constant(kind, None))
            elif isinstance(leaf, np.ndarray):
                place = builder.gep(entry.args[0], [ir.Constant(i64, self.offset(leaf))])
                arguments.append(builder.bitcast(place, kind))
            else:
                arguments.append(ir.Constant(kind, int(leaf) if isinstance(kind, ir.IntType) else float(leaf)))
        status = builder.call(callee, [result, exception, *arguments])
        value = builder.trunc(builder.load(result), i32)
        failed = builder.icmp_signed("!=", status, ir.Constant(status.type, 0))
        builder.ret(builder.select(failed, ir.Constant(i32, -1), value))
        return str(module)


def constant_function(name: str, value: int) -> str:
    """Return the module of ``int64_t NAME(void)``, which returns a number."""
    module = ir.Module(name)
    function = ir.Function(module, ir.FunctionType(ir.IntType(64), []), name)
    ir.IRBuilder(function.append_basic_block()).ret(ir.Constant(ir.IntType(64), value))
    return str(module)
