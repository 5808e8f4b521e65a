"""The two halves of a campaign: make the missing runs, and train a model on all of them."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing

from palpate.app.common.console import Console, count_nodes
from palpate.app.common.exit_status import RunError
from palpate.app.train.bar import Bar
from palpate.app.train.cluster import run_on_cluster
from palpate.app.train.folder import HELD_OUT, TRAINED, Folder, Job
from palpate.app.train.local import run_local
from palpate.app.train.work import Outcome
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.solid.model import EnergySolid
from palpate.files import check_space
from palpate.reduction.basis.linear_modes import interpolated_modes
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import save
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.scene import TrainingScene

__all__ = ["MODEL", "make_model", "make_runs"]

MODEL = "model.rom"
REPEATED = 32  # training runs in which tools touch or hold the body, by which their forces are measured


def make_runs(
    folder: Folder,
    scene: TrainingScene,
    wanted: Sequence[Job],
    console: Console,
    workers: int = 1,
    cluster: str | None = None,
) -> None:
    """Make the missing runs, and print their progress.

    Raises
    ------
    InputError
        The disk has no room for them, or no cluster answers.
    OSError
        A file could not be written.
    """
    left = folder.left(wanted)
    paths = {job: scene.path(job.seed)[1] for job in left}
    frames = sum(round(duration / scene.every) + 1 for duration in paths.values())
    check_space(folder.path, frames * len(scene.model.cloud) * 6 * 8, "folder")
    there = len(wanted) - len(left)
    where = f"the cluster at {cluster}" if cluster else f"{workers} process{'es' if workers > 1 else ''}"
    console.say(
        f"{scene.title}: {count_nodes(len(scene.model.cloud))}, {len(wanted)} runs"
        + (f", {there} of them done before" if there else "")
        + (f"; {len(left)} on {where} ..." if left else "")
    )
    if not left:
        return
    try:
        with Bar(paths, console) as shown:
            if cluster is None:
                outcomes: Generator[Outcome] = run_local(folder, left, workers, shown.at)
            else:
                outcomes = run_on_cluster(folder, left, cluster, console)
            with closing(outcomes):  # stops what still runs, however this ends
                for outcome in outcomes:
                    shown.done(outcome)
    except KeyboardInterrupt:
        done = len(wanted) - len(folder.left(wanted))
        raise KeyboardInterrupt(
            f"{done} of {len(wanted)} runs are kept; the same command continues from there"
        ) from None


def make_model(
    folder: Folder,
    scene: TrainingScene,
    wanted: Sequence[Job],
    console: Console,
    modes: int,
    cubature: float | None = None,
) -> ReducedModel:
    """Train on the runs that were finished, read from their files, and keep the model in the folder.

    Its report names the scene and its parameters under ``"scene"``.

    Parameters
    ----------
    folder : Folder
    scene : TrainingScene
    wanted : sequence of Job
    console : Console
    modes : int
    cubature : float, optional
        As for `palpate.hyper_reduce`; by default the scene's.

    Raises
    ------
    RunError
        No training run was finished.
    InputError
        As `palpate.hyper_reduce`.
    FileFormatError
        The file of a run is damaged, or that of another run.
    OSError
        A file could not be written.
    """
    done = [job for job in wanted if folder.file(job).exists()]
    for job in done:
        folder.check_run(job)
    learned = [folder.file(job) for job in done if job.kind == TRAINED]
    tried = [(scene.path(job.seed)[0], folder.file(job)) for job in done if job.kind == HELD_OUT]
    if not learned:
        reason = (folder.fault(wanted[0]) or {}).get("reason", "see its worker")
        raise RunError(f"no training run was finished; the first: {reason}; {folder.runs} holds their frames")
    paths = [(scene.path(job.seed)[0], folder.file(job)) for job in done if job.kind == TRAINED]
    touched = [trial for trial in paths if any(isinstance(load, Contact | Grasp) for load in trial[0])]
    share = scene.cubature if cubature is None else cubature
    with console.status(f"training {modes} modes on {len(learned)} runs, trying them on {len(tried)} others"):
        coarse = smooth = None
        if scene.coarse is not None and isinstance(scene.model, EnergySolid):
            coarse = scene.coarse()
            smooth = interpolated_modes(coarse, scene.model, modes)
        model = hyper_reduce(
            scene.model, learned, modes=modes if smooth is None else 0, enrichment=smooth, prescribed=scene.tools,
            held_out=tried, cubature=share, coarse=coarse, repeated=touched[:REPEATED],
        )  # fmt: skip
    model.report["scene"] = {"name": folder.manifest["scene"], "parameters": folder.manifest["parameters"]}
    save(model, folder.path / MODEL)
    return model
