"""Points and segments inside a body by its nearest node, against winding numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from closed_surfaces import ball
from scipy.spatial import cKDTree

import palpate as pt
from palpate.meshfree.cut.points import inside_body, shares_inside
from palpate.surface.nesting import inside_points, inside_shares

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["box", "ball"])
def cloud(request):
    if request.param == "box":
        return pt.box((0.05, 0.04, 0.03), 0.005, jitter=0.2)
    return pt.fill(ball(0.03), 0.006)


def drawn(cloud):
    """What the functions need of an uncut body, its surface, and points in it and around it."""
    on_surface = np.zeros(len(cloud), dtype=bool)
    on_surface[cloud.triangles] = True
    uncut = SimpleNamespace(tree=cKDTree(cloud.points), on_surface=on_surface, spacing=cloud.spacing)
    low, high = cloud.points.min(axis=0) - 3 * cloud.spacing, cloud.points.max(axis=0) + 3 * cloud.spacing
    points = np.random.default_rng(0).uniform(low, high, (2000, 3))
    return uncut, np.ascontiguousarray(cloud.points[cloud.triangles]), points


def test_points_are_inside_where_the_winding_number_says_so(cloud):
    uncut, corners, points = drawn(cloud)
    expected = inside_points(points, corners)
    assert 200 < expected.sum() < 1800
    np.testing.assert_array_equal(inside_body(uncut, corners, points), expected)


def test_short_segments_are_inside_by_the_share_of_their_length(cloud):
    uncut, corners, points = drawn(cloud)
    ways = 0.5 * cloud.spacing * np.random.default_rng(1).uniform(-0.5, 0.5, points.shape)
    segments, expected = np.stack([points - ways, points + ways], axis=1), np.zeros(len(points))
    inside_shares(segments, corners, expected)
    assert np.sum((expected > 0.0) & (expected < 1.0)) > 20
    np.testing.assert_allclose(shares_inside(uncut, corners, segments), expected, atol=1e-12)
