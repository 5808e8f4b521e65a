"""Prescribed motions of nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.faults import InputError

__all__ = ["PrescribedMotion"]


@dataclass(frozen=True)
class PrescribedMotion(Described):
    """A prescribed displacement of a group of nodes (equation 6).

    Parameters
    ----------
    group : str
        Nodes bonded to the tool.
    displacement : (3,) sequence [m] or function
        ``displacement(points, time)`` returns the displacements, shape (g, 3) or (3,) [m], at the
        group's reference positions (g, 3) [m] and a time [s].
    until : float [s]
        Time of release; by default infinity.

    Raises
    ------
    InputError
        `until` is negative or not a number.
    """

    group: str
    displacement: Sequence[float] | Callable[[Floats, float], Any]
    until: float = np.inf

    def __post_init__(self) -> None:
        try:
            valid = float(self.until) >= 0
        except (TypeError, ValueError, OverflowError):
            valid = False
        if not valid:
            raise InputError(
                f"until of PrescribedMotion of {self.group!r} must be a time of at least 0 s, got {self.until!r}"
            )

    def _facts(self) -> list[Fact]:
        until = float(self.until) if self.until < np.inf else None
        return [("group", self.group, ""), ("displacement", self.displacement, "m"), ("until", until, "s")]

    def is_active(self, times: Floats) -> NDArray[np.bool_]:
        """Return True for the times [s] before the release."""
        return np.asarray(times <= self.until * (1 + 1e-9))
