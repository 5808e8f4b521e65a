"""Loads prepared for a cloud and its supports, as arrays for the compiled steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from inspect import isabstract
from itertools import pairwise
from typing import Any, NamedTuple, get_args

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, brief, first_few
from palpate.dynamics.contact.geometry import Contacts, contacts, held_nodes, with_scratch
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad, ForcePattern
from palpate.dynamics.loads.foundation import Foundation, foundation_areas
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.pressure import Pressure
from palpate.dynamics.loads.supports import (
    FIXED,
    FREE,
    PRESCRIBED,
    SLIDING,
    Support,
    SupportedNodes,
    constrained_directions,
    supported_nodes,
)
from palpate.dynamics.loads.surface_force import SurfaceForce
from palpate.dynamics.loads.values import arrays_at, vectors_at
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.patches import spread_load

SUPPORT_TOLERANCE = 1e-9  # largest prescribed displacement across a support, relative to the largest one
Load = DeadLoad | Pressure | Gravity | PrescribedMotion | Grasp | Contact | Foundation


class LoadHistory(NamedTuple):
    """Values of the loads at s times, for the compiled step."""

    gravity: Floats  # (s, 3) array [m/s^2]
    amplitudes: Floats  # (s, dead loads, a) array: amplitudes of the dead loads, padded with zeros
    pressure: Floats  # (s, pressures) array [Pa]
    motion: Floats  # (s, p, 3) array [m]: displacements of the prescribed nodes
    constrained: NDArray[np.bool_]  # (s, p) bool array: True while a prescribed node follows its motion
    poses: Floats  # (s, tools, 7) array: positions [m] and quaternions of the tools
    times: Floats  # (s,) array [s]


class LoadSites(NamedTuple):
    """Nodes of the loads and their constant factors, for the compiled step."""

    kind: NDArray[np.uint8]  # (n,) array: FREE, FIXED, PRESCRIBED or SLIDING
    sliding: NDArray[np.int64]  # (r,) array: nodes that slide on a support, also those that are prescribed
    slide: Floats  # (r, 3, 3) array: projections on the directions in which they are free
    slide_of: NDArray[np.int64]  # (n,) array: index of a node in `sliding`; -1 for others
    dead_start: NDArray[np.int64]  # (dead loads + 1,) array: first entry of every dead load, and the number of entries
    dead_node: NDArray[np.int64]  # (k,) array
    dead_pattern: Floats  # (k, a, 3) array: forces [N] of unit amplitudes
    # pressure_start, pressure_node: arrays: as for the dead loads
    pressure_start: NDArray[np.int64]
    pressure_node: NDArray[np.int64]
    pressure_area: Floats  # (k, 3) array [m^2]: area vectors
    prescribed: NDArray[np.int64]  # (p,) array: nodes of prescribed motion
    impulses: Floats  # (p, 3) array [N s]: impulses on the prescribed nodes, summed by the step
    foundation_node: NDArray[np.int64]  # (k,) array
    foundation_spring: Floats  # (k,) array [N/m]
    foundation_dashpot: Floats  # (k,) array [N s/m]


@dataclass(frozen=True)
class PreparedLoads(Described):
    """Loads prepared for a cloud and its supports.

    Parameters
    ----------
    loads : tuple of loads
    sites : LoadSites
    supports : mapping of group name to nodes
        Groups of supports and of prescribed motion, whose reaction forces are reported.
    points : (n, d) array [m]
    contacts : Contacts
    motions : tuple of pairs
        Prescribed motions, with their slices of `sites.prescribed`.
    grasps : tuple of str
        Names of the prescribed groups of a `Grasp`.
    directions : dict
        Constrained directions (k, 3) of the supports that leave their groups free in others.
    partitions : dict
        Partitions of unity by groups, computed on first use.
    removed : (r,) int array
        Nodes that left the body, for which no group bears a force.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> loads = bar.prepare([pull])
    >>> loads.loads == (pull,), sorted(loads.supports)
    (True, ['x-'])
    """

    _public = ()
    loads: tuple[Load, ...]
    sites: LoadSites
    supports: dict[str, NDArray[np.int64]]
    points: Floats
    contacts: Contacts
    motions: tuple[tuple[PrescribedMotion, slice], ...] = field(default=())
    grasps: tuple[str, ...] = ()
    directions: dict[str, Floats] = field(default_factory=dict, repr=False, compare=False)
    partitions: dict[tuple[str, ...], Any] = field(default_factory=dict, repr=False, compare=False)
    removed: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64), repr=False, compare=False)

    def is_prescribed(self, times: Floats) -> NDArray[np.bool_]:
        """Return whether the motion of groups is prescribed at some times [s], shape (t,); True without such groups."""
        return self.motions[0][0].is_active(times) if self.motions else np.ones(len(times), dtype=np.bool_)

    def with_scratch(self) -> tuple[LoadSites, Contacts]:
        """Return the sites and contacts with new scratch arrays, for one call of a step."""
        return self.sites._replace(impulses=np.zeros_like(self.sites.impulses)), with_scratch(self.contacts)

    def _facts(self) -> list[Fact]:
        return [("nodes", len(self.points), ""), ("supports", list(self.supports), ""), ("loads", self.loads, "")]

    def schedule(self, times: Floats) -> LoadHistory:
        """Evaluate the loads at some times [s].

        Raises
        ------
        InputError
            A load's function returned the wrong shape or a value that is not finite.
        """
        motion, constrained = self._motion(times)
        pressures = [load.values(times) for load in self.loads if isinstance(load, Pressure)]
        return LoadHistory(
            gravity=self._gravity(times),
            amplitudes=self._amplitudes(times),
            pressure=np.stack(pressures, axis=1) if pressures else np.zeros((len(times), 0)),
            motion=motion,
            constrained=constrained,
            poses=np.stack([tool.poses(times) for tool in self.tools], axis=1)
            if self.tools
            else np.zeros((len(times), 0, 7)),
            times=np.asarray(times, dtype=float),
        )

    def _gravity(self, times: Floats) -> Floats:
        gravity = np.zeros((len(times), 3))
        for load in self.loads:
            if isinstance(load, Gravity):
                gravity += vectors_at(load.acceleration, times, "acceleration of Gravity")
        return gravity

    def _amplitudes(self, times: Floats) -> Floats:
        amplitudes = np.zeros((len(times), len(self.dead_loads), self.sites.dead_pattern.shape[1]))
        for g, load in enumerate(self.dead_loads):
            values = load.amplitudes(times)
            amplitudes[:, g, : values.shape[1]] = values
        return amplitudes

    def _motion(self, times: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the displacements (s, p, 3) [m] of the prescribed nodes, and where they apply (s, p)."""
        motion = np.zeros((len(times), len(self.sites.prescribed), 3))
        constrained = np.ones(motion.shape[:2], dtype=np.bool_)
        for prescribed, where in self.motions:
            constrained[:, where] = prescribed.is_active(times)[:, None]
            points, displacement = self.points[self.sites.prescribed[where]], prescribed.displacement
            name = f"displacement of PrescribedMotion of {prescribed.group!r}"
            last = np.minimum(times, prescribed.until)
            values = [displacement(points, float(t)) if callable(displacement) else displacement for t in last]
            if np.shape(values[0]) == (3,):
                motion[:, where] = arrays_at(values, (3,), times, name)[:, None]
            else:
                motion[:, where] = arrays_at(values, (len(points), 3), times, name)
            self._check_sliding(prescribed, where, motion[:, where])
        return motion, constrained

    def _check_sliding(self, prescribed: PrescribedMotion, where: slice, motion: Floats) -> None:
        """Raise `InputError` if prescribed nodes (s, p, 3) leave the plane or line of their support."""
        sites, nodes = self.sites, self.sites.prescribed[where]
        on_support = np.flatnonzero(sites.slide_of[nodes] >= 0)
        if not on_support.size:
            return
        sliding = motion[:, on_support]
        error = sliding - np.einsum("pcd,spd->spc", sites.slide[sites.slide_of[nodes[on_support]]], sliding)
        largest = np.abs(error).max()
        if largest > SUPPORT_TOLERANCE * np.abs(motion).max(initial=0.0):
            raise InputError(
                f"displacement of PrescribedMotion of {prescribed.group!r} must stay on the supports of its nodes, got "
                f"{largest:.3g} m across them; move the group along its supports, or leave those nodes out"
            )

    @cached_property
    def dead_loads(self) -> tuple[DeadLoad, ...]:
        """Dead loads, in the order of `LoadSites.dead_start`."""
        return tuple(load for load in self.loads if isinstance(load, DeadLoad))

    @cached_property
    def tools(self) -> tuple[Contact, ...]:
        """Rigid tools that can come into contact with the body."""
        return tuple(load for load in self.loads if isinstance(load, Contact))

    def breakpoints(self, start: float, end: float) -> list[float]:
        """Return the times [s] after `start` at which prescribed motions end, and then `end`."""
        margin = 1e-9 * abs(end)
        return [*sorted({m.until for m, _ in self.motions if start + margin < m.until < end - margin}), end]

    def grasp_slices(self) -> dict[str, slice]:
        """Return the slice of `sites.prescribed` of every `Grasp`."""
        return {motion.group: where for motion, where in self.motions if motion.group in self.grasps}

    def constraint_mask(self, time: float) -> NDArray[np.bool_]:
        """Return True for the nodes that are fixed or prescribed in all directions at a time [s], shape (n,)."""
        mask = (self.sites.kind == FIXED) | (self.sites.kind == PRESCRIBED)
        for load, where in self.motions:
            if not load.is_active(np.array(time)):
                mask[self.sites.prescribed[where]] = False
        return mask

    def active_supports(self, time: float) -> dict[str, NDArray[np.int64]]:
        """Return the nodes of the supports and prescribed groups that are active at a time [s]."""
        released = {load.group for load, _ in self.motions if not load.is_active(np.array(time))}
        return {name: nodes for name, nodes in self.supports.items() if name not in released}

    @staticmethod
    def rates(values: Callable[[Floats], Floats], time: float, interval: float = 1e-4) -> tuple[Floats, Floats]:
        """Return first and second time derivatives of prescribed values.

        One-sided differences over `interval` [s] use past values only. At a jump of the motion or of
        its velocity they are the derivatives before the jump.
        """
        f3, f2, f1, now = values(time - interval * np.array([3.0, 2.0, 1.0, 0.0]))
        return (3 * now - 4 * f1 + f2) / (2 * interval), (2 * now - 5 * f1 + 4 * f2 - f3) / interval**2


class _Constraints(NamedTuple):
    """Supported nodes and prescribed motions."""

    kind: NDArray[np.uint8]  # (n,) FREE, FIXED, PRESCRIBED or SLIDING
    nodes: SupportedNodes
    supports: dict[str, NDArray[np.int64]]
    prescribed: NDArray[np.int64]  # (p,) nodes
    motions: tuple[tuple[PrescribedMotion, slice], ...]
    until: Floats  # (n,) time [s] until which a node is constrained


def listed(loads: Any) -> tuple[Load, ...]:
    """Return one load, or several, as a tuple."""
    if isinstance(loads, Load):
        return (loads,)
    if isinstance(loads, str | bytes | Mapping) or not isinstance(loads, Iterable):
        raise InputError(
            f"loads must be a load or a list of loads, got {brief(loads)}; use such as {SurfaceForce.__name__}(...)"
        )
    listed = tuple(loads)
    for load in listed:
        if not isinstance(load, Load):
            raise InputError(f"loads must be of {kind_names(get_args(Load))}, got {brief(load)}; replace or remove it")
    return listed


def kind_names(kinds: Sequence[type]) -> str:
    """Return the names of kinds of loads for a message; those of an abstract kind are its subclasses."""
    concrete = [name for kind in kinds for name in (kind.__subclasses__() if isabstract(kind) else [kind])]
    return ", ".join(kind.__name__ for kind in concrete)


def check_kinds(
    loads: Sequence[Load], allowed: tuple[type, ...], what: str, remedy: str = "run the full model with it"
) -> None:
    """Refuse loads of other kinds than those that a model has forces for.

    The message names the argument and the model by `what`, and what to do with such a load by `remedy`.
    """
    for load in loads:
        if not isinstance(load, allowed):
            raise InputError(f"{what} must be one of {kind_names(allowed)}, got {brief(load)}; {remedy}")


def prepare_loads(
    cloud: Cloud,
    supports: Sequence[Support],
    loads: Load | Sequence[Load],
    areas_of: Callable[[DeadLoad | Pressure], Floats] | None = None,
    patches: sparse.csr_array | None = None,
    removed: Ints | None = None,
    edges: Ints | None = None,
) -> PreparedLoads:
    """Prepare loads for a cloud with supports.

    `areas_of` returns the area vectors (g, 3) [m^2] of a load's group; by default those of the cloud's faces. `patches`
    (n, n) are the weights of the nodal displacements in those of the contact patches; by default the patches are the
    nodes. `removed` nodes left the body: they are fixed, and no tool reaches them. `edges` (e, 2) are pairs of surface
    nodes at whose midpoints tools meet patches, too.
    """
    loads = listed(loads)
    grasps = tuple(load.name for load in loads if isinstance(load, Grasp))
    for load in loads:
        cloud = load.with_group(cloud) if isinstance(load, Grasp) else cloud
    loads = tuple(
        PrescribedMotion(load.name, load.displacement, load.until) if isinstance(load, Grasp) else load
        for load in loads
    )
    gone = np.zeros(0, dtype=np.int64) if removed is None else removed
    constraints = _constraints(cloud, supports, loads, gone)
    sites = _load_sites(cloud, loads, constraints, areas_of)
    _check_free_nodes(cloud, loads, constraints)
    tools = [load for load in loads if isinstance(load, Contact)]
    for tool in tools:
        if tool.name in constraints.supports:
            raise InputError(
                f"name of Contact must differ from supports and prescribed groups, got {tool.name!r}; choose another"
            )
    return PreparedLoads(
        loads=loads,
        sites=sites,
        supports=constraints.supports,
        points=cloud.points,
        contacts=contacts(tools, cloud, constraints.until, (sites.slide_of, sites.slide), patches, gone, edges),
        motions=constraints.motions,
        grasps=grasps,
        directions=constrained_directions(cloud, supports),
        removed=gone,
    )


def with_held_nodes(prepared: PreparedLoads, masses: Floats, rate: float) -> PreparedLoads:
    """Return prepared loads whose tools also press on the nodes that supports hold in all directions.

    `masses` are (n,) [kg]; `rate` [1/s] is the speed of the fastest waves over the spacing.
    """
    contacts, nodes = prepared.contacts, np.flatnonzero(prepared.sites.kind == FIXED)
    if not prepared.tools or not len(nodes):
        return prepared
    nodes_of_tools = [contacts.candidates.patch[begin:end] for begin, end in pairwise(contacts.candidates.start)]
    reach = np.array([np.isin(nodes, each) for each in nodes_of_tools])
    records = held_nodes(nodes, contacts.patches.points[nodes], masses[nodes], rate, reach)
    return replace(prepared, contacts=contacts._replace(held=records))


def _constraints(cloud: Cloud, supports: Sequence[Support], loads: Sequence[Load], removed: Ints) -> _Constraints:
    """Return the constraints of supports and prescribed motions; raise `InputError` for overlaps."""
    groups = {support.group: cloud.group(support.group) for support in supports}
    supported = supported_nodes(cloud, supports)
    kind = supported.kind.copy()
    kind[removed] = FIXED
    until = np.where(kind == FIXED, np.inf, -np.inf)
    prescribed, motions, count = [np.zeros(0, dtype=np.int64)], [], 0
    for load in loads:
        if not isinstance(load, PrescribedMotion):
            continue
        nodes = cloud.group(load.group)
        gone = np.intersect1d(nodes, removed)
        if gone.size:
            raise InputError(
                f"group of PrescribedMotion must have no removed nodes, got {load.group!r}, whose nodes "
                f"{first_few(gone)} are of a piece that was cut off; cut with detached='keep', or use another group"
            )
        taken = nodes[(kind[nodes] == FIXED) | (kind[nodes] == PRESCRIBED)]
        if taken.size:
            raise InputError(
                f"group of PrescribedMotion must have free nodes only, got {load.group!r}, whose nodes "
                f"{first_few(taken)} are already fixed or prescribed; use another group"
            )
        kind[nodes] = PRESCRIBED
        until[nodes] = load.until * (1 + 1e-9)
        groups[load.group] = nodes
        prescribed.append(nodes)
        motions.append((load, slice(count, count + len(nodes))))
        count += len(nodes)
    return _Constraints(kind, supported, groups, np.concatenate(prescribed), tuple(motions), until)


def _load_sites(
    cloud: Cloud,
    loads: Sequence[Load],
    constraints: _Constraints,
    areas_of: Callable[[DeadLoad | Pressure], Floats] | None,
) -> LoadSites:
    """Return the nodes and factors of dead loads, pressures and foundations."""
    dead: list[ForcePattern] = []
    pressures: list[tuple[NDArray[np.int64], Floats]] = []
    foundations: list[tuple[NDArray[np.int64], Floats, Floats]] = []
    for load in loads:
        if isinstance(load, DeadLoad | Pressure):
            areas = cloud.area_vectors(load.group) if areas_of is None else areas_of(load)
            if isinstance(load, Pressure):
                pressures.append(spread_load(cloud, cloud.group(load.group), areas))
            else:
                pattern = load.pattern(cloud, areas)
                dead.append(ForcePattern(*spread_load(cloud, pattern.nodes, pattern.forces)))
        elif isinstance(load, Foundation):
            nodes, shares = cloud.group(load.group), foundation_areas(cloud, load)
            foundations.append((nodes, load.stiffness * shares, load.damping * shares))
    no_nodes = np.zeros(0, dtype=np.int64)
    amplitudes = max((pattern.forces.shape[1] for pattern in dead), default=0)
    slide_of = np.full(len(cloud), -1, dtype=np.int64)
    slide_of[constraints.nodes.sliding] = np.arange(len(constraints.nodes.sliding))
    return LoadSites(
        kind=constraints.kind,
        sliding=constraints.nodes.sliding,
        slide=constraints.nodes.slide,
        slide_of=slide_of,
        dead_start=np.cumsum([0, *(len(pattern.nodes) for pattern in dead)]),
        dead_node=np.concatenate([no_nodes, *(pattern.nodes for pattern in dead)]),
        dead_pattern=np.concatenate(
            [np.zeros((0, amplitudes, 3)), *(_pad(pattern.forces, amplitudes) for pattern in dead)]
        ),
        pressure_start=np.cumsum([0, *(len(n) for n, _ in pressures)]),
        pressure_node=np.concatenate([no_nodes, *(n for n, _ in pressures)]),
        pressure_area=np.concatenate([np.zeros((0, 3)), *(a for _, a in pressures)]),
        prescribed=constraints.prescribed,
        impulses=np.zeros((len(constraints.prescribed), 3)),
        foundation_node=np.concatenate([no_nodes, *(n for n, _, _ in foundations)]),
        foundation_spring=np.concatenate([np.zeros(0), *(k for _, k, _ in foundations)]),
        foundation_dashpot=np.concatenate([np.zeros(0), *(d for _, _, d in foundations)]),
    )


def _pad(forces: Floats, amplitudes: int) -> Floats:
    """Pad the forces (k, a, 3) of unit amplitudes with zeros for further amplitudes."""
    return np.pad(forces, ((0, 0), (0, amplitudes - forces.shape[1]), (0, 0)))


def _check_free_nodes(cloud: Cloud, loads: Sequence[Load], constraints: _Constraints) -> None:
    """Raise `InputError` for a load on constrained nodes only, and for a body without free nodes."""
    kind = constraints.kind
    free = (kind == FREE) | (kind == SLIDING)
    for load in loads:
        if isinstance(load, DeadLoad | Pressure) and not free[cloud.group(load.group)].any():
            raise InputError(
                f"group of {type(load).__name__} must have free nodes, got {load.group!r}, which is all fixed or "
                "prescribed; load another group"
            )
    if not free.any():
        names = ", ".join(map(repr, constraints.supports))
        raise InputError(f"the body must have free nodes, got all {len(cloud)} nodes fixed or prescribed by {names}")
