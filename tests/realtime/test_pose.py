"""Poses move no faster than allowed, and the wrench is conjugate to them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.realtime.period import IGNORE, LARGEST_WAY, MAX_PERIODS, Settings, Work, move_tools, take_pose
from palpate.realtime.pose import IDENTITY_POSE, follow_pose, normalise_pose, tool_coordinates, wrench


def pose_of(position, rotation):
    return np.concatenate([position, np.roll(rotation.as_quat(), 1)])


def rotation_of(pose):
    return Rotation.from_quat(np.roll(pose[3:], -1))


@pytest.fixture
def random():
    return np.random.default_rng(7)


def test_tool_coordinates_are_those_of_the_rigid_motion(random):
    tool = random.normal(size=(5, 12))
    pose = pose_of(random.normal(size=3), Rotation.random(random_state=3))
    out = np.empty(5)
    tool_coordinates(tool[None], pose[None], out)
    turned = rotation_of(pose).as_matrix() - np.eye(3)
    np.testing.assert_allclose(out, tool @ np.concatenate([pose[:3], turned.ravel()]), atol=1e-13)


def test_the_wrench_does_the_work_of_the_generalised_forces(random):
    """The tool's power on the body is the same in both: forces . d(coordinates) = -(force . d + moment . theta)."""
    tool, forces = random.normal(size=(5, 12)), random.normal(size=5)
    pose = pose_of(random.normal(size=3), Rotation.random(random_state=5))
    force, moment, before, after = np.empty(3), np.empty(3), np.empty(5), np.empty(5)
    wrench(tool, pose, forces, force, moment)
    way, turn = 1e-6 * random.normal(size=(2, 3))
    for side, out in ((-1, before), (1, after)):
        moved = pose_of(pose[:3] + side * way, Rotation.from_rotvec(side * turn) * rotation_of(pose))
        tool_coordinates(tool[None], moved[None], out)
    assert forces @ (after - before) == pytest.approx(-2 * (force @ way + moment @ turn), rel=1e-8)


def test_a_followed_pose_keeps_both_speed_limits_and_arrives(random):
    max_distance, max_angle = 0.002, 0.01
    pose, aim = IDENTITY_POSE.copy(), pose_of([0.03, -0.01, 0.02], Rotation.from_rotvec([0.3, -1.0, 0.2]))
    aim[3:] *= -1  # the same rotation
    path = [pose.copy()]
    while len(path) < 200 and not np.array_equal(pose, aim):
        follow_pose(pose, aim, max_distance, max_angle, 1.0)
        path.append(pose.copy())
    ways = np.linalg.norm(np.diff([p[:3] for p in path], axis=0), axis=1)
    angles = [(rotation_of(b) * rotation_of(a).inv()).magnitude() for a, b in pairwise(path)]
    assert ways.max() <= max_distance * (1 + 1e-12)
    assert max(angles) <= max_angle * (1 + 1e-7)
    total = np.linalg.norm([0.3, -1.0, 0.2]), np.linalg.norm(aim[:3])
    assert len(path) - 1 == np.ceil(max(total[0] / max_angle, total[1] / max_distance))  # straight there
    np.testing.assert_allclose(np.linalg.norm([p[3:] for p in path], axis=1), 1.0, rtol=1e-12)


def test_a_near_pose_is_reached_exactly_in_one_period(random):
    pose = IDENTITY_POSE.copy()
    aim = pose_of([1e-4, 0.0, -1e-4], Rotation.from_rotvec([1e-3, 0.0, 0.0]))
    follow_pose(pose, aim, 0.002, 0.01, 1.0)
    assert np.array_equal(pose, aim)


def test_a_pose_is_reached_evenly_in_a_number_of_periods():
    pose, aim = IDENTITY_POSE.copy(), pose_of([0.008, 0.0, -0.004], Rotation.from_rotvec([0.1, 0.0, 0.2]))
    ways, angles = [], []
    for left in (5.0, 4.0, 3.0, 2.0, 1.0):
        before = pose.copy()
        follow_pose(pose, aim, 1.0, 1.0, left)
        ways.append(np.linalg.norm(pose[:3] - before[:3]))
        angles.append((rotation_of(pose) * rotation_of(before).inv()).magnitude())
    np.testing.assert_allclose(ways, np.linalg.norm(aim[:3]) / 5, rtol=1e-9)
    np.testing.assert_allclose(angles, np.linalg.norm([0.1, 0.2]) / 5, rtol=1e-6)
    assert np.array_equal(pose, aim)


def test_a_tool_follows_a_pointer_as_fast_as_the_pointer_moves():
    """Poses come every 17 periods; at the largest speed the tool would make each way in two periods, and wait."""
    work = Work.at_rest(np.zeros(3), np.eye(3, 12))
    work.follow[0, MAX_PERIODS] = 40.0
    settings = Settings(1_000_000, 0, 5e-4, 0.01, np.inf, 0, IGNORE, 0)
    ways = []
    for period in range(340):
        if period % 17 == 0:  # 50 mm/s
            take_pose(work, 0, np.array([50e-6 * (period + 17), 0, 0, 1, 0, 0, 0]))
        before = work.pose[0, 0]
        move_tools(work, settings)
        ways.append(work.pose[0, 0] - before)
    assert np.ptp(ways[34:]) < 1e-12
    assert ways[-1] == pytest.approx(50e-6)
    work.follow[0, LARGEST_WAY] = 30e-6  # slower than the pointer
    take_pose(work, 0, np.array([0.0, 0, 0, 1, 0, 0, 0]))
    move_tools(work, settings)
    assert work.pose[0, 0] == pytest.approx(340 * 50e-6 - 30e-6)


def test_a_half_turn_is_followed(random):
    pose, aim = IDENTITY_POSE.copy(), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    for _ in range(4):
        follow_pose(pose, aim, 1.0, np.pi / 4, 1.0)
    assert abs(pose[3:] @ aim[3:]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("position", "quaternion", "said"),
    [
        ((np.nan, 0, 0), (1, 0, 0, 0), "finite"),
        ((0, 0, 0), (1, 0, np.inf, 0), "finite"),
        ((0, 0, 0), (0, 0, 0, 0), "must be non-zero"),
        ((0, 1.01, 0), (1, 0, 0, 0), "got a jump of 1.01 m"),
        ((0, 0), (1, 0, 0, 0), "position must be 3 real numbers"),
        ((0, 0, 0), (1, 0, 0), "quaternion must be 4 real numbers"),
        (("0", "0", "0"), (1, 0, 0, 0), "real numbers"),
        ("abc", (1, 0, 0, 0), "real numbers, got 'abc'"),
        ((0, 0, 1j), (1, 0, 0, 0), "real numbers"),
        ((0, 0, 0), np.array([1, 0, 0, 0], dtype=complex), "real numbers"),
        ((0, 0, None), (1, 0, 0, 0), "real numbers"),
        ((0, 0, [0]), (1, 0, 0, 0), "real numbers"),
        ((0, 0, 10**400), (1, 0, 0, 0), "real numbers"),
    ],
)
def test_a_bad_pose_is_refused(position, quaternion, said):
    with pytest.raises(pt.InputError, match=said):
        normalise_pose(position, quaternion, IDENTITY_POSE)


@pytest.mark.parametrize("size", [1e-200, 3.0, 1e200])
def test_quaternions_are_normalised(size):
    pose = normalise_pose((0.1, 0.2, 0.3), (0.0, 0.6 * size, 0.0, -0.8 * size), IDENTITY_POSE)
    np.testing.assert_allclose(pose, [0.1, 0.2, 0.3, 0.0, 0.6, 0.0, -0.8], rtol=1e-14)
