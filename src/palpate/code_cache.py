"""The cache of compiled functions, which may be missing, read-only, full or damaged.

Numba raises an error where it finds no folder to write. Here such a function is compiled at every
start, and one warning gives the reason. Folders that others can write are not used, because their
content is run.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator

from palpate.threads import loops_share_threads
from palpate.working_folder import foreign_writer, make_private

__all__ = ["SERIAL_KEY", "SafeCache", "cached_njit", "enable_cache", "loop_options"]


def loop_options(options: dict[str, Any]) -> dict[str, Any]:
    """Return options of `numba.njit`, without ``parallel`` where several threads cannot run parallel loops at once."""
    return options if loops_share_threads() else {**options, "parallel": False}


class _Reasons:
    """Reasons why functions are not cached, each warned of once."""

    def __init__(self) -> None:
        self.found: list[str] = []
        self._warned = False

    def warn(self, reason: str) -> None:
        if not self._warned:
            self._warned = True
            message = f"compiled code is not kept, so every start compiles it again: {reason}"
            warnings.warn(f"{message}; set NUMBA_CACHE_DIR to a folder of yours", RuntimeWarning, stacklevel=4)


REASONS = _Reasons()
SERIAL_KEY = () if loops_share_threads() else ("serial",)  # of code that was compiled without parallel loops


def _checked(locator: Any) -> Any:
    """Return a class of Numba's that locates a cache, limited to folders that only their owner can write."""

    class Checked(locator):  # type: ignore[misc]
        def ensure_cache_path(self) -> None:
            """Create the folder and check who can write it; an OSError lets Numba try the next one."""
            folder = self.get_cache_path()
            make_private(folder)
            if why := foreign_writer(folder):
                REASONS.found.append(why)
                raise OSError(why)
            super().ensure_cache_path()

        @classmethod
        def from_function(cls, function: Callable[..., Any], file: str) -> Any:
            locator_of_file = super().from_function(function, file)
            try:
                if locator_of_file is not None:  # not every class of Numba checks it
                    locator_of_file.ensure_cache_path()
            except OSError:
                return None
            return locator_of_file

    return Checked


# who can write next to the sources can change these, too
CACHE_LOCATORS = [
    each if each is InTreeCacheLocator else _checked(each) for each in CompileResultCacheImpl._locator_classes
]


class _SafeImpl(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = CACHE_LOCATORS


class SafeCache(FunctionCache):  # type: ignore[misc]
    """Compiled code on disk. Damaged code counts as missing, and a full disk stops no program."""

    _impl_class = _SafeImpl

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (*super()._index_key(sig, codegen), *SERIAL_KEY)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return compiled code; None where there is none, or a power cut has damaged it."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a damaged pickle raises errors of any type; the code is compiled and saved again
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save compiled code if the folder takes it."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            REASONS.warn(f"{self.cache_path}: {error.strerror or error}")
        except Exception:
            self.flush()  # a damaged index
            super().save_overload(sig, data)


def enable_cache(compiled: Any, make: Callable[[], SafeCache]) -> None:
    """Let a compiled function use a cache, if there is a folder for it."""
    try:
        compiled._cache = make()
    except RuntimeError:  # Numba found no folder
        REASONS.warn(REASONS.found[-1] if REASONS.found else "neither the installation nor the cache can be written")


def cached_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function that calls no other module's compiled functions, and cache it.

    Parameters
    ----------
    **options : Any
        Options of `numba.njit`.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        compiled = njit(**loop_options(options))(function)
        enable_cache(compiled, lambda: SafeCache(function))
        return compiled

    return decorate
