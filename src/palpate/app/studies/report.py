"""Reports of the studies: entries of the reduced runs, and the paper's claims next to the results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.common.console import Table, percent
from palpate.app.common.report import deliver, machine
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Study

__all__ = [
    "Claim", "claim_entries", "deliver_study", "finished_runs", "preamble", "reduced_table", "time_per_mode",
]  # fmt: skip

COLUMNS = ("modes", "nodes", "displ.", "velocity", "energy", "force", "proj.", "s", "ratio", "steps", "us/step")

Claim = tuple[str, str, str, bool | None]  # figure, claim of the paper, result here, whether it holds


def preamble(study: Study) -> dict[str, Any]:
    """Return the first entries of a report: scene, parameters, machine and stability."""
    scene = study.scene
    return {
        "title": scene.title,
        "parameters": dict(scene.parameters) | {"duration": scene.duration, "every": scene.every},
        "nodes": len(scene.model.cloud),
        "machine": machine(),
        "stability": asdict(scene.model.stability),
    }


def finished_runs(study: Study, phase: str, series: str = PROJECTED) -> list[dict[str, Any]]:
    """Return the entries of the reduced runs of a series that finished a phase, each with its number of modes."""
    series_entries = [entry for entry in study.reduced if entry["series"] == series]
    entries = [{"modes": entry["modes"]} | entry["phases"][phase] for entry in series_entries]
    return [entry for entry in entries if not entry["failed"]]


def claim_entries(claims: Sequence[Claim]) -> list[dict[str, Any]]:
    """Return the paper's claims, the results here, and whether they hold; None where no run tests a claim."""
    return [dict(zip(("figure", "claim", "here", "holds"), claim, strict=True)) for claim in claims]


def time_per_mode(done: dict[int, dict[str, Any]]) -> tuple[float, float]:
    """Return the slope [s] of a straight line through the computing times over the modes, and how well it fits, R^2."""
    sizes, seconds = np.array(list(done), dtype=float), np.array([entry["wall_seconds"] for entry in done.values()])
    line = np.polynomial.Polynomial.fit(sizes, seconds, 1)
    spread = np.sum((seconds - seconds.mean()) ** 2)
    fit = float(1 - np.sum((seconds - line(sizes)) ** 2) / spread) if spread > 0 else 1.0
    return float(line.convert().coef[-1]), fit


def deliver_study(
    report: dict[str, Any], tables: Sequence[Table], out: Path, files: Sequence[str], as_json: bool
) -> int:
    """Write and print the report of a study next to the paper's claims.

    Parameters
    ----------
    report, tables, out, files, as_json
        As for `palpate.app.common.report.deliver`.

    Returns
    -------
    int
        The exit code: 1 if every reduced run failed.
    """
    claims = {PROJECTED: report["paper"], HYPER_REDUCED: report.get("paper_hyper_reduced")}
    deliver(report, [*tables, _claims_table(claims)], out, files, as_json)
    return 1 if all(entry["failed"] for entry in report["reduced"]) else 0


def reduced_table(title: str, entries: Sequence[dict[str, Any]]) -> Table:
    """Return a table of reduced runs, from their entries in the report."""
    rows = []
    for entry in entries:
        if entry["failed"]:
            rows.append([str(entry["modes"]), "failed", *(["-"] * (len(COLUMNS) - 2))])
            continue
        wrong = [percent(value) for value in (*entry["errors"].values(), entry["projection_error"])]
        time = f"{entry['wall_seconds']:.2f}", f"{entry['ratio']:.2%}", str(entry["steps"])
        step = 1e6 * entry["seconds_per_step"]
        cost = f"{step:.1f}" if step < 100 else f"{step:.0f}"
        rows.append([str(entry["modes"]), str(entry["nodes"]), *wrong, *time, cost])
    return Table(title, COLUMNS, rows, ["right"] * len(COLUMNS), wraps=False)


def _claims_table(series: dict[str, Sequence[dict[str, Any]] | None]) -> Table:
    """Return a table of the claims of the paper, judged for the models of each series that has claims."""
    answers = {True: "yes", False: "no", None: "-"}
    judged = {name: claims for name, claims in series.items() if claims}
    rows = []
    for claims in zip(*judged.values(), strict=True):
        results = [word for claim in claims for word in (claim["here"], answers[claim["holds"]])]
        rows.append([claims[0]["figure"], claims[0]["claim"], *results])
    columns = [word for name in judged for word in (name, "holds")]
    return Table("Claims of the paper", ("figure", "paper", *columns), rows, ["left"] * (2 + len(columns)))
