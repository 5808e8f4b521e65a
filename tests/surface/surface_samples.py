"""Small valid files of every kind of surface, as bytes."""

from __future__ import annotations

import base64
import gzip
import json
from itertools import product

import numpy as np
from closed_surfaces import cube


def samples(folder):
    """Bytes of a cube in every kind, by names whose suffix is that of the kind; made by trimesh and VTK."""
    import trimesh

    body = cube(0.1, 0.2)
    mesh = trimesh.Trimesh(body.vertices, body.triangles, process=False)
    made = {f"exported.{kind}": mesh.export(file_type=kind) for kind in ("stl", "obj", "ply", "off", "glb")}
    made["text.stl"] = mesh.export(file_type="stl_ascii")
    made["text.ply"] = mesh.export(file_type="ply", encoding="ascii")
    made["embedded.gltf"] = gltf(body)
    made = {name: data.encode() if isinstance(data, str) else data for name, data in made.items()}
    made.update(vtk_samples(body, folder))
    made["big.ply"] = big_endian_ply(body)
    made["text.trian"] = trian(body)
    made["packed.off.gz"] = gzip.compress(made["exported.off"], mtime=0)
    return made


def gltf(body, **changed):
    """A glTF file with its buffer in a URI; `changed` replaces entries of its JSON."""
    points, indices = body.vertices.astype("<f4").tobytes(), body.triangles.astype("<u2").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(points + indices).decode()
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"name": "cube", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(body.vertices), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": body.triangles.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(indices)},
        ],
        "buffers": [{"uri": uri, "byteLength": len(points) + len(indices)}],
    }
    return json.dumps(content | changed).encode()


def vtk_samples(body, folder):
    """What VTK's own writers make: versions 4.2 and 5.1, text and binary, each way of writing arrays."""
    from pyvista import PolyData
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    surface = PolyData.from_regular_faces(body.vertices, body.triangles)
    surface.field_data["note"] = np.arange(3.0)
    surface.cell_data["number"] = np.arange(len(body.triangles))
    made = {}
    for version, binary in product((42, 51), (False, True)):
        writer = vtkPolyDataWriter()
        writer.SetFileVersion(version)
        writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
        made[f"legacy-{version}-{'binary' if binary else 'ascii'}.vtk"] = writer
    for mode, wide, packed in product(("ascii", "binary", "raw", "base64"), (False, True), (False, True)):
        writer = vtkXMLPolyDataWriter()
        {"ascii": writer.SetDataModeToAscii, "binary": writer.SetDataModeToBinary}.get(
            mode, writer.SetDataModeToAppended
        )()
        writer.SetEncodeAppendedData(mode == "base64")
        writer.SetHeaderTypeToUInt64() if wide else writer.SetHeaderTypeToUInt32()
        writer.SetCompressorTypeToZLib() if packed else writer.SetCompressorTypeToNone()
        writer.SetBlockSize(256)  # bytes: several blocks an array
        made[f"{mode}-{64 if wide else 32}-{'zlib' if packed else 'plain'}.vtp"] = writer
    for name, writer in made.items():
        writer.SetInputData(surface)
        writer.SetFileName(str(folder / name))
        writer.Write()
    return {name: (folder / name).read_bytes() for name in made}


def big_endian_ply(body):
    """A binary PLY file with colours, a second element, and triangles and a pair of corners as faces."""
    points = np.zeros(len(body.vertices), dtype=[("p", ">f8", 3), ("c", "u1", 3)])
    points["p"] = body.vertices
    rows = b"".join(b"\3" + face.astype(">i4").tobytes() + b"\7" for face in body.triangles)
    head = (
        f"ply\nformat binary_big_endian 1.0\nelement vertex {len(points)}\nproperty double x\nproperty double y\n"
        "property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        f"element edge 1\nproperty int a\nelement face {len(body.triangles) + 1}\n"
        "property list uchar int vertex_index\nproperty uchar flag\nend_header\n"
    )
    return head.encode() + points.tobytes() + bytes(4) + rows + b"\2" + bytes(8) + b"\7"


def trian(body):
    """A trian file of SOFA: vertices, then triangles with their neighbours opposite to each vertex."""
    triangles = body.triangles
    edges = {
        (a, b): t for t, face in enumerate(triangles.tolist()) for a, b in zip(face, face[1:] + face[:1], strict=True)
    }
    rows = [(*face, *(edges[face[k - 1], face[k - 2]] for k in range(3))) for face in triangles.tolist()]
    lines = [f"{len(body.vertices)}", *(" ".join(map(repr, point)) for point in body.vertices.tolist())]
    lines += [f"{len(rows)}", *(" ".join(map(str, row)) for row in rows)]
    return "\n".join(lines).encode()
