"""Paths of a tool that holds a group: of the beam's end and of the middle of the membrane."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.scenes.open_scene import open_scene
from palpate.scenes.scene_paths import SWINGS_PER_MOTION, held_motion
from palpate.scenes.training import training_of

DEPTH, TANGENTIAL, RADIUS = 0.02, 0.004, 0.02  # [m] of the membrane's file


@pytest.fixture(scope="module")
def membrane():
    return open_scene("membrane", {"prestretch": 1.2, "training.duration": 0.2})


@pytest.fixture(scope="module")
def beam():
    return open_scene("beam")


def way(scene, seed, times):
    (load,), duration = scene.paths(seed)
    assert (load.group, duration) == ("tool", 0.2)
    return np.array([load.displacement(np.zeros((1, 2)), time)[0] for time in times])


def test_a_path_starts_and_ends_at_rest_and_stays_within_its_amplitudes(membrane):
    for seed in range(5):
        path = way(membrane, seed, np.linspace(0.0, 0.2, 101))
        np.testing.assert_allclose(path[[0, -1]], 0.0, atol=1e-15)
        early, later = way(membrane, seed, [1e-6, 2e-6])
        np.testing.assert_allclose(later, 4 * early, rtol=1e-6)  # its speed is zero there
        assert np.all(np.abs(path).max(axis=0) <= SWINGS_PER_MOTION * np.array([TANGENTIAL, TANGENTIAL, DEPTH]))
        assert np.abs(path[:, 2]).max() > 0


def test_equal_seeds_are_equal_paths_and_others_are_not(membrane):
    times, other = np.linspace(0.0, 0.2, 11), open_scene("membrane", {"training.duration": 0.2})
    np.testing.assert_array_equal(way(membrane, 3, times), way(other, 3, times))
    assert np.abs(way(membrane, 3, times) - way(membrane, 4, times)).max() > 1e-3


def test_the_sheet_is_taut_and_its_middle_is_prescribed(membrane):
    scene = training_of(membrane, {"prestretch": 1.2})
    model = scene.model
    assert scene.tools == ("tool",)
    held = np.linalg.norm(model.cloud.points[model.cloud.group("tool")], axis=1)
    assert held.max() <= RADIUS * (1 + 1e-9)
    assert set(model.tension(np.zeros((len(model.cloud), 3)))) == {2}
    expected = 2 * 0.17e6 * (1.2**2 - 1.2**-4)
    np.testing.assert_allclose(model.principal_stress(np.zeros((len(model.cloud), 3))), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "value"),
    [("spacing", 0.06), ("prestretch", 0.9), ("training.duration", 0.0), ("training.duration", 11.0),
     ("training.every", 2.0)],
)  # fmt: skip
def test_values_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(pt.InputError, match=f"^{name} must .*, got"):
        _ = open_scene("membrane", {name: value}).body


def test_the_path_of_the_beam_is_smooth_and_starts_and_ends_at_rest(beam):
    hand = beam.held_motion(3, 0.4)
    for time in (0.0, 0.4, 0.8):
        moved, quaternion = hand(time)
        np.testing.assert_allclose(moved, 0.0, atol=1e-15)
        np.testing.assert_allclose(np.abs(quaternion), [1, 0, 0, 0], atol=1e-15)
    near = np.array([hand(1e-4)[0], hand(2e-4)[0]])
    np.testing.assert_allclose(near[1], 4 * near[0], rtol=1e-4)  # its speed is zero there
    assert np.linalg.norm(hand(0.13)[0]) > 1e-3


def test_held_out_motions_of_a_held_group_are_those_of_a_hand(beam):
    """They have some 60 poses a second, are within the swings, and are longer than smooth ones."""
    training, ends = beam.description.training, []
    for seed in range(500_000, 500_020):
        (load,), duration = beam.paths(seed)
        assert duration == pytest.approx(0.6)
        hand = held_motion(training, seed, duration, by_hand=True)
        times, _ = hand.knots
        assert np.all(np.diff(times) >= 0.0)
        assert times[-1] >= duration
        assert 25 < len(np.unique(times)) / 2 < 45  # some 60 poses a second, each with a start and an end
        moved = np.array([hand.pose(time)[0] for time in np.arange(0.0, duration, 1e-3)])
        assert np.all(moved >= np.minimum(training.low, 0.0) - 1e-12)
        assert np.all(moved <= np.maximum(training.high, 0.0) + 1e-12)
        ends.append(np.linalg.norm(moved[-1]) / np.linalg.norm(moved, axis=1).max())
        points = beam.cloud.points[beam.cloud.group("x+")]
        centre = load.displacement(points, 0.1).mean(axis=0)
        np.testing.assert_allclose(centre, hand.pose(0.1)[0], atol=1e-12)
    assert 1 <= sum(end < 1e-9 for end in ends) <= 10  # some return
    assert len(beam.paths(3)[0]) == 1
    assert beam.paths(3)[1] == training.duration


def test_the_load_of_a_held_group_is_the_rigid_motion_of_its_pose(beam, bar):
    hand, nodes = beam.held_motion(5, 0.4), bar.group("x+")
    points, centre = bar.points[nodes], bar.points[nodes].mean(axis=0)
    displacement = hand.load(bar, "x+").displacement
    assert callable(displacement)
    placed = points + displacement(points, 0.17)
    moved, (w, *v) = hand(0.17)
    arms = points - centre
    turned = arms + 2 * np.cross(v, np.cross(v, arms) + w * arms)
    np.testing.assert_allclose(placed, centre + moved + turned, atol=1e-12)


def test_swings_without_size_are_refused():
    for low, high in ((["1 mm", 0, 0], [0, 0, 0]), ([0, 0, 0], [0, 0, 0])):
        still = {"low": low, "high": high, "low_turn": [0, 0, 0], "high_turn": [0, 0, 0]}
        with pytest.raises(pt.InputError, match=r"low of \[training\] must be at most high, and not all 0"):
            _ = open_scene("beam", still).paths
