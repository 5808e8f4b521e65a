"""What clients may say, and how everything else is refused."""

from __future__ import annotations

import json

import pytest

import palpate as pt
from palpate.app.session.messages import parse_message


def test_missing_fields_have_defaults_and_unknown_fields_are_dropped():
    message = parse_message('{"type": "pose", "position": [0, 0.01, -0.02], "colour": "red"}')
    assert message == {
        "type": "pose", "position": [0.0, 0.01, -0.02], "quaternion": [1.0, 0.0, 0.0, 0.0], "sequence": 0, "index": 0,
    }  # fmt: skip


def test_quaternions_are_normalised():
    turn = parse_message('{"type": "pose", "position": [0, 0, 0], "quaternion": [0, 0, 3, 4]}')["quaternion"]
    assert turn == pytest.approx([0, 0, 0.6, 0.8])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not valid JSON"),
        ("{", "not valid JSON"),
        ("[" * 30_000, "32 nested levels"),
        ('{"type": "latency", "stamp": ' + "[" * 40 + "]" * 40 + "}", "32 nested levels"),
        ('{"type": "release", "type": "release"}', "same key twice"),
        ('{"type": "latency", "stamp": 1e999}', "not finite"),
        ('{"type": "latency", "stamp": ' + "9" * 5000 + "}", "not valid JSON"),
        ('{"type": "latency", "stamp": [1]}', "must be a finite number, text"),
        ('{"type": "latency", "stamp": true}', "must be a finite number, text"),
        (json.dumps({"type": "latency", "stamp": "x" * 201}), "at most 200"),
        ('{"type": "hello", "protocol": 2, "token": "\\ud800"}', "surrogate"),
        ('{"type": "force", "rate": 1e-300}', "from 1 to 1000"),
        ('{"type": "force", "rate": 0.01}', "from 1 to 1000"),
        ('{"type": "force", "rate": 1001}', "from 1 to 1000"),
        ('{"type": "force", "rate": false}', "from 1 to 1000"),
        ("[]", "JSON object"),
        ("{}", "got None"),
        ('{"type": ["pose"]}', "type must be one of"),
        ('{"type": "fly"}', "type must be one of hello, ack"),
        ('{"type": "pose"}', "position must be given"),
        ('{"type": "pose", "position": [0, 0]}', "list of 3"),
        ('{"type": "pose", "position": [0, 0, NaN]}', "NaN is not a number"),
        ('{"type": "pose", "position": [0, 0, 1e400]}', "not finite"),
        ('{"type": "pose", "position": [0, 0, true]}', "from -1000 to 1000"),
        ('{"type": "pose", "position": [0, 0, "1"]}', "from -1000 to 1000"),
        ('{"type": "pose", "position": [0, 0, 0], "quaternion": [0, 0, 0, 0]}', "non-zero quaternion"),
        ('{"type": "ack", "sequence": -1}', "from 0 to 2"),
        ('{"type": "ack", "sequence": 1.5}', "whole number"),
        ('{"type": "tool", "kind": "laser", "position": [0, 0, 0]}', "'sphere', 'capsule', 'grasp'"),
        ('{"type": "tool", "kind": "sphere", "position": [0, 0, 0], "radius": -1}', "radius"),
        ('{"type": "speed", "factor": 0}', "0.05 to 1"),
        ('{"type": "material", "name": "x", "value": 0}', "value"),
        (json.dumps({"type": "hello", "protocol": 2, "token": "x" * 1000}), "at most 200"),
        ('{"type": "pose", "position": [0, 0, 0], "index": 4}', "index must be a whole number from 0 to 3, got 4"),
        ('{"type": "release", "index": 16}', "from 0 to 3, got 16"),
        ('{"type": "release", "index": -1}', "from 0 to 3, got -1"),
        ('{"type": "release", "index": true}', "from 0 to 3, got True"),
        ('{"type": "pin", "index": 1.0, "pinned": true}', "from 0 to 3, got 1.0"),
        ('{"type": "pin", "index": 1}', "pinned must be given"),
        ('{"type": "pin", "index": 1, "pinned": 1}', "pinned must be true or false"),
        ('{"type": "follow", "fast": 1}', "fast must be true or false"),
        ('{"type": "force", "rate": 100, "tools": []}', "list of 1 to 4 indices"),
        (json.dumps({"type": "force", "rate": 100, "tools": list(range(16))}), "list of 1 to 4 indices"),
        ('{"type": "force", "rate": 100, "tools": [0, 0]}', "different indices"),
        ('{"type": "force", "rate": 100, "tools": 0}', "list of 1 to 4 indices"),
        (b"\x00\x01", "binary"),
    ],
)
def test_invalid_messages_are_refused(text, said):
    with pytest.raises(pt.InputError, match=said):
        parse_message(text)


def test_a_client_of_version_2_has_no_index_and_no_pin():
    message = {"type": "pose", "position": [0, 0, 0], "index": 16}
    assert parse_message(json.dumps(message), 2)["index"] == 0
    assert parse_message('{"type": "force", "rate": 100, "tools": 5}', 2)["tools"] == [0]
    with pytest.raises(pt.InputError, match="type must be one of") as refused:
        parse_message('{"type": "pin", "index": 0, "pinned": true}', 2)
    assert "pin," not in str(refused.value)


@pytest.mark.parametrize("stamp", [None, 0, -1.5, 2**53, "text"])
def test_the_stamp_of_a_latency_message_is_not_changed(stamp):
    assert parse_message(json.dumps({"type": "latency", "stamp": stamp})) == {"type": "latency", "stamp": stamp}


def test_rates_are_0_or_from_1_to_1000():
    messages = [parse_message(json.dumps({"type": "force", "rate": rate})) for rate in (0, 1, 1000)]
    assert [message["rate"] for message in messages] == [0.0, 1.0, 1000.0]


def test_refusals_are_short_and_printable():
    with pytest.raises(pt.InputError) as refused:
        parse_message(json.dumps({"type": "\U0001f9e0" * 1000}))
    assert len(str(refused.value)) < 400
    str(refused.value).encode()
