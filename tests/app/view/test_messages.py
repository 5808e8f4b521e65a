"""What clients may say, and how everything else is refused."""

from __future__ import annotations

import json

import pytest

import palpate as pt
from palpate.app.view.messages import parsed


def test_what_is_missing_has_its_default_and_what_is_unknown_is_left_out():
    message = parsed('{"type": "pose", "position": [0, 0.01, -0.02], "colour": "red"}')
    assert message == {
        "type": "pose", "position": [0.0, 0.01, -0.02], "quaternion": [1.0, 0.0, 0.0, 0.0], "sequence": 0,
    }  # fmt: skip


def test_quaternions_become_unit_ones():
    turn = parsed('{"type": "pose", "position": [0, 0, 0], "quaternion": [0, 0, 3, 4]}')["quaternion"]
    assert turn == pytest.approx([0, 0, 0.6, 0.8])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[" * 5000, "not JSON"),
        ("[]", "JSON object"),
        ("{}", "type = None"),
        ('{"type": ["pose"]}', "type = "),
        ('{"type": "fly"}', "type = 'fly': allowed are hello, ack"),
        ('{"type": "pose"}', "position is missing"),
        ('{"type": "pose", "position": [0, 0]}', "list of 3"),
        ('{"type": "pose", "position": [0, 0, NaN]}', "NaN is no number"),
        ('{"type": "pose", "position": [0, 0, 1e400]}', "from -10 to 10"),
        ('{"type": "pose", "position": [0, 0, true]}', "from -10 to 10"),
        ('{"type": "pose", "position": [0, 0, "1"]}', "from -10 to 10"),
        ('{"type": "pose", "position": [0, 0, 0], "quaternion": [0, 0, 0, 0]}', "length 0"),
        ('{"type": "ack", "sequence": -1}', "at least 0"),
        ('{"type": "ack", "sequence": 1.5}', "whole number"),
        ('{"type": "tool", "kind": "laser", "position": [0, 0, 0]}', "'sphere', 'capsule', 'grasp'"),
        ('{"type": "tool", "kind": "sphere", "position": [0, 0, 0], "radius": -1}', "radius"),
        ('{"type": "speed", "factor": 0}', "0.05 to 1"),
        ('{"type": "material", "name": "x", "value": 0}', "value"),
        (json.dumps({"type": "hello", "protocol": 1, "token": "x" * 1000}), "at most 200"),
        (b"\x00\x01", "binary"),
    ],
)
def test_others_are_refused(text, said):
    with pytest.raises(pt.InputError, match=said):
        parsed(text)
