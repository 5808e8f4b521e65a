"""Compilation in a second process, while this one does other work.

Both processes read what the other has kept in the cache of compiled functions.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from threading import get_ident
from typing import Any

from numba.core import event

from palpate.core.processes import Child, Function


@contextlib.contextmanager
def second_process(function: Function, request: Any) -> Iterator[Child | None]:
    """Call a function in another process within a context; yield None in place of it on a single processor."""
    if _processors() < 2:
        yield None
        return
    child = Child(function, request)
    try:
        yield child
    finally:
        child.stop()


@contextlib.contextmanager
def compile_ahead(function: Function, request: Any) -> Iterator[Callable[[], object]]:
    """Call a function that compiles in another process within a context, if there is a second processor.

    Yields a function that waits until that process has answered, or ended. What it has not compiled is compiled when it
    is called.
    """
    with second_process(function, request) as child:
        yield lambda: None if child is None else next(child.answers(), None)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class CompiledFunctions(event.Listener):  # type: ignore[misc]
    """Counts the functions that Numba compiles in this process."""

    def __init__(self) -> None:
        self.count = 0
        event.register("numba:compile", self)

    def on_start(self, event: Any) -> None:
        """Do nothing."""

    def on_end(self, event: Any) -> None:
        """Count a function."""
        self.count += 1

    def close(self) -> None:
        """Stop counting."""
        with contextlib.suppress(ValueError):  # of an earlier call
            event.unregister("numba:compile", self)


class _NotCompiledError(Exception):
    """A function that is called is not compiled yet."""


class _Refusal(event.Listener):  # type: ignore[misc]
    """Raises an error where Numba begins to compile in the thread that made it; Numba reports those of all threads."""

    def __init__(self) -> None:
        self._thread = get_ident()

    def on_start(self, event: Any) -> None:
        if get_ident() == self._thread:
            raise _NotCompiledError

    def on_end(self, event: Any) -> None:
        """Do nothing."""


@contextlib.contextmanager
def only_compiled_code() -> Iterator[None]:
    """Leave the block where it calls a function that would have to be compiled first; other threads compile."""
    with contextlib.suppress(_NotCompiledError), event.install_listener("numba:compile", _Refusal()):
        yield
