"""``palpate run liver --realtime``: the liver, pressed by a ball again and again.

Its model comes from a file, or from the user's cache, where a campaign has left it (`palpate.app.models.cache`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.common.console import Console
from palpate.app.models.cache import LIVER, cache_file, load_cached_liver
from palpate.app.run.realtime import Poses, run_realtime
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.run.model import Model
from palpate.dynamics.solid.model import Solid
from palpate.faults import InputError
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.liver import MAX_SLIDE, pressed_liver
from palpate.scenes.tool_paths import ToolPaths
from palpate.scenes.training import typed

__all__ = ["pressing_ball", "run_liver"]

SEED, PRESS_SECONDS = 1000, 2.0  # of a press that was not trained on; its duration [s]
FULL_SPACING, FULL_RADIUS, SPACINGS_OF_BALL, FRICTION = 0.009, 0.0225, 2.5, 0.2  # [m], [m]: of the full liver
DEEPEST, SHALLOWEST = 0.015, 2 / 3  # [m] depth of the press; least depth over that, or over the trained one if less


def run_liver(
    *,
    realtime: bool = True,
    model: Path | None = None,
    full: bool = False,
    spacing: float | None = None,
    **options: Any,
) -> int:
    """Press the liver in real time for some seconds, again and again, and report how the rate was kept.

    Parameters
    ----------
    realtime : bool
        The liver always runs in real time.
    model : path, optional
        File of a reduced model that `palpate train liver` has made. By default a small one from the user's cache, which
        is trained there at first use.
    full : bool
        Step the full liver in place of a reduced model.
    spacing : float, optional [m]
        Of the full liver; by default 9 mm.
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
    RunError
        The state ran away, and the black box is kept; or not a single run to train on could be finished.
    OSError
        A file could not be read or written.
    """
    options = {name: value for name, value in options.items() if value is not None}
    if full:
        if model is not None:
            raise InputError(f"model must be left out with --full, got {str(model)!r}; leave out one of the two")
        return _run_full(FULL_SPACING if spacing is None else spacing, options)
    if spacing is not None:
        raise InputError(f"spacing must be left out without --full, got {spacing:g}; add --full")
    file = cache_file() if model is None else model

    def make(console: Console) -> tuple[ReducedModel, Poses, Contact]:
        body = load_cached_liver(console) if model is None else load(model)
        return body, *pressing_ball(body, file)

    about = {"file": str(file)}
    return run_realtime(make, title="Liver pressed by a ball, in real time", about=about, **options)


def _run_full(spacing: float, options: dict[str, Any]) -> int:
    """Press the full liver in real time."""

    def make(console: Console) -> tuple[Model, Poses, Contact]:
        radius = max(FULL_RADIUS, SPACINGS_OF_BALL * spacing)
        with console.status("filling the liver with nodes (the first time on a machine compiles it)"):
            scene = pressed_liver(spacing=spacing, radius=radius, depth=DEEPEST)
        assert isinstance(scene.model, Solid)
        paths = _tool_paths(scene.model, radius, DEEPEST, FRICTION)
        return scene.model, *_presses(paths)

    return run_realtime(make, title="Full liver pressed by a ball, in real time", about={"full": True}, **options)


def pressing_ball(body: ReducedModel, file: Path) -> tuple[Poses, Contact]:
    """Return the poses of a ball that presses a body again and again, and the ball itself where it begins."""
    scene = body.report.get("scene", {})
    if body.data.compliance is None or scene.get("name") != LIVER:
        known = f"trained on the scene {scene['name']!r}" if scene else "whose file names no scene"
        raise InputError(
            f"model must be one that was trained on a liver that a ball touches, got {str(file)!r}, {known}; train one "
            "with palpate train liver"
        )
    about = typed(LIVER, scene["parameters"])
    return _presses(_tool_paths(body, about["radius"], min(about["depth"], DEEPEST), about["friction"]))


def _tool_paths(body: Solid | ReducedModel, radius: float, depth: float, friction: float) -> ToolPaths:
    return ToolPaths(body, radius, depth, friction, MAX_SLIDE, grasps=0.0, shallowest=SHALLOWEST)


def _presses(paths: ToolPaths) -> tuple[Poses, Contact]:
    (ball,), duration = paths.press(SEED)
    home = ball.poses(np.zeros(1))[0, :3]

    def poses(time: float) -> Any:
        place = ball.poses(np.array([time % PRESS_SECONDS * duration / PRESS_SECONDS]))[0]
        return place[:3] - home, place[3:]

    return poses, Contact(ball.tool, home, friction=ball.friction)
