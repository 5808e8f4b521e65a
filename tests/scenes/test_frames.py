"""Frames of files: SPACE=LPS and SPACE=RAS in headers, as 3D Slicer writes them."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import palpate as pt

SCENE = """
[surface]
file = "organ.{kind}"
units = "m"
[body]
spacing = "14 mm"
[tissue]
law = "NeoHookean"
parameters = {{ C1 = "1100 Pa" }}
[[support]]
place = {{ near = {{ file = "bone.{kind}", distance = "8 mm" }} }}
"""
HALF_TURN = np.array([-1.0, -1.0, 1.0])


def box(low, high):
    cloud = pt.box(np.subtract(high, low), 0.005)
    return cloud.points + low, cloud.triangles


def written(kind, space, vertices, triangles):
    """Return the bytes of a file as 3D Slicer writes it."""
    word = f"3D Slicer output. SPACE={space}" if space else "a mesh"
    if kind == "stl":
        corners = vertices[triangles].astype("<f4")
        rows = [struct.pack("<3f", 0, 0, 0) + each.tobytes() + b"\0\0" for each in corners]
        return word.encode().ljust(80, b" ") + struct.pack("<I", len(rows)) + b"".join(rows)
    points = [" ".join(map(str, row)) for row in vertices]
    if kind == "obj":
        faces = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
        return "\n".join([f"# {word}", *(f"v {p}" for p in points), *faces, ""]).encode()
    faces = [f"3 {a} {b} {c}" for a, b, c in triangles]
    if kind == "ply":
        header = ["ply", "format ascii 1.0", f"comment {word}", f"element vertex {len(points)}"]
        header += [f"property float {axis}" for axis in "xyz"]
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        return "\n".join([*header, *points, *faces, ""]).encode()
    if kind == "vtp":
        numbers = [
            " ".join(map(str, each)) for each in (vertices.ravel(), triangles.ravel(), 3 * np.arange(1, len(faces) + 1))
        ]
        codes = " ".join(str(ord(letter)) for letter in f"{space}\0")
        field = f'<FieldData><Array type="String" Name="SPACE" format="ascii">{codes}</Array></FieldData>' * bool(space)
        points = f'<Points><DataArray type="Float64" format="ascii">{numbers[0]}</DataArray></Points>'
        arrays = "".join(
            f'<DataArray type="Int64" Name="{name}" format="ascii">{text}</DataArray>'
            for name, text in zip(("connectivity", "offsets"), numbers[1:], strict=True)
        )
        piece = f'<Piece NumberOfPoints="{len(vertices)}">{points}<Polys>{arrays}</Polys></Piece>'
        return f'<VTKFile type="PolyData"><PolyData>{field}{piece}</PolyData></VTKFile>'.encode()
    header = ["# vtk DataFile Version 3.0", word, "ASCII", "DATASET POLYDATA", f"POINTS {len(points)} float"]
    return "\n".join([*header, *points, f"POLYGONS {len(faces)} {4 * len(faces)}", *faces, ""]).encode()


def held_place(folder, kind, organ_space, bone_space):
    """Return the mean x of the support of a body with a bone at its end at large x, in the frame of the body."""
    body, bone = box((0.0, 0.0, 0.0), (0.12, 0.06, 0.06)), box((0.122, 0.0, 0.0), (0.142, 0.06, 0.06))
    turned = (organ_space or "LPS") != (bone_space or "LPS")
    (folder / f"organ.{kind}").write_bytes(written(kind, organ_space, *body))
    (folder / f"bone.{kind}").write_bytes(written(kind, bone_space, bone[0] * (HALF_TURN if turned else 1.0), bone[1]))
    (folder / "scene.toml").write_text(SCENE.format(kind=kind), encoding="utf-8")
    cloud = pt.open_scene(folder / "scene.toml").body.cloud
    return cloud.points[cloud.group("support 1"), 0].mean()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "vtk", "vtp"])
def test_files_of_two_frames_meet_in_that_of_the_body(kind, tmp_path):
    with pytest.warns(UserWarning, match="bone.* is in LPS and the body in RAS: it is turned by 180 degrees about z"):
        assert held_place(tmp_path, kind, "RAS", "LPS") > 0.11


@pytest.mark.parametrize(("organ_space", "bone_space"), [("LPS", "RAS"), ("RAS", ""), ("", "RAS")])
def test_a_file_without_a_frame_is_in_lps_if_the_other_states_one(organ_space, bone_space, tmp_path):
    with pytest.warns(UserWarning, match="turned by 180 degrees"):
        assert held_place(tmp_path, "stl", organ_space, bone_space) > 0.11


@pytest.mark.parametrize("space", ["LPS", "RAS", ""])
def test_files_of_one_frame_stay(space, tmp_path):
    assert held_place(tmp_path, "stl", space, space) > 0.11
