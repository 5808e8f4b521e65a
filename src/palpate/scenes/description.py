"""Description of a scene: the sections of a scene file, without the files and bodies that they name.

Lengths of places are in the body's coordinates, after units and scale of the surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from typing import Any

from palpate.core.faults import InputError
from palpate.core.parameters import Fault, parameter, read_values
from palpate.dynamics.contact.tool_parameters import friction, side_stress, thickness, toughness
from palpate.tissue.liver import LIVER_DENSITY, LIVER_POISSON, MASS_DAMPING

SINGLE_SECTIONS = ("surface", "body", "tissue", "tool", "cut", "run", "training")
SURFACE_SHAPES = ("liver", "box", "disc")
# keys of [training] that choose runs and the size of the model; neither the body nor a path depends on them
CHOICES_OF_RUNS = ("paths", "held_out", "modes", "tolerance", "cubature", "seed")
Vector = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Surface of the body: a file, or a generated shape."""

    file: str = parameter("", "", "surface file or label map, relative to the scene file")
    parts: tuple[str, ...] = parameter(
        "", (), "names or patterns of parts of the file, such as '*lobe*'; those of a label map are one body"
    )
    labels: str = parameter("", "", "names that a label map lacks: JSON, .ctbl, or lines of a number and a name")
    units: str = parameter(
        "", "", "unit of length in the file; guessed if it is left out", choices=("m", "cm", "mm", "in")
    )
    scale: float = parameter("", 1.0, "factor of all lengths", low=1e-6, high=1e6)
    repair: bool = parameter("", True, "close small holes, turn triangles, smooth folds and remove specks")
    generated: str = parameter("", "", "generated shape in place of a file", choices=SURFACE_SHAPES)
    size: Vector = parameter("m", (), "edges of a box from the origin", above=0.0, length=3)
    disc_radius: float = parameter("m", 0.1, "radius of a disc", above=0.0, high=10.0)

    def __post_init__(self) -> None:
        if bool(self.file) == bool(self.generated):
            raise InputError("must have file or generated, and not both; give one of them")
        if (self.generated == "box") != bool(self.size):
            raise InputError("must have size for a box, and only for a box; give size = [length, width, height]")


@dataclass(frozen=True, kw_only=True)
class Body:
    """Nodes and equations of the body."""

    spacing: float | None = parameter("m", None, "distance between nodes", above=0.0, high=1.0)
    form: str = parameter("", "energy", "form of the equations of motion", choices=("energy", "strong"))
    seed: int = parameter("", 0, "seed of the nodes' positions", low=0, high=2**31)
    thickness: float | None = parameter("m", None, "thickness of a membrane", above=0.0, high=1.0)
    prestretch: float = parameter("", 1.0, "stretch of a membrane at rest", low=0.5, high=3.0)
    under_loads: bool = parameter(
        "", False, "whether the surface has its shape under the loads at time 0, as a scan has under gravity"
    )


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """Viscoelastic relaxation, a Prony series (`palpate.materials.Prony`)."""

    shares: Vector = parameter(help="modulus of each branch over that of the law", above=0.0)
    times: Vector = parameter("s", help="relaxation times", above=0.0)
    bulk_shares: Vector = parameter("", (), "the same for the bulk modulus", low=0.0)


@dataclass(frozen=True, kw_only=True)
class Fibre:
    """Fibres of one direction everywhere (`palpate laws`)."""

    law: str = parameter("", "Fibres", "law of the fibres", choices=("Fibres", "Guccione"))
    directions: tuple[tuple[float, float, float], ...] = parameter(help="directions of the families, of any length")
    parameters: dict[str, float | str] = parameter(help="parameters of the fibre law")


@dataclass(frozen=True, kw_only=True)
class Tissue:
    """Tissue of the body."""

    law: str = parameter("", "NeoHookean", "law of the catalogue (palpate laws)")
    energy: str = parameter("", "", "energy of a law of your own as a text, such as 'C1*(I1 - 3 - 2*log(J))'")
    parameters: dict[str, float | str] = parameter("", {}, "parameters of the law")
    density: float = parameter("kg/m^3", LIVER_DENSITY, "density", above=0.0)
    poisson: float = parameter("", LIVER_POISSON, "Poisson's ratio at rest", low=0.0, high=0.5)
    volumetric: str = parameter(
        "", "quadratic", "form of the volumetric energy", choices=("quadratic", "logarithmic", "mixed")
    )
    split: str = parameter("", "coupled", "strain of the shear energy", choices=("coupled", "isochoric"))
    mass_damping: float = parameter(
        "1/s", MASS_DAMPING, "damping by mass: an amplitude decays at half this rate", low=0.0, high=1000.0
    )
    relaxation: Relaxation | None = parameter("", None, "relaxation of the tissue")
    fibres: Fibre | None = parameter("", None, "fibres")


@dataclass(frozen=True, kw_only=True)
class Plane:
    """Half space behind a plane."""

    point: Vector = parameter("m", help="a point of the plane", length=3)
    normal: Vector = parameter(help="normal, away from the place", length=3)


@dataclass(frozen=True, kw_only=True)
class Box:
    """Box along the axes."""

    low: Vector = parameter("m", help="lowest corner", length=3)
    high: Vector = parameter("m", help="highest corner", length=3)


@dataclass(frozen=True, kw_only=True)
class Ball:
    """Ball."""

    centre: Vector = parameter("m", help="centre", length=3)
    radius: float = parameter("m", help="radius", above=0.0, high=10.0)


@dataclass(frozen=True, kw_only=True)
class Painted:
    """Painted vertices of a mesh, in the unit of the surface."""

    file: str = parameter(help="painted mesh (.ply, .vtk, .vtp, .vtu), relative to the scene file")
    field: str = parameter("", "", "scalar field on its vertices; the only one if it is left out")
    least: float = parameter("", 0.5, "smallest painted value")


@dataclass(frozen=True, kw_only=True)
class Near:
    """Nearness to another surface, such as a bone.

    Headers may state the frame as 3D Slicer does, ``SPACE=LPS`` or ``SPACE=RAS``. A surface in the other frame is
    turned into that of the body, with a warning.
    """

    file: str = parameter(help="surface file or label map, relative to the scene file; units and scale as the body's")
    distance: float | None = parameter(
        "m", None, "largest distance; of a label map by default half a spacing, or 1.5 edges of a voxel if more",
        above=0.0, high=1.0,
    )  # fmt: skip
    parts: tuple[str, ...] = parameter("", (), "names or patterns of its parts")


@dataclass(frozen=True, kw_only=True)
class Place:
    """Part of the body: exactly one of these."""

    side: str = parameter(
        "", "", "'x-', 'z+', 'back' (away from the first view), 'lowest 15%', 'near X,Y,Z,R' [mm]; where the "
        "file states how the patient lies, 'left', 'right', 'front', 'rear', 'head', 'feet'",
    )  # fmt: skip
    group: str = parameter("", "", "group of a generated shape, such as 'x-' or 'rim'")
    plane: Plane | None = parameter("", None, "what is behind a plane")
    box: Box | None = parameter("", None, "what is inside a box")
    ball: Ball | None = parameter("", None, "what is inside a ball")
    painted: Painted | None = parameter("", None, "what is painted")
    near: Near | None = parameter("", None, "what is near another surface")
    part: str = parameter("", "", "what is inside a closed part of the surface file or label map, by name or pattern")

    def __post_init__(self) -> None:
        named = [field.name for field in fields(self) if getattr(self, field.name)]
        if len(named) != 1:
            raise InputError(
                f"must be one of {', '.join(field.name for field in fields(self))}, got {' and '.join(named) or 'none'}"
            )

    @property
    def title(self) -> str:
        """The place in words."""
        for field in fields(self):
            if getattr(self, field.name):
                value = getattr(self, field.name)
                return value if isinstance(value, str) and field.name in ("side", "group") else field.name
        raise AssertionError("a place has one kind")


@dataclass(frozen=True, kw_only=True)
class Region:
    """Tissue with other parameters of the same law."""

    name: str = parameter("", "", "name in reports")
    place: Place = parameter(help="where it is")
    parameters: dict[str, float | str] = parameter("", {}, "parameters of the law that differ")
    stiffness: float = parameter("", 1.0, "factor of the moduli, in place of parameters", above=0.0, high=1e4)


@dataclass(frozen=True, kw_only=True)
class Support:
    """Support of the body's surface."""

    name: str = parameter("", "", "name in reports")
    kind: str = parameter(
        "",
        "fixed",
        "fixed, roller (slides in the plane of its normal), rail, or springs per area",
        choices=("fixed", "roller", "rail", "springs"),
    )
    place: Place = parameter(help="where it is")
    surface_only: bool = parameter("", False, "hold nodes of the surface only, not those below it")
    direction: Vector = parameter("", (), "normal of a roller, or direction of a rail", length=3)
    stiffness: float = parameter("N/m^3", 0.0, "stiffness of springs per area", low=0.0)
    damping: float = parameter("N s/m^3", 0.0, "damping of springs per area", low=0.0)

    def __post_init__(self) -> None:
        if (self.kind == "springs") != (self.stiffness > 0):
            raise InputError("must have a stiffness if it is of springs, and none else; give stiffness = '10 kPa/cm'")
        if self.kind == "rail" and not self.direction:
            raise InputError("must have a direction if it is a rail; give direction = [1, 0, 0]")
        if self.direction and self.kind not in ("roller", "rail"):
            raise InputError("must have no direction unless it is a roller or a rail; leave it out")


@dataclass(frozen=True, kw_only=True)
class Tool:
    """Tool that touches the body, or that holds a group of it."""

    radius: float | None = parameter(
        "m", None, "radius of the ball; one that fits the body if it is left out", above=0.0, high=0.5
    )
    friction: float = friction(0.2, high=2.0)
    holds: str = parameter("", "", "group that the tool holds and moves, in place of touching the surface")
    hold_radius: float | None = parameter(
        "m", None, "of a disc: the tool holds what is so near its centre", above=0.0, high=10.0
    )


@dataclass(frozen=True, kw_only=True)
class Cut:
    """Scalpel of `palpate run --cut`, which goes down into the body, along it, and out again."""

    toughness: float = toughness()
    wedge: float = thickness()
    shear_stress: float = side_stress()
    edge_length: float | None = parameter(
        "m", None, "of the blade; one that fits the spacing if it is left out", above=0.0, high=1.0
    )
    cut_length: float | None = parameter(
        "m", None, "way along the body; one that fits it if it is left out", above=0.0, high=1.0
    )
    cut_depth: float | None = parameter(
        "m", None, "way into the body; one that fits it if it is left out", above=0.0, high=0.2
    )
    cut_speed: float = parameter("m/s", 0.02, "speed of the blade", above=0.0, high=1.0)


@dataclass(frozen=True, kw_only=True)
class Load:
    """Load of a single run: a force, a pressure or gravity over time."""

    name: str = parameter("", "", "name in reports")
    kind: str = parameter(help="kind of load", choices=("force", "pressure", "gravity", "motion"))
    place: Place | None = parameter("", None, "where it acts; gravity acts everywhere")
    times: Vector = parameter("s", (0.0,), "times; between them the factor is interpolated", low=0.0)
    factors: Vector = parameter("", (1.0,), "factors at these times")
    force: Vector = parameter("N", (), "total force", length=3)
    pressure: float = parameter("Pa", 0.0, "pressure, positive towards the body")
    acceleration: Vector = parameter("m/s^2", (), "acceleration of gravity", length=3)
    displacement: Vector = parameter("m", (), "displacement of a motion", length=3)

    def __post_init__(self) -> None:
        needed = {"force": "force", "pressure": "pressure", "gravity": "acceleration", "motion": "displacement"}
        for kind, name in needed.items():
            if bool(getattr(self, name)) != (kind == self.kind):
                raise InputError(
                    f"must have {needed[self.kind]} and no other of its size if it is {self.kind}; change it"
                )
        if (self.place is None) != (self.kind == "gravity"):
            raise InputError("must have a place unless it is gravity; give place = { side = 'z+' }")
        if len(self.times) != len(self.factors) or any(
            b <= a for a, b in zip(self.times, self.times[1:], strict=False)
        ):
            raise InputError("must have increasing times and as many factors; change one of them")


@dataclass(frozen=True, kw_only=True)
class Run:
    """A single run of the full body under its loads, or under a press of the tool if there are none."""

    duration: float = parameter("s", 1.0, "length", above=0.0, high=600.0)
    every: float = parameter("s", 0.01, "time between two frames", above=0.0, high=1.0)

    def __post_init__(self) -> None:
        if self.every > self.duration:
            raise InputError("must have every of at most the duration; make it smaller")


@dataclass(frozen=True, kw_only=True)
class Training:
    """Random paths of the tool, and the reduced model that is trained on them."""

    paths: int = parameter("", 12, "runs to train on; with a tolerance, the most", low=1, high=100_000)
    held_out: int = parameter("", 20, "further runs, on which errors are measured", low=0, high=100_000)
    modes: int = parameter("", 60, "modes of the reduced model", low=1, high=1000)
    tolerance: float | None = parameter("", None, "choose paths until the errors are at most this", above=0.0, high=1.0)
    cubature: float | None = parameter("", None, "largest relative error of the sampled forces", low=0.0, high=1.0)
    seed: int = parameter("", 0, "seed of the paths", low=0, high=1_000_000)
    depth: float | None = parameter(
        "m",
        None,
        "depth of the deepest press, and length of the longest pull; what fits the body if it is left out",
        above=0.0,
        high=0.2,
    )
    slide: float | None = parameter(
        "m", None, "longest slide of a press; what fits the body if it is left out", low=0.0, high=0.5
    )
    grasps: float = parameter("", 0.25, "share of the paths that are pulls of forceps", low=0.0, high=1.0)
    pairs: float = parameter("", 0.25, "share of the held-out paths with two tools at once", low=0.0, high=1.0)
    every: float = parameter("s", 0.01, "time between two frames", above=0.0, high=1.0)
    duration: float = parameter("s", 0.4, "length of a path of a tool that holds a group", above=0.0, high=10.0)
    low: Vector = parameter("m", (0.0, 0.0, 0.0), "smallest displacement of a swing of a held group", length=3)
    high: Vector = parameter("m", (0.0, 0.0, 0.0), "largest displacement of a swing", length=3)
    low_turn: Vector = parameter("rad", (0.0, 0.0, 0.0), "smallest rotation vector of a swing", length=3)
    high_turn: Vector = parameter("rad", (0.0, 0.0, 0.0), "largest rotation vector of a swing", length=3)


@dataclass(frozen=True, kw_only=True)
class Description:
    """A scene: a body with its tissue and supports, and what happens to it."""

    title: str = parameter("", "", "title of the scene")
    surface: Shape = parameter(help="surface of the body")
    body: Body = parameter("", Body(), "nodes of the body")
    tissue: Tissue = parameter("", Tissue(), "tissue of the body")
    region: tuple[Region, ...] = parameter("", (), "regions of other tissue")
    support: tuple[Support, ...] = parameter(
        "", (), "supports; the side away from the first view is fixed if there are none"
    )
    tool: Tool = parameter("", Tool(), "tool")
    cut: Cut = parameter("", Cut(), "scalpel of a cut in real time")
    load: tuple[Load, ...] = parameter("", (), "loads of a single run")
    run: Run = parameter("", Run(), "single run of the full body")
    training: Training = parameter("", Training(), "training of a reduced model")

    def group_name(self, kind: str, number: int) -> str:
        """Return the name of the group of a support, a region or a load by its number from 0."""
        entries = getattr(self, kind)
        if not entries:
            return f"{kind} {number + 1}"
        place, generated = entries[number].place, self.surface.generated
        return entries[number].name or (place.group if place and generated else "") or f"{kind} {number + 1}"


def with_settings(description: Description, settings: Mapping[str, Any]) -> Description:
    """Return a description with other values of its settings.

    They are settings by dotted key, such as ``"tissue.poisson"``, or by its last word if one section alone has it. A
    parameter of the law is set by its name.
    """
    changes: dict[str, dict[str, Any]] = {}
    names: dict[tuple[str | int, ...], str] = {}  # under which settings were given, for messages
    law = str(settings.get("tissue.law", settings.get("law", description.tissue.law)))
    for key, value in settings.items():
        section, word = _find_setting(description, key, law)
        if section == "parameters":
            before = changes.setdefault("tissue", {}).get("parameters", description.tissue.parameters)
            changes["tissue"]["parameters"] = {**before, word: value}
        else:
            changes.setdefault(section, {})[word] = value
            names[section, word] = key
    for section, values in changes.items():
        old = getattr(description, section)
        try:
            changed = replace(old, **read_values(type(old), values, (section,)))
        except Fault as fault:
            name = names.get(fault.path[:2], ".".join(map(str, fault.path[:2])))
            raise InputError(f"{'.'.join([name, *map(str, fault.path[2:])])} {fault.message}") from fault
        except InputError as error:
            raise InputError(f"{section} {error}") from error
        description = replace(description, **{section: changed})
    return description


def chooses_runs(description: Description, key: str) -> bool:
    """Return True for a setting on which neither the body nor a path depends, such as ``"modes"``."""
    section, word = _find_setting(description, key, description.tissue.law)
    return section == "training" and word in CHOICES_OF_RUNS


def _find_setting(description: Description, key: str, law: str) -> tuple[str, str]:
    """Return the section and the key of a setting; the section ``"parameters"`` for a parameter of a law."""
    settings_by_name = {
        f"{section}.{field.name}": (section, field.name)
        for section in SINGLE_SECTIONS
        for field in fields(getattr(description, section))
    }
    matches = [each for each in settings_by_name if each == key or each.endswith(f".{key}")]
    if len(matches) > 1:
        raise InputError(f"settings must name one key, got {key!r}; give {' or '.join(matches)}")
    if matches:
        return settings_by_name[matches[0]]
    from palpate.tissue.catalogue import LAWS  # here, so that help texts answer without it

    parameters = next((each.parameters for each in LAWS if each.name == law), ())
    if key in {each.name for each in parameters} | set(description.tissue.parameters):
        return "parameters", key
    near = get_close_matches(key[:60], [*settings_by_name, *(word for _, word in settings_by_name.values())], 1)
    remedy = f"did you mean {near[0]}?" if near else "docs/reference/scene_files.md lists them"
    raise InputError(f"settings must be keys of the scene, got {key!r:.60}; {remedy}")
