"""What clients say: JSON objects, checked before anything else sees them. See docs/protocol.md."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from palpate.faults import InputError
from palpate.files import json_of, shortened

__all__ = ["LONGEST", "PROTOCOL", "Message", "checked", "parsed"]

PROTOCOL = 1
LONGEST = 64 * 1024  # bytes of a message
FARTHEST = 10.0  # [m] from the origin: what is farther is a client that lost its place
LONGEST_TEXT = 200
SLOWEST_RATE, FASTEST_RATE = 1.0, 1000.0  # [Hz] of force frames

Message = dict[str, Any]
Check = Callable[[str, Any], Any]


def number(low: float, high: float, *, open_low: bool = False) -> Check:
    """Return a check of a number in a range."""

    def check(name: str, value: Any) -> float:
        good = isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high
        if not good or (open_low and value == low):
            raise InputError(f"{name} = {_short(value)}: allowed is a number from {low:g} to {high:g}")
        return float(value)

    return check


def _vector(count: int) -> Check:
    def check(name: str, value: Any) -> list[float]:
        if not isinstance(value, list) or len(value) != count:
            raise InputError(f"{name} = {_short(value)}: allowed is a list of {count} numbers")
        return [number(-FARTHEST, FARTHEST)(name, entry) for entry in value]

    return check


def _turn(name: str, value: Any) -> list[float]:
    turn: list[float] = _vector(4)(name, value)
    length = math.sqrt(sum(part * part for part in turn))
    if length < 1e-6:
        raise InputError(f"{name} = {turn}: a quaternion of length 0 is no rotation")
    return [part / length for part in turn]


def _whole(name: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**53:
        raise InputError(f"{name} = {_short(value)}: allowed is a whole number of at least 0")
    return value


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str) or len(value) > LONGEST_TEXT:
        raise InputError(f"{name} = {_short(value)}: allowed is a text of at most {LONGEST_TEXT} characters")
    return value


def _one_of(*names: str) -> Check:
    def check(name: str, value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            raise InputError(f"{name} = {_short(value)}: allowed are {', '.join(map(repr, names))}")
        return value

    return check


def _or_none(check: Check) -> Check:
    return lambda name, value: None if value is None else check(name, value)


def _rate(name: str, value: Any) -> float:
    if value == 0 and not isinstance(value, bool):
        return 0.0
    return float(number(SLOWEST_RATE, FASTEST_RATE)(f"{name} (0 for none)", value))


def _stamp(name: str, value: Any) -> Any:
    good = value is None or (isinstance(value, str) and len(value) <= LONGEST_TEXT)
    if not good and (isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value)):
        allowed = f"a finite number, a text of at most {LONGEST_TEXT} characters, or null"
        raise InputError(f"{name} = {_short(value)}: allowed is {allowed}")
    return value


def _short(value: Any) -> str:
    return shortened(repr(value))


# of every type of message: names, checks, and what is taken where a name is missing; without it the name is needed
NEEDED = object()
_TOOL: dict[str, tuple[Check, Any]] = {
    "kind": (_one_of("sphere", "capsule", "grasp"), NEEDED),
    "radius": (number(1e-4, 1.0), 0.015),
    "length": (number(1e-4, 1.0), 0.04),
    "friction": (number(0.0, 2.0), 0.2),
    "stiffness": (_or_none(number(1.0, 1e4)), None),
    "position": (_vector(3), NEEDED),
    "quaternion": (_turn, (1.0, 0.0, 0.0, 0.0)),
    "sequence": (_whole, 0),
}
FIELDS: dict[str, dict[str, tuple[Check, Any]]] = {
    "hello": {"protocol": (_whole, NEEDED), "token": (_text, NEEDED), "name": (_text, "")},
    "ack": {"sequence": (_whole, NEEDED)},
    "pose": {
        "position": (_vector(3), NEEDED), "quaternion": (_turn, (1.0, 0.0, 0.0, 0.0)), "sequence": (_whole, 0),
    },
    "tool": _TOOL,
    "release": {},
    "drive": {},
    "control": {"action": (_one_of("reset", "pause", "resume"), NEEDED)},
    "speed": {"factor": (number(0.05, 1.0), NEEDED)},
    "show": {"scalar": (_one_of("displacement", "stress", "pressure", "none"), NEEDED)},
    "material": {"name": (_text, NEEDED), "value": (number(0.0, 1e12, open_low=True), NEEDED)},
    "record": {"action": (_one_of("start", "stop"), NEEDED)},
    "replay": {"action": (_one_of("play", "pause", "seek"), NEEDED), "time": (number(0.0, 1e6), 0.0)},
    "force": {"rate": (_rate, NEEDED)},
    "latency": {"stamp": (_stamp, None)},
}  # fmt: skip


def parsed(text: str | bytes) -> Message:
    """Return a message with all its names, missing ones filled in, unknown ones left out.

    Raises
    ------
    InputError
        It is no JSON object of finite numbers and at most 32 levels, its type is unknown, or a value is missing or out
        of range.
    """
    if isinstance(text, bytes):
        raise InputError("binary messages are not understood: send JSON as text")
    return checked(json_of(text))


def checked(given: Any) -> Message:
    """Return what `parsed` does of a message that is no text any more."""
    if not isinstance(given, dict):
        raise InputError("a message is a JSON object")
    kind = given.get("type")
    if not isinstance(kind, str) or kind not in FIELDS:
        raise InputError(f"type = {_short(kind)}: allowed are {', '.join(FIELDS)}")
    message: Message = {"type": kind}
    for name, (check, missing) in FIELDS[kind].items():
        if name in given:
            message[name] = check(f"{kind}: {name}", given[name])
        elif missing is NEEDED:
            raise InputError(f"{kind}: {name} is missing")
        else:
            message[name] = list(missing) if isinstance(missing, tuple) else missing
    return message
