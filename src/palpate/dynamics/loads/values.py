"""Values of loads at given times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, brief, check_arguments

Vector = Sequence[float] | Callable[[float], Sequence[float]]


def vectors_at(value: Vector | None, times: Floats, name: str) -> Floats:
    """Return the values (t, 3) of a vector, or of a function of time, at times (t,) [s]; zero for None."""
    if value is None:
        return np.zeros((len(times), 3))
    return _values_at(value, (3,), times, name)


def check_vector(value: Vector | None, name: str) -> None:
    """Check a vector when its load is made; a function of time is checked when it is called."""
    if value is not None and not callable(value):
        arrays_at([value], (3,), np.zeros(1), name)


def scalars_at(value: float | Callable[[float], float], times: Floats, name: str) -> Floats:
    """Return the values (t,) of a number or of a function of time [s]; errors as in `vectors_at`."""
    return _values_at(value, (), times, name)


def _values_at(value: Any, shape: tuple[int, ...], times: Floats, name: str) -> Floats:
    if callable(value):
        check_arguments(value, ("time",), name)
    return arrays_at([value(float(t)) if callable(value) else value for t in times], shape, times, name)


def arrays_at(values: list[Any], shape: tuple[int, ...], times: Floats, name: str) -> Floats:
    """Stack values over times, shape (t, *shape); errors as in `vectors_at`."""
    try:
        array = np.array(values, dtype=float)
    except (ValueError, TypeError, OverflowError):
        array = np.zeros(0)
    if array.shape != (len(times), *shape):
        remedy = "give (x, y, z)" if shape == (3,) else "change it"
        expected = {(): "a number", (3,): "three numbers"}.get(shape, f"an array of shape {shape}")
        raise InputError(f"{name} must be {expected}, got {brief(values[0])}; {remedy}")
    bad = np.flatnonzero(~np.isfinite(array.reshape(len(times), -1)).all(axis=1))
    if bad.size:
        raise InputError(f"{name} must be finite, got {brief(values[bad[0]])} at t = {times[bad[0]]:g} s")
    return array
