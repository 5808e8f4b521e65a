"""Calibration of the error indicator on held-out runs, and the table of errors that it predicts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.material.relaxation import equilibrium_history, history_after
from palpate.dynamics.run.model import State
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.contact.compliance import contact_displacements
from palpate.reduction.contact.tools import contact_at_frame
from palpate.reduction.hyper.model import ReducedModel

__all__ = ["Frames", "calibrate_indicator", "error_table", "indicator_frames"]


BINS, FEWEST = 12, 20  # rows of the table, at most; frames in a row, at least


class Frames(NamedTuple):
    """Frames of a held-out run that a reduced model has repeated.

    Parameters
    ----------
    distances, imbalances : (f,) arrays [m]
        Of the reduced run, see `ReducedModel.distance` and `ReducedModel.imbalance`.
    missed : (f,) array
        Root mean square error of the displacement over the body, over the largest such displacement of the run.
    """

    distances: Floats
    residual_norms: Floats
    missed: Floats


def indicator_frames(model: ReducedModel, loads: Sequence[Load], own: Trajectory, full: Trajectory) -> Frames:
    """Say of every frame of a reduced model's run how far it was from training, and from the full run."""
    prepared, mass = model.prepare(loads), model.masses / model.masses.sum()
    contact_forces = [contact_at_frame(own, k, len(model.cloud)) for k in range(len(own.times))]
    compliance = np.array([_contact_displacements(model, own, k) for k in range(len(own.times))])
    coordinates, velocities = model.project(own.displacements - compliance), model.project(own.velocities)
    states: list[State] = []
    for a, v, time in zip(coordinates, velocities, own.times.tolist(), strict=True):
        where, evaluate = model._scratch.history, partial(model.force, a)
        last = states[-1] if states else None
        history = (
            history_after(where, last.history, time - last.time, evaluate)
            if last
            else equilibrium_history(where, evaluate)
        )
        states.append(State(a, v, time, history=history, contact_state=contact_forces[len(states)]))
    squares = np.einsum("tnc,n->t", full.displacements**2, mass)
    missed = np.sqrt(np.einsum("tnc,n->t", (own.displacements - full.displacements) ** 2, mass))
    return Frames(
        np.array([model.distance(state) for state in states]),
        np.array([model.residual_norm(state, prepared) for state in states]),
        missed / max(float(np.sqrt(squares.max())), 1e-300),
    )


def _contact_displacements(model: ReducedModel, own: Trajectory, frame: int) -> Floats:
    """Return the displacements (n, 3) [m] by the forces that a reduced run has kept of a frame."""
    known, of_frame = model.data.compliance, own.contact_forces[:, 0] == frame
    if known is None or not of_frame.any():
        return np.zeros((len(model.cloud), 3))
    rows, bonded = own.contact_forces[of_frame], own.bonded[of_frame]
    pushes = np.zeros((2, len(model.cloud), 3))
    pushes[bonded.astype(int), rows[:, 1].astype(int)] = rows[:, 2:]
    return contact_displacements(known, model.cloud.points, pushes[:, known.nodes], [False, True])[0]


def calibrate_indicator(runs: Sequence[Frames], share: float) -> tuple[float, float, list[dict[str, float]]]:
    """Return reach and leeway [m] with which a share of all frames has a trust number of at most 1, and the table."""
    distance_scale, residual_scale = (
        max(float(np.quantile(np.concatenate(values), share)), 1e-300)
        for values in ([run.distances for run in runs], [run.residual_norms for run in runs])
    )
    numbers = [np.maximum(run.distances / distance_scale, run.residual_norms / residual_scale) for run in runs]
    wider = max(float(np.quantile(np.concatenate(numbers), share)), 1.0)
    table = error_table([own / wider for own in numbers], [run.missed for run in runs])
    return wider * distance_scale, wider * residual_scale, table


def error_table(numbers: Sequence[Floats], missed: Sequence[Floats]) -> list[dict[str, float]]:
    """Relate trust numbers to errors: what errors were met where the trust number had reached so much and no more.

    Parameters
    ----------
    numbers, missed : sequences of (f,) arrays
        Of every held-out run, frame by frame: the trust number, and the displacement error.

    Returns
    -------
    list of mappings
        In ascending order: ``"trust"``, the largest number of a row, ``"median"`` and ``"percentile_95"`` of the errors
        of its frames, and how many ``"frames"`` it holds. Errors do not fall from row to row: rows where they would are
        averaged (isotonic regression).
    """
    reached = np.concatenate([np.maximum.accumulate(own) for own in numbers])
    errors = np.concatenate(list(missed))[np.argsort(reached, kind="stable")]
    reached = np.sort(reached)
    about = np.array_split(np.arange(len(reached)), int(np.clip(len(reached) // FEWEST, 1, BINS)))
    ends = np.unique([np.searchsorted(reached, reached[part[-1]], side="right") for part in about])  # equals together
    data = np.split(np.arange(len(reached)), ends[:-1])
    sizes = np.array([len(part) for part in data], dtype=float)
    columns = [_rising(np.array([np.quantile(errors[part], q) for part in data]), sizes) for q in (0.5, 0.95)]
    return [
        {"trust": float(reached[part[-1]]), "median": float(m), "percentile_95": float(p), "frames": len(part)}
        for part, m, p in zip(data, *columns, strict=True)
    ]


def _rising(values: Floats, weights: Floats) -> Floats:
    """Nearest values that do not fall: neighbours that do are pooled."""
    from scipy.optimize import isotonic_regression

    return np.asarray(isotonic_regression(values, weights=weights).x)
