"""glTF and GLB files: the triangles of meshes, transformed by the nodes of the scene."""

from __future__ import annotations

import base64
import binascii
import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import json_of, shortened
from palpate.surface.formats.common import Parts, check_indices, fans, strips, triangle_count_error
from palpate.surface.surface import MAX_TRIANGLES

TYPE_BY_COMPONENT = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH_BY_TYPE = {"SCALAR": 1, "VEC3": 3}
TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives
TRANSFORM_KEYS = {"matrix", "rotation", "scale", "translation"}
MAX_BYTES = 2**40  # bytes
MAX_VALUES = 1_000_000  # of the JSON, so that it takes some hundred megabytes at most
MAX_NODES = 50_000
MAX_PRIMITIVES = 10_000  # of a mesh
MAX_NAME_LENGTH = 200  # characters
MAX_REUSE = 4  # corners that the primitives of a mesh use, over the bytes of the buffers


def read_glb(data: bytes) -> Parts:
    """Return the parts of a GLB file: its meshes, by their names."""
    version, length = (int.from_bytes(data[k : k + 4], "little") for k in (4, 8))
    if data[:4] != b"glTF" or version != 2 or length > len(data):
        raise FileFormatError(f"it must be glTF of version 2 and have the {length} bytes that its header states")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= length:
        size = int.from_bytes(data[at : at + 4], "little")
        if at + 8 + size > length:
            raise FileFormatError(f"its chunk at byte {at} states {size} bytes and has {length - at - 8}")
        chunks.setdefault(data[at + 4 : at + 8], data[at + 8 : at + 8 + size])
        at += 8 + size
    return _parts(chunks.get(b"JSON", b""), chunks.get(b"BIN\0"))


def read_gltf(data: bytes) -> Parts:
    """Return the parts of a glTF file that contains all its buffers."""
    return _parts(data, None)


def _parts(text: bytes, binary: bytes | None) -> Parts:
    if sum(map(text.count, (b",", b"[", b"{"))) > MAX_VALUES:
        raise FileFormatError(f"its JSON must have at most {MAX_VALUES} values; export the surface alone")
    try:
        content = json_of(text.decode("utf-8-sig").rstrip("\0"))
    except (InputError, UnicodeDecodeError) as error:
        raise FileFormatError(f"its JSON cannot be read ({error})") from None
    if not isinstance(content, dict):
        raise FileFormatError("its JSON must be an object")
    file = _GltfFile(content, binary)
    parts: Parts = {}
    meshes: dict[int, tuple[str, list[dict[str, Any]]]] = {}  # each once, however many nodes place it
    copies: dict[str, int] = {}
    for number, matrix in _scene_meshes(file):
        row = file.entry("meshes", number)
        if number not in meshes:
            meshes[number] = _mesh(row, number)
        name, primitives = meshes[number]
        if primitives:
            parts[_unused(name, parts, copies)] = partial(_join_primitives, file, primitives, matrix)
    return parts


def _mesh(row: dict[str, Any], number: int) -> tuple[str, list[dict[str, Any]]]:
    """Return the name and the primitives of triangles of a mesh."""
    rows = _object_list(row, "primitives")
    if len(rows) > MAX_PRIMITIVES:
        raise FileFormatError(f"its meshes must have at most {MAX_PRIMITIVES} primitives, got {len(rows)}; join them")
    name = row.get("name")
    name = shortened(name, MAX_NAME_LENGTH) if isinstance(name, str) else f"mesh {number}"
    return name, [each for each in rows if each.get("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN)]


def _unused(name: str, parts: Parts, copies: dict[str, int]) -> str:
    """Return the name, or with the next free number of its copies."""
    free = name
    while free in parts:
        copies[name] = copies.get(name, len(parts) - 1) + 1
        free = f"{name}_{copies[name]}"
    return free


@dataclass
class _GltfFile:
    """The JSON of a file, with bounded access to its tables and buffers."""

    content: dict[str, Any]
    binary: bytes | None
    buffers: dict[int, bytes] = field(default_factory=dict)
    arrays: dict[int, NDArray[Any]] = field(default_factory=dict)
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    size: int = 0  # bytes of the buffers that were read
    read: int = 0  # bytes of accessors

    def entry(self, table: str, number: Any) -> dict[str, Any]:
        if table not in self.tables:
            self.tables[table] = _object_list(self.content, table)
        rows = self.tables[table]
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(rows):
            raise FileFormatError(f"it refers to {table}[{number!r:.30}] and has {len(rows)}")
        return rows[number]

    def buffer(self, number: Any) -> bytes:
        if number not in self.buffers:
            row = self.entry("buffers", number)
            uri = row.get("uri")
            if uri is None and number == 0 and self.binary is not None:
                content = self.binary
            elif isinstance(uri, str) and uri.startswith("data:") and ";base64," in uri[:200]:
                try:
                    content = base64.b64decode(uri.partition(",")[2], validate=True)
                except (binascii.Error, ValueError):
                    raise FileFormatError(f"its buffer {number} is not valid base64") from None
            else:
                raise FileFormatError(f"its buffer {number} is in another file, which is not read; export it as GLB")
            if _integer(row, "byteLength", MAX_BYTES) > len(content):
                raise FileFormatError(f"its buffer {number} is shorter than it states")
            self.buffers[number] = content
            self.size += len(content)
        return self.buffers[number]

    def array(self, number: Any, kind: str) -> NDArray[Any]:
        """Return the rows of an accessor, (n,) of scalars and (n, 3) of vectors."""
        row = self.entry("accessors", number)
        width = WIDTH_BY_TYPE[kind]
        if row.get("type") != kind or row.get("componentType") not in TYPE_BY_COMPONENT:
            raise FileFormatError(f"its accessor {number} must be of type {kind}")
        if number not in self.arrays:
            if "sparse" in row or "bufferView" not in row:
                raise FileFormatError(f"its accessor {number} is sparse or has no data, which is not supported")
            view = self.entry("bufferViews", row["bufferView"])
            if "extensions" in view:
                raise FileFormatError("its buffers are compressed, which is not supported; export it without")
            data = self.buffer(view.get("buffer"))
            dtype = np.dtype(TYPE_BY_COMPONENT[row["componentType"]])
            count, size = _integer(row, "count", MAX_BYTES), width * dtype.itemsize
            start, length = _integer(view, "byteOffset", MAX_BYTES, 0), _integer(view, "byteLength", MAX_BYTES)
            offset, stride = _integer(row, "byteOffset", MAX_BYTES, 0), _integer(view, "byteStride", 1 << 16, size)
            last = offset + stride * (count - 1) + size
            if count == 0 or stride < size or last > length or start + length > len(data):
                raise FileFormatError(f"its accessor {number} must lie within its buffer")
            self.read += count * size
            if self.read > self.size:
                raise FileFormatError("its accessors read more bytes than its buffers have; they must not overlap")
            step = (stride, dtype.itemsize)[: 1 + (width > 1)]
            self.arrays[number] = np.ndarray((count, 3)[: 1 + (width > 1)], dtype, data, start + offset, step).copy()
        return self.arrays[number]


def _object_list(row: dict[str, Any], key: str) -> list[dict[str, Any]]:
    rows = row.get(key, [])
    if not isinstance(rows, list) or not all(isinstance(each, dict) for each in rows):
        raise FileFormatError(f"its {key} must be a list of objects")
    return rows


def _integer(row: dict[str, Any], key: str, most: int, default: int | None = None) -> int:
    value = row.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise FileFormatError(f"its {key} must be a whole number from 0 to {most}, got {value!r:.30}")
    return value


def _scene_meshes(file: _GltfFile) -> list[tuple[Any, Floats]]:
    """Return the indices of meshes in the scene with their matrices, each node once."""
    nodes = _object_list(file.content, "nodes")
    if len(nodes) > MAX_NODES:
        raise FileFormatError(f"it must have at most {MAX_NODES} nodes, got {len(nodes)}; join its meshes")
    if _object_list(file.content, "scenes"):
        roots = _numbers(file.entry("scenes", file.content.get("scene", 0)), "nodes")
    else:
        children = {k for node in nodes for k in _numbers(node, "children")}
        roots = [k for k in range(len(nodes)) if k not in children]
    meshes, seen = [], set()
    waiting = [(k, np.eye(4)) for k in reversed(roots)]
    while waiting:
        number, above = waiting.pop()
        if number in seen:
            raise FileFormatError(f"its node {number} must have one parent only")
        node = file.entry("nodes", number)
        seen.add(number)
        matrix = above @ _matrix(node) if TRANSFORM_KEYS & node.keys() else above
        if "mesh" in node:
            meshes.append((node["mesh"], matrix))
        waiting += [(k, matrix) for k in reversed(_numbers(node, "children"))]
    return meshes


def _numbers(row: dict[str, Any], key: str) -> list[int]:
    values = row.get(key, [])
    if not isinstance(values, list) or not all(isinstance(k, int) and not isinstance(k, bool) for k in values):
        raise FileFormatError(f"its {key} must be a list of whole numbers")
    return values


def _matrix(node: dict[str, Any]) -> Floats:
    """Return the matrix (4, 4) of a node, from columns or from scale, rotation and translation."""
    if "matrix" in node:
        return _vector(node, "matrix", [0.0] * 16).reshape(4, 4).T
    x, y, z, w = _vector(node, "rotation", [0.0, 0.0, 0.0, 1.0])
    square = x * x + y * y + z * z + w * w
    if not 0.5 < square < 2:
        raise FileFormatError("the rotation of a node must be a unit quaternion")
    turn = np.array([
        [1 - 2 * (y * y + z * z) / square, 2 * (x * y - z * w) / square, 2 * (x * z + y * w) / square],
        [2 * (x * y + z * w) / square, 1 - 2 * (x * x + z * z) / square, 2 * (y * z - x * w) / square],
        [2 * (x * z - y * w) / square, 2 * (y * z + x * w) / square, 1 - 2 * (x * x + y * y) / square],
    ])  # fmt: skip
    matrix = np.eye(4)
    matrix[:3, :3] = turn * _vector(node, "scale", [1.0] * 3)
    matrix[:3, 3] = _vector(node, "translation", [0.0] * 3)
    return matrix


def _vector(node: dict[str, Any], key: str, default: list[float]) -> Floats:
    values = node.get(key, default)
    plain = isinstance(values, list) and len(values) == len(default)
    if not plain or not all(isinstance(x, int | float) and math.isfinite(x) and abs(x) < 1e12 for x in values):
        raise FileFormatError(f"the {key} of a node must be {len(default)} numbers below 1e12")
    return np.array(values, dtype=float)


def _join_primitives(file: _GltfFile, primitives: list[dict[str, Any]], matrix: Floats) -> tuple[Floats, Ints]:
    """Return the transformed vertices and the triangles of all primitives of a mesh."""
    vertices: dict[Any, Floats] = {}  # by the accessor, which primitives may share
    first: dict[Any, int] = {}
    v, used, total = 0, 0, 0
    triangles = []
    for position, indices, mode in dict.fromkeys(map(_key, primitives)):
        if position not in vertices:
            vertices[position] = _positions(file, position)
            first[position], v = v, v + len(vertices[position])
        count = len(vertices[position] if indices is None else file.array(indices, "SCALAR"))
        used += count
        if used > MAX_REUSE * file.size:
            raise FileFormatError(f"its primitives use {used} corners of {file.size} bytes; join those that are equal")
        if indices is None:
            corners = np.arange(count)
        else:
            corners = check_indices(file.array(indices, "SCALAR"), "indices")
            if corners.max() >= len(vertices[position]):
                raise FileFormatError(f"its accessor {indices} names vertices that do not exist")
        if mode == TRIANGLES:
            corners_of_triangles = fans(corners, np.full(len(corners) // 3, 3))
        else:
            corners_of_triangles = (strips if mode == STRIP else fans)(corners, np.array([len(corners)]))
        triangles.append(corners_of_triangles + first[position])
        total += len(corners_of_triangles)
        if total > MAX_TRIANGLES:
            raise triangle_count_error(total)
    joined = np.concatenate(triangles)
    with np.errstate(all="ignore"):  # `Surface` raises for values that are not finite
        placed = np.concatenate(list(vertices.values())) @ matrix[:3, :3].T + matrix[:3, 3]
        mirrored = np.linalg.det(matrix[:3, :3]) < 0
    return placed, joined[:, ::-1] if mirrored else joined


def _key(primitive: dict[str, Any]) -> tuple[Any, Any, int]:
    """Return the accessors of positions and indices, and the mode, of a primitive."""
    extensions, attributes = primitive.get("extensions", {}), primitive.get("attributes")
    if not isinstance(extensions, dict) or "KHR_draco_mesh_compression" in extensions:
        raise FileFormatError("its meshes are compressed by Draco, which is not supported; export it without")
    if not isinstance(attributes, dict) or not isinstance(attributes.get("POSITION"), int):
        raise FileFormatError("its primitives must have positions")
    indices = primitive.get("indices")
    if indices is not None and not isinstance(indices, int):
        raise FileFormatError("the indices of its primitives must be a whole number")
    return attributes["POSITION"], indices, primitive.get("mode", TRIANGLES)


def _positions(file: _GltfFile, number: Any) -> Floats:
    values = file.array(number, "VEC3")
    row = file.entry("accessors", number)
    scale = np.iinfo(values.dtype).max if row.get("normalized") is True and values.dtype.kind != "f" else 1
    return np.asarray(values, dtype=float) / scale
