"""Surface files of few bytes that are composed to cost much: repeated, shared, empty and nested parts.

`fuzz.py` runs these trials as kind ``cost``. A trial fails if a file of up to `MAX_BYTES` takes more
than `MAX_SECONDS` of computing time; the memory of a trial is limited by `fuzz.py`.
"""

from __future__ import annotations

import base64
import json
import struct
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import palpate as pt

Rng = np.random.Generator

MAX_BYTES = 500_000
MAX_SECONDS = 6.0  # of computing time of a file: 12 µs a byte


def trial(rng: Rng, folder: Path) -> str:
    """Compose a file, read and check it."""
    suffix = str(rng.choice(sorted(COMPOSERS)))
    data = COMPOSERS[suffix](rng)[:MAX_BYTES]
    path = folder / f"composed.{suffix}"
    path.write_bytes(data)
    began = time.process_time()
    try:
        surface = pt.io.read_surface(path, units="m", repair=bool(rng.integers(2)))
        pt.io.check_surface(surface)
        found = "accepted"
    except pt.InputError:
        found = "refused"
    took = time.process_time() - began
    return found if took <= MAX_SECONDS else f"slow: {suffix} of {len(data)} bytes, {took:.0f} s"


def _count(rng: Rng, most: int) -> int:
    """Return a count, as often small as large."""
    return int(most ** rng.random())


def _gltf_content(rng: Rng) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of a glTF file and its buffer, with shared and repeated parts."""
    corners = _count(rng, 150_000)
    points = rng.normal(size=(_count(rng, 10_000) + 3, 3)).astype("<f4")
    kind, code = [("<u2", 5123), ("<u4", 5125), ("u1", 5121)][int(rng.integers(3))]
    limit = min(len(points), 255 if kind == "u1" else 65_535)
    indices = rng.integers(0, limit, corners) if rng.random() < 0.5 else np.tile([0, 1, 2], corners // 3 + 1)
    places, triangles = points.tobytes(), indices.astype(kind).tobytes()
    views = [
        {"buffer": 0, "byteLength": len(places)},
        {"buffer": 0, "byteOffset": len(places), "byteLength": len(triangles)},
    ]
    parts = _count(rng, min(1500, len(points) // 3))  # accessors of positions that do not overlap
    each = len(points) // parts
    accessors: list[dict[str, Any]] = [
        {"bufferView": 1, "componentType": code, "count": len(indices), "type": "SCALAR"},
        *(
            {"bufferView": 0, "byteOffset": 12 * each * k, "componentType": 5126, "count": each, "type": "VEC3"}
            for k in range(parts)
        ),
    ]
    primitives: list[dict[str, Any]] = [
        {"attributes": {"POSITION": 1 + k % parts}, "mode": int(rng.integers(4, 7))}
        | ({} if rng.random() < 0.1 else {"indices": 0})
        for k in range(_count(rng, 3000))
    ]
    if rng.random() < 0.3:
        primitives = [{}] * _count(rng, 60_000)
    mesh: dict[str, Any] = {"primitives": primitives}
    if rng.random() < 0.4:
        mesh["name"] = ["a" * _count(rng, 150_000), ["x"] * _count(rng, 20_000), "b_1"][int(rng.integers(3))]
    meshes = [mesh] * (1 if rng.random() < 0.7 else _count(rng, 50))
    nodes: list[dict[str, Any]] = [{"mesh": int(rng.integers(len(meshes)))} for _ in range(_count(rng, 12_000))]
    if rng.random() < 0.3:
        nodes = [node | {"scale": [1, 1, -1], "children": [k + 1]} for k, node in enumerate(nodes)] + [{}]
    content = {
        "meshes": meshes, "nodes": nodes, "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": len(places) + len(triangles)}],
    }  # fmt: skip
    return content, places + triangles


def _glb(rng: Rng) -> bytes:
    content, binary = _gltf_content(rng)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = [struct.pack("<I4s", len(part), name) + part for part, name in ((text, b"JSON"), (binary, b"BIN\0"))]
    return struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, chunks))) + b"".join(chunks)


def _gltf(rng: Rng) -> bytes:
    content, binary = _gltf_content(rng)
    content["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    return json.dumps(content).encode()


def _vtp(rng: Rng) -> bytes:
    if rng.random() < 0.3:  # words of the grammar, again and again
        words = [
            b"<AppendedData",
            b"<AppendedData>",
            b" ",
            b"_",
            b"\n",
            b"<Piece/>",
            b"<Points>",
            b"<DataArray>",
            b"<a>",
        ]
        unit = b"".join(words[int(k)] for k in rng.integers(len(words), size=int(rng.integers(1, 4))))
        return (b"<VTKFile>" if rng.random() < 0.5 else b"") + unit * _count(rng, MAX_BYTES // len(unit))
    blocks = _count(rng, 20_000)
    block = zlib.compress(bytes(_count(rng, 1000))) if rng.random() < 0.7 else b""
    size = len(zlib.decompress(block)) if block else 0
    head = struct.pack("<3I", blocks, size, int(rng.choice([0, size, 1])))
    packed = head + struct.pack("<I", len(block)) * blocks + block * blocks
    array = b'<DataArray type="Float32" Name="%d" format="appended" offset="0"/>'
    points = b'<Piece NumberOfPoints="1"><Points>' + array % 0 + b"</Points>"
    arrays = b"".join(b"<Polys>" + array % k + b"</Polys>" for k in range(_count(rng, 3)))
    piece = points + arrays + b"</Piece>"
    return (
        b'<VTKFile type="PolyData" byte_order="LittleEndian" compressor="vtkZLibDataCompressor">'
        + piece * _count(rng, max(2, (MAX_BYTES - len(packed)) // len(piece)))
        + b'<AppendedData encoding="raw">_' + packed + b"</AppendedData></VTKFile>"
    )  # fmt: skip


def _ply(rng: Rng) -> bytes:
    lists = _count(rng, 1000)
    head = b"ply\nformat binary_little_endian 1.0\n"
    rows = (MAX_BYTES - 60_000) // lists
    name = [b"x", b"face", b"vertex"][int(rng.integers(3))]
    head += b"element %s %d\n" % (name, rows)
    head += b"".join(b"property list uchar %s a%d\n" % (rng.choice([b"uchar", b"int"]), k) for k in range(lists))
    head += b"element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    body = bytes(rows * lists) if rng.random() < 0.5 else b"\1" + bytes(rows * lists)
    return head + body + np.eye(3, dtype="<f4").tobytes() + b"\3" + struct.pack("<3i", 0, 1, 2)


def _vtk(rng: Rng) -> bytes:
    head = b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n"
    units = [
        b"POLYGONS 0 0\n",
        b"FIELD f 1\na 0 0 int\n",
        b"POINTS 0 float\n",
        b" \n",
        b"METADATA\n",
        b"POLYGONS 1 4\n3 0 1 2\n",
    ]
    unit = units[int(rng.integers(len(units)))]
    return head + unit * _count(rng, MAX_BYTES // len(unit))


def _words(*units: bytes) -> Callable[[Rng], bytes]:
    """Return a composer that repeats a few words."""

    def compose(rng: Rng) -> bytes:
        unit = b"".join(units[int(k)] for k in rng.integers(len(units), size=int(rng.integers(1, 5))))
        return units[0] + unit * _count(rng, MAX_BYTES // len(unit))

    return compose


COMPOSERS: dict[str, Callable[[Rng], bytes]] = {
    "glb": _glb, "gltf": _gltf, "vtp": _vtp, "ply": _ply, "vtk": _vtk,
    "stl": _words(b"solid x\n", b"vertex ", b" ", b"\n", b"0 0 0\n", b"endsolid", b"endfacet\n", b"a"),
    "obj": _words(b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", b"f 1 2 3\n", b"o x\n", b"o ", b"v 0 0 1\n", b" ", b"\\\n", b"f"),
    "off": _words(b"OFF\n3 9 0\n0 0 0\n1 0 0\n0 1 0\n", b"3 0 1 2\n", b"#", b"\n", b"OFF", b" "),
}  # fmt: skip
