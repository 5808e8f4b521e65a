"""The error indicator: distance of a state from the training states, and the error expected there.

Its value is the trust number of `palpate.hyper_reduce`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.faults import InputError, number_in_range

__all__ = ["distances_to_nearest", "expected_error"]


def distances_to_nearest(states: Floats, others: Floats, mass: Floats) -> Floats:
    """Return the distance [m] of each state (s, m) to the nearest of other states (t, m).

    The distance is the root mean square displacement over the body; `mass` (m, m) is the mass matrix
    divided by the mass of the body.
    """
    root = np.linalg.cholesky(mass)
    one, two = states @ root, others @ root
    square = np.sum(one**2, axis=1)[:, None] + np.sum(two**2, axis=1) - 2 * one @ two.T
    return np.sqrt(np.maximum(square.min(axis=1), 0.0))


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
