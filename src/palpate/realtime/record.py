"""The record of one period: an array of float64 that the engine publishes and the black box stores.

A record holds the fields of `HEADER_DTYPE`, then those of `TOOL_DTYPE` for each of t tools, then m coordinates and m
velocities. The header repeats the fields of the first tool, so that programs of one tool read no further. Arrays of
recordings and frames of the protocol follow from the same table, `PERIOD_FIELDS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact


class Field(NamedTuple):
    """A value of a period: its name, unit and shape are the same in records, recordings and frames."""

    name: str
    unit: str = ""
    shape: tuple[int, ...] = ()
    type: str = "<f8"  # in recordings; all numbers of records and frames are float64


PERIOD_FIELDS = {
    field.name: field
    for field in (
        Field("time", "s"),
        Field("steps"),
        Field("failed"),
        Field("iterations"),
        Field("computing", "s"),
        Field("lateness", "s"),
        Field("trust"),
        Field("worst_trust"),
        Field("largest_force", "N"),
        Field("clamped"),
        Field("limited"),
        Field("sequence"),
        Field("kinetic", "J"),
        Field("strain", "J"),
        Field("position", "m", (3,)),
        Field("quaternion", "", (4,)),
        Field("force", "N", (3,)),
        Field("moment", "N m", (3,)),
        Field("stiffness", "N/m", (3, 3)),
    )
}


def layout(names: Iterable[str], fields: Mapping[str, Field] = PERIOD_FIELDS) -> np.dtype[Any]:
    """Return the layout of numbers of some fields that follow each other."""
    return np.dtype([(name, "<f8", fields[name].shape) for name in names])


HEADER_DTYPE = layout(PERIOD_FIELDS)
TOOL_DTYPE = layout(("position", "quaternion", "force", "moment", "stiffness", "largest_force", "limited", "sequence"))
HEADER_SIZE, TOOL_SIZE = HEADER_DTYPE.itemsize // 8, TOOL_DTYPE.itemsize // 8


def field_offset(name: str, fields: np.dtype[Any] = HEADER_DTYPE) -> int:
    """Return the index in a record at which a field of `HEADER_DTYPE` begins, or in the part of a tool."""
    return int(dict(fields.fields or {})[name][1]) // 8


def record_size(coordinates: int, tools: int) -> int:
    """Return the count of numbers in a record."""
    return HEADER_SIZE + TOOL_SIZE * tools + 2 * coordinates


@dataclass(frozen=True, kw_only=True)
class PeriodRecord(Described):
    """Results of one period for the body; the parameters are those of `Reading`."""

    time: float
    steps: int
    trust: float
    kinetic: float
    strain: float
    computing: float
    lateness: float
    coordinates: Floats
    state: str
    tools: tuple[Any, ...]

    def _facts(self) -> list[Fact]:
        return [
            ("engine", self.state, ""),
            ("time", self.time, "s"),
            ("force", self.tools[0].force, "N"),
            ("moment", self.tools[0].moment, "N m"),
            ("trust", self.trust, ""),
            ("computing time", self.computing, "s"),
            ("wake-up latency", self.lateness, "s"),
            ("steps", self.steps, ""),
            ("coordinates", len(self.coordinates), ""),
        ]


@dataclass(frozen=True, kw_only=True)
class ToolReading(Described):
    """Results of one period for one tool.

    Parameters
    ----------
    position, quaternion : (3,) array [m] and (4,) array
        Pose of the tool, relative to that at rest.
    force, moment : (3,) arrays [N], [N m]
        Force and moment of the body on the tool, about its reference point.
    stiffness : (3, 3) array [N/m]
        Contact stiffness: the derivative of the tool's force on the body by its displacement, while others rest.
    largest_force : float [N]
        Largest force since the body was at rest.
    limited : bool
        Whether the force was scaled down to the engine's limit.
    sequence : int
        Number of the newest pose that the period used.
    force_bound : float [N]
        Error bound of the force, as in `Reading`.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> left, right = (
    ...     pt.tools.Contact(pt.tools.Sphere(radius=0.005), (x, 0.015, 0.021), name=name)
    ...     for name, x in (("left", 0.008), ("right", 0.022))
    ... )
    >>> with pt.Engine(pt.realtime_model(block, contact=[left, right])) as engine:
    ...     reading = engine.read()
    >>> len(reading.tools), reading.tools[1].force.tolist()
    (2, [0.0, 0.0, 0.0])
    """

    _public = ()
    position: Floats
    quaternion: Floats
    force: Floats
    moment: Floats
    stiffness: Floats
    largest_force: float
    limited: bool
    sequence: int
    force_bound: float

    @classmethod
    def from_record(cls, numbers: Floats, bound: Callable[[float], float]) -> ToolReading:
        """Read the part (TOOL_SIZE,) of a tool, with the error bound by the size of the force."""
        fields = numbers.view(TOOL_DTYPE)[0]
        arrays = {name: fields[name].copy() for name in ("position", "quaternion", "force", "moment", "stiffness")}
        return cls(
            **arrays, largest_force=float(fields["largest_force"]), limited=bool(fields["limited"]),
            sequence=int(fields["sequence"]), force_bound=bound(float(np.linalg.norm(arrays["force"]))),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Reading(PeriodRecord):
    """Results of one period as the engine returns them; the pose is relative to the tool at rest.

    A force above the engine's limit is scaled down together with the moment. Force, moment, stiffness, pose, sequence,
    largest_force, force_bound and limited are those of the first tool; `tools` has those of all.

    Parameters
    ----------
    time : float [s]
        Model time since the last reset.
    steps : int
        Periods since the last reset.
    force, moment : (3,) arrays [N], [N m]
        Force and moment of the body on the tool, about the tool's reference point.
    stiffness : (3, 3) array [N/m]
        Contact stiffness: the derivative of the tool's force on the body by the tool's displacement, symmetric and
        without negative eigenvalues. It is updated every few periods, and is zero for a model without a stiffness
        function. That of a full body holds along the ways of the tool, and is zero until there is one above the
        noise (`palpate.dynamics.nodal.tool_stiffness`).
    trust : float
        Error indicator; above 1 the model was not trained on such states.
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
        Largest error indicator since the body was at rest, which decays as its vibrations do;
        `palpate.ReducedModel.expected_error` converts it to an error. The body is at rest when its energy has fallen
        to 1e-4 of the largest of the motion: what is left of an error is below 1 % of the amplitude.
    largest_force : float [N]
        Largest force on the tool since the body was at rest.
    force_bound : float [N]
        Error bound of the force, which runs of the kind of the held-out runs keep with the level of
        `palpate.ReducedModel.expected_error`. Infinite where the error is unknown: from an error indicator of 2 on,
        or without such runs.
    clamped : bool
        Whether the engine keeps the tool away from states that the model was not trained on.
    limited : bool
        Whether the force was scaled down to the engine's limit.
    velocities : (m,) array
        Velocities of the reduced coordinates.
    tools : tuple of ToolReading
        One for every tool, in their order.

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

    _public = ()
    force: Floats
    moment: Floats
    stiffness: Floats
    position: Floats
    quaternion: Floats
    sequence: int
    worst_trust: float
    largest_force: float
    force_bound: float
    clamped: bool
    limited: bool
    velocities: Floats
    tools: tuple[ToolReading, ...]

    @classmethod
    def from_record(
        cls, record: Floats, state: str, tools: int, bound: Callable[[float, float], float] | None = None
    ) -> Reading:
        """Read a record of a number of tools, with the error bound by the largest error indicator and the force."""
        header, at = record[:HEADER_SIZE].view(HEADER_DTYPE)[0], HEADER_SIZE + TOOL_SIZE * tools
        names = ("time", "trust", "worst_trust", "kinetic", "strain", "computing", "lateness")
        numbers: dict[str, Any] = {name: float(header[name]) for name in names}

        def bound_of(size: float) -> float:
            return bound(numbers["worst_trust"], size) if bound else math.inf

        parts = record[HEADER_SIZE:at].reshape(tools, TOOL_SIZE)
        readings = tuple(ToolReading.from_record(part, bound_of) for part in parts)
        coordinates, velocities = record[at:].reshape(2, -1).copy()
        return cls(
            **numbers, **vars(readings[0]), steps=int(header["steps"]), clamped=bool(header["clamped"]),
            coordinates=coordinates, velocities=velocities, state=state, tools=readings,
        )  # fmt: skip
