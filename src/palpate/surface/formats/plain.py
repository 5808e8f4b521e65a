"""STL, OBJ, OFF and trian files."""

from __future__ import annotations

import re
from functools import partial
from itertools import chain

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import FileFormatError
from palpate.surface.formats.common import (
    Parts,
    check_indices,
    fans,
    printable_word,
    read_count,
    read_numbers,
    triangle_count_error,
)
from palpate.surface.surface import MAX_TRIANGLES

FACET_DTYPE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(data: bytes) -> Parts:
    """Return the parts of an STL file, binary or ASCII: the solids, by their names."""
    count = int.from_bytes(data[80:84], "little")
    size = 84 + FACET_DTYPE.itemsize * count
    if len(data) == size:
        if count > MAX_TRIANGLES:
            raise triangle_count_error(count)
        corners = np.frombuffer(data, FACET_DTYPE, count, 84)["corners"]
        return {"": lambda: (corners.reshape(-1, 3).astype(float), np.arange(3 * count).reshape(-1, 3))}
    if not data.lstrip()[:5].lower() == b"solid":
        raise FileFormatError(f"its header states {count} triangles, which take {size} bytes; it has {len(data)}")
    parts: dict[str, list[bytes]] = {}
    for solid in re.split(rb"(?i)\bendsolid\b[^\n]*", data):
        head, _, body = solid.strip().partition(b"\n")
        if body:
            parts.setdefault(head[5:].strip().decode("utf-8", "replace"), []).append(body)
    return {name: partial(_facets, b"\n".join(bodies)) for name, bodies in parts.items()}


def _facets(text: bytes) -> tuple[Floats, Ints]:
    words = [match[1] for match in re.finditer(rb"(?i)\bvertex\s+(\S+\s+\S+\s+\S+)", text)]
    facets = len(re.findall(rb"(?i)\bendfacet\b", text))
    vertices = read_numbers(b" ".join(words))
    if not facets or len(words) != 3 * facets or len(vertices) != 9 * facets:
        raise FileFormatError(f"its {facets} facets must have three vertices of three numbers each")
    return vertices.reshape(-1, 3), np.arange(3 * facets).reshape(-1, 3)


def read_obj(data: bytes) -> Parts:
    """Return the parts of an OBJ file: its objects, by their names. Material files are not read."""
    points: list[list[bytes]] = []
    polygons: dict[str, list[list[int]]] = {}
    current, faces = polygons.setdefault("", []), 0
    for number, line in enumerate(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines(), 1):
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            if len(words) < 4:
                raise FileFormatError(f"the vertex in line {number} must have three coordinates")
            points.append(words[1:4])
            if len(points) > 3 * MAX_TRIANGLES:
                raise FileFormatError(f"it must have at most {3 * MAX_TRIANGLES} vertices; decimate it first")
        elif words[0] == b"f":
            try:
                face = [int(each.partition(b"/")[0]) for each in words[1:]]
            except ValueError:
                raise FileFormatError(f"the face in line {number} must be of whole numbers") from None
            faces += 1
            if faces > MAX_TRIANGLES:
                raise triangle_count_error(faces)
            current.append([k - 1 if k > 0 else len(points) + k if k < 0 else -1 for k in face])
            if min(current[-1], default=0) < 0 or max(current[-1], default=0) >= 2**31:
                raise FileFormatError(f"the face in line {number} names a vertex that does not exist")
        elif words[0] == b"o":
            name = line.strip()[1:].strip().decode("utf-8", "replace")
            current = polygons.setdefault(name, [])
    vertices = read_numbers(b" ".join(chain.from_iterable(points)))
    if len(vertices) != 3 * len(points):
        raise FileFormatError("its vertices must have three coordinates each")
    return {name: partial(_object, vertices.reshape(-1, 3), faces) for name, faces in polygons.items() if faces}


def _object(vertices: Floats, faces: list[list[int]]) -> tuple[Floats, Ints]:
    corners = np.fromiter(chain.from_iterable(faces), dtype=np.int64)
    return vertices, fans(corners, np.fromiter(map(len, faces), dtype=np.int64, count=len(faces)))


def read_off(data: bytes) -> Parts:
    """Return the surface of an OFF file."""
    text = re.sub(rb"#[^\n]*", b"", data).strip()
    head = re.match(rb"(ST)?C?N?OFF\b", text)
    if head is None or text[head.end() :].lstrip()[:6] == b"BINARY":
        raise FileFormatError(f"it must start with OFF, and be text; it starts with {printable_word(text[:12])}")
    lines = [line for line in text[head.end() :].splitlines() if line.strip()]
    counts = lines[0].split() if lines else []
    if len(counts) < 2:
        raise FileFormatError("the numbers of vertices and faces are missing")
    triangles = read_count(counts[1], "triangles", len(lines) - 1)
    v = read_count(counts[0], "vertices", len(lines) - 1 - triangles)
    vertices = read_numbers(b" ".join(chain.from_iterable(line.split()[:3] for line in lines[1 : v + 1])))
    if len(vertices) != 3 * v:
        raise FileFormatError("its vertices must have three coordinates each")
    faces = []
    for line in lines[v + 1 : v + 1 + triangles]:
        words = line.split()
        size = read_count(words[0], "corners of a face", len(words) - 1)
        faces.append(words[1 : size + 1])
    corners = check_indices(read_numbers(b" ".join(chain.from_iterable(faces))), "indices")
    sizes = np.fromiter(map(len, faces), dtype=np.int64, count=len(faces))
    return {"": lambda: (vertices.reshape(-1, 3), fans(corners, sizes))}


def read_trian(data: bytes) -> Parts:
    """Return the surface of a trian file of SOFA.

    The text holds the number of vertices, their coordinates, the number of triangles, and for each triangle three
    vertices and three neighbours, -1 at a border (SOFA, `MeshTrianLoader`). The neighbours are not used.
    """
    values = read_numbers(data)
    if not len(values):
        raise FileFormatError("the number of vertices is missing")
    vertices = _count_at(values, 0, "vertices", 3)
    if 1 + 3 * vertices >= len(values):
        raise FileFormatError("the number of triangles is missing")
    triangles = _count_at(values, 1 + 3 * vertices, "triangles", 6)
    rows = values[2 + 3 * vertices :]
    if len(rows) != 6 * triangles:
        raise FileFormatError(
            f"its {triangles} triangles must have three vertices and three neighbours each, {6 * triangles} numbers, "
            f"got {len(rows)}"
        )
    corners = check_indices(rows.reshape(-1, 6)[:, :3], "vertices of triangles")
    return {"": lambda: (values[1 : 1 + 3 * vertices].reshape(-1, 3), corners)}


def _count_at(values: Floats, place: int, what: str, width: int) -> int:
    """Return the count at a place of numbers, whose rows of a width must fit behind it."""
    most = (len(values) - place - 1) // width
    number = values[place]
    if not float(number).is_integer():
        raise FileFormatError(f"the number of {what} must be an integer, got {number:g}")
    return read_count(str(int(number)), what, most)
