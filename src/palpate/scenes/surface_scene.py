"""The scene of a surface file alone: liver tissue, held at the side away from the first view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from palpate.faults import InputError
from palpate.parameters import check_number, fields_of
from palpate.scenes.description import Body, Description, Shape, Support, Tissue, with_settings
from palpate.scenes.names import SceneKind
from palpate.scenes.organ_scene import OrganScene
from palpate.scenes.places import place_of_text

__all__ = ["surface_scene"]


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
    description = Description(
        title="",
        surface=Shape(
            file=str(file),
            parts=tuple(part),
            units=units or "",
            scale=scale,
            labels="" if labels is None else str(labels),
        ),
        body=Body(spacing=spacing),
        tissue=Tissue(law=law or "NeoHookean"),
        support=tuple(Support(place=place_of_text(text)) for text in fixed),
    )
    scene = OrganScene(with_settings(description, settings or {}), Path(), str(file), SceneKind.SURFACE_FILE, settings)
    _ = scene.material  # raises for a wrong law or parameter
    return scene
