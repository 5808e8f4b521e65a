"""The error indicator: distance from training, residual norm, and the error expected at a trust number.

The trust number of `palpate.hyper_reduce` is the larger of two lengths divided by their scales: the
distance to the nearest training state, and the residual norm of the forces on test fields
(`palpate.reduction.training.residual_fields`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.model import State
from palpate.faults import InputError, number_in_range
from palpate.reduction.hyper.body import ReducedBody
from palpate.reduction.hyper.reactions import constraint_forces

__all__ = ["distances_to_nearest", "expected_error", "residual_norm", "training_distance"]


def distances_to_nearest(states: Floats, others: Floats, mass: Floats) -> Floats:
    """Return the distance [m] of each state (s, m) to the nearest of other states (t, m).

    The distance is the root mean square displacement over the body; `mass` (m, m) is the mass matrix
    divided by the mass of the body.
    """
    root = np.linalg.cholesky(mass)
    one, two = states @ root, others @ root
    square = np.sum(one**2, axis=1)[:, None] + np.sum(two**2, axis=1) - 2 * one @ two.T
    return np.sqrt(np.maximum(square.min(axis=1), 0.0))


def training_distance(body: ReducedBody, state: State) -> float:
    """Return the root mean square displacement [m] over the body from a state to the nearest training state."""
    mass = body.mass / body.masses.sum()
    return float(distances_to_nearest(state.coordinates[None], body.data.training_states, mass)[0])


def residual_norm(body: ReducedBody, state: State, prepared: PreparedLoads) -> float:
    """Return the root mean square displacement [m] that the unbalanced forces would cause at rest.

    The unbalanced forces act on the residual fields (`palpate.reduction.training.residual_fields`), and
    the displacement is in their shapes. The norm is 0 without residual fields.
    """
    first = len(body.data.basis_vectors) - body.data.residual_fields
    return float(np.linalg.norm(constraint_forces(body, state, prepared)[first:]))


def expected_error(report: dict[str, Any], trust: float) -> tuple[float, float]:
    """Return the errors that a report tabulates for a trust number; see `ReducedModel.expected_error`."""
    number = number_in_range("trust", trust, 0.0)
    table = report.get("held_out", {}).get("trust")
    if not table:
        raise InputError(
            "held_out must be given in training to expect errors, got none; train with hyper_reduce(..., held_out=...)"
        )
    for row in table:
        if number <= row["trust"]:
            return row["median"], row["percentile_95"]
    return np.inf, np.inf
