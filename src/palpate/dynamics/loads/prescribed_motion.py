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
    """Nodes that follow a tool (equation 6).

    Parameters
    ----------
    group : str
        The nodes the tool holds.
    displacement : (3,) sequence [m] or function
        ``displacement(points, time)``, with the group's reference positions (g, 3) [m] and the time [s], returns the
        displacements, shape (g, 3) or (3,) [m].
    until : float [s]
        Last time at which the tool holds the nodes; by default it never lets go.

    Raises
    ------
    InputError
        `until` is no number of at least 0.
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
                f"PrescribedMotion of {self.group!r}: until = {self.until!r} must be a time of at least 0 s"
            )

    def _facts(self) -> list[Fact]:
        until = float(self.until) if self.until < np.inf else None
        return [("group", self.group, ""), ("displacement", self.displacement, "m"), ("until", until, "s")]

    def holds(self, times: Floats) -> NDArray[np.bool_]:
        """Return whether the tool holds its nodes at some times [s]."""
        return np.asarray(times <= self.until * (1 + 1e-9))
