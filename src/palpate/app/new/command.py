"""``palpate new``: write a commented scene file for a surface, which works as it is."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.common.arguments import option_names
from palpate.app.common.console import Console, count_nodes
from palpate.app.models.full_body import fill_scene
from palpate.app.new.proposals import Proposals, propose
from palpate.app.new.text import commented_text
from palpate.core.faults import InputError
from palpate.core.files import check_folder, whole_file, write_json
from palpate.scenes.description import Support
from palpate.scenes.names import SceneKind, kind_of
from palpate.scenes.open_scene import open_scene
from palpate.scenes.scene import Scene
from palpate.scenes.schema import scene_schema
from palpate.scenes.spacing import TRAINING_NODES, spacing_for
from palpate.surface.checks import METRES_BY_UNIT
from palpate.surface.formats.first_bytes import refuse_misnamed
from palpate.surface.labels.label_map import choose_segments, segments_mask
from palpate.surface.labels.reading import is_label_map, read_label_map

SCHEMA_FILE = "scene.schema.json"


def new(
    *,
    file: Path,
    out: Path,
    part: Sequence[str] | None = None,
    labels: Path | None = None,
    units: str | None = None,
    scale: float = 1.0,
    spacing: float | None = None,
    law: str | None = None,
    fixed: Sequence[str] = (),
    without: Sequence[str] = (),
) -> int:
    """Write a scene file for a surface, and open it as a check; the file must not exist."""
    if kind_of(out.name) is not SceneKind.SCENE_FILE:
        raise InputError(f"out must end in .toml, got {str(out)!r}; name the scene file organ.toml")
    if out.exists():
        raise InputError(f"out must be a new file, got {str(out)!r}, which exists; choose another name, or remove it")
    refuse_misnamed(file)
    if kind_of(file.name) is not SceneKind.SURFACE_FILE:
        raise InputError(f"file must be a surface, got {str(file)!r}; palpate new --help lists the formats")
    check_folder(out.parent)
    console = Console()
    settings = {"units": units, "scale": scale, "spacing": spacing, "law": law}
    settings = {name: value for name, value in settings.items() if value is not None}
    scene = open_scene(file, settings, part=tuple(part or ()), labels=labels, without=without, fixed=fixed)
    proposals = None
    if is_label_map(file):
        scene, proposals = _with_proposals(scene, tuple(part or ()), tuple(without), spacing, console)
    scene, guesses = _fitted(scene, spacing, console)
    if proposals is not None:
        guesses["reasons"] = {region.name: why for region, why in proposals.regions}
        if not fixed:
            guesses["reasons"] |= {support.name: why for support, why in proposals.supports}
            guesses["support"] = "by what touches the organ in the label map"
    notes = [option_names(note) for note in scene.notes if "does not state its units" not in note]
    alternatives = [(_placed_support(each, out), why) for each, why in proposals.alternatives] if proposals else []
    text = commented_text(_placed(scene, out), guesses, notes, _schema(out), alternatives)
    _schema(out).parent.mkdir(exist_ok=True)
    write_json(_schema(out), scene_schema())
    with whole_file(out) as partial:
        partial.write_text(text, encoding="utf-8")
    open_scene(out)  # the written file can be read
    for note in notes:
        console.say(note)
    console.say(f"{out}: {count_nodes(len(scene.cloud))}, {guesses['reach']}")
    quoted = f"'{out}'" if " " in str(out) else str(out)
    console.say(f"touch it:         palpate view {quoted}")
    console.say(f"a finer model:    palpate view {quoted} --refine, or palpate train {quoted}")
    return 0


def _fitted(scene: Scene, spacing: float | None, console: Console) -> tuple[Scene, dict[str, Any]]:
    """Return the scene with spacing, unit, tool and depth filled in, and words about the guesses."""
    with console.status("checking the surface"):
        surface = scene.repaired_surface
    assert surface is not None
    volume, about = abs(surface.volume), scene.description
    target_spacing = spacing_for(TRAINING_NODES, volume) if spacing is None else spacing
    fitted = fill_scene(scene, target_spacing, spacing is not None, console.status)
    with console.status("finding where a tool reaches"):
        paths = fitted.tool_paths()
    unit = min(METRES_BY_UNIT, key=lambda name: abs(np.log(METRES_BY_UNIT[name] * about.surface.scale / surface.unit)))
    area = paths.surface.areas
    reach, held_share = area[paths.reachable].sum() / area.sum(), area[paths.surface.held].sum() / area.sum()
    description = replace(
        fitted.description,
        title=fitted.title,
        surface=about.surface if is_label_map(about.surface.file) else replace(about.surface, units=unit),
        training=replace(about.training, depth=_round(paths.depth), slide=_round(paths.slide)),
        support=about.support,
    )
    guesses = {
        "units": "stated by the file"
        if is_label_map(about.surface.file)
        else "given"
        if about.surface.units
        else f"guessed: an organ of {1e3 * volume:.3g} litres",
        "size": " x ".join(f"{1e3 * x:.0f}" for x in np.ptp(surface.vertices, axis=0)) + " mm",
        "nodes": len(fitted.cloud),
        "support": "given" if about.support else "guessed: the side away from the first view of the page",
        "radius": paths.radius,
        "reach": f"a ball of {1e3 * paths.radius:.3g} mm reaches {reach:.0%} of the surface, {held_share:.0%} is held",
    }
    made = Scene(description, fitted.folder, fitted.name)
    vars(made).update({name: vars(fitted)[name] for name in ("surface", "cloud", "body") if name in vars(fitted)})
    made.notes += [*dict.fromkeys([*scene.notes, *fitted.notes])]
    return made, guesses


def _with_proposals(
    scene: Scene, part: tuple[str, ...], without: tuple[str, ...], spacing: float | None, console: Console
) -> tuple[Scene, Proposals]:
    """Return the scene of an organ with what lies in it, and held by what touches it, and all proposals."""
    about = scene.description
    with console.status("searching the label map"):
        labels = read_label_map(about.surface.file, about.surface.labels or None).scaled(about.surface.scale)
        organ = segments_mask(labels, choose_segments(labels, part or None))
        target_spacing = spacing or spacing_for(TRAINING_NODES, organ.volume)
        proposals = propose(labels, Path(about.surface.file), part, target_spacing, without)
    regions = tuple(region for region, _ in proposals.regions)
    supports = about.support or tuple(support for support, _ in proposals.supports)
    shape = replace(about.surface, parts=proposals.parts)
    about = replace(about, title=proposals.title, surface=shape, region=regions, support=supports)
    made = Scene(about, scene.folder, scene.name)
    made.notes += scene.notes
    return made, proposals


def _round(length: float) -> float:
    """Return a length [m] of two digits."""
    return float(f"{length:.2g}")


def _placed(scene: Scene, out: Path) -> Scene:
    """Return the scene with files relative to the folder of its scene file, if possible."""
    about = scene.description
    names = _relative(about.surface.labels, out) if about.surface.labels else ""
    surface = replace(about.surface, file=_relative(about.surface.file, out), labels=names)
    about = replace(about, surface=surface, support=tuple(_placed_support(each, out) for each in about.support))
    return Scene(about, out.parent, str(out))


def _placed_support(support: Support, out: Path) -> Support:
    """Return a support whose file is relative to the folder of a scene file, if possible."""
    place = support.place
    if place.painted:
        place = replace(place, painted=replace(place.painted, file=_relative(place.painted.file, out)))
    if place.near:
        place = replace(place, near=replace(place.near, file=_relative(place.near.file, out)))
    return replace(support, place=place)


def _relative(file: str, out: Path) -> str:
    try:
        return Path(os.path.relpath(file, out.parent)).as_posix()
    except ValueError:  # on another drive
        return Path(file).absolute().as_posix()


def _schema(out: Path) -> Path:
    """Return the path of the schema, in the folder of the scene's results."""
    return out.with_name(f"{out.stem}.palpate") / SCHEMA_FILE
