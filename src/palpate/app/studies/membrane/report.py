"""The report of the membrane study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.console import quantities_table
from palpate.app.studies.report import Claim, claim_entries, finished_runs, preamble, reduced_table, time_per_mode
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Study
from palpate.arrays import Floats
from palpate.dynamics.run.trajectory import Trajectory
from palpate.files import plain

__all__ = ["build_report", "tables"]

States = NDArray[np.int8]

# How the paper's words of Figures 7 and 8 are read; it prints no numbers
HIGH_ERROR, SMALL_ERROR = 0.1, 0.03  # displacement error
MAX_REMAINING_ERROR = 0.2  # at most this share of the error with 2 modes is left with 8
MAX_ERROR_CHANGE = 0.01  # change of the displacement error
MAX_TIME_SHARE = 0.1  # of the full model's


def build_report(
    study: Study,
    states: States,
    singular_values: Mapping[str, Floats],
    pod_seconds: float,
    choices: Mapping[str, str],
) -> dict[str, Any]:
    """Return the report of the study: only what JSON can hold, in SI units.

    Parameters
    ----------
    states : (f, n) array
        Of `palpate.Membrane.tension` at the times of the full run.
    singular_values : mapping of str to (r,) arrays
        Of the snapshots behind the modes of every phase.
    pod_seconds : float [s]
        Time of their decomposition.
    choices : mapping of str to str
        Parameters that are not numbers.
    """
    report = preamble(study)
    report["parameters"] |= choices
    where = np.cumsum([0, *(len(part.times) - 1 for part in study.parts)])
    report |= {
        "full": {
            phase.name: _full_run(study, part, states[begin : begin + len(part.times)])
            for phase, part, begin in zip(study.phases, study.parts, where, strict=False)
        },
        "pod_seconds": pod_seconds,
        "singular_values": {name: values.tolist() for name, values in singular_values.items()},
        "snapshots": {phase.name: len(part.times) for phase, part in zip(study.phases, study.parts, strict=True)},
        "reduced": study.reduced,
        "paper": claim_entries(_claims({entry["modes"]: entry for entry in finished_runs(study, "push")})),
    }
    return {name: plain(value) for name, value in report.items()}


def _full_run(study: Study, run: Trajectory, states: States) -> dict[str, Any]:
    cloud = study.scene.model.cloud
    force, deflection = run.reactions["tool"], run.displacements[-1, :, 2]
    size = np.linalg.norm(force, axis=1)
    wrinkled = (states == 1) @ cloud.volumes
    peak, widest = int(np.argmax(size)), int(np.argmax(wrinkled))
    energy = max(np.abs(run.external).max(), (run.kinetic + run.strain).max())
    return {
        "wall_seconds": run.wall_seconds,
        "real_time_factor": float(run.times[-1] - run.times[0]) / run.wall_seconds,
        "steps": int(run.steps[-1]),
        "stiffness_damping": run.stiffness_damping,
        "end_time": float(run.times[-1]),
        "tool_force_at_end": float(force[-1, 2]),
        "centre_deflection_at_end": float(deflection[cloud.group("centre")[0]]),
        "mean_deflection_at_end": float(deflection @ cloud.volumes / cloud.volumes.sum()),
        "peak_tool_force": float(size[peak]),
        "peak_tool_force_time": float(run.times[peak]),
        "energy_balance": float(np.abs(run.balance).max() / energy),
        "energy_balance_after_first_snapshot": float(np.abs(run.balance[1:] - run.balance[1]).max() / energy),
        "largest_wrinkled_area": float(wrinkled[widest]),
        "largest_wrinkled_share": float(wrinkled[widest] / cloud.volumes.sum()),
        "largest_wrinkled_time": float(run.times[widest]) if wrinkled[widest] else None,
    }


def tables(report: dict[str, Any]) -> list[Any]:
    """Return the tables of the full run and of the reduced ones, for people."""
    runs = list(report["full"].values())
    rows = {
        "computing time": [f"{run['wall_seconds']:.2f} s" for run in runs],
        "simulated time over computing time": [f"{run['real_time_factor']:.3g}" for run in runs],
        "time steps": [f"{run['steps']}" for run in runs],
        "tool force at the end": [f"{1e3 * run['tool_force_at_end']:.3f} mN" for run in runs],
        "largest tool force": [
            f"{1e3 * run['peak_tool_force']:.3f} mN at {1e3 * run['peak_tool_force_time']:.0f} ms" for run in runs
        ],
        "deflection of the centre at the end": [f"{1e3 * run['centre_deflection_at_end']:.2f} mm" for run in runs],
        "mean deflection at the end": [f"{1e3 * run['mean_deflection_at_end']:.2f} mm" for run in runs],
        "largest wrinkled share of the sheet": [_widest(run) for run in runs],
        "energy balance, largest miss over largest energy": [f"{run['energy_balance']:.2%}" for run in runs],
        "the same after the first snapshot": [f"{run['energy_balance_after_first_snapshot']:.2%}" for run in runs],
    }
    title = f"{report['title']}, {report['nodes']} nodes: full model"
    drawn = [quantities_table(title, list(report["full"]), rows)]
    for series, title in {PROJECTED: "Projected models (the paper's)", HYPER_REDUCED: "Hyper-reduced models"}.items():
        for name in report["full"]:
            series_entries = [entry for entry in report["reduced"] if entry["series"] == series]
            entries = [{"modes": entry["modes"]} | entry["phases"][name] for entry in series_entries]
            drawn.append(reduced_table(f"{title}, {name}: errors, time over the full model's", entries))
    return drawn


def _widest(run: dict[str, Any]) -> str:
    time = run["largest_wrinkled_time"]
    return "none" if time is None else f"{run['largest_wrinkled_share']:.1%} at {1e3 * time:.0f} ms"


def _claims(done: dict[int, dict[str, Any]]) -> list[Claim]:
    """The paper's claims of Figures 7 and 8, against the runs while the tool pushes."""
    wrong = {modes: entry["errors"]["displacement"] for modes, entry in done.items()}
    return [
        _high_with_two(wrong),
        _dramatically_less(wrong),
        _very_small_with_eight(wrong),
        _negligible_after_eight(wrong),
        _little_time(done),
        _growing_time(done),
    ]


def _high_with_two(wrong: dict[int, float]) -> Claim:
    claim = f"the error with only 2 modes is relatively high (read: above {HIGH_ERROR:.0%})"
    if 2 not in wrong:
        return "Figure 7", claim, "not run with 2 modes", None
    return "Figure 7", claim, f"{wrong[2]:.2%}", wrong[2] > HIGH_ERROR


def _dramatically_less(wrong: dict[int, float]) -> Claim:
    claim = f"more modes reduce it dramatically (read: 8 leave less than {MAX_REMAINING_ERROR:.0%} of it)"
    if not {2, 8} <= set(wrong):
        return "Figure 7", claim, "needs 2 and 8 modes", None
    return "Figure 7", claim, f"8 leave {wrong[8] / wrong[2]:.2%} of it", wrong[8] < MAX_REMAINING_ERROR * wrong[2]


def _very_small_with_eight(wrong: dict[int, float]) -> Claim:
    claim = f"the error with 8 modes is very small (read: below {SMALL_ERROR:.0%})"
    if 8 not in wrong:
        return "Figure 7", claim, "not run with 8 modes", None
    return "Figure 7", claim, f"{wrong[8]:.2%}", wrong[8] < SMALL_ERROR


def _negligible_after_eight(wrong: dict[int, float]) -> Claim:
    claim = f"after 8 modes its change is negligible (read: less than {MAX_ERROR_CHANGE:.0%} of the displacement)"
    more = [modes for modes in wrong if modes > 8]
    if 8 not in wrong or not more:
        return "Figure 7", claim, "needs 8 modes and more", None
    here = f"{wrong[8]:.2%} with 8, " + ", ".join(f"{wrong[modes]:.2%} with {modes}" for modes in more)
    return "Figure 7", claim, here, max(abs(wrong[modes] - wrong[8]) for modes in more) < MAX_ERROR_CHANGE


def _little_time(done: dict[int, dict[str, Any]]) -> Claim:
    claim = f"few modes reduce the computing time dramatically (read: 2 take less than {MAX_TIME_SHARE:.0%})"
    if 2 not in done:
        return "Figure 8", claim, "not run with 2 modes", None
    return "Figure 8", claim, f"{done[2]['ratio']:.1%} of the full model's", done[2]["ratio"] < MAX_TIME_SHARE


def _growing_time(done: dict[int, dict[str, Any]]) -> Claim:
    claim = "the computing time increases with the number of modes"
    if len(done) < 3:
        return "Figure 8", claim, "needs three sizes", None
    slope, fit = time_per_mode(done)
    first, last = (done[modes]["wall_seconds"] for modes in (min(done), max(done)))
    ends = f"{first:.2f} s with {min(done)}, {last:.2f} s with {max(done)}"
    here = f"{ends}; {1e3 * slope:.2g} ms a mode, R^2 = {fit:.2f}"
    return "Figure 8", claim, here, slope > 0 and last > first
