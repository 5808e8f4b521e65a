"""A full body without training: a scene with a spacing for real time on this machine."""

from __future__ import annotations

import numpy as np

from palpate.app.common.arguments import option_names
from palpate.app.common.console import Console, count_nodes
from palpate.app.models.force_error import force_error_text
from palpate.app.models.spacing import BUSY_SHARE, MOST_NODES, realtime_spacing
from palpate.core.faults import CloudError, InputError
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.solid.model import EnergySolid
from palpate.scenes.names import SceneKind
from palpate.scenes.open_surface import NODES_PER_CELL
from palpate.scenes.scene import Scene

FINER_FACTOR, MAX_FINER_TRIALS = 0.8, 4  # factor of a guessed spacing that is too coarse for the tissue; how often
FINER_NODES = 6.7  # the nodes of half the spacing over those of the whole (validation/spacing_force.py)


def prepare_full_body(scene: Scene, console: Console, spacing: float | None = None) -> Scene:
    """Return a scene with its full body; print guesses, repairs and notes.

    Its spacing is the finest in real time on this machine, or `spacing` [m] in its place. A larger spacing of the
    scene stays, and so does any spacing that a user gives for a surface without a scene file.
    """
    if scene.description.surface.file:
        with console.status("checking the surface"):
            _ = scene.repaired_surface
    given, surface = scene.description.body.spacing, scene.surface
    if surface is None:  # a box or a disc, which is small
        fitted = _prepared(scene, console)
    elif given is not None and scene.kind is not SceneKind.SCENE_FILE:
        fitted = fill_scene(scene, given, True, console)
    else:
        if spacing is None:
            with console.status("measuring this machine"):
                spacing = realtime_spacing(abs(surface.volume), scene.material)
        coarsest = max(given or 0.0, spacing)
        fitted = fill_scene(scene, coarsest, coarsest == given, console)
    body, cloud = fitted.body, fitted.cloud
    for line in notes_of(scene, fitted):
        console.say(line)
    guessed = cloud.spacing != given
    console.say(
        f"body: {count_nodes(len(cloud))} {1e3 * cloud.spacing:.3g} mm apart"
        + (", the finest in real time on this machine" if guessed else "")
        + f", {1e3 * np.ptp(cloud.points, axis=0).max():.3g} mm long{_remedy(scene, '--spacing, --units, --scale')}"
    )
    if scene.description.surface.file:
        console.say(f"{force_line(fitted)}; {_finer_text(len(cloud), guessed)}")
    material = body.material
    console.say(
        f"tissue: {type(material).__name__}, shear modulus {1e-3 * material.shear_modulus:.3g} kPa, Poisson's ratio "
        f"{material.poisson:.3g}{_remedy(scene, '--law, --set')}"
    )
    supports = " and ".join(f"{each.place.title} ({each.kind})" for each in scene.description.support)
    supported = np.unique(
        np.concatenate([cloud.group(each.group) for each in body.supports] or [np.zeros(0, dtype=int)])
    )
    console.say(
        f"support: {supports.replace(' (fixed)', '') or 'the side away from the first view'} ({len(supported)} nodes)"
        + _remedy(scene, "--fixed")
    )
    return fitted


def _remedy(scene: Scene, options: str) -> str:
    """Return the end of a line: the option or key that changes a choice."""
    return f"; another: {scene.name}" if scene.kind is SceneKind.SCENE_FILE else f"; another: {options}"


def fill_scene(scene: Scene, spacing: float, required: bool, console: Console) -> Scene:
    """Return a scene with the body of a spacing [m], or of a finer one for thin tissue.

    Parameters
    ----------
    scene : Scene
        Of a surface.
    spacing : float [m]
    required : bool
        Whether a finer spacing is not allowed.
    """
    surface = scene.surface
    assert surface is not None
    volume = abs(surface.volume)
    for trial in range(MAX_FINER_TRIALS + 1):
        _check_count(volume, spacing)
        if spacing > surface.size:
            raise InputError(f"spacing must be at most the size of the surface, got {spacing:g} m; use a smaller one")
        try:
            return _prepared(scene.with_body(spacing=spacing), console)
        except CloudError:  # too thin for the spacing
            finer = float(f"{FINER_FACTOR * spacing:.2g}")
            if required or trial == MAX_FINER_TRIALS or _count(volume, finer) > MOST_NODES:
                raise
            spacing = finer
    raise AssertionError("the last trial returns or raises")


def _prepared(scene: Scene, console: Console) -> Scene:
    with console.status("filling the surface with nodes"):
        _ = scene.cloud
    with console.status("preparing the body (the first time on a machine compiles it)"):
        body = scene.body
    if not isinstance(body, EnergySolid | Membrane):
        raise InputError("form of [body] must be 'energy' for a body in real time, got 'strong'; change it")
    return scene


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


def _count(volume: float, spacing: float) -> float:
    """Return the expected number of nodes."""
    return float(NODES_PER_CELL * volume / spacing**3)


def _check_count(volume: float, spacing: float) -> None:
    count = _count(volume, spacing)
    if count > MOST_NODES:
        coarser = np.cbrt(NODES_PER_CELL * volume / MOST_NODES)
        raise InputError(
            f"spacing must give at most {MOST_NODES} nodes for a full body, got {1e3 * spacing:.3g} mm (about "
            f"{count:.0f} nodes); use {1e3 * coarser:.2g} mm or more, or train a reduced model"
        )
