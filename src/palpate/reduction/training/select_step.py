"""Selection of the fastest step rule at equal error, by timing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import DivergenceError, InputError, integer_in_range, number_in_range
from palpate.dynamics.loads.prepared import Load, listed
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.hyper.model import ReducedModel

TRIED_STEPS = (None, 1e-3, 0.5e-3, 0.25e-3)  # explicit; implicit, [s]
REFERENCE_REFINEMENT = 20  # steps of the reference per explicit step
DEFAULT_FRAMES = 100  # of the motion


def select_time_step(
    model: ReducedModel,
    loads: Load | Sequence[Load] = (),
    *,
    duration: float,
    tolerance: float = 0.05,
    every: float | None = None,
    repeats: int = 3,
    clock: Callable[[], float] = perf_counter,
) -> ReducedModel:
    """Return the model with the step rule that keeps a tolerance at the least computing time.

    A motion is run with explicit steps and with implicit ones of 1, 0.5 and 0.25 ms, and compared with a
    reference of explicit steps ten times shorter. The times are measured in this call, because the result
    depends on the model, the motion and the machine. A stiff body needs short explicit steps, and fast
    waves need short implicit ones. Tissue that relaxes has explicit steps only.

    Parameters
    ----------
    model : ReducedModel
    loads : load or sequence of loads
        A motion representative of the model's use.
    duration : float [s]
    tolerance : float
        Largest relative error of velocities and of displacements over the whole run.
    every : float, optional [s]
        Time between snapshots; no step is longer. By default a hundredth of the duration, but at least
        1 ms.
    repeats : int
        Number of timings of each rule; the shortest time counts.
    clock : function
        Returns the time [s].

    Returns
    -------
    ReducedModel
        Its `report` has an entry ``"stepping"``: ``"tolerance"``, ``"reference_step"`` [s], the chosen
        ``"step"`` [s], None for explicit, and ``"rules"``. This is a list of ``"step"``, number of
        ``"steps"``, ``"seconds"``, ``"velocity"`` and ``"displacement"`` error; infinite where the run
        failed.

    Raises
    ------
    InputError
        No rule keeps the tolerance. The message lists the errors of each.
    DivergenceError
        The reference run fails.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.hyper_reduce(bar, full, modes=4)
    >>> chosen = pt.select_time_step(model, [pull], duration=0.03, tolerance=0.2, repeats=1)
    >>> len(chosen.report["stepping"]["rules"])
    4
    """
    loads = listed(loads)
    number_in_range("duration", duration, 0.0, open_low=True, unit="s")
    tolerance_value = number_in_range("tolerance", tolerance, 0.0, 1.0, open_low=True)
    frame_interval = min(duration, max(duration / DEFAULT_FRAMES, TRIED_STEPS[1] or 0.0)) if every is None else every
    rounds = integer_in_range("repeats", repeats, 1)
    steps = [step for step in TRIED_STEPS if step is None or model.material.prony is None]
    rules = [_Rule(model.with_step(step), loads, duration, frame_interval, clock) for step in steps]
    explicit = rules[0].run()
    finest = duration / float(explicit.steps[-1]) / REFERENCE_REFINEMENT
    fine = rollout(model.with_step(None), loads, duration=duration, every=frame_interval, step=finest, progress=False)
    for _ in range(rounds):
        for rule in rules:
            rule.time()
    table = [rule.row(fine) for rule in rules]
    step = _fastest_step(table, tolerance_value)
    report = {"tolerance": tolerance_value, "reference_step": finest, "step": step, "rules": table}
    return model.with_step(step).with_report({"stepping": report})


class _Rule:
    """A model with one step rule on the motion, its run and its times."""

    def __init__(
        self, model: ReducedModel, loads: Sequence[Load], duration: float, every: float, clock: Callable[[], float]
    ) -> None:
        self._model, self._loads, self._duration, self._every, self._clock = model, loads, duration, every, clock
        self._seconds, self._ready = np.inf, False
        self._run: Trajectory | None = None

    def run(self) -> Trajectory:
        return rollout(self._model, self._loads, duration=self._duration, every=self._every, progress=False)

    def time(self) -> None:
        """Run once, after compilation, and store the shortest time; a run that fails has infinite time."""
        try:
            if not self._ready:
                rollout(self._model, self._loads, duration=self._every, every=self._every, progress=False)
                self._ready = True
            began = self._clock()
            self._run = self.run()
            self._seconds = min(self._seconds, self._clock() - began)
        except DivergenceError:
            self._run, self._seconds = None, np.inf

    def row(self, fine: Trajectory) -> dict[str, Any]:
        """Return the row of the table: time and errors against the reference."""
        run = self._run
        return {
            "step": self._model.step,
            "steps": 0 if run is None else int(run.steps[-1]),
            "seconds": float(self._seconds),
            "velocity": np.inf if run is None else _relative_error(fine.velocities, run.velocities),
            "displacement": np.inf if run is None else _relative_error(fine.displacements, run.displacements),
        }


def _relative_error(fine: Floats, other: Floats) -> float:
    size = float(np.linalg.norm(fine))
    return float(np.linalg.norm(other - fine)) / size if size > 0 else 0.0


def _fastest_step(table: Sequence[dict[str, Any]], tolerance: float) -> float | None:
    """Return the step of the fastest row that keeps the tolerance."""
    good = [row for row in table if max(row["velocity"], row["displacement"]) <= tolerance]
    if not good:
        names = ["explicit" if row["step"] is None else f"{1e3 * row['step']:g} ms" for row in table]
        errors = [f"{row['velocity']:.2%} and {row['displacement']:.2%}" for row in table]
        each = ", ".join(f"{name}: {error}" for name, error in zip(names, errors, strict=True))
        raise InputError(
            f"tolerance must be attainable, got a tolerance of {tolerance:.2%} with errors of velocities "
            f"and displacements ({each}); increase it, or use ReducedModel.with_step with a shorter step"
        )
    step: float | None = min(good, key=lambda row: float(row["seconds"]))["step"]
    return step
