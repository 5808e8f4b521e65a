"""Isosurfaces against spheres, for closedness, and against VTK's, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.surface.isosurface import TRIANGLE_CASES, zero_surface


def grid(n, low=-1.0, high=1.0):
    step = (high - low) / (n - 1)
    return np.meshgrid(*3 * [low + step * np.arange(n)], indexing="ij"), step


def volume(vertices, triangles):
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.sum(np.cross(a, b) * c) / 6


def test_a_ball_is_closed_and_its_volume_converges_with_the_square_of_the_step():
    misses = []
    for n in (11, 21, 41):
        (x, y, z), step = grid(n)
        vertices, triangles = zero_surface(np.sqrt(x**2 + y**2 + z**2) - 0.7, (-1.0, -1.0, -1.0), step)
        edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)
        assert len(vertices) - len(edges) // 2 + len(triangles) == 2  # Euler's number of a ball
        misses.append(abs(abs(volume(vertices, triangles)) - 4 / 3 * np.pi * 0.7**3))
    assert misses[0] / misses[1] > 3.5
    assert misses[1] / misses[2] > 3.5


def test_a_plane_is_exact():
    (x, y, z), step = grid(5)
    vertices, triangles = zero_surface(x + 0.5 * y + 0.25 * z - 0.1, (-1.0, -1.0, -1.0), step)
    assert len(triangles) > 10
    assert np.abs(vertices @ [1.0, 0.5, 0.25] - 0.1).max() < 1e-6  # vertices have single precision


def test_every_case_and_its_complement_have_the_same_edges():
    assert len(TRIANGLE_CASES) == 256
    assert all(set(TRIANGLE_CASES[k]) == set(TRIANGLE_CASES[255 - k]) for k in range(256))


@pytest.mark.parametrize("seed", range(4))
def test_vertices_and_triangles_are_those_of_vtk(seed):
    data = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    core = pytest.importorskip("vtkmodules.vtkFiltersCore")
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    field = np.random.default_rng(seed).normal(size=(14, 9, 11))  # noise: all cases, many times
    image, contour = data.vtkImageData(), core.vtkFlyingEdges3D()
    image.SetDimensions(*field.shape)
    image.SetSpacing(0.003, 0.003, 0.003)
    image.SetOrigin(0.1, -0.2, 0.3)
    image.GetPointData().SetScalars(numpy_to_vtk(field.ravel(order="F"), deep=True))
    contour.SetInputData(image)
    contour.SetValue(0, 0.0)
    contour.ComputeNormalsOff()
    contour.Update()
    found = contour.GetOutput()
    vertices, triangles = zero_surface(field, (0.1, -0.2, 0.3), 0.003)
    np.testing.assert_array_equal(vertices, vtk_to_numpy(found.GetPoints().GetData()).astype(float))
    np.testing.assert_array_equal(triangles, vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3))
