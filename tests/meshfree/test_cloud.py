"""What a cloud's arrays say about the body they stand for."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

import palpate as pt

SIZES = {2: (0.5, 0.3), 3: (0.5, 0.3, 0.4)}


@pytest.fixture(params=[(2, 0.0), (2, 0.3), (3, 0.0), (3, 0.3)], ids=lambda p: f"{p[0]}d-jitter{p[1]}")
def body(request):
    d, jitter = request.param
    return pt.box(SIZES[d], spacing=0.1, jitter=jitter), np.array(SIZES[d])


@pytest.fixture(params=[0.0, 0.3], ids=["lattice", "jitter"])
def block(request):
    return pt.box(SIZES[3], spacing=0.1, jitter=request.param)


def test_nodal_volumes_sum_to_the_volume(body):
    cloud, size = body
    assert cloud.volumes.sum() == pytest.approx(size.prod(), rel=1e-13)


def test_face_areas_sum_to_the_area_of_every_face(body):
    cloud, size = body
    for normal in (*np.eye(len(size)), *-np.eye(len(size))):
        on = (cloud.face_normals == normal).all(axis=1)
        assert cloud.face_areas[on].sum() == pytest.approx(size.prod() / size[np.abs(normal) == 1][0], rel=1e-13)


def test_the_surface_is_closed(body):
    cloud, _ = body
    np.testing.assert_allclose(cloud.face_areas @ cloud.face_normals, 0, atol=1e-15)


def test_normals_have_unit_length_and_point_outward(body):
    cloud, size = body
    np.testing.assert_array_equal(np.linalg.norm(cloud.face_normals, axis=1), 1)
    outward = np.sum(cloud.face_normals * (cloud.points[cloud.face_nodes] - size / 2), axis=1)
    np.testing.assert_allclose(outward, np.abs(cloud.face_normals) @ size / 2, rtol=1e-14)


def test_groups_are_the_nodes_of_the_faces_even_when_jittered(body):
    cloud, size = body
    assert set(cloud.groups) == {axis + side for axis in "xyz"[: len(size)] for side in "-+"}
    for a in range(len(size)):
        np.testing.assert_array_equal(cloud.group("xyz"[a] + "-"), np.flatnonzero(cloud.points[:, a] == 0))
        np.testing.assert_array_equal(cloud.group("xyz"[a] + "+"), np.flatnonzero(cloud.points[:, a] == size[a]))


def test_nodes_stay_in_the_body(body):
    cloud, size = body
    assert np.all((cloud.points >= 0) & (cloud.points <= size))


def test_a_node_has_as_many_faces_as_it_lies_on(body):
    cloud, size = body
    lies_on = np.sum((cloud.points == 0) | (cloud.points == size), axis=1)
    np.testing.assert_array_equal(np.bincount(cloud.face_nodes, minlength=len(cloud)), lies_on)
    assert np.sum(lies_on == len(size)) == 2 ** len(size)  # corners


def test_corner_cells_are_an_eighth_of_inner_ones():
    volumes = pt.box((0.4, 0.4, 0.4), spacing=0.1).volumes / 0.1**3
    counts = {0.125: 8, 0.25: 12 * 3, 0.5: 6 * 9, 1.0: 27}
    np.testing.assert_allclose(np.sort(volumes), np.repeat(list(counts), list(counts.values())), rtol=1e-12)


def test_boundary_vectors_are_2_over_h_on_every_face_and_zero_inside(body):
    cloud, size = body
    expected = 2 / 0.1 * ((cloud.points == size).astype(float) - (cloud.points == 0))
    np.testing.assert_allclose(cloud.boundary_vectors(), expected, rtol=1e-12, atol=1e-12)


def test_area_vectors_of_a_face_sum_to_its_area_times_its_normal(block):
    np.testing.assert_allclose(block.area_vectors("x+").sum(axis=0), (0.3 * 0.4, 0, 0), rtol=1e-13)
    np.testing.assert_allclose(block.area_vectors("y-").sum(axis=0), (0, -0.5 * 0.4, 0), rtol=1e-13)


def test_drawing_triangles_close_the_surface(block):
    edges = Counter((a, b) for t in block.triangles.tolist() for a, b in zip(t, t[1:] + t[:1], strict=True))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)


def test_drawing_triangles_face_outward_and_enclose_the_volume(block):
    a, b, c = np.moveaxis(block.points[block.triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    assert np.all(np.sum(normal * (a - np.array(SIZES[3]) / 2), axis=1) > 0)
    assert np.sum(a * normal) / 6 == pytest.approx(np.prod(SIZES[3]), rel=1e-12)  # divergence theorem


def test_drawing_triangles_tile_a_rectangle():
    cloud = pt.box(SIZES[2], spacing=0.1, jitter=0.2)
    a, b, c = np.moveaxis(cloud.points[cloud.triangles], 1, 0)
    areas = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert np.all(areas > 0)
    assert areas.sum() == pytest.approx(0.15, rel=1e-13)


def test_the_seed_decides_the_jitter():
    points = [pt.box(SIZES[3], spacing=0.1, jitter=0.2, seed=seed).points for seed in (5, 5, 6)]
    np.testing.assert_array_equal(points[0], points[1])
    assert not np.array_equal(points[0], points[2])


def test_jitter_moves_nodes_by_at_most_its_share_of_the_spacing():
    moved = np.abs(pt.box(SIZES[3], 0.1, jitter=0.25).points - pt.box(SIZES[3], 0.1).points).max()
    assert 0.02 < moved <= 0.025 * (1 + 1e-12)


def test_each_edge_gets_the_nearest_whole_number_of_cells():
    cloud = pt.box((1.0, 0.52, 0.3), spacing=0.1)
    assert len(cloud) == 11 * 6 * 4
    assert cloud.spacing == pytest.approx((0.1 + 0.104 + 0.1) / 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"spacing": 0.2}, r"at least 4 nodes across.*2 nodes.*at most 0.1 m"),
        ({"spacing": 0.0}, "spacing must be .*, got 0.0"),
        ({"spacing": np.nan}, "spacing must be .*, got nan"),
        ({"spacing": "fine"}, "spacing must be a number"),
        ({"size": (0.5, -0.3, 0.4)}, "size must be .*, got -0.3"),
        ({"size": (0.5,)}, "size must have 2 or 3 entries"),
        ({"jitter": 0.31}, r"jitter must be in \[0, 0.3\], got 0.31"),
        ({"seed": -1}, "seed must be .*, got -1"),
        ({"spacing": 1e-5}, r"at most 5e\+07"),
    ],
)
def test_invalid_boxes_are_refused(arguments, message):
    with pytest.raises(pt.InputError, match=message):
        pt.box(**({"size": SIZES[3], "spacing": 0.1} | arguments))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": np.full((4, 4, 4, 3), np.nan).reshape(-1, 3)}, "points must be finite.*nodes 0, 1"),
        ({"points": np.zeros((4, 1))}, "must have shape"),
        ({"volumes": np.zeros(64)}, "volumes must be positive"),
        ({"face_areas": np.ones(3)}, "one row for every node-face pair"),
        ({"groups": {"tip": np.array([64])}}, "group 'tip'"),
        ({"groups": {"tip": np.array([], dtype=int)}}, "group 'tip' must hold nodes"),
    ],
)
def test_clouds_with_inconsistent_arrays_are_refused(change, message):
    with pytest.raises(pt.CloudError, match=message):
        replace(pt.box((0.3, 0.3, 0.3), 0.1), **change)


def test_an_unknown_group_is_refused_with_the_names_of_all_groups(block):
    with pytest.raises(pt.InputError, match=r"group must be one of 'x\+'.*'z-', got 'top'"):
        block.group("top")


def test_the_area_of_a_group_that_is_not_a_face_is_refused(block):
    mixed = replace(block, groups={"skin": np.unique(block.face_nodes)})
    with pytest.raises(pt.InputError, match="'skin' must lie on one face"):
        mixed.area_vectors("skin")
