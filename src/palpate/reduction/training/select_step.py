"""Which step rule is quickest: measured on a motion, at equal error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import DivergenceError, InputError, integer_in_range, number_in_range
from palpate.reduction.hyper.model import ReducedModel

__all__ = ["select_time_step"]


STEPS = (None, 1e-3, 0.5e-3, 0.25e-3)  # explicit; implicit, [s]
FINER = 10  # steps of the reference in one explicit step
FRAMES = 100  # of the motion, unless told otherwise


def select_time_step(
    model: ReducedModel,
    loads: Sequence[Load] = (),
    *,
    duration: float,
    tolerance: float = 0.05,
    every: float | None = None,
    repeats: int = 3,
    clock: Callable[[], float] = perf_counter,
) -> ReducedModel:
    """Return the model with the step rule that keeps a tolerance at the least computing time, measured here and now.

    A motion is run with explicit steps and with implicit ones of 1, 0.5 and 0.25 ms, and compared with a reference of
    explicit steps ten times shorter. Which rule wins depends on the model, the motion and the machine: a stiff body
    needs short explicit steps, fast waves need short implicit ones. Tissue that relaxes has explicit steps only.

    Parameters
    ----------
    model : ReducedModel
    loads : sequence of loads
        A motion like those that the model is for.
    duration : float [s]
    tolerance : float
        Largest error of velocities and of displacements that the steps may make: over the whole run, relative.
    every : float, optional [s]
        Time between snapshots; no step is longer. By default a hundredth of the duration, but at least 1 ms.
    repeats : int
        How often every rule is timed; the shortest time counts.
    clock : function
        What tells the time [s].

    Returns
    -------
    ReducedModel
        Its `report` has all that was measured under ``"stepping"``: ``"tolerance"``, ``"reference_step"`` [s], the
        chosen ``"step"`` [s], None for explicit, and ``"rules"``, a list of ``"step"``, ``"steps"`` taken,
        ``"seconds"``, ``"velocity"`` and ``"displacement"`` error; infinite where the run failed.

    Raises
    ------
    InputError
        No rule keeps the tolerance: the message tells what each reaches.
    DivergenceError
        The reference itself fails.
    """
    number_in_range("duration", duration, 0.0, open_low=True, unit="s")
    wanted = number_in_range("tolerance", tolerance, 0.0, 1.0, open_low=True)
    own = min(duration, max(duration / FRAMES, STEPS[1] or 0.0)) if every is None else every
    rounds = integer_in_range("repeats", repeats, 1)
    possible = [step for step in STEPS if step is None or model.material.prony is None]
    rules = [_Rule(model.with_step(step), loads, duration, own, clock) for step in possible]
    explicit = rules[0].run()
    finest = duration / float(explicit.steps[-1]) / FINER
    fine = rollout(model.with_step(None), loads, duration=duration, every=own, step=finest, progress=False)
    for _ in range(rounds):
        for rule in rules:
            rule.time()
    table = [rule.measured(fine) for rule in rules]
    step = _chosen(table, wanted)
    report = {"tolerance": wanted, "reference_step": finest, "step": step, "rules": table}
    return ReducedModel(
        replace(model.data, report={**model.report, "stepping": report}), step=step, single=model.single
    )


class _Rule:
    """A model of one step rule on the motion, its run and its times."""

    def __init__(
        self, model: ReducedModel, loads: Sequence[Load], duration: float, every: float, clock: Callable[[], float]
    ) -> None:
        self._model, self._loads, self._duration, self._every, self._clock = model, loads, duration, every, clock
        self._seconds, self._ready = np.inf, False
        self._found: Trajectory | None = None

    def run(self) -> Trajectory:
        return rollout(self._model, self._loads, duration=self._duration, every=self._every, progress=False)

    def time(self) -> None:
        """Run, compiled beforehand, and keep the shortest time; a run that fails takes for ever."""
        try:
            if not self._ready:
                rollout(self._model, self._loads, duration=self._every, every=self._every, progress=False)
                self._ready = True
            began = self._clock()
            self._found = self.run()
            self._seconds = min(self._seconds, self._clock() - began)
        except DivergenceError:
            self._found, self._seconds = None, np.inf

    def measured(self, fine: Trajectory) -> dict[str, Any]:
        """Return the table's row: time and errors against the reference."""
        run = self._found
        return {
            "step": self._model.step,
            "steps": 0 if run is None else int(run.steps[-1]),
            "seconds": float(self._seconds),
            "velocity": np.inf if run is None else _missed(fine.velocities, run.velocities),
            "displacement": np.inf if run is None else _missed(fine.displacements, run.displacements),
        }


def _missed(fine: Floats, other: Floats) -> float:
    size = float(np.linalg.norm(fine))
    return float(np.linalg.norm(other - fine)) / size if size > 0 else 0.0


def _chosen(table: Sequence[dict[str, Any]], tolerance: float) -> float | None:
    """Return the step of the row that takes least time of those that keep the tolerance."""
    good = [row for row in table if max(row["velocity"], row["displacement"]) <= tolerance]
    if not good:
        names = ["explicit" if row["step"] is None else f"{1e3 * row['step']:g} ms" for row in table]
        errors = [f"{row['velocity']:.2%} and {row['displacement']:.2%}" for row in table]
        each = ", ".join(f"{name}: {error}" for name, error in zip(names, errors, strict=True))
        raise InputError(
            f"no step rule keeps a tolerance of {tolerance:.2%} on velocities and displacements ({each}); "
            "allow more, or give shorter steps by hand: ReducedModel.with_step"
        )
    step: float | None = min(good, key=lambda row: float(row["seconds"]))["step"]
    return step
