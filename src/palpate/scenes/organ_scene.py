"""A scene that was opened: the body, the loads and the tool paths of a `Description`.

Files are read and bodies are made when they are first used.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats, Ints
from palpate.describe import Described, Fact
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.pressure import Pressure
from palpate.dynamics.loads.supports import Clamp, Rail, Roller, free_rigid_motions
from palpate.dynamics.loads.supports import Support as BodySupport
from palpate.dynamics.loads.surface_force import SurfaceForce
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.solid.model import Solid
from palpate.dynamics.solid.unloading import UnloadedBody, unloaded
from palpate.faults import FileFormatError, InputError
from palpate.files import digest_of, read_bytes
from palpate.meshfree.cloud import BORDER_MARGIN, MOVED_MARGIN, Cloud, box
from palpate.meshfree.filling import BODY_PREFIX, fill
from palpate.meshfree.sheets import disc
from palpate.scenes.description import CHOICES_OF_RUNS, Description
from palpate.scenes.names import SceneKind
from palpate.scenes.organ import liver_surface
from palpate.scenes.places import PlaceFinder, side_mask
from palpate.scenes.scene_paths import MIN_DEPTH_RATIO, HeldMotion, held_motion, touching_paths
from palpate.scenes.scene_text import line_of_file, words_of
from palpate.scenes.tissue import fibres_of, material_of
from palpate.scenes.tool_paths import ToolPaths, check_radius
from palpate.surface.checks import SurfaceReport, check_surface, shape_problems
from palpate.surface.files import read_surface
from palpate.surface.labels.reading import is_label_map
from palpate.surface.repair import repair_surface
from palpate.surface.surface import Surface, scaled
from palpate.tissue.materials import Material

TOOL_GROUP = "tool"
DEFAULT_SIDE = "back"  # away from the first view of the page
MIN_HELD, MAX_HELD_SHARE = 3, 0.6  # nodes of a body that supports hold


class OrganScene(Described):
    """A body with its loads and tool paths, from a scene file.

    Parameters
    ----------
    description : Description
    folder : path
        Folder of relative file names.
    name : str
        Name of the scene in messages and reports: of a scene of the package, or the path of a file.
    kind : SceneKind or None
        Where it comes from.
    settings : mapping, optional
        Settings that replaced values of the file; workers of a campaign open the scene with them.

    Attributes
    ----------
    notes : list of str
        What was guessed or repaired so far.

    Examples
    --------
    >>> import palpate as pt
    >>> scene = pt.open_scene("beam", {"spacing": "6.6 mm"})
    >>> scene.duration, scene.every, len(scene.loads)
    (1.0, 0.01, 1)
    """

    _title = "Scene"

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
        self._unloaded: UnloadedBody | None = None

    def _facts(self) -> list[Fact]:
        about = self.description
        return [
            ("name", self.name, ""),
            ("surface", about.surface.file or about.surface.generated, ""),
            ("spacing", about.body.spacing or None, "m"),
            ("law", "text" if about.tissue.energy else about.tissue.law, ""),
            ("regions", len(about.region) or None, ""),
            ("supports", len(about.support) or None, ""),
        ]

    @property
    def title(self) -> str:
        """Title of the scene."""
        from palpate.surface.formats.names import LABEL_FORMATS, format_of
        from palpate.surface.parts import names_text

        file = Path(self.description.surface.file)
        if self.description.title or not self.description.surface.file:
            return self.description.title or Path(self.name).stem.capitalize()
        stem = Path(file.stem).stem if format_of(file)[1] else file.stem
        parts = self.description.surface.parts if format_of(file)[0] in LABEL_FORMATS else ()
        words = f"{names_text(parts, 3)} ({stem})" if parts else stem
        words = words.replace("_", " ")
        return words[:1].upper() + words[1:]

    def with_body(self, **changes: Any) -> OrganScene:
        """Return the scene with other settings of its body, such as ``spacing=0.005``."""
        about = replace(self.description, body=replace(self.description.body, **changes))
        settings = {key: value for key, value in self.settings.items() if key.removeprefix("body.") not in changes}
        settings |= {f"body.{name}": value for name, value in changes.items()}
        scene = OrganScene(about, self.folder, self.name, self.kind, settings)
        if "surface" in vars(self):
            vars(scene)["surface"] = self.surface
        return scene

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

    @cached_property
    def cloud(self) -> Cloud:
        """Nodes of the body, with groups of its supports, regions and loads.

        Raises
        ------
        InputError
            The surface cannot be filled, or a place holds no node, too few or too many.
        CloudError
            The body is too thin for the spacing.
        """
        cloud = self._filled()
        finder = self._finder(cloud)
        for number, region in enumerate(self.description.region):
            with self._naming("region", number):
                cloud = _with_group(cloud, self._group("region", number), finder.mask(region.place))
        for number, support in enumerate(self.description.support):
            with self._naming("support", number):
                mask = finder.mask(support.place, margin=0.0 if support.kind == "springs" else BORDER_MARGIN)
                if support.surface_only or support.kind == "springs":
                    mask = _on_surface(cloud, mask)
                cloud = _with_group(cloud, self._group("support", number), mask)
        if not self.description.support:
            cloud = cloud.with_group(self._group("support", 0), self._default_support(cloud))
            if self.kind is SceneKind.SCENE_FILE:
                self.notes.append(
                    f"support: the scene has none, so the side {DEFAULT_SIDE!r} of the body is held; give [[support]]"
                )
        for number, load in enumerate(self.description.load):
            if load.place is not None:
                with self._naming("load", number):
                    mask = finder.mask(load.place, margin=MOVED_MARGIN if load.kind == "motion" else 0.0)
                    mask = mask if load.kind == "motion" else _on_surface(cloud, mask)
                    cloud = _with_group(cloud, self._group("load", number), mask)
        self._check_supports(cloud)
        return cloud

    @cached_property
    def body(self) -> Solid | Membrane:
        """Full model of the body.

        Raises
        ------
        InputError, CloudError
            As `cloud`, or the tissue does not suit the body.
        """
        about = self.description
        fixed = [each for each in map(self._support, range(len(about.support) or 1)) if each is not None]
        if about.surface.generated == "disc":
            if about.body.under_loads:
                raise InputError("under_loads of [body] must be false for a disc, got true; use prestretch")
            if about.body.thickness is None:
                raise InputError("thickness of [body] must be given for a disc, got none; give thickness = '0.1 mm'")
            if about.body.form != "energy":
                raise InputError(f"form of [body] must be energy for a disc, got {about.body.form}; leave form out")
            if about.region:
                raise InputError(f"region must be left out for a disc, got {len(about.region)}; give one tissue")
            return Membrane(
                self.cloud, self.material, about.body.thickness, fixed, prestretch=about.body.prestretch,
                mass_damping=about.tissue.mass_damping,
                fibres=None if about.tissue.fibres is None else fibres_of(about.tissue.fibres),
            )  # fmt: skip
        materials: dict[str, Material] = {"": self.material}
        for number, region in enumerate(about.region):
            if region.parameters:
                with self._naming("region", number):
                    materials[self._group("region", number)] = material_of(about.tissue, region.parameters)
        body = Solid(
            self.cloud, materials if len(materials) > 1 else self.material, fixed, form=about.body.form,
            mass_damping=about.tissue.mass_damping, stiffness=self._stiffness_factors(materials),
            fibres=None if about.tissue.fibres is None else fibres_of(about.tissue.fibres),
        )  # fmt: skip
        motions = free_rigid_motions(self.cloud.points, body.constrain(np.zeros(len(self.cloud), dtype=bool)))
        if motions and not self.foundations:
            raise InputError(
                f"supports must hold the body, got {motions} rigid motions left free; fix a part, or use springs"
            )
        if not about.body.under_loads:
            return body
        with self._naming("body", "under_loads"):
            self._unloaded = unloaded(body, self._loads_of_shape())
        sag = float(np.linalg.norm(self._unloaded.displacements, axis=1).max())
        self.notes.append(
            f"body: its stress-free shape is up to {1e3 * sag:.3g} mm from the surface, which loads have deformed; "
            "runs begin in that shape, a view and training in the stress-free one"
        )
        return self._unloaded.body

    def _loads_of_shape(self) -> tuple[Load, ...]:
        """Return the loads at time 0 that have deformed the surface."""
        loads = self.description.load
        if not any(np.interp(0.0, load.times, load.factors) for load in loads):
            raise InputError(
                "under_loads must be false without loads at time 0, got true; give a [[load]] of kind = 'gravity' "
                "whose factor at 0 s is not 0"
            )
        if any(load.kind == "motion" for load in loads):
            raise InputError("under_loads must be false with a load of kind 'motion', got true; give a force")
        return self.loads

    @property
    def start(self) -> Floats | None:
        """Displacements (n, 3) [m] of the body at the start of a run: those of a shape under loads, or None."""
        _ = self.body
        return None if self._unloaded is None else self._unloaded.displacements

    def _stiffness_factors(self, materials: dict[str, Material]) -> Floats | None:
        """Return factors (n,) that give every node the mean compliance of its cell; None where all are 1.

        A node has the parameters of the region it lies in; its factor makes up for the part of its cell in others.
        """
        if not self.description.region:
            return None
        nodal = np.full(len(self.cloud), self.material.shear_modulus)
        modulus, finder = nodal.copy(), self._finder(self.cloud)
        for number, region in enumerate(self.description.region):
            group = self._group("region", number)
            inside = materials.get(group, self.material).shear_modulus
            nodal[self.cloud.group(group)] = inside
            share = finder.fractions(region.place)
            modulus = 1.0 / ((1.0 - share) / modulus + share / (region.stiffness * inside))
        return None if np.allclose(modulus, nodal, rtol=1e-12) else modulus / nodal

    @cached_property
    def foundations(self) -> tuple[Foundation, ...]:
        """Springs per area, which act in every run."""
        return tuple(
            Foundation(self._group("support", number), support.stiffness, support.damping)
            for number, support in enumerate(self.description.support)
            if support.kind == "springs"
        )

    @cached_property
    def loads(self) -> tuple[Load, ...]:
        """Loads of a single run, with the foundations."""
        return (*self.foundations, *map(self._load, range(len(self.description.load))))

    @property
    def duration(self) -> float:
        """Length [s] of a single run."""
        return self.description.run.duration

    @property
    def every(self) -> float:
        """Time [s] between two frames of a single run."""
        return self.description.run.every

    @cached_property
    def paths(self) -> Callable[[int], tuple[tuple[Load, ...], float]]:
        """Function of a seed, from 0, that returns the loads of a random tool path and its duration [s]."""
        if not self.held_group:
            return self.tool_paths()
        duration = self.description.training.duration
        self.held_motion(0, duration)  # raises an error at once

        def path(seed: int) -> tuple[tuple[Load, ...], float]:
            load = self.held_motion(seed, duration).load(self.body.cloud, self.held_group)
            return (*self.foundations, load), duration

        return path

    def tool_paths(self, body: Any = None, deepest: float = np.inf, shallowest: float = MIN_DEPTH_RATIO) -> ToolPaths:
        """Return the paths of the tool on the free surface; see `palpate.scenes.scene_paths.touching_paths`.

        Parameters
        ----------
        body : Solid or ReducedModel, optional
            By default the scene's.
        deepest : float [m]
        shallowest : float
        """
        about = self.description
        if body is None and about.tool.radius is not None and about.body.spacing is not None:  # before it is filled
            with self._naming("tool", "radius"):
                check_radius(about.tool.radius, about.body.spacing)
        touched = self.body if body is None else body
        return touching_paths(about.tool, about.training, touched, self.foundations, deepest, shallowest)

    def held_motion(self, seed: int, duration: float) -> HeldMotion:
        """Return a motion of the tool that holds a group, over a time [s]."""
        return held_motion(self.description.training, seed, duration)

    @property
    def region_groups(self) -> list[str]:
        """Groups of the regions."""
        return [self._group("region", number) for number in range(len(self.description.region))]

    @property
    def held_group(self) -> str:
        """Group that the tool holds; empty for a tool that touches the body."""
        tool = self.description.tool
        return TOOL_GROUP if tool.hold_radius else tool.holds

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Dependencies of the bodies and paths of this scene: its sections, and digests of the files in them.

        Raises
        ------
        FileNotFoundError, FileFormatError
            A file cannot be read.
        """
        from hashlib import sha256

        about = asdict(self.description)
        for name in CHOICES_OF_RUNS:
            about["training"].pop(name)
        about.pop("title"), about.pop("run"), about.pop("load"), about.pop("cut")
        if not about["surface"]["labels"]:
            about["surface"].pop("labels")  # scenes without it keep their digests
        digests = {file: sha256(read_bytes(self.folder / file, "file")).hexdigest() for file in sorted(_files(about))}
        return {"sections": about, "files": digests}

    @property
    def digest(self) -> str:
        """Digest of `identity`."""
        return digest_of(self.identity)[:16]

    def _group(self, kind: str, number: int) -> str:
        """Return the name of the group of a support, a region or a load by its number from 0."""
        entries = getattr(self.description, kind)
        if not entries:
            return f"{kind} {number + 1}"
        place, generated = entries[number].place, self.description.surface.generated
        return entries[number].name or (place.group if place and generated else "") or f"{kind} {number + 1}"

    @contextlib.contextmanager
    def _naming(self, *keys: str | int) -> Iterator[None]:
        """Name the file, the line and the keys of an entry in errors."""
        try:
            yield
        except FileFormatError:
            raise
        except InputError as error:
            raise type(error)(f"{self._place_of(keys)}: {error}") from error

    def _place_of(self, keys: tuple[str | int, ...]) -> str:
        """Return the file, the line and the keys of an entry; for a surface the argument that gives supports."""
        if keys[0] == "support" and self.kind is SceneKind.SURFACE_FILE:
            return "fixed"
        words = ".".join(words_of(keys))
        is_set = any(words == key or words.endswith(f".{key}") for key in self.settings)
        if is_set or self.kind is not SceneKind.SCENE_FILE:
            return words
        return f"{self.name}, line {line_of_file(Path(self.name), keys)}: {words}"

    def _filled(self) -> Cloud:
        about = self.description
        if not about.body.spacing:
            raise InputError("spacing of [body] must be given, got none; give one, such as spacing = '5 mm'")
        if about.surface.generated == "box":
            size = [about.surface.scale * edge for edge in about.surface.size]
            return box(size, about.body.spacing)
        if about.surface.generated == "disc":
            cloud = disc(about.surface.scale * about.surface.disc_radius, about.body.spacing)
            radius = about.tool.hold_radius
            return cloud.within(TOOL_GROUP, (0.0, 0.0), radius, margin=0.0) if radius else cloud
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            surface = self.repaired_surface
            assert surface is not None
            cloud = fill(surface, about.body.spacing, seed=about.body.seed)
        noted = {*surface.warnings, *(repair.what for repair in surface.repairs)}
        self.notes += [f"surface: {line}" for line in sorted({str(each.message) for each in caught} - noted)]
        return cloud

    def _finder(self, cloud: Cloud) -> PlaceFinder:
        unit, space = (1.0, "") if self.surface is None else (self.surface.unit, self.surface.space)
        return PlaceFinder(cloud, self.description.surface, unit, self.folder, space)

    def _default_support(self, cloud: Cloud) -> NDArray[np.bool_]:
        """Return the side of each body away from the first view."""
        if cloud.points.shape[1] == 2:
            raise InputError(
                "support must be given for a disc, got none; give [[support]] with place = { group = 'rim' }"
            )
        mask = np.zeros(len(cloud), dtype=bool)
        for nodes, _ in _bodies(cloud):
            mask[nodes] = side_mask(cloud.points[nodes], DEFAULT_SIDE, BORDER_MARGIN * cloud.spacing)
        return mask

    def _support(self, number: int) -> BodySupport | None:
        """Return a support of the body; None for springs, which are a load."""
        group = self._group("support", number)
        if not self.description.support:
            return Clamp(group)
        support = self.description.support[number]
        with self._naming("support", number):
            if support.kind == "roller":
                return self._roller(group, support.direction)
            if support.kind == "rail":
                return Rail(group, support.direction)
        return Clamp(group) if support.kind == "fixed" else None

    def _roller(self, group: str, direction: Sequence[float]) -> Roller:
        roller = Roller(group, direction or None)
        if not direction:
            try:
                roller.directions(self.cloud)
            except InputError as error:
                raise InputError(
                    f"direction must be given for a roller on {group!r}, whose nodes are not one face, got none; give "
                    "its normal, such as direction = [0, 0, 1]"
                ) from error
        return roller

    def _load(self, number: int) -> Load:
        load, group = self.description.load[number], self._group("load", number)
        times, factors = np.array(load.times), np.array(load.factors)

        def factor(time: float) -> float:
            return float(np.interp(time, times, factors))

        def scaled_vector(vector: Sequence[float]) -> Callable[[float], Sequence[float]]:
            return lambda time: [factor(time) * each for each in vector]

        if load.kind == "force":
            return SurfaceForce(group, force=scaled_vector(load.force))
        if load.kind == "pressure":
            return Pressure(group, lambda time: factor(time) * load.pressure)
        if load.kind == "gravity":
            return Gravity(scaled_vector(load.acceleration))
        return PrescribedMotion(group, lambda points, time: factor(time) * np.array(load.displacement))

    def _check_supports(self, cloud: Cloud) -> None:
        """Raise `InputError` for supports that hold too little or too much of a body."""
        kinds = [each.kind for each in self.description.support] or ["fixed"]
        groups = {kind: np.zeros(len(cloud), dtype=bool) for kind in ("fixed", "springs", "roller", "rail")}
        for number, kind in enumerate(kinds):
            groups[kind][cloud.group(self._group("support", number))] = True
        fixed, springs = groups["fixed"], groups["springs"]
        sliding = groups["roller"] | groups["rail"]
        bodies = _bodies(cloud)
        for nodes, where in bodies:
            count = int(fixed[nodes].sum())
            if fixed[nodes].mean() > MAX_HELD_SHARE:
                raise InputError(
                    f"fixed must leave tissue free, got {fixed[nodes].mean():.0%} of the nodes{where} held; hold a "
                    "smaller part"
                )
            if count < MIN_HELD and not springs[nodes].any() and not sliding[nodes].any():
                raise InputError(f"fixed must hold at least {MIN_HELD} nodes{where}, got {count}; hold a larger part")


def _files(sections_: Any) -> set[str]:
    """Return the names of files in nested sections."""
    if isinstance(sections_, Mapping):
        names = {sections_[key] for key in ("file", "labels") if sections_.get(key)}
        return names.union(*(_files(each) for each in sections_.values()))
    if isinstance(sections_, list | tuple):
        return set().union(*(_files(each) for each in sections_))
    return set()


def _check_closed(surface: Surface) -> SurfaceReport:
    """Return the report of a surface; raise InputError if it cannot be filled."""
    report = check_surface(surface)
    if report.errors:
        raise InputError(
            f"{surface.name} must hold a closed surface, got one that is not: {report.errors[0].what}; run palpate "
            "check for pictures"
        )
    return report


def _bodies(cloud: Cloud) -> list[tuple[Ints, str]]:
    """Return the nodes of each body of a cloud, and its name for messages, empty for one alone."""
    names = [name for name in cloud.groups if name.startswith(f"{BODY_PREFIX} ")]
    if not names:
        return [(np.arange(len(cloud)), "")]
    return [(cloud.group(name), f" of {name} of {len(names)}") for name in names]


def _with_group(cloud: Cloud, name: str, mask: NDArray[np.bool_]) -> Cloud:
    """Return the cloud with a group; the cloud itself if it has this one."""
    if name in cloud.groups and np.array_equal(cloud.groups[name], np.flatnonzero(mask)):
        return cloud
    return cloud.with_group(name, mask)


def _on_surface(cloud: Cloud, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the nodes of a mask that are on the surface."""
    if cloud.points.shape[1] == 2:
        return mask
    on = np.zeros(len(cloud), dtype=bool)
    on[cloud.face_nodes] = True
    if not np.any(mask & on):
        raise InputError("place must hold nodes of the surface, got inner nodes only; make it larger")
    return np.asarray(mask & on)
