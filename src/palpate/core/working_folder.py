"""Guards against files that other packages would read from the working folder, or that others can write.

Numba reads its configuration, pyMOR a program and matplotlib its style from the folder in which a
person works. This folder may hold downloaded files, so palpate prevents all three. Compiled code is
read only where nobody but root and the user can write (`foreign_writer`).

This module imports the standard library only, because `palpate/__init__.py` imports it.
"""

from __future__ import annotations

import contextlib
import io
import os
import stat
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

NUMBA_CONFIGURATION = "numba.core.config"
MATPLOTLIB_STYLE = "matplotlibrc"
PYMOR_DEFAULTS = "PYMOR_DEFAULTS"
MAX_LINKS = 40  # of one path, as of Linux
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH

Guard = Callable[[ModuleType], contextlib.AbstractContextManager[None]]


# folders of compiled code


def cache_folder() -> Path | None:
    """Return the folder of palpate in the user's cache; None for a user without a home folder."""
    from platformdirs import user_cache_path  # not of the standard library

    try:
        folder = user_cache_path("palpate")
    except RuntimeError:
        return None
    return folder if folder.is_absolute() else None


def foreign_writer(place: str | Path) -> str:
    """Return the reason for which others can replace a folder or file; empty if only root and the user can.

    It belongs to one of them, also where this process cannot write it. All parents and links count; missing parts of
    the path are ignored. A parent with the sticky bit may be writable by others, because they cannot rename there what
    is not theirs. A parent may belong to the owner of ``/``, as whom a container may show root.
    """
    if os.name != "posix":
        return ""
    path, owners = Path(os.path.abspath(place)), (0, os.getuid())
    parents_owners = (*owners, os.stat("/").st_uid)
    for _ in range(MAX_LINKS):
        for part in (*reversed(path.parents), path):
            try:
                status = part.lstat()
            except OSError:
                return ""  # missing, as are all below it
            if status.st_uid not in (owners if part == path else parents_owners):
                return f"{part} belongs to another user"
            if stat.S_ISLNK(status.st_mode):
                target = Path(os.path.abspath(part.parent / os.readlink(part)))
                path = target / path.relative_to(part)
                break
            if status.st_mode & OTHERS_WRITE and (part == path or not status.st_mode & stat.S_ISVTX):
                return f"others can write to {part}"
        else:
            return ""
    return f"{place} has more than {MAX_LINKS} links"


def make_private(folder: str | Path) -> None:
    """Create a folder and its missing parents, for their owner only."""
    path = Path(folder)
    for part in (*reversed(path.parents), path):
        with contextlib.suppress(FileExistsError):
            if not part.is_dir():
                part.mkdir(mode=0o700)


def check_cache_folder() -> None:
    """Refuse a folder for compiled code that others can write, because this code is run.

    In a folder with the sticky bit, such as ``/tmp``, ``NUMBA_CACHE_DIR`` becomes a private folder of the user.
    """
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if not folder:
        return
    if not os.path.isabs(folder):
        raise ImportError(
            f"NUMBA_CACHE_DIR must be an absolute path, got {folder!r}; compiled code in the working folder is not run"
        )
    with contextlib.suppress(OSError):  # a folder that cannot be created is not used
        make_private(folder)
        mode = os.stat(folder).st_mode
        if mode & stat.S_ISVTX and mode & OTHERS_WRITE:
            folder = os.environ["NUMBA_CACHE_DIR"] = os.path.join(folder, f"palpate-{os.getuid()}")
            make_private(folder)
    if why := foreign_writer(folder):
        raise ImportError(
            f"NUMBA_CACHE_DIR must be a folder that only you or root can write, got {folder!r}, but {why}; choose "
            "another folder, make it yours alone (chmod go-w), or unset the variable"
        )


# configuration of packages


class _GuardedLoader(Loader):
    """A loader of a module that reads no configuration in the working folder."""

    def __init__(self, loader: Loader, guard: Guard) -> None:
        self._loader, self._guard = loader, guard

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        with self._guard(module):
            self._loader.exec_module(module)


class _GuardingFinder(MetaPathFinder):
    """A finder that guards the execution of a module."""

    def __init__(self, name: str, guard: Guard) -> None:
        self.name, self._guard = name, guard

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self.name:
            return None
        spec = None
        for finder in list(sys.meta_path):
            if finder is not self and hasattr(finder, "find_spec") and spec is None:
                spec = finder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = _GuardedLoader(spec.loader, self._guard)
        return spec


@contextlib.contextmanager
def _without_configuration(module: Any) -> Iterator[None]:
    """Hide the package that reads Numba's file, while Numba's configuration is imported."""
    hidden = sys.modules.get("yaml")
    sys.modules["yaml"] = None  # type: ignore[assignment]
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "A Numba config file is found")
            yield
    finally:
        del sys.modules["yaml"]
        if hidden is not None:
            sys.modules["yaml"] = hidden
    _forget_configuration(module)


def _forget_configuration(module: Any) -> None:
    module._config_fname = ""  # no file has this name, also when Numba looks again before it compiles


@contextlib.contextmanager
def _without_style(module: Any) -> Iterator[None]:
    """Hide ``matplotlibrc`` in the working folder, where matplotlib looks first."""
    exists = os.path.exists
    os.path.exists = lambda path: path != MATPLOTLIB_STYLE and exists(path)
    try:
        yield
    finally:
        os.path.exists = exists


def guard_numba() -> None:
    """Prevent Numba from reading its configuration in the working folder, now and later."""
    loaded = sys.modules.get(NUMBA_CONFIGURATION)
    if loaded is None:
        sys.meta_path.insert(0, _GuardingFinder(NUMBA_CONFIGURATION, _without_configuration))
    else:
        _forget_configuration(loaded)
        loaded.reload_config()


def guard_matplotlib() -> None:
    """Prevent matplotlib from reading its style in the working folder when it is imported later.

    Commands call this. In programs of users the rules of matplotlib hold.
    """
    if not any(isinstance(each, _GuardingFinder) and each.name == "matplotlib" for each in sys.meta_path):
        sys.meta_path.insert(0, _GuardingFinder("matplotlib", _without_style))


def import_pymor() -> None:
    """Import pyMOR without its defaults in the working folder, which are a program."""
    if "pymor" in sys.modules or PYMOR_DEFAULTS in os.environ:
        import pymor

        return
    os.environ[PYMOR_DEFAULTS] = "NONE"
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # pyMOR prints that it loads none
            import pymor  # noqa: F401
    finally:
        del os.environ[PYMOR_DEFAULTS]
