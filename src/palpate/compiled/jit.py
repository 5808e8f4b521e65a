"""Compiled functions of kernels and laws, kept on disk under a digest of all code that they use."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache
from types import CellType, FunctionType
from typing import Any

from numba import njit, types
from numba.extending import register_jitable

from palpate.compiled.code_cache import CALLER_OPTIONS, enable_cache, own_options
from palpate.compiled.code_digest import law_digest

__all__ = ["inline", "kernel_njit", "law_digest", "law_njit", "rename_for"]


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


@cache
def _maker_digest() -> str:
    """Return the digest of the functions whose code decides how a function is compiled."""
    return law_digest("", inline, rename_for, own_options, _ignore_literals, law_njit, sorted(CALLER_OPTIONS.items()))


def kernel_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile and cache a function under a digest of its module and of the imported compiled functions.

    Numba's own cache detects a change of the function's own file only. The options are those of `law_njit`.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        return law_njit(law_digest(function.__module__), **options)(function)

    return decorate


def _ignore_literals(compiled: Any) -> None:
    """Let all integers share the version of a signature; Numba compiles one for each literal integer in a call."""
    template = compiled.get_call_template

    def get_call_template(args: Any, kws: Any) -> Any:
        return template(tuple(map(_plain_type, args)), {name: _plain_type(kind) for name, kind in kws.items()})

    compiled.get_call_template = get_call_template


def _plain_type(kind: Any) -> Any:
    return kind.literal_type if isinstance(kind, types.IntegerLiteral) else kind


def law_njit(
    digest: str, *, cached: bool = True, inner: bool = False, allocates: bool = False, **options: Any
) -> Callable[[Callable[..., Any]], Any]:
    """Compile with `numba.njit` and its options under a unique name, by default cached on disk under a digest.

    The digest is that of all sources except the function's own module (`law_digest`).

    An `inner` function is one that only compiled code calls. The wrapper for calls from Python is not compiled, which
    saves a quarter of the compilation for bodies of many arrays. `allocates` must be True for a function that allocates
    arrays. Others are compiled without the reference counts of arrays, a quarter of the time of a reduced period; one
    that does allocate fails to compile.

    Kernels call others with the index of a parallel loop as ``np.int64``: as it is, unsigned in one of the two passes
    over the loop, it would compile them twice.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        renamed = rename_for(digest, function)
        given = own_options({"_nrt": allocates, **options})
        compiled = njit(no_cfunc_wrapper=True, no_cpython_wrapper=inner, **given)(renamed)
        _ignore_literals(compiled)
        if cached:
            chosen = _maker_digest(), inner, allocates, sorted(options.items())
            enable_cache(compiled, renamed, law_digest(function.__module__, digest, *chosen))
        return compiled

    return decorate
