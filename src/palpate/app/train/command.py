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
from palpate.app.train.folder import RECORDINGS_FOLDER, manifest_of, open_campaign
from palpate.app.train.paths import add_recording
from palpate.app.train.report import report_campaign
from palpate.app.train.scene_folder import name_in_folder, training_folder
from palpate.core.faults import InputError, integer_in_range
from palpate.core.files import check_folder
from palpate.scenes.description import Training
from palpate.scenes.names import SceneKind, kind_of
from palpate.scenes.open_scene import json_of_scene, open_scene
from palpate.scenes.open_surface import complete_for_training, open_surface
from palpate.scenes.training import DESCRIPTION_KEY, open_training, search_current_folder, training_of

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
    as_json: bool = False,
) -> int:
    """Make the missing runs of a campaign, and train a reduced model on all of them.

    Parameters
    ----------
    scene : str
        As for `palpate.scenes.training.open_training`; a module is looked for in the current folder, too. Or a
        surface file.
    part, labels, without
        Of a surface file, as for `palpate.scenes.open_surface.open_surface`.
    given : sequence of str
        Its parameters as ``"name=value"``.
    paths, held_out : int, optional
        Runs to train on, from 1, and to measure errors on, from 0. By default those of the scene, as all below.
    seed : int, optional
        Of the paths.
    tolerance : float, optional
        Largest mean error on the held-out runs. Paths on uncovered surface, or with large expected errors, are added
        until it is reached, at most `paths`; see `palpate.app.train.campaign.Campaign.train_to_tolerance`.
    more : sequence of path
        Recordings of sessions: the campaign also trains on their tool paths beyond trust, from now on.
    modes : int, optional
        Size of the reduced model. By default that of the scene, and more if a tolerance requires them.
    cubature : float, optional
        As for `palpate.hyper_reduce`: relative error of the sampled forces; by default the scene's.
    workers : int, optional
        Processes of one thread each on this machine; by default 1.
    cluster : str, optional
        Address of a Dask scheduler, or the path of its file, instead.
    out : path, optional
        Folder of the campaign; by default next to a scene file (`palpate.app.train.scene_folder`).
    as_json : bool
        Print the report as JSON instead of a table.

    Returns
    -------
    int
        0, also if some runs failed; 3 if the errors on the held-out runs are too large to use the model.
    """
    kind, opened = kind_of(scene), None
    if kind is not None:
        settings = parse_settings(given)
        if kind is SceneKind.SURFACE_FILE:
            parts = tuple(part or ())
            opened = complete_for_training(
                open_surface(scene, part=parts, labels=labels, settings=settings, without=without)
            )
            scene, settings = opened.name, {DESCRIPTION_KEY: json_of_scene(opened)}  # with which workers open it
        else:
            for name, value in (("part", part), ("labels", labels), ("without", without)):
                if value:
                    raise InputError(f"{name} must be left out unless a surface file is given, got {scene!r:.60}")
            opened = open_scene(scene, settings)
        defaults = opened.description.training
        if out is None:
            out = DEFAULT_OUT if kind is SceneKind.PACKAGE else training_folder(opened)
    else:
        settings = split_settings(given)  # converted to the types of the function's defaults
        defaults, out = USER_DEFAULTS, DEFAULT_OUT if out is None else out
    more_modes = modes is None
    sizes: dict[str, Any] = {
        "paths": paths, "held_out": held_out, "seed": seed, "modes": modes, "tolerance": tolerance
    }  # fmt: skip
    chosen = replace(defaults, **{name: value for name, value in sizes.items() if value is not None})
    if chosen.tolerance is not None and not chosen.held_out:
        raise InputError("held_out must be at least 1 with --tolerance, got 0; the errors are of held-out runs")
    if cluster is not None:
        check_dask()
        if workers is not None:
            raise InputError(f"workers must be left out with --cluster, got {workers}; a cluster has its own")
    workers = integer_in_range("workers", 1 if workers is None else workers, 1, MAX_WORKERS)
    check_folder(out)
    if opened is not None:
        check_sizes(opened, chosen, recorded=bool(more) or (out / RECORDINGS_FOLDER).is_dir())
    console = Console()
    with console.status("making the model ready (the first time on a machine compiles it, for about a minute)"):
        if ":" in scene:
            search_current_folder()
        made = open_training(scene, settings) if opened is None else training_of(opened, settings)
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
                chosen.tolerance, chosen.paths, chosen.held_out, more_modes
            )
        supports = campaign.support_study(jobs)
        report_campaign(campaign_folder, made, jobs, model, campaign.seconds, rounds, supports, as_json)
    if "advice" in model.report:
        return complain(f"warning: {model.report['advice']}", UNTRUSTED)
    return DONE
