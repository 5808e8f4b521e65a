"""Cut surfaces: fronts of the union, the way of a bond round them, and the side of nodes on a cut."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree.cut.diffraction_lengths import diffraction_lengths
from palpate.meshfree.cut.surface import NO_CUT, changed_spheres, cut_surface, swept
from palpate.surface.nesting import inside_points

pytestmark = pytest.mark.slow

SPACING = 0.1
BODY = pt.box((1.0, 1.0, 1.0), SPACING)
IS_INSIDE = partial(inside_points, corners=BODY.points[BODY.triangles])


def half_plane(end, height=0.55, low=-0.5, high=1.5):
    """Rectangle in a plane of constant z, from outside the body to x = `end`."""
    across = np.linspace(low, high, 5)
    positions = [np.column_stack([np.full(5, x), across, np.full(5, height)]) for x in (-0.5, end)]
    return swept(np.array(positions))


def paths(surface, pairs):
    """Lengths of the bonds between pairs of points (k, 2, 3)."""
    points = np.asarray(pairs, dtype=float).reshape(-1, 3)
    count = len(points) // 2
    result = np.empty(count)
    start, near = np.arange(count + 1), np.arange(1, 2 * count, 2)
    nodes, fronts = np.arange(0, 2 * count, 2), (surface.fronts, surface.front_components)
    diffraction_lengths(points, nodes, start, near, surface.tree, *fronts, result)
    return result


def test_the_front_is_the_edge_inside_the_body_moved_ahead():
    surface = cut_surface(NO_CUT, half_plane(0.5), IS_INSIDE, SPACING)
    np.testing.assert_allclose(surface.fronts[:, :, 0], 0.52, atol=1e-12)  # 0.2 spacings ahead
    assert 0.9 <= np.linalg.norm(np.diff(surface.fronts, axis=1), axis=2).sum() <= 1.1
    assert surface.extended[:, :, 0].max() == pytest.approx(0.52)


def test_fronts_are_those_of_the_union():
    first = cut_surface(NO_CUT, half_plane(0.5), IS_INSIDE, SPACING)
    further = swept(np.array([[(x, y, 0.55) for y in np.linspace(-0.5, 1.5, 5)] for x in (0.5, 0.7)]))
    both = cut_surface(first, further, IS_INSIDE, SPACING)
    np.testing.assert_allclose(both.fronts[:, :, 0], 0.72, atol=1e-12)
    at_once = cut_surface(NO_CUT, np.concatenate([half_plane(0.5), further]), IS_INSIDE, SPACING)
    np.testing.assert_array_equal(both.extended, at_once.extended)


def test_a_cut_through_the_body_has_no_front():
    assert len(cut_surface(NO_CUT, half_plane(1.5), IS_INSIDE, SPACING).fronts) == 0


def test_the_front_of_a_corner_moves_along_both_edges():
    surface = cut_surface(NO_CUT, half_plane(0.5, high=0.5), IS_INSIDE, SPACING)
    assert np.abs(surface.fronts - (0.52, 0.52, 0.55)).max(axis=2).min() == pytest.approx(0.0, abs=1e-12)


def test_a_bond_goes_the_shortest_way_round_the_front():
    surface = cut_surface(NO_CUT, half_plane(0.5), IS_INSIDE, SPACING)
    ahead = [(0.6, 0.5, 0.5), (0.6, 0.5, 0.6)]
    across = [(0.45, 0.42, 0.5), (0.45, 0.58, 0.6)]
    far = [(0.1, 0.5, 0.5), (0.1, 0.5, 0.6)]
    along = [(0.1, 0.5, 0.5), (0.3, 0.5, 0.5)]
    length = paths(surface, [ahead, across, far, along])
    off = np.hypot(0.52 - 0.45, 0.05)
    np.testing.assert_allclose(length, [0.1, np.hypot(0.16, 2 * off), np.inf, 0.2], rtol=1e-9)


def test_the_way_of_a_bond_is_that_of_the_opposite_bond():
    random = np.random.default_rng(0)
    surface = cut_surface(NO_CUT, half_plane(0.5, height=0.5), IS_INSIDE, SPACING)
    pairs = 0.5 + random.uniform(-0.15, 0.15, (200, 2, 3))
    pairs[::3, 0, 2] = 0.5  # on the plane
    pairs[::5, 1, 2] = 0.5 + 1e-9 * random.uniform(-1, 1, 40)
    np.testing.assert_allclose(paths(surface, pairs), paths(surface, pairs[:, ::-1]), rtol=1e-12)


def test_a_way_round_a_front_does_not_cross_another_cut():
    """The first cut is open far beyond the front of the second one, 0.4 spacings below it."""
    opened = cut_surface(NO_CUT, half_plane(0.9), IS_INSIDE, SPACING)
    both = cut_surface(opened, half_plane(0.5, height=0.51), IS_INSIDE, SPACING)
    through_both, between = [(0.5, 0.5, 0.46), (0.5, 0.5, 0.6)], [(0.5, 0.5, 0.46), (0.5, 0.5, 0.54)]
    assert np.isinf(paths(opened, [through_both])).all()
    length = paths(both, [through_both, between])
    assert np.isinf(length[0])
    assert length[1] == pytest.approx(np.hypot(0.02, 0.05) + np.hypot(0.02, 0.03))


def test_triangles_with_a_common_edge_are_a_component():
    """A second cut shares one corner of the first, (0.5, 0.5, 0.55)."""
    positions = np.array([[(x, y, 0.05 + y) for y in (0.5, 1.5)] for x in (0.5, 1.5)])
    surface = cut_surface(
        cut_surface(NO_CUT, half_plane(0.5), IS_INSIDE, SPACING), swept(positions), IS_INSIDE, SPACING
    )
    np.testing.assert_array_equal(surface.components, [0] * 8 + [1] * 2)
    assert set(surface.front_components) == {0, 1}


def test_changes_are_new_triangles_moved_fronts_and_triangles_of_joined_components():
    """The third sheet joins the second to the first, whose triangles behind its front stay."""
    y = np.linspace(-0.5, 1.5, 5)
    sheets = [
        swept(np.array([np.column_stack([np.full(5, x), y, np.full(5, 0.55)]) for x in places]))
        for places in ((-0.5, 0.0, 0.4), (0.8, 1.5), (0.4, 0.8))
    ]
    apart = cut_surface(cut_surface(NO_CUT, sheets[0], IS_INSIDE, SPACING), sheets[1], IS_INSIDE, SPACING)
    joined = cut_surface(apart, sheets[2], IS_INSIDE, SPACING)
    assert len(changed_spheres(joined, joined)) == 0
    middles, radii = np.split(changed_spheres(apart, joined), [3], axis=1)
    is_changed = lambda ends: np.linalg.norm(ends.mean(axis=1)[:, None] - middles, axis=2).min(axis=1) < 1e-9  # noqa: E731
    # of the last triangle at the front of the first sheet only a corner outside the body is there
    np.testing.assert_array_equal(is_changed(joined.extended), np.repeat([False, True, False, True], [8, 7, 1, 16]))
    assert is_changed(apart.fronts).all()
    assert radii.max() <= np.linalg.norm([0.7, 0.5])


def test_a_front_that_a_further_cut_covers_is_no_longer_one():
    first = cut_surface(NO_CUT, half_plane(0.5), IS_INSIDE, SPACING)
    farther = cut_surface(first, half_plane(0.8), IS_INSIDE, SPACING)
    np.testing.assert_allclose(farther.fronts[:, :, 0], 0.82, atol=1e-12)
    again = cut_surface(first, half_plane(0.5), IS_INSIDE, SPACING)
    np.testing.assert_array_equal(again.fronts, first.fronts)


@pytest.mark.parametrize("turned", [False, True])
def test_a_node_on_a_cut_is_on_one_side_of_it(turned):
    triangles = half_plane(1.5, height=0.5)
    surface = cut_surface(NO_CUT, triangles[:, ::-1] if turned else triangles, IS_INSIDE, SPACING)
    on = (0.5, 0.5, 0.5)
    length = paths(surface, [(on, (0.5, 0.5, 0.6)), (on, (0.5, 0.5, 0.4)), (on, (0.6, 0.5, 0.5))])
    np.testing.assert_allclose(length, [0.1, np.inf, 0.1])


def test_a_triangle_without_width_is_refused():
    with pytest.raises(pt.CloudError, match=r"must be at least .* wide, got triangle 0"):
        cut_surface(NO_CUT, np.array([[(0, 0, 0), (0.5, 0, 0), (1.0, 0, 0)]], dtype=float), IS_INSIDE, SPACING)
