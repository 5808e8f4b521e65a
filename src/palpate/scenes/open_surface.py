"""Opening of a surface file alone: liver tissue, held at the side away from the first view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core.faults import InputError
from palpate.core.parameters import check_number, fields_of
from palpate.scenes.description import Body, Description, Region, Shape, Support, Tissue, with_settings
from palpate.scenes.label_parts import whole_body
from palpate.scenes.names import SceneKind
from palpate.scenes.places import place_of_text
from palpate.scenes.scene import Scene, title_of_file
from palpate.surface.labels.reading import is_label_map

NODES_PER_CELL = 1.45  # nodes over volume / spacing^3 in a filled organ
TRAINED_NODES = 4500  # of a body without a spacing; statics of training take 5,000 at most


def open_surface(
    file: str | Path,
    *,
    units: str | None = None,
    scale: float = 1.0,
    part: Sequence[str] = (),
    spacing: float | None = None,
    law: str | None = None,
    settings: Mapping[str, Any] | None = None,
    fixed: Sequence[str] = (),
    labels: str | Path | None = None,
    without: Sequence[str] = (),
) -> Scene:
    """Open a surface file or a label map.

    Parameters
    ----------
    units : str, optional
        Unit of the file.
    scale : float
        Factor of all lengths.
    part : sequence of str
        Names or patterns of parts of the file.
    spacing : float, optional [m]
    law : str, optional
        Name of a law; by default neo-Hookean with the shear modulus of liver.
    settings : mapping
        Parameters of the law and other settings (`palpate.open_scene`).
    fixed : sequence of str
        ``x-``, ``back``, ``left``, ``lowest 15%``, ``near X,Y,Z,R`` [mm], or ``painted FILE`` in the unit of the
        surface, with ``:FIELD`` where the file has several; by default ``back``, of each body.
    labels : path, optional
        File of names that a label map lacks.
    without : sequence of str
        Labels of a map that lie in the body and do not join it (`palpate.surface.labels.inner`).

    Raises
    ------
    ChoiceError
        A label map has several labels, and no part was chosen.
    InputError
        An argument is wrong, or no label of `without` joins the body.
    """
    for name, value, section in (("scale", scale, Shape), ("spacing", spacing, Body)):
        if value is not None:
            try:
                check_number(value, fields_of(section)[name][0].metadata)
            except InputError as error:
                raise InputError(f"{name} {error}") from None
    parts, regions, notes, subtitle = tuple(part), tuple[Region, ...](), list[str](), ""
    if is_label_map(file):
        names = None if labels is None else Path(labels)
        parts, regions, notes, subtitle = whole_body(Path(file), names, parts, tuple(without), scale, spacing)
    elif without:
        raise InputError(f"without must be left out unless a label map is given, got {str(file)!r:.60}")
    description = Description(
        title="" if len(parts) == len(part) else title_of_file(file, tuple(part)),
        surface=Shape(
            file=str(file),
            parts=parts,
            units=units or "",
            scale=scale,
            labels="" if labels is None else str(labels),
        ),
        body=Body(spacing=spacing),
        tissue=Tissue(law=law or "NeoHookean"),
        region=regions,
        support=tuple(Support(place=place_of_text(text)) for text in fixed),
    )
    scene = Scene(with_settings(description, settings or {}), Path(), str(file), settings)
    _ = scene.material  # raises for a wrong law or parameter
    scene.notes += [f"label map: {note}" for note in notes]
    scene.subtitle = subtitle
    return scene


def complete_for_training(scene: Scene) -> Scene:
    """Return a scene with what training requires: its own spacing, or one that gives about `TRAINED_NODES`.

    That of a surface file depends on the file, and not on the folder from which it was opened.
    """
    about = scene.description
    if scene.kind is SceneKind.SURFACE_FILE:
        file = Path(scene.name).absolute()
        support = tuple(
            replace(each, place=replace(each.place, painted=replace(
                each.place.painted, file=str(Path(each.place.painted.file).absolute())
            ))) if each.place.painted else each
            for each in about.support
        )  # fmt: skip
        names = str(Path(about.surface.labels).absolute()) if about.surface.labels else ""
        about = replace(about, surface=replace(about.surface, file=file.name, labels=names), support=support)
        opened, scene = scene, Scene(about, file.parent, str(file))
        scene.take_surface(opened)
    if about.body.spacing or scene.surface is None:
        return scene
    spacing = np.cbrt(NODES_PER_CELL * abs(scene.surface.volume) / TRAINED_NODES)
    return scene.with_body(spacing=float(f"{spacing:.3g}"))
