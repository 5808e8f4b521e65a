"""A scene that was opened: the body, the loads and the tool paths of a `Description`.

Files are read and bodies are made when they are first used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.arrays import Floats
from palpate.describe import Fact
from palpate.files import digest_of, read_bytes
from palpate.scenes.description import CHOICES_OF_RUNS
from palpate.scenes.names import TOOL_GROUP
from palpate.scenes.scene_source import SceneSource, group_name, naming

if TYPE_CHECKING:  # mechanics take a second to import, before a page opens
    from palpate.dynamics.loads.foundation import Foundation
    from palpate.dynamics.loads.prepared import Load
    from palpate.dynamics.membrane.model import Membrane
    from palpate.dynamics.solid.model import Solid
    from palpate.meshfree.cloud import Cloud
    from palpate.scenes.scene_paths import HeldMotion
    from palpate.scenes.tool_paths import ToolPaths


class OrganScene(SceneSource):
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
    def cloud(self) -> Cloud:
        """Nodes of the body, with groups of its supports, regions and loads.

        Raises
        ------
        InputError
            The surface cannot be filled, or a place holds no node, too few or too many.
        CloudError
            The body is too thin for the spacing.
        """
        from palpate.scenes.scene_body import scene_cloud

        return scene_cloud(self)

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
        from palpate.scenes.scene_body import check_disc, scene_body

        check_disc(self)
        return scene_body(self, self.cloud, self.foundations)

    @cached_property
    def foundations(self) -> tuple[Foundation, ...]:
        """Springs per area, which act in every run."""
        from palpate.scenes.scene_body import scene_foundations

        return scene_foundations(self)

    @cached_property
    def loads(self) -> tuple[Load, ...]:
        """Loads of a single run, with the foundations."""
        from palpate.scenes.scene_body import scene_loads

        return scene_loads(self, self.foundations)

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

    def tool_paths(self) -> ToolPaths:
        """Return the paths of the tool on the free surface of the body."""
        from palpate.scenes.scene_paths import touching_paths
        from palpate.scenes.tool_paths import check_radius

        about = self.description
        if about.tool.radius is not None and about.body.spacing is not None:  # before the body is filled
            with naming(self, "tool", "radius"):
                check_radius(about.tool.radius, about.body.spacing)
        return touching_paths(about.tool, about.training, self.body, self.foundations)

    def held_motion(self, seed: int, duration: float) -> HeldMotion:
        """Return a motion of the tool that holds a group, over a time [s]."""
        from palpate.scenes.scene_paths import held_motion

        return held_motion(self.description.training, seed, duration)

    @property
    def region_groups(self) -> list[str]:
        """Groups of the regions."""
        return [group_name(self, "region", number) for number in range(len(self.description.region))]

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


def _files(sections_: Any) -> set[str]:
    """Return the names of files in nested sections."""
    if isinstance(sections_, Mapping):
        names = {sections_[key] for key in ("file", "labels") if sections_.get(key)}
        return names.union(*(_files(each) for each in sections_.values()))
    if isinstance(sections_, list | tuple):
        return set().union(*(_files(each) for each in sections_))
    return set()
