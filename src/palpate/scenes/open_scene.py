"""Opening of scenes: of the package, of scene files, of surface files and label maps, and of descriptions as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

from palpate.core.faults import InputError, brief
from palpate.core.files import json_of, read_text
from palpate.core.parameters import Fault, read_section, written_section
from palpate.scenes.description import Description, with_settings
from palpate.scenes.names import PACKAGE_SCENES, SceneKind, kind_of
from palpate.scenes.open_surface import open_surface
from palpate.scenes.scene import Scene
from palpate.scenes.scene_text import MAX_BYTES, parse_description
from palpate.surface.files import refuse_other_format
from palpate.surface.formats.first_bytes import refuse_misnamed


def open_scene(
    source: str | Path,
    settings: Mapping[str, Any] | None = None,
    *,
    part: str | Sequence[str] = (),
    labels: str | Path | None = None,
    without: str | Sequence[str] = (),
    fixed: str | Sequence[str] = (),
) -> Scene:
    """Open a scene of the package, a scene file, or a surface file or label map.

    A surface alone is a scene of liver tissue, held at the side away from the first view.

    Parameters
    ----------
    source : str or path
        ``"beam"``, ``"liver"`` or ``"membrane"``; a file that ends in ``.toml``; or a file that
        `palpate.io.read_surface` reads.
    settings : mapping of str to value, optional
        Values in place of those in the file, such as ``{"spacing": 0.006, "tissue.poisson": 0.4}``, or for a surface
        ``{"units": "mm", "law": "MooneyRivlin"}``. Texts may carry units.
    part : str or sequence of str
        Names or patterns of parts of a surface file or label map.
    labels : str or path, optional
        File of names that a label map lacks.
    without : str or sequence of str
        Labels of a map that lie in the body and do not join it.
    fixed : str or sequence of str
        What holds a surface: ``x-``, ``back``, ``left``, ``lowest 15%``, ``near X,Y,Z,R`` [mm], or ``painted FILE`` in
        the unit of the surface, with ``:FIELD`` where the file has several; by default ``back``, of each body.

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
    ChoiceError
        A label map has several labels, and no part was chosen.
    InputError
        No such scene, or a key or a value is wrong; the message names the file, the line and the key.

    Examples
    --------
    >>> import palpate as pt
    >>> scene = pt.open_scene("beam", {"poisson": 0.3})
    >>> scene.body.material.poisson
    0.3
    """
    name, settings = str(source), settings or {}
    kind = kind_of(name)
    if kind is SceneKind.SURFACE_FILE:
        return open_surface(
            source, settings, part=_texts(part), labels=labels, without=_texts(without), fixed=_texts(fixed)
        )
    for option, value in {"part": part, "labels": labels, "without": without, "fixed": fixed}.items():
        if value:
            raise InputError(f"{option} must be left out unless a surface file is given, got {name!r:.60}")
    if kind is SceneKind.PACKAGE:
        text = (files("palpate.scenes") / "data" / f"{name}.toml").read_text(encoding="utf-8")
        description, folder = parse_description(text, f"{name}.toml of palpate"), Path()
    elif kind is SceneKind.SCENE_FILE:
        path = Path(source)
        description, folder = parse_description(read_text(path, "scene file", MAX_BYTES), str(path)), path.parent
    else:
        refuse_misnamed(Path(name))
        if Path(name).is_file():
            refuse_other_format(Path(name))
        near = get_close_matches(name[:60], PACKAGE_SCENES, 1)
        remedy = f"; did you mean {near[0]}?" if near else ""
        raise InputError(
            f"source must be {', '.join(PACKAGE_SCENES)}, a file that ends in .toml, or a surface file, got "
            f"{brief(name)}{remedy}"
        )
    return Scene(with_settings(description, settings), folder, name, settings)


def _texts(given: str | Sequence[str]) -> tuple[str, ...]:
    return (given,) if isinstance(given, str) else tuple(given)


def json_of_scene(scene: Scene) -> str:
    """Return the description of a scene as JSON, for `open_description`."""
    return json.dumps(written_section(scene.description))


def open_description(name: str, text: str) -> Scene:
    """Open a description as JSON.

    `name` is a scene of the package, or a scene file or a surface file, next to which the description's files are.
    """
    try:
        description: Description = read_section(Description, json_of(text))
    except Fault as fault:
        raise InputError(f"description must be that of a scene, got one whose {fault.message}") from fault
    return Scene(description, Path() if kind_of(name) is SceneKind.PACKAGE else Path(name).parent, name)
