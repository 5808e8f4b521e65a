"""``palpate train``: make many runs along random paths, and train a reduced model on all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.app.common.arguments import parse_settings, split_settings
from palpate.app.common.console import Console
from palpate.app.common.exit_status import DONE, UNTRUSTED, complain
from palpate.app.train.campaign import Campaign, Round, check_sizes
from palpate.app.train.cluster import check_dask
from palpate.app.train.estimate import confirm, estimate_training, keep_trained
from palpate.app.train.folder import RECORDINGS_FOLDER, manifest_of, open_campaign
from palpate.app.train.paths import add_recording
from palpate.app.train.report import report_campaign
from palpate.app.train.scene_folder import name_in_folder, training_folder
from palpate.core.faults import InputError, integer_in_range
from palpate.core.files import check_folder
from palpate.scenes.description import Training
from palpate.scenes.names import SceneKind, kind_of
from palpate.scenes.open_scene import open_scene
from palpate.scenes.open_surface import complete_for_training
from palpate.scenes.scene import Scene
from palpate.scenes.training import open_training, parameters_of, search_current_folder, training_of

DEFAULT_OUT = Path("out/train")
USER_DEFAULTS = Training(paths=64, held_out=8, modes=24)  # of a scene that is a user's function
MAX_WORKERS = 1024


def train(
    *,
    scene: str,
    part: Sequence[str] | None = None,
    labels: Path | None = None,
    without: Sequence[str] = (),
    given: Sequence[str] = (),
    paths: int | None = None,
    held_out: int | None = None,
    seed: int | None = None,
    tolerance: float | None = None,
    more: Sequence[Path] = (),
    modes: int | None = None,
    cubature: float | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    out: Path | None = None,
    yes: bool = False,
    as_json: bool = False,
) -> int:
    """Make the missing runs of a campaign, and train a reduced model on all of them.

    `scene` is as for `palpate.open_scene`, or ``"module:function"`` of a function that returns a `TrainingScene`; the
    module is looked for in the current folder, too. Its settings `given` are ``"name=value"``. Options that are None
    have the scene's values; `workers` is 1 by default, and with a tolerance `modes` may grow.

    With a tolerance, the largest mean error on the held-out runs, paths are added until it is reached, at most `paths`;
    see `palpate.app.train.campaign.Campaign.train_to_tolerance`. The campaign also trains on the tool paths beyond
    trust of the recordings `more`, from now on. `cluster` is the address of a Dask scheduler, or the path of its file,
    in place of processes on this machine. With `yes` nobody is asked before work of minutes.

    Returns 0, also if some runs failed; 3 if the errors on the held-out runs are too large to use the model.
    """
    console, opened, arguments = Console(), None, dict[str, str]()
    if kind_of(scene) is None:
        arguments = split_settings(given)  # converted to the types of the function's defaults
    else:
        opened = _open(scene, given, part, labels, without)
        scene = opened.name
    sizes: dict[str, Any] = {"paths": paths, "held_out": held_out, "seed": seed, "modes": modes, "tolerance": tolerance}
    sizes = {name: value for name, value in sizes.items() if value is not None}
    chosen = replace(USER_DEFAULTS if opened is None else opened.description.training, **sizes)
    if chosen.tolerance is not None and not chosen.held_out:
        raise InputError("held_out must be at least 1 with --tolerance, got 0; the errors are of held-out runs")
    workers = _count_workers(workers, cluster)
    if out is None:
        out = DEFAULT_OUT if opened is None or opened.kind is SceneKind.PACKAGE else training_folder(opened)
    check_folder(out)
    if opened is not None:
        check_sizes(opened, chosen, recorded=bool(more) or (out / RECORDINGS_FOLDER).is_dir())
        opened.check_training()
        with console.status("measuring this machine"):
            estimate = estimate_training(opened, chosen, out, workers)
        confirm(console, estimate, "Train?", yes)
    with console.status("making the model ready (the first time on a machine compiles it, for about a minute)"):
        if opened is None:
            search_current_folder()
            made = open_training(scene, arguments)
        else:
            made = training_of(opened, parameters_of(opened))
    with open_campaign(out, manifest_of(name_in_folder(scene, out), made, chosen.seed)) as campaign_folder:
        for recording in more:
            add_recording(campaign_folder, made, recording)
        campaign = Campaign(campaign_folder, made, console, chosen.modes, cubature, workers, cluster)
        rounds: list[Round] = []
        if chosen.tolerance is None:
            jobs = campaign.jobs(range(chosen.paths), chosen.held_out)
            model = campaign.train(jobs)
        else:
            jobs, model, rounds = campaign.train_to_tolerance(
                chosen.tolerance, chosen.paths, chosen.held_out, more_modes=modes is None
            )
        if opened is not None:
            keep_trained(opened)
        supports = campaign.support_study(jobs)
        report_campaign(campaign_folder, made, jobs, model, campaign.seconds, rounds, supports, as_json)
    if "advice" in model.report:
        return complain(f"warning: {model.report['advice']}", UNTRUSTED)
    return DONE


def _open(
    source: str, given: Sequence[str], part: Sequence[str] | None, labels: Path | None, without: Sequence[str]
) -> Scene:
    """Return a scene with what training requires."""
    scene = open_scene(source, parse_settings(given), part=part or (), labels=labels, without=without)
    return complete_for_training(scene) if scene.kind is SceneKind.SURFACE_FILE else scene


def _count_workers(workers: int | None, cluster: str | None) -> int:
    """Return the number of processes on this machine."""
    if cluster is not None:
        check_dask()
        if workers is not None:
            raise InputError(f"workers must be left out with --cluster, got {workers}; a cluster has its own")
    return integer_in_range("workers", 1 if workers is None else workers, 1, MAX_WORKERS)
