"""Paths of tools on any body: what they reach, how they come, how deep they press, and where they are placed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tool_bodies import Body, bean, filled, hollow, lobes, together

import palpate as pt
from palpate.scenes.load_case import TRAINING_SEEDS
from palpate.scenes.tool_paths import ToolPaths
from palpate.surface.nesting import winding_number

pytestmark = pytest.mark.slow

ORGANS = Path(__file__).parents[3] / "shared" / "data"
HELD_OUT = 500_000  # first seed of held-out runs
TIMES = np.linspace(0.0, 0.6, 61)


def liver_with_back(spacing):
    cloud = pt.fill(pt.liver_surface(), spacing)
    return Body(cloud.with_group("back", pt.near_plane(cloud, (0.0, 0.03, 0.0), (0.0, -1.0, 0.0))), ("back",))


BODIES = {
    "box": lambda: (Body(pt.box((0.1, 0.08, 0.05), 0.005), ("x-",)), 0.0125, 0.015),
    "lobes": lambda: (Body(lobes(0.03)), 0.011, 0.012),
    "narrow": lambda: (Body(lobes(0.008)), 0.011, 0.012),
    "bean": lambda: (Body(bean()), 0.0125, 0.01),
    "two": lambda: (
        Body(together(pt.box((0.06,) * 3, 0.006), pt.box((0.06,) * 3, 0.006), (0.08, 0.01, 0.0)), ("z-",)), 0.013, 0.02
    ),
    "liver": lambda: (liver_with_back(0.01), 0.025, 0.02),
}  # fmt: skip


@pytest.fixture(scope="module", params=BODIES)
def paths(request):
    body, radius, depth = BODIES[request.param]()
    return ToolPaths(body, radius, depth, 0.2, 0.02)


def ball(paths, seed, times=TIMES):
    (contact,), duration = paths.press(seed)
    assert duration == TIMES[-1]
    return contact.poses(times)[:, :3]


def signed_distance(cloud, places):
    """Distances [m] to the triangles, by many points on them, negative inside, where triangles wind around a place."""
    corners = cloud.points[cloud.triangles]
    weights = np.array([(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)]) / 6
    samples = np.einsum("wk,tka->wta", weights, corners).reshape(-1, 3)
    distance = cKDTree(samples).query(places)[0]
    inside = [winding_number(corners, place) > 0.5 for place in places]
    return np.where(inside, -distance, distance)


def test_the_ball_comes_from_outside_along_the_normal_and_only_indents_the_body(paths):
    cloud, radius = paths.surface.cloud, paths.radius
    for seed in (*range(6), *range(HELD_OUT, HELD_OUT + 6)):
        way = ball(paths, seed)
        gap = signed_distance(cloud, way[::3]) - radius
        assert min(gap[0], gap[-1]) > -0.01 * radius
        assert gap.min() < 0  # it touches
        # no deeper than allowed, apart from the sag of a slide and the distance between samples
        assert -gap.min() <= 1.1 * paths.depth + 0.1 * radius
        along = (way[25] - way[0]) / np.linalg.norm(way[25] - way[0])
        np.testing.assert_allclose(across(way[:26] - way[0], along), 0.0, atol=1e-12)
        met = np.linalg.norm(across(paths.surface.points - way[0], along), axis=1) < 1e-9
        assert np.any(met & paths.reachable & (paths.normals @ -along > 1 - 1e-9))


def across(vectors, axis):
    return vectors - (vectors @ axis)[:, None] * axis


def test_tools_keep_from_fixed_nodes(paths):
    surface = paths.surface
    if not len(surface.fixed_points):
        pytest.skip("a free body")
    nodes = np.concatenate([surface._touched(paths.press(seed)[0][0], 0.6) for seed in range(40)])
    distances = np.linalg.norm(surface.points[nodes, None] - surface.fixed_points, axis=2).min(axis=1)
    assert distances.min() >= paths.radius - surface.cloud.spacing
    for seed in range(40):
        (grasp,), _ = paths.grasp(seed)
        assert np.linalg.norm(surface.fixed_points - grasp.point, axis=1).min() > grasp.radius
        assert not np.isin(grasp.with_group(surface.cloud).group("grasp"), surface.nodes[surface.held]).any()


def inner_walls(surface, gap):
    """Nodes on the walls of the gap of `lobes`, away from its rims."""
    x, y, z = surface.points.T
    return (np.abs(np.abs(x) - gap / 2) < 1e-3) & (z > 0.0) & (z < 0.02) & (np.abs(y) < 0.015)


@pytest.mark.parametrize(("gap", "reached"), [(0.008, False), (0.03, True)])
def test_between_lobes_only_a_ball_that_fits_reaches(gap, reached):
    paths = ToolPaths(Body(lobes(gap)), 0.011, 0.012, 0.2, 0.01)
    walls = inner_walls(paths.surface, gap)
    assert np.count_nonzero(walls) > 10
    assert paths.reachable[walls].mean() == pytest.approx(1.0 if reached else 0.0, abs=0.05)
    outside = np.abs(paths.surface.points[:, 0]) > 0.039
    assert paths.reachable[outside].all()


def test_a_notch_that_is_narrower_than_the_ball_is_not_reached():
    narrow, wide = (ToolPaths(Body(bean()), radius, 0.01, 0.2, 0.01) for radius in (0.024, 0.0125))
    x, y, z = narrow.surface.points.T
    bottom = (np.hypot(x, y - 0.03) < 0.0185) & (np.abs(x) < 0.005) & (np.abs(z) < 0.01)
    assert np.count_nonzero(bottom) > 5
    assert not narrow.reachable[bottom].any()
    assert wide.reachable[bottom].all()


def test_a_closed_cavity_is_not_reached_though_the_ball_has_room_in_it():
    paths = ToolPaths(Body(hollow()), 0.011, 0.01, 0.2, 0.01)
    inside = np.linalg.norm(paths.surface.points, axis=1) < 0.035
    assert np.count_nonzero(inside) > 50
    assert not paths.reachable[inside].any()
    assert paths.reachable[~inside].all()


def test_depths_are_limited_by_the_thickness_and_by_fixed_nodes_below():
    plate = pt.box((0.12, 0.12, 0.02), 0.005)
    free = ToolPaths(Body(plate), 0.0125, 0.02, 0.2, 0.0)
    x, y, z = free.surface.points.T
    middle = (z > 0.019) & (np.abs(x - 0.06) < 0.03) & (np.abs(y - 0.06) < 0.03)
    np.testing.assert_allclose(free.depths[middle], 0.4 * 0.02, atol=0.4 * 0.0026)
    for seed in range(20):
        indentation = 0.0125 - np.linalg.norm(plate.points[:, None] - ball(free, seed)[25], axis=2).min()
        assert 0 < indentation <= free.depths.max() + 1e-9
    thick = pt.box((0.12, 0.12, 0.06), 0.005)
    depths = {}
    for height in (0.02, 0.04):
        inner = thick.with_group("bone", np.flatnonzero(thick.points[:, 2] <= height + 1e-9))
        found = ToolPaths(Body(inner, ("bone",)), 0.0125, 0.02, 0.2, 0.0, grasps=0.0)
        top = np.flatnonzero((found.surface.points == (0.06, 0.06, 0.06)).all(axis=1))
        depths[height] = float(found.depths[top[0]])
    assert depths[0.02] == pytest.approx(0.4 * 0.04, abs=1e-3)
    assert depths[0.04] == pytest.approx(0.4 * 0.02, abs=1e-3)


@pytest.mark.quick
def test_slides_do_not_cross_supports():
    cloud = pt.box((0.2, 0.08, 0.04), 0.01)
    strip = np.flatnonzero((np.abs(cloud.points[:, 0] - 0.1) < 0.011) & (cloud.points[:, 2] > 0.039))
    paths = ToolPaths(Body(cloud.with_group("strip", strip), ("strip",)), 0.025, 0.01, 0.2, 0.2, grasps=0.0)
    crossed = False
    for seed in range(HELD_OUT, HELD_OUT + 60):
        nodes = paths.surface._touched(paths.press(seed)[0][0], 0.6)
        distances = np.linalg.norm(paths.surface.points[nodes, None] - cloud.points[strip], axis=2)
        assert distances.min() >= 0.025 - 0.01
        crossed |= np.ptp(paths.surface.points[nodes, 0]) > 0.03
    assert crossed  # slides are long enough for that


def test_slides_over_a_bulge_are_not_deeper_than_presses():
    radius, body = 0.0125, 0.03
    paths = ToolPaths(
        Body(filled(lambda x, y, z: np.sqrt(x**2 + y**2 + z**2) - body, (body,) * 3, 0.005)), radius, 0.008, 0.2, 0.05
    )
    lengths = []
    for seed in range(60):
        way = ball(paths, seed)[25:46]
        depths = radius - (np.linalg.norm(way, axis=1) - body)
        assert depths.max() <= 1.1 * max(depths[0], depths[-1]) + 0.04 * radius
        lengths.append(np.linalg.norm(way[-1] - way[0]))
    assert np.max(lengths) > 0.01


def test_rollers_are_pressed_and_clamps_and_planes_of_symmetry_are_not():
    cloud = pt.box((0.08, 0.08, 0.08), 0.01)
    for support, pressed in ((pt.Roller("z+"), True), ("z+", False), (pt.SymmetryPlane("z+"), False)):
        paths = ToolPaths(Body(cloud, (support,)), 0.02, 0.01, 0.2, 0.0)
        middle = np.flatnonzero((paths.surface.points == (0.04, 0.04, 0.08)).all(axis=1))[0]
        assert paths.reachable[middle] == pressed
        assert paths.surface.held[middle] != pressed


def places(paths, seeds):
    return np.array([ball(paths, seed, np.array([0.25]))[0] for seed in seeds])


def covering_radius(paths, pressed):
    """Largest distance of a reachable node from the nearest press."""
    points = paths.surface.points[paths.reachable]
    return np.linalg.norm(points[:, None] - pressed, axis=2).min(axis=1).max()


def test_training_places_are_spread_and_held_out_places_are_not():
    paths = ToolPaths(Body(pt.box((0.2, 0.1, 0.05), 0.01)), 0.025, 0.01, 0.2, 0.02, grasps=0.0)
    campaigns = [1_000_000 * k for k in range(5)]
    for count in (8, 16, 32):
        spread = np.mean([covering_radius(paths, places(paths, c + np.arange(count))) for c in campaigns])
        others = np.mean([covering_radius(paths, places(paths, c + HELD_OUT + np.arange(count))) for c in campaigns])
        assert spread < 0.85 * others


def test_held_out_places_are_at_random_by_area():
    paths = ToolPaths(Body(pt.box((0.2, 0.1, 0.05), 0.01)), 0.025, 0.01, 0.2, 0.0, grasps=0.0)
    drawn = places(paths, range(HELD_OUT, HELD_OUT + 400))
    share = paths.surface.areas[paths.reachable & (paths.surface.points[:, 0] < 0.1 - 1e-9)].sum()
    share += 0.5 * paths.surface.areas[paths.reachable & (np.abs(paths.surface.points[:, 0] - 0.1) < 1e-9)].sum()
    share /= paths.surface.areas[paths.reachable].sum()
    assert np.mean(drawn[:, 0] < 0.1) == pytest.approx(share, abs=0.08)  # three standard deviations


def test_equal_seeds_give_equal_paths_and_others_other_depths_and_slides():
    one, two = (ToolPaths(Body(pt.box((0.1, 0.08, 0.05), 0.005), ("x-",)), 0.0125, 0.015, 0.2, 0.02) for _ in "ab")
    for seed in (20, HELD_OUT, 1_000_002, 0):
        np.testing.assert_array_equal(ball(one, seed), ball(two, seed))
    assert np.abs(ball(one, 0) - ball(one, 1_000_000)).max() > 1e-3
    ways = [ball(one, seed) for seed in range(0, 60) if seed % 4 != 3]
    depths = [1.4 * 0.0125 - np.linalg.norm(way[25] - way[0]) for way in ways]  # heights of the pressed centre
    slides = np.array([np.linalg.norm(way[45] - way[25]) for way in ways])
    assert np.std(depths) > 1e-3
    assert 0.005 < slides.mean() < 0.02
    assert slides.max() <= 0.02 + 0.015 + 0.005


def test_held_out_paths_are_short_touches_of_a_hand(paths):
    """They come along the normal exponentially, keep outside of the body before, and move aside or away at most."""
    kinds, times = set(), np.linspace(0.0, 0.3, 61)
    for seed in range(HELD_OUT, HELD_OUT + 40):
        (touch,), duration = paths.touch(seed)
        assert duration == 0.3
        way = touch.poses(times)[:, :3]
        normal = way[0] - way[20]  # before 0.14 s it moves along the normal alone
        depth = np.linalg.norm(normal) / (1 - np.exp(-0.1 / 0.07)) - 0.05 * paths.radius
        normal /= np.linalg.norm(normal)
        np.testing.assert_allclose(across(way[:28] - way[0], normal), 0.0, atol=1e-12)
        assert 0.0 < depth <= paths.depths.max() + 1e-12
        assert signed_distance(paths.surface.cloud, way[:1])[0] > (1 - 0.01) * paths.radius
        aside = float(np.linalg.norm(across(way[-1:] - way[27], normal)))
        rises = (way[-1] - way[27]) @ normal > 0.5 * 0.1 * 0.16
        kinds.add("release" if rises else "flick" if aside > 0.0081 else "draw" if aside > 1e-9 else "hold")
        assert aside <= paths.slide + 1e-12
    assert {"hold", "release"} <= kinds
    assert kinds & {"draw", "flick"}


def forceps(paths, seed, times):
    (grasp,), duration = paths(seed)
    assert duration == 0.6
    poses = pt.tools.Contact(pt.tools.Plane(), grasp.motion).poses(np.asarray(times))
    return grasp, poses[:, :3] - grasp.point, 2 * np.arccos(np.minimum(poses[:, 3], 1.0))


def test_every_fourth_path_is_a_pull_within_a_cone_that_turns_returns_and_releases():
    paths = ToolPaths(Body(pt.box((0.1, 0.1, 0.04), 0.01), ("y+",)), 0.025, 0.02, 0.2, 0.02)
    turns = []
    for seed in range(83):
        if seed % 4 != 3:
            assert isinstance(paths(seed)[0][0], pt.tools.Contact)
            continue
        grasp, moved, turned = forceps(paths, seed, TIMES)
        node = int(np.argmin(np.linalg.norm(paths.surface.points - grasp.point, axis=1)))
        held = grasp.with_group(paths.surface.cloud).group("grasp")
        assert len(held) >= 5
        assert grasp.radius == 0.02
        assert 0.57 < grasp.until < 0.6
        pull = np.linalg.norm(moved, axis=1)
        assert 0.3 * 0.02 - 1e-12 <= pull.max() <= 0.02 + 1e-12
        np.testing.assert_allclose(pull[25:46], pull.max())  # it holds, and turns
        assert moved[25] @ paths.normals[node] >= np.cos(np.pi / 4) * pull.max() - 1e-12
        assert turned.max() <= np.pi / 9 + 1e-12
        assert turned[:26].max() == pytest.approx(0.0, abs=1e-7)
        ends = grasp.until - 1e-9 <= TIMES
        np.testing.assert_allclose(moved[ends], 0.0, atol=1e-12)
        np.testing.assert_allclose(turned[ends], 0.0, atol=1e-7)
        turns.append(turned.max())
    assert 5 <= np.count_nonzero(np.array(turns) > 1e-3) <= 15


@pytest.mark.parametrize(("share", "count"), [(0.0, 0), (0.1, 4), (0.5, 20), (1.0, 40)])
def test_grasps_are_a_share_of_the_paths(share, count):
    paths = ToolPaths(Body(pt.box((0.1, 0.1, 0.04), 0.01)), 0.025, 0.01, 0.2, 0.0, grasps=share)
    assert sum(isinstance(paths(seed)[0][0], pt.tools.Grasp) for seed in range(40)) == count
    held_out = [paths(seed) for seed in range(HELD_OUT, HELD_OUT + 40)]
    assert sum(isinstance(loads[0], pt.tools.Grasp) for loads, _ in held_out) == count
    assert {duration for _, duration in held_out} == {0.3}


def test_two_bodies_in_one_cloud_are_both_pressed_and_block_each_other():
    half = pt.box((0.06, 0.06, 0.06), 0.006)
    for distance, reached in ((0.012, False), (0.06, True)):
        paths = ToolPaths(Body(together(half, half, (0.06 + distance, 0.0, 0.0))), 0.015, 0.01, 0.2, 0.0, grasps=0.0)
        facing = np.abs(paths.surface.points[:, 0] - 0.06) < 1e-9
        facing &= (np.abs(paths.surface.points[:, 1:] - 0.03) < 0.02).all(axis=1)
        assert paths.reachable[facing].all() == paths.reachable[facing].any() == reached
        assert {bool(place[0] > 0.06 + distance / 2) for place in places(paths, range(6))} == {True, False}


def test_what_cannot_be_reached_is_refused_by_name():
    cloud = pt.box((0.08, 0.08, 0.08), 0.01)
    long = pt.box((0.16, 0.06, 0.06), 0.01)
    everywhere = cloud.with_group("all", np.arange(len(cloud)))
    for arguments, message in (
        ((Body(cloud), 0.019, 0.01, 0.2, 0.0), "radius of .tool. must be at least 2 spacings = 0.02 m, got 0.019"),
        ((Body(cloud), 0.04, 0.01, 0.2, 0.0), "radius must be less than half the body's size of 0.08 m, got 0.04 m"),
        ((Body(everywhere, ("all",)), 0.02, 0.01, 0.2, 0.0), "got supports at all surface nodes; support fewer"),
        ((Body(long, ("z-", "y-", "y+")), 0.035, 0.01, 0.2, 0.0), "radius must be at most 0.03 m, .* got 0.035 m; use"),
        ((Body(long, ("z-", "y-", "y+")), 0.02, 0.01, 0.2, 0.0), "forceps of radius 0.02 m .* set grasps to 0"),
        ((Body(cloud), 0.02, 0.0, 0.2, 0.0), "depth must be"),
        ((Body(pt.box((0.08, 0.08), 0.01)), 0.02, 0.01, 0.2, 0.0), "body must be a solid with a surface"),
    ):  # fmt: skip
        with pytest.raises(pt.InputError, match=message):
            ToolPaths(*arguments)


@pytest.mark.parametrize(
    ("file", "units"),
    [
        ("", ""),
        *(
            pytest.param(*row, marks=pytest.mark.skipif(not ORGANS.is_dir(), reason="the organs are not at hand"))
            for row in (("hra/VH_F_liver_solid_6k.ply", "m"), ("sofa/liver-smooth.obj", "cm"), ("sofa/liver.vtk", "mm"))
        ),
    ],
    ids=lambda part: part or "generated",
)
def test_presses_on_organs_come_from_outside(file, units):
    surface = pt.io.read_surface(ORGANS / file, units=units, repair=True) if file else pt.liver_surface()
    spacing = float(np.cbrt(surface.volume / 2000))
    cloud = pt.fill(surface, spacing)
    low, high = cloud.points[:, 1].min(), cloud.points[:, 1].max()
    cloud = cloud.with_group("bed", pt.near_plane(cloud, (0, high - 0.3 * (high - low), 0), (0, -1, 0)))
    paths = ToolPaths(Body(cloud, ("bed",)), 2.5 * spacing, 4 * spacing, 0.2, 3 * spacing)
    assert paths.surface.share(paths.reachable) > 0.5
    test_the_ball_comes_from_outside_along_the_normal_and_only_indents_the_body(paths)


@pytest.mark.parametrize(("share", "count"), [(0.0, 0), (0.25, 10), (0.5, 20), (1.0, 40)])
def test_pairs_are_a_share_of_the_held_out_paths(share, count):
    paths = ToolPaths(Body(pt.box((0.2, 0.2, 0.05), 0.01)), 0.025, 0.01, 0.2, 0.01, pairs=share)
    held_out = [paths(TRAINING_SEEDS + number) for number in range(40)]
    pairs = [loads for loads, _ in held_out if len(loads) == 2]
    assert abs(len(pairs) - count) <= 1
    assert all(len(paths(number)[0]) == 1 for number in range(40))
    grasped = [sum(isinstance(loads[0], pt.tools.Grasp) for loads, _ in held_out if len(loads) == n) for n in (1, 2)]
    assert sum(grasped) == 10
    assert abs(grasped[1] - share * 10) <= 2  # whether a path is a pair does not depend on its tool


def test_the_tools_of_a_pair_stay_apart_and_the_first_is_the_tool_alone():
    paths, times = ToolPaths(Body(pt.box((0.2, 0.2, 0.05), 0.01)), 0.025, 0.01, 0.2, 0.01), np.linspace(0, 0.75, 151)
    near = []
    for number in range(20):
        ((one, two), duration), ((alone,), short) = paths.pair(number), paths.single(number)
        assert two.name == {"Contact": "tool 2", "Grasp": "grasp 2"}[type(two).__name__]
        places, other, expected = (
            np.array([np.asarray(motion(time)[0] if isinstance(load, pt.tools.Grasp) else motion(time))
                      for time in times])
            for load, motion in ((one, one.motion), (two, two.motion), (alone, alone.motion))
        )  # fmt: skip
        np.testing.assert_array_equal(places, expected)
        delay = duration - short
        assert -1e-12 <= delay <= 0.15 + 1e-12
        if isinstance(two, pt.tools.Grasp):
            assert two.until == pytest.approx(0.58 + delay)
            np.testing.assert_array_equal(other[times <= delay], np.tile(other[0], (np.sum(times <= delay), 1)))
        sizes = sum(load.radius if isinstance(load, pt.tools.Grasp) else load.tool.radius for load in (one, two))
        apart = np.linalg.norm(places - other, axis=1).min()
        assert apart > sizes
        near.append(apart < 1.7 * sizes)
    assert 5 <= sum(near) <= 17


def test_a_body_without_room_for_a_second_tool_has_the_first_alone():
    top_alone = Body(pt.box((0.06, 0.06, 0.04), 0.01), ("z-", "x-", "x+", "y-", "y+"))
    paths = ToolPaths(top_alone, 0.025, 0.01, 0.2, 0.0, grasps=0.0, pairs=1.0)
    assert [len(paths(TRAINING_SEEDS + number)[0]) for number in range(4)] == [1, 1, 1, 1]
