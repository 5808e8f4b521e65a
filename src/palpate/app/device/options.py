"""Options of a haptic device, which several commands have."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

from palpate.app.common.arguments import add_parameter
from palpate.core.faults import InputError
from palpate.core.parameters import check_parameters, parameter

DEFAULT_SERVICE_PORT = 10001  # of the Inverse Service 3.x
DEVICE_PATTERN = re.compile(r"haply(?::(\d{1,5}))?")
AXES_PATTERN = re.compile(r"([+-]?[XYZ])([+-]?[XYZ])([+-]?[XYZ])")
OPTION_PREFIX = "device_"


@dataclass(frozen=True)
class DeviceOptions:
    """How the motion of a hand becomes that of a tool, and the force of the body that of the hand."""

    device_scale: float = parameter("", 1.0, "displacement of the tool over that of the hand", low=0.01, high=100.0)
    device_force: float = parameter("", 1.0, "force on the hand over that on the tool", low=0.0, high=100.0)
    device_limit: float = parameter("N", 3.3, "largest force on the hand", above=0.0, high=20.0)
    device_axes: str = parameter(
        "", "XYZ", "axes of the device along x, y and z of the body, such as XZ-Y; right, forward, up are X, Y, Z"
    )
    port: int = DEFAULT_SERVICE_PORT
    # age of a reading of the engine, and time without an answer of the service, at which the force becomes zero: below
    # 20 ms at the device, with a period of it and the transit of a message
    max_age: float = parameter("s", 0.012, "age of readings at which forces are zero", above=0.0, high=1.0)

    def __post_init__(self) -> None:
        check_parameters(self)
        axes_rotation(self.device_axes)


def axes_rotation(axes: str) -> list[list[float]]:
    """Return the rotation matrix from the axes of a device to those of the body, by a text such as ``XZ-Y``."""
    match = AXES_PATTERN.fullmatch(axes) if isinstance(axes, str) else None
    rows = [] if match is None else [_axis(word) for word in match.groups()]
    if not rows or _determinant(rows) != 1.0:
        raise InputError(
            f"device_axes must be X, Y and Z once each, with signs and right-handed, got {axes!r:.20}; write XYZ, or "
            "XZ-Y for a body whose y is up"
        )
    return rows


def _axis(word: str) -> list[float]:
    row = [0.0, 0.0, 0.0]
    row["XYZ".index(word[-1])] = -1.0 if word[0] == "-" else 1.0
    return row


def _determinant(m: list[list[float]]) -> float:
    return math.fsum(
        m[0][i] * (m[1][(i + 1) % 3] * m[2][(i + 2) % 3] - m[1][(i + 2) % 3] * m[2][(i + 1) % 3]) for i in range(3)
    )


def add_device(parser: Any) -> None:
    """Add the options of a haptic device to a parser."""
    group = parser.add_argument_group("of a haptic device")
    text = "a Haply Inverse3, or two, moves the tool and feels its force, through the Inverse Service of this machine"
    group.add_argument("--device", metavar="haply[:PORT]", help=f"{text} (default port: {DEFAULT_SERVICE_PORT})")
    for name, field in _declared():
        note = f" (default: {field.default:g})" if name != "device_axes" else f" (default: {field.default})"
        words = {"type": str, "metavar": "AXES"} if name == "device_axes" else {}
        add_parameter(group, DeviceOptions, name, note, **words)


def _declared() -> Iterator[tuple[str, Any]]:
    return ((field.name, field) for field in fields(DeviceOptions) if field.name.startswith(OPTION_PREFIX))


def take_device(options: dict[str, Any]) -> DeviceOptions | None:
    """Remove the options of a device from those of a command, and return them; None without a device."""
    device = options.pop("device", None)
    values = {name: value for name, _ in _declared() if (value := options.pop(name, None)) is not None}
    if device is None:
        if values:
            name, value = next(iter(values.items()))
            raise InputError(f"{name} must be left out without --device, got {value}; add --device haply")
        return None
    match = DEVICE_PATTERN.fullmatch(device)
    port = int(match[1] or DEFAULT_SERVICE_PORT) if match else 0
    if not 1 <= port <= 65535:
        raise InputError(
            f"device must be haply or haply:PORT with a port from 1 to 65535, got {device!r:.40}; write --device haply"
        )
    return DeviceOptions(**values, port=port)
