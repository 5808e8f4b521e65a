"""Body forces."""

from __future__ import annotations

from dataclasses import dataclass

from palpate.dynamics.loads.values import Vector

__all__ = ["Gravity"]


@dataclass(frozen=True)
class Gravity:
    """A body force rho g (equation 3).

    Parameters
    ----------
    acceleration : (3,) sequence, or function of time [s] that returns one [m/s^2]
    """

    acceleration: Vector = (0.0, 0.0, -9.81)
