"""The cache of compiled functions on disk.

The key of Numba's cache contains the closure of a function, and a closure over other compiled
functions never compares equal in a new process. Numba does not detect a change of an inlined function
either. Here the key is a digest of the law and of the sources that a kernel uses: its own module, and
the imported modules of compiled functions.
"""

from __future__ import annotations

import hashlib
import inspect
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import CellType, FunctionType
from typing import Any

import numba
from numba import njit
from numba.core.caching import IndexDataCacheFile
from numba.extending import register_jitable

from palpate.code_cache import SERIAL_KEY, SafeCache, enable_cache, loop_options

__all__ = ["inline", "kernel_njit", "kernel_sources", "law_digest", "law_njit", "rename_for"]


class KeyedFile(IndexDataCacheFile):  # type: ignore[misc]
    """Compiled code on disk, one file per key, without an index.

    Numba numbers these files and lists them in an index. Two processes that save at once can lose an
    entry, or use one number for two signatures, and running the code of another signature crashes.
    """

    def save(self, key: Any, data: Any) -> None:
        """Save compiled code under a key."""
        self._save_data(self._name(key), (key, data))

    def load(self, key: Any) -> Any:
        """Return the compiled code of a key; None where there is none."""
        try:
            saved, data = self._load_data(self._name(key))
        except FileNotFoundError:
            return None
        return data if saved == key else None

    def _name(self, key: Any) -> str:
        return f"{self._index_name.removesuffix('.nbi')}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"


class _DigestCache(SafeCache):
    def __init__(self, function: Callable[..., Any], digest: str) -> None:
        super().__init__(function)
        self._digest = digest
        self._cache_file = KeyedFile(self._cache_path, self._impl.filename_base, None)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load compiled code, after the start of Numba's threads.

        Numba starts them when it loads a function that was compiled together with a parallel loop. It
        does not do so for a function compiled when its parallel callees came from the cache, and calling
        that one crashes.
        """
        numba.get_num_threads()
        return super().load_overload(sig, target_context)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (sig, codegen.magic_tuple(), numba.__version__, self._digest, *SERIAL_KEY)


IMPORT_PATTERN = re.compile(r"^from (palpate\.[\w.]+) import (\([^)]*\)|[^\n(]+)", re.MULTILINE)
PLAIN_TYPES = (bool, int, float, str, tuple)  # types of constants in compiled code


@cache
def _source(module: str) -> str:
    """Return the text of a loaded module; empty for one without a file, such as a notebook."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file).read_text(encoding="utf-8") if file and file.endswith(".py") else ""


@cache
def kernel_sources(module: str) -> dict[str, str]:
    """Return the sources on which the compiled functions of a module depend.

    Imports of modules with compiled functions are followed recursively. Of other modules of palpate only
    the values of imported constants are included.

    Parameters
    ----------
    module : str
        Name of a loaded module.

    Returns
    -------
    dict of str to str
        Text by the name of a module, or value by ``module:constant``.
    """
    sources: dict[str, str] = {}
    remaining = [module]
    while remaining:
        name = remaining.pop()
        if name in sources:
            continue
        sources[name] = _source(name)
        for imported, names in IMPORT_PATTERN.findall(sources[name]):
            if _compiles(imported):
                remaining.append(imported)
                continue
            for word in re.findall(r"\w+", re.sub(r" as \w+|#.*", "", names)):
                value = getattr(sys.modules.get(imported), word, None)
                if isinstance(value, PLAIN_TYPES):
                    sources[f"{imported}:{word}"] = repr(value)
    return sources


def _compiles(module: str) -> bool:
    """Return True for a module with compiled functions."""
    text = _source(module)
    return any(word in text for word in ("from numba", "palpate.dynamics.compiled", "palpate.code_cache"))


@cache
def _sources_digest(module: str) -> bytes:
    return repr(sorted(kernel_sources(module).items())).encode()


def law_digest(module: str, *what: object) -> str:
    """Return the digest of a module's kernels, of functions (by their sources) and of other values (by their repr).

    Parameters
    ----------
    module : str
        ``__name__`` of the caller, whose source and imported compiled functions are included.
    *what : object
        Functions of a law, flags and further digests.
    """
    digest = hashlib.sha256(_sources_digest(module))
    for item in what:
        digest.update(_text(item).encode())
    return digest.hexdigest()


def _text(item: object) -> str:
    """Return the sources of a function and of all functions that it uses, or the repr of another value."""
    if not inspect.isfunction(item):
        return repr(item)
    sources: dict[object, str] = {}
    remaining: list[object] = [item]
    while remaining:
        value = remaining.pop()
        if not inspect.isfunction(value):
            sources[repr(value)] = ""
        elif value not in sources:
            sources[value] = inspect.getsource(value)
            remaining += [cell.cell_contents for cell in value.__closure__ or ()]
            used = [value.__globals__.get(name) for name in value.__code__.co_names]
            used = [getattr(other, "py_func", other) for other in used]
            remaining += [other for other in used if isinstance(other, PLAIN_TYPES) or inspect.isfunction(other)]
    return "".join(text or str(value) for value, text in sources.items())


def rename_for(digest: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a copy of a function with a digest in its name.

    Compiled code is linked by name. Functions of two laws with one name, compiled in two processes and
    read from the cache by a third, would be confused there.
    """
    copy = FunctionType(
        function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    )
    copy.__qualname__ = f"{function.__qualname__}_{digest[:16]}"
    copy.__module__ = function.__module__
    return copy


def inline(digest: str, function: Callable[..., Any]) -> Any:
    """Return a function of a law for calls from compiled code, with the functions in its closure."""
    cells = tuple(
        CellType(inline(digest, cell.cell_contents)) if inspect.isfunction(cell.cell_contents) else cell
        for cell in function.__closure__ or ()
    )
    copied = FunctionType(function.__code__, function.__globals__, function.__name__, function.__defaults__, cells)
    copied.__qualname__, copied.__module__ = function.__qualname__, function.__module__
    return register_jitable(error_model="numpy")(rename_for(digest, copied))


def kernel_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile and cache a function under a digest of its module and of the imported compiled functions.

    Numba's own cache detects a change of the function's own file only.

    Parameters
    ----------
    **options : Any
        See `law_njit`.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        return law_njit(law_digest(function.__module__), **options)(function)

    return decorate


def law_njit(
    digest: str, *, cached: bool = True, inner: bool = False, allocates: bool = False, **options: Any
) -> Callable[[Callable[..., Any]], Any]:
    """Compile with `numba.njit` under a unique name, by default cached under a digest.

    Kernels call others with the index of a parallel loop as ``np.int64``: as it is, unsigned in one of the
    two passes over the loop, it would compile them twice.

    Parameters
    ----------
    digest : str
        Digest of all sources except the function's own module (`law_digest`).
    cached : bool
        True stores the compiled code on disk.
    inner : bool
        True for a function that only compiled code calls. The wrapper for calls from Python is not
        compiled, which saves a quarter of the compilation for bodies of many arrays.
    allocates : bool
        True for a function that allocates arrays. Others are compiled without the reference counts of
        arrays, a quarter of the time of a reduced period; one that does allocate fails to compile.
    **options : Any
        Options of `numba.njit`.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        renamed = rename_for(digest, function)
        compiled = njit(no_cfunc_wrapper=True, no_cpython_wrapper=inner, _nrt=allocates, **loop_options(options))(
            renamed
        )
        if cached:
            full_digest = law_digest(function.__module__, digest)
            enable_cache(compiled, lambda: _DigestCache(renamed, full_digest))
        return compiled

    return decorate
