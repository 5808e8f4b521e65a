"""Cache of spacings with which bodies kept real time on this machine: a file of the cache folder of the user."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

from palpate.core.faults import InputError
from palpate.core.files import json_of, read_text, write_json
from palpate.core.working_folder import cache_folder

MAX_SPACINGS, MAX_BYTES = 1000, 1_000_000  # in the file: the oldest are dropped
MIN_SPACING, MAX_SPACING = 1e-5, 1.0  # [m]; other values in the file are not used


def cached_spacing(digest: str) -> float | None:
    """Return the spacing [m] in the cache for a scene of a digest, or None."""
    value = _read().get(digest)
    return value if isinstance(value, float) and MIN_SPACING <= value <= MAX_SPACING else None


def cache_spacing(digest: str, spacing: float) -> None:
    """Put the spacing [m] for a scene of a digest into the cache; do nothing where its folder cannot be written."""
    spacings = {key: value for key, value in _read().items() if key != digest} | {digest: spacing}
    with contextlib.suppress(OSError, InputError):
        _file().parent.mkdir(parents=True, exist_ok=True)
        write_json(_file(), dict(list(spacings.items())[-MAX_SPACINGS:]))


def _read() -> dict[str, Any]:
    try:
        content = json_of(read_text(_file(), "file of spacings", MAX_BYTES))
    except (OSError, ValueError):  # an `InputError` is a `ValueError`
        return {}
    return content if isinstance(content, dict) else {}


def _file() -> Path:
    return (cache_folder() or Path(os.devnull)) / "spacings.json"
