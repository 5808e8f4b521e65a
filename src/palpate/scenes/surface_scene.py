"""The scene of a surface file alone: liver tissue, held at the side away from the first view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.faults import InputError
from palpate.parameters import check_number, fields_of
from palpate.scenes.description import Body, Description, Region, Shape, Support, Tissue, with_settings
from palpate.scenes.label_parts import whole_body
from palpate.scenes.names import SceneKind, kind_of
from palpate.scenes.open_scene import open_scene
from palpate.scenes.organ_scene import OrganScene
from palpate.scenes.places import place_of_text
from palpate.surface.labels.reading import is_label_map

NODES_PER_CELL = 1.45  # nodes over volume / spacing^3 in a filled organ
REFINED_NODES = 4500  # of a body without a spacing; statics of training take 5,000 at most


def surface_scene(
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
) -> OrganScene:
    """Return the scene of a surface file or a label map.

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
    """
    for name, value, section in (("scale", scale, Shape), ("spacing", spacing, Body)):
        if value is not None:
            try:
                check_number(value, fields_of(section)[name][0].metadata)
            except InputError as error:
                raise InputError(f"{name} {error}") from None
    parts, regions, notes = tuple(part), tuple[Region, ...](), list[str]()
    if is_label_map(file):
        parts, regions, notes = whole_body(Path(file), None if labels is None else Path(labels), parts, scale, spacing)
    description = Description(
        title="",
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
    scene = OrganScene(with_settings(description, settings or {}), Path(), str(file), SceneKind.SURFACE_FILE, settings)
    _ = scene.material  # raises for a wrong law or parameter
    scene.notes += [f"label map: {note}" for note in notes]
    return scene


def refined_scene(scene: OrganScene) -> OrganScene:
    """Return the scene of the reduced model: with its own spacing, or with one that gives about `REFINED_NODES`.

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
        scene = OrganScene(about, file.parent, str(file), scene.kind)
    if about.body.spacing or scene.surface is None:
        return scene
    spacing = np.cbrt(NODES_PER_CELL * abs(scene.surface.volume) / REFINED_NODES)
    return scene.with_body(spacing=float(f"{spacing:.3g}"))


def named_scene(
    what: str, settings: Mapping[str, Any] | None = None, part: Sequence[str] | None = None, labels: Path | None = None
) -> OrganScene:
    """Return a scene of the package, of a scene file, or of a surface file as `refined_scene`.

    Parameters
    ----------
    settings : mapping, optional
        As for `palpate.open_scene`.
    part, labels
        Of a surface file, as for `surface_scene`.
    """
    if kind_of(what) is SceneKind.SURFACE_FILE:
        return refined_scene(surface_scene(what, part=tuple(part or ()), labels=labels, settings=settings))
    for name, value in (("part", part), ("labels", labels)):
        if value:
            raise InputError(f"{name} must be left out unless a surface file is given, got {what!r:.60}")
    return open_scene(what, settings)
