"""One file for a reduced model: HDF5, with nothing in it that could run."""

from __future__ import annotations

from pathlib import Path

from palpate.reduction.reduced import ReducedModel, ReducedParts

__all__ = ["load", "save"]


def save(parts: ReducedParts, path: Path) -> None:
    """Write the parts of a model to a file, whole or not at all."""
    raise NotImplementedError(path)


def load(path: str | Path) -> ReducedModel:
    """Read a reduced model."""
    raise NotImplementedError(path)
