"""Painted meshes from files."""

from __future__ import annotations

import os

import numpy as np
import pytest

import palpate as pt


@pytest.mark.parametrize("suffix", [".vtp", ".vtk"])
def test_painted_vertices_mark_the_nearest_nodes_of_the_body(tmp_path, small_cloud, suffix):
    import pyvista

    mesh = pyvista.Box((0, 0.015, 0, 0.015, 0, 0.015), level=5).clean()
    mesh["ligament"] = (mesh.points[:, 2] < 1e-6).astype(float)
    mesh.save(tmp_path / f"painted{suffix}")
    points, values = pt.io.read_painted(tmp_path / f"painted{suffix}", "ligament")
    assert np.array_equal(pt.painted(small_cloud, points, values), small_cloud.group("z-"))


def test_meshes_without_the_painted_field_are_refused(tmp_path):
    import pyvista

    with pytest.raises(FileNotFoundError, match="no painted mesh at"):
        pt.io.read_painted(tmp_path / "none.ply", "ligament")
    (tmp_path / "text.txt").write_text("0 0 0")
    with pytest.raises(pt.FileFormatError, match="a painted mesh is one of"):
        pt.io.read_painted(tmp_path / "text.txt", "ligament")
    mesh = pyvista.Box().clean()
    mesh["arrows"] = mesh.points
    mesh.save(tmp_path / "mesh.vtp")
    with pytest.raises(pt.InputError, match="no field 'ligament' on its points, but 'arrows'"):
        pt.io.read_painted(tmp_path / "mesh.vtp", "ligament")
    with pytest.raises(pt.InputError, match="is not a scalar"):
        pt.io.read_painted(tmp_path / "mesh.vtp", "arrows")


@pytest.mark.slow
@pytest.mark.parametrize(
    "content",
    [
        b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\n"
        b"POLYGONS 1 4\n99999999 0 0 0\n",
        b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 999999999999 float\n0 0 0\n",
        b"",
        b"\x00" * 500,
    ],
)
def test_files_that_crash_the_reader_are_refused(tmp_path, content):
    """The first of them ends a process of VTK with a segmentation fault."""
    (tmp_path / "mesh.vtk").write_bytes(content)
    with pytest.raises(pt.FileFormatError, match=r"mesh\.vtk"):
        pt.io.read_painted(tmp_path / "mesh.vtk", "ligament")


def test_a_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "mesh.vtk")
    with pytest.raises(pt.FileFormatError, match="not a regular file"):
        pt.io.read_painted(tmp_path / "mesh.vtk", "ligament")
