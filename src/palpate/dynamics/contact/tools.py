"""Rigid tools: motions, contact and grasps of the shapes in `palpate.dynamics.contact.shapes`.

A pose is the position (3,) [m] of this frame and a
unit quaternion (4,), w x y z, in one array (7,), as in `palpate.realtime.pose`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, brief, check_arguments
from palpate.core.parameters import parameter
from palpate.dynamics.contact.shapes import Capsule, Forceps, Plane, Punch, Sphere, Tool
from palpate.dynamics.contact.tool_parameters import friction
from palpate.meshfree.cloud import MOVED_MARGIN, Cloud

__all__ = [
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

MAX_ROTATION = 1e6  # [rad], component of a rotation vector


@dataclass(frozen=True)
class Contact(Described):
    """A rigid tool in unilateral contact with a body, with Coulomb friction.

    Patches of surface that would enter the tool within a step are moved onto its surface. The change
    of the nodes' momentum is the tool's impulse on the body. A patch is a node or, on a solid in its
    energy form, the surface around a node (`palpate.meshfree.patches`).

    Parameters
    ----------
    tool : Sphere, Capsule, Plane, Punch or Blade
    motion : pose, or function of time [s], or sampled arrays
        Pose of the tool: a position (3,) [m], or a position and a rotation. A rotation is a rotation
        vector (3,) [rad] or a quaternion (4,), w x y z. A function of time returns one of these.
        Sampled arrays are a tuple of times (k,) [s], positions (k, 3) [m] and optional rotations
        (k, 3) or (k, 4). Poses are interpolated between samples, and constant outside.
    friction : float
        Coulomb's coefficient mu of sticking and sliding.
    name : str
        Unique name of the tool's force and moment in a trajectory.
    group : str, optional
        Nodes whose patches can be in contact. By default all, because a deep press acts on nodes
        below the surface too.

    Raises
    ------
    InputError
        The tool has another type, the friction is negative, or a constant pose is not a position, or a position and a
        rotation.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> sphere = pt.tools.Sphere(radius=0.01)
    >>> ball = pt.tools.Contact(sphere, lambda t: (0.015, 0.015, 0.026 - 0.1 * t), friction=0.3)
    >>> run = pt.rollout(block, [ball], duration=0.03, every=0.01)
    >>> bool(run.reactions["tool"][-1, 2] < 0)
    True
    """

    _public = ()
    tool: Tool
    motion: Motion
    friction: float = friction(0.0)
    name: str = "tool"
    group: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.tool, Tool):
            raise InputError(
                f"tool of Contact {self.name!r} must be a Sphere, Capsule, Plane, Punch or Blade, got "
                f"{self.tool!r:.200}"
            )
        super().__post_init__()
        _check_constant(self.motion, f"motion of Contact {self.name!r}")

    def _facts(self) -> list[Fact]:
        return _with_motion(super()._facts())

    def poses(self, times: Floats) -> Floats:
        """Return the tool's poses (t, 7) at some times [s]; errors as in `poses`."""
        return poses(self._motion, times, f"motion of Contact {self.name!r}")

    @cached_property
    def _motion(self) -> Motion:
        return motion_function(self.motion, f"motion of Contact {self.name!r}")


@dataclass(frozen=True)
class Grasp(Described):
    """Forceps bonded to the surface nodes near a point, which they move as a rigid body.

    Parameters
    ----------
    point : (d,) sequence [m]
        Grasped point, and the tool's origin.
    radius : float [m]
    motion : see `Contact`
        Pose of the tool.
    until : float [s]
        Time of release; by default infinity.
    name : str
        Name of the force in the trajectory, and of the group of bonded nodes.

    Raises
    ------
    InputError
        `until` is negative or not a number, a constant pose is invalid, or no surface node is within the radius.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> forceps = pt.tools.Grasp((0.015, 0.015, 0.015), 0.006, lambda t: (0.015, 0.015, 0.015 + 0.1 * t))
    >>> run = pt.rollout(block, [forceps], duration=0.02, every=0.01)
    >>> bool(run.reactions["grasp"][-1, 2] > 0)
    True
    """

    _public = ()
    point: Sequence[float] = parameter("m", help="grasped point")
    radius: float = parameter("m", help="radius around the point", above=0.0)
    motion: Motion = parameter(help="pose of the tool")
    until: float = parameter("s", np.inf, "time of release", low=0.0)
    name: str = "grasp"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_constant(self.motion, f"motion of Grasp {self.name!r}")

    def _facts(self) -> list[Fact]:
        return _with_motion(super()._facts())

    def with_group(self, cloud: Cloud) -> Cloud:
        """Return the cloud with the bonded nodes as a group, unless the group exists."""
        if self.name in cloud.groups:
            return cloud
        near = cloud.within(self.name, self.point, self.radius, margin=MOVED_MARGIN)
        nodes = np.intersect1d(near.group(self.name), surface_nodes(cloud))
        if nodes.size == 0:
            raise InputError(
                f"point of Grasp {self.name!r} must be within {self.radius:g} m of a surface node, got {self.point} m; "
                "move the point or use a larger radius"
            )
        return replace(cloud, groups={**cloud.groups, self.name: nodes})

    def poses(self, times: Floats) -> Floats:
        """Return the tool's poses (t, 7) at some times [s]; errors as in `poses`."""
        return poses(self._motion, times, f"motion of Grasp {self.name!r}")

    def displacement(self, points: Floats, time: float) -> Floats:
        """Return the displacements (g, 3) [m] of points (g, d) [m] at a time [s]."""
        pose = self.poses(np.array([time]))[0]
        origin = np.pad(np.asarray(self.point, dtype=float), (0, 3 - len(self.point)))
        arms = np.pad(points, ((0, 0), (0, 3 - points.shape[1]))) - origin
        rotated = Rotation.from_quat(pose[3:], scalar_first=True).apply(arms)
        return np.asarray(pose[:3] - origin + rotated - arms)

    @cached_property
    def _motion(self) -> Motion:
        return motion_function(self.motion, f"motion of Grasp {self.name!r}")


def _with_motion(facts: Sequence[Fact]) -> list[Fact]:
    """Return facts with the motion in a few words."""
    return [(name, _motion_fact(value) if name == "motion" else value, unit) for name, value, unit in facts]


def _motion_fact(motion: Motion) -> str:
    """Return in a few words what a motion is given as."""
    if callable(motion):
        return "a function of time"
    if _is_constant(motion):
        return "at rest"
    times = np.asarray(motion[0], dtype=float)
    return f"{times.size:,} samples from {times.min(initial=np.inf):.3g} to {times.max(initial=-np.inf):.3g} s"


def surface_nodes(cloud: Cloud) -> NDArray[np.int64]:
    """Return the surface nodes of a solid, or all nodes of a membrane.

    Parameters
    ----------
    cloud : Cloud

    Returns
    -------
    (k,) int array
        In ascending order.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> len(cloud.points), len(pt.tools.surface_nodes(cloud))
    (112, 92)
    """
    return np.unique(cloud.face_nodes) if cloud.points.shape[1] == 3 else np.arange(len(cloud))


def _is_constant(motion: Any) -> bool:
    """Return whether a motion other than a function is one pose, and not sampled arrays."""
    return np.ndim(motion[0]) == 0 or (len(motion) == 2 and np.ndim(motion[1]) == 1)


def _check_constant(motion: Any, what: str) -> None:
    """Check one pose when its load is made; functions and samples are checked when they are used."""
    if callable(motion):
        return
    is_listed = isinstance(motion, Sequence) or (isinstance(motion, np.ndarray) and motion.ndim > 0)
    if not is_listed or not len(motion) or _is_constant(motion):
        poses(lambda time: motion, np.zeros(1), what)


def motion_function(motion: Motion, what: str) -> Motion:
    """Return a function of time or a constant pose for a motion."""
    if callable(motion):
        check_arguments(motion, ("time",), what)
    if callable(motion) or _is_constant(motion):
        return motion
    if len(motion) not in (2, 3):
        raise InputError(
            f"{what} must be times (k,), positions (k, 3) and optional rotations (k, 3 or 4), got {len(motion)} arrays"
        )
    try:
        times, positions, *given = (np.asarray(part, dtype=float) for part in motion)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{what} must be arrays of numbers, got {brief(motion)}") from None
    count = times.size
    if times.ndim != 1 or count < 2 or positions.shape != (count, 3):
        raise InputError(
            f"{what} must have shapes (k,) of times and (k, 3) of positions, got {times.shape} and {positions.shape}"
        )
    if not (np.isfinite(times).all() and np.isfinite(positions).all() and np.all(np.diff(times) > 0)):
        raise InputError(f"{what} must have ascending times, and finite times and positions")
    orientations = None
    for rotations in given:
        if rotations.shape not in ((count, 3), (count, 4)):
            raise InputError(f"{what} must have rotations of shape {(count, 3)} or {(count, 4)}, got {rotations.shape}")
        orientations = Slerp(times, Rotation.from_quat([quaternion(row, what) for row in rotations], scalar_first=True))

    def sampled(time: float) -> Any:
        at = float(np.clip(time, times[0], times[-1]))
        position = np.array([np.interp(at, times, column) for column in positions.T])
        return position if orientations is None else (position, orientations(at).as_quat(scalar_first=True))

    return sampled


def quaternion(rotation: Any, what: str) -> Floats:
    """Return the unit quaternion (4,), w x y z, of a rotation vector (3,) [rad] or quaternion (4,)."""
    try:
        array = np.asarray(rotation, dtype=float)
    except (ValueError, TypeError, OverflowError):
        array = np.zeros(0)
    if array.shape not in ((3,), (4,)) or not np.isfinite(array).all():
        raise InputError(
            f"{what} must be a finite rotation vector (3,) [rad] or quaternion (4,), got {brief(rotation)}"
        )
    if array.shape == (3,):
        if np.abs(array).max() > MAX_ROTATION:
            raise InputError(f"{what} must be at most {MAX_ROTATION:g} rad, got {brief(rotation)}")
        return np.asarray(Rotation.from_rotvec(array).as_quat(scalar_first=True))
    largest = np.abs(array).max()
    if not largest > 0:
        raise InputError(f"{what} must have a length above 0, got 0; use (1, 0, 0, 0) for no rotation")
    if not 1e-100 < largest < 1e100:  # squares out of double precision
        array = array / largest
    return np.asarray(array / np.linalg.norm(array))


def poses(motion: Motion, times: Floats, what: str) -> Floats:
    """Return the poses (t, 7) of a function of time or constant pose at some times [s]."""
    result = np.zeros((len(times), 7))
    result[:, 3] = 1.0
    for k, time in enumerate(times):
        value = motion(float(time)) if callable(motion) else motion
        rotated = isinstance(value, tuple | list) and len(value) == 2
        try:
            position = np.asarray(value[0] if rotated else value, dtype=float)
        except (ValueError, TypeError, OverflowError):
            position = np.zeros(0)
        if position.shape != (3,):
            raise InputError(f"{what} must be a position (3,) [m], or a position and a rotation, got {brief(value)}")
        if not np.isfinite(position).all():
            raise InputError(f"{what} must be finite, got {brief(value)} at t = {time:g} s")
        result[k, :3] = position
        if rotated:
            result[k, 3:] = quaternion(value[1], f"the rotation of {what} at t = {time:g} s")
    return result
