"""Snapshots of several runs, from memory or from files that together may exceed the memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.run.trajectory import StoredTrajectory, Trajectory

Run = Trajectory | str | Path  # or the path of a trajectory's file


@dataclass(frozen=True)
class _Frames:
    """An array of snapshots without a run."""

    displacements: Floats
    points: None = None
    times: Floats = field(default_factory=lambda: np.zeros(0))
    contact_forces: Floats = field(default_factory=lambda: np.zeros((0, 5)))
    bonded: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))


class Snapshots:
    """The displacements in all frames of some runs, one run after the other, read at each use.

    The runs are trajectories, or paths of their files, which are read in parts, or an array (L, n, 3) [m]. Each of
    `runs` has `times`, `displacements`, `contact_forces` and `bonded`; `lengths` are their frames. `has_contact` is
    True if tools touch the body in any of them.
    """

    def __init__(self, runs: Run | Sequence[Run] | Floats) -> None:
        if isinstance(runs, np.ndarray):
            if runs.ndim != 3 or runs.shape[2] != 3:
                raise InputError(f"snapshots must have shape (L, n, 3), got {runs.shape}; reshape them")
            self.runs: list[_Frames | Trajectory | StoredTrajectory] = [_Frames(runs)]
        else:
            some = [runs] if isinstance(runs, Run) else list(runs)
            self.runs = [run if isinstance(run, Trajectory) else StoredTrajectory(run) for run in some]
        if not self.runs:
            raise InputError("trajectories must hold at least one, got none; run the full model first")
        self.points = [part.points for part in self.runs if part.points is not None]
        self.lengths = [len(part.displacements) for part in self.runs]
        self.nodes = int(self.runs[0].displacements.shape[1])
        for part in self.runs:
            if part.displacements.shape[1] != self.nodes:
                raise InputError(
                    f"trajectories must have the same nodes, got {self.nodes} and "
                    f"{part.displacements.shape[1]}; use runs of one body"
                )
        self.has_contact = any(len(run.contact_forces) for run in self.runs)
        self._ends = np.cumsum(self.lengths)

    def __len__(self) -> int:
        return int(self._ends[-1])

    def evenly_spaced(self, most: int) -> NDArray[np.int64]:
        """Return the numbers of at most so many snapshots, evenly spaced over all."""
        return np.linspace(0, len(self) - 1, min(most, len(self))).astype(int)

    def blocks(self, most: int) -> Iterator[Floats]:
        """Yield all snapshots in order, at most so many at a time: (b, n, 3) arrays that the caller may change."""
        for first in range(0, len(self), most):
            last = min(first + most, len(self))
            block, begin = np.empty((last - first, self.nodes, 3)), 0
            for part, length, end in zip(self.runs, self.lengths, self._ends, strict=True):
                start, stop = max(first, end - length), min(last, end)
                if start < stop:
                    frames = slice(start - (end - length), stop - (end - length))
                    block[begin : begin + stop - start] = part.displacements[frames]
                    begin += stop - start
            if not np.isfinite(block).all():
                raise InputError("snapshots must be finite, got inf or nan; leave that run out")
            yield block

    def each(self, which: NDArray[np.int64]) -> Iterator[Floats]:
        """Yield some snapshots (n, 3) by number, one at a time."""
        for k in which:
            part = int(np.searchsorted(self._ends, k, side="right"))
            yield self.runs[part].displacements[int(k) - int(self._ends[part]) + self.lengths[part]]
