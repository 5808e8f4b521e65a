"""Errors of a reduced model on held-out runs, and the scales of its error indicator calibrated to them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from palpate.core.faults import DivergenceError, TrustWarning
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.calibrate_contact import Trial
from palpate.reduction.training.calibrate_indicator import Frames, calibrate_scales, error_curves, repeat_run
from palpate.reduction.training.errors import ContactErrors, Errors, contact_errors, relative_errors
from palpate.reduction.training.parallel_runs import in_threads
from palpate.reduction.training.scales import ERROR_QUANTILE


def errors_on_held_out(model: ReducedModel, held_out: Sequence[Trial]) -> ReducedModel:
    """Run the held-out motions; return the model with their errors in its report and calibrated scales."""
    with warnings.catch_warnings(action="ignore", category=TrustWarning):  # its scales are not calibrated yet
        results = in_threads(partial(_test_run, model), held_out)
    entries, frames = [entry for entry, _, _ in results], [each for _, each, _ in results if each is not None]
    touched = [entry for entry in entries if entry["failed"] or "force" in entry]
    missed, total = np.sum([squares for _, _, squares in results], axis=0)
    report: dict[str, Any] = {"runs": entries, **_over_runs(entries, list(Errors.__annotations__))}
    report["projection_error"] = float(np.sqrt(missed / total)) if total else 0.0
    if any(not entry["failed"] for entry in touched):
        report["contact"] = _over_runs(touched, list(ContactErrors.__annotations__))
    if not frames:
        return model.with_report({"held_out": report})
    scales = calibrate_scales([run.measures for run in frames], ERROR_QUANTILE)
    report["expected_error"] = error_curves(frames, scales, 0.5 * model.data.mass_damping)
    trained = replace(model.data.trained, scales=scales)
    return model.with_data(trained=trained, report={**model.report, "held_out": report})


def _test_run(model: ReducedModel, trial: Trial) -> tuple[dict[str, Any], Frames | None, tuple[float, float]]:
    """Repeat a held-out run; return its errors and frames, or why it failed, and what its modes miss of it.

    The last two numbers are squares: of the displacements that the modes do not represent, and of all.
    """
    loads, stored = trial
    run = stored if isinstance(stored, Trajectory) else Trajectory.load(stored)
    rest = run.displacements - np.tensordot(
        model.body.project(run.displacements), model.data.trial_and_test_basis[: model.count], 1
    )
    squares = float(np.linalg.norm(rest)) ** 2, float(np.linalg.norm(run.displacements)) ** 2
    try:
        reduced, frames = repeat_run(model, loads, run)
        errors = relative_errors(run, reduced).as_dict() | _contact_errors(model, loads, run, reduced)
        return {"failed": False} | errors, frames, squares
    except DivergenceError as error:
        return {"failed": True, "reason": str(error)}, None, squares


def _contact_errors(
    model: ReducedModel, loads: Sequence[Load], run: Trajectory, reduced: Trajectory
) -> dict[str, float]:
    """Return the errors of contact by name; none without contact."""
    tools = [load.name for load in loads if isinstance(load, Contact | Grasp)]
    errors = (
        contact_errors(run, reduced, tools, model.data.compliance.nodes) if model.data.compliance is not None else None
    )
    return errors.as_dict() if errors is not None else {}


def _over_runs(entries: Sequence[dict[str, Any]], names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return mean and 95th percentile of the errors of runs; infinite if one of them failed."""
    failed = any(entry["failed"] for entry in entries)
    values = {name: np.inf if failed else np.array([entry[name] for entry in entries]) for name in names}
    return {
        "mean": {name: float(np.mean(errors)) for name, errors in values.items()},
        "percentile_95": {name: float(np.quantile(errors, ERROR_QUANTILE)) for name, errors in values.items()},
    }
