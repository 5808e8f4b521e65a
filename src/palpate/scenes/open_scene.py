"""Opening of scene files, of the scenes of the package, which are such files, and of descriptions as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

from palpate.core.faults import InputError, brief
from palpate.core.files import json_of, read_text
from palpate.core.parameters import Fault, read_section, written_section
from palpate.scenes.description import Description, with_settings
from palpate.scenes.names import PACKAGE_SCENES, SceneKind, kind_of
from palpate.scenes.scene import Scene
from palpate.scenes.scene_text import MAX_BYTES, parse_description
from palpate.surface.formats.first_bytes import refuse_misnamed


def open_scene(what: str | Path, settings: Mapping[str, Any] | None = None) -> Scene:
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
    Scene
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
        description, folder = parse_description(text, f"{what}.toml of palpate"), Path()
    elif kind is SceneKind.SCENE_FILE:
        path = Path(what)
        description, folder = parse_description(read_text(path, "scene file", MAX_BYTES), str(path)), path.parent
    else:
        refuse_misnamed(Path(str(what)))
        near = get_close_matches(str(what)[:60], PACKAGE_SCENES, 1)
        remedy = f"; did you mean {near[0]}?" if near else ""
        raise InputError(
            f"scene must be {', '.join(PACKAGE_SCENES)}, or a file that ends in .toml, got {brief(str(what))}{remedy}"
        )
    return Scene(with_settings(description, settings or {}), folder, str(what), settings)


def json_of_scene(scene: Scene) -> str:
    """Return the description of a scene as JSON, for `open_description`."""
    return json.dumps(written_section(scene.description))


def open_description(name: str, text: str) -> Scene:
    """Open a description as JSON.

    Parameters
    ----------
    name : str
        A scene of the package, or a scene file or a surface file, next to which the description's files are.
    """
    try:
        description: Description = read_section(Description, json_of(text))
    except Fault as fault:
        raise InputError(f"description must be that of a scene, got one whose {fault.message}") from fault
    return Scene(description, Path() if kind_of(name) is SceneKind.PACKAGE else Path(name).parent, name)
