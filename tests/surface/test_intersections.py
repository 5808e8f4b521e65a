"""The search for triangles that meet: against an independent method, on symmetric cases, with bounded memory."""

from __future__ import annotations

import itertools
import tracemalloc

import numpy as np
import pytest
from closed_surfaces import ball, cube
from scipy.optimize import linprog

import palpate as pt
from palpate.surface import intersections
from palpate.surface.intersections import MAX_PAIRS, self_intersections


def meet(p, q, i, j):
    """Whether two triangles have a common point beyond common vertices: the largest weight elsewhere, a linear program.

    Convex combinations a of p and b of q are equal; what is sought is most weight in a on vertices that q has not.
    """
    cost = -np.array([*(k not in j for k in i), 0, 0, 0], dtype=float)
    equal = np.vstack([np.hstack([p.T, -q.T]), [1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1]])
    found = linprog(cost, A_eq=equal, b_eq=[0, 0, 0, 1, 1])
    return found.status == 0 and -found.fun > 1e-7


def icosphere():
    """A ball of 320 triangles that is its own mirror image through the origin."""
    g = (1 + 5**0.5) / 2
    points = np.array([p for a in (-1, 1) for b in (-g, g) for p in ((0, a, b), (a, b, 0), (b, 0, a))], dtype=float)
    near = [t for t in itertools.combinations(range(12), 3) if np.ptp(points[list(t)], axis=0).max() < 3.3]
    near = [
        t for t in near if all(np.linalg.norm(points[a] - points[b]) < 2.1 for a, b in itertools.combinations(t, 2))
    ]
    triangles = np.array([t if np.linalg.det(points[list(t)]) > 0 else t[::-1] for t in near])
    for _ in range(2):
        corners = points[triangles]
        middle = 0.5 * (corners + np.roll(corners, -1, axis=1))
        a, b, c, ab, bc, ca = (x for each in (corners, middle) for x in each.swapaxes(0, 1))
        loose = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        _, first, inverse = np.unique(loose.reshape(-1, 3).round(9), axis=0, return_index=True, return_inverse=True)
        points, triangles = loose.reshape(-1, 3)[first], inverse.reshape(-1, 3)
    return points / np.linalg.norm(points, axis=1)[:, None], triangles


@pytest.mark.parametrize("grid", [3, 9])
def test_pairs_equal_those_of_linear_programs_for_integer_triangles(grid):
    rng = np.random.default_rng(grid)  # a coarse grid: edges meet edges, vertices faces, many in a common plane
    points = rng.integers(0, grid, size=(15, 3)).astype(float)
    _, same = np.unique(points, axis=0, return_inverse=True)
    triangles = np.array([rng.choice(15, 3, replace=False) for _ in range(24)])
    corners = points[triangles]
    solid = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0
    triangles = same[triangles][solid]
    triangles = triangles[np.sort(np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1])]
    merged = np.zeros((same.max() + 1, 3))
    merged[same] = points
    corners = merged[triangles]
    expected = [
        [s, t]
        for s, t in itertools.combinations(range(len(triangles)), 2)
        if meet(corners[s], corners[t], triangles[s], triangles[t])
    ]
    assert 20 < len(expected) < 270
    assert self_intersections(merged, triangles).tolist() == expected


@pytest.mark.parametrize("count", [2, 5, 64, 1000])
def test_the_tree_finds_the_same_pairs_as_a_search_of_all(count):
    rng = np.random.default_rng(count)
    corners = rng.uniform(size=(count, 1, 3)) + rng.normal(scale=0.5 / np.cbrt(count), size=(count, 3, 3))
    corners[: count // 20] = rng.normal(scale=2, size=(count // 20, 3, 3))  # a few much larger than the others
    triangles = np.arange(3 * count).reshape(-1, 3)
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = np.argwhere(np.triu(np.all((low[:, None] <= high) & (low <= high[:, None]), axis=2), 1))
    expected = [[s, t] for s, t in near if intersections._meet(corners[s], corners[t], triangles[s], triangles[t])]
    assert self_intersections(corners.reshape(-1, 3), triangles).tolist() == expected


def test_every_symmetric_spike_is_found():
    points, triangles = icosphere()
    assert len(self_intersections(points, triangles)) == 0
    for k in range(len(points)):  # each vertex pulled through the opposite one, or onto it or an edge's middle
        for length in (-0.9, -1.0, -1.5):
            spiked = points.copy()
            spiked[k] *= length
            expected = 0 if length == -0.9 else 1
            assert min(len(self_intersections(spiked, triangles)), 1) == expected, (k, length)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize(
    ("points", "triangles", "found"),
    [
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0), (1, -1, 1), (1, 1, 1), (1, 0, -1)], [(0, 1, 2), (3, 4, 5)], 1),
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0), (0.5, 0.5, 0), (1, 1, 2), (2, 2, 2)], [(0, 1, 2), (3, 4, 5)], 1),  # on face
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0), (1, 0, 0), (1, -1, 1), (1, -1, -1)], [(0, 1, 2), (3, 4, 5)], 1),  # on edge
        (
            [(0, 0, 0), (2, 0, 0), (0, 2, 0), (0.5, 0.5, 0), (3, 0.5, 0), (3, 1, 0)],
            [(0, 1, 2), (3, 4, 5)],
            1,
        ),  # in plane
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0), (1.1, 1.1, 0), (3, 0.5, 0), (3, 1, 0)], [(0, 1, 2), (3, 4, 5)], 0),
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0), (1, 1, 1), (1, 1, -1)], [(0, 1, 2), (0, 3, 4)], 1),  # over a common vertex
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0), (-1, -1, 1), (-1, -1, -1)], [(0, 1, 2), (0, 3, 4)], 0),
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 1, 0)], [(0, 1, 2), (1, 0, 3)], 1),  # folded on a common edge
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 1, 1e-3)], [(0, 1, 2), (1, 0, 3)], 0),
    ],
)
def test_intersections_of_two_triangles_are_classified(points, triangles, found, scale):
    shift = np.array([0.3, -0.7, 0.1])
    assert len(self_intersections(scale * (np.array(points, dtype=float) + shift), np.array(triangles))) == found


@pytest.mark.parametrize("far", [2.0, 100.0, 1e9])
def test_memory_is_bounded_with_a_vertex_far_away(far):
    body = ball(0.05, 0.004)
    vertices = body.vertices.copy()
    vertices[0] = far
    self_intersections(cube().vertices, cube().triangles)
    tracemalloc.start()
    self_intersections(vertices, body.triangles)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2000 * len(body.triangles)


def test_the_search_stops_at_the_limits_of_pairs_and_boxes(monkeypatch):
    corners = np.random.default_rng(0).normal(size=(2000, 3, 3))
    soup = pt.Surface(corners.reshape(-1, 3), np.arange(6000).reshape(-1, 3))
    assert len(self_intersections(soup.vertices, soup.triangles)) == MAX_PAIRS
    assert any("at least 10000 pairs" in problem.what for problem in pt.io.check_surface(soup).errors)
    monkeypatch.setattr(intersections, "MAX_BOX_TESTS", (1000, 1))
    with pytest.raises(pt.InputError, match="overlap in fewer than 2000 places"):
        self_intersections(soup.vertices, soup.triangles)
    assert any(problem.name == "tangled" for problem in pt.io.check_surface(soup).errors)


def split_by_flat_triangles():
    """A cube with a triangle split at vertices on its edge, which triangles without area join to the neighbour."""
    body = cube(0.1, 0.2)
    a, b, c = body.triangles[0]
    m = len(body.vertices)
    p, q, k = m + 1, m + 2, m + 3
    start, end = body.vertices[[a, b]]
    on = [start + x * (end - start) for x in (0.5, 0.25, 0.75)]
    vertices = np.vstack([body.vertices, *on, 0.5 * (on[0] + body.vertices[c])])
    inner = [(a, p, k), (p, m, k), (a, k, c), (m, q, k), (q, b, k), (k, b, c)]
    return pt.Surface(vertices, np.vstack([body.triangles[1:], inner, [(a, b, m), (a, m, p), (m, b, q)]]))


def test_a_surface_closed_by_triangles_without_area_has_no_faults():
    surface = split_by_flat_triangles()
    assert pt.io.check_surface(surface).problems == ()
    pierced = surface.vertices.copy()
    pierced[-1] *= -3  # the vertex next to the split edge, pulled through the cube
    pairs = self_intersections(pierced, surface.triangles)
    assert len(pairs) > 0
    assert pairs.max() < len(surface.triangles) - 3  # of the triangles as they were given, and of those with an area
