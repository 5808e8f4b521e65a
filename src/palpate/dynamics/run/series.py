"""Series of a run: each quantity of its frames once, for recorders, journals, trajectories and their files.

A record holds one frame, in the arrays of a journal: ``numbers`` are the series that every run has, and ``blade`` those
of a blade. Its ``contact_forces`` have no frame numbers, with which the rows of a trajectory begin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.sealed import Array

MAX_DISPLACEMENT = 1e30  # [m], so that sums of squares are finite
EVERY_RUN, WITH_TRUST, WITH_BOUNDS = "in every run", "with an error indicator", "with error bounds"
WITH_BLADE = "with a blade"


@dataclass(frozen=True)
class Series:
    """A quantity of the frames of a run."""

    array: Array  # as in a file; its first size is the number of frames
    exists: str = EVERY_RUN  # in which runs; its array is empty in others
    is_total: bool = False  # whether it counts from the start, so that a run that continues adds to it


def _energy(exists: str = EVERY_RUN, *, is_total: bool = False) -> Series:
    most = math.inf if exists == WITH_BLADE else Array.most
    return Series(Array(("frames",), most=most, unit="J"), exists, is_total)


def _positive(unit: str, exists: str) -> Series:
    return Series(Array(("frames",), low=0.0, most=math.inf, unit=unit), exists)


SERIES = {
    "times": Series(Array(("frames",), unit="s", rising=True)),
    "kinetic": _energy(),
    "strain": _energy(),
    "external": _energy(is_total=True),
    "dissipated": _energy(is_total=True),
    "steps": Series(Array(("frames",), rising=True), is_total=True),
    "displacements": Series(Array(("frames", "nodes", 3), most=MAX_DISPLACEMENT, unit="m")),
    "velocities": Series(Array(("frames", "nodes", 3), unit="m/s")),
    "trust": _positive("", WITH_TRUST),
    "displacement_bounds": _positive("m", WITH_BOUNDS),
    "force_bounds": _positive("N", WITH_BOUNDS),
    "cut_area": _positive("m^2", WITH_BLADE),
    "released_energy": _energy(WITH_BLADE),
    "edge_work": _energy(WITH_BLADE),
    "friction_work": _energy(WITH_BLADE),
    "release_rate": Series(Array(("frames",), most=math.inf, unit="J/m^2"), WITH_BLADE),
}
FIELD_NAMES = tuple(name for name, each in SERIES.items() if len(each.array.shape) > 1)  # stored frame by frame
NUMBER_NAMES = tuple(name for name, each in SERIES.items() if each.exists == EVERY_RUN and name not in FIELD_NAMES)
OPTIONAL_NAMES = tuple(name for name, each in SERIES.items() if each.exists != EVERY_RUN)
BLADE_NAMES = tuple(name for name, each in SERIES.items() if each.exists == WITH_BLADE)  # as `Outputs.blade`
# of each group or tool
GROUP_ARRAYS = {"reactions": Array(("frames", 3), unit="N"), "moments": Array(("frames", 3), unit="N m")}
LIST_ARRAYS = {
    "contact_forces": Array(("contacts", 5)),
    "bonded": Array(("contacts",), "|b1"),
    "cuts": Array(("triangles", 10)),
}


def joined_records(records: Sequence[Mapping[str, Any]], names: Mapping[str, Sequence[str]], nodes: int) -> Any:
    """Return the arrays of a trajectory of records, by their names in its file.

    `names` are those of groups and tools with reactions and moments, in the order of their rows.
    """
    numbers = _stack(records, "numbers", (len(NUMBER_NAMES),))
    data = {name: numbers[:, k].copy() for k, name in enumerate(NUMBER_NAMES)}
    data |= {name: _stack(records, name, (nodes, 3)) for name in FIELD_NAMES}
    for what, keys in names.items():
        forces = _stack(records, what, (len(keys), 3))
        data |= {array_name(what, key): forces[:, k].copy() for k, key in enumerate(keys)}
    data |= dict.fromkeys(OPTIONAL_NAMES, np.zeros(0))
    data["trust"] = np.concatenate([np.zeros(0), *(each["trust"] for each in records)])
    width = max((len(each["blade"]) for each in records), default=0)  # files of earlier versions have fewer
    if width:  # zeros before it cuts
        rows = np.array([each["blade"] if len(each["blade"]) else np.zeros(width) for each in records])
        data |= {name: rows[:, k].copy() for k, name in enumerate(BLADE_NAMES[:width])}
    numbered = [np.insert(each["contact_forces"], 0, k, axis=1) for k, each in enumerate(records)]
    data["contact_forces"] = np.concatenate([np.zeros((0, 5)), *numbered])
    data["cuts"] = np.concatenate([np.zeros((0, 10)), *(each["cuts"] for each in records)])
    return data | {"bonded": np.concatenate([np.zeros(0, dtype=np.bool_), *(each["bonded"] for each in records)])}


def _stack(records: Sequence[Mapping[str, Any]], name: str, shape: tuple[int, ...]) -> Floats:
    return np.stack([each[name] for each in records]) if records else np.zeros((0, *shape))


def array_name(what: str, key: str) -> str:
    """Return the HDF5 name of an array of a group or tool, without slashes and zero bytes."""
    if key in ("", ".", ".."):
        return f"{what}/%{key}"
    return f"{what}/{key.replace('%', '%25').replace('/', '%2F').replace(chr(0), '%00')}"
