"""``palpate train``: many runs along random paths, and a reduced model of all of them."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path
from time import perf_counter

from palpate.app.console import Console, count_nodes
from palpate.app.files import check_folder, check_space, whole_file
from palpate.app.study import ReproduceError
from palpate.app.train.bar import Bar
from palpate.app.train.cluster import check_dask, run_on_cluster
from palpate.app.train.folder import HELD_OUT, MOST_PATHS, TRAINED, Folder, Job, jobs, manifest_of, opened
from palpate.app.train.local import run_here
from palpate.app.train.report import MODEL, deliver
from palpate.app.train.work import Outcome
from palpate.faults import InputError, integer_in_range
from palpate.reduction.reduced import ReducedModel
from palpate.reduction.training import reduce
from palpate.scenes.scene import TrainingScene
from palpate.scenes.training import training_scene

__all__ = ["train"]

MOST_SEED = 1_000_000
MOST_WORKERS = 1024


def train(
    *,
    scene: str,
    given: Sequence[str] = (),
    paths: int = 64,
    held_out: int = 8,
    seed: int = 0,
    modes: int = 24,
    workers: int | None = None,
    cluster: str | None = None,
    folder: Path,
    as_json: bool = False,
) -> int:
    """Make the runs of a campaign that are not there yet, and train a reduced model on all.

    Parameters
    ----------
    scene : str
        As for `palpate.scenes.training.training_scene`.
    given : sequence of str
        Its parameters as ``"name=value"``.
    paths, held_out : int
        Runs to train on, from 1, and to measure errors on, from 0.
    seed : int
        Of the paths.
    modes : int
        Size of the reduced model.
    workers : int, optional
        Processes of one thread each on this machine; by default 1.
    cluster : str, optional
        Address of a Dask scheduler, or the path of its file, instead.
    folder : path
    as_json : bool
        Print the report as JSON instead of a table.

    Returns
    -------
    int
        0, also if some runs failed.

    Raises
    ------
    InputError
        A parameter out of range, or the folder of another campaign.
    ReproduceError
        No training run was finished.
    OSError
        A file could not be written.
    """
    wanted = jobs(
        integer_in_range("seed", seed, 0, MOST_SEED),
        integer_in_range("paths", paths, 1, MOST_PATHS),
        integer_in_range("held_out", held_out, 0, MOST_PATHS),
    )
    modes = integer_in_range("modes", modes, 1)
    if cluster is not None:
        check_dask()
        if workers is not None:
            raise InputError(f"workers = {workers}: a cluster has its own; leave --workers or --cluster out")
    workers = integer_in_range("workers", 1 if workers is None else workers, 1, MOST_WORKERS)
    parameters = _parameters(given)
    check_folder(folder)
    console = Console()
    with console.status("making the model ready (the first run on a machine compiles it: a minute or two)"):
        made = training_scene(scene, parameters)
    with opened(folder, manifest_of(scene, made, seed)) as own:
        _check_space(own, made, wanted)
        began = perf_counter()
        _run(own, made, wanted, workers, cluster, console)
        seconds = {"runs": perf_counter() - began}
        began = perf_counter()
        model = _reduced(own, made, wanted, modes, console)
        seconds["training"] = perf_counter() - began
        deliver(own, made, wanted, model, seconds, as_json)
    return 0


def _parameters(given: Sequence[str]) -> dict[str, str]:
    parameters = {}
    for pair in given:
        name, sign, value = pair.partition("=")
        if not sign:
            raise InputError(f"set = {pair!r}: needed is NAME=VALUE, such as spacing=0.005")
        parameters[name] = value
    return parameters


def _check_space(folder: Folder, scene: TrainingScene, wanted: Sequence[Job]) -> None:
    frames = sum(round(scene.path(job.seed)[1] / scene.every) + 1 for job in folder.left(wanted))
    check_space(folder.path, frames * len(scene.model.cloud) * 6 * 8)


def _run(
    folder: Folder, scene: TrainingScene, wanted: Sequence[Job], workers: int, cluster: str | None, console: Console
) -> None:
    """Make what runs are left, and say how they go."""
    left = folder.left(wanted)
    there = len(wanted) - len(left)
    where = f"the cluster at {cluster}" if cluster else f"{workers} process{'es' if workers > 1 else ''}"
    console.say(
        f"{scene.title}: {count_nodes(len(scene.model.cloud))}, {len(wanted)} runs"
        + (f", {there} of them done before" if there else "")
        + (f"; {len(left)} on {where} ..." if left else "")
    )
    if not left:
        return
    durations = {job: scene.path(job.seed)[1] for job in left}
    try:
        with Bar(durations, console) as shown:
            if cluster is None:
                outcomes: Generator[Outcome] = run_here(folder, left, workers, shown.at)
            else:
                outcomes = run_on_cluster(folder, left, cluster, console)
            with closing(outcomes):  # stops what still runs, however this ends
                for outcome in outcomes:
                    shown.done(outcome)
    except KeyboardInterrupt:
        done = len(wanted) - len(folder.left(wanted))
        raise KeyboardInterrupt(f"{done} of {len(wanted)} runs are kept; the same command goes on from there") from None


def _reduced(folder: Folder, scene: TrainingScene, wanted: Sequence[Job], modes: int, console: Console) -> ReducedModel:
    """Train on the runs that were finished, read from their files, and keep the model in the folder."""
    done = [job for job in wanted if folder.file(job).exists()]
    learned = [folder.file(job) for job in done if job.kind == TRAINED]
    tried = [(scene.path(job.seed)[0], folder.file(job)) for job in done if job.kind == HELD_OUT]
    if not learned:
        reason = (folder.fault(wanted[0]) or {}).get("reason", "see its worker")
        raise ReproduceError(f"no training run was finished; the first: {reason}; {folder.runs} holds what they did")
    console.say(f"training {modes} modes on {len(learned)} runs, trying them on {len(tried)} others ...")
    smooth = None if scene.shapes is None else scene.shapes(modes)
    own = modes if smooth is None else 0
    model = reduce(scene.model, learned, modes=own, enrichment=smooth, driven=scene.tools, held_out=tried)
    with whole_file(folder.path / MODEL) as partial:
        model.save(partial)
    return model
