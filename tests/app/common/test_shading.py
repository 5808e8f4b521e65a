"""The light and the smooth patches of off-screen pictures."""

import re
from pathlib import Path

import numpy as np
import pytest

from palpate.app.common import shading
from palpate.app.common.shading import RefinedSurface, colour_at, round_up, shade

PAGE = Path(__file__).parents[3] / "page" / "src"
CAMERA = np.eye(3)  # looks along -z, up is y
TO_THE_EYE = np.array([[0.0, 0.0, 1.0]])


def cube() -> tuple[np.ndarray, np.ndarray]:
    """Return corners of the unit cube and its outward triangles."""
    points = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return points, np.array([corners for a, b, c, d in sides for corners in ((a, b, c), (a, c, d))])


def test_the_colours_are_those_of_the_page():
    text = (PAGE / "colours.js").read_text()

    def numbers(name: str) -> np.ndarray:
        return np.array(re.findall(r"[\d.]+", re.search(rf"const {name} = (.*?);", text).group(1)), dtype=float)

    np.testing.assert_array_equal(numbers("ABOVE").reshape(4, 3), shading.ABOVE)
    np.testing.assert_array_equal(numbers("BELOW").reshape(4, 3), shading.BELOW)
    np.testing.assert_array_equal(numbers("TISSUE"), shading.TISSUE)
    np.testing.assert_array_equal(numbers("FRONT"), shading.FRONT)


def test_values_on_tissue_that_faces_the_eye_have_the_colours_of_the_legend():
    for value in (0.4, 0.7, 1.0, -0.6):
        drawn = shade(TO_THE_EYE, CAMERA, np.array([value]))[0] / 255
        assert np.abs(drawn - np.clip(colour_at(np.array(value)), 0, 1)).max() < 0.06


def test_light_does_not_depend_on_the_side_of_a_triangle():
    np.testing.assert_array_equal(shade(TO_THE_EYE, CAMERA), shade(-TO_THE_EYE, CAMERA))


def test_a_refined_sphere_is_nearer_to_the_sphere_than_its_triangles():
    import pyvista

    sphere = pyvista.Icosphere(nsub=2)
    points = np.asarray(sphere.points, dtype=float)
    points /= np.linalg.norm(points, axis=1)[:, None]
    triangles = sphere.faces.reshape(-1, 4)[:, 1:]
    refined = RefinedSurface(points, triangles)
    flat = np.linalg.norm(refined.values(points), axis=1)
    places, normals = refined.places(points)
    assert len(refined.triangles) == 4**shading.MAX_REFINEMENTS * len(triangles)
    assert np.abs(np.linalg.norm(places, axis=1) - 1).max() < 0.05 * np.abs(flat - 1).max()
    np.testing.assert_allclose(normals, places / np.linalg.norm(places, axis=1)[:, None], atol=0.01)


def test_a_cube_keeps_its_flat_sides_and_sharp_edges():
    points, triangles = cube()
    places, normals = RefinedSurface(points, triangles).places(points)
    assert np.abs(places[:, :, None] - [0.0, 1.0]).min(axis=(1, 2)).max() < 1e-12
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1.0)


@pytest.mark.parametrize(("value", "end"), [(0.9, 1), (1.2, 1.5), (7.2, 8), (10, 10), (0.021, 0.03), (8.1, 10)])
def test_the_end_of_a_colour_scale_is_round_and_not_below_the_largest_value(value, end):
    assert round_up(value) == pytest.approx(end)
