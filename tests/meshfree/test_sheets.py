"""Plane clouds: what they stand for, how evenly they fill it, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path
from scipy.spatial import ConvexHull, Voronoi, cKDTree

import palpate as pt

pytestmark = pytest.mark.slow

RADIUS = 0.1
LAYOUTS = ("rings", "hexagonal")
TURN = np.arange(10) * np.pi / 5 + np.pi / 2
OUTLINES = {
    "rectangle": [(0, 0), (0.3, 0), (0.3, 0.2), (0, 0.2)],
    "clockwise": [(0, 0.2), (0.3, 0.2), (0.3, 0), (0, 0)],
    "triangle": [(0.01, 0), (0.31, 0.05), (0.1, 0.25)],
    "L": [(0, 0), (0.3, 0), (0.3, 0.14), (0.13, 0.14), (0.13, 0.3), (0, 0.3)],
    "star": np.stack([np.cos(TURN), np.sin(TURN)], axis=1) * np.tile([0.2, 0.09], 5)[:, None],
}
SPACING = 0.0123


def shoelace(corners):
    x, y = np.asarray(corners, dtype=float).T
    return np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2


def nearest(cloud):
    """Distance of every node to its nearest neighbour, in spacings."""
    return cKDTree(cloud.points).query(cloud.points, k=2)[0][:, 1] / cloud.spacing


def sides(cloud):
    """Side lengths (t, 3) [m] and signed areas (t,) [m^2] of the triangles."""
    a, b, c = np.moveaxis(cloud.points[cloud.triangles], 1, 0)
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    return np.stack(
        [np.linalg.norm(b - c, axis=1), np.linalg.norm(c - a, axis=1), np.linalg.norm(a - b, axis=1)], 1
    ), area


def largest_hole(cloud):
    """Radius of the largest circle without a node in it, in spacings; 0.577 on the lattice."""
    lengths, area = sides(cloud)
    return (lengths.prod(axis=1) / (4 * area)).max() / cloud.spacing


def inner(cloud):
    return np.setdiff1d(np.arange(len(cloud)), cloud.group("rim"))


def assert_quadratics_are_exact(cloud, worst_condition):
    stencils = pt.moving_least_squares(cloud.points, order=2, neighbours=18)
    assert stencils.condition.max() < worst_condition
    size = np.ptp(cloud.points, axis=0).max()
    x, y = (cloud.points.T - cloud.points.mean(axis=0)[:, None]) / size
    field = 1 + 2 * x - 3 * y + 4 * x**2 - 5 * y**2 + 6 * x * y
    gradient = np.stack([2 + 8 * x + 6 * y, -3 - 10 * y + 6 * x], axis=1)
    np.testing.assert_allclose(stencils.gradient(field) * size, gradient, atol=1e-9)
    np.testing.assert_allclose(stencils.hessian(field) * size**2, np.tile([8, -10, 6], (len(x), 1)), atol=1e-7)


@pytest.fixture(params=[(layout, jitter) for layout in LAYOUTS for jitter in (0.0, 0.3)], ids=str)
def plate(request):
    layout, jitter = request.param
    return pt.disc(RADIUS, RADIUS / 12, layout, jitter, seed=3)


@pytest.fixture(params=[(name, jitter) for name in OUTLINES for jitter in (0.0, 0.3)], ids=str)
def shape(request):
    name, jitter = request.param
    return np.array(OUTLINES[name]), pt.sheet(OUTLINES[name], SPACING, jitter, seed=3)


@pytest.mark.quick
def test_areas_of_a_disc_sum_to_its_area(plate):
    assert plate.volumes.sum() == pytest.approx(np.pi * RADIUS**2, rel=1e-13)


def assert_areas_are_voronoi_cells(cloud):
    """Of the inner nodes, against another algorithm."""
    cells = Voronoi(cloud.points)
    expected = [ConvexHull(cells.vertices[cells.regions[cells.point_region[i]]]).volume for i in inner(cloud)]
    np.testing.assert_allclose(cloud.volumes[inner(cloud)], expected, rtol=1e-9)


def test_areas_of_a_disc_are_those_of_the_voronoi_cells(plate):
    assert_areas_are_voronoi_cells(plate)


def test_areas_of_a_sheet_are_those_of_the_voronoi_cells(shape):
    assert_areas_are_voronoi_cells(shape[1])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_sums_over_a_disc_are_integrals_to_second_order(layout):
    errors = []
    for count in (10, 20, 40):
        cloud = pt.disc(1.0, 1 / count, layout)
        errors.append(cloud.volumes @ cloud.points[:, 0] ** 2 / (np.pi / 4) - 1)
    assert abs(errors[0]) < 0.02
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2, atol=0.2)


def test_rim_and_centre_are_groups_of_a_disc(plate):
    distance = np.linalg.norm(plate.points, axis=1)
    np.testing.assert_array_equal(plate.group("rim"), np.flatnonzero(distance > RADIUS * (1 - 1e-12)))
    np.testing.assert_allclose(distance[plate.group("rim")], RADIUS, rtol=1e-14)
    np.testing.assert_array_equal(plate.points[plate.group("centre")], [[0, 0]])
    assert set(plate.groups) == {"face", "rim", "centre"}


def test_rim_nodes_are_evenly_spaced(plate):
    rim = plate.points[plate.group("rim")]
    gaps = np.linalg.norm(rim - np.roll(rim, -1, axis=0), axis=1)
    np.testing.assert_allclose(gaps, gaps[0], rtol=1e-12)
    assert gaps[0] == pytest.approx(plate.spacing, rel=0.06)


def test_faces_of_a_disc_obey_the_divergence_theorem(plate):
    np.testing.assert_array_equal(plate.face_nodes, plate.group("rim"))
    np.testing.assert_allclose(np.linalg.norm(plate.face_normals, axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(plate.face_areas @ plate.face_normals, 0, atol=1e-15)
    flux = np.sum(plate.points[plate.face_nodes] * plate.face_normals, axis=1) @ plate.face_areas
    assert flux == pytest.approx(2 * np.pi * RADIUS**2, rel=1e-13)
    assert plate.face_areas.sum() == pytest.approx(2 * np.pi * RADIUS, rel=1e-13)


def test_boundary_vectors_of_rings_are_those_of_half_cells():
    cloud = pt.disc(RADIUS, RADIUS / 40)
    size = np.linalg.norm(cloud.boundary_vectors(), axis=1)
    np.testing.assert_allclose(size[cloud.group("rim")] * cloud.spacing, 2, rtol=0.02)
    np.testing.assert_array_equal(size[inner(cloud)], 0)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("count", [10, 20, 40, 80])
def test_nodes_of_a_disc_are_evenly_spread(layout, count):
    cloud = pt.disc(RADIUS, RADIUS / count, layout)
    distance = nearest(cloud)
    assert 0.78 < distance.min() <= distance.max() < 1.1
    assert largest_hole(cloud) < 0.75


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_disc_whose_radius_is_not_a_multiple_of_the_spacing_is_evenly_spread(layout):
    for count in (2, 2.5, 3.3, 4.7, 7.49, 12.6, 23.7, 55.5):
        distance = nearest(pt.disc(1.0, 1 / count, layout))
        assert 0.7 < distance.min() <= distance.max() < 1.25


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("count", [10, 20, 40, 80])
def test_jitter_keeps_neighbours_apart(layout, count):
    for seed in range(2):
        distance = nearest(pt.disc(RADIUS, RADIUS / count, layout, 0.2, seed))
        assert 0.6 * 0.78 < distance.min() <= distance.max() < 1.25


def test_ring_k_has_6_k_nodes():
    cloud = pt.disc(1.0, 0.098)
    ring = np.linalg.norm(cloud.points, axis=1) / cloud.spacing
    np.testing.assert_allclose(ring, np.rint(ring), atol=1e-12)
    np.testing.assert_array_equal(np.bincount(np.rint(ring).astype(int)), [1, *range(6, 66, 6)])
    assert cloud.spacing == pytest.approx(0.1)


def test_nodes_of_successive_rings_are_not_on_one_ray():
    """Of three successive rings no three nodes lie on one ray, but for those of the six nodes of the first."""
    cloud = pt.disc(1.0, 1 / 20)
    ring = np.rint(np.linalg.norm(cloud.points, axis=1) * 20)
    angle = np.arctan2(*cloud.points.T)
    for k in range(2, 19):
        apart = [np.abs(np.angle(np.exp(1j * (angle[ring == k][:, None] - angle[ring == k + s])))) for s in (1, 2)]
        facing = [a.min(axis=1) < 0.05 / k for a in apart]
        assert not np.any(facing[0] & facing[1])


def test_the_middle_of_a_hexagonal_disc_is_a_lattice():
    cloud = pt.disc(RADIUS, RADIUS / 20, "hexagonal")
    lattice = cloud.points @ np.linalg.inv([[1, 0], [0.5, 0.75**0.5]]) / cloud.spacing
    deep = np.linalg.norm(cloud.points, axis=1) < RADIUS - 5.2 * cloud.spacing
    assert deep.sum() > 700
    np.testing.assert_allclose(lattice[deep], np.rint(lattice[deep]), atol=1e-12)
    np.testing.assert_allclose(cloud.volumes[deep], 0.75**0.5 * cloud.spacing**2, rtol=1e-12)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_discs_have_six_fold_symmetry(layout):
    cloud = pt.disc(1.0, 1 / 12, layout)
    turned = cloud.points @ [[0.5, 0.75**0.5], [-(0.75**0.5), 0.5]]
    distance, image = cKDTree(cloud.points).query(turned)
    np.testing.assert_allclose(distance, 0, atol=1e-9)
    np.testing.assert_allclose(cloud.volumes[image], cloud.volumes, rtol=1e-7)


def test_lattice_nodes_share_stencils():
    for cloud in (pt.disc(RADIUS, RADIUS / 40, "hexagonal"), pt.sheet(OUTLINES["rectangle"], 0.004)):
        stencils = pt.moving_least_squares(cloud.points, order=2, neighbours=18)
        assert np.bincount(stencils.row).max() > 0.6 * len(cloud)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("count", [2, 3, 10, 40])
@pytest.mark.parametrize("jitter", [0.0, 0.2, 0.3])
def test_stencils_on_a_disc_are_exact_and_well_conditioned(layout, count, jitter):
    for seed in range(2):
        assert_quadratics_are_exact(pt.disc(RADIUS, RADIUS / count, layout, jitter, seed), 1000 if jitter else 250)


def test_the_smallest_disc_has_two_rings():
    """One ring is too few for quadratics."""
    assert len(pt.disc(1.0, 0.5)) == len(pt.disc(1.0, 0.5, "hexagonal")) == 19
    with pytest.raises(pt.CloudError, match="neighbours for a fit of order 2 in 2D"):
        pt.moving_least_squares(pt.disc(1.0, 0.5).points[:7], order=2, neighbours=18)


def test_triangles_of_a_disc_tile_its_rim_polygon(plate):
    _, area = sides(plate)
    assert np.all(area > 0)
    assert area.sum() == pytest.approx(shoelace(plate.points[plate.group("rim")]), rel=1e-13)
    np.testing.assert_array_equal(np.unique(plate.triangles), np.arange(len(plate)))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_triangle_of_a_disc_is_a_sliver(layout):
    lengths, area = sides(pt.disc(RADIUS, RADIUS / 40, layout))
    heights = 2 * area / lengths.max(axis=1)
    assert heights.min() > 0.5 * RADIUS / 40


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_seed_decides_the_jitter(layout):
    points = [pt.disc(RADIUS, RADIUS / 8, layout, 0.2, seed).points for seed in (5, 5, 6)]
    np.testing.assert_array_equal(points[0], points[1])
    assert not np.array_equal(points[0], points[2])


def test_jitter_moves_inner_nodes_by_at_most_its_share_of_the_distance_to_their_neighbours():
    for still, moved in (
        (pt.disc(RADIUS, RADIUS / 20, "hexagonal"), pt.disc(RADIUS, RADIUS / 20, "hexagonal", 0.25)),
        (pt.sheet(OUTLINES["L"], SPACING), pt.sheet(OUTLINES["L"], SPACING, 0.25)),
    ):
        share = np.linalg.norm(moved.points - still.points, axis=1) / (nearest(still) * still.spacing)
        assert 0.24 < share.max() <= 0.25 * (1 + 1e-12)
        assert np.mean(share[inner(still)]) == pytest.approx(0.25 * 2 / 3, rel=0.1)  # uniform in a circle
        np.testing.assert_array_equal(share[still.group("rim")], 0)


@pytest.mark.quick
def test_areas_of_a_sheet_sum_to_its_area(shape):
    outline, cloud = shape
    assert cloud.volumes.sum() == pytest.approx(abs(shoelace(outline)), rel=1e-12)


def test_edges_run_from_corner_to_corner_in_even_steps(shape):
    outline, cloud = shape
    assert set(cloud.groups) == {"face", "rim", *(f"edge{k}" for k in range(len(outline)))}
    for k, (start, end) in enumerate(zip(outline, np.roll(outline, -1, axis=0), strict=True)):
        length = np.linalg.norm(end - start)
        points = cloud.points[cloud.group(f"edge{k}")]
        along = np.sort((points - start) @ (end - start) / length)
        np.testing.assert_allclose(along, np.linspace(0, length, round(length / SPACING) + 1), atol=1e-15)
        np.testing.assert_allclose((points - start) @ [-(end - start)[1], (end - start)[0]], 0, atol=1e-16)
    edges = [cloud.group(f"edge{k}") for k in range(len(outline))]
    np.testing.assert_array_equal(cloud.group("rim"), np.unique(np.concatenate(edges)))
    assert sum(map(len, edges)) == len(cloud.group("rim")) + len(outline)  # corners twice


def test_area_vectors_of_an_edge_are_its_length_along_its_outward_normal(shape):
    outline, cloud = shape
    for k, along in enumerate(np.roll(outline, -1, axis=0) - outline):
        outward = np.sign(shoelace(outline)) * np.array([along[1], -along[0]])
        vectors = cloud.area_vectors(f"edge{k}")
        np.testing.assert_allclose(vectors.sum(axis=0), outward, atol=1e-15)
        sizes = np.linalg.norm(vectors, axis=1)
        assert np.sum(sizes < 0.75 * sizes.max()) == 2  # half a segment to either corner
        assert not Path(outline).contains_point(outline[k] + along / 2 + 1e-3 * outward)


def test_faces_of_a_sheet_obey_the_divergence_theorem(shape):
    outline, cloud = shape
    np.testing.assert_allclose(cloud.face_areas @ cloud.face_normals, 0, atol=1e-15)
    flux = np.sum(cloud.points[cloud.face_nodes] * cloud.face_normals, axis=1) @ cloud.face_areas
    assert flux == pytest.approx(2 * abs(shoelace(outline)), rel=1e-12)
    np.testing.assert_array_equal(np.sort(np.bincount(cloud.face_nodes))[-len(outline) :], 2)  # corners


def test_triangles_tile_a_sheet_and_stay_in_it(shape):
    outline, cloud = shape
    _, area = sides(cloud)
    assert np.all(area > 0)
    assert area.sum() == pytest.approx(abs(shoelace(outline)), rel=1e-12)
    assert Path(outline).contains_points(cloud.points[cloud.triangles].mean(axis=1)).all()
    np.testing.assert_array_equal(np.unique(cloud.triangles), np.arange(len(cloud)))


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("spacing", [0.02, 0.0123, 0.004])
def test_nodes_of_a_sheet_are_evenly_spread(name, spacing):
    cloud = pt.sheet(OUTLINES[name], spacing)
    distance = nearest(cloud)
    assert 0.7 < distance[inner(cloud)].min() <= distance.max() < 1.25
    assert distance.min() > 0.6  # the tips of the star
    assert largest_hole(cloud) < 0.85


def test_stencils_on_a_sheet_are_exact_and_well_conditioned(shape):
    assert_quadratics_are_exact(shape[1], 4000)


@pytest.mark.parametrize("seed", range(12))
def test_accepted_outlines_have_accurate_stencils(seed):
    """Random outlines: each is refused, or gives a cloud that tiles it and carries quadratics, jittered or not."""
    generator = np.random.default_rng(seed)
    accepted = 0
    for _ in range(12):
        angle = np.sort(generator.uniform(0, 2 * np.pi, generator.integers(3, 10)))
        outline = generator.uniform(0.4, 1, (len(angle), 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        try:
            still = pt.sheet(outline, 0.08)
        except pt.InputError as refusal:
            assert "outline" in str(refusal)  # noqa: PT017
            continue
        accepted += 1
        for cloud in (still, pt.sheet(outline, 0.08, 0.3, seed)):
            assert sides(cloud)[1].min() > 0
            assert cloud.volumes.sum() == pytest.approx(abs(shoelace(outline)), rel=1e-12)
            assert_quadratics_are_exact(cloud, 1e5)
        assert nearest(still)[inner(still)].min() > 0.65
    assert accepted > 0


def test_areas_stay_positive_in_corners_whose_cells_would_reach_beyond_the_rim():
    outline = [(0, 0), (-0.4, 0), (0, 0.4), (0.6, 0.8), (1, 0.4), (1.2, 0.4)]
    cloud = pt.sheet(outline, 0.15)
    assert cloud.volumes.min() > 0.01 * np.median(cloud.volumes)
    assert cloud.volumes.sum() == pytest.approx(abs(shoelace(outline)), rel=1e-12)


def test_jitter_keeps_edges_where_they_crowd_each_other():
    """Two edges with steps of 0.09 m and 0.14 m meet in a sharp corner: triangles could cut through the shorter one."""
    outline = [(0, 0), (-0.17, -0.01), (-0.33, 0.32), (-0.41, 0.28), (-0.15, 0.6), (-0.91, 0.41), (-1.18, 0.37)]
    outline += [(-1.3, 0.48), (-1.51, 0.52), (-1.69, 0.03), (-0.36, -0.9), (-0.51, -0.36), (0.14, -0.2)]
    for seed in range(8):
        cloud = pt.sheet(outline, 0.15, 0.3, seed)
        assert sides(cloud)[1].sum() == pytest.approx(abs(shoelace(outline)), rel=1e-12)


def test_a_reversed_or_closed_outline_gives_the_same_sheet():
    corners = OUTLINES["L"]
    cloud, closed = pt.sheet(corners, SPACING), pt.sheet([*corners, corners[0]], SPACING)
    backward = pt.sheet(corners[::-1], SPACING)
    np.testing.assert_array_equal(cloud.points, closed.points)
    assert len(backward) == len(cloud)
    assert set(closed.groups) == set(cloud.groups) == set(backward.groups)


def test_a_moved_outline_gives_the_moved_sheet():
    near, far = (pt.sheet(np.array(OUTLINES["star"]) + shift, SPACING) for shift in (0.0, 1024.0))
    np.testing.assert_allclose(far.points - 1024, near.points, atol=1e-9)


def test_a_sheet_of_equilateral_triangles_is_a_lattice_throughout():
    cloud = pt.sheet([(0, 0), (1, 0), (0.5, 0.75**0.5)], 0.1)
    assert len(cloud) == 66
    np.testing.assert_allclose(nearest(cloud), 1, rtol=1e-9)
    counts = {1 / 6: 3, 1 / 2: 27, 1: 36}
    cells = np.sort(cloud.volumes) / (0.75**0.5 * 0.1**2)
    np.testing.assert_allclose(cells, np.repeat(list(counts), list(counts.values())), rtol=1e-9)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius": 0.0}, "radius must be .*, got 0.0"),
        ({"radius": np.inf}, "radius must be .*, got inf"),
        ({"spacing": -0.1}, "spacing must be .*, got -0.1"),
        ({"spacing": np.nan}, "spacing must be .*, got nan"),
        ({"spacing": 0.51}, r"at least 2 rings .* radius 1 m, got 0.51 m; use at most 0.5 m"),
        ({"spacing": 1e-4}, r"at most 5e7 nodes, got 0.0001 m \(3.6e\+08 nodes\)"),
        ({"layout": "square"}, "layout must be one of 'rings', 'hexagonal', got 'square'"),
        ({"jitter": 0.31}, r"jitter must be in \[0, 0.3\], got 0.31"),
        ({"jitter": -0.1}, "jitter must be .*, got -0.1"),
        ({"seed": 0.5}, "seed must be .*, got 0.5"),
    ],
)
def test_invalid_discs_are_refused(change, message):
    with pytest.raises(pt.InputError, match=message):
        pt.disc(**({"radius": 1.0, "spacing": 0.1} | change))


SLIT = [(-1, -1), (1, -1), (1, 1), (0.05, 1), (0.05, 0), (-0.05, 0), (-0.05, 1), (-1, 1)]
NECK = [(-1, -1), (-0.2, -0.05), (0.2, -0.05), (1, -1), (1, 1), (0.2, 0.05), (-0.2, 0.05), (-1, 1)]
# The spike between edges 3 and 4 is so sharp, and its two edges so unevenly divided, that triangles cut through it.
SPIKE = [(1.148, 2.101), (0.982, 2.141), (0.612, 2.638), (0.777, 2.721), (0.391, 2.684), (0.884, 3.261), (1.175, 3.451),
         (1.237, 3.052), (1.536, 3.359)]  # fmt: skip


@pytest.mark.quick
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"outline": [(0, 0), (1, 0)]}, "outline must have at least 3 corners, got 2"),
        ({"outline": [(0, 0), (1, 0), (0, 0)]}, "at least 3 corners, got 2"),
        ({"outline": [(0, 0, 0), (1, 0, 0), (1, 1, 0)]}, r"outline must be numbers of shape \(m, 2\)"),
        ({"outline": [(0, 0), (1,)]}, r"outline must be numbers of shape \(m, 2\).*got \[\(0, 0\), \(1,\)\]"),
        ({"outline": "square"}, "outline must be numbers of shape .*'square'"),
        ({"outline": [(0, 0), (1, np.nan), (1, 1)]}, "outline must have finite corners, got .* at corner 1"),
        ({"outline": [(0, 0), (1, 0), (1, 0), (0, 1)]}, "must have different corners, got .* at corners 1 and 2"),
        ({"outline": [(0, 0), (1, 0), (2, 0)]}, "outline must have a positive area, got 3 corners on one line"),
        ({"outline": [(0, 0), (1, 1), (1, 0), (0, 1)]}, "must not cross or touch itself, got edge 0 .* meets edge 2"),
        ({"outline": [(0, 0), (2, 0), (2, 1), (1, 0), (0, 1)]}, "touch itself, got edge 0 .* meets edge 2"),
        ({"outline": [(0, 0), (2, 0), (1, 0), (1, 1)]}, "touch itself, got edge 0 .* meets edge 2"),
        ({"outline": [(0, 0), (1, 0), (1, 1), (1, 0.5)]}, "touch itself, got edge 1 .* meets edge 3"),
        ({"outline": [(0, 0), (1, 0), (0, 0.3)]}, "edges 0 and 1 .* a sharp corner; cut it off"),
        ({"outline": [(0, 0.3), (0, 0), (1, 0)]}, "edges 1 and 2 .* a sharp corner"),
        ({"outline": [(1, 0), (0, 0.3), (0, 0)]}, "edges 2 and 0 .* a sharp corner"),
        (
            {"outline": [(0, 0), (1, 0), (1, 0.04), (0, 1)]},
            "edge 1 of the outline must be .*, got 0.04 m; .*at most 0.08 m",
        ),
        (
            {"outline": [(0, 0), (1, 0), (1, 0.12), (0, 0.12)]},
            "edges 0 and 2 .* a narrow passage.* at most 0.0923 m",
        ),
        ({"outline": NECK}, "edges [12] and [56] .* got 0.1 m .* a narrow passage"),
        ({"outline": SLIT}, "edges 3 and [56] .* a narrow gap.* at most 0.05 m"),
        ({"outline": SPIKE, "spacing": 0.15}, r"outline must be wider for its nodes near \[0.6"),
        ({"spacing": 0.8}, "spacing must be smaller for a small or narrow outline, got 0.8 m"),
        ({"spacing": 3.0}, "edge 0 of the outline must be at least half the spacing = 3 m long, got 1 m"),
        ({"spacing": 1e-4}, r"at most 5e7 nodes, got 0.0001 m \(1.2e\+08 nodes\)"),
        ({"spacing": 0.0}, "spacing must be .*, got 0.0"),
        ({"jitter": 0.4}, r"jitter must be in \[0, 0.3\], got 0.4"),
        ({"seed": -1}, "seed must be .*, got -1"),
    ],
)
def test_invalid_sheets_are_refused(change, message):
    with pytest.raises(pt.InputError, match=message):
        pt.sheet(**({"outline": [(0, 0), (1, 0), (1, 1), (0, 1)], "spacing": 0.1} | change))


def test_an_advised_spacing_is_accepted():
    assert pt.sheet(SLIT, 0.05).group("edge4").size == 3
    assert pt.sheet([(0, 0), (1, 0), (1, 0.12), (0, 0.12)], 0.0923).spacing == pytest.approx(1 / 11)


def test_within_gives_a_group_of_the_nodes_near_a_point():
    cloud = pt.disc(1.0, 0.1)
    touched = cloud.within("tool", (0.0, 0.0), 0.3)
    assert set(touched.groups) == {"face", "rim", "centre", "tool"}
    assert len(touched.group("tool")) == 1 + 6 + 12 + 18  # the ring at 0.3 included
    np.testing.assert_array_equal(touched.points, cloud.points)
    assert "tool" not in cloud.groups


def test_within_measures_distances_in_three_dimensions():
    block = pt.box((0.4, 0.4, 0.4), 0.1).within("tool", (0.2, 0.2, 0.4), 0.1)
    np.testing.assert_allclose(np.abs(block.points[block.group("tool")] - (0.2, 0.2, 0.4)).sum(axis=1).max(), 0.1)
    assert len(block.group("tool")) == 6  # the node there, four next to it, one below


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "rim"}, "group must be a new name, got 'rim'"),
        ({"centre": (0.55, 0.0), "radius": 0.01}, r"radius must reach a node from \[0.55 0. +\] m.* 0.0"),
        ({"centre": (0.0, 0.0, 0.0)}, "centre must have 2 entries, got 3"),
        ({"centre": (0.0, np.nan)}, "centre must be .*, got nan"),
        ({"radius": 0.0}, "radius must be .*, got 0.0"),
    ],
)
def test_within_refuses_invalid_groups(change, message):
    with pytest.raises(pt.InputError, match=message):
        pt.disc(1.0, 0.1).within(**({"name": "tool", "centre": (0.0, 0.0), "radius": 0.1} | change))
