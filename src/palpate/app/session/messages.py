"""Messages of clients: JSON objects, validated on arrival. See docs/reference/protocol.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from palpate.app.recordings.snapshot import TOOL_KINDS
from palpate.core.faults import InputError
from palpate.core.files import json_of, shortened
from palpate.dynamics.contact.shapes import TOOLS, tool_parameters
from palpate.dynamics.contact.tool_parameters import friction
from palpate.realtime.contract import MAX_TOOLS

PROTOCOL_VERSIONS = (2, 3)
MAX_MESSAGE_BYTES = 64 * 1024
MAX_COORDINATE = 1000.0  # [m] of a position; single precision, in which bodies are drawn, has 0.06 mm there
MAX_TEXT_LENGTH, MAX_TEXTS = 200, 200  # characters; texts of a list
NO_VIEWERS, VIEWERS_LEFT = "no viewers", "viewers left"  # reasons of a pause
SEE_DOCS = "see docs/reference/protocol.md"
MIN_TOOL_SIZE, MAX_TOOL_SIZE = 1e-4, 1.0  # [m]
MIN_FORCE_RATE, MAX_FORCE_RATE = 1.0, 1000.0  # [Hz] of force frames

Message = dict[str, Any]
Check = Callable[[str, Any], Any]


def _number(low: float, high: float, *, open_low: bool = False) -> Check:
    """Return a check for a number in a range."""

    def check(name: str, value: Any) -> float:
        good = isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high
        if not good or (open_low and value == low):
            above = "above" if open_low else "from"
            raise InputError(f"{name} must be a number {above} {low:g} to {high:g}, got {_repr(value)}; {SEE_DOCS}")
        return float(value)

    return check


def _vector(count: int) -> Check:
    def check(name: str, value: Any) -> list[float]:
        if not isinstance(value, list) or len(value) != count:
            raise InputError(f"{name} must be a list of {count} numbers, got {_repr(value)}; {SEE_DOCS}")
        return [_number(-MAX_COORDINATE, MAX_COORDINATE)(name, entry) for entry in value]

    return check


def _unit_quaternion(name: str, value: Any) -> list[float]:
    quaternion: list[float] = _vector(4)(name, value)
    length = math.sqrt(sum(part * part for part in quaternion))
    if length < 1e-6:
        raise InputError(f"{name} must be a non-zero quaternion, got {quaternion}; use [1, 0, 0, 0] for no rotation")
    return [part / length for part in quaternion]


def _whole_number(name: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**53:
        raise InputError(f"{name} must be a whole number from 0 to 2^53, got {_repr(value)}; {SEE_DOCS}")
    return value


def _index(name: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < MAX_TOOLS:
        raise InputError(f"{name} must be a whole number from 0 to {MAX_TOOLS - 1}, got {_repr(value)}; {SEE_DOCS}")
    return value


def _indices(name: str, value: Any) -> list[int]:
    if not isinstance(value, list) or not 1 <= len(value) <= MAX_TOOLS:
        raise InputError(f"{name} must be a list of 1 to {MAX_TOOLS} indices, got {_repr(value)}; {SEE_DOCS}")
    indices = [_index(name, entry) for entry in value]
    if len(set(indices)) < len(indices):
        raise InputError(f"{name} must be different indices, got {_repr(value)}; leave out those that come twice")
    return indices


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str) or len(value) > MAX_TEXT_LENGTH:
        raise InputError(f"{name} must be text of at most {MAX_TEXT_LENGTH} characters, got {_repr(value)}; shorten it")
    return value


def _texts(name: str, value: Any) -> list[str]:
    if not isinstance(value, list) or len(value) > MAX_TEXTS:
        raise InputError(f"{name} must be a list of at most {MAX_TEXTS} texts, got {_repr(value)}; {SEE_DOCS}")
    return [_text(name, entry) for entry in value]


def _boolean(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{name} must be true or false, got {_repr(value)}; {SEE_DOCS}")
    return value


def _one_of(*names: str) -> Check:
    def check(name: str, value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            allowed = ", ".join(map(repr, names))
            raise InputError(f"{name} must be one of {allowed}, got {_repr(value)}; choose one of these")
        return value

    return check


def _or_none(check: Check) -> Check:
    return lambda name, value: None if value is None else check(name, value)


def _rate(name: str, value: Any) -> float:
    if value == 0 and not isinstance(value, bool):
        return 0.0
    return float(_number(MIN_FORCE_RATE, MAX_FORCE_RATE)(f"{name} (0 for no frames)", value))


def _stamp(name: str, value: Any) -> Any:
    good = value is None or (isinstance(value, str) and len(value) <= MAX_TEXT_LENGTH)
    if not good and (isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value)):
        allowed = f"a finite number, text of at most {MAX_TEXT_LENGTH} characters, or null"
        raise InputError(f"{name} must be {allowed}, got {_repr(value)}; {SEE_DOCS}")
    return value


def _repr(value: Any) -> str:
    return shortened(repr(value))


def _tool_limits(about: Mapping[str, Any]) -> dict[str, Any]:
    """Return the range of a tool's parameter in messages, where lengths are of the size of a hand."""
    if about["unit"] == "m":
        return {"low": max(about["low"], MIN_TOOL_SIZE), "high": min(about["high"], MAX_TOOL_SIZE)}
    return {name: about[name] for name in ("low", "high", "open_low")}


def describe_tools(kinds: Iterable[str]) -> dict[str, Any]:
    """Return the names of all tools, as frames number them, and the parameters of some kinds, for ``hello``."""
    declared = tool_parameters()
    described = {
        kind: [
            {"name": name, "unit": declared[name][0]["unit"], "usual": usual, **_tool_limits(declared[name][0])}
            for name, usual in TOOLS[kind].usual.items()
        ]
        for kind in kinds
    }
    return {"tool_kinds": list(TOOL_KINDS), "tool_parameters": described}


REQUIRED_FIELD = object()  # marks a field without default
FRICTION_FIELD = friction(0.2, high=2.0)
_TOOL: dict[str, tuple[Check, Any]] = {
    "kind": (_one_of(*TOOLS), REQUIRED_FIELD),
    **{name: (_number(**_tool_limits(about)), usual) for name, (about, usual) in tool_parameters().items()},
    "friction": (_number(**_tool_limits(FRICTION_FIELD.metadata)), FRICTION_FIELD.default),
    "stiffness": (_or_none(_number(1.0, 1e4)), None),
    "position": (_vector(3), REQUIRED_FIELD),
    "quaternion": (_unit_quaternion, (1.0, 0.0, 0.0, 0.0)),
    "sequence": (_whole_number, 0), "index": (_index, 0),
}  # fmt: skip
# fields of each type of message: check and default
FIELDS_BY_MESSAGE: dict[str, dict[str, tuple[Check, Any]]] = {
    "hello": {
        "protocol": (_whole_number, REQUIRED_FIELD), "token": (_text, REQUIRED_FIELD), "name": (_text, ""),
        "preparation": (_boolean, False), "surroundings": (_boolean, False),
    },
    "ack": {"sequence": (_whole_number, REQUIRED_FIELD)},
    "pose": {
        "position": (_vector(3), REQUIRED_FIELD), "quaternion": (_unit_quaternion, (1.0, 0.0, 0.0, 0.0)),
        "sequence": (_whole_number, 0), "index": (_index, 0),
    },
    "tool": _TOOL,
    "pin": {"index": (_index, 0), "pinned": (_boolean, REQUIRED_FIELD)},
    "release": {"index": (_index, 0)},
    "drive": {},
    "control": {"action": (_one_of("reset", "pause", "resume", "undo"), REQUIRED_FIELD)},
    "speed": {"factor": (_number(0.05, 1.0), REQUIRED_FIELD)},
    "follow": {"fast": (_boolean, REQUIRED_FIELD)},
    "show": {"scalar": (_one_of("displacement", "stress", "pressure", "none"), REQUIRED_FIELD)},
    "material": {"name": (_text, REQUIRED_FIELD), "value": (_number(0.0, 1e12, open_low=True), REQUIRED_FIELD)},
    "record": {"action": (_one_of("start", "stop"), REQUIRED_FIELD)},
    "replay": {"action": (_one_of("play", "pause", "seek"), REQUIRED_FIELD), "time": (_number(0.0, 1e6), 0.0)},
    "choose": {"parts": (_texts, REQUIRED_FIELD), "without": (_texts, ())},
    "body": {"law": (_text, REQUIRED_FIELD), "modes": (_whole_number, 0), "second": (_text, "")},
    "refine": {"action": (_one_of("start", "stop", "use"), REQUIRED_FIELD)},
    "force": {"rate": (_rate, REQUIRED_FIELD), "tools": (_indices, (0,))},
    "latency": {"stamp": (_stamp, None)},
}  # fmt: skip
TYPES_OF_VERSION_3, FIELDS_OF_VERSION_3 = ("pin",), ("index", "tools")  # unknown to clients of version 2


def parse_message(text: str | bytes, version: int = PROTOCOL_VERSIONS[-1]) -> Message:
    """Return a message with all its fields; adds defaults and drops fields that the version does not have."""
    if isinstance(text, bytes):
        raise InputError("message must be text, got binary data; send JSON as text")
    return validate_message(json_of(text), version)


def validate_message(content: Any, version: int = PROTOCOL_VERSIONS[-1]) -> Message:
    """Return a decoded message with all its fields; see `parse_message`."""
    if not isinstance(content, dict):
        raise InputError(f"message must be a JSON object, got {_repr(content)}; {SEE_DOCS}")
    kind = content.get("type")
    hidden_types, hidden = (TYPES_OF_VERSION_3, FIELDS_OF_VERSION_3) if version < 3 else ((), ())
    types = [each for each in FIELDS_BY_MESSAGE if each not in hidden_types]
    if not isinstance(kind, str) or kind not in types:
        raise InputError(f"type must be one of {', '.join(types)}, got {_repr(kind)}; {SEE_DOCS}")
    message: Message = {"type": kind}
    for name, (check, default) in FIELDS_BY_MESSAGE[kind].items():
        if name in content and name not in hidden:
            message[name] = check(f"{kind}: {name}", content[name])
        elif default is REQUIRED_FIELD:
            raise InputError(f"{kind}: {name} must be given, got nothing; {SEE_DOCS}")
        else:
            message[name] = list(default) if isinstance(default, tuple) else default
    return message
