"""``palpate run SCENE --realtime``: step the body of a scene under repeated presses or moves of its tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.common.console import Console
from palpate.app.models.trained import model_file, trained_model
from palpate.app.run.realtime import Poses, run_realtime
from palpate.dynamics.contact.blade import Scalpel
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import InputError
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.description import Cut
from palpate.scenes.organ_scene import OrganScene
from palpate.scenes.scene_paths import MIN_RADIUS, touching_paths
from palpate.scenes.surface_scene import named_scene

__all__ = ["pressing_ball", "run_scene_realtime"]

UNTRAINED_SEED = 1_500_000  # of a path that was not trained on
PRESS_SECONDS, SWING_SECONDS = 2.0, 3.0  # [s] duration of such a path
REST_SECONDS = 1.0  # [s] of a scalpel above the body at first
CUT_SHARE, MAX_CUT_DEPTH = 0.25, 0.015  # of the size of a body that is cut, and [m] depth of the cut at most
AIR_GAP, SCALPEL_LENGTH = 0.005, 0.03  # [m] of a scalpel over the body at first, and of its edge
NO_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])
MAX_PRESS_DEPTH, MIN_DEPTH_SHARE = 0.015, 2 / 3  # [m] depth of the press at most; least depth over that


def run_scene_realtime(
    *,
    scene: str,
    settings: Mapping[str, Any],
    part: Sequence[str] | None = None,
    labels: Path | None = None,
    model: Path | None = None,
    full: bool = False,
    cut: bool = False,
    **options: Any,
) -> int:
    """Step a scene's body in real time for some seconds under its moving tool, and report missed deadlines.

    Parameters
    ----------
    scene : str
        As for `palpate.open_scene`, or a surface file.
    settings : mapping
        Its settings.
    part, labels
        Of a surface file, as for `palpate.io.read_surface`.
    model : path, optional
        File of a reduced model of the scene. By default that of the scene, trained at the first use.
    full : bool
        Step the full body in place of a reduced model.
    cut : bool
        Step the full body, and cut it with a scalpel.
    options : mapping
        ``seconds``, ``rate``, ``out`` and ``as_json``: see `palpate.app.run.realtime.run_realtime`.

    Returns
    -------
    int
        0, whether the rate was held or not.
    """
    full = full or cut
    if full and model is not None:
        given = "--cut" if cut else "--full"
        raise InputError(f"model must be left out with {given}, got {str(model)!r}; leave out one of the two")
    opened = named_scene(scene, settings, part, labels)
    about: dict[str, Any] = {"full": True} if full else {"file": str(model_file(opened) if model is None else model)}

    def make(console: Console) -> tuple[Any, Poses, Contact | None]:
        if full:
            with console.status("filling the surface with nodes (the first time on a machine compiles it)"):
                body = opened.body
        else:
            body = trained_model(opened, console) if model is None else load(model)  # type: ignore[assignment]
        if cut:
            return body, *cutting_scalpel(body, opened.description.cut)
        if opened.held_group:
            return body, opened.held_motion(UNTRAINED_SEED, SWING_SECONDS), None
        return body, *pressing_ball(opened, body, model)

    if cut:
        about |= {"toughness": opened.description.cut.toughness}
    title = f"{'Full ' + opened.title.lower() if full else opened.title} in real time"
    return run_realtime(make, title=title, about=about, **options)


def cutting_scalpel(body: Any, cut: Cut) -> tuple[Poses, Contact]:
    """Return the poses of a scalpel that cuts across the top of a body, and the scalpel at its first pose.

    It goes down into the body, along its longest horizontal axis, and out again.

    Parameters
    ----------
    cut : Cut
        Section of a scene. Sizes that it leaves out fit the body.
    """
    points, spacing = body.cloud.points, body.cloud.spacing
    if points.shape[1] != 3 or not isinstance(body, EnergySolid):
        raise InputError("body that a scalpel cuts must be a solid in the energy form, got another; use another scene")
    centre, size = points.mean(axis=0), np.ptp(points, axis=0)
    axis = int(np.argmax(size[:2]))
    length = cut.cut_length or CUT_SHARE * size[axis]
    near = np.abs(points[:, :2] - centre[:2])
    above = points[(near[:, axis] < 0.5 * length) & (near[:, 1 - axis] < 2 * spacing)]
    depth = cut.cut_depth or min(MAX_CUT_DEPTH, CUT_SHARE * np.ptp(above[:, 2]))
    edge_length = cut.edge_length or max(SCALPEL_LENGTH, 4 * spacing)
    blade = Scalpel(length=edge_length, toughness=cut.toughness, friction=cut.shear_stress, wedge=cut.wedge)
    along = np.zeros(3)
    along[axis] = 1.0
    first = np.array([*(centre[:2] - 0.5 * length * along[:2]), above[:, 2].max() + AIR_GAP])
    down, across = (AIR_GAP + depth) / cut.cut_speed, length / cut.cut_speed
    times = np.cumsum([0.0, REST_SECONDS, down, across, down])
    turns = np.array([[0, 0, 0], [0, 0, 0], [0, 0, -down], [0, 0, -down], [0, 0, 0]]) * cut.cut_speed
    ways = np.array([0.0, 0.0, 0.0, length, length])

    def poses(time: float) -> Any:
        place = [np.interp(time, times, column) for column in (turns + ways[:, None] * along).T]
        return np.array(place), NO_ROTATION

    rotation = (0.0, 0.0, 0.5 * np.pi * axis)
    return poses, Contact(blade, (tuple(first), rotation), name="scalpel")


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
