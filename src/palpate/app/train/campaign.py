"""A campaign: make missing runs, train a model on all, and add runs until a tolerance is reached."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np

from palpate.app.common.console import Console, count_nodes, duration_text, percent
from palpate.app.common.exit_status import RunError
from palpate.app.train.bar import Bar
from palpate.app.train.choose import CANDIDATES_PER_RUN, FIRST_RUNS, choose, next_count
from palpate.app.train.cluster import run_on_cluster
from palpate.app.train.folder import HELD_OUT, Folder, Job, jobs
from palpate.app.train.local import run_local
from palpate.app.train.paths import path_of, recorded_jobs
from palpate.app.train.scene_folder import is_file
from palpate.app.train.work import Outcome
from palpate.core.faults import DivergenceError, InputError, TrustWarning
from palpate.core.files import check_space
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import StoredTrajectory
from palpate.dynamics.solid.model import Solid, energy_solid
from palpate.reduction.contact.coarse_body import statics_body
from palpate.reduction.contact.support_sensitivity import select_presses, support_sensitivity
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import save
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.description import Training
from palpate.scenes.load_case import TrainingScene
from palpate.scenes.names import kind_of
from palpate.scenes.scene import Scene

MODEL_FILE = "model.rom"
# Where tools touch the body anywhere. Every fourth path of a liver is a grasp, and error indicators compare runs.
# With 3 to 6 modes the 95th percentile of the force errs by 12 to 14 %, with 8 by 10 %, with 24 by 9 % (liver of
# 12 mm).
MIN_PATHS, MIN_MODES = 4, 8
MODE_STEPS = (32, 48, 66, 96)  # numbers of modes that are tried where runs do not keep a tolerance
# [s] of the first path, from which the time of all runs is estimated; that over the time of all, at most
SAMPLE_TIME, SAMPLE_SHARE = 0.1, 0.02
MAX_REPEATED = 32  # training runs in which tools touch or hold the body, by which their forces are measured


class Round(NamedTuple):
    """A model of a campaign with a tolerance: its training runs, its modes, and its error on the held-out runs."""

    runs: int
    modes: int
    error: float
    tolerance: float


def check_sizes(scene: Scene, training: Training, recorded: bool = False) -> None:
    """Raise `InputError` for too few paths or modes of a scene, before its body is made.

    A `recorded` campaign also trains on recordings, whose paths are not counted here.
    """
    if not scene.held_group and scene.description.surface.generated != "disc":  # tools touch the body
        _check_least(MIN_PATHS if recorded else training.paths, training.modes)


def _check_least(paths: int, modes: int) -> None:
    """Raise `InputError` for too few paths or modes where tools touch the body anywhere."""
    for name, value, least in (("paths", paths, MIN_PATHS), ("modes", modes, MIN_MODES)):
        if value < least:
            raise InputError(
                f"{name} must be at least {least} where tools touch the body anywhere, got {value}; use {least} or more"
            )


@dataclass(frozen=True)
class Campaign:
    """A campaign in its folder; makes its runs and models."""

    folder: Folder
    scene: TrainingScene
    console: Console
    modes: int  # of the models
    cubature: float | None = None  # as for `palpate.hyper_reduce`; by default the scene's
    workers: int = 1  # processes on this machine
    cluster: str | None = None  # address of a Dask scheduler, or the path of its file, instead
    # time spent on ``"runs"`` and on ``"training"``
    seconds: dict[str, float] = field(default_factory=lambda: {"runs": 0.0, "training": 0.0})

    def jobs(self, paths: Iterable[int], held_out: int) -> list[Job]:
        """Return the runs of training paths by number, of recorded paths, and a number of held-out ones."""
        return [*jobs(self.folder.manifest["seed"], paths, held_out), *recorded_jobs(self.folder)]

    def train(self, jobs: Sequence[Job]) -> ReducedModel:
        """Make the missing runs among some, and train a model on all of them."""
        began = perf_counter()
        self.make_runs(jobs)
        between = perf_counter()
        try:
            model = self._make_model(jobs)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"all {len(jobs)} runs are kept; the same command trains on them") from None
        self.seconds["runs"] += between - began
        self.seconds["training"] += perf_counter() - between
        return model

    def train_to_tolerance(
        self, tolerance: float, most: int, held_out: int, more_modes: bool = False
    ) -> tuple[list[Job], ReducedModel, list[Round]]:
        """Train models on an increasing number of runs, until the held-out error is at most a tolerance.

        The tolerance is of the mean errors over the held-out runs, of displacement and reactions. Where tools touch the
        body, it is of their forces and the surface while they press. At most `most` paths are trained on.

        The paths of further runs are those that cover most of the uncovered surface, and on which the model so far errs
        most (`palpate.app.train.choose`). The folder keeps their numbers. If the tolerance is not kept with all of
        them, `more_modes` trains models with more modes on the same runs.

        Returns the jobs, the last model and the rounds.
        """
        numbers, rounds = self.folder.rounds() or [list(range(min(FIRST_RUNS, most)))], list[Round]()
        while True:
            self.folder.write_rounds(numbers)
            chosen = [k for each in numbers for k in each]
            jobs = self.jobs(chosen, held_out)
            model = self.train(jobs)
            rounds.append(self._round(model, len(chosen), tolerance))
            if rounds[-1].error <= tolerance or len(chosen) >= most:
                break
            numbers.append(self.further_paths(model, chosen, most))
        for modes in MODE_STEPS if more_modes else ():
            if modes > self.modes and rounds[-1].error > tolerance:
                model = replace(self, modes=modes).train(jobs)
                rounds.append(self._round(model, len(chosen), tolerance))
        return jobs, model, rounds

    def _round(self, model: ReducedModel, runs: int, tolerance: float) -> Round:
        """Return the record of a model, and print its error."""
        error, modes = _held_out_error(model), int(model.data.modes)
        self.console.say(f"{runs} paths, {modes} modes: error {percent(error)}")
        return Round(runs, modes, error, tolerance)

    def support_study(self, jobs: Sequence[Job]) -> dict[str, Any] | None:
        """Return changes of tool forces by changes of the supports; None without contact.

        The presses are those of the training runs; see `palpate.reduction.contact.support_sensitivity`.
        """
        scene, files = self.scene, [self.folder.file(job) for job in jobs if job.kind != HELD_OUT]
        if scene.tools or scene.model.kinematics.sheet:
            return None
        presses = select_presses([StoredTrajectory(file) for file in files[:MAX_REPEATED] if file.exists()])
        if not presses:
            return None
        began, loads = perf_counter(), path_of(self.folder, scene, jobs[0])[0]
        body = energy_solid(self._statics or scene.model.energy_form())
        foundations = [load for load in loads if isinstance(load, Foundation)]
        with self.console.status("measuring how forces depend on the supports"):
            changes = support_sensitivity(body, scene.model.cloud.points, presses, foundations)
        self.seconds["supports"] = perf_counter() - began
        return changes

    def further_paths(self, model: ReducedModel, chosen: Sequence[int], most: int) -> list[int]:
        """Return the numbers of the paths of the next round."""
        count, first = next_count(len(chosen), most), max(chosen) + 1
        candidates = jobs(self.folder.manifest["seed"], range(first, first + CANDIDATES_PER_RUN * count), 0)
        with self.console.status(f"trying {len(candidates)} paths on the reduced model"):
            chosen_jobs = choose(model, self.folder, self.scene, candidates, count, self.jobs(chosen, 0))
        return sorted(job.number for job in chosen_jobs)

    def make_runs(self, jobs: Sequence[Job]) -> None:
        """Make the missing runs, and print their progress."""
        folder, scene, console = self.folder, self.scene, self.console
        every = {job: path_of(folder, scene, job) for job in jobs}
        self._check_sizes({job: path for job, path in every.items() if job.kind != HELD_OUT}.values())
        left = folder.left(jobs)
        paths = {job: every[job][1] for job in left}
        frames = sum(self._frames(duration) for duration in paths.values())
        check_space(folder.path, frames * len(scene.model.cloud) * 6 * 8, "folder")
        complete = len(jobs) - len(left)
        processes = f"{self.workers} process{'es' if self.workers > 1 else ''}"
        where = f"the cluster at {self.cluster}" if self.cluster else processes
        estimate = self._estimate(every[left[0]][0], paths.values()) if left else ""
        console.say(
            f"{scene.title}: {count_nodes(len(scene.model.cloud))}, {len(jobs)} runs"
            + (f", {complete} of them done before" if complete else "")
            + (f"; {len(left)} on {where}{estimate} ..." if left else "")
        )
        if not left:
            return
        try:
            with Bar(paths, console) as shown:
                if self.cluster is None:
                    outcomes: Generator[Outcome] = run_local(folder, left, self.workers, shown.at)
                else:
                    outcomes = run_on_cluster(folder, left, self.cluster, console)
                with closing(outcomes):  # stops unfinished runs, in every case
                    for outcome in outcomes:
                        shown.done(outcome)
        except KeyboardInterrupt:
            done = len(jobs) - len(folder.left(jobs))
            raise KeyboardInterrupt(
                f"{done} of {len(jobs)} runs are kept; the same command continues from there"
            ) from None

    def _estimate(self, loads: Sequence[Load], durations: Collection[float]) -> str:
        """Return about how long runs of some durations [s] take here, from the beginning of the first, as text.

        It is empty for a scene of a user's function: what its loads do is left to the processes of the runs.
        """
        if self.cluster is not None or kind_of(self.folder.manifest["scene"]) is None:
            return ""
        scene = self.scene
        sample = scene.every * max(1, round(min(SAMPLE_TIME, SAMPLE_SHARE * sum(durations)) / scene.every))
        try:
            with self.console.status("measuring this machine (the first time on a machine compiles the runs)"):
                rollout(scene.model, loads, duration=sample, every=scene.every, progress=False)  # compiles
                began = process_time()
                rollout(scene.model, loads, duration=sample, every=scene.every, progress=False)
                seconds = (process_time() - began) * sum(durations) / sample
        except (InputError, DivergenceError):  # the run itself reports it
            return ""
        text = duration_text(seconds / min(self.workers, len(durations)))
        return f", about {text} if nothing else runs here; Ctrl-C stops them, and the same command continues"

    def _frames(self, duration: float) -> int:
        return round(duration / self.scene.every) + 1

    def _check_sizes(self, paths: Collection[tuple[Sequence[Load], float]]) -> None:
        """Raise `InputError` for too few paths or modes, or for too many modes."""
        scene = self.scene
        touched = any(isinstance(load, Contact | Grasp) for loads, _ in paths for load in loads)
        if not touched or scene.tools or scene.model.kinematics.sheet:
            snapshots = sum(self._frames(duration) for _, duration in paths)
            if self.modes > snapshots:
                raise InputError(
                    f"modes must be at most {snapshots}, the number of snapshots of {len(paths)} runs, got "
                    f"{self.modes}; use fewer modes or more paths"
                )
            return
        _check_least(len(paths), self.modes)
        free = 3 * int(np.sum(~(self._statics or scene.model).fixed_mask))
        if self.modes > free // 2:
            raise InputError(
                f"modes must be at most {free // 2}, half the degrees of freedom of the body, got {self.modes}; use "
                "fewer modes"
            )

    @cached_property
    def _statics(self) -> Solid | None:
        """Coarser model for the modes and statics of a large body that tools touch; None for a small body.

        An `InputError` of making it is raised before the runs.
        """
        scene, body = self.scene, self.scene.model
        if scene.coarse is not None:
            return scene.coarse()
        return statics_body(body)

    def _make_model(self, jobs: Sequence[Job]) -> ReducedModel:
        """Train on the files of finished runs, and keep the model in the folder.

        Its report names the scene and its parameters under ``"scene"``.
        """
        folder, scene = self.folder, self.scene
        done = [job for job in jobs if folder.file(job).exists()]
        for job in done:
            folder.check_run(job)
        trials = [(job, (path_of(folder, scene, job)[0], folder.file(job))) for job in done]
        tried = [trial for job, trial in trials if job.kind == HELD_OUT]
        learned = [trial for job, trial in trials if job.kind != HELD_OUT]
        if not learned:
            reason = (folder.fault(jobs[0]) or {}).get("reason", "see its worker")
            raise RunError(f"no training run was finished; the first: {reason}; {folder.runs} holds their frames")
        touched = [trial for trial in learned if any(isinstance(load, Contact | Grasp) for load in trial[0])]
        coarse = self._statics if touched and not scene.tools else None
        share = scene.cubature if self.cubature is None else self.cubature
        with (
            warnings.catch_warnings(action="ignore", category=TrustWarning),
            self.console.status(
                f"training {self.modes} modes on {len(learned)} runs, trying them on {len(tried)} others"
            ),
        ):
            model = hyper_reduce(
                scene.model,
                [file for _, file in learned],
                modes=self.modes,
                prescribed=scene.tools,
                held_out=tried,
                cubature=share,
                coarse=coarse,
                repeated=touched[:MAX_REPEATED],
            )
        name = folder.manifest["scene"]
        name = Path(name).name if is_file(name) else name
        scene_entry = {"name": name, "parameters": folder.manifest["parameters"]}
        model = model.with_report({"scene": scene_entry})
        save(model, folder.path / MODEL_FILE)
        return model


def _held_out_error(model: ReducedModel) -> float:
    """Return the larger of the mean errors that a tolerance limits."""
    held_out = model.report["held_out"]
    errors, names = (
        (held_out["contact"]["mean"], ("force", "surface_95"))
        if "contact" in held_out
        else (held_out["mean"], ("displacement", "reaction"))
    )
    return float(max(errors[name] for name in names))
