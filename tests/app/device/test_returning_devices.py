"""Devices that are not ready, jump, or return: they move nothing, have no force, and the tool never jumps."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from palpate.app.device.hand_loop import GONE_SECONDS, HandLoop
from palpate.app.device.options import DeviceOptions
from palpate.app.device.service import parse_state

INTERVAL, STIFFNESS = 1e-3, 500.0  # [s], [N/m] of a wall below z = 0
HIGH, LOW = (0.0, -0.12, 0.15), (0.0, 0.0, 0.0)  # [m]: a hand at its device, and what a device says before it is ready
READY = {"calibrated": True, "in_use": True, "power_supply": True, "ready": True, "started": True}
TURNED = {"w": math.cos(0.5), "x": 0.0, "y": 0.0, "z": math.sin(0.5)}


def entry(name, place=HIGH, status=READY, **more):
    """Return the entry of a device in a message of the service."""
    place = dict(zip("xyz", place, strict=True)) if isinstance(place, tuple) else place
    fields = {"device_id": name, "state": {"cursor_position": place}} | more
    return fields if status is None else fields | {"status": status}


class Rig:
    """A loop whose poses a wall answers; `paths` are the poses of the tools at each message."""

    def __init__(self, tools=2, **options):
        self.loop = HandLoop(DeviceOptions(**options), tools, self.take)
        self.now, self.number, self.running = 0.0, 0, True
        self.said, self.devices, self.hands, self.asked = [], {}, [], False
        self.poses = [(np.array([0.1 * k, 0.0, -2e-3]), np.array([1.0, 0.0, 0.0, 0.0])) for k in range(tools)]
        self.paths, self.forces = [], []

    def take(self, answer):
        if "say" in answer:
            self.said.append(answer["say"])
        elif "devices" in answer:
            self.devices = answer["devices"]
        elif "hands" in answer:
            self.hands.append(answer["hands"])
        else:
            self.asked = True
            for index, _, pose in answer["poses"]:
                if pose is not None and str(index) in self.devices:
                    self.poses[index] = np.array(pose[0]), np.array(pose[1])

    def step(self, entries, count=1, interval=INTERVAL, grips=()):
        for _ in range(count):
            self.now += interval
            state = parse_state(json.dumps({"inverse3": entries, "wireless_verse_grip": list(grips)}))
            self.forces.append(self.loop.forces(state, self.now))
            self.paths.append([np.concatenate(pose) for pose in self.poses])
            if self.asked:
                self.asked, self.number = False, self.number + 1
                self.loop.receive({"period": INTERVAL, "tools": [self.contact(*pose) for pose in self.poses]}, self.now)
        return self.forces[-1]

    def contact(self, position, quaternion):
        depth = max(-position[2], 0.0)
        return {
            "steps": self.number, "running": self.running, "epoch": 1, "bonded": False, "selected": True,
            "force": [0.0, 0.0, STIFFNESS * depth], "stiffness": [0.0] * 8 + [STIFFNESS if depth else 0.0],
            "position": position.tolist(), "quaternion": quaternion.tolist(),
        }  # fmt: skip

    def largest_step(self, since=0):
        """Return the largest step [m] and change of a quaternion of a tool between two messages."""
        return np.abs(np.diff(np.array(self.paths[since:]), axis=0)).max()


NOT_READY = {
    "calibrated": ({"calibrated": False}, "is not calibrated: calibrate it"),
    "not known": ({"calibrated": None}, "is not calibrated"),
    "a number": ({"calibrated": 0}, "is not calibrated"),
    "a text": ({"calibrated": "false"}, "is not calibrated"),
    "nested": ({"calibration": {"calibrated": False}}, "is not calibrated"),
    "by joints": ({"calibrated": {"a": True, "b": False}}, "is not calibrated"),
    "no joints": ({"calibrated": []}, "is not calibrated"),
    "asleep": ({"awake": False}, "is asleep: wake it"),
    "sleeping": ({"is_asleep": True}, "is asleep: wake it"),
    "no power": ({"power_supply": False}, "has no power: connect"),
    "error": ({"error": True}, "is in error: see"),
    "errors": ({"errors": ["motor 2"]}, "is in error"),
    "text of an error": ({"error": "overheated"}, "is in error"),
    "not ready": ({"ready": False}, "is not ready"),
    "not started": ({"started": False}, "is not started"),
    "several": ({"ready": False, "calibrated": False}, "is not calibrated"),
}


@pytest.mark.parametrize("name", NOT_READY)
def test_a_device_that_is_not_ready_moves_nothing_feels_nothing_and_is_named_once(name):
    status, words = NOT_READY[name]
    rig = Rig()
    rig.step([entry("A", LOW, READY | status)], 300)
    assert rig.devices == {}
    assert rig.forces[-1] == {"A": [0.0, 0.0, 0.0]}  # sent, because the service answers only a message with a force
    assert rig.largest_step() == 0.0
    (line,) = rig.said
    assert line.startswith(f"A {words}")
    assert "until then tool 1 stays" in line
    rig.step([entry("A")], 600)
    assert rig.largest_step() == 0.0
    assert rig.said[1:] == ["A moves tool 1"]
    assert rig.devices == {"0": "A"}
    assert rig.forces[-1]["A"][2] == pytest.approx(STIFFNESS * 2e-3)


@pytest.mark.parametrize(
    "status",
    [
        None, {}, {"in_use": False}, {"calibrated": True}, {"error": None, "errors": []}, {"error": "none"},
        {"calibrated": 1}, {"calibrated": {"a": True}}, {"calibrated": "true"}, {"battery": 0, "firmware": "1.2"},
    ],
)  # fmt: skip
def test_a_device_without_a_stated_fault_moves_its_tool(status):
    rig = Rig()
    rig.step([entry("A", HIGH, status)], 3)
    rig.step([entry("A", (0.0, -0.12, 0.151), status)], 3)
    assert rig.poses[0][0][2] == pytest.approx(-1e-3)
    assert rig.said == ["A moves tool 1"]


def test_a_state_is_also_read_at_the_entry_and_in_its_state():
    for device in (entry("A", LOW, None, calibrated=False), entry("A", LOW, "booting", ready=False)):
        assert parse_state(json.dumps({"inverse3": [device]})).faults.keys() == {"A"}
    device = entry("A", LOW, None)
    device["state"]["calibrated"] = False
    assert parse_state(json.dumps({"inverse3": [device]})).positions == {}


@pytest.mark.parametrize("place", [None, {"x": None, "y": None, "z": None}, {"x": math.nan, "y": 0, "z": 0}, {}])
def test_a_position_without_meaning_is_not_read_before_calibration(place):
    rig = Rig()
    rig.step([entry("A", place, READY | {"calibrated": False})], 10)
    assert rig.said[0].startswith("A is not calibrated")
    state = parse_state(json.dumps({"inverse3": [entry("A", place, READY | {"calibrated": False})]}))
    assert state.notes == ()


@pytest.mark.parametrize("gap", [1, 30, round(GONE_SECONDS / INTERVAL) + 5])
def test_a_device_with_a_damaged_position_is_anchored_where_the_tool_is(gap):
    rig = Rig()
    rig.step([entry("A")], 600)
    rig.step([entry("A", {"x": math.nan, "y": 0, "z": None})], gap)
    assert rig.forces[-1].get("A", [0.0] * 3) == [0.0] * 3
    rig.step([entry("A", (0.1, 0.0, 0.1))], 20)
    assert rig.largest_step() == 0.0
    assert rig.forces[-1]["A"][2] < 0.05  # the ramp begins again


@pytest.mark.parametrize("status", [{"calibrated": False}, {"error": True}, {"awake": False}])
def test_a_status_that_flips_during_a_press_takes_the_force_away_at_once(status):
    rig = Rig()
    rig.step([entry("A")], 600)
    assert rig.forces[-1]["A"][2] > 0.9
    rig.step([entry("A", LOW, READY | status)])
    assert rig.forces[-1] == {"A": [0.0, 0.0, 0.0]}
    assert rig.devices == {}
    rig.poses[0] = np.array([0.0, 0.05, -1e-3]), rig.poses[0][1]  # the page moves the tool meanwhile
    rig.step([entry("A", LOW, READY | status)], 50)
    began = len(rig.paths)
    rig.step([entry("A", (0.1, -0.1, 0.1))], 200)
    assert rig.largest_step(began) == 0.0
    np.testing.assert_allclose(rig.poses[0][0], [0.0, 0.05, -1e-3])
    assert max(force["A"][2] for force in rig.forces[began : began + 10]) < 0.02
    assert rig.said[-1] == "A moves tool 1 again"


def test_a_status_that_flickers_moves_nothing_and_says_little():
    rig = Rig()
    for k in range(400):
        ready = k % 2 == 0
        rig.step([entry("A", HIGH if ready else LOW, READY | {"calibrated": ready})])
    assert rig.largest_step() == 0.0
    assert not any(any(force["A"]) for force in rig.forces)
    assert len(rig.said) == 3


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.0, -0.12, 0.17), (0.19, -0.12, 0.15)])
def test_a_jump_under_an_unchanged_status_moves_no_tool_and_gives_no_energy(place):
    rig = Rig()
    rig.step([entry("A")], 600)
    energy = rig.loop.passivity.energy
    rig.step([entry("A", place)], 100)
    assert rig.largest_step() == 0.0
    assert rig.loop.passivity.energy == pytest.approx(energy, abs=1e-6)
    assert rig.said[-1] == "A jumped, faster than a hand: tool 1 stays, and follows it from there"
    assert rig.forces[600] == {"A": [0.0, 0.0, 0.0]}
    rig.step([entry("A", (place[0], place[1], place[2] + 1e-3))], 3)
    assert rig.poses[0][0][2] == pytest.approx(-1e-3)


@pytest.mark.parametrize(("speed", "interval"), [(0.5, 1e-3), (1.9, 1e-3), (0.5, 0.01), (0.1, 0.05)])
def test_all_that_a_hand_does_is_followed_also_with_late_messages(speed, interval):
    rig = Rig(max_age=1.0)
    rig.step([entry("A")], 3)
    for k in range(1, 30):
        rig.step([entry("A", (0.0, -0.12, 0.15 + speed * interval * k))], interval=interval)
    assert rig.poses[0][0][2] == pytest.approx(-2e-3 + 29 * speed * interval)
    assert rig.said == ["A moves tool 1"]


@pytest.mark.parametrize("gap", [0.02, 0.15, 2.0])
@pytest.mark.parametrize("is_silent", [False, True])
@pytest.mark.parametrize("step", [0.005, 0.05, 0.3])
def test_a_hand_that_moved_in_a_gap_of_messages_continues_from_the_tool(gap, is_silent, step):
    rig = Rig(device_scale=3.0)
    rig.step([entry("A")], 600)
    if is_silent:  # as the adapter does after 12 ms
        rig.loop.silence()
    began = len(rig.paths) - 1
    rig.step([entry("A", (0.0, -0.12, 0.15 - step))], interval=gap)
    rig.step([entry("A", (0.0, -0.12, 0.15 - step))], 10)
    assert rig.largest_step(began) < 1e-3


def test_a_connection_that_is_made_again_continues_from_the_tool():
    rig = Rig()
    rig.step([entry("A")], 600)
    rig.loop.close()
    assert rig.devices == {}
    rig.now += 3.0
    rig.step([entry("A", LOW)], 300)
    assert rig.largest_step() == 0.0
    assert rig.said == ["A moves tool 1", "A moves tool 1 again"]


def test_of_two_devices_the_one_that_returns_is_anchored_and_the_other_presses_on():
    rig = Rig()
    both = [entry("R", config={"handedness": "right"}), entry("L", config={"handedness": "left"})]
    rig.step(both, 600)
    assert rig.devices == {"0": "R", "1": "L"}
    rig.step([entry("R", LOW, READY | {"calibrated": False}), both[1]], 100)
    assert rig.devices == {"1": "L"}
    assert rig.forces[-1]["R"] == [0.0, 0.0, 0.0]
    assert rig.forces[-1]["L"][2] == pytest.approx(STIFFNESS * 2e-3)
    rig.step([entry("R", (0.1, 0.1, 0.1)), both[1]], 600)
    assert rig.largest_step() == 0.0
    assert rig.devices == {"0": "R", "1": "L"}
    assert all(force["L"][2] > 0.9 for force in rig.forces[700:])
    rig.step([both[1]], 200)  # unplugged
    assert rig.said[-1] == "R is gone: tool 1 stays where it is"
    rig.step([both[1], entry("R", LOW)], 50)
    assert rig.devices == {"0": "R", "1": "L"}
    assert rig.largest_step() == 0.0


def test_a_device_that_is_not_ready_keeps_its_tool_for_itself_if_there_are_enough():
    rig = Rig()
    right = entry("R", LOW, READY | {"calibrated": False}, config={"handedness": "right"})
    rig.step([right, entry("L", config={"handedness": "left"})], 10)
    assert rig.devices == {"1": "L"}
    rig.step([entry("R"), entry("L")], 10)
    assert rig.devices == {"0": "R", "1": "L"}
    alone = Rig(tools=1)
    alone.step([right, entry("L", config={"handedness": "left"})], 10)
    assert alone.devices == {"0": "L"}


def test_a_clutch_that_is_held_at_the_return_keeps_the_tool():
    def grip(held):
        return [{"device_id": "G", "state": {"orientation": TURNED, "buttons": {"b": held}}}]

    rig = Rig()
    rig.step([entry("A")], 600, grips=grip(False))
    rig.step([entry("A", LOW, READY | {"awake": False})], 10, grips=grip(True))
    for place in (LOW, (0.0, 0.0, 0.002), (0.0, 0.0, 0.004)):
        rig.step([entry("A", place)], 10, grips=grip(True))
    rig.step([entry("A", (0.0, 0.0, 0.006))], 10, grips=grip(False))
    assert rig.largest_step() == 0.0
    rig.step([entry("A", (0.0, 0.0, 0.007))], 10, grips=grip(False))
    assert rig.poses[0][0][2] == pytest.approx(-1e-3)


STRAIGHT = {"device_id": "G1", "state": {"orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}}}
AWAY = [
    [], [STRAIGHT], [{"device_id": "G0"}, STRAIGHT], [{"device_id": "G0", "state": {"buttons": {}}}, STRAIGHT],
    [{"device_id": "G0", "state": {"orientation": TURNED}, "status": {"awake": False}}, STRAIGHT],
]  # fmt: skip


@pytest.mark.parametrize("away", AWAY, ids=range(len(AWAY)))
def test_a_grip_without_rotation_or_out_of_the_list_turns_no_tool_and_gives_its_place_to_no_other(away):
    rig = Rig()
    first = {"device_id": "G0", "state": {"orientation": TURNED}}
    rig.step([entry("A"), entry("B")], 10, grips=[first, STRAIGHT])
    rig.step([entry("A"), entry("B")], 10, grips=away)
    rig.step([entry("A"), entry("B")], 10, grips=[STRAIGHT, first])
    assert rig.largest_step() < 1e-12
    turned = {"device_id": "G0", "state": {"orientation": STRAIGHT["state"]["orientation"]}}
    rig.step([entry("A"), entry("B")], 10, grips=[STRAIGHT, turned])
    assert abs(rig.poses[0][1][3]) == pytest.approx(math.sin(0.5))  # the first one still turns the first tool
    np.testing.assert_allclose(rig.poses[1][1], [1.0, 0.0, 0.0, 0.0])


def test_a_session_that_pauses_finds_its_tool_where_it_was():
    rig = Rig()
    rig.step([entry("A")], 600)
    rig.running = False
    for k in range(100):
        rig.step([entry("A", (0.0, -0.12, 0.15 - 1e-3 * k))])
    rig.running = True
    rig.step([entry("A", (0.0, -0.12, 0.05))], 50)
    assert rig.largest_step() < 2e-3  # of the messages until the pause is known
    assert rig.poses[0][0][2] > -5e-3
