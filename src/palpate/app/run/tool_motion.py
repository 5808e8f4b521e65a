"""Motions of the tool of a scene in real time: repeated presses of a ball, moves of a group, or a cut."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from palpate.app.models.input import Input
from palpate.app.session.play import Poses
from palpate.core.faults import InputError
from palpate.dynamics.contact.blade import Scalpel
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.solid.model import EnergySolid
from palpate.reduction.hyper.model import ReducedModel
from palpate.scenes.description import Cut
from palpate.scenes.scene import Scene
from palpate.scenes.scene_paths import MIN_RADIUS, touching_paths

UNTRAINED_SEED = 1_500_000  # of a path that was not trained on
PRESS_SECONDS, SWING_SECONDS = 2.0, 3.0  # [s] duration of such a path
REST_SECONDS = 1.0  # [s] of a scalpel above the body at first
CUT_SHARE, MAX_CUT_DEPTH = 0.25, 0.015  # of the size of a body that is cut, and [m] depth of the cut at most
AIR_GAP, SCALPEL_LENGTH = 0.005, 0.03  # [m] of a scalpel over the body at first, and of its edge
NO_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])
MAX_PRESS_DEPTH, MIN_DEPTH_SHARE = 0.015, 2 / 3  # [m] depth of the press at most; least depth over that


def tool_motion(opened: Input, body: Any, cut: bool) -> tuple[Poses, Contact | None]:
    """Return the poses of the tool of a scene, and the tool at its first pose; None for one that moves a group."""
    scene = opened.scene
    if scene is None:
        raise InputError(f"script must be given for the model of a file, got none for {opened.name}; or name a scene")
    if cut:
        return cutting_scalpel(body, scene.description.cut)
    if not scene.held_group:
        return pressing_ball(scene, body, opened.name)
    if not isinstance(body, ReducedModel):
        raise InputError(f"full must be left out for {scene.name}, whose tool holds a group, got it; leave it out")
    if len(body.data.prescribed) != 1:
        raise InputError(
            f"model must have one prescribed group for the engine, got {len(body.data.prescribed)}; "
            f"train one with palpate train {scene.name}"
        )
    return scene.held_motion(UNTRAINED_SEED, SWING_SECONDS), None


def cutting_scalpel(body: Any, cut: Cut) -> tuple[Poses, Contact]:
    """Return the poses of a scalpel that cuts across the top of a body, and the scalpel at its first pose.

    It goes down into the body, along its longest horizontal axis, and out again. Sizes that the section of the scene
    leaves out fit the body.
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


def pressing_ball(scene: Scene, body: Any, name: str = "") -> tuple[Poses, Contact]:
    """Return the poses of a ball that presses a body repeatedly, and the ball at its first pose."""
    if isinstance(body, ReducedModel) and body.data.compliance is None:
        raise InputError(
            f"model must be one that was trained on a body that a ball touches, got {name!r}; train one with "
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
