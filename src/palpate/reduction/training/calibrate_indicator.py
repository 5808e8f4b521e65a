"""Calibration of the error indicator on held-out runs, and the table of expected errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.run.model import State
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.contact.compliance import contact_displacements
from palpate.reduction.contact.tools import contact_at_frame
from palpate.reduction.hyper.error_indicator import residual_norm, training_distance
from palpate.reduction.hyper.load_share import MAX_LOAD_SCALE, MIN_LOAD_SCALE
from palpate.reduction.hyper.model import ReducedModel

__all__ = ["Calibration", "Frames", "calibrate_indicator", "error_table", "indicator_frames"]


MAX_ROWS = 12  # of the table
MIN_FRAMES = 20  # in a row


class Frames(NamedTuple):
    """Frames of a held-out run of a reduced model.

    Parameters
    ----------
    distances, residual_norms : (f,) arrays [m]
        See `palpate.reduction.hyper.error_indicator`.
    load_shares : (f,) array
        See `palpate.reduction.hyper.load_share`.
    errors : (f,) array
        Root mean square displacement error over the body, divided by the largest such displacement of the
        run.
    """

    distances: Floats
    residual_norms: Floats
    load_shares: Floats
    errors: Floats


def indicator_frames(model: ReducedModel, loads: Sequence[Load], own: Trajectory, full: Trajectory) -> Frames:
    """Return distances from training, residual norms and errors of all frames of a reduced model's run."""
    prepared, mass = model.prepare(loads), model.masses / model.masses.sum()
    contact_forces = [contact_at_frame(own, k, len(model.cloud)) for k in range(len(own.times))]
    compliance = np.array([_contact_displacements(model, own, k) for k in range(len(own.times))])
    coordinates, velocities = model.body.project(own.displacements - compliance), model.body.project(own.velocities)
    states: list[State] = []
    work = model.workspace()
    for a, v, time in zip(coordinates, velocities, own.times.tolist(), strict=True):
        last = states[-1] if states else None
        history = (
            model.body.history_after(a, last.history, time - last.time, work)
            if last
            else model.body.equilibrium_history(a, work)
        )
        states.append(State(a, v, time, history=history, contact_state=contact_forces[len(states)]))
    squares = np.einsum("tnc,n->t", full.displacements**2, mass)
    missed = np.sqrt(np.einsum("tnc,n->t", (own.displacements - full.displacements) ** 2, mass))
    return Frames(
        np.array([training_distance(model.body, state) for state in states]),
        np.array([residual_norm(model.body, state, prepared) for state in states]),
        np.array([model.load_share(state, prepared) for state in states]),
        missed / max(float(np.sqrt(squares.max())), 1e-300),
    )


def _contact_displacements(model: ReducedModel, own: Trajectory, frame: int) -> Floats:
    """Return the displacements (n, 3) [m] of the surface compliance by the stored forces of a frame."""
    known, of_frame = model.data.compliance, own.contact_forces[:, 0] == frame
    if known is None or not of_frame.any():
        return np.zeros((len(model.cloud), 3))
    rows, bonded = own.contact_forces[of_frame], own.bonded[of_frame]
    pushes = np.zeros((2, len(model.cloud), 3))
    pushes[bonded.astype(int), rows[:, 1].astype(int)] = rows[:, 2:]
    return contact_displacements(known, model.cloud.points, pushes[:, known.nodes], [False, True])[0]


class Calibration(NamedTuple):
    """Scales of the error indicator and the table of expected errors.

    Parameters
    ----------
    distance_scale, residual_scale : float [m]
    load_scale : float
    table : list of mappings
        See `error_table`.
    """

    distance_scale: float
    residual_scale: float
    load_scale: float
    table: list[dict[str, float]]


def calibrate_indicator(runs: Sequence[Frames], share: float) -> Calibration:
    """Return the scales of the error indicator, and the table of expected errors.

    With these scales the trust number is at most 1 in a given share of all frames, unless the scale of the
    load shares would be above `MAX_LOAD_SCALE`.
    """
    distance_scale, residual_scale = (
        max(float(np.quantile(np.concatenate(values), share)), 1e-300)
        for values in ([run.distances for run in runs], [run.residual_norms for run in runs])
    )
    load_scale = max(float(np.quantile(np.concatenate([run.load_shares for run in runs]), share)), MIN_LOAD_SCALE)
    wider = max(
        float(np.quantile(np.concatenate(_numbers(runs, distance_scale, residual_scale, load_scale)), share)), 1.0
    )
    scales = wider * distance_scale, wider * residual_scale, min(wider * load_scale, MAX_LOAD_SCALE)
    return Calibration(*scales, error_table(_numbers(runs, *scales), [run.errors for run in runs]))


def _numbers(runs: Sequence[Frames], distance_scale: float, residual_scale: float, load_scale: float) -> list[Floats]:
    """Return the trust numbers (f,) of the frames of each run."""
    return [
        np.max(
            [run.distances / distance_scale, run.residual_norms / residual_scale, run.load_shares / load_scale], axis=0
        )
        for run in runs
    ]


def error_table(numbers: Sequence[Floats], errors: Sequence[Floats]) -> list[dict[str, float]]:
    """Return a table of the errors met at trust numbers.

    Parameters
    ----------
    numbers, errors : sequences of (f,) arrays
        Trust number and displacement error of every held-out run, frame by frame.

    Returns
    -------
    list of mappings
        Rows in ascending order: ``"trust"``, the largest number so far in the frames of the row;
        ``"median"`` and ``"percentile_95"`` of their errors; and the number of ``"frames"``. Errors do not
        decrease from row to row (isotonic regression).
    """
    running_maximum = np.concatenate([np.maximum.accumulate(own) for own in numbers])
    sorted_errors = np.concatenate(list(errors))[np.argsort(running_maximum, kind="stable")]
    running_maximum = np.sort(running_maximum)
    count = int(np.clip(len(running_maximum) // MIN_FRAMES, 1, MAX_ROWS))
    bins = np.array_split(np.arange(len(running_maximum)), count)
    lasts = [running_maximum[part[-1]] for part in bins]
    ends = np.unique(np.searchsorted(running_maximum, lasts, side="right"))  # equal values in one row
    rows = np.split(np.arange(len(running_maximum)), ends[:-1])
    sizes = np.array([len(part) for part in rows], dtype=float)
    columns = [_isotonic(np.array([np.quantile(sorted_errors[part], q) for part in rows]), sizes) for q in (0.5, 0.95)]
    return [
        {"trust": float(running_maximum[part[-1]]), "median": float(m), "percentile_95": float(p), "frames": len(part)}
        for part, m, p in zip(rows, *columns, strict=True)
    ]


def _isotonic(values: Floats, weights: Floats) -> Floats:
    """Return the nearest values that do not decrease."""
    from scipy.optimize import isotonic_regression

    return np.asarray(isotonic_regression(values, weights=weights).x)
