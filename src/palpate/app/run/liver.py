"""``palpate run liver --realtime``: the liver, pressed by a ball again and again.

Its model comes from a file, or from the user's cache, where a campaign (`palpate.app.train`) has left it at first use.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from palpate import __version__
from palpate.app.console import Console, count_nodes
from palpate.app.run.realtime import Poses, run_realtime
from palpate.app.train.campaign import MODEL, make_model, make_runs
from palpate.app.train.folder import jobs, manifest_of, opened
from palpate.dynamics.contact.tools import Contact
from palpate.faults import FileFormatError, InputError
from palpate.files import check_folder
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage import model_file
from palpate.reduction.storage.models import load
from palpate.scenes.liver import ToolPaths
from palpate.scenes.training import training_scene, typed

__all__ = ["run_liver"]

SCENE = "liver"
SMALL = {"spacing": 0.009, "radius": 0.0225, "depth": 0.016}  # of the scene that is trained where no model is given [m]
PATHS, HELD_OUT, MODES = 10, 3, 40
MOST_WORKERS = 4
SEED, LASTING = 1000, 2.0  # of the press, which was not trained on; how long it takes [s]
DEEPEST, SHALLOWEST = 0.015, 2 / 3  # [m] of the press, and of that or what was trained, if less


def run_liver(*, model: Path | None = None, **options: Any) -> int:
    """Press the liver in real time for some seconds, again and again, and report how the rate was kept.

    Parameters
    ----------
    model : path, optional
        File of a reduced model that `palpate train liver` has made. By default a small one from the user's cache, which
        is trained there at first use.
    options : mapping
        ``seconds``, ``rate``, ``out`` and ``as_json``: see `palpate.app.run.realtime.run_realtime`.

    Returns
    -------
    int
        0, whether the rate was held or not.

    Raises
    ------
    InputError, FileFormatError
        A parameter out of range, a file that holds no model of the pressed liver, or a cache that cannot be written.
    ReproduceError
        The state ran away, and the black box is kept; or not a single run to train on could be finished.
    OSError
        A file could not be read or written.
    """
    options = {name: value for name, value in options.items() if value is not None}

    def made(console: Console) -> tuple[ReducedModel, Poses, Contact]:
        body = cached(console) if model is None else load(model)
        return body, *_pressing(body, cache() / MODEL if model is None else model)

    about = {"file": str(model or cache() / MODEL)}
    return run_realtime(made, title="Liver pressed by a ball, in real time", about=about, **options)


def cache() -> Path:
    """Return the folder of the user's cache that holds the small model of this version with these parameters."""
    about = {"scene": typed(SCENE, SMALL), "training": [PATHS, HELD_OUT, MODES], "file": model_file.VERSION}
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:8]
    return user_cache_path("palpate") / f"{SCENE}-{__version__}-{digest}"


def cached(console: Console) -> ReducedModel:
    """Return the small model from the cache; where it is not there yet, train it.

    The campaign goes on where it was stopped. Its runs are removed when the model is there.
    """
    folder = cache()
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
        scene = training_scene(SCENE, SMALL)
    with opened(folder, manifest_of(SCENE, scene, 0)) as own:
        wanted = jobs(0, PATHS, HELD_OUT)
        make_runs(own, scene, wanted, console, min(os.cpu_count() or 1, MOST_WORKERS))
        body = make_model(own, scene, wanted, console, MODES)
        shutil.rmtree(own.runs)
    console.say(f"trained {MODES} modes, {count_nodes(body.report['nodes'])} sampled")
    return body


def _pressing(body: ReducedModel, file: Path) -> tuple[Poses, Contact]:
    """Return the poses of a ball that presses a body again and again, and the ball itself where it begins."""
    scene = body.report.get("scene", {})
    if body.data.compliance is None or scene.get("name") != SCENE:
        known = f"but on the scene {scene['name']!r}" if scene else "its file names no scene"
        raise InputError(
            f"model = {str(file)!r}: it was not trained on a liver that a ball touches, {known}; palpate train liver "
            "makes one that was"
        )
    about = typed(SCENE, scene["parameters"])
    paths = ToolPaths(body.cloud, about["radius"], min(about["depth"], DEEPEST), about["friction"], SHALLOWEST)
    (ball,), duration = paths.press(SEED)
    home = ball.poses(np.zeros(1))[0, :3]

    def poses(time: float) -> Any:
        place = ball.poses(np.array([time % LASTING * duration / LASTING]))[0]
        return place[:3] - home, place[3:]

    return poses, Contact(ball.tool, home, friction=ball.friction)
