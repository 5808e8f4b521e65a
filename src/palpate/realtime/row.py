"""The numbers of a period: what a reader of the engine sees and what the black box keeps.

They stand in one array of float64: those of `HEAD`, then m coordinates, then m velocities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.describe import Described, Fact

__all__ = ["HEAD", "UNITS", "WIDTH", "Period", "Reading", "offset"]

Floats = NDArray[np.float64]

HEAD = np.dtype(
    [(name, "f8") for name in ("time", "steps", "failed", "iterations", "computing", "lateness")]
    + [(name, "f8") for name in ("trust", "worst_trust", "held", "limited", "sequence", "kinetic", "strain")]
    + [("position", "f8", 3), ("quaternion", "f8", 4), ("force", "f8", 3), ("moment", "f8", 3)]
    + [("stiffness", "f8", (3, 3))]
)
WIDTH = HEAD.itemsize // 8
UNITS = {"time": "s", "computing": "s", "lateness": "s", "kinetic": "J", "strain": "J", "position": "m"}
UNITS |= {"force": "N", "moment": "N m", "stiffness": "N/m"}


def offset(name: str) -> int:
    """Return where the numbers of a field begin."""
    return int(dict(HEAD.fields or {})[name][1]) // 8


@dataclass(frozen=True, kw_only=True)
class Period(Described):
    """What is known of one period.

    Parameters
    ----------
    time : float [s]
        Of the body: periods since the last reset.
    steps : int
        Periods since the last reset.
    force, moment : (3,) arrays [N], [N m]
        Of the body on the tool, about the tool's reference point.
    stiffness : (3, 3) array [N/m]
        Derivative of the tool's force on the body by the tool's displacement, that of some periods ago; zero where the
        model tells none.
    trust : float
        Above 1 the model was not trained on such states.
    position, quaternion : (3,) array [m] and (4,) array
        Pose of the tool; it follows the given pose at no more than the engine's speed.
    sequence : int
        Number that `Engine.set_pose` gave to the newest pose that the period knew.
    kinetic, strain : float [J]
    computing, lateness : float [s]
        Computing time of the period's step, and how late it began.
    coordinates : (m,) array
    state : str
        ``"stopped"``, ``"running"``, ``"paused"`` or ``"ran away"``; the numbers are the last good ones.
    """

    time: float
    steps: int
    force: Floats
    moment: Floats
    stiffness: Floats
    trust: float
    position: Floats
    quaternion: Floats
    sequence: int
    kinetic: float
    strain: float
    computing: float
    lateness: float
    coordinates: Floats
    state: str

    def _facts(self) -> list[Fact]:
        return [
            ("engine", self.state, ""),
            ("time", self.time, "s"),
            ("force", self.force, "N"),
            ("moment", self.moment, "N m"),
            ("trust", self.trust, ""),
            ("computing time", self.computing, "s"),
            ("lateness", self.lateness, "s"),
            ("steps", self.steps, ""),
            ("coordinates", len(self.coordinates), ""),
        ]


@dataclass(frozen=True, kw_only=True)
class Reading(Period):
    """What an engine tells, all of one period. The pose is that in the model, from where the tool stands at rest.

    Where the force is larger than the engine's limit, force and moment are scaled down together.

    Parameters
    ----------
    worst_trust : float
        The largest trust number since the last reset: `palpate.ReducedModel.expected_error` tells what errors it means.
    held : bool
        Whether the tool is held back from states that the model was not trained on.
    limited : bool
        Whether the force was scaled down.
    velocities : (m,) array
    """

    worst_trust: float
    held: bool
    limited: bool
    velocities: Floats

    @classmethod
    def of(cls, row: Floats, state: str) -> Reading:
        """Read a row (WIDTH + 2 m,)."""
        head = row[:WIDTH].view(HEAD)[0]
        names = ("time", "trust", "worst_trust", "kinetic", "strain", "computing", "lateness")
        numbers: dict[str, Any] = {name: float(head[name]) for name in names}
        numbers |= {name: int(head[name]) for name in ("steps", "sequence")}
        arrays = {name: head[name].copy() for name in ("force", "moment", "stiffness", "position", "quaternion")}
        coordinates, velocities = row[WIDTH:].reshape(2, -1).copy()
        return cls(
            **numbers, **arrays, held=bool(head["held"]), limited=bool(head["limited"]), coordinates=coordinates,
            velocities=velocities, state=state,
        )  # fmt: skip
