"""Cache of spacings with which bodies kept real time on this machine: a file of the cache folder of the user."""

from __future__ import annotations

from palpate.app.common.machine import keep, kept_values

SPACINGS_FILE = "spacings.json"
MIN_SPACING, MAX_SPACING = 1e-5, 1.0  # [m]; other values in the file are not used


def cached_spacing(digest: str) -> float | None:
    """Return the spacing [m] in the cache for a scene of a digest, or None."""
    value = kept_values(SPACINGS_FILE).get(digest)
    return value if isinstance(value, float) and MIN_SPACING <= value <= MAX_SPACING else None


def cache_spacing(digest: str, spacing: float) -> None:
    """Put the spacing [m] for a scene of a digest into the cache; do nothing where its folder cannot be written."""
    keep(digest, spacing, SPACINGS_FILE)
