"""What a session did, moment by moment, in one sealed HDF5 file with the model in it, so that the file can be replayed.

Numbers of moments stand in arrays of their names, the model's arrays under ``model/``. With the file goes another one,
of the surface over time, that ParaView opens.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.export import write_vtkhdf
from palpate.app.view.snapshot import STATES, TOOLS, Snapshot
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.files import plain, shortened
from palpate.meshfree.cloud import Cloud
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.realtime.display_surface import Surface
from palpate.reduction.storage.model_file import contents, model_of
from palpate.sealed import SealedFile, loading, open_sealed, write_sealed

__all__ = ["EVERY", "Recorder", "Recording", "load_recording", "save_recording"]

Floats = NDArray[np.float64]

FORMAT, VERSION = "palpate recording", 3
REMEDY = "record the session again"
LARGEST = 1e9  # of the numbers of a recording, in SI units
BEYOND = {"steps": 2.0**53, "sequence": 2.0**53, "stiffness": 1e30}  # where these may be larger
LONGEST_TITLE = 200  # characters
ERRORS = ("displacement", "largest", "force", "peak", "wall_seconds", "seconds")  # of a run of the full model
EVERY = 0.01  # [s] between moments
LONGEST = 600.0  # [s]
SHOWN_EVERY = 0.04  # [s] between moments in the file for ParaView
NUMBERS = tuple(f.name for f in fields(Snapshot) if f.name not in ("nodes", "forces", "tool", "state"))


@dataclass(frozen=True)
class Recording:
    """A session that was.

    Parameters
    ----------
    title : str
    model : ReducedModel
    times : (f,) array [s]
        Of the clock on the wall, from 0.
    moments : list of Snapshot
    tools : list of dict
        What the protocol tells of every tool that was chosen, with ``"frame"``, the first moment of it.
    full : dict
        What the full model did along the tool's path (`palpate.app.view.fullrun`); empty if it was not run.
    """

    title: str
    model: ReducedModel
    times: Floats
    moments: list[Snapshot]
    tools: list[dict[str, Any]]
    full: dict[str, Any]


class Recorder:
    """Keeps moments of a session in a thread of its own.

    Parameters
    ----------
    moment : function
        Returns the present moment, and what the protocol tells of the tool that was chosen then, from any thread.
    """

    def __init__(self, moment: Callable[[], tuple[Snapshot, dict[str, Any]]]) -> None:
        self._moment = moment
        self.times: list[float] = []
        self.moments: list[Snapshot] = []
        self.tools: list[dict[str, Any]] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="palpate recorder", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the recording."""
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        began, due = time.monotonic(), 0.0
        while not self._end.is_set() and due < LONGEST:
            now = time.monotonic() - began
            if now > LONGEST:  # the machine slept
                return
            moment, told = self._moment()
            told = {name: value for name, value in told.items() if name not in ("position", "quaternion", "held")}
            if not self.tools or any(self.tools[-1][name] != value for name, value in told.items()):
                self.tools.append({**told, "frame": len(self.times)})
            self.moments.append(moment)
            self.times.append(now)
            due = max(due + EVERY, now)
            self._end.wait(max(0.0, due - (time.monotonic() - began)))


def save_recording(path: Path, recording: Recording) -> None:
    """Write a recording, whole or not at all, and the surface for ParaView beside it.

    Raises
    ------
    InputError
        There is nothing in it, a number is not finite, or the name is that of a file for ParaView.
    OSError
        A file cannot be written; names it.
    """
    if not recording.moments:
        raise InputError("the recording is empty")
    if path.suffix == ".vtkhdf":
        raise InputError(f"a recording's name must not end in .vtkhdf, got {str(path)!r}: the file for ParaView has it")
    path.parent.mkdir(parents=True, exist_ok=True)
    moments, model = recording.moments, recording.model
    header, arrays = contents(model)
    arrays = {f"model/{name}": values for name, values in arrays.items()}
    arrays |= {name: np.array([getattr(moment, name) for moment in moments], dtype=float) for name in NUMBERS}
    arrays["trust"] = np.minimum(arrays["trust"], LARGEST)  # a body trained at rest has almost no reach
    arrays |= {
        "wall": np.array(recording.times, dtype=float),
        "tool": np.array([TOOLS.index(moment.tool) for moment in moments], dtype="u1"),
        "state": np.array([STATES.index(moment.state) for moment in moments], dtype="u1"),
        "touched/start": np.cumsum([0, *(len(moment.nodes) for moment in moments)], dtype="<i8"),
        "touched/nodes": np.concatenate([moment.nodes for moment in moments]).astype("<i8"),
        "touched/forces": np.concatenate([moment.forces for moment in moments]).astype("<f8"),
    }
    if recording.full:
        full = recording.full
        arrays |= {"full/times": np.array(full["times"], dtype=float), "full/force": np.array(full["force"], float)}
        arrays |= {"full/positions": np.array(full["positions"], dtype="<f4")}
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise InputError(f"{name} of the recording is not finite: {path} was not written")
    about = {
        "title": shortened(recording.title, LONGEST_TITLE), "tools": plain(recording.tools), "model": header,
        "errors": plain(recording.full["errors"]) if recording.full else None,
        "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }  # fmt: skip
    write_sealed(path, FORMAT, VERSION, about, arrays)
    _write_surface(path.with_suffix(".vtkhdf"), recording)


def _write_surface(path: Path, recording: Recording) -> None:
    """Write what of the surface moved and was strained to a file for ParaView, some 25 moments a second."""
    surface, cloud = Surface(recording.model), recording.model.cloud
    nothing = np.zeros(0, dtype=np.int64)
    drawn = Cloud(
        surface.rest.astype(float), cloud.volumes[surface.nodes], nothing, np.zeros((0, 3)), np.zeros(0), {},
        surface.triangles.astype(np.int64), cloud.spacing,
    )  # fmt: skip
    kept = [0]
    for k, at in enumerate(recording.times):
        if at >= recording.times[kept[-1]] + SHOWN_EVERY:
            kept.append(k)
    moved = [recording.moments[k].displacements(surface) for k in kept]
    shown: dict[str, Floats] = {"displacement": np.array(moved, dtype=float)}
    for name in surface.scalars[1:]:
        values = [recording.moments[k].scalar(surface, name, m) for k, m in zip(kept, moved, strict=True)]
        shown[name] = np.array(values, dtype=float)
    write_vtkhdf(path, drawn, recording.times[kept], shown)


def load_recording(path: Path) -> Recording:
    """Read a recording.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileFormatError
        It is not a recording, damaged, or holds what no session leaves.
    """
    with loading(path, REMEDY):
        file = open_sealed(path, FORMAT, VERSION)
        return recording_of(file)


def recording_of(file: SealedFile) -> Recording:
    """Return the recording in a file.

    Raises
    ------
    InputError
        A value is missing, or none that a session leaves.
    """
    header = file.header
    if header.keys() != {"title", "tools", "model", "errors", "written"} or not isinstance(header["model"], dict):
        raise InputError("the header is not that of a recording")
    if not isinstance(header["title"], str) or len(header["title"]) > LONGEST_TITLE:
        raise InputError(f"title must be text of at most {LONGEST_TITLE} characters")
    own = {name: file.read(name) for name in file.arrays if not name.startswith("model/")}
    model = model_of(header["model"], file, "model/")
    frames = len(own["wall"]) if "wall" in own and own["wall"].ndim else 0
    shapes = _shapes(model, frames, header["errors"] is not None)
    if own.keys() != shapes.keys() or not frames:
        raise InputError(f"the arrays are {', '.join(sorted(own))}; expected {', '.join(sorted(shapes))}, of moments")
    sizes: dict[str, int] = {}
    for name, (kind, shape) in shapes.items():
        wanted = tuple(sizes.setdefault(each, found) if isinstance(each, str) else each
                       for each, found in zip(shape, own[name].shape, strict=False))  # fmt: skip
        if own[name].ndim != len(shape) or own[name].shape != wanted or own[name].dtype != kind:
            raise InputError(f"array {name} has shape {own[name].shape} of {own[name].dtype.str}, expected {shape}")
        most = BEYOND.get(name, LARGEST)
        if not (np.abs(own[name]) <= most).all():
            raise InputError(f"array {name} holds numbers that are not finite, or beyond {most:g}")
    _check_numbers(own, len(model._contact_surface.nodes))
    tools = checked_tools(header["tools"], frames)
    start, nodes, forces = (own[f"touched/{name}"] for name in ("start", "nodes", "forces"))
    moments = [_moment(own, k, nodes[start[k] : start[k + 1]], forces[start[k] : start[k + 1]]) for k in range(frames)]
    return Recording(header["title"], model, own["wall"], moments, tools, _full(own, header["errors"]))


def _shapes(model: ReducedModel, frames: int, full: bool) -> dict[str, tuple[str, tuple[int | str, ...]]]:
    """Return type and shape of the arrays of a recording; sizes by name are free, but each is the same everywhere."""
    wide = {"force": (3,), "moment": (3,), "hand": (3,), "position": (3,), "quaternion": (4,), "stiffness": (3, 3)}
    wide |= {"coordinates": (model.count,)}
    shapes: dict[str, tuple[str, tuple[int | str, ...]]] = {
        name: ("<f8", (frames, *wide.get(name, ()))) for name in NUMBERS
    }
    shapes |= {"wall": ("<f8", (frames,)), "tool": ("|u1", (frames,)), "state": ("|u1", (frames,))}
    shapes |= {"touched/start": ("<i8", (frames + 1,)), "touched/nodes": ("<i8", ("touched",))}
    shapes |= {"touched/forces": ("<f8", ("touched", 3))}
    if full:
        shapes |= {"full/times": ("<f8", ("full",)), "full/force": ("<f8", ("full", 3))}
        shapes |= {"full/positions": ("<f4", ("full", len(Surface(model).rest), 3))}
    return shapes


def _check_numbers(own: dict[str, Any], contactable: int) -> None:
    """Refuse numbers that no session leaves."""
    for name in ("wall", "time", "steps", "sequence", "trust", "computing"):
        if np.any(own[name] < 0):
            raise InputError(f"{name} must not be negative")
    for name in ("steps", "sequence"):
        if np.any(own[name] != np.floor(own[name])):
            raise InputError(f"{name} must hold whole numbers")
    if np.any(np.diff(own["wall"]) < 0) or own["wall"][-1] > LONGEST or np.any(own["firmness"] <= 0):
        raise InputError(f"wall must not decrease or pass {LONGEST:g} s, and firmness must be positive")
    if np.any(np.abs(np.linalg.norm(own["quaternion"], axis=1) - 1) > 1e-3):
        raise InputError("quaternion must have length 1")
    if own["tool"].max() >= len(TOOLS) or own["state"].max() >= len(STATES):
        raise InputError(f"tool and state must be numbers below {len(TOOLS)} and {len(STATES)}")
    start, nodes = own["touched/start"], own["touched/nodes"]
    if start[0] != 0 or start[-1] != len(nodes) or np.any(np.diff(start) < 0):
        raise InputError("touched/start does not share out touched/nodes")
    if np.any((nodes < 0) | (nodes >= contactable)):
        raise InputError(f"touched/nodes names nodes outside 0..{contactable - 1}")
    if "full/times" in own and (not len(own["full/times"]) or np.any(np.diff(own["full/times"]) < 0)):
        raise InputError("full/times must not be empty or decrease")


def checked_tools(tools: Any, frames: int) -> list[dict[str, Any]]:
    """Return what a file says of the tools; refuse what no session says.

    Raises
    ------
    InputError
        A tool that is none, or first moments that do not increase from 0.
    """
    if not isinstance(tools, list) or not tools or not all(isinstance(tool, dict) for tool in tools):
        raise InputError("tools must be a list of tools")
    for tool in tools:
        if tool.keys() != {"kind", "radius", "length", "friction", "stiffness", "frame"} or tool["kind"] not in TOOLS:
            raise InputError(f"tools holds {tool!r:.80}, which is not a tool")
        for name, most in (("radius", 1.0), ("length", 1.0), ("friction", 2.0)):
            number_in_range(f"{name} of a tool", tool[name], 0.0, most)
        if tool["stiffness"] is not None:
            number_in_range("stiffness of a tool", tool["stiffness"], 0.0, LARGEST, open_low=True, unit="N/m")
        integer_in_range("frame of a tool", tool["frame"], 0, frames - 1)
    first = [tool["frame"] for tool in tools]
    if first[0] != 0 or any(b <= a for a, b in pairwise(first)):
        raise InputError("the first moments of tools must increase from 0")
    return tools


def _moment(numbers: dict[str, Any], k: int, nodes: NDArray[np.int64], forces: Floats) -> Snapshot:
    values: dict[str, Any] = {name: np.array(numbers[name][k]) for name in NUMBERS}
    for name in values:
        if values[name].ndim == 0:
            values[name] = int(values[name]) if name in ("steps", "sequence") else float(values[name])
    values |= {"nodes": nodes, "forces": forces, "tool": TOOLS[numbers["tool"][k]]}
    return Snapshot(**values, state=STATES[numbers["state"][k]])


def _full(own: dict[str, Any], errors: Any) -> dict[str, Any]:
    """Return what the full model did; empty where it was not run."""
    if errors is None:
        return {}
    if not isinstance(errors, dict) or errors.keys() != {*ERRORS}:
        raise InputError(f"errors must have {', '.join(ERRORS)}")
    told = {name: number_in_range(f"{name} of errors", errors[name], -LARGEST, LARGEST) for name in ERRORS}
    return {**{name: own[f"full/{name}"] for name in ("times", "positions", "force")}, "errors": told}
