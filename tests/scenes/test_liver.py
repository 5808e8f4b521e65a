"""The pressed liver: its presses and grasps, and the smooth shapes that stand for modes."""

from __future__ import annotations

import numpy as np
import pytest
from palpate.scenes.liver import ToolPaths, pressed_liver

import palpate as pt
from palpate.reduction.basis.linear_modes import interpolated_modes
from palpate.scenes.training import training_scene

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene():
    return pressed_liver(spacing=0.012, radius=0.03)


def ball(scene, seed):
    (contact,), duration = scene.path(seed)
    return contact.poses(np.linspace(0.0, duration, 13))[:, :3]


def test_presses_begin_and_end_outside_and_go_in(scene):
    points = scene.model.cloud.points
    for seed in (0, 1, 2, 4, 5):
        way = ball(scene, seed)
        depth = 0.03 - np.linalg.norm(points[:, None] - way, axis=2).min(axis=0)
        assert depth[0] < 0
        assert depth[-1] < 0
        assert 0.3 * 0.02 - 1e-9 <= depth.max() <= 0.021
    np.testing.assert_array_equal(ball(scene, 2), ball(scene, 2))
    assert np.abs(ball(scene, 2) - ball(scene, 4)).max() > 1e-3


@pytest.fixture(scope="module")
def block():
    """Paths on a block, whose nodes are known."""
    cloud = pt.box((0.1, 0.1, 0.04), spacing=0.01)
    cloud = cloud.with_group("back", np.flatnonzero(cloud.points[:, 1] > 0.095))
    return ToolPaths(cloud, 0.025, 0.02, 0.2)


def test_the_presses_of_given_seeds_do_not_change(block):
    """The ball away, pressed, and slid, as before seeds of grasps came in between."""
    for seed, *expected in (
        (0, (0.1, -0.031, 0.02), (0.1, -0.015222986007, 0.02), (0.0915625, -0.015222986007, 0.0284375)),
        (5, (0.07, 0.05, 0.071), (0.07, 0.05, 0.047688828944), (0.07, 0.05, 0.047688828944)),
        (500_002, (0.07, 0.07, 0.071), (0.07, 0.07, 0.054653733814), (0.07, 0.07, 0.054653733814)),
    ):
        (contact,), duration = block(seed)
        assert (contact.tool, contact.friction, duration) == (pt.tools.Sphere(0.025), 0.2, 0.6)
        places = contact.poses(np.array([0.0, 0.25, 0.4]))[:, :3]
        np.testing.assert_allclose(places, expected, atol=1e-11)
        gaps = np.linalg.norm(places[:, None] - block.cloud.points, axis=2).min(axis=1) - 0.025
        assert gaps[0] > 0 > gaps[1:].max()
        assert gaps.min() >= -0.02


def forceps(paths, seed, times):
    (grasp,), duration = paths(seed)
    assert duration == 0.6
    poses = pt.tools.Contact(pt.tools.Plane(), grasp.motion).poses(np.asarray(times))
    return grasp, poses[:, :3] - grasp.point, 2 * np.arccos(np.minimum(poses[:, 3], 1.0))


def test_every_fourth_path_is_a_pull_within_a_cone_that_turns_returns_and_releases(block):
    turns, times = [], np.linspace(0.0, 0.6, 61)
    for seed in range(3, 83, 4):
        grasp, moved, turned = forceps(block, seed, times)
        node = int(np.argmin(np.linalg.norm(block.cloud.points - grasp.point, axis=1)))
        held = grasp.with_group(block.cloud).group("grasp")
        assert len(held) >= 5
        assert not np.isin(held, block.cloud.group("back")).any()
        assert grasp.radius == 0.02
        assert 0.57 < grasp.until < 0.6
        pull = np.linalg.norm(moved, axis=1)
        assert 0.3 * 0.02 - 1e-12 <= pull.max() <= 0.02 + 1e-12
        np.testing.assert_allclose(pull[25:46], pull.max())  # it holds, and turns
        assert moved[25] @ block.normals[node] >= np.cos(np.pi / 4) * pull.max() - 1e-12
        assert turned.max() <= np.pi / 9 + 1e-12
        assert turned[:26].max() == pytest.approx(0.0, abs=1e-7)
        ends = times >= grasp.until - 1e-9
        np.testing.assert_allclose(moved[ends], 0.0, atol=1e-12)
        np.testing.assert_allclose(turned[ends], 0.0, atol=1e-7)
        turns.append(turned.max())
    assert 5 <= np.count_nonzero(np.array(turns) > 1e-3) <= 15


def test_equal_seeds_give_equal_grasps_and_others_others(block):
    times = np.linspace(0.0, 0.6, 13)
    (one, *first), (two, *second), (_, *other) = (forceps(block, seed, times) for seed in (7, 7, 11))
    np.testing.assert_array_equal(one.point, two.point)
    assert (one.radius, one.until) == (two.radius, two.until)
    np.testing.assert_array_equal(np.column_stack(first), np.column_stack(second))
    assert np.abs(first[0] - other[0]).max() > 1e-3


def test_tools_too_large_for_the_body_are_refused(block):
    with pytest.raises(pt.InputError, match=r"forceps of radius 0\.096 m"):
        ToolPaths(block.cloud, 0.16, 0.02, 0.2)(3)


def test_the_full_model_runs_a_press_and_a_grasp(scene):
    for seed in (0, 3):
        loads, _ = scene.path(seed)
        run = pt.rollout(scene.model, loads, duration=0.1, every=0.05)
        assert np.isfinite(run.displacements).all()


def test_modes_are_zero_at_the_back_and_nearly_orthogonal(scene):
    assert scene.coarse() is scene.model  # coarse enough itself
    finer = pressed_liver(spacing=0.010, radius=0.03).model
    shapes = interpolated_modes(scene.coarse(), finer, 6)
    cloud = finer.cloud
    assert shapes.shape == (6, len(cloud), 3)
    assert not shapes[:, cloud.group("back")].any()
    flat = shapes.reshape(6, -1) * np.sqrt(np.repeat(finer.masses, 3))
    gram = flat @ flat.T
    sizes = np.sqrt(np.diag(gram))
    gram /= sizes * sizes[:, None]
    assert np.abs(gram[:3, :3] - np.eye(3)).max() < 0.05  # vibrations
    assert np.linalg.cond(gram) < 100  # with their derivatives


def test_bad_parameters_are_refused_by_name():
    with pytest.raises(pt.InputError, match="radius"):
        pressed_liver(spacing=0.01, radius=0.02)
    with pytest.raises(pt.InputError, match="poisson"):
        training_scene("liver", {"poisson": 0.5})
