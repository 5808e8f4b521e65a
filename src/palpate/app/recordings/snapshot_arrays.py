"""Arrays of snapshots, by the names that they have in a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.recordings.snapshot import ENGINE_STATES, TOOL_KINDS, Snapshot
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import InputError
from palpate.reduction.hyper.model import ReducedModel

__all__ = [
    "FORMAT",
    "MAX_TITLE_LENGTH",
    "MAX_VALUE",
    "SNAPSHOT_ARRAYS",
    "VERSION",
    "coordinates_type",
    "snapshot_arrays",
]

FORMAT, VERSION = "palpate recording", 3
MAX_TITLE_LENGTH = 200  # characters
MAX_VALUE = 1e9  # of the arrays of a recording, in SI units
SNAPSHOT_ARRAYS = tuple(
    f.name for f in fields(Snapshot) if f.name not in ("contact_nodes", "contact_forces", "tool", "state")
)


def coordinates_type(model: ReducedModel | EnergySolid) -> str:
    """Return the type of coordinates in a recording: nodal displacements of a full body have single precision."""
    return "<f8" if isinstance(model, ReducedModel) else "<f4"


def snapshot_arrays(snapshots: Sequence[Snapshot], model: ReducedModel | EnergySolid) -> dict[str, NDArray[Any]]:
    """Return the arrays of at least one snapshot of a body."""
    arrays: dict[str, NDArray[Any]] = {
        name: np.array(
            [getattr(each, name) for each in snapshots],
            dtype=coordinates_type(model) if name == "coordinates" else "<f8",
        )
        for name in SNAPSHOT_ARRAYS
    }
    arrays["trust"] = np.minimum(arrays["trust"], MAX_VALUE)  # unbounded for a body trained at rest
    arrays |= {
        "tool": np.array([TOOL_KINDS.index(each.tool) for each in snapshots], dtype="u1"),
        "state": np.array([ENGINE_STATES.index(each.state) for each in snapshots], dtype="u1"),
        "contact/start": np.cumsum([0, *(len(each.contact_nodes) for each in snapshots)], dtype="<i8"),
        "contact/nodes": np.concatenate([each.contact_nodes for each in snapshots]).astype("<i8"),
        "contact/forces": np.concatenate([each.contact_forces for each in snapshots]).astype("<f8").reshape(-1, 3),
    }
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise InputError(f"{name} of the recording must be finite, got other values; record a sound session")
    return arrays
