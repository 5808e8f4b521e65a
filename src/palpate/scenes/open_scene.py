"""Opening of scene files, and of the scenes of the package, which are such files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.faults import InputError, brief
from palpate.files import json_of
from palpate.parameters import Fault, read_section, written_section
from palpate.scenes.description import Description, chooses_runs, with_settings
from palpate.scenes.names import PACKAGE_SCENES, SceneKind, kind_of
from palpate.scenes.organ_scene import OrganScene
from palpate.scenes.scene_text import parse_scene, read_scene

if TYPE_CHECKING:  # mechanics take a second to import, before a page opens
    from palpate.scenes.scene import TrainingScene

# parameters of a training scene from a file: digest of what it depends on; its description where the file alone has
# another one, or is a surface
DIGEST_KEY, DESCRIPTION_KEY = "digest", "description"


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
    kind = kind_of(str(what))
    if kind is SceneKind.PACKAGE:
        text = (files("palpate.scenes") / "data" / f"{what}.toml").read_text(encoding="utf-8")
        description, folder = parse_scene(text, f"{what}.toml of palpate"), Path()
    elif kind is SceneKind.SCENE_FILE:
        description, folder = read_scene(Path(what)), Path(what).parent
    else:
        near = get_close_matches(str(what)[:60], PACKAGE_SCENES, 1)
        remedy = f"; did you mean {near[0]}?" if near else ""
        raise InputError(
            f"scene must be {', '.join(PACKAGE_SCENES)}, or a file that ends in .toml, got {brief(str(what))}{remedy}"
        )
    return OrganScene(with_settings(description, settings or {}), folder, str(what), kind, settings)


def text_of_scene(scene: OrganScene) -> str:
    """Return the description of a scene as JSON, for `described_scene`."""
    return json.dumps(written_section(scene.description))


def described_scene(name: str, text: str) -> OrganScene:
    """Return the scene of a description as JSON.

    Parameters
    ----------
    name : str
        A scene of the package, or a scene file or a surface file, next to which the description's files are.
    """
    try:
        description: Description = read_section(Description, json_of(text))
    except Fault as fault:
        raise InputError(f"{DESCRIPTION_KEY} must be that of a scene, got one whose {fault.message}") from fault
    kind = kind_of(name)
    return OrganScene(description, Path() if kind is SceneKind.PACKAGE else Path(name).parent, name, kind)


def training_scene_of(scene: OrganScene, parameters: Mapping[str, Any]) -> TrainingScene:
    """Return the body and the paths of a scene for a campaign.

    Parameters
    ----------
    parameters : mapping
        Settings with which the scene was opened. A digest among them must be that of the scene.
    """
    from palpate.scenes.scene import TrainingScene

    given = dict(parameters)
    digest, text = given.pop(DIGEST_KEY, None), given.get(DESCRIPTION_KEY)
    for name, value in given.items():
        if not isinstance(value, str | int | float):  # as a campaign and a model file keep it
            raise InputError(f"{name} must be a number or a text to train with, got {brief(value)}; change the file")
    if text is not None and text != text_of_scene(scene):
        raise InputError(f"{DESCRIPTION_KEY} must be that of the scene, got another one; open the scene by it")
    if digest not in (None, scene.digest):
        raise InputError(
            f"{scene.name}, or a file that it names, has changed; open the changed scene in another folder"
        )
    training = scene.description.training
    tools = (scene.held_group,) if scene.held_group else ()
    # a campaign continues with other numbers of paths and modes
    kept = {key: given[key] for key in given if key == DESCRIPTION_KEY or not chooses_runs(scene.description, key)}
    kept[DIGEST_KEY] = scene.digest
    made = TrainingScene(scene.body, scene.paths, training.every, scene.title, kept, tools)
    return made if training.cubature is None else replace(made, cubature=training.cubature)
