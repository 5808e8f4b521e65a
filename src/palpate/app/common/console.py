"""Terminal: progress on standard error, results on standard output."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import rich.table
from rich.box import SIMPLE_HEAD

from palpate.app.common.exit_status import RunError
from palpate.dynamics.run.progress import make_console


@dataclass(frozen=True)
class Table:
    """Rows of text under headings, for a terminal and for a report."""

    title: str
    columns: Sequence[str]  # headings
    rows: Sequence[Sequence[str]]  # as long as `columns`
    justify: Sequence[Literal["left", "right"]]  # for every column
    wraps: bool = True  # whether a terminal may break the lines of a cell


class Console:
    """Lines about the work in progress, on standard error.

    `on_phase` is called with the text of every phase when it begins. `on_progress` is called with the share of it that
    is done, from 0 to 1, and a text about it. A `quiet` one prints nothing.
    """

    def __init__(
        self,
        on_phase: Callable[[str], None] | None = None,
        on_progress: Callable[[float, str], None] | None = None,
        quiet: bool = False,
    ) -> None:
        self._console = make_console(stderr=True, highlight=False, markup=False, soft_wrap=True, quiet=quiet)
        self._on_phase, self._on_progress = on_phase, on_progress

    def say(self, text: str) -> None:
        """Print one line."""
        self._console.print(text)

    def begin_phase(self, text: str) -> None:
        """Report that a phase of the work begins, without a line."""
        if self._on_phase is not None:
            self._on_phase(text)

    def report_progress(self, share: float, text: str) -> None:
        """Report the share of a phase that is done, without a line."""
        if self._on_progress is not None:
            self._on_progress(share, text)

    def confirm(self, question: str) -> None:
        """Ask whether to go on, and raise `RunError` for a no; a script, which has no terminal, is not asked."""
        if not (self._console.is_terminal and _reads_terminal()):
            return
        while True:
            self._console.print(f"{question} [Y/n] ", end="")
            answer = sys.stdin.readline()
            if answer.strip().lower() in ("n", "no") or not answer:  # the end of the input, too
                raise RunError("stopped before it began; nothing was changed")
            if answer.strip().lower() in ("", "y", "yes"):
                return

    @contextmanager
    def status(self, text: str) -> Iterator[None]:
        """Begin a phase and show its line during the block; print it once if the output is not a terminal."""
        self.begin_phase(text)
        if self._console.is_terminal:
            with self._console.status(text):
                yield
        else:
            self.say(f"{text} ...")
            yield


def _reads_terminal() -> bool:
    """Return True if standard input is a terminal that this process may read: one in the background would stop."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    try:
        return not hasattr(os, "tcgetpgrp") or os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # a terminal that controls no processes stops none
        return True


def print_json(report: dict[str, Any]) -> None:
    """Print a report on standard output, for machines."""
    json.dump(report, sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def print_plain(tables: Sequence[Any], out: Path, files: Sequence[str]) -> None:
    """Print tables or lines, and the folder of the files if there are any, on standard output."""
    console = make_console(stderr=False, highlight=False, markup=False)
    if not console.is_terminal:
        console.width = 100
    for table in tables:
        console.print(_printable(table) if isinstance(table, Table) else table)
    if files:
        console.print(f"In {out}: {', '.join(files)}", soft_wrap=True)


def quantities_table(
    title: str,
    columns: Sequence[str],
    rows: Mapping[str, Sequence[str]],
    first: str = "quantity",
    justify: Literal["left", "right"] = "right",
) -> Table:
    """Return a table of quantities by name, with one or more values for each."""
    lines = [(name, *values) for name, values in rows.items()]
    return Table(title, (first, *columns), lines, ("left", *[justify] * len(columns)))


def _printable(table: Table) -> rich.table.Table:
    shown = rich.table.Table(title=table.title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    for heading, justify in zip(table.columns, table.justify, strict=True):
        shown.add_column(heading, justify=justify, no_wrap=not table.wraps)
    for row in table.rows:
        shown.add_row(*row)
    return shown


def count_nodes(nodes: int) -> str:
    """Return a number of nodes as text."""
    return f"{nodes} node{'' if nodes == 1 else 's'}"


def duration_text(seconds: float) -> str:
    """Return a duration as text, such as ``40 s`` or ``3 min``."""
    return f"{max(seconds, 1.0):.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def percent(value: float) -> str:
    """Return a share in per cent."""
    return f"{value:.2%}" if value < 10 else "> 1000%"
