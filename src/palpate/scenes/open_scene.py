"""Opening of scene files, and of the scenes of the package, which are such files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from palpate.dynamics.solid.model import Solid
from palpate.faults import InputError, brief
from palpate.reduction.contact.residual_flexibility import MAX_NODES
from palpate.scenes.description import Description, with_settings
from palpate.scenes.names import SCENES, is_scene_file
from palpate.scenes.organ_scene import OrganScene
from palpate.scenes.scene import TrainingScene
from palpate.scenes.scene_text import parse_scene, read_scene

__all__ = ["DIGEST", "open_scene", "training_scene_of"]

COARSE_NODES = 0.7 * MAX_NODES  # of the coarse body of a fine one
DIGEST = "digest"  # parameter of a training scene from a file: digest of what it depends on


def open_scene(what: str | Path, settings: Mapping[str, Any] | None = None) -> OrganScene:
    """Open a scene file, or a scene of the package.

    Parameters
    ----------
    what : str or path
        A file that ends in ``.toml``, or ``"beam"``, ``"liver"`` or ``"membrane"``.
    settings : mapping of str to value, optional
        Values in place of those in the file, such as ``{"spacing": 0.006, "tissue.poisson": 0.4}``. Texts may carry
        units.

    Returns
    -------
    OrganScene
        Its `body`, `loads` and `paths`; the surface and the body are made when they are first used.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileFormatError
        The file is not TOML.
    InputError
        No such scene, or a key or a value is wrong; the message names the file, the line and the key.

    Examples
    --------
    >>> import palpate as pt
    >>> scene = pt.open_scene("beam", {"poisson": 0.3})
    >>> scene.body.material.poisson
    0.3
    """
    if str(what) in SCENES:
        text = (files("palpate.scenes") / "data" / f"{what}.toml").read_text(encoding="utf-8")
        description, folder = parse_scene(text, f"{what}.toml of palpate"), Path()
    elif is_scene_file(str(what)):
        description, folder = read_scene(Path(what)), Path(what).parent
    else:
        raise InputError(f"scene must be {', '.join(SCENES)}, or a file that ends in .toml, got {brief(str(what))}")
    return _with(description, settings or {}, folder, str(what))


def _with(description: Description, settings: Mapping[str, Any], folder: Path, name: str) -> OrganScene:
    return OrganScene(with_settings(description, settings), folder, name, settings)


def training_scene_of(scene: OrganScene, parameters: Mapping[str, Any]) -> TrainingScene:
    """Return the body and the paths of a scene for a campaign.

    Parameters
    ----------
    scene : OrganScene
    parameters : mapping
        Settings with which the scene was opened. A digest among them must be that of the scene.

    Raises
    ------
    InputError
        The scene file, or a file that it names, is not what it was; or as `OrganScene.body` and `OrganScene.paths`.
    """
    given = dict(parameters)
    digest = given.pop(DIGEST, None)
    for name, value in given.items():
        if not isinstance(value, str | int | float):  # as a campaign and a model file keep it
            raise InputError(f"{name} must be a number or a text to train with, got {brief(value)}; change the file")
    if digest not in (None, scene.digest):
        raise InputError(
            f"{scene.name}, or a file that it names, has changed; open the changed scene in another folder"
        )
    training = scene.description.training
    tools = (scene.held_group,) if scene.held_group else ()
    made = TrainingScene(
        scene.body, scene.paths, training.every, scene.title, given | {DIGEST: scene.digest}, tools,
        coarse=None if tools or len(scene.cloud) <= MAX_NODES else lambda: _coarse_body(scene),
    )  # fmt: skip
    return made if training.cubature is None else replace(made, cubature=training.cubature)


def _coarse_body(scene: OrganScene) -> Solid:
    """Return the body of a scene with fewer nodes, for its vibration modes and statics."""
    ratio = (len(scene.cloud) / COARSE_NODES) ** (1 / 3)
    coarse = scene.with_body(spacing=scene.cloud.spacing * ratio, form="energy").body
    assert isinstance(coarse, Solid)  # as membranes have a tool that holds a group
    return coarse
