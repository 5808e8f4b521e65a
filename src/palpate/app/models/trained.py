"""The reduced model of a scene: from the scene's folder, or trained there by a campaign at the first use.

The folder of a scene file is next to it, that of a scene of the package is in the user's cache.
"""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_path

from palpate import __version__
from palpate.app.common.console import Console, count_nodes, percent
from palpate.app.train.campaign import MODEL, Campaign
from palpate.app.train.folder import manifest_of, open_campaign
from palpate.faults import FileFormatError, InputError
from palpate.files import check_folder
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.names import SCENES
from palpate.scenes.open_scene import training_scene_of
from palpate.scenes.organ_scene import OrganScene

__all__ = ["model_file", "trained_model", "training_folder"]

MAX_WORKERS = 4
FOLDER_SUFFIX = ".palpate"  # of the folder next to a scene file


def training_folder(scene: OrganScene) -> Path:
    """Return the folder of a scene's campaign, whether it exists or not; another surface has another folder."""
    if scene.name in SCENES:
        return user_cache_path("palpate") / f"{scene.name}-{__version__}-{scene.digest[:8]}"
    file = Path(scene.name)
    return file.with_name(file.stem + FOLDER_SUFFIX) / scene.digest[:8]


def model_file(scene: OrganScene) -> Path:
    """Return the file of a scene's trained model, whether it exists or not."""
    return training_folder(scene) / MODEL


def trained_model(scene: OrganScene, console: Console) -> ReducedModel:
    """Return the reduced model of a scene from its folder; train it where it is not there yet.

    A campaign that was stopped is continued.

    Raises
    ------
    InputError
        The folder cannot be written, or the scene cannot be trained.
    RunError
        No training run was finished.
    """
    folder, training = training_folder(scene), scene.description.training
    if (folder / MODEL).is_file():
        try:
            model = load(folder / MODEL)
        except FileFormatError as error:
            console.say(f"{error}; training another")
        else:
            if training.tolerance or model.report.get("training_runs") == training.paths:
                return model
    try:
        check_folder(folder, "cache" if scene.name in SCENES else "folder")
    except InputError as error:
        raise InputError(f"{error}, or train a model elsewhere: palpate train {scene.name} --out FOLDER") from error
    with console.status("preparing the full model (the first run on a machine compiles it: a minute or two)"):
        made = training_scene_of(scene, scene.settings)
    console.say(f"a reduced model is trained, once, and kept in {folder}")
    with open_campaign(folder, manifest_of(scene.name, made, training.seed)) as own:
        campaign = Campaign(own, made, console, training.modes, workers=min(os.cpu_count() or 1, MAX_WORKERS))
        if training.tolerance:
            _, model, _ = campaign.train_to_tolerance(training.tolerance, training.paths, training.held_out)
        else:
            model = campaign.train(campaign.jobs(range(training.paths), training.held_out))
    console.say(f"trained {training.modes} modes, {count_nodes(model.report['nodes'])} sampled{_errors(model)}")
    return model


def _errors(model: ReducedModel) -> str:
    """Return the mean errors on held-out runs in words, empty where there are none."""
    found = model.report.get("held_out")
    if not found:
        return ""
    mean = found["contact"]["mean"] if "contact" in found else found["mean"]
    if "contact" in found:
        errors = f"the tool's force errs by {percent(mean['force'])}, the surface by {percent(mean['surface_95'])}"
    else:
        errors = f"displacements err by {mean['displacement']:.2%}, reaction forces by {mean['reaction']:.2%}"
    return f"; on paths not trained on {errors}"
