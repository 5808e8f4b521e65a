"""``palpate run SCENE --realtime``: step the body of a scene under repeated presses or moves of its tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.common.console import Console
from palpate.app.models.trained import model_file, trained_model
from palpate.app.run.realtime import Poses, run_realtime
from palpate.dynamics.contact.tools import Contact
from palpate.faults import InputError
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.open_scene import open_scene
from palpate.scenes.organ_scene import OrganScene
from palpate.scenes.scene_paths import MIN_RADIUS, touching_paths

__all__ = ["pressing_ball", "run_scene_realtime"]

UNTRAINED_SEED = 1_500_000  # of a path that was not trained on
PRESS_SECONDS, SWING_SECONDS = 2.0, 3.0  # [s] duration of such a path
MAX_PRESS_DEPTH, MIN_DEPTH_SHARE = 0.015, 2 / 3  # [m] depth of the press at most; least depth over that


def run_scene_realtime(
    *,
    scene: str,
    settings: Mapping[str, Any],
    model: Path | None = None,
    full: bool = False,
    **options: Any,
) -> int:
    """Step a scene's body in real time for some seconds under its moving tool, and report missed deadlines.

    Parameters
    ----------
    scene : str
        As for `palpate.open_scene`.
    settings : mapping
        Its settings.
    model : path, optional
        File of a reduced model of the scene. By default that of the scene, trained at the first use.
    full : bool
        Step the full body in place of a reduced model.
    options : mapping
        ``seconds``, ``rate``, ``out`` and ``as_json``: see `palpate.app.run.realtime.run_realtime`.

    Returns
    -------
    int
        0, whether the rate was held or not.

    Raises
    ------
    InputError, FileFormatError
        A parameter out of range, a file that holds no model for the scene's tool, or a folder that cannot be written.
    RunError
        The state ran away, and the black box is kept; or not a single run to train on could be finished.
    OSError
        A file could not be read or written.
    """
    if full and model is not None:
        raise InputError(f"model must be left out with --full, got {str(model)!r}; leave out one of the two")
    opened = open_scene(scene, settings)
    about = {"full": True} if full else {"file": str(model_file(opened) if model is None else model)}

    def make(console: Console) -> tuple[Any, Poses, Contact | None]:
        if full:
            with console.status("filling the surface with nodes (the first time on a machine compiles it)"):
                body = opened.body
        else:
            body = trained_model(opened, console) if model is None else load(model)  # type: ignore[assignment]
        if opened.held_group:
            return body, opened.held_motion(UNTRAINED_SEED, SWING_SECONDS), None
        return body, *pressing_ball(opened, body, model)

    title = f"{'Full ' + opened.title.lower() if full else opened.title} in real time"
    return run_realtime(make, title=title, about=about, **options)


def pressing_ball(scene: OrganScene, body: Any, file: Path | None = None) -> tuple[Poses, Contact]:
    """Return the poses of a ball that presses a body repeatedly, and the ball at its first pose."""
    if isinstance(body, ReducedModel) and body.data.compliance is None:
        raise InputError(
            f"model must be one that was trained on a body that a ball touches, got {str(file)!r}; train one with "
            f"palpate train {scene.name}"
        )
    tool = scene.description.tool
    if tool.radius is not None:  # of a coarser body than the scene's
        tool = replace(tool, radius=max(tool.radius, MIN_RADIUS * body.cloud.spacing))
    paths = touching_paths(tool, scene.description.training, body, (), MAX_PRESS_DEPTH, MIN_DEPTH_SHARE)
    (ball,), duration = paths.press(UNTRAINED_SEED)
    home = ball.poses(np.zeros(1))[0, :3]

    def poses(time: float) -> Any:
        place = ball.poses(np.array([time % PRESS_SECONDS * duration / PRESS_SECONDS]))[0]
        return place[:3] - home, place[3:]

    return poses, Contact(ball.tool, home, friction=ball.friction)
