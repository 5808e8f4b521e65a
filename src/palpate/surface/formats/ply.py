"""PLY files, ASCII and binary."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Ints
from palpate.core.faults import FileFormatError
from palpate.surface.formats.common import Parts, check_indices, fans, printable_word, read_count, read_numbers

NUMPY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "float32": "f4", "float64": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
}  # fmt: skip
STRUCT_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
MAX_HEADER_BYTES = 1 << 16  # bytes
MAX_RAGGED_VALUES = 4_000_000  # lists and numbers in rows of different lengths, which are read one by one
NEEDED_ELEMENTS = ("vertex", "face")
BYTE_ORDERS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)  # name, type, that of lengths


def read_ply(data: bytes) -> Parts:
    """Return the surface of a PLY file."""
    elements, order, at = _header(data)
    if not order:  # read a text file as one of doubles
        data, at = read_numbers(data[at:]).astype("<f8").tobytes(), 0
        for element in elements:
            element.properties = [(name, "f8", "f8" if length else "") for name, _, length in element.properties]
    columns: dict[str, dict[str, tuple[NDArray[Any], Ints]]] = {}
    for element in elements:
        columns[element.name], at = _rows(element, data, at, order or "<")
    points, faces = columns.get("vertex", {}), columns.get("face", {})
    polygons = faces.get("vertex_indices", faces.get("vertex_index"))
    if polygons is None or not {"x", "y", "z"} <= points.keys():
        raise FileFormatError("it must have vertices with x, y and z, and faces with a list vertex_indices")
    corners = check_indices(polygons[0], "indices")
    return {"": lambda: (np.column_stack([points[x][0].astype(float) for x in "xyz"]), fans(corners, polygons[1]))}


def _header(data: bytes) -> tuple[list[_Element], str, int]:
    """Return the elements, the byte order (empty for text) and the first byte of the rows."""
    end = data.find(b"end_header", 0, MAX_HEADER_BYTES)
    at = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or at == 0 or data[end + 10 : at].strip():
        raise FileFormatError(f"its header must start with ply and end with end_header within {MAX_HEADER_BYTES} bytes")
    elements: list[_Element] = []
    order = None
    for line in data[:end].splitlines()[1:]:
        words = line.split()
        if not words or words[0] in (b"comment", b"obj_info"):
            continue
        if words[0] == b"format" and len(words) == 3:
            order = BYTE_ORDERS.get(words[1])
        elif words[0] == b"element" and len(words) == 3:
            name = words[1].decode("ascii", "replace")
            elements.append(_Element(name, read_count(words[2], "triangles" if name == "face" else "rows", len(data))))
        elif (
            words[0] == b"property" and elements and len(words) in (3, 5) and (words[1] == b"list") == (len(words) == 5)
        ):
            kinds = [NUMPY_TYPES.get(each.decode("ascii", "replace"), "") for each in words[1:-1] if each != b"list"]
            if "" in kinds:
                raise FileFormatError(f"its header states a property of unknown type: {printable_word(line)}")
            elements[-1].properties.append((words[-1].decode("ascii", "replace"), kinds[-1], "".join(kinds[:-1])))
        else:
            raise FileFormatError(f"its header holds an unknown line {printable_word(line)}")
    if order is None:
        raise FileFormatError("its header must state a format: ascii, binary_little_endian or binary_big_endian")
    return elements, order, at


def _rows(element: _Element, data: bytes, at: int, order: str) -> tuple[dict[str, tuple[NDArray[Any], Ints]], int]:
    """Return the values and list lengths of each property over all rows, and the first byte of the next element."""
    least = sum(np.dtype(length or kind).itemsize for _, kind, length in element.properties)
    if element.count * least > len(data) - at:
        raise FileFormatError(
            f"it states {element.count} rows of {printable_word(element.name.encode())} and ends before that"
        )
    if not element.count or not element.properties:
        return {}, at
    sizes = _sizes(element, data, at, order)
    row = _row(element, sizes, order)
    if element.count * row.itemsize <= len(data) - at:
        rows = np.frombuffer(data, row, element.count, at)
        if all(np.all(rows[f"n{k}"] == n) for k, n in enumerate(sizes) if n is not None):  # all lists as the first
            values = {
                name: (rows[f"v{k}"].ravel(), np.full(element.count, n))
                for k, ((name, _, _), n) in enumerate(zip(element.properties, (s or 0 for s in sizes), strict=True))
                if element.name in NEEDED_ELEMENTS
            }
            return values, at + element.count * row.itemsize
    return _ragged_rows(element, data, at, order)


def _sizes(element: _Element, data: bytes, at: int, order: str) -> list[int | None]:
    """Return the lengths of the lists in the row that begins at a byte; None for single values."""
    sizes: list[int | None] = []
    for _, kind, length in element.properties:
        n = None
        if length:
            stated = struct.Struct(order + STRUCT_CODES[length])
            n = _list_length(data, at, stated, np.dtype(kind).itemsize)
            at += stated.size
        sizes.append(n)
        at += np.dtype(kind).itemsize * (1 if n is None else n)
    return sizes


def _row(element: _Element, sizes: list[int | None], order: str) -> np.dtype[Any]:
    fields: list[Any] = []
    for k, ((_, kind, length), n) in enumerate(zip(element.properties, sizes, strict=True)):
        if n is not None:
            fields.append((f"n{k}", order + length))
        fields.append((f"v{k}", order + kind, () if n is None else (n,)))
    return np.dtype(fields)


def _ragged_rows(
    element: _Element, data: bytes, at: int, order: str
) -> tuple[dict[str, tuple[NDArray[Any], Ints]], int]:
    """Return the values of rows with lists of different lengths, found one by one."""
    values = element.count * len(element.properties)
    if values > MAX_RAGGED_VALUES:
        raise FileFormatError(
            f"it must have at most {MAX_RAGGED_VALUES} values in rows of lists of different lengths, got {values}; "
            "save it without lists that are not faces"
        )
    count = element.count
    starts = np.empty((len(element.properties), count), dtype=np.int64)  # the first byte of each value or list
    sizes = np.ones((len(element.properties), count), dtype=np.int64)
    layout = [
        (np.dtype(kind).itemsize, struct.Struct(order + STRUCT_CODES[length]) if length else None)
        for _, kind, length in element.properties
    ]
    for row in range(count):
        for k, (width, length) in enumerate(layout):
            n = 1
            if length is not None:
                n = _list_length(data, at, length, width)
                at += length.size
                sizes[k, row] = n
            starts[k, row] = at
            at += n * width
    if at > len(data):
        raise FileFormatError("it ends within a row")
    if element.name not in NEEDED_ELEMENTS:
        return {}, at
    content, by_property = np.frombuffer(data, "u1"), {}
    for k, (name, kind, _) in enumerate(element.properties):
        width, total = layout[k][0], int(sizes[k].sum())
        first = np.cumsum(sizes[k]) - sizes[k]
        place = np.repeat(starts[k] - first * width, sizes[k]) + np.arange(total) * width
        by_property[name] = (content[place[:, None] + np.arange(width)].view(order + kind).reshape(-1), sizes[k])
    return by_property, at


def _list_length(data: bytes, at: int, length: struct.Struct, width: int) -> int:
    """Return the length of a list that fits in the rest of the file."""
    if at + length.size > len(data):
        raise FileFormatError("it ends within a row")
    stated = length.unpack_from(data, at)[0]
    if not 0 <= stated <= (len(data) - at) // width or stated != int(stated):
        raise FileFormatError(f"it states a list of {stated} entries, for which it has no room")
    return int(stated)
