"""A recorder of the frames of a run, in memory and in a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.sealed import typed
from palpate.dynamics.run.journal import Journal
from palpate.dynamics.run.model import Outputs
from palpate.dynamics.run.series import FIELD_NAMES, GROUP_ARRAYS, NUMBER_NAMES, joined_records
from palpate.dynamics.run.trajectory import MESH_ARRAYS, Trajectory, from_arrays
from palpate.meshfree.cloud import Cloud

Bounds = Callable[[Trajectory], tuple[Floats, Floats]]


class Recorder:
    """A collector of the frames of a run, with an optional file.

    During the run the file is a journal (`palpate.dynamics.run.journal`), which survives an interruption of the
    program. `close` replaces it with the HDF5 file of the trajectory. For the label see `Trajectory`.
    """

    def __init__(self, path: Path | None, model: str, cloud: Cloud, stiffness_damping: float, label: str = "") -> None:
        self.path, self.model, self.label = path, model, label
        self.stiffness_damping = float(stiffness_damping)
        self._mesh = typed({"points": cloud.points, "triangles": cloud.triangles}, MESH_ARRAYS)
        self.frames: list[dict[str, Any]] = []
        self._names: dict[str, list[str]] = {name: [] for name in GROUP_ARRAYS}
        self._former: Outputs | None = None
        self._journal: Journal | None = None
        if path is not None:
            with _write_errors(path):
                if path.exists() and not path.is_file():
                    raise OSError("it exists and is not a regular file")
                self._journal = Journal(path)

    def add(self, time: float, steps: int, frame: Outputs) -> None:
        """Append a frame."""
        record = _record(len(self.frames), time, steps, frame, self._former)
        if not self.frames:
            self._names = {name: list(getattr(frame, name)) for name in GROUP_ARRAYS}
        self.frames.append(record)
        self._former = frame
        if self._journal is None or self.path is None:
            return
        with _write_errors(self.path):
            if len(self.frames) == 1:
                about = {name: getattr(self, name) for name in ("model", "label", "stiffness_damping")}
                self._journal.add(about | self._names, self._mesh)
            self._journal.add({}, record)
            if len(self.frames) == 1:
                self._journal.rename(self.path)

    def close(self, wall_seconds: float, complete: bool, bounds: Bounds | None = None) -> Trajectory:
        """Finish the file, and return the trajectory, with error bounds by a function of it."""
        header: dict[str, Any] = {"wall_seconds": wall_seconds, "complete": complete}
        header |= {name: getattr(self, name) for name in ("model", "label", "stiffness_damping")} | self._names
        data = joined_records(self.frames, self._names, len(self._mesh["points"])) | self._mesh
        run = from_arrays(header, data)
        if bounds is not None:
            displacement, force = bounds(run)
            run = replace(run, displacement_bounds=displacement, force_bounds=force)
        if self._journal is not None and self.path is not None:
            self._journal.close()
            run.save(self.path)
        return run


def _record(number: int, time: float, steps: int, frame: Outputs, former: Outputs | None) -> dict[str, Any]:
    """Return the record of a frame that follows another one."""
    numbers = {"times": time, "steps": steps} | {n: getattr(frame, n) for n in NUMBER_NAMES if hasattr(frame, n)}
    arrays: dict[str, Any] = {"numbers": [numbers[name] for name in NUMBER_NAMES]}
    arrays |= {name: getattr(frame, name) for name in (*FIELD_NAMES, "contact_forces")}
    arrays |= {name: np.reshape(list(getattr(frame, name).values()), (-1, 3)) for name in GROUP_ARRAYS}
    arrays["trust"] = [] if frame.trust is None else [frame.trust]
    arrays |= {"blade": frame.blade, "cuts": np.insert(_new_cuts(frame, former), 0, number, axis=1)}
    arrays = {name: np.asarray(values, dtype=float) for name, values in arrays.items()}
    return arrays | {"bonded": np.asarray(frame.bonded, dtype=np.bool_)}


def _new_cuts(frame: Outputs, former: Outputs | None) -> Floats:
    """Return the corners (c, 9) of the triangles that a frame has and the one before has not."""
    corners = frame.cut_triangles.reshape(-1, 9)
    if former is None:
        return corners
    before = former.cut_triangles.reshape(-1, 9)
    common = min(len(corners), len(before))
    differs = np.flatnonzero(np.any(corners[:common] != before[:common], axis=1))
    return corners[differs[0] if differs.size else common :]


@contextmanager
def _write_errors(path: Path) -> Iterator[None]:
    """Name the file and a remedy in errors of writing."""
    try:
        yield
    except OSError as error:
        why = error.strerror or error
        raise OSError(
            f"cannot write {path}: {why}; choose another folder or free some space; frames written before are kept"
        ) from error
