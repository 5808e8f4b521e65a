"""A scene: a description with its files, and the surface, body, loads and tool paths that come of them.

Files are read and bodies are made when they are first used. What needs mechanics is made by functions of
`palpate.scenes.body`, which take a description and no scene.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError
from palpate.core.files import digest_of, read_bytes
from palpate.core.parameters import Fault
from palpate.scenes.description import CHOICES_OF_RUNS, Description
from palpate.scenes.names import TOOL_GROUP, SceneKind, kind_of
from palpate.scenes.organ import liver_surface
from palpate.scenes.scene_text import at_entry, line_of_file, words_of
from palpate.scenes.tissue import material_of
from palpate.surface.checks import SurfaceReport, check_surface, shape_problems
from palpate.surface.files import read_surface
from palpate.surface.labels.reading import is_label_map
from palpate.surface.repair import repair_surface
from palpate.surface.surface import Surface, scaled
from palpate.tissue.materials import Material

if TYPE_CHECKING:  # mechanics take a second to import, before a page opens
    from palpate.dynamics.loads.foundation import Foundation
    from palpate.dynamics.loads.prepared import Load
    from palpate.dynamics.membrane.model import Membrane
    from palpate.dynamics.solid.model import Solid
    from palpate.meshfree.cloud import Cloud
    from palpate.scenes.scene_paths import HeldMotion
    from palpate.scenes.tool_paths import ToolPaths


class Scene(Described):
    """A body with its loads and tool paths, of a scene file, a surface file or a scene of the package.

    Parameters
    ----------
    description : Description
    folder : path
        Folder of relative file names.
    name : str
        Name of the scene in messages and reports: of a scene of the package, or the path of a file.
    settings : mapping, optional
        Settings that replaced values of the file; workers of a campaign open the scene with them.

    Attributes
    ----------
    kind : SceneKind or None
        Where it comes from, by its name.
    notes : list of str
        What was guessed or repaired so far.
    subtitle : str
        Names of the labels of a map that lie in the body, of those with it and those without; empty without any.

    Examples
    --------
    >>> import palpate as pt
    >>> scene = pt.open_scene("beam", {"spacing": "6.6 mm"})
    >>> scene.duration, scene.every, len(scene.loads)
    (1.0, 0.01, 1)
    """

    _public = (
        "body", "cloud", "description", "duration", "every", "folder", "foundations", "kind", "loads", "material",
        "name", "notes", "paths", "settings", "subtitle", "surface", "title", "with_body",
    )  # fmt: skip

    def __init__(
        self, description: Description, folder: Path, name: str, settings: Mapping[str, Any] | None = None
    ) -> None:
        self.description, self.folder, self.name, self.kind = description, folder, name, kind_of(name)
        self.settings = dict(settings or {})
        self.notes: list[str] = []
        self.subtitle = ""

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
        about = self.description
        if about.title or not about.surface.file:
            return about.title or Path(self.name).stem.capitalize()
        return title_of_file(about.surface.file, about.surface.parts)

    def with_body(self, **changes: Any) -> Scene:
        """Return the scene with other settings of its body, such as ``spacing=0.005``."""
        about = replace(self.description, body=replace(self.description.body, **changes))
        settings = {key: value for key, value in self.settings.items() if key.removeprefix("body.") not in changes}
        settings |= {f"body.{name}": value for name, value in changes.items()}
        scene = Scene(about, self.folder, self.name, settings)
        scene.subtitle = self.subtitle
        scene.take_surface(self)
        return scene

    def with_tissue(self, cloud: Cloud | None = None, **changes: Any) -> Scene:
        """Return the scene with other settings of its tissue, such as ``law="Ogden"``, and its nodes if known."""
        about = replace(self.description, tissue=replace(self.description.tissue, **changes))
        scene = Scene(about, self.folder, self.name, self.settings)
        scene.subtitle = self.subtitle
        scene.take_surface(self)
        if cloud is not None:
            vars(scene)["cloud"] = cloud
        return scene

    def take_surface(self, other: Scene) -> None:
        """Take the surface of a scene with the same file, if that scene has read it, so that it is read once."""
        if "surface" in vars(other):
            vars(self)["surface"] = other.surface

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
        if is_label_map(shape.file):
            return self.read_surface()
        with contextlib.suppress(InputError):  # parts that are closed after a repair alone
            surface = self.read_surface()
            if not shape.repair or not any(problem.kind == "error" for problem in shape_problems(surface)):
                return surface
        surface = self.read_surface(shape.repair)
        _check_closed(surface)
        return surface

    def read_surface(self, repair: bool = False) -> Surface:
        """Return the surface of the file with its faults, as it is or repaired."""
        shape = self.description.surface
        surface = read_surface(
            self.folder / shape.file, part=list(shape.parts) or None, units=shape.units or None, scale=shape.scale,
            repair=repair, labels=self.folder / shape.labels if shape.labels else None,
        )  # fmt: skip
        return _with_title(surface, self.description.title) if is_label_map(shape.file) else surface

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
        from palpate.scenes.body import DEFAULT_SIDE, check_spacing, make_cloud

        about = self.description
        check_spacing(about)
        surface = self.repaired_surface
        with self._placing_faults():
            cloud, notes = make_cloud(about, surface, self.folder)
        self.notes += notes
        if not about.support and self.kind is SceneKind.SCENE_FILE:
            self.notes.append(
                f"support: the scene has none, so the side {DEFAULT_SIDE!r} of the body is held; give [[support]]"
            )
        return cloud

    @cached_property
    def body(self) -> Solid | Membrane:
        """Full model of the body.

        Raises
        ------
        InputError, CloudError
            As `cloud`, or the tissue does not suit the body.
        """
        return self._body_and_start[0]

    @property
    def start(self) -> Floats | None:
        """Displacements (n, 3) [m] of the body at the start of a run: those of a shape under loads, or None."""
        return self._body_and_start[1]

    @cached_property
    def _body_and_start(self) -> tuple[Solid | Membrane, Floats | None]:
        from palpate.scenes.body import check_disc, make_body

        check_disc(self.description)
        cloud = self.cloud
        with self._placing_faults():
            body, start = make_body(self.description, self.material, cloud, self.surface, self.folder)
        if start is not None:
            sag = float(np.linalg.norm(start, axis=1).max())
            self.notes.append(
                f"body: its stress-free shape is up to {1e3 * sag:.3g} mm from the surface, which loads have deformed; "
                "runs begin in that shape, a view and training in the stress-free one"
            )
        return body, start

    @cached_property
    def foundations(self) -> tuple[Foundation, ...]:
        """Springs per area, which act in every run."""
        from palpate.scenes.body import foundations_of

        return foundations_of(self.description)

    @cached_property
    def loads(self) -> tuple[Load, ...]:
        """Loads of a single run, with the foundations."""
        from palpate.scenes.body import loads_of

        return loads_of(self.description)

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
        duration, every = self.description.training.duration, self.description.training.every
        self.check_training()
        from palpate.scenes.scene_paths import HAND_DURATION, held_motion
        from palpate.scenes.tool_paths import is_touch

        def path(seed: int) -> tuple[tuple[Load, ...], float]:
            by_hand = is_touch(seed)
            length = every * round(HAND_DURATION * duration / every) if by_hand else duration
            load = held_motion(self.description.training, seed, length, by_hand).load(self.body.cloud, self.held_group)
            return (*self.foundations, load), length

        return path

    def check_training(self) -> None:
        """Raise `InputError` for a spacing, a disc, a tool or a motion with which nothing can be trained.

        The body is not made.
        """
        from palpate.scenes.body import check_disc, check_spacing
        from palpate.scenes.tool_paths import check_radius

        about = self.description
        check_spacing(about)
        check_disc(about)
        if self.held_group:
            self.held_motion(0, about.training.duration)
        elif about.tool.radius is not None and about.body.spacing is not None:
            with self._placing_faults(), at_entry("tool", "radius"):
                check_radius(about.tool.radius, about.body.spacing)

    def tool_paths(self) -> ToolPaths:
        """Return the paths of the tool on the free surface of the body."""
        from palpate.scenes.scene_paths import touching_paths

        about = self.description
        self.check_training()
        return touching_paths(about.tool, about.training, self.body, self.foundations)

    def held_motion(self, seed: int, duration: float) -> HeldMotion:
        """Return a motion of the tool that holds a group, over a time [s]."""
        from palpate.scenes.scene_paths import held_motion

        return held_motion(self.description.training, seed, duration)

    @property
    def region_groups(self) -> list[str]:
        """Groups of the regions."""
        about = self.description
        return [about.group_name("region", number) for number in range(len(about.region))]

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

    @contextlib.contextmanager
    def _placing_faults(self) -> Iterator[None]:
        """Name the file, the line and the keys of an entry in errors."""
        try:
            yield
        except Fault as fault:
            error = fault.__cause__
            assert error is not None  # `at_entry`
            raise type(error)(f"{self._location(fault.path)}: {fault.message}") from error

    def _location(self, keys: tuple[str | int, ...]) -> str:
        """Return the file, the line and the keys of an entry; for a surface the argument that gives supports."""
        if keys[0] == "support" and self.kind is SceneKind.SURFACE_FILE:
            return "fixed"
        words = ".".join(words_of(keys))
        is_set = any(words == key or words.endswith(f".{key}") for key in self.settings)
        if is_set or self.kind is not SceneKind.SCENE_FILE:
            return words
        return f"{self.name}, line {line_of_file(Path(self.name), keys)}: {words}"


def title_of_file(file: str | Path, parts: Sequence[str]) -> str:
    """Return the title of the body in a file: its name, or those of its parts of a label map."""
    from palpate.surface.formats.names import LABEL_FORMATS, format_of
    from palpate.surface.parts import names_text

    path = Path(file)
    kind, packed = format_of(path)
    stem = Path(path.stem).stem if packed else path.stem
    words = f"{names_text(parts, 3)} ({stem})" if parts and kind in LABEL_FORMATS else stem
    words = words.replace("_", " ")
    return words[:1].upper() + words[1:]


def _with_title(surface: Surface, title: str) -> Surface:
    """Return the surface of a label map with the title of its scene, also in its warnings, in place of its parts."""
    if not title:
        return surface
    warnings = tuple(title + each.removeprefix(surface.name) if each.startswith(surface.name) else each
                     for each in surface.warnings)  # fmt: skip
    return replace(surface, name=title, warnings=warnings)


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
