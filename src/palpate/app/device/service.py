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

from palpate.core.faults import InputError, brief

MAX_STATE_BYTES = 64 * 1024  # of a message of the service; one device takes about 1 kB
MAX_DEVICES = 16  # listed in a message
MAX_ID_CHARACTERS = 64
MAX_DISTANCE = 2.0  # [m] of a cursor from the origin; the arm reaches 0.3 m
MAX_STATUS_DEPTH = 4  # of objects in the status of a device
GRIP_KINDS = ("wireless_verse_grip", "verse_grip")
CHECK_VERSION = "check the version of the Inverse Service (3.1 or newer)"
NO_ERRORS = ("", "none", "ok", "no_error", "false")  # texts of a device without errors

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w, x, y, z


@dataclass(frozen=True)
class Grip:
    """A handle: its rotation, whether the button of the clutch is pressed, and its name."""

    rotation: Quaternion | None
    clutch: bool
    name: str = ""


@dataclass(frozen=True)
class Fault:
    """Why a device must not move a tool, and what a person does about it."""

    reason: str
    remedy: str


NO_POWER = Fault("has no power", "connect its power supply")
IS_ASLEEP = Fault("is asleep", "wake it: move it, or press its button")
IN_ERROR = Fault("is in error", "see Haply Hub, or switch it off and on")
FORBIDDEN_STATES = dict.fromkeys(("error", "errors", "in_error", "fault", "faults"), IN_ERROR) | {"asleep": IS_ASLEEP}
NEEDED_STATES = {  # where the service states them
    "connected": Fault("is not connected", "plug its cable in"),
    "power_supply": NO_POWER,
    "powered": NO_POWER,
    "awake": IS_ASLEEP,
    "calibrated": Fault("is not calibrated", "calibrate it, as Haply Hub shows"),
    "started": Fault("is not started", "restart the Haply Inverse Service"),
    "ready": Fault("is not ready", "wait until Haply Hub shows it as ready"),
}
FAULT_ORDER = tuple(dict.fromkeys([*FORBIDDEN_STATES.values(), *NEEDED_STATES.values()]))  # the first is named


@dataclass(frozen=True)
class ServiceState:
    """What a message of the service says."""

    positions: Mapping[str, Vector] = field(default_factory=dict)  # [m] of cursors by device that is ready, in order
    handedness: Mapping[str, str] = field(default_factory=dict)  # of devices, in a snapshot
    grips: tuple[Grip, ...] = ()
    notes: tuple[str, ...] = ()  # what was left out, and why
    faults: Mapping[str, Fault] = field(default_factory=dict)  # of devices that are not ready

    @property
    def devices(self) -> list[str]:
        """Names of all devices, those that are ready first."""
        return [*self.positions, *self.faults]


def parse_state(text: str | bytes) -> ServiceState:
    """Return what a message says; a device whose entry is not valid is left out, with a note.

    The position of a device that is not ready has no meaning, and is not read.
    """
    if isinstance(text, bytes):
        raise InputError("message of the service must be text, got binary data; " + CHECK_VERSION)
    try:  # in a tenth of the time of `json_of`; what is taken from the message is checked below
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError(f"message of the service must be JSON, got {brief(text)}; {CHECK_VERSION}") from None
    if not isinstance(message, dict):
        raise InputError(f"message of the service must be a JSON object, got {brief(message)}; {CHECK_VERSION}")
    positions: dict[str, Vector] = {}
    faults: dict[str, Fault] = {}
    handedness: dict[str, str] = {}
    notes: list[str] = []
    for entry in _entries(message, "inverse3"):
        try:
            name = _name(entry)
            if name in positions or name in faults:
                raise InputError(f"device_id must be of one device, got {name!r} twice; the second is left out")
            fault = _fault(entry)
            if fault is None:
                positions[name] = _position(name, entry.get("state"))
            else:
                faults[name] = fault
        except InputError as error:
            notes.append(str(error))
            continue
        config = entry.get("config")
        if isinstance(config, dict):
            hand = config.get("handedness")
            handedness[name] = hand if hand in ("left", "right") else ""
    grips = [_grip(entry, f"{kind} {k}") for kind in GRIP_KINDS for k, entry in enumerate(_entries(message, kind))]
    present = tuple(each for each in grips if each is not None)
    return ServiceState(positions, handedness, present, tuple(notes), faults)


def _entries(message: Mapping[str, Any], kind: str) -> Sequence[Mapping[str, Any]]:
    entries = message.get(kind, [])
    if not isinstance(entries, list) or len(entries) > MAX_DEVICES:
        raise InputError(
            f"{kind} must be a list of at most {MAX_DEVICES} devices, got {brief(entries)}; {CHECK_VERSION}"
        )
    if any(not isinstance(entry, dict) for entry in entries):
        raise InputError(f"{kind} must be a list of objects, got {brief(entries)}; {CHECK_VERSION}")
    return entries


def _name(entry: Mapping[str, Any]) -> str:
    name = entry.get("device_id")
    if not isinstance(name, str) or not 0 < len(name) <= MAX_ID_CHARACTERS or not name.isprintable():
        raise InputError(f"device_id must be a short text, got {brief(name)}; {CHECK_VERSION}")
    return name


def _position(name: str, state: Any) -> Vector:
    position = _numbers(state.get("cursor_position") if isinstance(state, dict) else None, "xyz")
    if position is None or max(map(abs, position)) > MAX_DISTANCE:
        where = state.get("cursor_position") if isinstance(state, dict) else state
        raise InputError(
            f"cursor_position of {name} must be x, y and z within {MAX_DISTANCE:g} m, got {brief(where)}; "
            f"{CHECK_VERSION}"
        )
    return position[0], position[1], position[2]


def _fault(entry: Mapping[str, Any]) -> Fault | None:
    """Return why a device is not ready; None if it is, or if the service does not state it."""
    faults: set[Fault] = set()
    _note_faults(entry, faults, 0)
    for name, depth in (("status", MAX_STATUS_DEPTH), ("state", 0)):
        reported = entry.get(name)
        if isinstance(reported, dict):
            _note_faults(reported, faults, depth)
    return next(each for each in FAULT_ORDER if each in faults) if faults else None


def _note_faults(reported: Mapping[str, Any], faults: set[Fault], depth: int) -> None:
    """Collect the faults that an object of an entry states, also in objects in it down to a depth."""
    for key, value in reported.items():
        if value is True and key in NEEDED_STATES:  # the usual one
            continue
        name = key.removeprefix("is_")
        if name in FORBIDDEN_STATES:
            if _has_error(value):
                faults.add(FORBIDDEN_STATES[name])
        elif name in NEEDED_STATES:
            if not _holds(value):
                faults.add(NEEDED_STATES[name])
        elif depth and isinstance(value, dict):
            _note_faults(value, faults, depth - 1)


def _parts(value: Any) -> list[Any]:
    return list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else [value]


def _holds(value: Any) -> bool:
    """Return whether a state is true; one of several parts, such as joints, if it is true of each."""
    parts = _parts(value)
    return bool(parts) and all(
        part.lower() == "true" if isinstance(part, str) else isinstance(part, int | float) and part > 0
        for part in parts
    )


def _has_error(value: Any) -> bool:
    return any(part.lower() not in NO_ERRORS if isinstance(part, str) else bool(part) for part in _parts(value))


def _grip(entry: Mapping[str, Any], place: str) -> Grip | None:
    """Return what a handle says; one that is not ready has neither rotation nor clutch, an empty entry is None."""
    name, state = entry.get("device_id"), entry.get("state")
    if name is None and state is None:
        return None
    name = name[:MAX_ID_CHARACTERS] if isinstance(name, str) else place
    if not isinstance(state, dict) or _fault(entry) is not None:
        return Grip(None, False, name)
    buttons, rotation = state.get("buttons"), _numbers(state.get("orientation"), "wxyz")
    clutch = (buttons.get("b") if isinstance(buttons, dict) else state.get("button")) is True
    size = math.hypot(*rotation) if rotation else 0.0
    if rotation is None or not 0.5 < size < 2.0:  # of a unit quaternion
        return Grip(None, clutch, name)
    w, x, y, z = (part / size for part in rotation)
    return Grip((w, x, y, z), clutch, name)


def _numbers(components: Any, names: str) -> list[float] | None:
    """Return finite numbers by their names, or None."""
    if not isinstance(components, dict):
        return None
    numbers: list[Any] = [components.get(name) for name in names]
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
    left one, they are taken in the order of the message; where tools are too few, those that are ready come first.
    """
    assigned = dict(present)
    for name in state.devices:
        if name in former and former[name] not in assigned.values():
            assigned.setdefault(name, former[name])
    left = [name for name in state.devices if name not in assigned]
    free = [index for index in range(tools) if index not in assigned.values()]
    hands = [state.handedness.get(name, "") for name in state.devices]
    if len(hands) > 1 and hands.count("right") == 1 and hands.count("left") == 1:
        left.sort(key=lambda name: {"right": 0, "left": 1}.get(state.handedness.get(name, ""), 2))
    if len(left) > len(free):
        left.sort(key=lambda name: name in state.faults)
    return assigned | dict(zip(left, free, strict=False))
