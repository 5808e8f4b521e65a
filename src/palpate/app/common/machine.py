"""What earlier commands have measured of this machine: a file of the cache folder of the user."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

from palpate.core.faults import InputError
from palpate.core.files import json_of, read_text, write_json
from palpate.core.working_folder import cache_folder

MAX_BYTES, MAX_SECONDS = 100_000, 1e6  # of the file; larger times in it are not used


def kept_seconds(name: str) -> float | None:
    """Return the time [s] that is kept under a name, or None."""
    value = _read().get(name)
    return float(value) if isinstance(value, int | float) and 0.0 < value < MAX_SECONDS else None


def kept_text(name: str) -> str:
    """Return the text that is kept under a name; empty without one."""
    value = _read().get(name)
    return value if isinstance(value, str) else ""


def keep(name: str, value: float | str) -> None:
    """Keep a time [s] or a text under a name; do nothing where the cache folder cannot be written."""
    with contextlib.suppress(OSError, InputError):
        _file().parent.mkdir(parents=True, exist_ok=True)
        write_json(_file(), _read() | {name: value})


def _read() -> dict[str, Any]:
    try:
        content = json_of(read_text(_file(), "file of measurements", MAX_BYTES))
    except (OSError, ValueError):  # an `InputError` is a `ValueError`
        return {}
    return content if isinstance(content, dict) else {}


def _file() -> Path:
    return (cache_folder() or Path(os.devnull)) / "machine.json"
