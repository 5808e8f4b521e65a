"""What a person sees: progress on standard error, results on standard output."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rich.console
from rich.box import SIMPLE_HEAD
from rich.table import Table

__all__ = ["Console", "print_results"]


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


def print_results(report: dict[str, Any], out: Path, files: Sequence[str], as_json: bool) -> None:
    """Print the report on standard output, as JSON for machines or as tables for people."""
    if as_json:
        json.dump(report, sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
        return
    console = rich.console.Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = 100
    console.print(_full_table(report))
    console.print(_reduced_table(report))
    console.print(_claims_table(report))
    console.print(f"In {out}: {', '.join(files)}", soft_wrap=True)


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)


def _full_table(report: dict[str, Any]) -> Table:
    full, table = report["full"], _table(f"{report['title']}, {report['nodes']} nodes: full model")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    rows = {
        "computing time": f"{full['wall_seconds']:.2f} s",
        "simulated time over computing time": f"{full['real_time_factor']:.3g}",
        "time steps": f"{full['steps']}",
        "largest displacement of the pulled end": f"{1e3 * full['peak_tip_displacement']:.2f} mm",
        "support force at the largest load": f"{full['reaction_at_peak']:.4g} N for {full['load_at_peak']:.4g} N",
        "energy balance, largest miss over largest work": f"{full['energy_balance']:.2%}",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _reduced_table(report: dict[str, Any]) -> Table:
    table = _table("Reduced models: errors, and time over the full model's")
    for heading in ("modes", "displ.", "velocity", "energy", "force", "proj.", "time", "ratio", "steps"):
        table.add_column(heading, justify="right", no_wrap=True)
    for entry in report["reduced"]:
        if entry["failed"]:
            table.add_row(str(entry["modes"]), *(["failed"] + 7 * ["-"]))
            continue
        wrong = [f"{value:.2%}" for value in (*entry["errors"].values(), entry["projection_error"])]
        time = f"{entry['wall_seconds']:.2f} s", f"{entry['ratio']:.1%}", str(entry["steps"])
        table.add_row(str(entry["modes"]), *wrong, *time)
    return table


def _claims_table(report: dict[str, Any]) -> Table:
    table = _table("What the paper says")
    for heading in ("figure", "paper", "here", "holds"):
        table.add_column(heading)
    for claim in report["paper"]:
        holds = {True: "yes", False: "no", None: "-"}[claim["holds"]]
        table.add_row(claim["figure"], claim["claim"], claim["here"], holds)
    return table
