"""VTK itself reads back what was written."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import palpate as pt
from palpate.core.vtk import pyvista_grid, write_vtkhdf

TIMES = np.array([0.0, 0.1, 0.3])


@pytest.fixture
def cloud():
    return pt.box((0.04, 0.03, 0.03), spacing=0.01)


@pytest.fixture
def fields(cloud):
    random = np.random.default_rng(0)
    return {
        "displacement": random.normal(size=(3, len(cloud), 3)),
        "von_mises": random.uniform(size=(3, len(cloud))),
    }


def test_vtk_reads_back_the_mesh_and_two_times(tmp_path, cloud, fields):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    path = tmp_path / "body.vtkhdf"
    write_vtkhdf(path, cloud.points, cloud.triangles, TIMES, fields)
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    information = reader.GetOutputInformation(0)
    key = reader.GetExecutive().TIME_STEPS()
    np.testing.assert_allclose([information.Get(key, k) for k in range(information.Length(key))], TIMES)
    for frame in (1, 2):
        reader.UpdateTimeStep(TIMES[frame])
        grid = reader.GetOutputDataObject(0)
        np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), cloud.points)
        for name, values in fields.items():
            np.testing.assert_array_equal(vtk_to_numpy(grid.GetPointData().GetArray(name)), values[frame])
        kinds = vtk_to_numpy(grid.GetCellTypes()) if hasattr(grid, "GetCellTypes") else None
        inside = len(cloud) - len(np.unique(cloud.triangles))
        assert grid.GetNumberOfCells() == len(cloud.triangles) + inside
        if kinds is not None:
            assert np.count_nonzero(kinds == 5) == len(cloud.triangles)
        first = [grid.GetCell(0).GetPointId(k) for k in range(3)]
        assert first == list(cloud.triangles[0])


def test_pyvista_takes_the_same_mesh(tmp_path, cloud, fields):
    import pyvista

    path, last = tmp_path / "body.vtkhdf", {name: values[-1] for name, values in fields.items()}
    write_vtkhdf(path, cloud.points, cloud.triangles, TIMES[:1], {name: values[None] for name, values in last.items()})
    mesh, read = pyvista_grid(cloud.points, cloud.triangles, last), pyvista.read(path)
    np.testing.assert_array_equal(mesh.points, cloud.points)
    np.testing.assert_array_equal(mesh.cells, read.cells)
    np.testing.assert_array_equal(mesh.celltypes, read.celltypes)
    for name, values in last.items():
        np.testing.assert_array_equal(mesh[name], values)
        np.testing.assert_array_equal(read[name], values)


def test_points_of_a_plane_lie_in_space():
    disc = pt.disc(0.1, 0.03)
    mesh = pyvista_grid(disc.points, disc.triangles, {})
    assert mesh.n_points == len(disc)
    assert mesh.points[:, 2].max() == 0.0
    assert mesh.area == pytest.approx(np.pi * 0.1**2, rel=0.1)


def test_a_missing_pyvista_is_named_with_the_extra_that_holds_it(monkeypatch, cloud):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(pt.InputError, match=r"requires pyvista, which is not installed; pip install 'palpate\[film\]'"):
        pyvista_grid(cloud.points, cloud.triangles, {})


def test_a_field_of_a_wrong_shape_is_refused_and_no_file_is_left(tmp_path, cloud, fields):
    short = {"von_mises": fields["von_mises"][:, :-1]}
    with pytest.raises(pt.InputError, match="'von_mises' must have shape"):
        write_vtkhdf(tmp_path / "body.vtkhdf", cloud.points, cloud.triangles, TIMES, short)
    assert list(tmp_path.iterdir()) == []


def test_a_field_that_is_not_finite_is_refused(tmp_path, cloud, fields):
    fields["von_mises"][1, 3] = np.nan
    with pytest.raises(pt.InputError, match="'von_mises' must be finite, got 1 other"):
        write_vtkhdf(tmp_path / "body.vtkhdf", cloud.points, cloud.triangles, TIMES, fields)


def test_an_unwritable_place_is_named(tmp_path, cloud, fields):
    with pytest.raises(OSError, match=r"cannot write .*missing"):
        write_vtkhdf(tmp_path / "missing" / "body.vtkhdf", cloud.points, cloud.triangles, TIMES, fields)
