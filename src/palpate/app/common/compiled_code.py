"""``palpate --cache``: the folder of compiled functions, and its removal; and a digest of what is compiled."""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any


def add_cache_option(parser: argparse.ArgumentParser) -> None:
    """Add the option to the parser of all commands."""
    parser.add_argument(
        "--cache",
        action=_CacheAction,
        nargs="?",
        const="show",
        choices=("show", "json", "empty"),
        help="show the folder of compiled functions, their number and size, also as json; empty removes them",
    )


class _CacheAction(argparse.Action):
    """Prints and exits, as ``--version`` does."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options | {"dest": argparse.SUPPRESS, "default": argparse.SUPPRESS})

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        _show_cache(values)
        parser.exit()


def _show_cache(what: str) -> None:
    """Print where compiled functions are kept, how many and how large; remove them if `what` is ``"empty"``."""
    from palpate.app.common.console import print_json
    from palpate.compiled.code_cache import MAX_BYTES, code_files, code_folder
    from palpate.compiled.shipped_code import installed_packs, machine_processor

    folder, files = code_folder(), code_files()
    if what == "empty":
        for each in files:
            with suppress(OSError):  # removed by another process, or the folder cannot be written
                each.path.unlink()
        files = [each for each in files if not each.path.exists()]
    triple, _, features = machine_processor()
    packs = {family: len(pack) for family, pack in installed_packs(triple, features)}
    size = sum(each.size for each in files)
    if what == "json":
        place = None if folder is None else str(folder)
        print_json({"folder": place, "functions": len(files), "bytes": size, "limit": MAX_BYTES, "installed": packs})
        return
    text = f"{len(files):,} compiled functions, {1e-6 * size:.1f} of at most {1e-6 * MAX_BYTES:.0f} MB"
    removed = "removed " if what == "empty" else ""
    print("no folder for compiled functions" if folder is None else f"{removed}{text}\n{folder}")
    for family, count in packs.items():
        print(f"palpate-kernels: {count:,} functions for {family}")


@cache
def code_digest() -> str:
    """Return a digest of the installed sources and of the folder of their compiled code."""
    import numba

    import palpate

    root = Path(palpate.__file__).parent
    source_files = [(str(path), path.stat().st_mtime_ns, path.stat().st_size) for path in sorted(root.rglob("*.py"))]
    settings = os.environ.get("NUMBA_CACHE_DIR", ""), numba.__version__, sys.version
    return hashlib.sha256(repr((source_files, settings)).encode()).hexdigest()
