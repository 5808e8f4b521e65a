"""Advice for a reduced model with large errors on held-out runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MAX_ERROR = 0.3  # mean error over the held-out runs above which a model is not to be used
SMOOTH_MODES, SMOOTH_RUNS = 40, 8  # errors decrease little beyond these (docs/howto/modes_and_spacing.md)
MIN_EXPLAINED = 0.5  # share of the displacements around tools that the surface compliance explains
LARGE_SHARE = 0.5  # projection error over the error, above which it causes it
UNSEEN_RATIO = 2.0  # projection error of held-out runs over that of the training runs


def advice(report: Mapping[str, Any]) -> str | None:
    """Return a sentence with the errors and what to change, or None where the mean errors are at most 30 %.

    The report of a reduced model has its held-out errors: of force and surface where tools touch the body, else of
    displacement and reaction.
    """
    held_out = report["held_out"]
    touched = "contact" in held_out
    names = {"force": "force", "surface_95": "surface"}
    if not touched:
        names = {"displacement": "displacement", "reaction": "reaction"}
    mean = held_out["contact"]["mean"] if touched else held_out["mean"]
    failed, runs = sum(run["failed"] for run in held_out["runs"]), len(held_out["runs"])
    largest = max(mean[name] for name in names)
    if not failed and largest <= MAX_ERROR:
        return None
    figures = " and ".join(f"{mean[name]:.0%} in {label}" for name, label in names.items())
    fault = f"failed on {failed} of {runs} held-out runs" if failed else f"errs by {figures} on held-out runs"
    if failed:
        changes = [f"use more paths than {report['training_runs']}", f"more modes than {report['modes']}"]
    else:
        changes = _changes_with_contact(report) if touched else _changes(report, largest)
    return f"the model {fault}, so its forces are not to be used; {' or '.join(changes)}, and train it again"


def _changes(report: Mapping[str, Any], error: float) -> list[str]:
    """Return changes by the projection errors of training and held-out runs on the modes."""
    trained, unseen = report["projection_error"], report["held_out"]["projection_error"]
    missed = f"(modes miss {unseen:.0%} of the held-out runs, {trained:.0%} of the training runs)"
    if unseen > max(UNSEEN_RATIO * trained, LARGE_SHARE * error):
        return [f"use more paths than {report['training_runs']} {missed}"]
    return [f"use more modes than {report['modes']} {missed}"]


def _changes_with_contact(report: Mapping[str, Any]) -> list[str]:
    """Return changes by the sizes and the compliance of a model with smooth modes."""
    changes, explained = [], report.get("compliance_explained", 1.0)
    if report["modes"] < SMOOTH_MODES:
        changes.append(f"use more modes than {report['modes']}, such as {SMOOTH_MODES}")
    if report["training_runs"] < SMOOTH_RUNS:
        changes.append(f"use more paths than {report['training_runs']}, such as {SMOOTH_RUNS}")
    if explained < MIN_EXPLAINED:
        changes.append(
            f"use a smaller spacing or a larger tool (the surface compliance explains {explained:.0%} of the "
            "indentation)"
        )
    return changes or ["use a smaller depth, a smaller spacing or a larger tool"]
