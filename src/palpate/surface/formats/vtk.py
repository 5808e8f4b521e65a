"""Legacy VTK files of PolyData, ASCII and binary, versions 1 to 5."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import FileFormatError
from palpate.surface.formats.common import Parts, check_indices, fans, printable_word, read_count, read_numbers, strips

NUMPY_TYPES = {
    b"char": ">i1", b"unsigned_char": ">u1", b"short": ">i2", b"unsigned_short": ">u2", b"int": ">i4",
    b"unsigned_int": ">u4", b"long": ">i8", b"unsigned_long": ">u8", b"float": ">f4", b"double": ">f8",
    b"vtkidtype": ">i4", b"vtktypeint32": ">i4", b"vtktypeint64": ">i8",
}  # fmt: skip
MAX_SECTIONS = 1000  # and arrays of fields
CELL_SECTIONS = (b"VERTICES", b"LINES", b"POLYGONS", b"TRIANGLE_STRIPS")


def read_vtk(data: bytes) -> Parts:
    """Return the surface of a legacy VTK file: its polygons and strips of triangles."""
    lines = _Lines(data)
    head = lines.next()
    lines.next(blank=True)  # title
    form = lines.next().upper()
    if not head.lower().startswith(b"# vtk datafile version") or form not in (b"ASCII", b"BINARY"):
        raise FileFormatError("it must start with # vtk DataFile Version, a title, and ASCII or BINARY")
    lines.text = form == b"ASCII"
    if lines.next().upper().split() != [b"DATASET", b"POLYDATA"]:
        raise FileFormatError("its DATASET must be POLYDATA; extract its surface first (in ParaView: Extract Surface)")
    points: Floats | None = None
    triangles: list[Ints] = []
    sections = 0
    while words := lines.next().split():
        sections += 1
        if sections > MAX_SECTIONS:
            raise FileFormatError(f"it must have at most {MAX_SECTIONS} sections; export the surface alone")
        key = words[0].upper()
        if key in (b"POINT_DATA", b"CELL_DATA"):
            break
        if key == b"METADATA":
            while lines.next(blank=True):
                pass
        elif key == b"FIELD" and len(words) == 3:
            for _ in range(read_count(words[2], "arrays", min(len(data), MAX_SECTIONS))):
                _field(lines)
        elif key == b"POINTS" and len(words) == 3:
            n = read_count(words[1], "points", len(data))
            points = lines.array(3 * n, words[2]).astype(float).reshape(-1, 3)
        elif key in CELL_SECTIONS and len(words) == 3:
            corners, sizes = _cells(lines, words[1], words[2])
            if key == b"POLYGONS":
                triangles.append(fans(corners, sizes))
            elif key == b"TRIANGLE_STRIPS":
                triangles.append(strips(corners, sizes))
        else:
            raise FileFormatError(f"it has an unknown line {printable_word(b' '.join(words))}")
    if points is None or not triangles:
        raise FileFormatError("it must have POINTS, and POLYGONS or TRIANGLE_STRIPS")
    vertices = points
    return {"": lambda: (vertices, np.concatenate(triangles))}


@dataclass
class _Lines:
    """The bytes of a file and the place of the next line or array."""

    data: bytes
    text: bool = True
    at: int = 0

    def next(self, blank: bool = False) -> bytes:
        """Return the next line, by default one that is not blank; none at the end."""
        while self.at < len(self.data):
            end = self.data.find(b"\n", self.at)
            end = len(self.data) if end < 0 else end
            line = self.data[self.at : end].strip()
            self.at = min(end + 1, len(self.data))
            if line or blank:
                return line
        return b""

    def array(self, count: int, kind: bytes) -> NDArray[Any]:
        """Return numbers of a type; in text, all numbers before the next word."""
        if kind.lower() not in NUMPY_TYPES:
            raise FileFormatError(f"it has numbers of an unknown type {printable_word(kind)}")
        dtype = np.dtype(NUMPY_TYPES[kind.lower()])
        if self.text:
            match = re.compile(rb"^[ \t]*[A-Za-z]", re.MULTILINE).search(self.data, self.at)
            end = match.start() if match else len(self.data)
            values = read_numbers(self.data[self.at : end])
        else:
            end = min(self.at + count * dtype.itemsize, len(self.data))
            values = np.frombuffer(self.data, dtype, (end - self.at) // dtype.itemsize, self.at)
        if len(values) != count:
            raise FileFormatError(f"it states {count} numbers and has {len(values)}")
        self.at = end
        return values


def _field(lines: _Lines) -> None:
    """Skip an array of a field."""
    words = lines.next().split()
    if len(words) != 4:
        raise FileFormatError("an array of its FIELD must state name, components, tuples and type")
    columns, rows = (read_count(each, "numbers", len(lines.data)) for each in words[1:3])
    lines.array(columns * rows, words[3])


def _cells(lines: _Lines, first: bytes, second: bytes) -> tuple[Ints, Ints]:
    """Return the corners of all polygons and their numbers, for either layout."""
    most = len(lines.data)
    count, size = read_count(first, "polygons", most), read_count(second, "indices", most)
    before = lines.at
    words = lines.next().split()
    if words and words[0].upper() == b"OFFSETS" and len(words) == 2:
        offsets = check_indices(lines.array(count, words[1]), "offsets")
        words = lines.next().split()
        if len(words) != 2 or words[0].upper() != b"CONNECTIVITY":
            raise FileFormatError("its OFFSETS must be followed by CONNECTIVITY")
        corners = check_indices(lines.array(size, words[1]), "indices")
        sizes = np.diff(offsets)
        if (count and offsets[0] != 0) or np.any(sizes < 0):
            raise FileFormatError("its OFFSETS must begin with 0 and ascend")
        return corners, sizes
    lines.at = before
    both = check_indices(lines.array(size, b"int"), "indices")
    if count == 0 or size == 0:
        return both, np.zeros(0, dtype=np.int64)
    starts = np.arange(0, size, both[0] + 1)  # if all polygons have as many corners as the first
    if len(starts) != count or size % count or np.any(both[starts] != both[0]):
        starts = _starts(both, count)
    keep = np.ones(size, dtype=bool)
    keep[starts] = False
    return both[keep], both[starts]


def _starts(both: Ints, count: int) -> Ints:
    """Return the indices at which polygons begin, each with the number of its corners."""
    starts: list[int] = []
    at = 0
    sizes = both.tolist()
    for _ in range(count):
        if at >= len(sizes):
            raise FileFormatError(f"it states {count} polygons and has {len(starts)}")
        starts.append(at)
        at += sizes[at] + 1
    if at != len(sizes):
        raise FileFormatError("its polygons must have as many indices as it states")
    return np.array(starts)
