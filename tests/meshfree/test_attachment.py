"""Parts of a body by place."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt


@pytest.fixture(scope="module")
def cloud():
    return pt.box((0.03, 0.02, 0.02), spacing=0.005)


def test_a_box_along_a_face_is_that_faces_group(cloud):
    assert np.array_equal(pt.in_box(cloud, (0, 0, 0), (0, 1, 1)), cloud.group("x-"))
    inside = pt.in_box(cloud, (0.004, 0.004, 0.004), (0.026, 0.016, 0.016), surface=False)
    assert len(inside) == 5 * 3 * 3
    assert not np.isin(inside, cloud.face_nodes).any()


def test_near_plane_marks_the_nodes_behind_a_plane(cloud):
    assert np.array_equal(pt.near_plane(cloud, (0.03, 0, 0), (-2, 0, 0)), cloud.group("x+"))
    corner = pt.near_plane(cloud, (0, 0, 0), (1, 1, 1), 0.0051 / np.sqrt(3))
    assert len(corner) == 4  # the corner and its neighbours along the edges


def test_paint_marks_the_nearest_nodes(cloud):
    brush = cloud.points[np.unique(cloud.face_nodes)] + 0.0004
    values = np.linalg.norm(brush - [0.015, 0.01, 0.02], axis=1) < 0.006
    nodes = pt.painted(cloud, brush, values)
    assert np.array_equal(nodes, np.unique(cloud.face_nodes)[values])
    with pytest.raises(pt.InputError, match=r"must hold a node|must reach a node"):
        pt.painted(cloud, brush + 1.0, values)


def test_a_group_from_masks_or_indices_can_be_fixed(cloud):
    marked = cloud.with_group("bed", pt.near_plane(cloud, (0, 0, 0.001), (0, 0, 1)))
    assert np.array_equal(marked.group("bed"), cloud.group("z-"))
    mask = np.zeros(len(cloud), dtype=bool)
    mask[[7, 3]] = True
    assert list(cloud.with_group("two", mask).group("two")) == [3, 7]
    assert list(cloud.with_group("two", [7, 3, 3]).group("two")) == [3, 7]


@pytest.mark.parametrize(
    ("find", "message"),
    [
        (lambda c: pt.in_box(c, (1, 1, 1), (2, 2, 2)), r"box from \[1. 1. 1.\] .* must hold a node of the surface"),
        (lambda c: pt.in_box(c, (1, 0, 0), (0, 1, 1)), "low must be below high"),
        (lambda c: pt.in_box(c, (0, 0), (1, 1, 1)), "low must have 3 entries, got 2"),
        (lambda c: pt.near_plane(c, (0, 0, 0), (0, 0, 0)), "normal must have a positive length"),
        (lambda c: pt.near_plane(c, (-1, 0, 0), (1, 0, 0)), "plane through .* must hold a node"),
        (lambda c: pt.painted(c, c.points, np.ones(3)), r"\(k, d\) and \(k,\)"),
        (lambda c: pt.painted(c, c.points * np.nan, np.ones(len(c))), "must be finite"),
        (lambda c: c.with_group("x-", [1]), "must be a new name, got 'x-'"),
        (lambda c: c.with_group("new", [-1]), "must be nodes in"),
        (lambda c: c.with_group("new", [0.5]), "must be nodes in"),
        (lambda c: c.with_group("new", []), "must be nodes in"),
    ],
)
def test_invalid_parts_are_refused(cloud, find, message):
    with pytest.raises(pt.InputError, match=message):
        find(cloud)
