"""Arrays of snapshots, by the names that they have in a recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.recordings.snapshot import ENGINE_STATES, SNAPSHOT_FIELDS, TOOL_KINDS, Snapshot
from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.core.sealed import MIN_POSITIVE, Array, typed
from palpate.dynamics.nodal.model import NodalModel
from palpate.reduction.hyper.model import ReducedModel

FORMAT, VERSION, OLDER_VERSIONS = "palpate recording", 4, (3,)
MAX_TITLE_LENGTH = 200  # characters
MAX_VALUE = 1e9  # of the arrays of a recording, in SI units
MAX_DURATION = 600.0  # [s]
MAX_COUNT = 2.0**53  # larger numbers are not all whole ones

_Array = partial(Array, most=MAX_VALUE)


def _arrays(sizes: tuple[str, ...], **limits: tuple[float, float]) -> dict[str, Array]:
    """Return the declarations of `SNAPSHOT_FIELDS` by name, for each entry of some sizes.

    The limits are the least number, and the largest size of a number.
    """
    declared = {}
    for name, (low, most) in limits.items():
        _, unit, shape, kind = SNAPSHOT_FIELDS[name]
        declared[name] = Array((*sizes, *shape), kind, low, most, unit)
    return declared


ANY_NUMBER, NOT_NEGATIVE, WHOLE_NUMBER = (-math.inf, MAX_VALUE), (0.0, MAX_VALUE), (0.0, MAX_COUNT)
SNAPSHOT_ARRAYS = _arrays(
    ("snapshots",), time=NOT_NEGATIVE, steps=WHOLE_NUMBER, trust=NOT_NEGATIVE, kinetic=ANY_NUMBER, strain=ANY_NUMBER,
    computing=NOT_NEGATIVE, lateness=ANY_NUMBER,
)  # fmt: skip
SNAPSHOT_ARRAYS |= {
    "coordinates": _Array(("snapshots", "coordinates")),
    "modulus_ratio": _Array(("snapshots",), low=MIN_POSITIVE),
}
TOOL_ARRAYS = _arrays(  # of `ToolSnapshot`, under ``tools/``
    ("snapshots", "tools"), force=ANY_NUMBER, moment=ANY_NUMBER, stiffness=(-math.inf, 1e30), position=ANY_NUMBER,
    quaternion=ANY_NUMBER, sequence=WHOLE_NUMBER, device_force=ANY_NUMBER, kind=(0, len(TOOL_KINDS) - 1),
    pinned=ANY_NUMBER,
)  # fmt: skip
STATE_ARRAY = _arrays(("snapshots",), state=(0, len(ENGINE_STATES) - 1))
CONTACT_ARRAYS = {
    "contact/start": Array(("parts",), "<i8", low=0, rising=True),
    "contact/nodes": Array(("contacts",), "<i8", index_of="surface"),
    "contact/forces": _Array(("contacts", 3), unit="N"),
    "contact/tools": Array(("contacts",), "|u1", index_of="tools"),
}
WALL_ARRAY = {"wall": Array(("snapshots",), low=0.0, most=MAX_DURATION, unit="s", rising=True)}
CUT_ARRAYS = {
    "cuts/start": Array(("cuts",), "<i8", index_of="snapshots"),
    "cuts/kept": _Array(("cuts",), "<i8", low=0),
    "cuts/count": _Array(("cuts",), "<i8", low=0),
    "cuts/triangles": _Array(("cut triangles", 3, 3), unit="m"),
}
FULL_ARRAYS = {
    "full/times": _Array(("full",), unit="s", rising=True),
    "full/force": _Array(("full", "tools", 3), unit="N"),
    "full/positions": _Array(("full", "vertices", 3), "<f4", unit="m"),
}


def coordinates_type(model: ReducedModel | NodalModel) -> str:
    """Return the type of coordinates in a recording: nodal displacements of a full body have single precision."""
    return "<f8" if isinstance(model, ReducedModel) else "<f4"


def recorded_arrays(model: ReducedModel | NodalModel, cuts: bool = False, full: bool = False) -> dict[str, Array]:
    """Return the arrays of a recording."""
    coordinates = replace(SNAPSHOT_ARRAYS["coordinates"], type=coordinates_type(model))
    tools = {f"tools/{name}": each for name, each in TOOL_ARRAYS.items()}
    declared = SNAPSHOT_ARRAYS | {"coordinates": coordinates} | tools | STATE_ARRAY | CONTACT_ARRAYS | WALL_ARRAY
    return declared | (CUT_ARRAYS if cuts else {}) | (FULL_ARRAYS if full else {})


def snapshot_arrays(
    times: Sequence[float] | Floats, snapshots: Sequence[Snapshot], model: ReducedModel | NodalModel
) -> dict[str, NDArray[Any]]:
    """Return the arrays of at least one snapshot of a body at times [s] since the start."""
    values: dict[str, Any] = {name: [getattr(each, name) for each in snapshots] for name in SNAPSHOT_ARRAYS}
    values["trust"] = np.minimum(values["trust"], MAX_VALUE)  # unbounded for a body trained at rest
    tools = [each.tools for each in snapshots]
    values |= {f"tools/{name}": [[getattr(tool, name) for tool in each] for each in tools] for name in TOOL_ARRAYS}
    values |= {
        "tools/kind": [[TOOL_KINDS.index(tool.kind) for tool in each] for each in tools],
        "state": [ENGINE_STATES.index(each.state) for each in snapshots],
        "contact/start": np.cumsum([0, *(len(each.contact_nodes) for each in snapshots)]),
        "contact/nodes": np.concatenate([each.contact_nodes for each in snapshots]),
        "contact/forces": np.concatenate([each.contact_forces for each in snapshots]).reshape(-1, 3),
        "contact/tools": np.concatenate([each.contact_tools for each in snapshots]),
        "wall": times,
    }
    arrays = typed(values, recorded_arrays(model))
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"{name} of the recording must be finite, got other values; record a sound session")
    return arrays


def upgraded_arrays(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a recording of version 3, which has one tool, as those of the present version."""
    if "tool" not in arrays:
        return arrays
    result = {("kind" if name == "tool" else name): values for name, values in arrays.items()}
    count, contacts = len(result["kind"]), len(result.get("contact/nodes", ()))
    result |= {"pinned": np.zeros(count, dtype="|b1"), "contact/tools": np.zeros(contacts, dtype="|u1")}
    if "full/force" in result:
        result["full/force"] = result["full/force"][:, None]
    one_tool = {f"tools/{name}": result.pop(name)[:, None] for name in TOOL_ARRAYS if name in result}
    return result | one_tool
