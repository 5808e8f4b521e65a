"""Prescribed motions of nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.describe import Described
from palpate.core.faults import check_arguments
from palpate.core.parameters import parameter
from palpate.dynamics.loads.values import arrays_at


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
        `until` is negative or not a number, or `displacement` is a function of other arguments, or a constant that is
        not three finite numbers.

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

    _public = ()
    group: str
    displacement: Sequence[float] | Callable[[Floats, float], Any] = parameter("m", help="displacement of the group")
    until: float = parameter("s", np.inf, "time of release", low=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if callable(self.displacement):
            check_arguments(self.displacement, ("points", "time"), f"displacement{self._owner()}")
        elif np.ndim(np.asarray(self.displacement, dtype=object)) != 2:  # one displacement for each node
            arrays_at([self.displacement], (3,), np.zeros(1), f"displacement{self._owner()}")

    def _owner(self) -> str:
        return f" of PrescribedMotion of {self.group!r}"

    def is_active(self, times: Floats) -> NDArray[np.bool_]:
        """Return True for the times [s] before the release."""
        return np.asarray(times <= self.until * (1 + 1e-9))
