"""The names of the package's scenes, and what the name of a scene stands for.

A command line reads them without an import of numerics.
"""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from palpate.surface.formats.names import LABEL_FORMATS, SURFACE_FORMATS, format_of

PACKAGE_SCENES = ("beam", "liver", "membrane")  # files in the folder data
SCENE_SUFFIX = ".toml"
TOOL_GROUP = "tool"  # of the nodes that a tool holds from the start


class SceneKind(Enum):
    """Where a scene comes from."""

    PACKAGE = "package"
    SCENE_FILE = "scene file"
    SURFACE_FILE = "surface file"


def kind_of(name: str) -> SceneKind | None:
    """Return the kind of the scene of a name; None for other names, such as those of models and functions."""
    if name in PACKAGE_SCENES:
        return SceneKind.PACKAGE
    if name.lower().endswith(SCENE_SUFFIX):
        return SceneKind.SCENE_FILE
    is_surface = format_of(Path(name))[0] in (*SURFACE_FORMATS, *LABEL_FORMATS)
    return SceneKind.SURFACE_FILE if is_surface else None


def listed_scenes() -> str:
    """Return the names for a sentence, such as ``beam, liver, membrane``."""
    return ", ".join(PACKAGE_SCENES)
