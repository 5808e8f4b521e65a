"""What a session did, moment by moment, in one HDF5 file with the model in it, so that the file alone can be replayed.

Moments stand in datasets of their names; what the tools were is text in an attribute. With the file goes another one,
of the surface over time, that ParaView opens.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.export import write_vtkhdf
from palpate.app.view.snapshot import STATES, TOOLS, Snapshot
from palpate.faults import FileFormatError, InputError
from palpate.files import whole_file
from palpate.meshfree.cloud import Cloud
from palpate.reduction.reduced import ReducedModel
from palpate.reduction.storage import load
from palpate.reduction.surface import Surface

__all__ = ["EVERY", "Recorder", "Recording", "load_recording", "save_recording"]

Floats = NDArray[np.float64]

FORMAT, VERSION = "palpate recording", 1
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
        There is nothing in it.
    OSError
        A file cannot be written; names it.
    """
    import h5py

    if not recording.moments:
        raise InputError("the recording is empty")
    path.parent.mkdir(parents=True, exist_ok=True)
    moments = recording.moments
    with whole_file(path) as partial, h5py.File(partial, "w") as file:
        for name in NUMBERS:
            file[name] = np.array([getattr(moment, name) for moment in moments], dtype=float)
        file["wall"] = recording.times
        file["tool"] = np.array([TOOLS.index(moment.tool) for moment in moments], dtype="u1")
        file["state"] = np.array([STATES.index(moment.state) for moment in moments], dtype="u1")
        file["touched/start"] = np.cumsum([0, *(len(moment.nodes) for moment in moments)])
        file["touched/nodes"] = np.concatenate([moment.nodes for moment in moments])
        file["touched/forces"] = np.concatenate([moment.forces for moment in moments])
        file["model"] = np.frombuffer(_packed(recording.model), dtype="u1")
        _write_full(file, recording.full)
        file.attrs.update(
            format=FORMAT, version=VERSION, title=recording.title, tools=json.dumps(recording.tools),
            written=time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        )  # fmt: skip
    _write_surface(path.with_suffix(".vtkhdf"), recording)


def _packed(model: ReducedModel) -> bytes:
    with TemporaryDirectory() as folder:
        model.save(Path(folder) / "model.rom")
        return (Path(folder) / "model.rom").read_bytes()


def _write_full(file: Any, full: dict[str, Any]) -> None:
    if full:
        group = file.create_group("full")
        for name in ("times", "positions", "force"):
            group[name] = full[name]
        group.attrs["errors"] = json.dumps(full["errors"])


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
        It is no recording, or damaged.
    """
    import h5py

    if not path.is_file():
        raise FileNotFoundError(f"no recording at {path}")
    try:
        with h5py.File(path) as file:
            if file.attrs.get("format") != FORMAT:
                raise FileFormatError(f"{path} is no recording of `palpate view`")
            if int(file.attrs["version"]) != VERSION:
                raise FileFormatError(f"{path}: version {file.attrs['version']} of the format is not known here")
            numbers = {name: file[name][:] for name in (*NUMBERS, "wall", "tool", "state")}
            start, nodes, forces = (file[f"touched/{name}"][:] for name in ("start", "nodes", "forces"))
            model, title = file["model"][:].tobytes(), str(file.attrs["title"])
            tools, full = json.loads(file.attrs["tools"]), _read_full(file)
        moments = [_moment(numbers, k, nodes[a:b], forces[a:b]) for k, (a, b) in _spans(start, len(numbers["wall"]))]
    except (OSError, KeyError, ValueError, IndexError, TypeError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{path} cannot be read as a recording: {error}") from error
    with TemporaryDirectory() as folder:
        (Path(folder) / "model.rom").write_bytes(model)
        own = load(Path(folder) / "model.rom")
    if not moments or moments[0].coordinates.shape != (own.count,) or nodes.max(initial=-1) >= len(own._skin.nodes):
        raise FileFormatError(f"{path}: its moments do not fit its model")
    return Recording(title, own, numbers["wall"], moments, tools, full)


def _spans(start: NDArray[np.int64], count: int) -> list[tuple[int, tuple[int, int]]]:
    if len(start) != count + 1:
        raise ValueError(f"{len(start)} spans for {count} moments")
    return [(k, (int(start[k]), int(start[k + 1]))) for k in range(count)]


def _moment(numbers: dict[str, Any], k: int, nodes: NDArray[np.int64], forces: Floats) -> Snapshot:
    values: dict[str, Any] = {name: np.array(numbers[name][k]) for name in NUMBERS}
    for name in values:
        if values[name].ndim == 0:
            values[name] = int(values[name]) if name in ("steps", "sequence") else float(values[name])
    values |= {"nodes": nodes, "forces": forces, "tool": TOOLS[numbers["tool"][k]]}
    return Snapshot(**values, state=STATES[numbers["state"][k]])


def _read_full(file: Any) -> dict[str, Any]:
    if "full" not in file:
        return {}
    group = file["full"]
    return {
        **{name: group[name][:] for name in ("times", "positions", "force")},
        "errors": json.loads(group.attrs["errors"]),
    }
