"""A progress bar with the real-time factor, on an interactive standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


def make_console(*, stderr: bool, **options: Any) -> Console:
    """Return a console that is a terminal only if its stream is one.

    Notebooks and build servers set ``FORCE_COLOR``, by which rich animates what a file or a page receives.
    """
    stream = sys.stderr if stderr else sys.stdout
    interactive = stream is not None and stream.isatty()
    return Console(stderr=stderr, force_terminal=None if interactive else False, **options)


@contextmanager
def progress_bar(label: str, duration: float, shown: bool) -> Iterator[Callable[[float, float], None]]:
    """Yield a function that takes the simulated and the wall time [s]."""
    console = make_console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.2f} / {task.total:g} s"),
        TextColumn("x{task.fields[factor]:.3g} real time"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not (shown and console.is_terminal)) as bar:
        task = bar.add_task(label, total=duration, factor=0.0)
        yield lambda time, wall: bar.update(task, completed=time, factor=time / max(wall, 1e-9))
