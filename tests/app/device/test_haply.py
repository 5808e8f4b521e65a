"""The adapter against an emulated service: what the hand feels, and that nothing is felt when anything fails."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.slow

START, STIFFNESS, HAND_STIFFNESS = 0.004, 300.0, 200.0  # [m], [N/m] of the wall and the hand, as in emulated_hand.py


def size(device):
    return math.hypot(*device.force)


def rests(device):
    return math.hypot(*device.velocity) < 1e-3


def pressed(service, wall, until, down=0.014, k=0):
    """Press, and wait for the whole force: hand and wall are two springs."""
    index = next((int(i) for i, name in wall.devices.items() if name == service.devices[k].name), 0)
    until(lambda: index in wall.poses)  # the hand is where it was at first
    device = service.devices[k]
    for depth in np.linspace(0.0, down, 50):  # slowly: a step between two late messages would be a jump
        service.move(depth, k)
        messages = len(device.log) + 3
        until(lambda: len(device.log) > messages)  # noqa: B023, it is called before the next round
    whole = (down - START) * STIFFNESS * HAND_STIFFNESS / (STIFFNESS + HAND_STIFFNESS)
    until(lambda: abs(size(device) - whole) < 0.02 * whole and rests(device), lambda: (device.force, wall.said))
    return whole


@pytest.mark.quick
def test_a_hand_moves_the_tool_and_feels_the_wall(service_of, wall_of, until):
    service = service_of("049D")
    wall = wall_of(service)
    pressed(service, wall, until)
    assert wall.devices == {"0": "049D"}
    assert wall.said == ["049D moves tool 1"]
    device = service.devices[0]
    until(lambda: wall.poses[0][0][2] - START == pytest.approx(device.position[2] - 0.15, abs=5e-5))
    until(lambda: device.force[2] == pytest.approx(-STIFFNESS * wall.poses[0][0][2], rel=0.01))
    assert device.force[:2] == [0.0, 0.0]
    first = next(force[2] for _, force, _ in device.log if force[2] > 0)
    assert first < 0.6 * device.force[2]  # the force is ramped in


def test_displacements_and_forces_are_scaled_and_turned(service_of, wall_of, until):
    service = service_of("049D")  # y of the device is along z of the body
    wall = wall_of(service, device_scale=2.0, device_force=0.5, device_axes="-XZY")
    until(lambda: 0 in wall.poses)
    device = service.devices[0]
    device.target = service.hand([0.003, -0.12 - 0.01, 0.15])
    until(lambda: abs(device.force[1]) > 0.5)
    until(lambda: abs(200 * (-0.13 - device.position[1]) + device.force[1]) < 0.02 and rests(device))
    until(lambda: wall.poses[0][0][2] - START == pytest.approx(2 * (device.position[1] + 0.12), abs=1e-4))
    until(lambda: device.force[1] == pytest.approx(-0.5 * STIFFNESS * wall.poses[0][0][2], rel=0.02))
    until(lambda: wall.poses[0][0][0] == pytest.approx(-0.006, abs=1e-4))


@pytest.mark.quick
def test_the_force_has_a_limit(service_of, wall_of, until):
    service = service_of("049D")
    wall = wall_of(service, device_limit=0.8)
    until(lambda: 0 in wall.poses)
    service.move(0.03)
    device = service.devices[0]
    until(lambda: size(device) == pytest.approx(0.8, rel=1e-6) and -STIFFNESS * wall.poses[0][0][2] > 2.0)
    assert max(math.hypot(*force) for _, force, _ in device.log) <= 0.8 * (1 + 1e-9)


def test_with_the_clutch_the_hand_is_free_and_the_tool_stays(service_of, wall_of, until):
    service = service_of("049D")
    wall = wall_of(service)
    whole = pressed(service, wall, until)
    device = service.devices[0]
    device.buttons["b"] = True
    until(lambda: size(device) == 0.0)
    where = wall.poses[0][0].copy()
    service.move(-0.02)
    until(lambda: abs(device.position[2] - 0.17) < 1e-4 and rests(device))  # not where it turns: it swings about 0.17
    np.testing.assert_allclose(wall.poses[0][0], where, atol=1e-4)
    assert size(device) == 0.0
    began = len(device.log)
    device.buttons["b"] = False
    until(lambda: size(device) > 0.3)  # from where the hand is now the tool presses as before
    felt = [force[2] for _, force, _ in device.log[began:]]
    assert next(force for force in felt if force != 0) < 0.6 * whole
    assert min(felt) > -1.0 - 1e-9  # of the controller, on a hand that leaves


def test_the_grip_turns_the_tool(service_of, wall_of, until):
    service = service_of("049D")
    wall = wall_of(service, device_axes="XZ-Y")
    until(lambda: 0 in wall.poses)
    service.devices[0].orientation = [math.cos(0.3), 0.0, 0.0, math.sin(0.3)]  # about z of the device
    expected = [math.cos(0.3), 0.0, math.sin(0.3), 0.0]  # y of the body
    until(lambda: np.allclose(wall.poses[0][1], expected, atol=1e-9), lambda: wall.poses[0][1])


@pytest.mark.quick(silent=[True])
@pytest.mark.parametrize("silent", [False, True])
def test_an_engine_that_stalls_lets_the_hand_go(service_of, wall_of, until, silent):
    service = service_of("049D")
    wall = wall_of(service)
    whole = pressed(service, wall, until)
    device = service.devices[0]
    wall.stalled, wall.silent = True, silent
    until(lambda: size(device) == 0.0)
    assert service.emulator.connections == 1
    if not silent:
        wall.stalled = False
        until(lambda: abs(size(device) - whole) < 0.02 * whole)


def test_a_socket_that_closes_is_opened_again(service_of, wall_of, until):
    service = service_of("049D")
    wall = wall_of(service)
    whole = pressed(service, wall, until)
    device = service.devices[0]
    service.close_sockets()
    until(lambda: service.emulator.connections == 2 and "0" in wall.devices)
    until(lambda: abs(size(device) - whole) < 0.05 * whole)
    assert any(text.endswith("closed the connection (no close frame)") for text in wall.said)
    assert wall.said[-1] == "049D moves tool 1 again"


@pytest.mark.quick
def test_a_service_that_does_not_answer_gets_no_force(service_of, wall_of, until):
    service = service_of("049D")
    wall = wall_of(service)
    pressed(service, wall, until)
    device = service.devices[0]
    service.emulator.muted = True
    until(lambda: size(device) == 0.0)
    service.emulator.muted = False
    depths = iter(np.arange(0.014, 0.1, 1e-5))

    def is_pressed():  # deeper and deeper: without its force the hand has moved on, and continues from the tool
        service.move(next(depths))
        return size(device) > 0.3

    until(is_pressed)


def test_a_killed_adapter_leaves_no_force(service_of, wall_of, until):
    service = service_of("049D")
    wall = wall_of(service)
    pressed(service, wall, until)
    os.kill(wall.child.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
    until(lambda: size(service.devices[0]) == 0.0)
    assert not service.emulator.sockets


RIG = Path(__file__).parents[3] / "validation" / "emulated_hand.py"


@pytest.mark.quick
def test_a_killed_session_leaves_no_force(service_of, until):
    service = service_of("049D")
    with subprocess.Popen([sys.executable, str(RIG), str(service.port)]) as parent:
        device = service.devices[0]
        until(lambda: len(device.log) > 100)
        service.move(0.014)
        until(lambda: size(device) > 0.1)
        parent.kill()
    until(lambda: size(device) == 0.0)
    until(lambda: not service.emulator.sockets)


def test_two_hands_have_a_tool_each(service_of, wall_of, until):
    service = service_of("L001", "R002")
    wall = wall_of(service, tools=2)
    until(lambda: wall.devices == {"0": "R002", "1": "L001"})
    pressed(service, wall, until, k=0)
    assert size(service.devices[1]) == 0.0
    assert wall.poses[1][0][2] < 0.0 < wall.poses[0][0][2]
    assert wall.poses[1][0][0] == pytest.approx(0.1, abs=1e-9)
    assert set(wall.said) == {"R002 moves tool 1", "L001 moves tool 2"}


def test_of_sixteen_devices_those_without_a_tool_are_named(service_of, wall_of, until):
    service = service_of(*(f"D{k:03d}" for k in range(16)))
    wall = wall_of(service, tools=2)
    until(lambda: wall.devices == {"0": "D000", "1": "D001"})
    until(lambda: len(wall.said) == 16)
    assert sum(text.endswith("is left out: devices move 2 tools at most") for text in wall.said) == 14


def test_a_device_that_returns_has_its_tool_again(service_of, wall_of, until):
    service = service_of("R001", "L002")
    wall = wall_of(service, tools=2)
    pressed(service, wall, until, k=0)
    gone, device = wall.poses[0][0].copy(), service.devices[0]
    device.present = False
    until(lambda: wall.devices == {"1": "L002"})
    assert "R001 is gone: tool 1 stays where it is" in wall.said
    device.set_force([0.0] * 3)
    device.present = True
    until(lambda: wall.devices == {"0": "R001", "1": "L002"})
    assert "R001 moves tool 1 again" in wall.said
    until(lambda: size(device) > 0.3)
    assert wall.poses[0][0][2] <= gone[2] + 5e-3
    assert service.emulator.connections == 1


def test_a_device_that_comes_later_has_the_tool_of_its_hand(service_of, wall_of, until):
    service = service_of("R001", "L002")
    service.devices[0].present = False
    wall = wall_of(service, tools=2)
    until(lambda: wall.devices == {"0": "L002"})
    service.devices[0].present = True
    until(lambda: wall.devices == {"0": "L002", "1": "R001"})


def replaced(**values):
    """A disguise that changes values of the first device's state."""

    def disguise(text):
        message = json.loads(text)
        message["inverse3"][0]["state"] |= values
        return json.dumps(message)

    return disguise


DAMAGES = {
    "not JSON": (lambda text: text[:40], "must be JSON"),
    "binary": (lambda text: text.encode(), "must be text"),
    "a list": (lambda text: "[]", "must be a JSON object"),
    "deep": (lambda text: "[" * 30_000, "must be JSON"),
    "no position": (replaced(cursor_position=None), "cursor_position of 049D must be"),
    "far away": (replaced(cursor_position={"x": 1e30, "y": 0, "z": 0}), "within 2 m"),
    "not finite": (replaced(cursor_position={"x": math.nan, "y": 0, "z": 0}), "cursor_position of 049D must be"),
    "17 devices": (lambda text: json.dumps({"inverse3": [{}] * 17}), "at most 16 devices"),
    "too long": (lambda text: '"' + "x" * 100_000 + '"', "closed the connection (1009"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damaged_messages_take_the_force_away_and_are_named_in_a_line(service_of, wall_of, until, name):
    service = service_of("049D")
    wall = wall_of(service)
    pressed(service, wall, until)
    device, (disguise, words) = service.devices[0], DAMAGES[name]
    service.emulator.disguise = disguise
    until(lambda: size(device) == 0.0)
    until(lambda: any(words in text for text in wall.said), lambda: wall.said)
    assert sum(words in text for text in wall.said) == 1
    assert all("\n" not in text and len(text) < 300 for text in wall.said)
    service.emulator.disguise = None
    until(lambda: size(device) > 0.3, lambda: wall.said)


def test_two_devices_of_one_name_are_one(service_of, wall_of, until):
    service = service_of("A", "A")
    wall = wall_of(service, tools=2)
    until(lambda: wall.devices == {"0": "A"})
    until(lambda: any("device_id must be of one device, got 'A' twice" in text for text in wall.said))


def test_without_a_service_a_line_says_so_once(wall_of, until):
    class Nothing:
        port = 9  # discard

    wall = wall_of(Nothing)
    until(lambda: len(wall.said) == 1)
    assert wall.said[0].startswith("no service at ws://localhost:9 (")
    assert wall.said[0].endswith("start the Haply Inverse Service")


def test_a_device_that_is_calibrated_after_the_start_moves_its_tool_then(service_of, wall_of, until):
    service = service_of("049D")
    device = service.devices[0]
    service.emulator.calibrate(False)
    device.target, device.position = service.hand([0.0, 0.0, 0.0]), [0.0, 0.0, 0.0]
    wall = wall_of(service)
    until(lambda: len(device.log) > 50)
    assert wall.said == [
        "049D is not calibrated: calibrate it, as Haply Hub shows; until then tool 1 stays, and the hand has no force"
    ]
    assert not wall.poses
    assert not wall.devices
    device.position, device.target = [0.0, -0.12, 0.15], service.hand([0.0, -0.12, 0.15])
    service.emulator.calibrate()
    until(lambda: 0 in wall.poses)
    assert wall.poses[0][0] == pytest.approx([0.0, 0.0, START], abs=1e-3)
    until(lambda: wall.said[-1] == "049D moves tool 1")
    pressed(service, wall, until)


def test_the_statistics_of_a_hand_say_why_it_has_no_force(service_of, wall_of, until):
    service = service_of("049D")
    wall = wall_of(service)
    until(lambda: 0 in wall.poses)
    depths = iter(np.arange(0.0, 0.1, 1e-4))

    def is_pressed():
        service.move(next(depths))
        return size(service.devices[0]) > 0.2

    until(is_pressed)
    service.devices[0].buttons["b"] = True
    until(lambda: "049D" in wall.hands and wall.hands["049D"].without_force.get("clutch", 0.0) > 0.1)
    hand, log = wall.hands["049D"], service.devices[0].log
    assert hand.clutches == 1
    assert hand.peak_force == pytest.approx(max(math.hypot(*force) for _, force, _ in log), rel=1e-6)
    assert 0 < hand.messages <= len(log) + 1
    assert sum(hand.without_force.values()) < hand.seconds
    assert 0.0 < hand.ramped < hand.seconds
