"""The report of the beam study."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.app.common.console import percent, quantities_table
from palpate.app.studies.report import Claim, claim_entries, finished_runs, preamble, reduced_table, time_per_mode
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Study
from palpate.arrays import Floats
from palpate.dynamics.run.trajectory import Trajectory
from palpate.files import plain
from palpate.reduction.training.errors import relative_errors

__all__ = ["ENERGY_FORM", "build_report", "tables", "tip_displacement"]


ENERGY_FORM = "energy form"  # another run of the same body, next to the study's strong form
MAX_LATE_DECREASE = 0.1  # share of the whole decrease of the error that may still come after 8 modes
NEARLY_LINEAR = 0.9  # coefficient of determination
MAX_TIME_RATIO = 1.5  # at most this many times the printed ratio of times still is its "almost" or "around"


def build_report(study: Study, singular_values: Floats, pod_seconds: float) -> dict[str, Any]:
    """Return the report of the study: only what JSON can hold, in SI units.

    Parameters
    ----------
    study : Study
    singular_values : (r,) array
        Of the full model's snapshots.
    pod_seconds : float [s]
        Time of their decomposition.
    """
    report = preamble(study) | {
        "full": _full_run(study, study.full),
        "energy_form": _energy_form(study),
        "pod_seconds": pod_seconds,
        "singular_values": singular_values.tolist(),
        "snapshots": len(study.full.times),
        "reduced": [_one_phase(entry) for entry in study.reduced],
        "paper": claim_entries(_claims({entry["modes"]: entry for entry in finished_runs(study, "full")})),
    }
    return {name: plain(value) for name, value in report.items()}


def tip_displacement(study: Study, run: Trajectory) -> Floats:
    """Return the mean axial displacement [m] of the pulled end over a run, shape (f,)."""
    nodes = study.scene.model.cloud.group("x+")
    return np.asarray(run.displacements[:, nodes, 0].mean(axis=1))


def _one_phase(entry: dict[str, Any]) -> dict[str, Any]:
    named = {"series": entry["series"], "modes": entry["modes"]} | entry["phases"]["full"]
    return named if entry["failed"] else named | entry["joined"]


def _energy_form(study: Study) -> dict[str, Any] | None:
    """Return the same of the energy form's run, and how far it is from the strong form's; nothing if it failed."""
    run = study.peers.get(ENERGY_FORM)
    return None if run is None else _full_run(study, run) | {"errors": relative_errors(study.full, run).as_dict()}


def _full_run(study: Study, full: Trajectory) -> dict[str, Any]:
    scene = study.scene
    tip = tip_displacement(study, full)
    peak, middle = int(np.argmax(np.abs(tip))), int(np.argmin(np.abs(full.times - scene.duration / 2)))
    force = scene.loads[0].force  # type: ignore[union-attr]
    return {
        "wall_seconds": full.wall_seconds,
        "real_time_factor": scene.duration / full.wall_seconds,
        "steps": int(full.steps[-1]),
        "stiffness_damping": full.stiffness_damping,
        "peak_tip_displacement": float(tip[peak]),
        "peak_tip_time": float(full.times[peak]),
        "energy_balance": float(np.abs(full.balance).max() / np.abs(full.external).max()),
        "load_at_peak": float(force(full.times[middle])[0]) if callable(force) else math.nan,
        "reaction_at_peak": float(-full.reactions["x-"][middle, 0]),
    }


def tables(report: dict[str, Any]) -> list[Any]:
    """Return the tables for people.

    The first one compares the hyper-reduced models with their own full model, the second one the two forms of
    the full model; those after it compare with the strong form, which the paper reduces.
    """
    runs = {"strong form": report["full"]} | ({ENERGY_FORM: report["energy_form"]} if report["energy_form"] else {})
    full = runs.values()
    rows = {
        "computing time": [f"{run['wall_seconds']:.2f} s" for run in full],
        "simulated time over computing time": [f"{run['real_time_factor']:.3g}" for run in full],
        "time steps": [f"{run['steps']}" for run in full],
        "largest displacement of the pulled end": [f"{1e3 * run['peak_tip_displacement']:.2f} mm" for run in full],
        "support force at the largest load": [
            f"{run['reaction_at_peak']:.4g} N for {run['load_at_peak']:.4g} N" for run in full
        ],
        "energy balance, largest miss over largest work": [f"{run['energy_balance']:.2%}" for run in full],
        "displacement error (34) against the strong form": [
            percent(run["errors"]["displacement"]) if "errors" in run else "-" for run in full
        ],
    }
    title = f"{report['title']}, {report['nodes']} nodes: full model"
    form_tables = []
    if report["energy_form"]:
        title += " in two forms, two discretisations with errors of their own"
        form_tables = [_against_energy_form(report["reduced"])]
    drawn = [*form_tables, quantities_table(title, list(runs), rows)]
    titles = {
        PROJECTED: "Projected models (the paper's)",
        HYPER_REDUCED: "Hyper-reduced models",
    }
    for series, name in titles.items():
        entries = [entry for entry in report["reduced"] if entry["series"] == series]
        drawn.append(reduced_table(f"{name}: errors against the strong form, time over its", entries))
    return drawn


def _against_energy_form(reduced: Sequence[dict[str, Any]]) -> Any:
    done = [entry for entry in reduced if entry["series"] == HYPER_REDUCED and not entry["failed"]]
    rows = {
        f"{entry['modes']} modes": [percent(value) for value in entry["errors_against"][ENERGY_FORM].values()]
        for entry in done
    }
    title = "Hyper-reduced models: errors against their own full model, the energy form"
    return quantities_table(title, ["displ.", "velocity", "energy", "force"], rows)


def _claims(done: dict[int, dict[str, Any]]) -> list[Claim]:
    return [
        _error_at_six(done.get(6)),
        _slight_after_eight(done),
        _linear_time(done),
        _ratio(done.get(2), 2, 0.01, "almost 1 % of the full model's time with 2 modes"),
        _ratio(done.get(8), 8, 0.03, "around 3 % of the full model's time with 8 modes"),
    ]


def _error_at_six(entry: dict[str, Any] | None) -> Claim:
    claim = "displacement error below 3 % with 6 modes"
    if entry is None:
        return "Figure 3", claim, "not run with 6 modes", None
    error = entry["errors"]["displacement"]
    return "Figure 3", claim, f"{error:.3%}", error < 0.03


def _slight_after_eight(done: dict[int, dict[str, Any]]) -> Claim:
    claim = "the error decreases only slightly after 8 modes"
    if 8 not in done or len(done) < 3 or max(done) == 8 or min(done) == 8:
        return "Figure 3", claim, "needs fewer modes, 8, and more", None
    first, eight, last = (done[m]["errors"]["displacement"] for m in (min(done), 8, max(done)))
    here = f"{first:.3%} with {min(done)}, {eight:.3%} with 8, {last:.3%} with {max(done)}"
    return "Figure 3", claim, here, eight - last <= MAX_LATE_DECREASE * (first - last)


def _linear_time(done: dict[int, dict[str, Any]]) -> Claim:
    claim = "the time grows almost linearly with the modes"
    if len(done) < 3:
        return "Figure 4", claim, "needs three sizes", None
    slope, fit = time_per_mode(done)
    return "Figure 4", claim, f"{slope:.3g} s a mode, R^2 = {fit:.3f}", fit > NEARLY_LINEAR and slope > 0


def _ratio(entry: dict[str, Any] | None, size: int, printed: float, claim: str) -> Claim:
    if entry is None:
        return "Figure 5", claim, f"not run with {size} modes", None
    return "Figure 5", claim, f"{entry['ratio']:.2%}", entry["ratio"] <= MAX_TIME_RATIO * printed
