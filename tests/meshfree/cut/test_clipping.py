"""Triangles of cuts are clipped to a box round the body."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.meshfree.cut.clipping import CLIP_MARGIN, clipped
from palpate.meshfree.cut.surface import triangle_areas

pytestmark = pytest.mark.slow

SPACING = 0.1
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
WIDTH = 1.0 + 2 * CLIP_MARGIN * SPACING


def test_a_plane_through_the_box_keeps_the_box_cross_section():
    huge = np.array([[(0.5, -1e6, -1e6), (0.5, 1e6, -1e6), (0.5, 0.0, 2e6)]])
    parts = clipped(huge, CORNERS, SPACING)
    assert triangle_areas(parts).sum() == pytest.approx(WIDTH**2, rel=1e-6)
    np.testing.assert_allclose(parts[..., 0], 0.5)


def test_triangles_near_the_body_stay_to_the_last_bit():
    random = np.random.default_rng(0).uniform(-0.5, 1.5, (20, 3, 3))
    np.testing.assert_array_equal(clipped(random, CORNERS, SPACING), random)


def test_triangles_that_share_an_edge_share_it_after_clipping():
    a, b, c, d = (np.array([0.5, y, z]) for y, z in ((-9.0, -9.0), (9.0, -8.0), (10.0, 9.0), (-8.0, 7.0)))
    parts = clipped(np.array([(a, b, c), (a, c, d)]), CORNERS, SPACING)
    assert triangle_areas(parts).sum() == pytest.approx(WIDTH**2, rel=1e-9)


def test_distant_triangles_vanish():
    assert clipped(np.full((3, 3, 3), 50.0) + np.eye(3), CORNERS, SPACING).shape == (0, 3, 3)
