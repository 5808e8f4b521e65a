"""The report of the beam study."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from palpate.app.common.console import quantities_table
from palpate.app.studies.report import Claim, claim_entries, finished_runs, preamble, reduced_table, time_per_mode
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Study
from palpate.arrays import Floats
from palpate.dynamics.run.trajectory import Trajectory
from palpate.files import plain
from palpate.reduction.training.errors import relative_errors

__all__ = ["build_report", "difference_of_forms", "tables", "tip_displacement"]


BACK_AT_REST = 0.9  # share of the run after which the load is small and the beam swings about rest
MIN_GROWTH = 1.5  # of the difference of the two forms after that, which is then one of phase
MIN_SHARE_LEFT = 0.5  # of the error with 8 modes; with less than that left, the decrease is not slight
NEARLY_LINEAR = 0.9  # coefficient of determination
MAX_TIME_RATIO = 1.5  # at most this many times the printed ratio of times still is its "almost" or "around"


def build_report(strong: Study, energy: Study | None, singular_values: Floats, pod_seconds: float) -> dict[str, Any]:
    """Return the report of the study: only what JSON can hold, in SI units.

    Parameters
    ----------
    strong : Study
        Of the strong form, with the paper's projected models.
    energy : Study, optional
        Of the energy form, with the hyper-reduced models; None if its full run diverged.
    singular_values : (r,) array
        Of the snapshots of the strong form.
    pod_seconds : float [s]
        Time of their decomposition.
    """
    reduced = [_one_phase(study, entry) for study in (strong, energy) if study for entry in study.reduced]
    projected = _by_modes(strong, PROJECTED)
    report = preamble(strong) | {
        "full": _full_run(strong),
        "energy_form": energy and _full_run(energy),
        "forms": energy and _distances(strong, energy),
        "pod_seconds": pod_seconds,
        "singular_values": singular_values.tolist(),
        "snapshots": len(strong.full.times),
        "reduced": reduced,
        "paper": claim_entries(_claims(projected)),
        "paper_hyper_reduced": energy and claim_entries(_claims(_by_modes(energy, HYPER_REDUCED))),
    }
    return {name: plain(value) for name, value in report.items()}


def _by_modes(study: Study, series: str) -> dict[int, dict[str, Any]]:
    """Return the entries of the finished runs of a series by their number of modes."""
    return {entry["modes"]: entry for entry in finished_runs(study, study.phases[0].name, series)}


def tip_displacement(study: Study, run: Trajectory) -> Floats:
    """Return the mean axial displacement [m] of the pulled end over a run, shape (f,)."""
    nodes = study.scene.model.cloud.group("x+")
    return np.asarray(run.displacements[:, nodes, 0].mean(axis=1))


def difference_of_forms(strong: Study, energy: Study) -> str:
    """Return the sentence on the distance of the two full runs, with its reason."""
    return _sentence(_distances(strong, energy))


def _distances(strong: Study, energy: Study) -> dict[str, Any]:
    """Return the errors of the energy form's run against the strong form's, and (34) until the beam is back at rest."""
    full, until = strong.full, BACK_AT_REST * strong.scene.duration
    apart, size = (
        np.linalg.norm(field, axis=2).sum(axis=1)
        for field in (energy.full.displacements - full.displacements, full.displacements)
    )
    early = (size > 0) & (full.times <= until)
    return {
        "errors": relative_errors(full, energy.full).as_dict(),
        "until": until,
        "displacement_until": float(np.mean(apart[early] / size[early])),
    }


def _sentence(forms: dict[str, Any]) -> str:
    error, early = forms["errors"]["displacement"], forms["displacement_until"]
    sentence = (
        f"The two full models differ by {error:.1%} in displacement (34), by {early:.1%} until {forms['until']:g} s"
    )
    if error < MIN_GROWTH * early:
        return sentence
    return f"{sentence}: afterwards the beam swings about rest, and the swings of the two differ in phase"


def _one_phase(study: Study, entry: dict[str, Any]) -> dict[str, Any]:
    named = {"series": entry["series"], "modes": entry["modes"]} | entry["phases"][study.phases[0].name]
    return named if entry["failed"] else named | entry["joined"]


def _full_run(study: Study) -> dict[str, Any]:
    scene, full = study.scene, study.full
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
    """Return tables and sentences for people: full models, their difference, and each series against its full model."""
    runs = {"strong form": report["full"]} | ({"energy form": report["energy_form"]} if report["energy_form"] else {})
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
    }
    title = f"{report['title']}, {report['nodes']} nodes: full model"
    drawn: list[Any] = [quantities_table(title, list(runs), rows)]
    if report["forms"]:
        drawn.append(_sentence(report["forms"]))
    titles = {
        PROJECTED: "Projected models (the paper's): errors and time against the strong form",
        HYPER_REDUCED: "Hyper-reduced models: errors and time against the energy form",
    }
    for series, title in titles.items():
        entries = [entry for entry in report["reduced"] if entry["series"] == series]
        drawn += [reduced_table(title, entries)] if entries else []
    return drawn


def _claims(done: dict[int, dict[str, Any]]) -> list[Claim]:
    return [
        _error_at_six(done.get(6)),
        slight_decrease_after_eight(done),
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


def slight_decrease_after_eight(done: dict[int, dict[str, Any]]) -> Claim:
    claim = f"the error decreases only slightly after 8 modes (read: at least {MIN_SHARE_LEFT:.0%} of it is left)"
    if 8 not in done or max(done) == 8:
        return "Figure 3", claim, "needs 8 modes, and more", None
    eight, last = (done[modes]["errors"]["displacement"] for modes in (8, max(done)))
    return "Figure 3", claim, f"{eight:.3%} with 8, {last:.3%} with {max(done)}", last >= MIN_SHARE_LEFT * eight


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
