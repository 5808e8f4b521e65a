"""Statistics of hands: sums over messages and adapters, and the report of a run."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from palpate.app.device.hand_loop import HandLoop
from palpate.app.device.options import DeviceOptions
from palpate.app.device.service import Grip, ServiceState
from palpate.app.device.statistics import (
    CLUTCH_PRESSED,
    NO_CONTACT,
    HandStatistics,
    add_statistics,
    hand_reports,
    tool_name,
)

INTERVAL, FORCE = 2e-3, 1.5  # [s], [N]


def test_tools_count_from_one():
    assert [tool_name(k) for k in range(3)] == ["tool 1", "tool 2", "tool 3"]


def test_statistics_of_two_adapters_are_added():
    total = {}
    first = HandStatistics(0, 1.0, 500, 2.0, 0.5, 1, 3, 0.2, 0.1, 0.0, {"clutch": 0.5})
    second = HandStatistics(0, 2.0, 700, 1.0, 0.25, 2, 0, 0.1, 0.0, 0.3, {"clutch": 0.25, "no contact": 1.0})
    add_statistics(total, {"A": asdict(first)})
    add_statistics(total, {"A": asdict(second), "B": asdict(HandStatistics(1))})
    whole = HandStatistics(
        0, 3.0, 1200, 2.0, 0.75, 3, 3, total["A"].ramped, 0.1, 0.3, {"clutch": 0.75, "no contact": 1.0}
    )
    assert total["A"] == whole
    assert total["A"].ramped == pytest.approx(0.3)
    reports = hand_reports(total)
    assert list(reports) == ["tool 1", "tool 2"]
    assert reports["tool 1"]["rate"] == pytest.approx(400.0)
    assert reports["tool 1"]["with_force"] == pytest.approx(1.25)
    assert reports["tool 1"]["mean_force"] == pytest.approx(0.6)
    assert list(reports["tool 1"]["without_force"]) == ["no contact", "clutch"]
    assert reports["tool 2"]["rate"] is None
    assert reports["tool 2"]["mean_force"] is None


def test_two_devices_that_moved_one_tool_are_both_reported():
    reports = hand_reports({"A": HandStatistics(0, 1.0, 10), "B": HandStatistics(0, 2.0, 10)})
    assert list(reports) == ["tool 1 (A)", "tool 1 (B)"]


def test_times_and_forces_of_a_press_with_a_clutch_are_counted():
    total, poses = {}, []

    def take(answer):
        poses.extend(answer.get("poses", []))
        add_statistics(total, answer.get("hands", {}))

    loop = HandLoop(DeviceOptions(device_limit=FORCE), 1, take)
    for k in range(1000):
        pressed, clutch = 100 <= k < 900, 800 <= k < 900
        contact = {
            "steps": k, "running": True, "epoch": 1, "bonded": False, "force": [0.0, 0.0, 2.0 if pressed else 0.0],
            "stiffness": [0.0] * 9, "position": [0.0, 0.0, 0.0], "quaternion": [1.0, 0.0, 0.0, 0.0],
        }  # fmt: skip
        loop.receive({"period": INTERVAL, "tools": [contact]}, k * INTERVAL)
        state = ServiceState({"A": (0.0, 0.0, 0.0)}, {}, (Grip(None, clutch),))
        loop.forces(state, k * INTERVAL)
    loop.close()
    hand = total["A"]
    assert hand.messages == 999  # the first one has no time before it
    assert hand.seconds == pytest.approx(999 * INTERVAL)
    assert (hand.clutches, hand.interruptions) == (1, 0)
    assert hand.peak_force == pytest.approx(FORCE)
    assert hand.limited == pytest.approx(700 * INTERVAL, abs=3 * INTERVAL)  # a force of 2 N
    assert hand.without_force[CLUTCH_PRESSED] == pytest.approx(100 * INTERVAL, abs=2 * INTERVAL)
    assert hand.without_force[NO_CONTACT] == pytest.approx(199 * INTERVAL, abs=5 * INTERVAL)
    ramp = np.arange(100, 250) * INTERVAL / 0.5  # the contact begins 0.2 s after the ramp
    impulse = FORCE * INTERVAL * (ramp.sum() + 550)
    assert hand.impulse == pytest.approx(impulse, rel=0.01)
    assert hand.ramped == pytest.approx(150 * INTERVAL, abs=3 * INTERVAL)
