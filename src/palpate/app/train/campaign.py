"""A campaign: make the missing runs, train a model on all of them, and again on further ones up to a tolerance."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from time import perf_counter
from typing import NamedTuple

from palpate.app.common.console import Console, count_nodes, percent
from palpate.app.common.exit_status import RunError
from palpate.app.train.bar import Bar
from palpate.app.train.choose import CANDIDATES_PER_RUN, FIRST_RUNS, choose, next_count
from palpate.app.train.cluster import run_on_cluster
from palpate.app.train.folder import HELD_OUT, Folder, Job, jobs
from palpate.app.train.local import run_local
from palpate.app.train.paths import path_of, recorded_jobs
from palpate.app.train.work import Outcome
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.membrane.model import Membrane
from palpate.faults import InputError
from palpate.files import check_space
from palpate.reduction.contact.residual_flexibility import MAX_NODES
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import save
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.scene import TrainingScene

__all__ = ["MODEL", "Campaign", "Round"]

MODEL = "model.rom"
REPEATED = 32  # training runs in which tools touch or hold the body, by which their forces are measured


class Round(NamedTuple):
    """A model of a campaign with a tolerance: its number of training runs, and its error on the held-out runs."""

    runs: int
    error: float
    tolerance: float


@dataclass(frozen=True)
class Campaign:
    """A campaign in its folder, and how its runs and models are made.

    Parameters
    ----------
    folder : Folder
    scene : TrainingScene
    console : Console
    modes : int
        Of the models.
    cubature : float, optional
        As for `palpate.hyper_reduce`; by default the scene's.
    workers : int
        Processes on this machine.
    cluster : str, optional
        Address of a Dask scheduler, or the path of its file, instead.
    seconds : dict
        Time spent on ``"runs"`` and on ``"training"``.
    """

    folder: Folder
    scene: TrainingScene
    console: Console
    modes: int
    cubature: float | None = None
    workers: int = 1
    cluster: str | None = None
    seconds: dict[str, float] = field(default_factory=lambda: {"runs": 0.0, "training": 0.0})

    def jobs(self, paths: Iterable[int], held_out: int) -> list[Job]:
        """Return the runs of training paths by number, of recorded paths, and a number of held-out ones."""
        return [*jobs(self.folder.manifest["seed"], paths, held_out), *recorded_jobs(self.folder)]

    def train(self, wanted: Sequence[Job]) -> ReducedModel:
        """Make the missing ones of the wanted runs, and train a model on them.

        Raises
        ------
        RunError
            No training run was finished.
        InputError
            The disk has no room for the runs, or no cluster answers; or as `palpate.hyper_reduce`.
        FileFormatError
            The file of a run is damaged, or that of another run.
        OSError
            A file could not be written.
        """
        began = perf_counter()
        self._make_runs(wanted)
        between = perf_counter()
        model = self._make_model(wanted)
        self.seconds["runs"] += between - began
        self.seconds["training"] += perf_counter() - between
        return model

    def train_to_tolerance(
        self, tolerance: float, most: int, held_out: int
    ) -> tuple[list[Job], ReducedModel, list[Round]]:
        """Train models on more and more runs, until the error on the held-out runs is at most a tolerance.

        The paths of further runs are those that cover most of the uncovered surface, and on which the model so
        far errs most (`palpate.app.train.choose`). The folder keeps their numbers.

        Parameters
        ----------
        tolerance : float
            Of the mean errors over the held-out runs: of displacement and reactions, or where tools touch the body,
            of their forces and the surface while they press.
        most : int
            Largest number of training paths.
        held_out : int
            Number of held-out runs.
        """
        numbers, rounds = self.folder.rounds() or [list(range(min(FIRST_RUNS, most)))], list[Round]()
        while True:
            self.folder.write_rounds(numbers)
            chosen = [k for each in numbers for k in each]
            wanted = self.jobs(chosen, held_out)
            model = self.train(wanted)
            rounds.append(Round(len(chosen), _held_out_error(model), tolerance))
            self.console.say(f"{len(chosen)} paths: error {percent(rounds[-1].error)}")
            if rounds[-1].error <= tolerance or len(chosen) >= most:
                return wanted, model, rounds
            numbers.append(self.further_paths(model, chosen, most))

    def further_paths(self, model: ReducedModel, chosen: Sequence[int], most: int) -> list[int]:
        """Return the numbers of the paths of the next round."""
        count, first = next_count(len(chosen), most), max(chosen) + 1
        candidates = jobs(self.folder.manifest["seed"], range(first, first + CANDIDATES_PER_RUN * count), 0)
        with self.console.status(f"trying {len(candidates)} paths on the reduced model"):
            found = choose(model, self.folder, self.scene, candidates, count, self.jobs(chosen, 0))
        return sorted(job.number for job in found)

    def _make_runs(self, wanted: Sequence[Job]) -> None:
        """Make the missing runs, and print their progress."""
        folder, scene, console = self.folder, self.scene, self.console
        left = folder.left(wanted)
        loads_and_durations = {job: path_of(folder, scene, job) for job in left}
        self._check_statics([load for loads, _ in loads_and_durations.values() for load in loads])
        paths = {job: duration for job, (_, duration) in loads_and_durations.items()}
        frames = sum(round(duration / scene.every) + 1 for duration in paths.values())
        check_space(folder.path, frames * len(scene.model.cloud) * 6 * 8, "folder")
        there = len(wanted) - len(left)
        processes = f"{self.workers} process{'es' if self.workers > 1 else ''}"
        where = f"the cluster at {self.cluster}" if self.cluster else processes
        console.say(
            f"{scene.title}: {count_nodes(len(scene.model.cloud))}, {len(wanted)} runs"
            + (f", {there} of them done before" if there else "")
            + (f"; {len(left)} on {where} ..." if left else "")
        )
        if not left:
            return
        try:
            with Bar(paths, console) as shown:
                if self.cluster is None:
                    outcomes: Generator[Outcome] = run_local(folder, left, self.workers, shown.at)
                else:
                    outcomes = run_on_cluster(folder, left, self.cluster, console)
                with closing(outcomes):  # stops what still runs, however this ends
                    for outcome in outcomes:
                        shown.done(outcome)
        except KeyboardInterrupt:
            done = len(wanted) - len(folder.left(wanted))
            raise KeyboardInterrupt(
                f"{done} of {len(wanted)} runs are kept; the same command continues from there"
            ) from None

    def _check_statics(self, loads: Sequence[Load]) -> None:
        """Raise `InputError` before the runs of a body with tools whose statics are too large for training."""
        scene, nodes = self.scene, len(self.scene.model.cloud)
        if scene.coarse or scene.tools or isinstance(scene.model, Membrane) or nodes <= MAX_NODES:
            return
        if any(isinstance(load, Contact | Grasp) for load in loads):
            raise InputError(
                f"coarse of the scene must be given for tools in contact with a body of more than {MAX_NODES} nodes, "
                f"got none for {nodes} nodes; let TrainingScene(coarse=...) return the same body with a larger spacing"
            )

    def _make_model(self, wanted: Sequence[Job]) -> ReducedModel:
        """Train on the runs that were finished, read from their files, and keep the model in the folder.

        Its report names the scene and its parameters under ``"scene"``.
        """
        folder, scene = self.folder, self.scene
        done = [job for job in wanted if folder.file(job).exists()]
        for job in done:
            folder.check_run(job)
        trials = [(job, (path_of(folder, scene, job)[0], folder.file(job))) for job in done]
        tried = [trial for job, trial in trials if job.kind == HELD_OUT]
        learned = [trial for job, trial in trials if job.kind != HELD_OUT]
        if not learned:
            reason = (folder.fault(wanted[0]) or {}).get("reason", "see its worker")
            raise RunError(f"no training run was finished; the first: {reason}; {folder.runs} holds their frames")
        touched = [trial for trial in learned if any(isinstance(load, Contact | Grasp) for load in trial[0])]
        share = scene.cubature if self.cubature is None else self.cubature
        with self.console.status(
            f"training {self.modes} modes on {len(learned)} runs, trying them on {len(tried)} others"
        ):
            model = hyper_reduce(
                scene.model,
                [file for _, file in learned],
                modes=self.modes,
                prescribed=scene.tools,
                held_out=tried,
                cubature=share,
                coarse=None if scene.coarse is None else scene.coarse(),
                repeated=touched[:REPEATED],
            )
        scene_entry = {"name": folder.manifest["scene"], "parameters": folder.manifest["parameters"]}
        model = model.with_report({"scene": scene_entry})
        save(model, folder.path / MODEL)
        return model


def _held_out_error(model: ReducedModel) -> float:
    """Return the larger of the mean errors that a tolerance is for."""
    found = model.report["held_out"]
    errors, names = (
        (found["contact"]["mean"], ("force", "surface_95"))
        if "contact" in found
        else (found["mean"], ("displacement", "reaction"))
    )
    return float(max(errors[name] for name in names))
