"""What holds and pushes a body: tractions, gravity, prescribed motions, tools, foundations.

A load says what happens in the user's words; `drive` gathers a list of loads into the arrays that the compiled time
step reads, for a given cloud and support.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.dynamics.contact.geometry import Contacts, contacts
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.foundation import Foundation, foundation_areas
from palpate.faults import InputError, brief, first_few
from palpate.meshfree.cloud import Cloud

__all__ = ["Gravity", "Load", "PreparedLoads", "PrescribedMotion", "SurfaceForce", "prepare_loads"]

Floats = NDArray[np.float64]
Vector = Sequence[float] | Callable[[float], Sequence[float]]
FREE, FIXED, PRESCRIBED = 0, 1, 2


@dataclass(frozen=True)
class SurfaceForce:
    """A force, a moment or a pressure on the face that a group of nodes makes up (equation 4).

    Give a force, a moment or both, or a pressure.

    Parameters
    ----------
    group : str
        Nodes of one face of the body.
    force : (3,) sequence, or function of time [s] that returns one, optional [N]
        Total force, spread evenly over the face's reference area, fixed in direction.
    moment : (3,) sequence, or function of time [s] that returns one, optional [N m]
        Total moment about the centroid of the face's reference area. Its traction, c x (X - centroid) with one c for
        the face, is fixed in direction too and sums to no force.
    pressure : float, or function of time [s], optional [Pa]
        Pressure on the deformed face: it follows the face as it moves and turns, and pushes against its normal. On a
        membrane the normal is +z and the face is that of the group's nodes; a force is spread over the flat edge that
        the group makes up, or else over its nodes' areas.

    Raises
    ------
    InputError
        Neither a force, a moment nor a pressure, or a pressure beside another.
    """

    group: str
    force: Vector | None = None
    moment: Vector | None = None
    pressure: float | Callable[[float], float] | None = None

    def __post_init__(self) -> None:
        if (self.force is None and self.moment is None) == (self.pressure is None):
            raise InputError(
                f"Traction on {self.group!r}: give either force [N], moment [N m] or both, or pressure [Pa]"
            )


@dataclass(frozen=True)
class Gravity:
    """A body force rho g (equation 3).

    Parameters
    ----------
    acceleration : (3,) sequence, or function of time [s] that returns one [m/s^2]
    """

    acceleration: Vector = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class PrescribedMotion:
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

    def holds(self, times: Floats) -> NDArray[np.bool_]:
        """Return whether the tool holds its nodes at some times [s]."""
        return np.asarray(times <= self.until * (1 + 1e-9))


Load = SurfaceForce | Gravity | PrescribedMotion | Grasp | Contact | Foundation


class LoadHistory(NamedTuple):
    """Values of the loads at the times of some steps, for the compiled step."""

    gravity: Floats  # (s, 3)
    force: Floats  # (s, groups, 3) total force [N]
    moment: Floats  # (s, groups, 3) total moment [N m] of the same groups
    pressure: Floats  # (s, groups) [Pa]
    motion: Floats  # (s, driven nodes, 3) [m]
    holds: NDArray[np.bool_]  # (s, driven nodes) whether the tool still holds them
    poses: Floats  # (s, tools that may touch the body, 7) places [m] and quaternions
    times: Floats  # (s,) [s]


class LoadSites(NamedTuple):
    """Where loads act, for the compiled step."""

    kind: NDArray[np.uint8]  # (n,) FREE, FIXED or DRIVEN
    force_start: NDArray[np.int64]
    force_node: NDArray[np.int64]
    force_share: Floats  # (k,) share of the total force
    moment_share: Floats  # (k, 3, 3) force [N] of a unit moment [N m]
    pressure_start: NDArray[np.int64]
    pressure_node: NDArray[np.int64]
    pressure_area: Floats  # (k, 3) area vectors [m^2]
    prescribed: NDArray[np.int64]
    impulses: Floats  # (driven nodes, 3) [N s] that drive them, added up by the step
    foundation_node: NDArray[np.int64]
    foundation_spring: Floats  # (k,) [N/m]
    foundation_dashpot: Floats  # (k,) [N s/m]


@dataclass(frozen=True)
class PreparedLoads:
    """Loads made ready for a cloud and its support.

    Parameters
    ----------
    loads : tuple of loads
    places : Places
    supports : mapping of group name to nodes
        Fixed and driven groups, whose reaction forces are reported.
    grasps : tuple of str
        Those driven groups that a `Grasp` holds.
    """

    loads: tuple[Load, ...]
    places: LoadSites
    supports: dict[str, NDArray[np.int64]]
    points: Floats
    contacts: Contacts
    motions: tuple[tuple[PrescribedMotion, slice], ...] = field(default=())
    grasps: tuple[str, ...] = ()
    partitions: dict[tuple[str, ...], Floats] = field(default_factory=dict, repr=False, compare=False)  # once computed

    def schedule(self, times: Floats) -> LoadHistory:
        """Evaluate every load at the given times [s].

        Raises
        ------
        InputError
            A load's function returned the wrong shape or a value that is not finite.
        """
        gravity = np.zeros((len(times), 3))
        forces, moments, pressures = [], [], []
        for load in self.loads:
            if isinstance(load, Gravity):
                gravity += _vectors(load.acceleration, times, "the acceleration of Gravity")
            elif isinstance(load, SurfaceForce) and load.pressure is None:
                forces.append(_vectors(load.force, times, f"the force of Traction on {load.group!r}"))
                moments.append(_vectors(load.moment, times, f"the moment of Traction on {load.group!r}"))
            elif isinstance(load, SurfaceForce):
                of, what = load.pressure, f"the pressure of Traction on {load.group!r}"
                pressures.append(_shaped([of(t) if callable(of) else of for t in times], (), times, what))
        motion = np.zeros((len(times), len(self.places.prescribed), 3))
        holds = np.ones(motion.shape[:2], dtype=np.bool_)
        for load, where in self.motions:
            holds[:, where] = load.holds(times)[:, None]
            points, of_motion = self.points[self.places.prescribed[where]], load.displacement
            what = f"the PrescribedMotion of {load.group!r}"
            last = np.minimum(times, load.until)
            values = [of_motion(points, float(t)) if callable(of_motion) else of_motion for t in last]
            if np.shape(values[0]) == (3,):
                motion[:, where] = _shaped(values, (3,), times, what)[:, None]
            else:
                motion[:, where] = _shaped(values, points.shape, times, what)
        return LoadHistory(
            gravity,
            np.stack(forces, axis=1) if forces else np.zeros((len(times), 0, 3)),
            np.stack(moments, axis=1) if moments else np.zeros((len(times), 0, 3)),
            np.stack(pressures, axis=1) if pressures else np.zeros((len(times), 0)),
            motion,
            holds,
            np.stack([tool.poses(times) for tool in self.tools], axis=1)
            if self.tools
            else np.zeros((len(times), 0, 7)),
            np.asarray(times, dtype=float),
        )

    @cached_property
    def tools(self) -> tuple[Contact, ...]:
        """Return the tools that may touch the body."""
        return tuple(load for load in self.loads if isinstance(load, Contact))

    def stops(self, start: float, end: float) -> list[float]:
        """Return the times [s] after `start` at which tools let go, and then `end`."""
        near = 1e-9 * abs(end)
        return [*sorted({m.until for m, _ in self.motions if start + near < m.until < end - near}), end]

    def grasped(self) -> dict[str, slice]:
        """Return which of the driven nodes every `Grasp` holds."""
        return {motion.group: where for motion, where in self.motions if motion.group in self.grasps}

    def held(self, time: float) -> NDArray[np.bool_]:
        """Return which nodes are fixed or held by a tool at a time [s], shape (n,)."""
        held = self.places.kind != FREE
        for load, where in self.motions:
            if not load.holds(np.array(time)):
                held[self.places.prescribed[where]] = False
        return held

    def holding(self, time: float) -> dict[str, NDArray[np.int64]]:
        """Return the supports and the tools that still hold the body at a time [s], with their nodes."""
        gone = {load.group for load, _ in self.motions if not load.holds(np.array(time))}
        return {name: nodes for name, nodes in self.supports.items() if name not in gone}

    @staticmethod
    def rates(values: Callable[[Floats], Floats], time: float, interval: float = 1e-4) -> tuple[Floats, Floats]:
        """Return first and second time derivatives of prescribed values, by differences over `interval` [s].

        The differences look back: at a time when the motion jumps or changes its speed, they tell what was until then.
        """
        f3, f2, f1, now = values(time - interval * np.array([3.0, 2.0, 1.0, 0.0]))
        return (3 * now - 4 * f1 + f2) / (2 * interval), (2 * now - 5 * f1 + 4 * f2 - f3) / interval**2


def _vectors(value: Vector | None, times: Floats, what: str) -> Floats:
    """Values (t, 3) of a vector at some times; one that is not given is zero."""
    if value is None:
        return np.zeros((len(times), 3))
    return _shaped([value(float(t)) if callable(value) else value for t in times], (3,), times, what)


def _shaped(values: list[Any], shape: tuple[int, ...], times: Floats, what: str) -> Floats:
    """Stack values over times, or raise `InputError` that says what is not of the shape or not finite."""
    try:
        array = np.array(values, dtype=float)
    except (ValueError, TypeError, OverflowError):
        array = np.zeros(0)
    if array.shape != (len(times), *shape):
        wanted = {(): "a number", (3,): "three numbers"}.get(shape, f"an array of shape {shape}")
        raise InputError(f"{what} must be {wanted}, not {brief(values[0])}")
    bad = np.flatnonzero(~np.isfinite(array.reshape(len(times), -1)).all(axis=1))
    if bad.size:
        raise InputError(f"{what} is not finite at t = {times[bad[0]]:g} s")
    return array


def _moment_shares(load: SurfaceForce, points: Floats, shares: Floats) -> Floats:
    """Forces [N] of nodes at `points` (g, d) [m] for a unit moment [N m] of a load, shape (g, 3, 3).

    A_i (c x r_i) with r_i = X_i - centroid and the area A_i has the moment I c, I = sum A_i (|r_i|^2 1 - r_i r_i^T).
    """
    if load.moment is None:
        return np.zeros((len(points), 3, 3))
    arms = np.pad(points - shares @ points, ((0, 0), (0, 3 - points.shape[1])))
    crossed = np.cross(np.eye(3), arms[:, None])  # (g, 3, 3), row c is e_c x r_i
    inertia = np.einsum("g,gia,gja->ij", shares, crossed, crossed)
    smallest, _, largest = np.linalg.eigvalsh(inertia)
    if smallest <= 1e-9 * largest:
        raise InputError(
            f"the moment of Traction on {load.group!r} needs a face: the group's nodes lie on one line or at one point"
        )
    return np.asarray(np.einsum("g,gia,ij->gaj", shares, crossed, np.linalg.inv(inertia)))


def prepare_loads(
    cloud: Cloud,
    fixed: Sequence[str],
    loads: Sequence[Load],
    areas_of: Callable[[SurfaceForce], Floats] | None = None,
    patches: sparse.csr_array | None = None,
) -> PreparedLoads:
    """Make loads ready for a cloud whose groups `fixed` are held.

    Parameters
    ----------
    cloud : Cloud
    fixed : sequence of str
    loads : sequence of loads
    areas_of : function, optional
        Of a traction, returns its group's area vectors (g, 3) [m^2]; by default those of the cloud's faces.
    patches : csr_array, optional
        (n, n) weights of the nodes in the displacements of what tools touch; by default they touch the nodes.

    Raises
    ------
    InputError
        An unknown group, a load on a fixed group, a moment on nodes in one line, two motions for one node, or no node
        that is free.
    """
    loads = tuple(loads)
    grasps = tuple(load.name for load in loads if isinstance(load, Grasp))
    for load in loads:
        cloud = load.with_group(cloud) if isinstance(load, Grasp) else cloud
    loads = tuple(
        PrescribedMotion(load.name, load.displacement, load.until) if isinstance(load, Grasp) else load
        for load in loads
    )
    kind = np.full(len(cloud), FREE, dtype=np.uint8)
    supports = {}
    for name in fixed:
        supports[name] = cloud.group(name)
        kind[supports[name]] = FIXED
    prescribed: list[NDArray[np.int64]] = []
    motions, count = [], 0
    forces: list[tuple[NDArray[np.int64], Floats, Floats]] = []
    pressures: list[tuple[NDArray[np.int64], Floats]] = []
    foundations: list[tuple[NDArray[np.int64], Floats, Floats]] = []
    prescribed_until = np.where(kind == FIXED, np.inf, -np.inf)
    for load in loads:
        if isinstance(load, PrescribedMotion):
            nodes = cloud.group(load.group)
            held = nodes[kind[nodes] != FREE]
            if held.size:
                raise InputError(
                    f"PrescribedMotion on group {load.group!r}: its nodes {first_few(held)} are already fixed or driven"
                )
            kind[nodes] = PRESCRIBED
            prescribed_until[nodes] = load.until * (1 + 1e-9)
            supports[load.group] = nodes
            prescribed.append(nodes)
            motions.append((load, slice(count, count + len(nodes))))
            count += len(nodes)
        elif isinstance(load, SurfaceForce):
            nodes = cloud.group(load.group)
            areas = cloud.area_vectors(load.group) if areas_of is None else areas_of(load)
            shares = np.linalg.norm(areas, axis=1)
            if load.pressure is None:
                shares /= shares.sum()
                forces.append((nodes, shares, _moment_shares(load, cloud.points[nodes], shares)))
            else:
                pressures.append((nodes, areas))
        elif isinstance(load, Foundation):
            nodes, areas = cloud.group(load.group), foundation_areas(cloud, load)
            foundations.append((nodes, load.stiffness * areas, load.damping * areas))
        elif not isinstance(load, Gravity | Contact):
            raise InputError(
                f"{load!r} is not a load: use Traction, Gravity, PrescribedMotion, Grasp, Contact or Foundation"
            )
    for load in loads:
        if isinstance(load, SurfaceForce) and np.all(kind[cloud.group(load.group)] != FREE):
            raise InputError(f"Traction on group {load.group!r}: all of it is fixed or driven; load another group")
    if np.all(kind != FREE):
        names = ", ".join(map(repr, supports))
        raise InputError(f"all {len(cloud)} nodes are fixed or driven by {names}: none is left to move")
    empty = np.zeros(0, dtype=np.int64)
    places = LoadSites(
        kind,
        np.cumsum([0, *(len(n) for n, _, _ in forces)]),
        np.concatenate([empty, *(n for n, _, _ in forces)]),
        np.concatenate([np.zeros(0), *(s for _, s, _ in forces)]),
        np.concatenate([np.zeros((0, 3, 3)), *(m for _, _, m in forces)]),
        np.cumsum([0, *(len(n) for n, _ in pressures)]),
        np.concatenate([empty, *(n for n, _ in pressures)]),
        np.concatenate([np.zeros((0, 3)), *(a for _, a in pressures)]),
        np.concatenate([empty, *prescribed]),
        np.zeros((count, 3)),
        np.concatenate([empty, *(n for n, _, _ in foundations)]),
        np.concatenate([np.zeros(0), *(k for _, k, _ in foundations)]),
        np.concatenate([np.zeros(0), *(d for _, _, d in foundations)]),
    )
    tools = [load for load in loads if isinstance(load, Contact)]
    for tool in tools:
        if tool.name in supports:
            raise InputError(f"Contact {tool.name!r}: a support or a driven group has that name; choose another")
    touching = contacts(tools, cloud, prescribed_until, patches)
    return PreparedLoads(loads, places, supports, cloud.points, touching, tuple(motions), grasps)
