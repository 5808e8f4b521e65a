"""Reports: numbers for machines, tables for people, in a folder and on standard output."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from palpate import __version__
from palpate.app.common.console import Table, print_json, print_plain
from palpate.core.files import whole_file, write_json

REPORTED_PACKAGES = ("numpy", "scipy", "numba", "h5py", "matplotlib", "pyvista", "vtk")
REPORTS = ("report.json", "report.md")  # that every study leaves


def deliver(
    report: dict[str, Any],
    tables: Sequence[Table | str],
    out: Path,
    files: Sequence[str],
    as_json: bool,
    *,
    written: Sequence[Table | str] | None = None,
) -> None:
    """Write a report into a folder as ``report.json`` and ``report.md``, and print it.

    `report` holds only what JSON can, with ``"title"``, and ``"machine"`` as `machine` returns it. `tables` are
    printed; `written` takes their place in ``report.md``. `files` are those that the command may have left in the
    folder, in the order of the list.
    """
    write_json(out / "report.json", report)
    pictures = [name for name in files if name.endswith(".png") and (out / name).is_file()]
    with whole_file(out / "report.md") as partial:
        partial.write_text(_markdown(report, tables if written is None else written, pictures), encoding="utf-8")
    if as_json:
        print_json(report)
    else:
        print_plain(tables, out, [name for name in files if (out / name).exists()])


def _markdown(report: dict[str, Any], blocks: Sequence[Table | str], pictures: Sequence[str]) -> str:
    """Return a report as Markdown: tables under their titles, sentences as lists, pictures, and the machine."""
    lines, listing = [f"# {report['title']}", ""], False
    for block in blocks:
        if listing and isinstance(block, Table):
            lines.append("")
        listing = isinstance(block, str)
        lines += [f"- {block}"] if isinstance(block, str) else _table_lines(block, report["title"])
    lines += [""] * listing
    for name in pictures:
        lines += [f"![{Path(name).stem.replace('_', ' ')}]({name})", ""]
    made = report["machine"]
    versions = ", ".join(f"{name} {made['versions'][name]}" for name in ("palpate", "python", "numpy", "numba"))
    lines.append(
        f"Made with {versions} on {made['system']}, {made['cpu_count']} processors, {made['threads']} threads."
    )
    lines.append("All figures are in report.json, in SI units.")
    return "\n".join(lines) + "\n"


def _table_lines(table: Table, title: str) -> list[str]:
    rules = ["---:" if justify == "right" else "---" for justify in table.justify]
    rows = [[cell.replace("|", "\\|") for cell in row] for row in (table.columns, *table.rows)]
    heading = [] if table.title == title else [f"## {table.title}", ""]
    head, *body = (f"| {' | '.join(row)} |" for row in rows)
    return [*heading, head, f"|{'|'.join(rules)}|", *body, ""]


def machine() -> dict[str, Any]:
    """Return versions, system, processors and threads of this process."""
    import numba

    versions = {"palpate": __version__, "python": platform.python_version()}
    for package in REPORTED_PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "versions": versions,
        "system": f"{platform.system()} {platform.machine()}",
        "cpu_count": os.cpu_count(),
        "threads": numba.get_num_threads(),
    }
