"""A recorder of the frames of a run, in memory and in a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.run.journal import Journal
from palpate.dynamics.run.model import Outputs
from palpate.dynamics.run.trajectory import FRAME_ARRAYS, GROUP_ARRAYS, SERIES_NAMES, Trajectory, blade_series, stack

__all__ = ["Recorder"]

Bounds = Callable[[Trajectory], tuple[Floats, Floats]]


class Recorder:
    """A collector of the frames of a run, with an optional file.

    During the run the file is a journal (`palpate.dynamics.run.journal`), which survives an
    interruption of the program. `close` replaces it with the HDF5 file of the trajectory.

    Parameters
    ----------
    points : (n, d) array [m]
    stiffness_damping : float [s]
    label : str
        See `Trajectory`.
    """

    def __init__(
        self, path: Path | None, model: str, points: Floats, stiffness_damping: float, label: str = ""
    ) -> None:
        self.path, self.model, self.label = path, model, label
        self.points, self.stiffness_damping = points, float(stiffness_damping)
        self.times: list[float] = []
        self.steps: list[int] = []
        self.frames: list[Outputs] = []
        self._journal: Journal | None = None
        if path is not None:
            with _write_errors(path):
                if path.exists() and not path.is_file():
                    raise OSError("it exists and is not a regular file")
                self._journal = Journal(path)

    def add(self, time: float, steps: int, frame: Outputs) -> None:
        """Append a frame."""
        self.times.append(time)
        self.steps.append(steps)
        self.frames.append(frame)
        if self._journal is None or self.path is None:
            return
        with _write_errors(self.path):
            if len(self.times) == 1:
                about = {"model": self.model, "label": self.label, "stiffness_damping": self.stiffness_damping}
                names = {"reactions": list(frame.reactions), "moments": list(frame.moments)}
                self._journal.add(about | names, {"points": np.asarray(self.points, dtype=float)})
            numbers = {"times": time, "steps": steps} | {
                n: getattr(frame, n) for n in SERIES_NAMES if hasattr(frame, n)
            }
            arrays: dict[str, Any] = {"numbers": [numbers[name] for name in SERIES_NAMES]}
            arrays |= {name: getattr(frame, name) for name in (*FRAME_ARRAYS, "contact_forces")}
            arrays |= {name: np.reshape(list(getattr(frame, name).values()), (-1, 3)) for name in GROUP_ARRAYS}
            arrays["trust"] = [] if frame.trust is None else [frame.trust]
            arrays |= {"blade": frame.blade, "cuts": _new_cuts(self.frames, len(self.frames) - 1)}
            arrays = {name: np.asarray(values, dtype=float) for name, values in arrays.items()}
            self._journal.add({}, arrays | {"bonded": np.asarray(frame.bonded, dtype=np.bool_)})
            if len(self.times) == 1:
                self._journal.rename(self.path)

    def close(self, wall_seconds: float, complete: bool, bounds: Bounds | None = None) -> Trajectory:
        """Finish the file, and return the trajectory, with error bounds by a function of it."""
        run = self._trajectory(wall_seconds, complete)
        if bounds is not None:
            displacement, force = bounds(run)
            run = replace(run, displacement_bounds=displacement, force_bounds=force)
        if self._journal is not None and self.path is not None:
            self._journal.close()
            run.save(self.path)
        return run

    def _trajectory(self, wall_seconds: float, complete: bool) -> Trajectory:
        frames, n = self.frames, len(self.points)
        points: Any = np.asarray(self.points, dtype=float)
        count = len(frames)  # a signal may arrive between the time and the frame
        series: dict[str, Any] = {"times": self.times[:count], "steps": self.steps[:count]}
        series |= {name: [getattr(o, name) for o in frames] for name in SERIES_NAMES if name not in series}
        numbers: dict[str, Any] = {name: np.array(values, dtype=float) for name, values in series.items()}
        forces: dict[str, Any] = {
            name: {key: np.array([getattr(o, name)[key] for o in frames]) for key in getattr(frames[0], name)}
            if frames else {} for name in GROUP_ARRAYS
        }  # fmt: skip
        rows: dict[str, Any] = {name: stack([getattr(o, name) for o in frames], (n, 3)) for name in FRAME_ARRAYS}
        return Trajectory(
            model=self.model, label=self.label, points=points,
            **numbers, **forces, **rows,
            contact_forces=np.concatenate(
                [np.zeros((0, 5)), *(np.insert(o.contact_forces, 0, k, axis=1) for k, o in enumerate(frames))]
            ),
            bonded=np.concatenate([np.zeros(0, dtype=np.bool_), *(o.bonded for o in frames)]),
            trust=np.array([o.trust for o in frames if o.trust is not None], dtype=float),
            **blade_series([o.blade for o in frames]),
            cuts=np.concatenate([np.zeros((0, 10)), *(_new_cuts(frames, k) for k in range(count))]),
            wall_seconds=wall_seconds, stiffness_damping=self.stiffness_damping, complete=complete,
        )  # fmt: skip


def _new_cuts(frames: list[Outputs], k: int) -> Floats:
    """Return the triangles (c, 10) that frame k has and the one before has not, with its number."""
    corners, former = frames[k].cut_triangles.reshape(-1, 9), frames[max(k - 1, 0)].cut_triangles.reshape(-1, 9)
    common = min(len(corners), len(former)) if k > 0 else 0
    differs = np.flatnonzero(np.any(corners[:common] != former[:common], axis=1))
    corners = corners[differs[0] if differs.size else common :]
    return np.insert(corners, 0, k, axis=1)


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
