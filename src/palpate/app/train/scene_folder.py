"""Folder of the campaign of a scene: next to a scene file, or in the user's cache for a scene of the package."""

from __future__ import annotations

import os
from pathlib import Path

from palpate import __version__
from palpate.core.faults import InputError
from palpate.core.working_folder import cache_folder
from palpate.scenes.names import SceneKind, kind_of
from palpate.scenes.scene import Scene

FOLDER_SUFFIX = ".palpate"  # of the folder next to a scene file


def training_folder(scene: Scene) -> Path:
    """Return the path of a scene's campaign, which may be missing; a changed scene has another folder."""
    if scene.kind is SceneKind.PACKAGE:
        folder = cache_folder()
        if folder is None:
            raise InputError("the user must have a home folder, got none; set XDG_CACHE_HOME to a folder of yours")
        return folder / f"{scene.name}-{__version__}-{scene.digest[:8]}"
    return folder_of_file(Path(scene.name)) / scene.digest[:8]


def folder_of_file(file: Path) -> Path:
    """Return the folder next to a scene file."""
    return file.with_name(file.stem + FOLDER_SUFFIX)


def recordings_folder(file: Path) -> Path:
    """Return the folder of the recordings of a page that shows a scene file."""
    return folder_of_file(file) / "recordings"


def last_recording(file: Path) -> Path:
    """Return the newest recording of a scene file; raise `InputError` if there is none."""
    recordings = sorted(recordings_folder(file).glob("*.h5"), key=lambda path: (path.stat().st_mtime_ns, path.name))
    if not recordings:
        raise InputError(
            f"{file} must have a recording in {recordings_folder(file)}, got none; press record on the page of palpate "
            f"view {file}"
        )
    return recordings[-1]


def name_in_folder(scene: str, folder: Path) -> str:
    """Return the name of a scene in a campaign's manifest: of a file, its path from the folder."""
    return os.path.relpath(scene, folder) if is_file(scene) else scene


def scene_in_folder(name: str, folder: Path) -> str:
    """Return the scene of a manifest: the inverse of `name_in_folder`."""
    return str(folder / name) if is_file(name) else name


def is_file(scene: str) -> bool:
    """Return True for a scene of a scene file or a surface file."""
    return kind_of(scene) in (SceneKind.SCENE_FILE, SceneKind.SURFACE_FILE)
