"""Study: a full model, and one or more series of reduced models trained on its run, under the same loads."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from palpate.app.common.console import Console, count_nodes
from palpate.app.common.exit_status import RunError
from palpate.core.arrays import Floats
from palpate.core.faults import DivergenceError, InputError, TrustWarning
from palpate.core.files import flush_and_rename
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.model import Model
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.errors import relative_errors
from palpate.scenes.load_case import LoadCase

Train = Callable[[NodalModel, Trajectory, int], Model]  # of a full model, its run over a phase and a number of modes

PROJECTED, HYPER_REDUCED = "projected", "hyper-reduced"  # names of series: `palpate.galerkin`, `palpate.hyper_reduce`

COMPILED_STEPS = 4  # of a run that compiles
SHOWN_MODES = 8  # the reduced model that figures compare with the full one: the paper's choice


@dataclass(frozen=True)
class Phase:
    """A part of a run that has reduced models of its own."""

    name: str
    start: float  # [s]
    duration: float  # [s]
    step: float | None = None  # [s] of the projected runs; None for the one that `palpate.rollout` chooses
    title: str = ""  # what happens in it, for figures


@dataclass(frozen=True)
class Shown:
    """The reduced runs of a series, one for every phase, that figures compare with the full ones."""

    modes: int
    runs: list[Trajectory]


@dataclass
class Study:
    """Models to run, and their results."""

    case: LoadCase
    phases: Sequence[Phase]  # one after the other; together they are the case's whole run
    series: Mapping[str, Train]  # kinds of reduced models by name
    form: str = ""  # of the equations, of an example that has several
    file: str = "full.h5"  # of the full run
    fields: dict[str, Floats] = field(default_factory=dict)  # stresses and states (f, n) of the full run, by name
    singular_values: list[Floats] = field(default_factory=list)  # of the snapshots behind the modes of every phase
    parts: list[Trajectory] = field(default_factory=list)  # runs of the full model, one for every phase
    # one for every series and number of modes: "series", "modes", "failed", for every phase its entry in "phases", and
    # those of the whole run in "joined"
    reduced: list[dict[str, Any]] = field(default_factory=list)
    shown: dict[str, Shown] = field(default_factory=dict)  # by series; without those of which no run was finished
    full: Trajectory = field(init=False)  # the parts joined

    @property
    def title(self) -> str:
        """Name of the full model in messages."""
        return f"full model, {self.form}" if self.form else "full model"

    def of_phases(self, values: Sequence[Any]) -> Any:
        """Return values of the phases by name, or the one value of a study with one phase."""
        named = {phase.name: value for phase, value in zip(self.phases, values, strict=True)}
        return named if len(named) > 1 else values[0]

    def finished(self, phase: Phase, series: str) -> list[dict[str, Any]]:
        """Return the entries of the reduced runs of a series that finished a phase, each with its number of modes."""
        return [entry for entry in self.entries(phase, series) if not entry["failed"]]

    def entries(self, phase: Phase, series: str) -> list[dict[str, Any]]:
        """Return the entries of all reduced runs of a series over a phase, each with its number of modes."""
        return [
            {"modes": entry["modes"]} | entry["phases"][phase.name]
            for entry in self.reduced
            if entry["series"] == series
        ]


def compile_study(study: Study, series: Iterable[str]) -> None:
    """Compile what a full model calls, and the reduced models of some series: a few steps of each."""
    case, step = study.case, study.case.model.stability.step
    short: dict[str, Any] = {"duration": COMPILED_STEPS * step, "every": step, "progress": False}
    with suppress(DivergenceError, InputError), warnings.catch_warnings(action="ignore"):  # the runs themselves say so
        run = rollout(case.model, case.loads, **short)
        for name in series:
            rollout(study.series[name](case.model, run, 1), case.loads, **short)


def run_full(study: Study, out: Path, files: Sequence[str], console: Console) -> None:
    """Run the full model into its file, streaming its frames into a file next to it until they are complete.

    Then the `files` of an earlier study are removed.
    """
    case, step = study.case, study.case.model.stability.step
    begun: list[Path] = []
    try:
        rollout(case.model, case.loads, duration=step, every=step, progress=False)  # compiles the rest
        console.say(f"{study.title}: {case.duration:g} s, {round(case.duration / case.every)} snapshots ...")
        for phase in study.phases:
            (out / _partial_name(phase)).unlink(missing_ok=True)  # of an earlier run that was stopped
        for phase in study.phases:
            begun.append(out / _partial_name(phase))
            begin: dict[str, Any] = {"start": phase.start, "file": begun[-1]}
            begin |= _last(study.parts[-1] if study.parts else None)
            study.parts.append(rollout(case.model, case.loads, duration=phase.duration, every=case.every, **begin))
    except DivergenceError as error:
        raise RunError(f"the {study.title} diverged: {error}; {_kept_frames(begun)}") from error
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"in the run of the {study.title}; {_kept_frames(begun)}" if begun else "") from None
    study.full = _join(study.parts)
    for name in files:  # of an earlier study: all files of a folder belong together
        (out / name).unlink(missing_ok=True)
    _keep(study, begun, out / study.file)
    console.say(f"{study.title}: {study.full.wall_seconds:.2f} s, {int(study.full.steps[-1])} steps")


def _partial_name(phase: Phase) -> str:
    return f"{phase.name}.partial.h5"


def _last(run: Trajectory | None) -> dict[str, Any]:
    """Return the initial state of a run that continues another one."""
    return {} if run is None else {"displacement": run.displacements[-1], "velocity": run.velocities[-1]}


def _kept_frames(partials: list[Path]) -> str:
    return f"the frames until then are kept in {' and '.join(str(path) for path in partials if path.exists())}"


def _join(parts: Sequence[Trajectory]) -> Trajectory:
    return reduce(Trajectory.concatenate, parts)


def _keep(study: Study, partials: list[Path], path: Path) -> None:
    """Give the complete run its name."""
    if len(partials) == 1:
        flush_and_rename(partials[0], path)
        return
    study.full.save(path)
    for partial in partials:
        partial.unlink()


def run_reduced(study: Study, sizes: Sequence[int], console: Console) -> None:
    """Train and run reduced models of every series and size, each phase from its own end of the phase before."""
    try:
        for name in study.series:
            for size in sizes:
                runs = _run_size(study, name, size, console)
                if len(runs) < len(study.phases):
                    continue
                shown = study.shown.get(name)
                if shown is None or abs(size - SHOWN_MODES) < abs(shown.modes - SHOWN_MODES):
                    study.shown[name] = Shown(size, runs)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"in the reduced runs; the frames of the {study.title} are kept in {study.file}"
        ) from None


def _run_size(study: Study, name: str, size: int, console: Console) -> list[Trajectory]:
    """Run a reduced model of one series and size through all phases; return the runs that were finished."""
    entry: dict[str, Any] = {"series": name, "modes": size, "failed": False, "phases": {}}
    runs: list[Trajectory] = []
    for phase, full in zip(study.phases, study.parts, strict=True):
        where = f", {phase.name}" if len(study.phases) > 1 else ""
        if entry["failed"]:
            entry["phases"][phase.name] = {"failed": True, "reason": "the phase before it failed"}
            continue
        measured, run = _run_phase(study, phase, full, name, size, runs[-1] if runs else None)
        entry["phases"][phase.name] = measured
        if run is None:
            entry["failed"] = True
            console.say(f"{name}, {size} modes{where}: failed: {measured['reason']}")
            continue
        runs.append(run)
        console.say(
            f"{name}, {size} modes at {count_nodes(measured['nodes'])}{where}: {run.wall_seconds:.2f} s, "
            f"{measured['ratio']:.2%} of the full model's time, "
            f"displacement error {measured['errors']['displacement']:.3%}"
        )
    if not entry["failed"]:
        entry["joined"] = comparison(study.full, _join(runs))
    study.reduced.append(entry)
    return runs


def _run_phase(
    study: Study, phase: Phase, full: Trajectory, name: str, size: int, before: Trajectory | None
) -> tuple[dict[str, Any], Trajectory | None]:
    """Train and run a reduced model over a phase; return its entry in the report, and its run if it was finished."""
    case, begin = study.case, {"start": phase.start} | _last(before)
    try:
        start = perf_counter()
        model = study.series[name](case.model, full, size)
        training = perf_counter() - start
        step = case.model.stability.step
        fixed_step = phase.step if name == PROJECTED else None
        with warnings.catch_warnings(action="ignore", category=TrustWarning):  # the report has the number
            rollout(model, case.loads, duration=step, every=step, progress=False, **begin)  # compiles
            run = rollout(model, case.loads, duration=phase.duration, every=case.every, step=fixed_step, **begin)
    except (DivergenceError, InputError) as error:
        return {"failed": True, "reason": " ".join(str(error).split())}, None
    measured = {
        "failed": False,
        "nodes": len(model.data.cubature.nodes) if isinstance(model, ReducedModel) else len(model.cloud),
        "projection_error": relative_errors(full, _projection(model, case, full)).displacement,
        "training_seconds": training,
        "real_time_factor": phase.duration / run.wall_seconds,
        "largest_trust": float(run.trust.max()) if len(run.trust) else None,
    }
    return measured | comparison(full, run), run


def comparison(full: Trajectory, run: Trajectory) -> dict[str, Any]:
    """Return the errors of a run against a reference, and its cost."""
    return {
        "errors": relative_errors(full, run).as_dict(),
        "error_at_end": _error_at_end(full, run),
        "wall_seconds": run.wall_seconds,
        "ratio": run.wall_seconds / full.wall_seconds,
        "steps": int(run.steps[-1]),
        "seconds_per_step": run.wall_seconds / float(run.steps[-1]),
    }


def _error_at_end(full: Trajectory, run: Trajectory) -> float:
    """Return the sum of |u_full - u| over the sum of |u_full| in the last frame."""
    missed = np.linalg.norm(run.displacements[-1] - full.displacements[-1], axis=1).sum()
    return float(missed / np.linalg.norm(full.displacements[-1], axis=1).sum())


def _projection(model: Model, case: LoadCase, run: Trajectory) -> Trajectory:
    """Return a run projected onto the displacements that a model can represent."""
    prepared = model.prepare(case.loads)
    frames = zip(run.times, run.displacements, strict=True)
    states = (model.state(prepared, displacement, time=float(time)) for time, displacement in frames)
    return replace(run, displacements=np.stack([model.displacement(state, prepared) for state in states]))
