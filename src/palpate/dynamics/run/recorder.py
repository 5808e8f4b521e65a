"""Recorders: the frames of a run, in memory and in a file while the run goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.run.journal import Journal
from palpate.dynamics.run.model import Outputs
from palpate.dynamics.run.trajectory import NAMED, ROWS, SERIES, Trajectory, stack

__all__ = ["Recorder"]


class Recorder:
    """Collects the frames of a run, and keeps them in a file on the way where there is a path.

    From the first frame on the file is a journal (`palpate.dynamics.run.journal`), which holds all frames until then
    whatever stops the program. In the end it becomes the HDF5 file of the trajectory.

    Parameters
    ----------
    path : path or None
    model : str
    points : (n, d) array [m]
    stiffness_damping : float [s]
    label : str
        See `Trajectory`.

    Raises
    ------
    OSError
        The file cannot be created or the disk is full; names the file.
    """

    def __init__(
        self, path: Path | None, model: str, points: Floats, stiffness_damping: float, label: str = ""
    ) -> None:
        self.path, self.model, self.points, self.stiffness_damping, self.label = (
            path,
            model,
            points,
            float(stiffness_damping),
            label,
        )
        self.times: list[float] = []
        self.steps: list[int] = []
        self.frames: list[Outputs] = []
        self._journal: Journal | None = None
        if path is not None:
            with _writing(path):
                if path.exists() and not path.is_file():
                    raise OSError("it exists and is not a regular file")
                self._journal = Journal(path)

    def add(self, time: float, steps: int, frame: Outputs) -> None:
        """Keep a frame."""
        self.times.append(time)
        self.steps.append(steps)
        self.frames.append(frame)
        if self._journal is None or self.path is None:
            return
        with _writing(self.path):
            if len(self.times) == 1:
                about = {"model": self.model, "label": self.label, "stiffness_damping": self.stiffness_damping}
                names = {"reactions": list(frame.reactions), "moments": list(frame.moments)}
                self._journal.add(about | names, {"points": np.asarray(self.points, dtype=float)})
            numbers = {"times": time, "steps": steps} | {n: getattr(frame, n) for n in SERIES if hasattr(frame, n)}
            arrays: dict[str, Any] = {"numbers": [numbers[name] for name in SERIES]}
            arrays |= {name: getattr(frame, name) for name in (*ROWS, "contact_forces")}
            arrays |= {name: np.reshape(list(getattr(frame, name).values()), (-1, 3)) for name in NAMED}
            arrays = {name: np.asarray(values, dtype=float) for name, values in arrays.items()}
            self._journal.add({}, arrays | {"bonded": np.asarray(frame.bonded, dtype=np.bool_)})
            if len(self.times) == 1:
                self._journal.rename(self.path)

    def close(self, wall_seconds: float, complete: bool) -> Trajectory:
        """Finish the file, and return what was collected."""
        run = self._collected(wall_seconds, complete)
        if self._journal is not None and self.path is not None:
            self._journal.close()
            run.save(self.path)
        return run

    def _collected(self, wall_seconds: float, complete: bool) -> Trajectory:
        frames, n = self.frames, len(self.points)
        points: Any = np.asarray(self.points, dtype=float)
        count = len(frames)  # a signal may have come between the time and the frame
        series: dict[str, Any] = {"times": self.times[:count], "steps": self.steps[:count]}
        series |= {name: [getattr(o, name) for o in frames] for name in SERIES if name not in series}
        own: dict[str, Any] = {name: np.array(values, dtype=float) for name, values in series.items()}
        forces: dict[str, Any] = {
            name: {of: np.array([getattr(o, name)[of] for o in frames]) for of in getattr(frames[0], name)}
            if frames else {} for name in NAMED
        }  # fmt: skip
        rows: dict[str, Any] = {name: stack([getattr(o, name) for o in frames], (n, 3)) for name in ROWS}
        return Trajectory(
            model=self.model, label=self.label, points=points,
            **own, **forces, **rows,
            contact_forces=np.concatenate(
                [np.zeros((0, 5)), *(np.insert(o.contact_forces, 0, k, axis=1) for k, o in enumerate(frames))]
            ),
            bonded=np.concatenate([np.zeros(0, dtype=np.bool_), *(o.bonded for o in frames)]),
            wall_seconds=wall_seconds, stiffness_damping=self.stiffness_damping, complete=complete,
        )  # fmt: skip


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        why = error.strerror or error
        raise OSError(
            f"cannot write {path}: {why}; choose another folder or free some space; frames written before are kept"
        ) from error
