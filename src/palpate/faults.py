"""The errors a user can meet, and the checks of arguments that raise them.

Every message names what is wrong, where, and what to do.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any, cast

import numpy as np

__all__ = [
    "CloudError",
    "DivergenceError",
    "FileFormatError",
    "InputError",
    "UnitWarning",
    "brief",
    "check_names",
    "integer_in_range",
    "number_in_range",
    "warn_of_unit",
]


class InputError(ValueError):
    """An argument is out of range, unknown, or does not fit another one."""


class CloudError(InputError):
    """A cloud of points cannot carry moving least squares.

    Attributes
    ----------
    nodes : (k,) int array
        Where; empty if that is not known.
    """

    def __init__(self, message: str, nodes: Any = ()) -> None:
        super().__init__(message)
        self.nodes = np.array(nodes, dtype=np.int64)


class FileFormatError(InputError):
    """A file is not what it should be: truncated, corrupt, or of another kind."""


class UnitWarning(UserWarning):
    """A value is far from that of tissue, as one in another unit is."""


class DivergenceError(RuntimeError):
    """A simulation left the range of finite, sensible states.

    Attributes
    ----------
    trajectory : object
        What was computed until then.
    """

    def __init__(self, message: str, trajectory: object = None) -> None:
        super().__init__(message)
        self.trajectory = trajectory


def number_in_range(
    name: str,
    value: float,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    open_low: bool = False,
    open_high: bool = False,
    unit: str = "",
) -> float:
    """Return `value` as a float, or raise `InputError` naming it and the allowed range."""
    try:
        if isinstance(cast(object, value), str | bytes):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be a number, got {brief(value)}") from None
    below = number <= low if open_low else number < low
    above = number >= high if open_high else number > high
    if not math.isfinite(number) or below or above:
        left = "(" if open_low or low == -math.inf else "["
        right = ")" if open_high or high == math.inf else "]"
        unit = f" {unit}" if unit else ""
        raise InputError(f"{name} = {brief(value)} is out of range: allowed is {left}{low:g}, {high:g}{right}{unit}")
    return number


def integer_in_range(name: str, value: int, low: int, high: float = math.inf) -> int:
    """Return `value` as an int, or raise `InputError` naming it and the allowed range."""
    try:
        whole = not isinstance(value, bool) and int(value) == value and low <= value <= high
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole:
        raise InputError(f"{name} = {brief(value)} is out of range: allowed is a whole number from {low} to {high:g}")
    return int(value)


def check_names(of: str, given: Iterable[str], allowed: Mapping[str, str]) -> None:
    """Refuse arguments that a class does not have.

    Parameters
    ----------
    of : str
        The class.
    given : iterable of str
    allowed : mapping of str to str
        Units by name; empty for a pure number.

    Raises
    ------
    InputError
        Names the argument, those that are allowed, and the nearest one.
    """
    for name in given:
        if name not in allowed:
            known = ", ".join(f"{each} [{unit}]" if unit else each for each, unit in allowed.items())
            near = get_close_matches(name, allowed, 1, 0.0)
            remedy = f"; did you mean {near[0]}?" if near else ""
            raise InputError(f"arguments of {of} must be among {known}, got {brief(name)[1:-1]}{remedy}")


def warn_of_unit(name: str, value: float, low: float, high: float, unit: str, remedy: str) -> None:
    """Warn, where the package is called from, of a value that only another unit explains."""
    if low <= value <= high:
        return
    level, frame = 1, sys._getframe(0)
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == "palpate":
        level, frame = level + 1, frame.f_back
    message = f"{name} should be from {low:g} to {high:g} {unit}, got {value:.4g} {unit}; {remedy}"
    warnings.warn(message, UnitWarning, stacklevel=level)


def brief(value: object) -> str:
    """Return the repr of any value, shortened, in one line, for a message."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a whole number of thousands of digits, or lists in lists
        text = f"a {type(value).__name__} too long to print"
    return text if len(text) <= 60 else text[:57] + "..."


def first_few(nodes: Any, most: int = 8) -> str:
    """Write a sequence of node numbers, shortened."""
    text = ", ".join(str(int(i)) for i in nodes[:most])
    return text + (f" and {len(nodes) - most} more" if len(nodes) > most else "")
