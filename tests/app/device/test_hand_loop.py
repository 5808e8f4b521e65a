"""What happens at each message, with a clock of the test: limit, ramp, age, clutch, and devices that come and go."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palpate.app.device.force import RAMP_SECONDS
from palpate.app.device.hand_loop import GONE_SECONDS, MAX_LINES, HandLoop
from palpate.app.device.options import DeviceOptions
from palpate.app.device.service import Grip, ServiceState

STIFFNESS, INTERVAL = 500.0, 1e-3  # [N/m] of a wall below z = 0, [s]


class Rig:
    """A loop with a wall that answers its poses, and a hand at a height [m]; `force` is on the hand."""

    def __init__(self, **options):
        self.answers = []
        self.loop = HandLoop(DeviceOptions(**options), 2, self.answers.append)
        self.now, self.steps, self.epoch, self.height, self.clutch = 0.0, 0, 1, 0.0, False
        self.tool, self.running, self.stalled, self.deaf = np.array([0.0, 0.0, -2e-3]), True, False, False

    def step(self, count=1, names=("A",)):
        for _ in range(count):
            self.now += INTERVAL
            state = ServiceState(dict.fromkeys(names, (0.0, 0.0, self.height)), {}, (Grip(None, self.clutch),))
            self.force = np.array(self.loop.forces(state, self.now).get("A", [0.0] * 3))
            while self.answers and not self.deaf:
                self.answer(self.answers.pop(0))
        return self.force[2]

    def move_to(self, height):
        """Move the hand at 1 m/s."""
        while abs(height - self.height) > 1e-9:
            self.height += float(np.clip(height - self.height, -INTERVAL, INTERVAL))
            self.step()
        return self.step()

    def answer(self, message):
        for index, epoch, pose in message.get("poses", []):
            if index == 0 and pose is not None and epoch == self.epoch:
                self.tool = np.array(pose[0])
        if "poses" in message:
            self.steps += not self.stalled
            depth = max(-self.tool[2], 0.0)
            contact = {
                "steps": self.steps, "running": self.running, "epoch": self.epoch, "bonded": False,
                "force": [0.0, 0.0, STIFFNESS * depth], "position": self.tool.tolist(), "quaternion": [1.0, 0, 0, 0],
                "stiffness": [0.0] * 8 + [STIFFNESS if depth else 0.0],
            }  # fmt: skip
            self.loop.receive({"period": INTERVAL, "tools": [contact, contact]}, self.now)


def test_the_force_is_ramped_in_to_that_of_the_body_within_its_limit():
    rig = Rig()
    assert rig.step(3) < 0.01
    seen = [rig.step() for _ in range(600)]
    assert np.diff(seen).max() <= STIFFNESS * 2e-3 * INTERVAL / RAMP_SECONDS * (1 + 1e-9)
    assert np.diff(seen).min() >= 0.0
    assert seen[-1] == pytest.approx(STIFFNESS * 2e-3)
    limited = Rig(device_limit=0.4)
    limited.step(600)
    assert np.linalg.norm(limited.force) == pytest.approx(0.4)


@pytest.mark.parametrize("deaf", [False, True])
def test_the_force_is_zero_within_20_ms_of_the_last_period_of_an_engine(deaf):
    rig = Rig()
    rig.step(600)
    assert rig.force[2] > 0.9
    rig.stalled, rig.deaf = not deaf, deaf  # the same reading again and again, or none
    felt = [rig.step() for _ in range(40)]
    last = max(k for k, force in enumerate(felt) if force > 0) + 1
    assert 10 <= last <= 15
    rig.stalled = rig.deaf = False
    rig.step(3)
    assert rig.step() < 0.02  # the ramp begins again
    assert rig.step(600) == pytest.approx(STIFFNESS * 2e-3)


def test_a_paused_engine_gives_no_force_at_once():
    rig = Rig()
    rig.step(600)
    rig.running = False
    rig.step()
    assert rig.step() == 0.0


def test_a_clutch_frees_the_hand_and_leaves_the_tool():
    rig = Rig()
    rig.step(600)
    rig.clutch = True
    assert rig.step() == 0.0
    rig.height = 0.1
    assert rig.step(100) == 0.0
    assert rig.tool[2] == pytest.approx(-2e-3)
    rig.clutch = False
    rig.step(2)
    assert rig.tool[2] == pytest.approx(-2e-3)
    rig.height = 0.101
    rig.step(600)
    assert rig.force[2] == pytest.approx(STIFFNESS * 1e-3, rel=1e-3)


def test_another_tool_is_moved_from_where_it_is_and_poses_for_the_former_are_marked():
    rig = Rig()
    rig.step(600)
    rig.move_to(-0.05)
    rig.epoch, rig.tool = 2, np.array([0.3, 0.0, 0.2])
    assert rig.step(5) == 0.0
    np.testing.assert_allclose(rig.tool, [0.3, 0.0, 0.2])
    rig.move_to(-0.04)
    np.testing.assert_allclose(rig.tool, [0.3, 0.0, 0.21])


def test_a_device_without_state_has_no_force_and_is_gone_after_a_while():
    rig = Rig()
    rig.step(600)
    rig.step(1, names=())
    assert not rig.force.any()
    assert rig.loop.channels  # zero is sent to it
    rig.step(round(GONE_SECONDS / INTERVAL) + 2, names=())
    assert not rig.loop.channels
    where = rig.tool.copy()
    rig.height = 0.2
    rig.step(5)
    np.testing.assert_allclose(rig.tool, where)  # it goes on from there
    assert rig.step() < 0.02


def test_the_account_pays_for_what_goes_out():
    rig = Rig()
    rig.step(600)
    rig.loop.passivity.energy = 0.0
    rig.height += 1e-3  # in 1 ms the hand received 1 N over 1 mm, which it never gave
    rig.step()
    assert rig.loop.passivity.energy == pytest.approx(-1e-3, rel=1e-6)


def test_lines_are_bounded_however_many_devices_come():
    said = []
    loop = HandLoop(DeviceOptions(), 2, said.append)
    for k in range(3000):
        names = [f"D{k}{letter}" for letter in "abcd"]
        loop.forces(ServiceState(dict.fromkeys(names, (0.0, 0.0, 0.0))), float(k))
    assert sum("say" in message for message in said) == MAX_LINES
    assert len(loop.channels) == 2
    for held in (loop._assigned, loop._refused, loop._lines):
        assert len(held) <= max(MAX_LINES, 64)


def test_states_at_one_time_or_after_a_long_one_give_finite_forces():
    rig = Rig()
    rig.step(600)
    for jump in (0.0, 1e-9, 10.0):
        rig.now += jump - INTERVAL
        rig.height += 0.01
        assert math.isfinite(rig.step())
