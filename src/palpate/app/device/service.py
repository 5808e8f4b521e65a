"""Messages of the Haply Inverse Service 3.x, checked on arrival; the form is that of its documentation of 3.5.

The service sends a snapshot first, and then one state for each message that it receives. All in SI units; its frame is
right-handed: x to the right, y forward, z up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from palpate.faults import InputError, brief

MAX_STATE_BYTES = 64 * 1024  # of a message of the service; one device takes about 1 kB
MAX_DEVICES = 16  # listed in a message
MAX_ID_CHARACTERS = 64
MAX_DISTANCE = 2.0  # [m] of a cursor from the origin; the arm reaches 0.3 m
GRIP_KINDS = ("wireless_verse_grip", "verse_grip")
CHECK_VERSION = "check the version of the Inverse Service (3.1 or newer)"

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w, x, y, z


@dataclass(frozen=True)
class Grip:
    """A handle: its rotation, and whether the button of the clutch is pressed."""

    rotation: Quaternion | None
    clutch: bool


@dataclass(frozen=True)
class ServiceState:
    """What a message of the service says."""

    positions: Mapping[str, Vector] = field(default_factory=dict)  # [m] of cursors by device, in order
    handedness: Mapping[str, str] = field(default_factory=dict)  # of devices, in a snapshot
    grips: tuple[Grip, ...] = ()
    notes: tuple[str, ...] = ()  # what was left out, and why


def parse_state(text: str | bytes) -> ServiceState:
    """Return what a message says; a device whose entry is not valid is left out, with a note."""
    if isinstance(text, bytes):
        raise InputError("message of the service must be text, got binary data; " + CHECK_VERSION)
    try:  # in a tenth of the time of `json_of`; what is taken from the message is checked below
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError(f"message of the service must be JSON, got {brief(text)}; {CHECK_VERSION}") from None
    if not isinstance(message, dict):
        raise InputError(f"message of the service must be a JSON object, got {brief(message)}; {CHECK_VERSION}")
    positions: dict[str, Vector] = {}
    handedness: dict[str, str] = {}
    notes: list[str] = []
    for entry in _entries(message, "inverse3"):
        try:
            name, position = _device(entry)
            if name in positions:
                raise InputError(f"device_id must be of one device, got {name!r} twice; the second is left out")
        except InputError as error:
            notes.append(str(error))
            continue
        positions[name] = position
        config = entry.get("config")
        if isinstance(config, dict):
            hand = config.get("handedness")
            handedness[name] = hand if hand in ("left", "right") else ""
    grips = [_grip(entry) for kind in GRIP_KINDS for entry in _entries(message, kind)]
    return ServiceState(positions, handedness, tuple(each for each in grips if each is not None), tuple(notes))


def _entries(message: Mapping[str, Any], kind: str) -> Sequence[Mapping[str, Any]]:
    entries = message.get(kind, [])
    if not isinstance(entries, list) or len(entries) > MAX_DEVICES:
        raise InputError(
            f"{kind} must be a list of at most {MAX_DEVICES} devices, got {brief(entries)}; {CHECK_VERSION}"
        )
    if any(not isinstance(entry, dict) for entry in entries):
        raise InputError(f"{kind} must be a list of objects, got {brief(entries)}; {CHECK_VERSION}")
    return entries


def _device(entry: Mapping[str, Any]) -> tuple[str, Vector]:
    name, state = entry.get("device_id"), entry.get("state")
    if not isinstance(name, str) or not 0 < len(name) <= MAX_ID_CHARACTERS or not name.isprintable():
        raise InputError(f"device_id must be a short text, got {brief(name)}; {CHECK_VERSION}")
    position = _numbers(state.get("cursor_position") if isinstance(state, dict) else None, "xyz")
    if position is None or max(map(abs, position)) > MAX_DISTANCE:
        where = state.get("cursor_position") if isinstance(state, dict) else state
        raise InputError(
            f"cursor_position of {name} must be x, y and z within {MAX_DISTANCE:g} m, got {brief(where)}; "
            f"{CHECK_VERSION}"
        )
    return name, (position[0], position[1], position[2])


def _grip(entry: Mapping[str, Any]) -> Grip | None:
    state = entry.get("state")
    if not isinstance(state, dict):
        return None
    buttons, rotation = state.get("buttons"), _numbers(state.get("orientation"), "wxyz")
    clutch = (buttons.get("b") if isinstance(buttons, dict) else state.get("button")) is True
    size = math.hypot(*rotation) if rotation else 0.0
    if rotation is None or not 0.5 < size < 2.0:  # of a unit quaternion
        return Grip(None, clutch)
    w, x, y, z = (part / size for part in rotation)
    return Grip((w, x, y, z), clutch)


def _numbers(given: Any, names: str) -> list[float] | None:
    """Return finite numbers by their names, or None."""
    if not isinstance(given, dict):
        return None
    numbers: list[Any] = [given.get(name) for name in names]
    if any(isinstance(each, bool) or not isinstance(each, int | float) for each in numbers):
        return None
    try:
        floats = [float(each) for each in numbers]
    except OverflowError:  # a whole number of hundreds of digits
        return None
    return floats if all(map(math.isfinite, floats)) else None


def force_message(forces: Mapping[str, Sequence[float]]) -> str:
    """Return the message that sets the forces [N] of devices, for which the service answers with a state."""
    return json.dumps(
        {
            "inverse3": [
                {"device_id": name, "commands": {"set_cursor_force": {"vector": dict(zip("xyz", force, strict=True))}}}
                for name, force in forces.items()
            ]
        },
        allow_nan=False,
    )


def assign_tools(
    state: ServiceState, present: Mapping[str, int], former: Mapping[str, int], tools: int
) -> dict[str, int]:
    """Return the index of the tool of each device: the right one has the first tool, the left one the second.

    Those that are present keep theirs, and those that return have theirs again if it is free. Without a right and a
    left one, they are taken in the order of the message.
    """
    assigned = dict(present)
    for name in state.positions:
        if name in former and former[name] not in assigned.values():
            assigned.setdefault(name, former[name])
    left = [name for name in state.positions if name not in assigned]
    hands = [state.handedness.get(name, "") for name in state.positions]
    if len(hands) > 1 and hands.count("right") == 1 and hands.count("left") == 1:
        left.sort(key=lambda name: {"right": 0, "left": 1}.get(state.handedness.get(name, ""), 2))
    for name in left:
        free = [index for index in range(tools) if index not in assigned.values()]
        if free:
            assigned[name] = free[0]
    return assigned
