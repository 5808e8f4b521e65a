"""What a person sees: progress on standard error, results on standard output."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rich.console
from rich.box import SIMPLE_HEAD
from rich.console import JustifyMethod
from rich.table import Table

__all__ = [
    "Console",
    "count_nodes",
    "percent",
    "print_json",
    "print_plain",
    "print_tables",
    "quantities_table",
    "reduced_table",
]


COLUMNS = ("modes", "nodes", "displ.", "velocity", "energy", "force", "proj.", "s", "ratio", "steps", "us/step")


class Console:
    """Lines about the work in progress, on standard error."""

    def __init__(self) -> None:
        self._console = rich.console.Console(stderr=True, highlight=False, markup=False, soft_wrap=True)

    def say(self, text: str) -> None:
        """Print one line."""
        self._console.print(text)

    @contextmanager
    def status(self, text: str) -> Iterator[None]:
        """Show what goes on for as long as it does; where nobody watches, say it once."""
        if self._console.is_terminal:
            with self._console.status(text):
                yield
        else:
            self.say(f"{text} ...")
            yield


def print_json(report: dict[str, Any]) -> None:
    """Print a report on standard output, for machines."""
    json.dump(report, sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def print_tables(tables: Sequence[Table], claims: Sequence[dict[str, Any]], out: Path, files: Sequence[str]) -> None:
    """Print a study's tables, the paper's claims and where the files lie on standard output, for people."""
    print_plain([*tables, _claims_table(claims)], out, files)


def print_plain(tables: Sequence[Any], out: Path, files: Sequence[str]) -> None:
    """Print tables or lines, and where the files lie, if there are any, on standard output."""
    console = rich.console.Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = 100
    for table in tables:
        console.print(table)
    if files:
        console.print(f"In {out}: {', '.join(files)}", soft_wrap=True)


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)


def quantities_table(
    title: str,
    columns: Sequence[str],
    rows: Mapping[str, Sequence[str]],
    first: str = "quantity",
    justify: JustifyMethod = "right",
) -> Table:
    """Return a table of quantities by name, one value or more for each."""
    table = _table(title)
    table.add_column(first)
    for heading in columns:
        table.add_column(heading, justify=justify)
    for name, values in rows.items():
        table.add_row(name, *values)
    return table


def reduced_table(title: str, entries: Sequence[dict[str, Any]]) -> Table:
    """Return a table of reduced runs, from their entries in the report."""
    table = _table(title)
    for heading in COLUMNS:
        table.add_column(heading, justify="right", no_wrap=True)
    for entry in entries:
        if entry["failed"]:
            table.add_row(str(entry["modes"]), "failed", *(["-"] * (len(COLUMNS) - 2)))
            continue
        wrong = [percent(value) for value in (*entry["errors"].values(), entry["projection_error"])]
        time = f"{entry['wall_seconds']:.2f}", f"{entry['ratio']:.2%}", str(entry["steps"])
        step = 1e6 * entry["seconds_per_step"]
        cost = f"{step:.1f}" if step < 100 else f"{step:.0f}"
        table.add_row(str(entry["modes"]), str(entry["nodes"]), *wrong, *time, cost)
    return table


def count_nodes(nodes: int) -> str:
    """Return how many nodes, in words."""
    return f"{nodes} node{'' if nodes == 1 else 's'}"


def percent(value: float) -> str:
    """Return a share in per cent."""
    return f"{value:.2%}" if value < 10 else "> 1000%"


def _claims_table(claims: Sequence[dict[str, Any]]) -> Table:
    table = _table("What the paper says")
    for heading in ("figure", "paper", "here", "holds"):
        table.add_column(heading)
    for claim in claims:
        holds = {True: "yes", False: "no", None: "-"}[claim["holds"]]
        table.add_row(claim["figure"], claim["claim"], claim["here"], holds)
    return table
