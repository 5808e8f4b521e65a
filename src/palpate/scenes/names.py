"""The names of the package's scenes, and the suffix of scene files.

A command line reads them without an import of numerics.
"""

from __future__ import annotations

__all__ = ["PACKAGE_SCENES", "SCENE_SUFFIX", "is_scene_file", "listed_scenes"]

PACKAGE_SCENES = ("beam", "liver", "membrane")  # files in the folder data
SCENE_SUFFIX = ".toml"


def is_scene_file(what: str) -> bool:
    """Return True for the name of a scene file."""
    return what.lower().endswith(SCENE_SUFFIX)


def listed_scenes() -> str:
    """Return the names for a sentence, such as ``beam, liver, membrane``."""
    return ", ".join(PACKAGE_SCENES)
