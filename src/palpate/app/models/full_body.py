"""A full body without training: a scene with a spacing for real time on this machine."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np

from palpate.app.common.arguments import option_names
from palpate.app.common.console import count_nodes
from palpate.app.models.force_error import force_error_text
from palpate.app.models.spacing import (
    BUSY_SHARE,
    FINER_FACTOR,
    FINER_NODES,
    MAX_FINER_TRIALS,
    MAX_NODES,
    realtime_spacing,
)
from palpate.core.faults import CloudError, InputError
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.solid.model import EnergySolid
from palpate.scenes.names import SceneKind
from palpate.scenes.scene import Scene
from palpate.scenes.spacing import NODES_PER_CELL, expected_nodes

PACKAGE_OPTIONS = ("--spacing", "--set")  # of the choices of a scene of the package

Status = Callable[[str], AbstractContextManager[None]]  # shows a phase of the work, such as `Console.status`


def prepare_full_body(scene: Scene, status: Status, spacing: float | None = None) -> Scene:
    """Return a scene with its full body; `full_body_lines` returns what was guessed and repaired.

    Its spacing is the finest in real time on this machine, or `spacing` [m] in its place. A larger spacing of the
    scene stays, and so does any spacing that a user gives for a surface without a scene file.
    """
    if scene.description.surface.file:
        with status("checking the surface"):
            _ = scene.repaired_surface
    requested, surface = scene.description.body.spacing, scene.surface
    if surface is None:  # a box or a disc, which is small
        return _prepared(scene, status)
    if requested is not None and scene.kind is not SceneKind.SCENE_FILE and _is_given(scene):
        return fill_scene(scene, requested, True, status)
    if spacing is None:
        with status("measuring this machine"):
            spacing = realtime_spacing(abs(surface.volume), scene.material)
    coarsest = max(requested or 0.0, spacing)
    return fill_scene(scene, coarsest, coarsest == requested, status)


def _is_given(scene: Scene) -> bool:
    """Return True if a user gave the spacing, which a scene of the package states, too."""
    return scene.kind is SceneKind.SURFACE_FILE or any(key.rpartition(".")[2] == "spacing" for key in scene.settings)


def fill_scene(scene: Scene, spacing: float, required: bool, status: Status) -> Scene:
    """Return a scene with the body of a spacing [m], or of a finer one for thin tissue unless it is `required`."""
    surface = scene.surface
    assert surface is not None
    volume = abs(surface.volume)
    for trial in range(MAX_FINER_TRIALS + 1):
        _check_count(volume, spacing)
        if spacing > surface.size:
            raise InputError(f"spacing must be at most the size of the surface, got {spacing:g} m; use a smaller one")
        try:
            return _prepared(scene.with_body(spacing=spacing), status)
        except CloudError:  # too thin for the spacing
            finer = float(f"{FINER_FACTOR * spacing:.2g}")
            if required or trial == MAX_FINER_TRIALS or expected_nodes(volume, finer) > MAX_NODES:
                raise
            spacing = finer
    raise AssertionError("the last trial returns or raises")


def _prepared(scene: Scene, status: Status) -> Scene:
    with status("filling the surface with nodes"):
        _ = scene.cloud
    with status("preparing the body (the first time on a machine compiles it)"):
        body = scene.body
    if not isinstance(body, EnergySolid | Membrane):
        raise InputError("form of [body] must be 'energy' for a body in real time, got 'strong'; change it")
    return scene


def _check_count(volume: float, spacing: float) -> None:
    count = expected_nodes(volume, spacing)
    if count > MAX_NODES:
        coarser = np.cbrt(NODES_PER_CELL * volume / MAX_NODES)
        raise InputError(
            f"spacing must give at most {MAX_NODES} nodes for a full body, got {1e3 * spacing:.3g} mm (about "
            f"{count:.0f} nodes); use {1e3 * coarser:.2g} mm or more, or train a reduced model"
        )


def full_body_lines(scene: Scene, fitted: Scene) -> list[str]:
    """Return lines about the body of `prepare_full_body`: guesses, repairs, notes, and the options that change them."""
    body, cloud = fitted.body, fitted.body.cloud
    guessed = cloud.spacing != scene.description.body.spacing
    lines = notes_of(scene, fitted)
    lines.append(
        f"body: {count_nodes(len(cloud))} {1e3 * cloud.spacing:.3g} mm apart"
        + (", the finest in real time on this machine" if guessed else "")
        + f", {1e3 * np.ptp(cloud.points, axis=0).max():.3g} mm long{_remedy(scene, '--spacing, --units, --scale')}"
    )
    if scene.surface is not None:
        lines.append(f"{force_line(fitted)}; {_finer_text(len(cloud), guessed)}")
    material = body.material
    lines.append(
        f"tissue: {type(material).__name__}, shear modulus {1e-3 * material.shear_modulus:.3g} kPa, Poisson's ratio "
        f"{material.poisson:.3g}{_remedy(scene, '--law, --set')}"
    )
    supports = " and ".join(f"{each.place.title} ({each.kind})" for each in scene.description.support)
    supported = np.unique(
        np.concatenate([cloud.group(each.group) for each in body.supports] or [np.zeros(0, dtype=int)])
    )
    lines.append(
        f"support: {supports.replace(' (fixed)', '') or 'the side away from the first view'} ({len(supported)} nodes)"
        + _remedy(scene, "--fixed")
    )
    return lines


def _remedy(scene: Scene, options: str) -> str:
    """Return the end of a line: the option or key that changes a choice."""
    if scene.kind is SceneKind.PACKAGE:
        options = ", ".join(each for each in options.split(", ") if each in PACKAGE_OPTIONS)
    option = scene.name if scene.kind is SceneKind.SCENE_FILE else options
    return f"; another: {option}" if option else ""


def notes_of(scene: Scene, fitted: Scene) -> list[str]:
    """Return what was guessed, repaired, added or left out, with options in place of arguments."""
    return [option_names(line) for line in dict.fromkeys([*scene.notes, *fitted.notes])]


def force_line(fitted: Scene) -> str:
    """Return a line about the error of the force against finite elements."""
    return f"force against finite elements: its error is {force_error_text(len(fitted.body.cloud))}"


def _finer_text(nodes: int, realtime: bool) -> str:
    """Return the nodes and the time at half the spacing."""
    times = 2 * FINER_NODES  # twice the steps
    cost = f"some {1 / (BUSY_SHARE * times):.1g} of real time" if realtime else f"{times:.0f} times the time"
    return f"half the spacing here: about {FINER_NODES * nodes:,.0f} nodes, {cost}"


def is_guessed(scene: Scene, fitted: Scene) -> bool:
    """Return True if the spacing of a fitted body is that of this machine, not one that a user gave."""
    return scene.surface is not None and fitted.body.cloud.spacing != scene.description.body.spacing
