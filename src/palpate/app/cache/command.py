"""The command ``palpate cache``: the folder of compiled functions, and its removal."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from palpate.app.common.console import print_json
from palpate.code_cache import MAX_BYTES, code_files, code_folder
from palpate.shipped_code import installed_packs, machine_processor

__all__ = ["show_cache"]


def show_cache(empty: bool, as_json: bool) -> int:
    """Print where compiled functions are kept, how many and how large; remove them if asked; return 0."""
    folder, files = code_folder(), code_files()
    if empty:
        for each in files:
            with suppress(OSError):  # removed by another process
                each.path.unlink()
    triple, _, features = machine_processor()
    packs = {family: len(pack) for family, pack in installed_packs(triple, features)}
    report: dict[str, Any] = {
        "folder": None if folder is None else str(folder),
        "functions": len(files),
        "bytes": sum(each.size for each in files),
        "limit": MAX_BYTES,
        "removed": empty,
        "installed": packs,
    }
    if as_json:
        print_json(report)
        return 0
    what = f"{len(files):,} compiled functions, {1e-6 * report['bytes']:.1f} of at most {1e-6 * MAX_BYTES:.0f} MB"
    print("no folder for compiled functions" if folder is None else f"{'removed ' if empty else ''}{what}\n{folder}")
    for family, count in packs.items():
        print(f"palpate-kernels: {count:,} functions for {family}")
    return 0
