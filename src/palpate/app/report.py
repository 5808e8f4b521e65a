"""What the reports of all studies share: numbers for machines, and the paper's claims beside them."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from palpate import __version__
from palpate.app.console import print_json, print_tables
from palpate.app.study import PROJECTED, Study
from palpate.files import write_json

__all__ = ["Claim", "deliver", "finished", "listed", "machine", "preamble", "time_per_mode"]

PACKAGES = ("numpy", "scipy", "numba", "h5py", "matplotlib", "pyvista", "vtk")

Claim = tuple[str, str, str, bool | None]  # figure, what the paper claims, what was found here, whether it holds


def preamble(study: Study) -> dict[str, Any]:
    """Return how a report begins: what was run, and on what."""
    scene = study.scene
    return {
        "title": scene.title,
        "parameters": dict(scene.parameters) | {"duration": scene.duration, "every": scene.every},
        "nodes": len(scene.model.cloud),
        "machine": machine(),
        "stability": asdict(scene.model.stability),
    }


def machine() -> dict[str, Any]:
    """Return what a run was made with: versions, system, processors and threads."""
    import numba

    versions = {"palpate": __version__, "python": platform.python_version()}
    for package in PACKAGES:
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


def finished(study: Study, phase: str, series: str = PROJECTED) -> list[dict[str, Any]]:
    """Return the entries of the reduced runs of a series that finished a phase, each with its number of modes."""
    own = [entry for entry in study.reduced if entry["series"] == series]
    entries = [{"modes": entry["modes"]} | entry["phases"][phase] for entry in own]
    return [entry for entry in entries if not entry["failed"]]


def listed(claims: Sequence[Claim]) -> list[dict[str, Any]]:
    """Return the paper's claims, what stands against them here, and whether they hold; None where it was not run."""
    return [dict(zip(("figure", "claim", "here", "holds"), claim, strict=True)) for claim in claims]


def time_per_mode(done: dict[int, dict[str, Any]]) -> tuple[float, float]:
    """Return the slope [s] of a straight line through the computing times over the modes, and how well it fits, R^2."""
    sizes, seconds = np.array(list(done), dtype=float), np.array([entry["wall_seconds"] for entry in done.values()])
    line = np.polynomial.Polynomial.fit(sizes, seconds, 1)
    spread = np.sum((seconds - seconds.mean()) ** 2)
    fit = float(1 - np.sum((seconds - line(sizes)) ** 2) / spread) if spread > 0 else 1.0
    return float(line.convert().coef[-1]), fit


def deliver(report: dict[str, Any], tables: Sequence[Any], out: Path, files: Sequence[str], as_json: bool) -> int:
    """Write and print a report, and return the exit code: 1 if every reduced run failed.

    Parameters
    ----------
    report : dict
    tables : sequence of Table
        For people, beside the paper's claims.
    out : path
        Folder.
    files : sequence of str
        What may lie there.
    as_json : bool
        Print the report as JSON instead of tables.
    """
    write_json(out / "report.json", report)
    if as_json:
        print_json(report)
    else:
        print_tables(tables, report["paper"], out, [name for name in files if (out / name).is_file()])
    return 1 if all(entry["failed"] for entry in report["reduced"]) else 0
