"""Recordings of sessions: one sealed HDF5 file with the snapshots and the model, so that it can be replayed.

The values of the snapshots are in arrays of their names; the model's arrays are under ``model/``. A second file, for
ParaView, has the surface over time.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.app.recordings.recording_journal import read_journal
from palpate.app.recordings.snapshot import ENGINE_STATES, TOOL_KINDS, Snapshot, ToolSnapshot
from palpate.app.recordings.snapshot_arrays import (
    CUT_ARRAYS,
    FORMAT,
    FULL_ARRAYS,
    MAX_DURATION,
    MAX_TITLE_LENGTH,
    MAX_VALUE,
    OLDER_VERSIONS,
    SNAPSHOT_ARRAYS,
    TOOL_ARRAYS,
    VERSION,
    recorded_arrays,
    snapshot_arrays,
    upgraded_arrays,
)
from palpate.core.arrays import Floats
from palpate.core.faults import InputError, integer_in_range, number_in_range
from palpate.core.files import plain, regular_file, shortened
from palpate.core.sealed import ArrayFile, check_arrays, loading, open_sealed, typed, write_sealed
from palpate.core.vtk import write_vtkhdf
from palpate.dynamics.contact.shapes import tool_parameters
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.journal import is_journal
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.cut.surface import is_narrow
from palpate.realtime.bodies.full_surface import display_surface
from palpate.realtime.contract import MAX_TOOLS
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.solid import body_contents, body_in

__all__ = [
    "ERROR_NAMES", "FORMAT", "MAX_DURATION", "RECORDING_INTERVAL", "VERSION", "Recording", "SurfaceFileError",
    "load_recording", "read_recording", "save_recording", "validate_tools",
]  # fmt: skip


RECORDING_REMEDY = "record the session again"
ERROR_NAMES = ("displacement", "largest", "force", "peak", "wall_seconds", "seconds")  # of the replay on the full model
TOOL_FIELDS = {"kind", "radius", "length", "friction", "stiffness", "start", "index"}  # and some of `TOOLS`
RECORDING_INTERVAL = 0.01  # [s] between snapshots
VTKHDF_INTERVAL = 0.04  # [s] between snapshots in the file for ParaView


class SurfaceFileError(OSError):
    """The file for ParaView cannot be written; the recording was."""


class Cut(NamedTuple):
    """A change of the cut of a body."""

    start: int  # index of the first snapshot of the body that is cut so
    kept: int  # number of triangles that stay
    triangles: Floats  # (t, 3, 3) array [m]: those that follow them


@dataclass(frozen=True)
class Recording:
    """A recorded session."""

    title: str
    model: ReducedModel | NodalModel  # the reduced model or the full body of the session
    times: Floats  # (f,) array [s]: wall-clock time, from 0
    snapshots: list[Snapshot]  # snapshots at these times
    # descriptions of the selected tools, with ``"index"``, and ``"start"``, the number of the first snapshot of each
    tools: list[dict[str, Any]]
    # result of `palpate.app.session.full_model_replay.replay_on_full_model`; empty without such a run
    full: dict[str, Any]
    cuts: list[Cut] = field(default_factory=list)  # changes of the cut of a full body, in the order of their snapshots

    def tool_at(self, frame: int, index: int = 0) -> dict[str, Any]:
        """Return the description of the tool of an index that is selected at a snapshot."""
        return [tool for tool in self.tools if tool["index"] == index and tool["start"] <= frame][-1]


def save_recording(path: Path, recording: Recording) -> None:
    """Write a recording atomically, and next to it the file with its surface for ParaView."""
    if not recording.snapshots:
        raise InputError("recording must have at least one snapshot, got none; record for longer")
    if path.suffix == ".vtkhdf":
        raise InputError(f"path must not end in .vtkhdf, got {str(path)!r}; use .h5")
    path.parent.mkdir(parents=True, exist_ok=True)
    snapshots, model = recording.snapshots, recording.model
    header, arrays = body_contents(model)
    arrays = {f"model/{name}": values for name, values in arrays.items()}
    arrays |= snapshot_arrays(recording.times, snapshots, model)
    if recording.cuts:
        arrays |= _cut_arrays(recording.cuts)
    if recording.full:
        arrays |= typed({name: recording.full[name.removeprefix("full/")] for name in FULL_ARRAYS}, FULL_ARRAYS)
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise InputError(f"{name} of the recording must be finite, got other values; {path} was not written")
    header_fields = {
        "title": shortened(recording.title, MAX_TITLE_LENGTH), "tools": plain(recording.tools), "model": header,
        "errors": plain(recording.full["errors"]) if recording.full else None,
        "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }  # fmt: skip
    write_sealed(path, FORMAT, VERSION, header_fields, arrays, deflate=True)
    try:
        _write_surface(path.with_suffix(".vtkhdf"), recording)
    except (InputError, OSError) as error:
        raise SurfaceFileError(str(error)) from error


def _write_surface(path: Path, recording: Recording) -> None:
    """Write the displacements and scalars of the surface to a file for ParaView, 25 snapshots a second."""
    surface = display_surface(recording.model)
    chosen = [0]
    for k, at in enumerate(recording.times):
        if at >= recording.times[chosen[-1]] + VTKHDF_INTERVAL:
            chosen.append(k)
    displacements = [recording.snapshots[k].displacements(surface) for k in chosen]
    shown: dict[str, Floats] = {"displacement": np.array(displacements, dtype=float)}
    for name in surface.scalars[1:]:
        values = [recording.snapshots[k].scalar(surface, name, m) for k, m in zip(chosen, displacements, strict=True)]
        shown[name] = np.array(values, dtype=float)
    points, triangles = surface.rest.astype(float), surface.triangles.astype(np.int64)
    write_vtkhdf(path, points, triangles, recording.times[chosen], shown)


def load_recording(path: Path) -> Recording:
    """Load a recording, or the complete snapshots of an interrupted one."""
    with loading(path, RECORDING_REMEDY):
        regular_file(path, "recording")
        if is_journal(path):
            return read_recording(read_journal(path))
        return read_recording(open_sealed(path, FORMAT, VERSION, OLDER_VERSIONS))


def read_recording(file: ArrayFile) -> Recording:
    """Return the recording in an open file."""
    header = file.header
    if header.keys() != {"title", "tools", "model", "errors", "written"} or not isinstance(header["model"], dict):
        raise InputError(f"header must be that of a recording, got {', '.join(header)!r:.80}")
    if not isinstance(header["title"], str) or len(header["title"]) > MAX_TITLE_LENGTH:
        raise InputError(f"title must be text of at most {MAX_TITLE_LENGTH} characters, got {header['title']!r:.80}")
    arrays = upgraded_arrays({name: file.read(name) for name in file.arrays if not name.startswith("model/")})
    model = body_in(header["model"], file, "model/")
    count = len(arrays["wall"]) if "wall" in arrays and arrays["wall"].ndim else 0
    sizes = {
        "snapshots": count,
        "parts": count + 1,
        "coordinates": model.count if isinstance(model, ReducedModel) else 3 * len(model.cloud),
        "surface": len(model.body.surface.nodes if isinstance(model, ReducedModel) else model.cloud),
        "vertices": len(display_surface(model).rest) if header["errors"] is not None else 0,
    }
    if getattr(arrays.get("tools/kind"), "ndim", 0) == 2:  # another one is refused below
        sizes["tools"] = min(max(arrays["tools/kind"].shape[1], 1), MAX_TOOLS)
    check_arrays(arrays, recorded_arrays(model, "cuts/start" in arrays, header["errors"] is not None), sizes)
    _require(count, "wall", "of at least one snapshot", "none")
    _check_values(arrays)
    tools = validate_tools(header["tools"], count, sizes["tools"])
    parts = [slice(first, last) for first, last in pairwise(arrays["contact/start"])]
    snapshots = [_snapshot(arrays, k, part) for k, part in enumerate(parts)]
    return Recording(header["title"], model, arrays["wall"], snapshots, tools, _full(arrays, header["errors"]),
                     _cuts(arrays, model))  # fmt: skip


def _cut_arrays(cuts: list[Cut]) -> dict[str, Any]:
    """Return the arrays of a recording for its cuts."""
    values = {
        "cuts/start": [cut.start for cut in cuts],
        "cuts/kept": [cut.kept for cut in cuts],
        "cuts/count": [len(cut.triangles) for cut in cuts],
        "cuts/triangles": np.concatenate([np.zeros((0, 3, 3)), *(cut.triangles for cut in cuts)]),
    }
    return typed(values, CUT_ARRAYS)


def _cuts(arrays: dict[str, Any], model: Any) -> list[Cut]:
    """Return the cuts in the arrays of a file; raise InputError for those that no session writes."""
    if "cuts/start" not in arrays:
        return []
    start, kept, count = (arrays[f"cuts/{name}"] for name in ("start", "kept", "count"))
    _require(isinstance(model, EnergySolid), "model", "a full body for cuts", "another")
    _require(np.all(np.diff(start) > 0), "cuts/start", "increasing indices of snapshots", "others")
    _require(
        not is_narrow(arrays["cuts/triangles"], model.cloud.spacing).any(), "cuts/triangles", "wide", "narrow ones"
    )
    parts = np.cumsum(count)
    total = parts[-1] if len(parts) else 0
    _require(total == len(arrays["cuts/triangles"]), "cuts/count", "numbers of the triangles", "others")
    cuts, total = [], 0
    for first, stay, last, number in zip(start, kept, parts, count, strict=True):
        _require(stay <= total, "cuts/kept", f"at most {total}", str(stay))
        cuts.append(Cut(int(first), int(stay), arrays["cuts/triangles"][last - number : last]))
        total = int(stay + number)
    return cuts


def _check_values(arrays: dict[str, Any]) -> None:
    """Raise InputError for values that no session writes."""
    for name in ("steps", "tools/sequence"):
        _require(not np.any(arrays[name] != np.floor(arrays[name])), name, "whole numbers", "fractions")
    length = np.linalg.norm(arrays["tools/quaternion"], axis=2)
    _require(not np.any(np.abs(length - 1) > 1e-3), "tools/quaternion", "of length 1", "other lengths")
    start, nodes = arrays["contact/start"], arrays["contact/nodes"]
    _require(start[0] == 0 and start[-1] == len(nodes), "contact/start", "a partition of contact/nodes", "others")
    if "full/times" in arrays:
        _require(len(arrays["full/times"]), "full/times", "non-empty", "no times")


def _require(condition: Any, name: str, requirement: str, got: str) -> None:
    if not condition:
        raise InputError(f"{name} must be {requirement}, got {got}")


def validate_tools(tools: Any, count: int, indices: int) -> list[dict[str, Any]]:
    """Return the tools of a file with a number of snapshots and of tools in each."""
    if not isinstance(tools, list) or not tools or not all(isinstance(tool, dict) for tool in tools):
        raise InputError(f"tools must be a list of tools, got {tools!r:.80}")
    parameters = tool_parameters()
    for tool in tools:
        known = TOOL_FIELDS | parameters.keys()
        tool.setdefault("index", 0)  # of version 3
        if not TOOL_FIELDS <= tool.keys() <= known or tool["kind"] not in TOOL_KINDS:
            raise InputError(f"each entry of tools must be a tool, got {tool!r:.80}")
        number_in_range("friction of a tool", tool["friction"], 0.0, 2.0)
        if tool["stiffness"] is not None:
            number_in_range("stiffness of a tool", tool["stiffness"], 0.0, MAX_VALUE, open_low=True, unit="N/m")
        for name, (about, _) in parameters.items():  # 0 of a tool without it, none in files of earlier versions
            if name in TOOL_FIELDS or tool.setdefault(name, None) is not None:
                most = 1.0 if about["unit"] == "m" else about["high"]
                number_in_range(f"{name} of a tool", tool[name], 0.0, most, unit=about["unit"])
        integer_in_range("start of a tool", tool["start"], 0, count - 1)
        integer_in_range("index of a tool", tool["index"], 0, indices - 1)
    for index in range(indices):
        starts = [tool["start"] for tool in tools if tool["index"] == index]
        if not starts or starts[0] != 0 or any(b <= a for a, b in pairwise(starts)):
            raise InputError(f"starts of tools of index {index} must increase from 0, got {starts!r:.80}")
    return tools


def _snapshot(arrays: dict[str, Any], k: int, part: slice) -> Snapshot:
    """Return a snapshot of the arrays of a file, with a part of the contacts."""
    values: dict[str, Any] = {name: _entry(arrays[name], k) for name in SNAPSHOT_ARRAYS}
    values |= {f"contact_{name}": arrays[f"contact/{name}"][part] for name in ("nodes", "forces", "tools")}
    values |= {"steps": int(values["steps"]), "state": ENGINE_STATES[arrays["state"][k]]}
    tools = []
    for index in range(arrays["tools/kind"].shape[1]):
        tool = {name: _entry(arrays[f"tools/{name}"], (k, index)) for name in TOOL_ARRAYS}
        tool |= {"sequence": int(tool["sequence"]), "kind": TOOL_KINDS[tool["kind"]]}
        tools.append(ToolSnapshot(**tool))
    return Snapshot(**values, tools=tuple(tools))


def _entry(values: NDArray[Any], at: Any) -> Any:
    """Return an entry of an array: a copy of an array, or a number of Python."""
    entry = values[at]
    return entry.copy() if entry.ndim else entry.item()


def _full(arrays: dict[str, Any], errors: Any) -> dict[str, Any]:
    """Return the results of the full model; empty without a run."""
    if errors is None:
        return {}
    if not isinstance(errors, dict) or errors.keys() != {*ERROR_NAMES}:
        raise InputError(f"errors must have the fields {', '.join(ERROR_NAMES)}, got {errors!r:.80}")
    values = {name: number_in_range(f"{name} of errors", errors[name], -MAX_VALUE, MAX_VALUE) for name in ERROR_NAMES}
    return {**{name: arrays[f"full/{name}"] for name in ("times", "positions", "force")}, "errors": values}
