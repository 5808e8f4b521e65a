"""``palpate train``: make many runs along random paths, and train a reduced model on all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palpate.app.common.console import Console
from palpate.app.train.campaign import Campaign, Round
from palpate.app.train.choose import CANDIDATES_PER_RUN
from palpate.app.train.cluster import check_dask
from palpate.app.train.folder import MAX_PATHS, manifest_of, open_campaign
from palpate.app.train.paths import add_recording
from palpate.app.train.report import report_campaign
from palpate.faults import InputError, brief, integer_in_range, number_in_range
from palpate.files import check_folder
from palpate.scenes.training import search_current_folder, training_scene

__all__ = ["train"]

MAX_SEED = 1_000_000
MAX_WORKERS = 1024
MAX_MODES = 1000


def train(
    *,
    scene: str,
    given: Sequence[str] = (),
    paths: int = 64,
    held_out: int = 8,
    seed: int = 0,
    tolerance: float | None = None,
    more: Sequence[Path] = (),
    modes: int = 24,
    cubature: float | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    out: Path,
    as_json: bool = False,
) -> int:
    """Make the missing runs of a campaign, and train a reduced model on all of them.

    Parameters
    ----------
    scene : str
        As for `palpate.scenes.training.training_scene`; a module is looked for in the current folder, too.
    given : sequence of str
        Its parameters as ``"name=value"``.
    paths, held_out : int
        Runs to train on, from 1, and to measure errors on, from 0.
    seed : int
        Of the paths.
    tolerance : float, optional
        Choose paths on uncovered surface and where the model errs most, at most `paths`, until its mean errors on the
        held-out runs are at most this; see `palpate.app.train.campaign.Campaign.train_to_tolerance`.
    more : sequence of path
        Recordings of sessions: the campaign also trains on their tool paths beyond trust, from now on.
    modes : int
        Size of the reduced model.
    cubature : float, optional
        As for `palpate.hyper_reduce`: relative error of the sampled forces; by default the scene's.
    workers : int, optional
        Processes of one thread each on this machine; by default 1.
    cluster : str, optional
        Address of a Dask scheduler, or the path of its file, instead.
    out : path
        Folder of the campaign.
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
    RunError
        No training run was finished.
    OSError
        A file could not be written.
    """
    seed = integer_in_range("seed", seed, 0, MAX_SEED)
    paths = integer_in_range("paths", paths, 1, MAX_PATHS // CANDIDATES_PER_RUN)
    held_out = integer_in_range("held_out", held_out, 0, MAX_PATHS)
    if tolerance is not None:
        tolerance = number_in_range("tolerance", tolerance, 0.0, 1.0, open_low=True)
        if not held_out:
            raise InputError("held_out must be at least 1 with --tolerance, got 0; the errors are of held-out runs")
    modes = integer_in_range("modes", modes, 1, MAX_MODES)
    if cubature is not None:
        cubature = number_in_range("cubature", cubature, 0.0, 1.0)
    if cluster is not None:
        check_dask()
        if workers is not None:
            raise InputError(f"workers must be left out with --cluster, got {workers}; a cluster has its own")
    workers = integer_in_range("workers", 1 if workers is None else workers, 1, MAX_WORKERS)
    parameters = _parameters(given)
    check_folder(out)
    console = Console()
    with console.status("making the model ready (the first run on a machine compiles it: a minute or two)"):
        if ":" in scene:
            search_current_folder()
        made = training_scene(scene, parameters)
    with open_campaign(out, manifest_of(scene, made, seed)) as own:
        for recording in more:
            add_recording(own, made, recording)
        campaign = Campaign(own, made, console, modes, cubature, workers, cluster)
        rounds: list[Round] = []
        if tolerance is None:
            wanted = campaign.jobs(range(paths), held_out)
            model = campaign.train(wanted)
        else:
            wanted, model, rounds = campaign.train_to_tolerance(tolerance, paths, held_out)
        report_campaign(own, made, wanted, model, campaign.seconds, rounds, as_json)
    return 0


def _parameters(given: Sequence[str]) -> dict[str, str]:
    parameters = {}
    for pair in given:
        name, sign, value = pair.partition("=")
        if not sign:
            raise InputError(f"--set must be NAME=VALUE, got {brief(pair)}; give one such as spacing=0.005")
        parameters[name] = value
    return parameters
