"""A description with its files: what of a scene needs no mechanics.

It has the surface of the body, its tissue, the names of groups, and errors that name the place of an entry.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from palpate.describe import Described
from palpate.faults import FileFormatError, InputError
from palpate.scenes.description import Description
from palpate.scenes.names import SceneKind
from palpate.scenes.organ import liver_surface
from palpate.scenes.scene_text import line_of_file, words_of
from palpate.scenes.tissue import material_of
from palpate.surface.checks import SurfaceReport, check_surface, shape_problems
from palpate.surface.files import read_surface
from palpate.surface.labels.reading import is_label_map
from palpate.surface.repair import repair_surface
from palpate.surface.surface import Surface, scaled
from palpate.tissue.materials import Material


class SceneSource(Described):
    """Description of a scene, the folder of its files, and the surface; `OrganScene` adds the body."""

    def __init__(
        self,
        description: Description,
        folder: Path,
        name: str,
        kind: SceneKind | None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        self.description, self.folder, self.name, self.kind = description, folder, name, kind
        self.settings = dict(settings or {})
        self.notes: list[str] = []

    @cached_property
    def surface(self) -> Surface | None:
        """Closed surface of the body, repaired where it is not closed as it is; None for a box or a disc.

        Raises
        ------
        InputError, FileFormatError, FileNotFoundError
            The file cannot be read, or holds no closed surface.
        """
        shape = self.description.surface
        if shape.generated:
            return scaled(liver_surface(), shape.scale) if shape.generated == "liver" else None
        path = self.folder / shape.file
        chosen: Any = {"part": list(shape.parts) or None, "units": shape.units or None, "scale": shape.scale}
        if shape.labels:
            chosen["labels"] = self.folder / shape.labels
        if is_label_map(path):
            return read_surface(path, **chosen)
        with contextlib.suppress(InputError):  # parts that are closed after a repair alone
            surface = read_surface(path, **chosen)
            if not shape.repair or not any(problem.kind == "error" for problem in shape_problems(surface)):
                return surface
        surface = read_surface(path, **chosen, repair=shape.repair)
        _check_closed(surface)
        return surface

    @cached_property
    def repaired_surface(self) -> Surface | None:
        """The surface as it is filled."""
        if self.surface is None or self.description.surface.generated:
            return self.surface
        shape = self.description.surface
        surface = repair_surface(self.surface) if shape.repair and not is_label_map(shape.file) else self.surface
        report = _check_closed(surface)
        self.notes += [f"surface: {line}" for line in surface.warnings]
        self.notes += [f"surface, {problem.kind}: {problem.what}" for problem in report.problems]
        return surface

    @cached_property
    def material(self) -> Material:
        """Material outside all regions."""
        return material_of(self.description.tissue)


def group_name(scene: SceneSource, kind: str, number: int) -> str:
    """Return the name of the group of a support, a region or a load by its number from 0."""
    entries = getattr(scene.description, kind)
    if not entries:
        return f"{kind} {number + 1}"
    place, generated = entries[number].place, scene.description.surface.generated
    return entries[number].name or (place.group if place and generated else "") or f"{kind} {number + 1}"


@contextlib.contextmanager
def naming(scene: SceneSource, *keys: str | int) -> Iterator[None]:
    """Name the file, the line and the keys of an entry in errors."""
    try:
        yield
    except FileFormatError:
        raise
    except InputError as error:
        raise type(error)(f"{_place_of(scene, keys)}: {error}") from error


def _place_of(scene: SceneSource, keys: tuple[str | int, ...]) -> str:
    """Return the file, the line and the keys of an entry; for a surface the argument that gives supports."""
    if keys[0] == "support" and scene.kind is SceneKind.SURFACE_FILE:
        return "fixed"
    words = ".".join(words_of(keys))
    is_set = any(words == key or words.endswith(f".{key}") for key in scene.settings)
    if is_set or scene.kind is not SceneKind.SCENE_FILE:
        return words
    return f"{scene.name}, line {line_of_file(Path(scene.name), keys)}: {words}"


def _check_closed(surface: Surface) -> SurfaceReport:
    """Return the report of a surface; raise InputError if it cannot be filled."""
    report = check_surface(surface)
    if report.errors:
        raise InputError(
            f"{surface.name} must hold a closed surface, got one that is not: {report.errors[0].what}; run palpate "
            "check for pictures"
        )
    return report
