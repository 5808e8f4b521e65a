"""The trust number: how far a reduced body is from what it was trained on, and what error that has meant."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.loads.loads import Drive, Load
from palpate.dynamics.material.relaxation import at_ease, followed
from palpate.dynamics.run.model import State
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import InputError, number_in_range
from palpate.reduction.contact.compliance import dents_of
from palpate.reduction.training.fit_compliance import touch_of

if TYPE_CHECKING:
    from palpate.reduction.hyper.model import ReducedModel

__all__ = ["Frames", "calibrated", "distance", "error_table", "expected_error", "imbalance", "nearest", "tried_frames"]

Floats = NDArray[np.float64]

BINS, FEWEST = 12, 20  # rows of the table, at most; frames in a row, at least


def nearest(states: Floats, others: Floats, mass: Floats) -> Floats:
    """Root mean square distance [m] over the body of every state (s, m) from the nearest of some others (t, m).

    `mass` (m, m) is the mass matrix over the body's mass.
    """
    root = np.linalg.cholesky(mass)
    one, two = states @ root, others @ root
    square = np.sum(one**2, axis=1)[:, None] + np.sum(two**2, axis=1) - 2 * one @ two.T
    return np.sqrt(np.maximum(square.min(axis=1), 0.0))


def distance(model: ReducedModel, state: State) -> float:
    """Return the root mean square displacement [m] over the body from a state to the nearest training state."""
    return float(nearest(state.coordinates[None], model.parts.trained, model.mass / model.masses.sum())[0])


def imbalance(model: ReducedModel, state: State, drive: Drive) -> float:
    """Return the root mean square displacement [m] that forces which the coordinates cannot balance would make.

    The forces are those on the witnesses (`palpate.reduction.training.residual_fields`), the displacement that at rest in their
    shapes; 0 without witnesses.
    """
    return float(np.linalg.norm(model.needed(state, drive)[len(model.parts.columns) - model.parts.witnesses :]))


class Frames(NamedTuple):
    """Frames of a held-out run that a reduced model has repeated.

    Parameters
    ----------
    distances, imbalances : (f,) arrays [m]
        Of the reduced run, see `distance` and `imbalance`.
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
        np.array([distance(model, state) for state in states]),
        np.array([imbalance(model, state, drive) for state in states]),
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


def expected_error(report: dict[str, Any], trust: float) -> tuple[float, float]:
    """Look a trust number up in the table of a report; see `ReducedModel.expected_error`."""
    number = number_in_range("trust", trust, 0.0)
    table = report.get("held_out", {}).get("trust")
    if not table:
        raise InputError("what errors to expect was not measured: train with reduce(..., held_out=...)")
    for row in table:
        if number <= row["trust"]:
            return row["median"], row["percentile_95"]
    return np.inf, np.inf
