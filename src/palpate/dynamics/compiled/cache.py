"""Compiled functions that are made for one material law and still found in the cache of the next process.

Numba looks a cached function up by its closure, and a closure over other compiled functions never compares equal
in a new process; nor does it notice when a function it has inlined changes. Here the key is a digest of the sources
of this package's kernels and of the law.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import CellType, FunctionType
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.extending import register_jitable

__all__ = ["inlined", "kernel_njit", "law_digest", "law_njit", "named_for"]


class KeyedFile(IndexDataCacheFile):  # type: ignore[misc]
    """Compiled code on the disk, in a file of its own for each key.

    Numba numbers these files. Two processes that save at once give two codes one number, and who reads them then runs
    the code of another signature, which crashes.
    """

    def save(self, key: Any, data: Any) -> None:
        """Save compiled code under a key."""
        known = self._load_index()
        base = self._index_name.removesuffix(".nbi")
        name = f"{base}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"
        if known.get(key) != name:
            self._save_index(known | {key: name})
        self._save_data(name, data)


class _DigestCache(FunctionCache):  # type: ignore[misc]
    def __init__(self, function: Callable[..., Any], digest: str) -> None:
        super().__init__(function)
        self._digest = digest
        locator = self._impl.locator
        self._cache_file = KeyedFile(self._cache_path, self._impl.filename_base, locator.get_source_stamp())

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (sig, codegen.magic_tuple(), self._digest)


KERNELS = (
    "dynamics/contact/geometry.py",
    "dynamics/contact/impulses.py",
    "dynamics/material/fibres.py",
    "dynamics/compiled/passes.py",
    "dynamics/compiled/lanes.py",
    "dynamics/material/material_fields.py",
    "dynamics/material/principal_stretches.py",
    "dynamics/material/principal_point.py",
    "dynamics/solid/strong_form.py",
    "dynamics/solid/energy_form.py",
    "dynamics/material/relaxation.py",
    "dynamics/membrane/passes.py",
    "dynamics/membrane/additional_stress.py",
    "dynamics/membrane/principal_moduli.py",
    "dynamics/material/small_strain.py",
    "dynamics/nodal/central_difference.py",
    "reduction/contact/compliance.py",
    "reduction/contact/tangent.py",
    "reduction/hyper/foundation.py",
    "reduction/hyper/implicit.py",
    "reduction/galerkin/step.py",
    "reduction/hyper/material_point.py",
    "reduction/hyper/sampled_energy.py",
    "reduction/hyper/explicit.py",
    "reduction/contact/gauss_seidel.py",
    "reduction/realtime/period.py",
)


@cache
def _kernel_sources() -> bytes:
    return b"".join((Path(__file__).parents[1] / name).read_bytes() for name in KERNELS)


def law_digest(*what: object) -> str:
    """Digest of functions (by their source), other values (by their repr), and the sources of the kernels."""
    digest = hashlib.sha256(_kernel_sources())
    for item in what:
        digest.update(_said(item).encode())
    return digest.hexdigest()


def _said(item: object) -> str:
    """Source of a function and of the functions that it closes over, or the repr of another value."""
    if not inspect.isfunction(item):
        return repr(item)
    return inspect.getsource(item) + "".join(_said(cell.cell_contents) for cell in item.__closure__ or ())


def named_for(digest: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a copy of a function whose name holds a digest.

    Compiled code is linked by name. Two laws' functions of one name, compiled in two processes and both read from the
    cache by a third, would be taken for each other there.
    """
    copy = FunctionType(
        function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    )
    copy.__qualname__ = f"{function.__qualname__}_{digest[:16]}"
    copy.__module__ = function.__module__
    return copy


def inlined(digest: str, function: Callable[..., Any]) -> Any:
    """Return a function of a law as compiled code can call it, with the functions that it closes over."""
    cells = tuple(
        CellType(inlined(digest, cell.cell_contents)) if inspect.isfunction(cell.cell_contents) else cell
        for cell in function.__closure__ or ()
    )
    own = FunctionType(function.__code__, function.__globals__, function.__name__, function.__defaults__, cells)
    own.__qualname__, own.__module__ = function.__qualname__, function.__module__
    return register_jitable(named_for(digest, own))


def kernel_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile and cache a function that calls compiled ones of other files, under a digest of all of them.

    Numba's own cache notices a change of the function's own file only.
    """
    return law_njit(law_digest("kernels"), **options)


def law_njit(
    digest: str, *, cached: bool = True, inner: bool = False, **options: Any
) -> Callable[[Callable[..., Any]], Any]:
    """Compile as `numba.njit` does, under a name of its own and, unless told otherwise, cached under `digest`.

    An `inner` function is called by compiled code alone, and never from Python: what would take Python's arguments
    apart is not compiled, which for bodies of many arrays is a quarter of all that there is to compile.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        own = named_for(digest, function)
        compiled = njit(no_cfunc_wrapper=True, no_cpython_wrapper=inner, **options)(own)
        if cached:
            compiled._cache = _DigestCache(own, digest)
        return compiled

    return decorate
