"""Prescribed motions of nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.faults import InputError, check_arguments

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
        `until` is negative or not a number, or `displacement` is a function of other arguments.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> tool = pt.PrescribedMotion("x+", lambda points, t: (0.1 * t, 0, 0))
    >>> run = pt.rollout(bar, [tool], duration=0.02, every=0.01)
    >>> float(run.displacements[-1, cloud.group("x+"), 0].max().round(6))
    0.002
    >>> bool(run.reactions["x+"][-1, 0] > 0)
    True
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

        if callable(self.displacement):
            name = f"displacement of PrescribedMotion of {self.group!r}"
            check_arguments(self.displacement, ("points", "time"), name)

    def _facts(self) -> list[Fact]:
        until = float(self.until) if self.until < np.inf else None
        return [("group", self.group, ""), ("displacement", self.displacement, "m"), ("until", until, "s")]

    def is_active(self, times: Floats) -> NDArray[np.bool_]:
        """Return True for the times [s] before the release."""
        return np.asarray(times <= self.until * (1 + 1e-9))
