"""Body forces."""

from __future__ import annotations

from dataclasses import dataclass

from palpate.describe import Described, Fact
from palpate.dynamics.loads.values import Vector

__all__ = ["Gravity"]


@dataclass(frozen=True)
class Gravity(Described):
    """A body force rho g (equation 3).

    Parameters
    ----------
    acceleration : (3,) sequence, or function of time [s] that returns one [m/s^2]
    """

    acceleration: Vector = (0.0, 0.0, -9.81)

    def _facts(self) -> list[Fact]:
        return [("acceleration", self.acceleration, "m/s^2")]
