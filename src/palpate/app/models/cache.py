"""The small liver in the user's cache: a campaign (`palpate.app.train`) trains it at the first use."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path

from platformdirs import user_cache_path

from palpate import __version__
from palpate.app.common.console import Console, count_nodes
from palpate.app.train.campaign import MODEL, Campaign
from palpate.app.train.folder import manifest_of, open_campaign
from palpate.faults import FileFormatError, InputError
from palpate.files import check_folder
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage import model_file as storage
from palpate.reduction.storage.models import load
from palpate.scenes.training import training_scene, typed

__all__ = ["LIVER", "cache_file", "cache_folder", "load_cached_liver"]

LIVER = "liver"
SCENE_PARAMETERS = {"spacing": 0.009, "radius": 0.0225, "depth": 0.016}  # [m] of the scene
PATHS, HELD_OUT, MODES = 10, 3, 40
MAX_WORKERS = 4


def cache_folder() -> Path:
    """Return the folder of the user's cache for the small liver of this version with these parameters."""
    about = {"scene": typed(LIVER, SCENE_PARAMETERS), "training": [PATHS, HELD_OUT, MODES], "file": storage.VERSION}
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:8]
    return user_cache_path("palpate") / f"{LIVER}-{__version__}-{digest}"


def cache_file() -> Path:
    """Return the file of the small liver in the user's cache, whether it exists or not."""
    return cache_folder() / MODEL


def load_cached_liver(console: Console) -> ReducedModel:
    """Return the small liver from the cache; train it where it is not there yet.

    A campaign that was stopped is continued. Its runs are removed when the model is there.
    """
    folder = cache_folder()
    if (folder / MODEL).is_file():
        try:
            return load(folder / MODEL)
        except FileFormatError as error:
            console.say(f"{error}; training another")
    try:
        check_folder(folder, "cache")
    except InputError as error:
        raise InputError(f"{error}, or give a model of your own: palpate train liver, then --model FILE") from error
    console.say(f"a small model of the liver is trained, once, and kept in {folder}")
    with console.status("making the full model ready (the first run on a machine compiles it: a minute or two)"):
        scene = training_scene(LIVER, SCENE_PARAMETERS)
    with open_campaign(folder, manifest_of(LIVER, scene, 0)) as own:
        campaign = Campaign(own, scene, console, MODES, workers=min(os.cpu_count() or 1, MAX_WORKERS))
        body = campaign.train(campaign.jobs(range(PATHS), HELD_OUT))
        shutil.rmtree(own.runs)
    console.say(f"trained {MODES} modes, {count_nodes(body.report['nodes'])} sampled")
    return body
