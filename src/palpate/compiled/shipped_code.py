"""Compiled functions of the installed package ``palpate-kernels``, for a family of processors.

A pack is one file for a version of Python, Numba and NumPy, a system and a family of processors. It holds what the
functions of `palpate.compiled.code_cache` keep in the folder of a user, under the same names. Packs are read where
Python would import the package from, and only if nobody but their owner can write them, because their code is run.

Layout: length of the index (8 bytes), index (JSON: name -> [offset, length, CRC-32]), entries.
"""

from __future__ import annotations

import json
import mmap
import sys
import warnings
import zlib
from collections.abc import Callable, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numba
import numpy as np
from numba.core.registry import cpu_target

from palpate.core.working_folder import foreign_writer

PACKAGE_NAME = "palpate_kernels"
INDEX_BYTES = 8  # of the length of the index
NUMPY_VERSION = ".".join(np.__version__.split(".")[:2])
# name of a processor in LLVM: the features that a machine needs to run its code
PROCESSOR_FAMILIES = {
    "x86-64-v3": "+avx,+avx2,+bmi,+bmi2,+cx16,+f16c,+fma,+lzcnt,+movbe,+popcnt,+sahf,+sse3,+sse4.1,+sse4.2,+ssse3",
    "generic": "+neon",
    "apple-m1": "+neon",
}


def pack_name(triple: str, family: str) -> str:
    """Return the name of the pack of this Python, Numba and NumPy for a system and a family of processors."""
    python = f"{sys.version_info[0]}{sys.version_info[1]}"
    return f"py{python}-numba{numba.__version__}-numpy{NUMPY_VERSION}-{triple}-{family}.pack"


def write_pack(path: Path, entries: Mapping[str, bytes]) -> None:
    """Write a pack of entries by their names."""
    index, offset = {}, 0
    for name, content in entries.items():
        index[name] = offset, len(content), zlib.crc32(content)
        offset += len(content)
    text = json.dumps(index).encode()
    path.write_bytes(len(text).to_bytes(INDEX_BYTES, "little") + text + b"".join(entries.values()))


class Pack:
    """A pack, whose entries are read one by one."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._start = INDEX_BYTES + int.from_bytes(self._map[:INDEX_BYTES], "little")
        self._index = json.loads(self._map[INDEX_BYTES : self._start])

    def __len__(self) -> int:
        return len(self._index)

    def read(self, name: str) -> bytes | None:
        """Return an entry; None if there is none, or it is damaged."""
        if name not in self._index:
            return None
        offset, length, check = self._index[name]
        content = self._map[self._start + offset : self._start + offset + length]
        return content if zlib.crc32(content) == check else None


def machine_processor() -> tuple[str, str, str]:
    """Return the triple, processor and features of LLVM for which functions are compiled here."""
    triple, processor, features = cpu_target.target_context.codegen().magic_tuple()
    return triple, processor, features


@cache
def installed_packs(triple: str, features: str) -> tuple[tuple[str, Pack], ...]:
    """Return the families of processors that this machine belongs to, and their packs; warn once if none fits."""
    spec = find_spec(PACKAGE_NAME)
    if spec is None or spec.origin is None:
        return ()
    folder, packs, why = Path(spec.origin).parent, list[tuple[str, Pack]](), list[str]()
    for family, needed in PROCESSOR_FAMILIES.items():
        path = folder / pack_name(triple, family)
        if set(needed.split(",")) <= set(features.split(",")) and path.is_file():
            if reason := foreign_writer(path):
                why.append(reason)
                continue
            try:
                packs.append((family, Pack(path)))
            except (OSError, ValueError):  # damaged: its functions are compiled
                continue
    if not packs and list(folder.glob("*.pack")):
        warnings.warn(
            f"functions are compiled: palpate-kernels has none for Python {sys.version_info[0]}.{sys.version_info[1]}, "
            f"Numba {numba.__version__}, NumPy {NUMPY_VERSION} and this processor" + (f"; {why[-1]}" if why else ""),
            RuntimeWarning,
            stacklevel=2,
        )
    return tuple(packs)


def find_shipped(name_for: Callable[[tuple[str, ...]], str], processor: tuple[str, ...]) -> bytes | None:
    """Return the entry of a function in an installed pack, or None.

    `name_for` returns the name of the entry for a triple, a processor and its features; `processor` has those of this
    machine.
    """
    triple, _, features = processor
    for family, pack in installed_packs(triple, features):
        content = pack.read(name_for((triple, family, "")))
        if content is not None:
            return content
    return None
