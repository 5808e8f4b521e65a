"""A surface file or a label map as a scene: liver tissue, held at the side away from the first view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.core.faults import InputError
from palpate.scenes.description import Description, Region, Shape, Support, with_settings
from palpate.scenes.label_parts import resolve_labels
from palpate.scenes.names import SceneKind
from palpate.scenes.places import place_of_text
from palpate.scenes.scene import Scene, title_of_file
from palpate.scenes.spacing import TRAINING_NODES, spacing_for
from palpate.surface.labels.reading import is_label_map


def open_surface(
    file: str | Path,
    settings: Mapping[str, Any],
    *,
    part: tuple[str, ...],
    labels: str | Path | None,
    without: tuple[str, ...],
    fixed: tuple[str, ...],
) -> Scene:
    """Open a surface file or a label map for `palpate.open_scene`, which has the parameters."""
    about = with_settings(
        Description(
            surface=Shape(file=str(file), parts=part, labels="" if labels is None else str(labels)),
            support=tuple(Support(place=place_of_text(text)) for text in fixed),
        ),
        settings,
    )
    chosen = about.surface.parts
    parts, regions, notes, subtitle = chosen, tuple[Region, ...](), list[str](), ""
    if is_label_map(file):
        names = Path(about.surface.labels) if about.surface.labels else None
        parts, regions, notes, subtitle = resolve_labels(
            Path(file), names, chosen, without, about.surface.scale, about.body.spacing
        )
    elif without:
        raise InputError(f"without must be left out unless a label map is given, got {str(file)!r:.60}")
    title = "" if len(parts) == len(chosen) else title_of_file(file, chosen)
    about = replace(about, title=title, surface=replace(about.surface, parts=parts), region=regions)
    scene = Scene(about, Path(), str(file), settings)
    _ = scene.material  # raises for a wrong law or parameter
    scene.notes += [f"label map: {note}" for note in notes]
    scene.subtitle = subtitle
    return scene


def complete_for_training(scene: Scene) -> Scene:
    """Return a scene with what training requires: its own spacing, or one that gives about `TRAINING_NODES`.

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
    return scene.with_body(spacing=spacing_for(TRAINING_NODES, abs(scene.surface.volume)))
