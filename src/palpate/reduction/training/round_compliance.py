"""Rounding of the surface compliance to multiples of a power of two, so that the file of a model is small.

The entries of a flexibility decrease with the distance of force and displacement, and its accuracy matters relative to
the compliance of a node under its own force. So all entries are rounded to multiples of one step, a fixed small
fraction of that. Most of them are then small integers, which compress well. The errors of the entries are independent,
and a tool pushes many nodes, so its displacement has a smaller relative error than an entry.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.reduction.contact.compliance import SurfaceCompliance
from palpate.reduction.contact.near_field import lowest_compliance

# largest steps, over the median compliance of a surface node under its own force; a step is more than half of it
MAX_STEP, MAX_INTERIOR_STEP = 1 / 1024, 1 / 700
MIN_LOWEST = 0.1  # lowest eigenvalue of the rounded compliance, over that of the exact one
MAX_HALVINGS = 8  # of the step, until the rounded compliance has it


def round_compliance(compliance: SurfaceCompliance) -> SurfaceCompliance:
    """Return a compliance whose flexibilities are multiples of powers of two, positive definite if it is.

    It must have its final factor: a scaled compliance is not rounded.
    """
    typical = float(np.median(np.diagonal(compliance.flexibility)))
    if not typical > 0:
        return compliance
    rounded, step = compliance, _power_of_two(MAX_STEP * typical)
    if compliance.interior is not None:
        interior = compliance.interior
        multiples = _multiples(interior.flexibility, _power_of_two(MAX_INTERIOR_STEP * typical / interior.factor))
        rounded = compliance._replace(interior=interior._replace(flexibility=multiples))
    least = MIN_LOWEST * max(_lowest(compliance), 0.0)
    for _ in range(MAX_HALVINGS):
        flexibility, near_field = _multiples(compliance.flexibility, step), _multiples(compliance.near_field, step)
        rounded = rounded._replace(flexibility=flexibility, near_field=near_field)
        if _lowest(rounded) > least:
            break
        step /= 2
    return rounded


def _lowest(compliance: SurfaceCompliance) -> float:
    """Return the lowest eigenvalue [m/N] of a compliance."""
    return lowest_compliance(
        compliance.flexibility, compliance.carriers, compliance.weights, compliance.nearby, compliance.near_field
    )


def _power_of_two(limit: float) -> float:
    """Return the largest power of two of at most a limit."""
    return float(np.ldexp(0.5, np.frexp(limit)[1]))


def _multiples(values: NDArray[Any], step: float) -> NDArray[np.float32]:
    return (np.rint(values / np.float32(step)) * np.float32(step)).astype(np.float32)
