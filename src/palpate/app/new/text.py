"""Text of a new scene file: the values in use, and comments about guesses and alternatives."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from palpate.scenes.description import Painted, Place, Region, Shape, Support, Training
from palpate.scenes.scene import Scene
from palpate.tissue.liver import SHEAR_MODULUS

LIVER_SOURCE = "mean of healthy livers: Yin et al., Clin. Gastroenterol. Hepatol. 5, 2007"


def commented_text(
    scene: Scene,
    guesses: Mapping[str, Any],
    notes: Sequence[str],
    schema: Path,
    alternatives: Sequence[tuple[Support, str]] = (),
) -> str:
    """Return the text of a scene file, for a scene with all values in use.

    `guesses` has ``"units"``, ``"size"``, ``"nodes"``, ``"support"`` and ``"reach"`` in words; ``"radius"`` of the ball
    [m]; ``"reasons"`` for regions and supports by their names. `notes` are about the surface. `alternatives` are
    supports that can be chosen in place of those in use, and what they are.
    """
    about = scene.description
    reasons = guesses.get("reasons", {})
    lines = [
        f"#:schema ./{schema.parent.name}/{schema.name}",
        '# A scene of palpate. Numbers are in SI units; a text may carry another: "4.5 mm", "2.2 kPa", "30 deg".',
        "# docs/reference/scene_files.md describes every key.",
        f"title = {_text(about.title)}",
        "",
        *_surface(about.surface, guesses, notes),
        "[body]",
        f"spacing = {_length(about.body.spacing)}  # {guesses['nodes']} nodes; half of it costs some 14 times the time",
        "",
        *_tissue(scene),
        *(line for region in about.region for line in _region(region, reasons)),
        "# [[region]]  # other tissue, such as a tumour; also a box, a painting, or a closed part of the file",
        '# place = { ball = { centre = ["10 mm", 0, 0], radius = "15 mm" } }',
        "# stiffness = 3",
        "",
        f"# Supports decide the force more than anything else. {guesses['support'].capitalize()}.",
        '# Others: side = "x-", "z+", "lowest 15%"; plane, box, ball, painted = { file = "paint.ply" },',
        '# near = { file = "bone.stl", distance = "3 mm" }.',
        *(line for support in about.support or (None,) for line in _support(support, reasons)),
        *(f"# {line}" if line else "" for each, why in alternatives for line in _support(each, {each.name: why})),
        "# [[support]]  # ligaments or a bed of soft tissue",
        '# kind = "springs"',
        '# place = { side = "lowest 15%" }',
        '# stiffness = "10 kPa/cm"',
        "",
        "[tool]",
        f"# radius = {_length(guesses['radius'])}  # of the ball; left out, it follows the spacing: {guesses['reach']}",
        f"friction = {about.tool.friction:g}",
        "",
        *_training(about.training),
    ]
    return "\n".join(lines)


def _surface(shape: Shape, guesses: Mapping[str, Any], notes: Sequence[str]) -> list[str]:
    return [
        "[surface]",
        f"file = {_text(shape.file)}",
        *([f"parts = [{', '.join(map(_text, shape.parts))}]"] if shape.parts else []),
        *([f"labels = {_text(shape.labels)}"] if shape.labels else []),
        f"units = {_text(shape.units)}  # {guesses['units']}, {guesses['size']}"
        if shape.units
        else f"# units are {guesses['units']}, {guesses['size']}",
        *([f"scale = {shape.scale!r}"] if shape.scale != 1.0 else []),
        "repair = true  # close small holes, turn triangles, smooth folds",
        *(f"# {line}" for note in notes for line in _wrapped(note)),
        "",
    ]


def _tissue(scene: Scene) -> list[str]:
    tissue = scene.description.tissue
    return [
        "[tissue]",
        f"law = {_text(tissue.law)}  # palpate laws lists the others",
        f"parameters = {_parameters(scene)}"
        + (f"  # {LIVER_SOURCE}" if _is_liver(scene) else "  # an example: set yours"),
        f'density = "{tissue.density:g} kg/m^3"',
        f"poisson = {tissue.poisson:g}  # up to 0.499; nearer to 0.5 costs time",
        f"mass_damping = {tissue.mass_damping:g}  # [1/s] free vibrations decay within a second",
        '# relaxation = { shares = [0.5], times = ["0.1 s"] }',
        '# fibres = { law = "Fibres", directions = [[1, 0, 0]], parameters = { k1 = "20 kPa", k2 = 5 } }',
        "",
    ]


def _training(training: Training) -> list[str]:
    return [
        "[training]  # of a reduced model: palpate train, or palpate view --refine",
        f"paths = {training.paths}  # more paths, smaller errors",
        f"held_out = {training.held_out}  # further paths, on which errors are measured",
        f"modes = {training.modes}",
        f"depth = {_length(training.depth)}  # of the deepest press",
        f"slide = {_length(training.slide)}",
        f"grasps = {training.grasps:g}  # share of the paths in which forceps pull",
        "",
    ]


def _region(region: Region, reasons: Mapping[str, str]) -> list[str]:
    lines = ["[[region]]" + _reason(region.name, reasons), f"name = {_text(region.name)}"]
    return [*lines, f"place = {{ part = {_text(region.place.part)} }}", f"stiffness = {region.stiffness:g}", ""]


def _support(support: Support | None, reasons: Mapping[str, str]) -> list[str]:
    about = support or Support(place=Place(side="back"))
    place, springs = about.place, about.kind == "springs"
    if place.painted:
        text = f"painted = {{ {_painted(place.painted)} }}"
    elif place.near:
        parts = ", ".join(map(_text, place.near.parts))
        text = f"near = {{ file = {_text(place.near.file)}, parts = [{parts}] }}"
    elif place.plane:
        point = ", ".join(map(_length, place.plane.point))
        text = f"plane = {{ point = [{point}], normal = {list(place.plane.normal)} }}"
    else:
        text = f"side = {_text(place.side)}"
    return [
        "[[support]]" + _reason(about.name, reasons),
        *([f"name = {_text(about.name)}"] if about.name else []),
        f"kind = {_text(about.kind)}",
        f"place = {{ {text} }}",
        *(["surface_only = true"] if about.surface_only and not springs else []),
        *([f'stiffness = "{about.stiffness / 1e5:g} kPa/cm"  # an example: set yours'] if springs else []),
        "",
    ]


def _reason(name: str, reasons: Mapping[str, str]) -> str:
    return f"  # {reasons[name]}" if name in reasons else ""


def _painted(paint: Painted) -> str:
    return f"file = {_text(paint.file)}" + (f", field = {_text(paint.field)}" if paint.field else "")


def _parameters(scene: Scene) -> str:
    """Return the parameters of the law in use as an inline table."""
    from palpate.tissue.catalogue import LAWS

    law = next(law for law in LAWS if law.name == scene.description.tissue.law)
    words = []
    for parameter in law.parameters:
        value = getattr(scene.material, parameter.name)
        if isinstance(value, tuple):
            words.append(f"{parameter.name} = [{', '.join(f'{each:g}' for each in value)}]")
        else:
            words.append(f"{parameter.name} = " + (f'"{value:g} {parameter.unit}"' if parameter.unit else f"{value:g}"))
    return "{ " + ", ".join(words) + " }"


def _is_liver(scene: Scene) -> bool:
    return scene.description.tissue.law == "NeoHookean" and scene.material.shear_modulus == SHEAR_MODULUS


def _length(value: float | None) -> str:
    """Return a length in millimetres, as a text of TOML."""
    return f'"{1e3 * (value or 0.0):.6g} mm"'


def _text(value: str) -> str:
    """Return a basic string of TOML, whose escapes are those of JSON."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _wrapped(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(" ".join(text.split()), 96)
