"""Line, length, area and depth of a cut, against closed forms of plane cuts through a box."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree.cut.opening import NO_MEASURES, cut_measures, cut_opening
from palpate.meshfree.cut.surface import swept

SIZE, SPACING = (0.06, 0.04, 0.03), 5e-3
ABOVE = 4e-3  # [m] by which the cuts are beyond the top of the box


@pytest.fixture(scope="module", params=[0.0, 0.2], ids=["regular", "irregular"])
def surface(request):
    """Triangles of the surface of a box."""
    cloud = pt.box(SIZE, SPACING, jitter=request.param)
    return cloud.points[cloud.triangles]


def plane_cut(start, end, depth, tilt=0.0):
    """Triangles of a plane cut from one point (x, y) of the top to another, and those of them in the body.

    The rows are at most half a spacing apart, and one of them is at the surface.
    """
    start, end = np.array(start), np.array(end)
    across = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start) * np.sin(tilt)
    heights = np.concatenate([np.linspace(ABOVE, 0.0, 3), np.linspace(0.0, -depth / np.cos(tilt), 5)[1:]])
    shares = np.linspace(0.0, 1.0, 17)[:, None]
    rows = [
        np.column_stack(
            [start + shares * (end - start) + height * across, np.full(17, SIZE[2] + height * np.cos(tilt))]
        )
        for height in heights
    ]
    triangles = swept(np.array(rows))
    return triangles, triangles[triangles.mean(axis=1)[:, 2] < SIZE[2]]


def measured(surface, *cuts):
    """Length, area and depth of cuts, each of all triangles and those in the body."""
    every, inside = (np.concatenate(parts) for parts in zip(*cuts, strict=True))
    return cut_measures(cut_opening(every, surface, SPACING), surface, inside, SPACING)


@pytest.mark.parametrize(
    ("start", "end"),
    [((0.012, 0.02), (0.048, 0.02)), ((0.0123, 0.0178), (0.0481, 0.0181)), ((0.01, 0.01), (0.05, 0.03))],
    ids=["through nodes", "along a side", "oblique"],
)
def test_a_straight_cut_has_its_length_area_and_depth(surface, start, end):
    length, area, depth = measured(surface, plane_cut(start, end, 8e-3))
    assert length == pytest.approx(np.hypot(*np.subtract(end, start)), rel=1e-6)
    assert area == pytest.approx(8e-3 * length, rel=1e-6)
    assert depth == pytest.approx(8e-3, rel=1e-6)


def test_the_depth_is_below_the_surface_where_the_cut_opens_it(surface):
    deep = measured(surface, plane_cut((0.012, 0.02), (0.048, 0.02), 0.024))  # nearer to the bottom than to the top
    assert deep.depth == pytest.approx(0.024, rel=1e-6)
    leaning = measured(surface, plane_cut((0.012, 0.02), (0.048, 0.02), 8e-3, tilt=np.pi / 4))
    assert leaning.depth == pytest.approx(8e-3, rel=1e-6)
    assert leaning.area == pytest.approx(0.036 * 8e-3 * np.sqrt(2), rel=1e-6)


def test_cuts_add_and_a_cut_over_another_one_counts_once(surface):
    first, second = plane_cut((0.012, 0.01), (0.048, 0.01), 8e-3), plane_cut((0.02, 0.03), (0.04, 0.03), 5e-3)
    both = measured(surface, first, second)
    assert both.length == pytest.approx(0.036 + 0.02, rel=1e-6)
    assert both.area == pytest.approx(0.036 * 8e-3 + 0.02 * 5e-3, rel=1e-6)
    assert both.depth == pytest.approx(8e-3, rel=1e-6)
    aside = plane_cut((0.012, 0.01 + 0.2 * SPACING), (0.048, 0.01 + 0.2 * SPACING), 8e-3)
    longer = plane_cut((0.012, 0.01), (0.057, 0.01), 8e-3)
    assert measured(surface, first, first) == pytest.approx(measured(surface, first), rel=1e-6)
    assert measured(surface, first, aside) == pytest.approx(measured(surface, first), rel=1e-6)
    part = 0.045 / 16  # whose middle may be in the cut before
    assert measured(surface, first, longer).length == pytest.approx(0.045, abs=part)
    assert measured(surface, first, longer).area == pytest.approx(0.045 * 8e-3, abs=part * 8e-3)


def test_the_line_of_a_cut_is_on_the_surface_without_gaps(surface):
    opening = cut_opening(plane_cut((0.01, 0.01), (0.05, 0.03), 8e-3)[0], surface, SPACING)
    np.testing.assert_allclose(opening.pieces[..., 2], SIZE[2], atol=1e-8)
    shares = np.sort((opening.pieces[..., 0] - 0.01) / 0.04, axis=1)
    shares = shares[np.argsort(shares[:, 0])]
    np.testing.assert_allclose(shares[1:, 0], shares[:-1, 1], atol=1e-6)
    np.testing.assert_allclose([shares[0, 0], shares[-1, 1]], [0.0, 1.0], atol=1e-6)


def test_a_cut_through_the_body_has_a_line_around_it(surface):
    corners = np.array([[-0.01, 0.0213, -0.01], [0.07, 0.0213, -0.01], [0.07, 0.0213, 0.04], [-0.01, 0.0213, 0.04]])
    opening = cut_opening(corners[[[0, 1, 2], [0, 2, 3]]], surface, SPACING)
    lengths = np.linalg.norm(opening.pieces[:, 1] - opening.pieces[:, 0], axis=1)
    assert lengths[opening.is_new].sum() == pytest.approx(2 * (SIZE[0] + SIZE[2]), rel=1e-6)


def test_a_cut_next_to_the_body_has_no_size(surface):
    corners = np.array([[[0.07, 0.0, 0.0], [0.08, 0.0, 0.0], [0.07, 0.02, 0.01]]])
    assert cut_measures(cut_opening(corners, surface, SPACING), surface, corners[:0], SPACING) == NO_MEASURES
    nothing = np.zeros((0, 3, 3))
    assert cut_measures(cut_opening(nothing, surface, SPACING), surface, nothing, SPACING) == NO_MEASURES
