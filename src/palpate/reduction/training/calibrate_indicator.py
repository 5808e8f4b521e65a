"""Calibration of the error indicator on held-out runs, and the table of errors that it predicts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.loads.loads import Load
from palpate.dynamics.material.relaxation import at_ease, followed
from palpate.dynamics.run.model import State
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.contact.compliance import dents_of
from palpate.reduction.contact.tools import touch_of
from palpate.reduction.hyper.model import ReducedModel

__all__ = ["Frames", "calibrated", "error_table", "tried_frames"]

Floats = NDArray[np.float64]

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
    imbalances: Floats
    missed: Floats


def tried_frames(model: ReducedModel, loads: Sequence[Load], own: Trajectory, full: Trajectory) -> Frames:
    """Say of every frame of a reduced model's run how far it was from training, and from the full run."""
    drive, mass = model.drive(loads), model.masses / model.masses.sum()
    touches = [touch_of(own, k, len(model.cloud)) for k in range(len(own.times))]
    dents = np.array([_dents(model, own, k) for k in range(len(own.times))])
    coordinates, velocities = model.projected(own.displacements - dents), model.projected(own.velocities)
    states: list[State] = []
    for a, v, time in zip(coordinates, velocities, own.times.tolist(), strict=True):
        where, evaluate = model._scratch.memory, partial(model.force, a)
        last = states[-1] if states else None
        memory = followed(where, last.memory, time - last.time, evaluate) if last else at_ease(where, evaluate)
        states.append(State(a, v, time, memory=memory, touch=touches[len(states)]))
    squares = np.einsum("tnc,n->t", full.displacements**2, mass)
    missed = np.sqrt(np.einsum("tnc,n->t", (own.displacements - full.displacements) ** 2, mass))
    return Frames(
        np.array([model.distance(state) for state in states]),
        np.array([model.imbalance(state, drive) for state in states]),
        missed / max(float(np.sqrt(squares.max())), 1e-300),
    )


def _dents(model: ReducedModel, own: Trajectory, frame: int) -> Floats:
    """Return the displacements (n, 3) [m] by the forces that a reduced run has kept of a frame."""
    known, of_frame = model.parts.dents, own.touches[:, 0] == frame
    if known is None or not of_frame.any():
        return np.zeros((len(model.cloud), 3))
    rows, held = own.touches[of_frame], own.held[of_frame]
    pushes = np.zeros((2, len(model.cloud), 3))
    pushes[held.astype(int), rows[:, 1].astype(int)] = rows[:, 2:]
    return dents_of(known, model.cloud.points, pushes[:, known.nodes], [False, True])[0]


def calibrated(runs: Sequence[Frames], share: float) -> tuple[float, float, list[dict[str, float]]]:
    """Return reach and leeway [m] with which a share of all frames has a trust number of at most 1, and the table."""
    reach, leeway = (
        max(float(np.quantile(np.concatenate(values), share)), 1e-300)
        for values in ([run.distances for run in runs], [run.imbalances for run in runs])
    )
    numbers = [np.maximum(run.distances / reach, run.imbalances / leeway) for run in runs]
    wider = max(float(np.quantile(np.concatenate(numbers), share)), 1.0)
    table = error_table([own / wider for own in numbers], [run.missed for run in runs])
    return wider * reach, wider * leeway, table


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
    parts = np.split(np.arange(len(reached)), ends[:-1])
    sizes = np.array([len(part) for part in parts], dtype=float)
    columns = [_rising(np.array([np.quantile(errors[part], q) for part in parts]), sizes) for q in (0.5, 0.95)]
    return [
        {"trust": float(reached[part[-1]]), "median": float(m), "percentile_95": float(p), "frames": len(part)}
        for part, m, p in zip(parts, *columns, strict=True)
    ]


def _rising(values: Floats, weights: Floats) -> Floats:
    """Nearest values that do not fall: neighbours that do are pooled."""
    from scipy.optimize import isotonic_regression

    return np.asarray(isotonic_regression(values, weights=weights).x)
