"""What earlier commands have measured of this machine: files of JSON in the cache folder of the user."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

from palpate.core.faults import InputError
from palpate.core.files import json_of, read_text, write_json
from palpate.core.working_folder import cache_folder

MEASUREMENTS_FILE = "machine.json"
MAX_VALUES, MAX_BYTES, MAX_SECONDS = (
    1000,
    1_000_000,
    1e6,
)  # of a file: the oldest are dropped; of a time


def kept_seconds(name: str) -> float | None:
    """Return the time [s] that is kept under a name, or None."""
    value = kept_values(MEASUREMENTS_FILE).get(name)
    return float(value) if isinstance(value, int | float) and 0.0 < value < MAX_SECONDS else None


def kept_text(name: str) -> str:
    """Return the text that is kept under a name; empty without one."""
    value = kept_values(MEASUREMENTS_FILE).get(name)
    return value if isinstance(value, str) else ""


def kept_values(file: str) -> dict[str, Any]:
    """Return the values of a file of the cache folder; none of one that is missing or damaged."""
    try:
        content = json_of(read_text(_path(file), "file of measurements", MAX_BYTES))
    except (OSError, ValueError):  # an `InputError` is a `ValueError`
        return {}
    return content if isinstance(content, dict) else {}


def keep(name: str, value: float | str, file: str = MEASUREMENTS_FILE) -> None:
    """Keep a value under a name as the newest of a file; do nothing where the cache folder cannot be written."""
    values = {key: other for key, other in kept_values(file).items() if key != name} | {name: value}
    with contextlib.suppress(OSError, InputError):
        _path(file).parent.mkdir(parents=True, exist_ok=True)
        write_json(_path(file), dict(list(values.items())[-MAX_VALUES:]))


def _path(file: str) -> Path:
    return (cache_folder() or Path(os.devnull)) / file
