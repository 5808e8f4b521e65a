"""The record of one period: an array of float64 that the engine publishes and the black box stores.

A record holds the fields of `HEADER_DTYPE`, then m coordinates, then m velocities.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.describe import Described, Fact

HEADER_DTYPE = np.dtype(
    [(name, "f8") for name in ("time", "steps", "failed", "iterations", "computing", "lateness")]
    + [
        (name, "f8")
        for name in ("trust", "worst_trust", "largest_force", "clamped", "limited", "sequence", "kinetic", "strain")
    ]
    + [("position", "f8", 3), ("quaternion", "f8", 4), ("force", "f8", 3), ("moment", "f8", 3)]
    + [("stiffness", "f8", (3, 3))]
)
HEADER_SIZE = HEADER_DTYPE.itemsize // 8
FIELD_UNITS = {"time": "s", "computing": "s", "lateness": "s", "kinetic": "J", "strain": "J", "position": "m"}
FIELD_UNITS |= {"force": "N", "largest_force": "N", "moment": "N m", "stiffness": "N/m"}


def field_offset(name: str) -> int:
    """Return the index in a record at which a field of `HEADER_DTYPE` begins."""
    return int(dict(HEADER_DTYPE.fields or {})[name][1]) // 8


@dataclass(frozen=True, kw_only=True)
class PeriodRecord(Described):
    """Results of one period; the parameters are those of `Reading`."""

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
class Reading(PeriodRecord):
    """Results of one period as the engine returns them; the pose is relative to the tool at rest.

    A force above the engine's limit is scaled down together with the moment.

    Parameters
    ----------
    time : float [s]
        Model time since the last reset.
    steps : int
        Periods since the last reset.
    force, moment : (3,) arrays [N], [N m]
        Force and moment of the body on the tool, about the tool's reference point.
    stiffness : (3, 3) array [N/m]
        Contact stiffness: the derivative of the tool's force on the body by the tool's displacement. It is
        updated every few periods, and is zero for a model without a stiffness function.
    trust : float
        Trust number; above 1 the model was not trained on such states.
    position, quaternion : (3,) array [m] and (4,) array
        Pose of the tool, which follows the requested pose at a limited speed.
    sequence : int
        Sequence number of the newest pose that the period used, as passed to `Engine.set_pose`.
    kinetic, strain : float [J]
        Kinetic and strain energy.
    computing, lateness : float [s]
        Computing time of the step, and the delay between its deadline and its start.
    coordinates : (m,) array
        Reduced coordinates.
    state : str
        ``"stopped"``, ``"running"``, ``"paused"`` or ``"diverged"``. After a divergence the other
        fields keep the last valid values.
    worst_trust : float
        Largest trust number since the body was at rest; `palpate.ReducedModel.expected_error` converts it to an
        error. The body is at rest when its energy has fallen to 1e-4 of the largest of the motion: what is left
        of an error is below 1 % of the amplitude.
    largest_force : float [N]
        Largest force on the tool since the body was at rest.
    force_bound : float [N]
        Error bound of the force, which runs of the kind of the held-out runs keep with the level of
        `palpate.ReducedModel.expected_error`. Infinite where the error is unknown: above all trust numbers of
        those runs, or without such runs.
    clamped : bool
        Whether the engine keeps the tool away from states that the model was not trained on.
    limited : bool
        Whether the force was scaled down to the engine's limit.
    velocities : (m,) array
        Velocities of the reduced coordinates.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
    >>> with pt.Engine(pt.realtime_model(block, contact=ball)) as engine:
    ...     reading = engine.read()
    >>> reading.force.tolist(), reading.limited, reading.force_bound
    ([0.0, 0.0, 0.0], False, inf)
    """

    worst_trust: float
    largest_force: float
    force_bound: float
    clamped: bool
    limited: bool
    velocities: Floats

    @classmethod
    def from_record(cls, record: Floats, state: str, bound: Callable[[float, float], float] | None = None) -> Reading:
        """Read a record (HEADER_SIZE + 2 m,), with the error bound by the largest trust number and the force."""
        header = record[:HEADER_SIZE].view(HEADER_DTYPE)[0]
        names = ("time", "trust", "worst_trust", "largest_force", "kinetic", "strain", "computing", "lateness")
        numbers: dict[str, Any] = {name: float(header[name]) for name in names}
        numbers |= {name: int(header[name]) for name in ("steps", "sequence")}
        arrays = {name: header[name].copy() for name in ("force", "moment", "stiffness", "position", "quaternion")}
        worst, size = numbers["worst_trust"], float(np.linalg.norm(arrays["force"]))
        coordinates, velocities = record[HEADER_SIZE:].reshape(2, -1).copy()
        return cls(
            **numbers, **arrays, force_bound=bound(worst, size) if bound else math.inf,
            clamped=bool(header["clamped"]), limited=bool(header["limited"]),
            coordinates=coordinates, velocities=velocities, state=state,
        )  # fmt: skip
