"""Readers of surface files: what valid files give, what files made to harm give, and what damage gives."""

from __future__ import annotations

import base64
import gzip
import json
import os
import re
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from closed_surfaces import ball, cube
from surface_samples import gltf, samples

import palpate as pt
from palpate.surface.files import READER_BY_FORMAT
from palpate.surface.formats.names import SURFACE_FORMATS, format_of, listed_formats

HUGE = (b"99999999", b"2147483648", b"18446744073709551616", b"-1", b"0.5", b"1e308", b"1e999", b"nan", b"0")
LEGACY = b"# vtk DataFile Version 3.0\nx\n%s\nDATASET POLYDATA\nPOINTS 3 float\n%s\n"
CORNERS = b"0 0 0 1 0 0 0 1 0"
PLY = b"ply\nformat %s 1.0\n%selement face %d\nproperty list %s int vertex_indices\nend_header\n"
POINTS = b"element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    return samples(tmp_path_factory.mktemp("samples"))


def read(folder, name, data, **options):
    (folder / name).write_bytes(data)
    return pt.io.read_surface(folder / name, units="m", **options)


def vtp(body=b"", head=b"", points=3, polys=1, appended=b""):
    """A VTP file of a piece with the arrays given."""
    return (
        b'<VTKFile type="PolyData" byte_order="LittleEndian" %s><PolyData>'
        b'<Piece NumberOfPoints="%d" NumberOfPolys="%d">%s</Piece></PolyData>%s</VTKFile>'
        % (head, points, polys, body, appended)
    )


def array(section, name, kind, text, form=b"ascii"):
    return b'<%s><DataArray type="%s" Name="%s" format="%s">%s</DataArray></%s>' % (
        section, kind, name, form, text, section,
    )  # fmt: skip


def blocks(*sizes, data=b""):
    return base64.b64encode(struct.pack(f"<{len(sizes)}I", *sizes)) + base64.b64encode(data)


def triangle(connectivity=b"0 1 2", offsets=b"3"):
    cells = array(b"Polys", b"connectivity", b"Int64", connectivity) + array(b"Polys", b"offsets", b"Int64", offsets)
    return array(b"Points", b"p", b"Float32", CORNERS) + cells


ZLIB = b'compressor="vtkZLibDataCompressor"'
BOMB = zlib.compress(bytes(200_000_000), 9)
BODY = cube(0.1, 0.2)
TWO = json.loads(gltf(BODY))


def shared_corners():
    """A glTF file of 1,500 primitives that share 75,000 corners."""
    count, copies = 75_000, 1500
    points, corners = np.tile(np.eye(3, dtype="<f4"), (copies, 1)), np.tile([0, 1, 2], count // 3).astype("u1")
    data = points.tobytes() + corners.tobytes()
    views = [
        {"buffer": 0, "byteLength": points.nbytes},
        {"buffer": 0, "byteOffset": points.nbytes, "byteLength": count},
    ]
    accessors = [{"bufferView": 1, "componentType": 5121, "count": count, "type": "SCALAR"}]
    accessors += [
        {"bufferView": 0, "byteOffset": 36 * k, "componentType": 5126, "count": 3, "type": "VEC3"}
        for k in range(copies)
    ]
    primitives = [{"attributes": {"POSITION": k + 1}, "indices": 0, "mode": 5} for k in range(copies)]
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return gltf(
        BODY, buffers=[{"uri": uri, "byteLength": len(data)}], bufferViews=views, accessors=accessors,
        meshes=[{"primitives": primitives}],
    )  # fmt: skip


ATTACKS = [
    ("size.vtk", LEGACY % (b"ASCII", CORNERS) + b"POLYGONS 1 4\n99999999 0 1 2\n", "99999999 corners"),
    ("index.vtk", LEGACY % (b"ASCII", CORNERS) + b"POLYGONS 1 4\n3 0 1 99999999\n", "vertices in .0, 2., got others"),
    ("negative.vtk", LEGACY % (b"ASCII", CORNERS) + b"POLYGONS 1 4\n3 0 1 -2\n", "must be from 0"),
    ("count.vtk", LEGACY % (b"ASCII", CORNERS) + b"POLYGONS 99999999 4\n3 0 1 2\n", "for the size of the file"),
    ("many.vtk", LEGACY % (b"ASCII", CORNERS) + b"POLYGONS 9 4\n3 0 1 2\n", "states 9 polygons"),
    ("points.vtk", LEGACY.replace(b"POINTS 3", b"POINTS 99999999") % (b"ASCII", CORNERS), "for the size of the file"),
    ("binary.vtk", LEGACY % (b"BINARY", bytes(36)) + b"POLYGONS 60 200\n" + b"\x7f" * 99, "states 200 numbers"),
    ("offsets.vtk", LEGACY % (b"ASCII", CORNERS) + b"POLYGONS 2 3\nOFFSETS int\n0 9\nCONNECTIVITY int\n0 1 2\n",
     "9 corners in total"),
    ("falls.vtk", LEGACY % (b"ASCII", CORNERS) + b"POLYGONS 3 3\nOFFSETS int\n0 6 3\nCONNECTIVITY int\n0 1 2\n",
     "ascend"),
    ("type.vtk", LEGACY.replace(b"float", b"string") % (b"ASCII", CORNERS), "unknown type"),
    ("grid.vtk", LEGACY.replace(b"POLYDATA", b"UNSTRUCTURED_GRID") % (b"ASCII", CORNERS), "must be POLYDATA"),
    ("field.vtk", LEGACY % (b"ASCII", CORNERS) + b"FIELD f 99999\n", "for the size of the file"),
    ("strip.vtk", LEGACY % (b"ASCII", CORNERS) + b"TRIANGLE_STRIPS 1 4\n3 0 1 7\n", "triangles must hold vertices in"),
    ("entities.vtp", b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>' + vtp(triangle()),
     "must not define"),
    ("external.vtp", b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]><VTKFile>&a;</VTKFile>',
     "must not define"),
    ("wide.vtp", ("<!DOCTYPE x []>" + vtp().decode()).encode("utf-16"), "must not define"),
    ("index.vtp", vtp(triangle(b"0 1 99999999")), "must have points below 3, got 99999999"),
    ("offset.vtp", vtp(triangle(offsets=b"99999999")), "99999999 corners"),
    ("points.vtp", vtp(triangle(), points=999), "has 9 coordinates"),
    ("bomb.vtp", vtp(array(b"Points", b"p", b"Float32", blocks(1, len(BOMB) * 999, 0, len(BOMB), data=BOMB), b"binary"),
                     ZLIB), "expand to more than"),
    ("hidden.vtp", vtp(array(b"Points", b"p", b"Float32", blocks(1, 36, 0, len(BOMB), data=BOMB), b"binary"), ZLIB),
     "must have 36 bytes"),
    ("blocks.vtp", vtp(array(b"Points", b"p", b"Float32", blocks(2**32 - 1, 36, 0, 9), b"binary"), ZLIB), "no room"),
    ("short.vtp", vtp(array(b"Points", b"p", b"Float32", blocks(2**31, data=bytes(36)), b"binary")), "expand to more"),
    ("appended.vtp", vtp(array(b"Points", b"p", b"Float32", b"", b'appended" offset="999999'),
                         appended=b'<AppendedData encoding="raw">_1234</AppendedData>'), "for the size of the file"),
    ("lz4.vtp", vtp(triangle(), b'compressor="vtkLZ4DataCompressor"'), "must be zlib"),
    ("header.vtp", vtp(array(b"Points", b"p", b"Float32", b"", b"binary"), b'header_type="Int8"'), "header_type"),
    ("count.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50), "states 4294967295 triangles"),
    ("cut.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\n",
     "must have three"),
    ("count.off", b"OFF\n99999999 1 0\n0 0 0\n3 0 0 0\n", "vertices must be at most 1 .*got 99999999"),
    ("faces.off", b"OFF\n1 999999 0\n0 0 0\n3 0 0 0\n", "triangles must be at most 2 .*got 999999"),
    ("size.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n99999999 0 1 2\n", "corners of a face"),
    ("count.trian", b"99999999\n0 0 0\n1\n0 0 0 -1 -1 -1\n", "vertices must be at most"),
    ("faces.trian", b"1\n0 0 0\n9\n0 0 0 -1 -1 -1\n", "triangles must be at most"),
    ("half.trian", b"1.5\n0 0 0\n1\n", "must be an integer"),
    ("rows.trian", b"3\n0 0 0 1 0 0 0 1 0\n1\n0 1 2 -1 -1 -1 7\n", "three neighbours"),
    ("index.trian", b"3\n0 0 0 1 0 0 0 1 0\n1\n0 1 9 -1 -1 -1\n", "triangles must hold vertices in"),
    ("short.trian", b"3\n0 0 0 1 0 0 0 1 0\n", "number of triangles is missing"),
    ("index.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 99999999\n", "triangles must hold vertices in"),
    ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999\n", "triangles must hold vertices in"),
    ("huge.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n", "does not exist"),
    ("behind.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -9\n", "does not exist"),
    ("zero.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "does not exist"),
    ("vertex.ply", PLY % (b"ascii", POINTS.replace(b"3", b"99999999"), 1, b"uchar") + CORNERS + b"\n3 0 1 2\n",
     "for the size of the file"),
    ("face.ply", PLY % (b"binary_little_endian", POINTS, 9999, b"uchar") + bytes(36) + b"\3" + bytes(12), "size of"),
    ("list.ply", PLY % (b"binary_little_endian", POINTS, 1, b"uint") + bytes(36) + b"\xff\xff\xff\x7f", "no room"),
    ("minus.ply", PLY % (b"binary_little_endian", POINTS, 1, b"int") + bytes(36) + b"\xff" * 4, "list of -1"),
    ("type.ply", PLY % (b"ascii", POINTS, 1, b"quad") + CORNERS, "unknown type"),
    ("half.ply", PLY % (b"ascii", POINTS, 1, b"uchar") + CORNERS + b" 2.5 0 1 2", "list of 2.5"),
    ("rows.ply", PLY % (b"ascii", b"element vertex 999999\n", 1, b"uchar") + CORNERS, "for the size of the file"),
    ("file.gltf", gltf(BODY, buffers=[{"uri": "secret.bin", "byteLength": 4}]), "another file"),
    ("above.gltf", gltf(BODY, buffers=[{"uri": "../../etc/passwd", "byteLength": 4}]), "another file"),
    ("net.gltf", gltf(BODY, buffers=[{"uri": "http://localhost/x", "byteLength": 4}]), "another file"),
    ("short.gltf", gltf(BODY, buffers=[TWO["buffers"][0] | {"byteLength": 10**12}]), "shorter than it states"),
    ("many.gltf", gltf(BODY, accessors=[TWO["accessors"][0] | {"count": 10**12}]), "must be a whole number|within"),
    ("count.gltf", gltf(BODY, accessors=[TWO["accessors"][0] | {"count": 10**9}]), "within its buffer"),
    ("offset.gltf", gltf(BODY, accessors=[TWO["accessors"][0] | {"byteOffset": 99}, TWO["accessors"][1]]), "within"),
    ("none.gltf", gltf(BODY, accessors=[{"componentType": 5126, "count": 10**9, "type": "VEC3"}]), "has no data"),
    ("view.gltf", gltf(BODY, bufferViews=[{"buffer": 0, "byteLength": 10**9}]), "within its buffer"),
    ("draco.gltf", gltf(BODY, meshes=[{"primitives": [TWO["meshes"][0]["primitives"][0] | {
        "extensions": {"KHR_draco_mesh_compression": {"bufferView": 0}}}]}]), "Draco"),
    ("ring.gltf", gltf(BODY, nodes=[{"children": [1]}, {"children": [0], "mesh": 0}]), "one parent"),
    ("double.gltf", gltf(BODY, nodes=[{"children": [1, 1]}, {"mesh": 0}]), "one parent"),
    ("mode.gltf", gltf(BODY, meshes=[{"primitives": [{"mode": 1, "attributes": {"POSITION": 0}}]}]), "hold triangles"),
    ("text.gltf", gltf(BODY, nodes="x"), "list of objects"),
    ("deep.gltf", b'{"a":' + b"[" * 100_000, "nested|valid JSON"),
    ("chunk.glb", b"glTF" + struct.pack("<III", 2, 20, 2**32 - 1) + b"JSON", "states 4294967295 bytes"),
    ("corners.gltf", shared_corners, "primitives use"),
    ("primitives.gltf",
     lambda: gltf(BODY, meshes=[{"primitives": [{}] * 50_000}], nodes=[{"mesh": 0}] * 12_000), "at most"),
    ("nodes.gltf", lambda: gltf(BODY, nodes=[{"mesh": 0}] * 60_000), "at most 50000 nodes"),
    ("values.gltf", lambda: gltf(BODY, extras=[0] * 1_000_001), "at most 1000000 values"),
    ("tags.vtp", b"<AppendedData" * 23_000, "not well formed"),
    ("arrays.vtp", vtp(b"<Points>" + b"<DataArray/>" * 100_001 + b"</Points>"), "at most 100000 pieces"),
    ("lists.ply", PLY.replace(b"element face", b"element x 5000000\nproperty list uchar int a\nelement face")
     % (b"binary_little_endian", POINTS, 1, b"uchar") + bytes(36) + b"\1" + bytes(5_000_020), "at most 4000000 values"),
    ("sections.vtk", LEGACY % (b"ASCII", CORNERS) + b"POLYGONS 0 0\n" * 20_000, "at most 1000 sections"),
    ("length.glb", b"glTF" + struct.pack("<II", 2, 2**31), "2147483648 bytes"),
]  # fmt: skip


def bytes_of(data):
    """Return the bytes of an attack; large ones are made when they are needed."""
    return data() if callable(data) else data


def test_files_of_every_writer_give_the_same_surface(valid, tmp_path):
    for name, data in valid.items():
        surface = read(tmp_path, name, data)
        assert len(surface.triangles) == 12, name
        assert surface.volume == pytest.approx(1e-3, rel=1e-6), name
        assert surface.vertices == pytest.approx(BODY.vertices[np.lexsort(BODY.vertices.T[::-1])], abs=1e-8), name


@pytest.mark.parametrize(("name", "data", "said"), ATTACKS, ids=[attack[0] for attack in ATTACKS])
def test_forged_files_are_refused_in_one_line(name, data, said, tmp_path):
    with pytest.raises(pt.InputError, match=said) as caught:
        read(tmp_path, name, bytes_of(data))
    assert len(str(caught.value)) < 500
    assert "\n" not in str(caught.value)
    assert "is damaged" not in str(caught.value)  # refused by a check, not by an exception of another kind


def heavy(folder):
    """Write files of up to 400 kB that ask for much; return their names."""
    rng = np.random.default_rng(0)
    lines = [b"OFF\n7000 7000 0", *(b"%g %g %g" % tuple(p) for p in rng.normal(size=(7000, 3)))]
    soup = rng.normal(size=(7000, 3, 3)).astype("<f4")
    records = np.zeros(7000, dtype=[("n", "<f4", 3), ("p", "<f4", (3, 3)), ("a", "<u2")])
    records["p"] = soup
    needles = records.copy()
    needles["p"] = rng.uniform(size=(7000, 1, 3)) * 1e-3 + np.array([[0, 0, 0], [1, 1, 1], [1, 1, 1.000001]])
    body = ball(0.05, 0.004)
    far = records[: len(body.triangles)].copy()
    far["p"] = body.vertices[body.triangles]
    far["p"][0, 0] = 1e8
    names = {
        "soup.stl": bytes(80) + struct.pack("<I", 7000) + records.tobytes(),
        "needles.stl": bytes(80) + struct.pack("<I", 7000) + needles.tobytes(),
        "far.stl": bytes(80) + struct.pack("<I", len(far)) + far.tobytes(),
        "fan.off": b"\n".join([*lines, *(b"3 0 %d %d" % (k % 7000, (k + 1) % 7000) for k in range(7000))]),
        "polygon.off": b"\n".join([*lines[:1], *lines[1:], *([b"3 0 1 2"] * 6999), b"60000 " + b"1 2 3 " * 20000]),
        "objects.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"".join(b"o %d\nf 1 2 3\n" % k for k in range(20_000)),
        "pieces.vtp": vtp(b'<Piece NumberOfPoints="1"/>' * 14_000),
        "nested.vtp": b"<VTKFile>" + b"<a>" * 100_000,
        "words.stl": b"solid " + b"vertex " * 50_000,
        "blank.obj": b"v" + b" " * 300_000 + b"\n" + b"f" * 50_000,
        "nodes.gltf": gltf(BODY, nodes=[{"mesh": 0}] * 20_000, scenes=[{"nodes": list(range(20_000))}]),
        "names.gltf": gltf(BODY, meshes=[{"name": "a" * 150_000, **TWO["meshes"][0]}], nodes=[{"mesh": 0}] * 12_000),
        "shared.gltf": gltf(BODY, accessors=[TWO["accessors"][0]] * 3000, meshes=[
            {"primitives": [{"attributes": {"POSITION": k}} for k in range(3000)]}]),
    }  # fmt: skip
    forged = {name: bytes_of(data) for name, data, _ in ATTACKS}
    for name, data in [*names.items(), *forged.items()]:
        (folder / name).write_bytes(data)
    return [*names, *(name for name, data in forged.items() if len(data) < 1_300_000)]


@pytest.mark.slow
def test_small_files_neither_use_much_memory_nor_crash_the_process(tmp_path):
    names = heavy(tmp_path)
    assert max((tmp_path / name).stat().st_size for name in names) < 1_300_000
    code = (
        "import sys, resource, palpate as pt\n"
        "from pathlib import Path\n"
        "def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "def read(path):\n"
        "    try: pt.io.check_surface(pt.io.read_surface(path))\n"
        "    except pt.InputError: pass\n"
        "read(sys.argv[1]); before = peak()\n"
        "for path in sys.argv[2:]:\n"
        "    read(path)\n"
        "    assert peak() - before < 200_000, path\n"
    )
    (tmp_path / "warm.stl").write_bytes((tmp_path / "far.stl").read_bytes())
    paths = [str(tmp_path / name) for name in ("warm.stl", *names)]
    ran = subprocess.run([sys.executable, "-c", code, *paths], capture_output=True, text=True, timeout=300)
    assert (ran.returncode, ran.stderr) == (0, "")


def damaged(data, rng):
    """Bytes with one to three random changes, most of them to numbers written in digits."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        place, length, kind = int(rng.integers(len(data))), int(rng.integers(1, 40)), rng.integers(8)
        if kind == 0:
            data[place] = int(rng.integers(256))
        elif kind == 1:
            data[place] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            del data[place + 1 :]
        elif kind == 3:
            data[place : place + length] = b"\0"
        elif kind == 4:
            data[place:place] = data[place : place + length]
        elif kind == 5:
            data[place : place + 4] = (b"\xff\xff\xff\x7f", b"\xff" * 4, b"\0\0\0\x80", bytes(4))[rng.integers(4)]
        elif found := list(re.finditer(rb"-?\d[\d.e+-]*", data)):
            start, end = found[int(rng.integers(len(found)))].span()
            data[start:end] = HUGE[rng.integers(len(HUGE))]
    return bytes(data)


@pytest.mark.slow
def test_random_damage_is_refused_or_gives_a_surface(valid, tmp_path):
    said = []
    for name, data in valid.items():
        for seed in range(60):
            try:
                surface = read(
                    tmp_path, name, damaged(data, np.random.default_rng([seed, len(data)])), repair=seed % 2 == 0
                )
                assert np.isfinite([surface.volume, surface.area]).all()
                pt.io.check_surface(surface)
            except pt.InputError as error:
                said.append(str(error))
    assert len(said) > 1000
    assert [text for text in said if "\n" in text or "is damaged" in text] == []


def test_no_other_file_is_read(tmp_path, monkeypatch):
    opened = []
    (tmp_path / "secret.mtl").write_text("newmtl x\nmap_Kd secret.png\n")
    text = b"mtllib secret.mtl\nusemtl x\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "body.obj").write_bytes(text)
    hook = {"on": True}
    sys.addaudithook(lambda event, args: opened.append(str(args[0])) if hook["on"] and event == "open" else None)
    pt.io.read_surface(tmp_path / "body.obj", units="m")
    hook["on"] = False
    assert any(name.endswith("body.obj") for name in opened)
    assert not any("secret" in name for name in opened)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_a_pipe_or_folder_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "folder.stl").mkdir()
    for name in ("pipe.stl", "folder.stl"):
        with pytest.raises(pt.FileFormatError, match="not a regular file"):
            pt.io.read_surface(tmp_path / name)


@pytest.mark.parametrize("scale", [1e308, 1e200, 1e10, 1e-12, 5e-324])
def test_coordinates_out_of_range_are_refused(scale, tmp_path):
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in (scale * cube(1.0, 2.0).vertices).tolist())
    text += "".join("f {} {} {}\n".format(*face) for face in BODY.triangles + 1)
    with pytest.raises(pt.InputError, match=r"at most 1e\+09|at least 1e-09"):
        read(tmp_path, "body.obj", text.encode())


def test_a_body_far_from_the_origin_is_refused_before_its_digits_are_lost():
    from palpate.surface.surface import weld

    assert weld(pt.Surface(BODY.vertices + 1e5, BODY.triangles)).volume == pytest.approx(1e-3, rel=1e-6)
    with pytest.raises(pt.InputError, match="times its size of the origin"):
        weld(pt.Surface(BODY.vertices + 1e8, BODY.triangles))


def test_copies_of_a_part_are_named_in_linear_time():
    from palpate.surface.formats.gltf import _unused

    class Counted(dict):
        looks = 0

        def __contains__(self, name):
            Counted.looks += 1
            return super().__contains__(name)

    parts, copies = Counted(), {}
    names = [f"x_{k}" for k in range(1000, 2000)] + ["x"] * 1000
    for name in names:
        parts[_unused(name, parts, copies)] = None
    assert len(parts) == len(names)
    assert Counted.looks < 4 * len(names)


def test_polygons_strips_and_lists_of_different_lengths_are_read(tmp_path):
    square = b"0 0 0 1 0 0 1 1 0 0 1 0 0.5 0.5 1"
    head = LEGACY.replace(b"POINTS 3", b"POINTS 5") % (b"ASCII", square)
    body = head + b"POLYGONS 4 16\n3 0 1 4 3 1 2 4 3 2 3 4 3 3 0 4\nTRIANGLE_STRIPS 1 5\n4 1 0 2 3\n"
    assert read(tmp_path, "strip.vtk", body).volume == pytest.approx(1 / 3)
    body = head + b"POLYGONS 5 21\n3 0 1 4 3 1 2 4 3 2 3 4 3 3 0 4 4 3 2 1 0\n"
    assert read(tmp_path, "mixed.vtk", body).volume == pytest.approx(1 / 3)
    rows = square.replace(b" 0.5 0.5", b"\n0.5 0.5") + b"\n3 0 1 4\n3 1 2 4\n3 2 3 4\n3 3 0 4\n4 3 2 1 0\n"
    assert read(tmp_path, "mixed.ply", PLY % (b"ascii", POINTS.replace(b"3", b"5"), 5, b"uchar") + rows).volume == (
        pytest.approx(1 / 3)
    )


def test_nodes_of_a_gltf_file_place_turn_and_mirror_their_meshes(tmp_path):
    turned = {"mesh": 0, "rotation": [0, 0, 0.5**0.5, 0.5**0.5], "translation": [1, 2, 3], "scale": [1, 2, -3]}
    nodes = [{"children": [1], "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]}, turned]
    surface = read(tmp_path, "body.gltf", gltf(BODY, nodes=nodes))
    assert surface.volume == pytest.approx(8 * 6e-3, rel=1e-6)
    assert np.ptp(surface.vertices, axis=0) == pytest.approx([0.4, 0.2, 0.6])
    assert surface.vertices.mean(axis=0) == pytest.approx([2, 4, 6])
    two = gltf(BODY, nodes=[{"mesh": 0}, {"mesh": 0, "translation": [1, 0, 0]}], scenes=[{"nodes": [0, 1]}])
    with pytest.raises(pt.InputError, match="part must be given for a file of 2 parts; choose one of cube, cube_1"):
        read(tmp_path, "two.gltf", two)
    assert read(tmp_path, "two.gltf", two, part="cube_1").volume == pytest.approx(1e-3, rel=1e-6)


def test_objects_of_an_obj_file_and_solids_of_an_stl_file_are_parts(tmp_path, valid):
    text = valid["exported.obj"]
    second = b"\no second\n" + b"\n".join(line for line in text.splitlines() if line.startswith(b"f"))
    (warning,) = read(tmp_path, "two.obj", text + second).warnings
    assert "two.obj has 2 parts" in warning
    assert read(tmp_path, "two.obj", text + second, part="second").volume == pytest.approx(1e-3)
    solids = b"\n".join(re.sub(rb"solid[^\n]*", b"solid " + name, valid["text.stl"]) for name in (b"left", b"right"))
    (warning,) = read(tmp_path, "two.stl", solids).warnings
    assert "left (0.001 litres) chosen" in warning.replace("1 litres", "0.001 litres")
    assert read(tmp_path, "two.stl", solids, part="left").volume == pytest.approx(1e-3)


def test_every_format_of_the_table_has_a_reader_and_is_named_in_help_and_documents():
    assert list(READER_BY_FORMAT) == list(SURFACE_FORMATS)
    root = Path(__file__).parents[2]
    texts = [(root / "docs" / "howto" / name).read_text() for name in ("view.md", "organs.md")]
    texts.append(pt.io.read_surface.__doc__)
    for text in texts:
        missing = [name for name in SURFACE_FORMATS.values() if not re.search(rf"\b{name}\b", text)]
        assert missing == []
    assert all(name in listed_formats() for name in SURFACE_FORMATS.values())


def test_a_compressed_file_is_read_by_the_suffix_within(valid, tmp_path):
    for name in ("exported.stl", "exported.obj", "exported.glb", "text.trian"):
        packed = read(tmp_path, f"{name}.gz", gzip.compress(valid[name]))
        assert packed.volume == pytest.approx(1e-3, rel=1e-6)
    assert format_of(Path("a/Organ.STL.GZ")) == ("stl", True)
    assert format_of(Path("organ.gz")) == ("", True)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (gzip.compress(b"OFF\n" + bytes(50_000_000)), "must unpack to at most"),
        (gzip.compress(b"OFF\n")[:-3], "cut off"),
        (gzip.compress(b"OFF\n") + b"more", "after its end"),
        (b"OFF\n3 1 0\n", "not a whole gzip file"),
        (b"", "not a whole gzip file|must not be empty"),
    ],
    ids=["bomb", "cut", "more", "plain", "empty"],  # compressed data have the time in them
)
def test_compressed_files_that_expand_too_far_or_are_cut_are_refused(data, said, tmp_path):
    with pytest.raises(pt.FileFormatError, match=said):
        read(tmp_path, "bomb.off.gz", data)


def test_messages_name_the_path_of_the_file(tmp_path):
    with pytest.raises(pt.FileFormatError, match=re.escape(str(Path(tmp_path) / "x.off"))):
        read(tmp_path, "x.off", b"OFF 1")
