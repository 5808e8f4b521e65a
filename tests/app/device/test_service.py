"""Messages of the Inverse Service: what they say, and that what is damaged is left out."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import palpate as pt
from palpate.app.device.service import ServiceState, assign_tools, force_message, parse_state

# as in the documentation of the service, docs.haply.co/inverseSDK/service/realtime/websocket-protocol
SNAPSHOT = """{"session_id": 7, "inverse3": [{"device_id": "049D", "config": {"type": "inverse3", "port": "COM12",
"handedness": "right", "gravity_compensation": {"enabled": true, "scaling_factor": 1.0}}, "state": {"cursor_position":
{"x": 0.0, "y": -0.12, "z": 0.15}, "cursor_velocity": {"x": 0.0, "y": 0.0, "z": 0.0}, "control_mode": "idle"},
"status": {"calibrated": true}}], "wireless_verse_grip": [{"device_id": "61548", "state": {"orientation": {"w": 0.6,
"x": 0.0, "y": 0.8, "z": 0.0}, "buttons": {"a": false, "b": true, "c": false}}}]}"""


def test_a_snapshot_says_where_devices_are_and_whose_hand_they_are_for():
    state = parse_state(SNAPSHOT)
    assert state.positions == {"049D": (0.0, -0.12, 0.15)}
    assert state.handedness == {"049D": "right"}
    (grip,) = state.grips
    assert grip.rotation == pytest.approx((0.6, 0.0, 0.8, 0.0))
    assert grip.clutch
    assert state.notes == ()


def test_a_wired_grip_has_one_button():
    state = parse_state('{"verse_grip": [{"state": {"button": true, "hall": 3}}, {"state": {"button": false}}, {}]}')
    assert [(grip.rotation, grip.clutch) for grip in state.grips] == [(None, True), (None, False)]


def test_a_force_is_a_vector_for_each_device():
    message = json.loads(force_message({"049D": [0.0, 0.1, 1.5], "B": [0.0, 0.0, 0.0]}))
    first = {"device_id": "049D", "commands": {"set_cursor_force": {"vector": {"x": 0.0, "y": 0.1, "z": 1.5}}}}
    assert message["inverse3"][0] == first
    assert [entry["device_id"] for entry in message["inverse3"]] == ["049D", "B"]
    with pytest.raises(ValueError, match="JSON"):
        force_message({"A": [math.nan, 0.0, 0.0]})


DAMAGED = ["", "7", "[1]", "null", "{", b"{}", '{"inverse3": 3}', '{"inverse3": [3]}', "[" * 60_000, "9" * 20_000]
DAMAGED += [json.dumps({"inverse3": [{}] * 17}), json.dumps({"verse_grip": {}}), '{"a":' * 20_000]


@pytest.mark.parametrize("text", DAMAGED, ids=range(len(DAMAGED)))
def test_other_texts_than_messages_are_refused_in_a_line(text):
    with pytest.raises(pt.InputError) as caught:
        parse_state(text)
    assert len(str(caught.value)) < 250
    assert "\n" not in str(caught.value)


ENTRIES = [
    {}, {"device_id": 7}, {"device_id": ""}, {"device_id": "x" * 65}, {"device_id": "a\nb"}, {"device_id": "A"},
    {"device_id": "A", "state": 3}, {"device_id": "A", "state": {"cursor_position": [0, 0, 0]}},
    {"device_id": "A", "state": {"cursor_position": {"x": 0, "y": 0}}},
    {"device_id": "A", "state": {"cursor_position": {"x": 0, "y": 0, "z": "1"}}},
    {"device_id": "A", "state": {"cursor_position": {"x": 0, "y": 0, "z": True}}},
    {"device_id": "A", "state": {"cursor_position": {"x": 0, "y": 0, "z": 3.0}}},
    {"device_id": "A", "state": {"cursor_position": {"x": 0, "y": 0, "z": math.inf}}},
    {"device_id": "A", "state": {"cursor_position": {"x": 0, "y": 0, "z": 10**400}}},
]  # fmt: skip


@pytest.mark.parametrize("entry", ENTRIES, ids=range(len(ENTRIES)))
def test_a_damaged_device_is_left_out_and_the_other_kept(entry):
    good = {"device_id": "B", "state": {"cursor_position": {"x": 0.0, "y": 0.1, "z": 0.2}}}
    state = parse_state(json.dumps({"inverse3": [entry, good]}))
    assert state.positions == {"B": (0.0, 0.1, 0.2)}
    assert len(state.notes) == 1
    assert len(state.notes[0]) < 250


def test_random_damage_is_refused_or_read():
    rng, read = np.random.default_rng(0), 0
    for _ in range(3000):
        text = bytearray(SNAPSHOT.encode())
        for _ in range(rng.integers(1, 6)):
            at = rng.integers(len(text))
            if rng.random() < 0.5:
                text[at] = rng.integers(32, 127)
            else:
                del text[at : at + rng.integers(1, 40)]
        try:
            state = parse_state(text.decode())
        except pt.InputError:
            continue
        read += 1
        assert all(math.isfinite(x) and abs(x) <= 2 for position in state.positions.values() for x in position)
    assert read > 100


def places(*names):
    return dict.fromkeys(names, (0.0, 0.0, 0.0))


def test_the_right_device_has_the_first_tool_and_the_left_one_the_second():
    state = ServiceState(places("A", "B"), {"A": "left", "B": "right"})
    assert assign_tools(state, {}, {}, 2) == {"B": 0, "A": 1}
    assert assign_tools(ServiceState(places("A"), {"A": "left"}), {}, {}, 2) == {"A": 0}
    assert assign_tools(ServiceState(places("A", "B"), dict.fromkeys("AB", "right")), {}, {}, 2) == {"A": 0, "B": 1}
    assert assign_tools(state, {}, {}, 1) == {"B": 0}


def test_a_device_that_returns_has_its_tool_unless_another_took_it():
    state = ServiceState(places("A", "B"))
    assert assign_tools(state, {"A": 1}, {"A": 1, "B": 0}, 2) == {"A": 1, "B": 0}
    assert assign_tools(state, {"A": 0}, {"A": 0, "B": 0}, 2) == {"A": 0, "B": 1}
    assert assign_tools(state, {"A": 0}, {"B": 0}, 1) == {"A": 0}
