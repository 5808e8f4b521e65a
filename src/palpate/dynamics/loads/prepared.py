"""Loads prepared for a body: the arrays that compiled steps read, for a given cloud and support."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, TypeGuard

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.dynamics.contact.geometry import Contacts, contacts
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad, ForcePattern
from palpate.dynamics.loads.foundation import Foundation, foundation_areas
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.surface_force import SurfaceForce
from palpate.dynamics.loads.values import arrays_at, scalars_at, vectors_at
from palpate.faults import InputError, brief, first_few
from palpate.meshfree.cloud import Cloud

__all__ = [
    "FIXED",
    "FREE",
    "PRESCRIBED",
    "Load",
    "LoadHistory",
    "LoadSites",
    "PreparedLoads",
    "check_kinds",
    "is_pressure",
    "listed",
    "prepare_loads",
]

FREE, FIXED, PRESCRIBED = 0, 1, 2
Load = DeadLoad | Gravity | PrescribedMotion | Grasp | Contact | Foundation


def is_pressure(load: object) -> TypeGuard[SurfaceForce]:
    """Return True for a pressure, which follows the face of the deformed body."""
    return isinstance(load, SurfaceForce) and load.pressure is not None


class LoadHistory(NamedTuple):
    """Values of the loads at the times of some steps, for the compiled step."""

    gravity: Floats  # (s, 3)
    amplitudes: Floats  # (s, dead loads, a), zero beyond those of a load
    pressure: Floats  # (s, groups) [Pa]
    motion: Floats  # (s, driven nodes, 3) [m]
    holds: NDArray[np.bool_]  # (s, driven nodes) whether the tool still holds them
    poses: Floats  # (s, tools that may touch the body, 7) places [m] and quaternions
    times: Floats  # (s,) [s]


class LoadSites(NamedTuple):
    """Where loads act, for the compiled step."""

    kind: NDArray[np.uint8]  # (n,) FREE, FIXED or DRIVEN
    dead_start: NDArray[np.int64]  # (dead loads + 1,) first node of each, and the end
    dead_node: NDArray[np.int64]  # (k,)
    dead_pattern: Floats  # (k, a, 3) forces [N] of unit amplitudes
    pressure_start: NDArray[np.int64]
    pressure_node: NDArray[np.int64]
    pressure_area: Floats  # (k, 3) area vectors [m^2]
    prescribed: NDArray[np.int64]
    impulses: Floats  # (driven nodes, 3) [N s] that drive them, added up by the step
    foundation_node: NDArray[np.int64]
    foundation_spring: Floats  # (k,) [N/m]
    foundation_dashpot: Floats  # (k,) [N s/m]


@dataclass(frozen=True)
class PreparedLoads(Described):
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

    def _facts(self) -> list[Fact]:
        return [("nodes", len(self.points), ""), ("supports", list(self.supports), ""), ("loads", self.loads, "")]

    def schedule(self, times: Floats) -> LoadHistory:
        """Evaluate every load at the given times [s].

        Raises
        ------
        InputError
            A load's function returned the wrong shape or a value that is not finite.
        """
        gravity = np.zeros((len(times), 3))
        amplitudes, pressures = np.zeros((len(times), *self._dead_shape)), []
        for g, dead in enumerate(self.dead):
            own = dead.amplitudes(times)
            amplitudes[:, g, : own.shape[1]] = own
        for load in self.loads:
            if isinstance(load, Gravity):
                gravity += vectors_at(load.acceleration, times, "acceleration of Gravity")
            elif is_pressure(load):
                pressures.append(scalars_at(load.pressure or 0.0, times, f"pressure of SurfaceForce on {load.group!r}"))
        motion = np.zeros((len(times), len(self.places.prescribed), 3))
        holds = np.ones(motion.shape[:2], dtype=np.bool_)
        for prescribed, where in self.motions:
            holds[:, where] = prescribed.holds(times)[:, None]
            points, displacement = self.points[self.places.prescribed[where]], prescribed.displacement
            name = f"displacement of PrescribedMotion of {prescribed.group!r}"
            last = np.minimum(times, prescribed.until)
            values = [displacement(points, float(t)) if callable(displacement) else displacement for t in last]
            if np.shape(values[0]) == (3,):
                motion[:, where] = arrays_at(values, (3,), times, name)[:, None]
            else:
                motion[:, where] = arrays_at(values, (len(points), 3), times, name)
        return LoadHistory(
            gravity,
            amplitudes,
            np.stack(pressures, axis=1) if pressures else np.zeros((len(times), 0)),
            motion,
            holds,
            np.stack([tool.poses(times) for tool in self.tools], axis=1)
            if self.tools
            else np.zeros((len(times), 0, 7)),
            np.asarray(times, dtype=float),
        )

    @cached_property
    def dead(self) -> tuple[DeadLoad, ...]:
        """Dead loads, in the order of `LoadSites.dead_start`."""
        return tuple(load for load in self.loads if isinstance(load, DeadLoad) and not is_pressure(load))

    @property
    def _dead_shape(self) -> tuple[int, int]:
        return len(self.dead), self.places.dead_pattern.shape[1]

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


def _padded(forces: Floats, amplitudes: int) -> Floats:
    """Return the forces (k, a, 3) of unit amplitudes with zeros for further amplitudes."""
    return np.pad(forces, ((0, 0), (0, amplitudes - forces.shape[1]), (0, 0)))


def listed(loads: Any) -> tuple[Load, ...]:
    """Return loads as a tuple.

    Raises
    ------
    InputError
        A load that is not in a list, or an entry that is no load.
    """
    if isinstance(loads, Load):
        raise InputError(f"loads must be a list, got one {type(loads).__name__}; put it in brackets, such as [pull]")
    if isinstance(loads, str | bytes | Mapping) or not isinstance(loads, Iterable):
        raise InputError(f"loads must be a list of loads, got {brief(loads)}; use such as [Traction(...), Gravity()]")
    listed = tuple(loads)
    for load in listed:
        if not isinstance(load, Load):
            raise InputError(
                f"loads must be Traction, Gravity, PrescribedMotion, Grasp, Contact or Foundation, got {brief(load)}; "
                "replace or remove it"
            )
    return listed


def check_kinds(loads: Sequence[Load], allowed: tuple[type, ...], what: str) -> None:
    """Refuse loads of other kinds than those that a model has forces for.

    Parameters
    ----------
    loads : sequence of loads
    allowed : tuple of types
    what : str
        The argument, and of which model, for the message.

    Raises
    ------
    InputError
        Names the first load of another kind.
    """
    for load in loads:
        if not isinstance(load, allowed):
            names = ", ".join("SurfaceForce" if kind is DeadLoad else kind.__name__ for kind in allowed)
            raise InputError(f"{what} must be one of {names}, got {brief(load)}; run the full model with it")


def prepare_loads(
    cloud: Cloud,
    fixed: Sequence[str],
    loads: Sequence[Load],
    areas_of: Callable[[DeadLoad], Floats] | None = None,
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
    loads = listed(loads)
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
    dead: list[ForcePattern] = []
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
        elif isinstance(load, DeadLoad):
            areas = cloud.area_vectors(load.group) if areas_of is None else areas_of(load)
            if is_pressure(load):
                pressures.append((cloud.group(load.group), areas))
            else:
                dead.append(load.pattern(cloud, areas))
        elif isinstance(load, Foundation):
            nodes, areas = cloud.group(load.group), foundation_areas(cloud, load)
            foundations.append((nodes, load.stiffness * areas, load.damping * areas))
    for load in loads:
        if isinstance(load, DeadLoad) and np.all(kind[cloud.group(load.group)] != FREE):
            raise InputError(
                f"group of {type(load).__name__} must have free nodes, got {load.group!r}, which is all fixed or "
                "prescribed; load another group"
            )
    if np.all(kind != FREE):
        names = ", ".join(map(repr, supports))
        raise InputError(f"all {len(cloud)} nodes are fixed or driven by {names}: none is left to move")
    empty = np.zeros(0, dtype=np.int64)
    most = max((own.forces.shape[1] for own in dead), default=0)
    places = LoadSites(
        kind,
        np.cumsum([0, *(len(own.nodes) for own in dead)]),
        np.concatenate([empty, *(own.nodes for own in dead)]),
        np.concatenate([np.zeros((0, most, 3)), *(_padded(own.forces, most) for own in dead)]),
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
