"""The map of a hand's motion to that of a tool: a rotation and a scale, which keep the power."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.app.device.hand import Anchor, HandMap
from palpate.app.device.options import axes_rotation


def rotate(q, v):
    return Rotation.from_quat(q, scalar_first=True).apply(v)


@pytest.mark.parametrize("axes", ["XYZ", "XZ-Y", "-XZY", "ZXY", "-X-YZ", "X-Y-Z"])
def test_axes_are_those_of_a_rotation(axes):
    rotation = np.array(axes_rotation(axes))
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    motion = HandMap(1.0, rotation)
    turn = np.array([np.cos(0.4), 0.0, np.sin(0.4), 0.0])  # about y of the device
    no_turn = np.array([1.0, 0.0, 0.0, 0.0])
    tool = motion.quaternion(Anchor(np.zeros(3), no_turn, np.zeros(3), no_turn), turn)
    for v in np.eye(3):  # a turn in the frame of the body is that of the hand in its own
        np.testing.assert_allclose(rotate(tool, rotation @ v), rotation @ rotate(turn, v), atol=1e-12)


def test_the_power_of_the_hand_is_that_of_the_tool():
    motion = HandMap(2.0, axes_rotation("XZ-Y"))
    anchor = Anchor(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([1.0, 0, 0, 0]))
    step, force = np.array([1.0, 2.0, 3.0]), np.array([0.3, -0.2, 0.5])
    tool_step = motion.position(anchor, step)
    assert force @ tool_step == pytest.approx(2.0 * motion.force_on_hand(force) @ step)
    stiffness = np.diag([1.0, 10.0, 100.0])
    np.testing.assert_allclose(motion.stiffness_at_hand(stiffness) @ step, motion.force_on_hand(stiffness @ tool_step))
