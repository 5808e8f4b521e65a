"""Rigid tools: their shapes, where they are over time, and how they touch a body.

A shape stands in the tool's own frame. A pose puts that frame into space: a position (3,) [m] and a unit quaternion
(4,), w x y z, in one array (7,), as in `palpate.realtime`. What the compiled step needs of a shape is its kind and
its sizes; the distances themselves are in `palpate.dynamics.contact.geometry`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.faults import InputError, brief, number_in_range
from palpate.meshfree.cloud import Cloud

__all__ = [
    "BONDED",
    "Capsule",
    "Contact",
    "Forceps",
    "Grasp",
    "Motion",
    "Plane",
    "Punch",
    "Sphere",
    "Tool",
    "poses",
    "surface_nodes",
]

Motion = Callable[[float], Any] | Sequence[Any] | Floats

CAPSULE, PLANE, PUNCH, BONDED = 0, 1, 2, 3
MOST_TURN = 1e6  # [rad] of a rotation vector
ROUNDING = 0.05  # of a punch's edge, in its radii


@dataclass(frozen=True)
class Sphere(Described):
    """A ball about the tool's origin.

    Parameters
    ----------
    radius : float [m]

    Raises
    ------
    InputError
        The radius is not positive.
    """

    radius: float
    kind: ClassVar[int] = CAPSULE

    def __post_init__(self) -> None:
        number_in_range("radius of a Sphere", self.radius, 0.0, open_low=True, unit="m")

    def _facts(self) -> list[Fact]:
        return [("radius", float(self.radius), "m")]

    @property
    def sizes(self) -> tuple[float, float, float]:
        """What the distance depends on [m]: radius, half the length, rounding."""
        return float(self.radius), 0.0, 0.0


@dataclass(frozen=True)
class Capsule(Described):
    """A cylinder along the tool's z axis with half a ball at either end, about the tool's origin.

    Parameters
    ----------
    radius, length : float [m]
        Of the cylinder; the ends reach a radius further.

    Raises
    ------
    InputError
        A size is not positive.
    """

    radius: float
    length: float
    kind: ClassVar[int] = CAPSULE

    def __post_init__(self) -> None:
        number_in_range("radius of a Capsule", self.radius, 0.0, open_low=True, unit="m")
        number_in_range("length of a Capsule", self.length, 0.0, open_low=True, unit="m")

    def _facts(self) -> list[Fact]:
        return [("radius", float(self.radius), "m"), ("length", float(self.length), "m")]

    @property
    def sizes(self) -> tuple[float, float, float]:
        """What the distance depends on [m]: radius, half the length, rounding."""
        return float(self.radius), 0.5 * float(self.length), 0.0


@dataclass(frozen=True)
class Plane(Described):
    """The half-space below the tool's z = 0; its normal is +z."""

    kind: ClassVar[int] = PLANE

    @property
    def sizes(self) -> tuple[float, float, float]:
        """A plane has no size."""
        return 0.0, 0.0, 0.0


@dataclass(frozen=True)
class Punch(Described):
    """A cylinder without end, above the tool's z = 0, whose flat end about the origin faces -z.

    Parameters
    ----------
    radius : float [m]
    rounding : float, optional [m]
        Radius of the edge's rounding, inside the cylinder; by default a twentieth of the radius.

    Raises
    ------
    InputError
        A radius that is not positive, or a rounding that is negative or larger than it.
    """

    radius: float
    rounding: float | None = None
    kind: ClassVar[int] = PUNCH

    def __post_init__(self) -> None:
        number_in_range("radius of a Punch", self.radius, 0.0, open_low=True, unit="m")
        if self.rounding is not None:
            number_in_range("rounding of a Punch", self.rounding, 0.0, self.radius, unit="m")

    def _facts(self) -> list[Fact]:
        return [("radius", float(self.radius), "m"), ("rounding", self.sizes[2], "m")]

    @property
    def sizes(self) -> tuple[float, float, float]:
        """What the distance depends on [m]: radius, half the length, rounding."""
        return float(self.radius), 0.0, ROUNDING * self.radius if self.rounding is None else float(self.rounding)


@dataclass(frozen=True)
class Forceps(Described):
    """What a `Grasp` is on a reduced model: a tool that holds the surface nodes within a radius of a point at rest.

    Parameters
    ----------
    radius : float [m]
    point : (3,) sequence [m]
    until : float [s]
    """

    radius: float
    point: Sequence[float]
    until: float
    kind: ClassVar[int] = BONDED

    def _facts(self) -> list[Fact]:
        return [
            ("radius", float(self.radius), "m"),
            ("point", np.asarray(self.point, dtype=float), "m"),
            ("until", float(self.until), "s"),
        ]

    @property
    def sizes(self) -> tuple[float, float, float]:
        """What it reaches [m]: a radius."""
        return float(self.radius), 0.0, 0.0


Tool = Sphere | Capsule | Plane | Punch | Forceps


@dataclass(frozen=True)
class Contact(Described):
    """A rigid tool that may touch a body: it pushes, and rubs by Coulomb's law, but never pulls.

    Patches of surface that would enter the tool within a step are put onto its surface; what that changes of the
    nodes' momentum is the tool's impulse on the body. A patch is a node, or, of a solid in its energy form, the surface
    around one (`palpate.meshfree.patches`).

    Parameters
    ----------
    tool : Sphere, Capsule, Plane or Punch
    motion : pose, or function of time [s], or sampled arrays
        Where the tool's origin is: a position (3,) [m], or a position and a rotation, which is a rotation vector (3,)
        [rad] or a quaternion (4,), w x y z; or a function of time that returns one of these. Sampled arrays are
        a tuple of times (k,) [s], positions (k, 3) [m] and, if the tool turns, rotations (k, 3) or (k, 4); between
        samples poses are interpolated, before the first and after the last they stay.
    friction : float
        Coulomb's coefficient mu, of sticking and of sliding.
    name : str
        Under which a trajectory keeps the tool's force and moment; every tool needs one of its own.
    group : str, optional
        The nodes whose patches the tool can touch; by default all, as a deep press meets some below the surface.

    Raises
    ------
    InputError
        What is given as a tool is none, or the friction is negative.
    """

    tool: Tool
    motion: Motion
    friction: float = 0.0
    name: str = "tool"
    group: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.tool, Tool):
            raise InputError(f"Contact {self.name!r}: {self.tool!r} is no tool; use Sphere, Capsule, Plane or Punch")
        number_in_range(f"friction of Contact {self.name!r}", self.friction, 0.0)

    def _facts(self) -> list[Fact]:
        return [
            ("name", self.name, ""),
            ("tool", self.tool, ""),
            ("friction", float(self.friction), ""),
            ("motion", _motion_fact(self.motion), ""),
            ("group", self.group, ""),
        ]

    def poses(self, times: Floats) -> Floats:
        """Return the tool's poses (t, 7) at some times [s]; for errors see `poses`."""
        return poses(self._motion, times, f"the motion of Contact {self.name!r}")

    @cached_property
    def _motion(self) -> Motion:
        return motion_function(self.motion, f"the motion of Contact {self.name!r}")


@dataclass(frozen=True)
class Grasp(Described):
    """Forceps that hold the surface nodes within a radius of a point, and move and turn them as a rigid body.

    Parameters
    ----------
    point : (d,) sequence [m]
        Where the body is grasped; the tool's origin.
    radius : float [m]
    motion : as of `Contact`
        Where the origin is and how the tool is turned.
    until : float [s]
        When it lets go; by default never.
    name : str
        Of the force in the trajectory, and of the group of nodes that is held.

    Raises
    ------
    InputError
        `until` is no number of at least 0; no surface node is that near.
    """

    point: Sequence[float]
    radius: float
    motion: Motion
    until: float = np.inf
    name: str = "grasp"

    def _facts(self) -> list[Fact]:
        return [
            ("name", self.name, ""),
            ("point", np.asarray(self.point, dtype=float), "m"),
            ("radius", float(self.radius), "m"),
            ("motion", _motion_fact(self.motion), ""),
            ("until", float(self.until) if self.until < np.inf else None, "s"),
        ]

    def with_group(self, cloud: Cloud) -> Cloud:
        """Return a cloud with the nodes that are held as a group of the grasp's name, unless it has one already."""
        if self.name in cloud.groups:
            return cloud
        near = cloud.within(self.name, self.point, self.radius)
        nodes = np.intersect1d(near.group(self.name), surface_nodes(cloud))
        if nodes.size == 0:
            raise InputError(f"Grasp {self.name!r}: no surface node is within {self.radius:g} m of {self.point} m")
        return replace(cloud, groups={**cloud.groups, self.name: nodes})

    def displacement(self, points: Floats, time: float) -> Floats:
        """Return the displacements (g, 3) [m] of points (g, d) [m] at a time [s]."""
        pose = poses(self._motion, np.array([time]), f"the motion of Grasp {self.name!r}")[0]
        origin = np.pad(np.asarray(self.point, dtype=float), (0, 3 - len(self.point)))
        arms = np.pad(points, ((0, 0), (0, 3 - points.shape[1]))) - origin
        turned = Rotation.from_quat(pose[3:], scalar_first=True).apply(arms)
        return np.asarray(pose[:3] - origin + turned - arms)

    @cached_property
    def _motion(self) -> Motion:
        return motion_function(self.motion, f"the motion of Grasp {self.name!r}")


def _motion_fact(motion: Motion) -> str:
    """Return in a few words what a motion is given as."""
    if callable(motion):
        return "a function of time"
    if np.ndim(motion[0]) == 0 or (len(motion) == 2 and np.ndim(motion[1]) == 1):
        return "at rest"
    times = np.asarray(motion[0], dtype=float)
    return f"{times.size:,} samples from {times.min(initial=np.inf):.3g} to {times.max(initial=-np.inf):.3g} s"


def surface_nodes(cloud: Cloud) -> NDArray[np.int64]:
    """Return the nodes that a tool can touch: those on the surface of a solid, all of a membrane."""
    return np.unique(cloud.face_nodes) if cloud.points.shape[1] == 3 else np.arange(len(cloud))


def motion_function(motion: Motion, what: str) -> Motion:
    """Return a motion as a function of time, or as a constant pose.

    Raises
    ------
    InputError
        Sampled arrays that do not fit together, are not finite, or have times that do not ascend.
    """
    if callable(motion) or np.ndim(motion[0]) == 0 or (len(motion) == 2 and np.ndim(motion[1]) == 1):
        return motion
    if len(motion) not in (2, 3):
        raise InputError(f"{what}: samples are times (k,), positions (k, 3) and, if it turns, rotations (k, 3 or 4)")
    try:
        times, positions, *given = (np.asarray(part, dtype=float) for part in motion)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{what}: samples must be arrays of numbers, not {brief(motion)}") from None
    count = times.size
    if times.ndim != 1 or count < 2 or positions.shape != (count, 3):
        raise InputError(f"{what}: {times.shape} times and positions {positions.shape} do not fit: (k,) and (k, 3)")
    if not (np.isfinite(times).all() and np.isfinite(positions).all() and np.all(np.diff(times) > 0)):
        raise InputError(f"{what}: times must ascend, and times and positions be finite")
    turns = None
    for rotations in given:
        if rotations.shape not in ((count, 3), (count, 4)):
            raise InputError(f"{what}: rotations of shape {rotations.shape} do not fit {count} times: (k, 3) or (k, 4)")
        turns = Slerp(times, Rotation.from_quat([quaternion(row, what) for row in rotations], scalar_first=True))

    def sampled(time: float) -> Any:
        at = float(np.clip(time, times[0], times[-1]))
        place = np.array([np.interp(at, times, column) for column in positions.T])
        return place if turns is None else (place, turns(at).as_quat(scalar_first=True))

    return sampled


def quaternion(rotation: Any, what: str) -> Floats:
    """Return the unit quaternion (4,), w x y z, of a rotation vector (3,) [rad] or of a quaternion (4,)."""
    try:
        array = np.asarray(rotation, dtype=float)
    except (ValueError, TypeError, OverflowError):
        array = np.zeros(0)
    if array.shape not in ((3,), (4,)) or not np.isfinite(array).all():
        raise InputError(f"{what}: a rotation is a finite vector (3,) [rad] or quaternion (4,), not {brief(rotation)}")
    if array.shape == (3,):
        if np.abs(array).max() > MOST_TURN:
            raise InputError(f"{what}: a rotation vector has at most {MOST_TURN:g} rad, not {brief(rotation)}")
        return np.asarray(Rotation.from_rotvec(array).as_quat(scalar_first=True))
    largest = np.abs(array).max()
    if not largest > 0:
        raise InputError(f"{what}: a quaternion of length 0 is no rotation; (1, 0, 0, 0) turns nothing")
    if not 1e-100 < largest < 1e100:  # whose squares leave double precision
        array = array / largest
    return np.asarray(array / np.linalg.norm(array))


def poses(motion: Motion, times: Floats, what: str) -> Floats:
    """Return the poses (t, 7) of a motion, a function of time or a constant pose, at some times [s].

    Raises
    ------
    InputError
        The motion is no position, or no position and rotation, or not finite; names `what` and when.
    """
    result = np.zeros((len(times), 7))
    result[:, 3] = 1.0
    for k, time in enumerate(times):
        value = motion(float(time)) if callable(motion) else motion
        turned = isinstance(value, tuple | list) and len(value) == 2
        try:
            place = np.asarray(value[0] if turned else value, dtype=float)
        except (ValueError, TypeError, OverflowError):
            place = np.zeros(0)
        if place.shape != (3,):
            raise InputError(f"{what} must be a position (3,) [m], or a position and a rotation, not {brief(value)}")
        if not np.isfinite(place).all():
            raise InputError(f"{what} is not finite at t = {time:g} s")
        result[k, :3] = place
        if turned:
            result[k, 3:] = quaternion(value[1], f"{what} at t = {time:g} s")
    return result
