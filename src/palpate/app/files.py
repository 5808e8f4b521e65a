"""Files that are written whole or not at all, and a folder that is known to take them before a run begins."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from palpate.faults import InputError

__all__ = ["check_folder", "check_space", "settle", "whole_file", "write_json"]


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`, of the same kind; give it the real name if all went well.

    What has the real name is on the disk, whatever stops the process or the machine.

    Raises
    ------
    OSError
        The file cannot be written; names it.
    """
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        yield partial
        settle(partial, path)
    except OSError as error:
        why = error.strerror or error
        raise OSError(f"cannot write {path}: {why}; free some space or choose another folder") from error
    finally:
        partial.unlink(missing_ok=True)


def settle(partial: Path, path: Path) -> None:
    """Give a file that is written its name, once it is on the disk."""
    with partial.open("rb+") as file:
        os.fsync(file.fileno())
    os.replace(partial, path)
    if os.name == "posix":  # elsewhere folders cannot be opened
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file, whole or not at all."""
    with whole_file(path) as partial:
        partial.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def check_folder(folder: Path, name: str = "out") -> None:
    """Check that files can be written into a folder that exists or can be made; leave nothing behind.

    Parameters
    ----------
    folder : path
    name : str
        Of the option that gave it.

    Raises
    ------
    InputError
        It is not a folder, or cannot be written.
    """
    existing = _existing(folder)
    if not existing.is_dir():
        raise InputError(
            f"{name} = {str(folder)!r}: {existing} is not a folder; allowed is a folder that can be written"
        )
    try:
        with TemporaryDirectory(prefix=".palpate-", dir=existing) as probe:
            (Path(probe) / "probe").write_bytes(bytes(4096))
    except OSError as error:
        why = (error.strerror or str(error)).lower()
        raise InputError(f"{name} = {str(folder)!r}: {existing} cannot be written ({why}); choose another") from error


def check_space(folder: Path, needed: int, name: str = "out") -> None:
    """Check that the disk of a folder, which exists or can be made, has room for a number of bytes.

    Parameters
    ----------
    folder : path
    needed : int
    name : str
        Of the option that gave the folder.

    Raises
    ------
    InputError
        It has not.
    """
    free = shutil.disk_usage(_existing(folder)).free
    if free < needed:
        need, has = needed / 1e6, free / 1e6
        raise InputError(f"{name} = {str(folder)!r}: this run writes about {need:.0f} MB, {has:.0f} MB are free")


def _existing(folder: Path) -> Path:
    """Return the folder itself, or the nearest one above it that exists."""
    existing = folder.absolute()
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    return existing
