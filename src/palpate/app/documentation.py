"""Folder of the documentation: in the package of a wheel, or in the sources."""

from __future__ import annotations

from pathlib import Path


def documentation() -> Path:
    """Return the folder that holds the pages that help texts call docs/NAME.md."""
    package = Path(__file__).parents[1]
    shipped = package / "docs"
    return shipped if shipped.is_dir() else package.parents[1] / "docs"
