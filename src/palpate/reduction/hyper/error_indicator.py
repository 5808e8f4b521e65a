"""The trust number: how far a reduced body is from what it was trained on, and what error that has meant."""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.faults import InputError, number_in_range

__all__ = ["expected_error", "nearest"]


def nearest(states: Floats, others: Floats, mass: Floats) -> Floats:
    """Root mean square distance [m] over the body of every state (s, m) from the nearest of some others (t, m).

    `mass` (m, m) is the mass matrix over the body's mass.
    """
    root = np.linalg.cholesky(mass)
    one, two = states @ root, others @ root
    square = np.sum(one**2, axis=1)[:, None] + np.sum(two**2, axis=1) - 2 * one @ two.T
    return np.sqrt(np.maximum(square.min(axis=1), 0.0))


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
