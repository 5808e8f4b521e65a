"""Compiled geometry of rigid tools and contact patches: distances, velocities and Coulomb's law.

A patch i is at X_i + sum of w_ij u_j: a node itself, or in the energy form the surface around it
(`palpate.meshfree.patches`). After the patches of the nodes come those of the edge midpoints of
surface triangles, with the means of the weights of their ends: between nodes that a tool spreads
apart, no small tool can pass. An edge midpoint may be as deep in a tool as the chord of its edge at rest, so
that it carries no force before its edge stretches. Functions of a point take coordinates and are
independent of the discretisation. The impulses of a step are in `palpate.dynamics.contact.impulses`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.compiled.reference import reference
from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.dynamics.contact.blade_sites import BladeSites, no_sites
from palpate.dynamics.contact.kinds import BLADE, BONDED, CAPSULE, PLANE, PUNCH
from palpate.dynamics.contact.tools import Contact
from palpate.meshfree.cloud import Cloud

CONTACT_GAP = {"nodes": 1e-6, "patches": 1e-3}  # gap of a node or patch in contact, in spacings
PATCH_OVERLAP = 0.05  # depth of a patch in a tool, in spacings; runs, whose tools begin outside, have less
SEARCH_GAP = 0.1  # gap of a patch that is included in the sweeps, in spacings
PATCH_RADIUS = 3.0  # largest distance of a patch from its node, in spacings
SLIDING_RESISTANCE = 20.0  # of a held node, in masses times the speed of the fastest waves over the spacing


class HeldNodes(NamedTuple):
    """Nodes that supports hold in all directions, and the forces of tools on them."""

    nodes: Ints  # (h,) int array
    points: Floats  # (h, 3) array [m]
    # stiffness, impedance: (h,) arrays [N/m], [N s/m]
    stiffness: Floats
    impedance: Floats
    reach: NDArray[np.bool_]  # (t, h) bool array: whether a tool acts on a node
    forces: Floats  # (h, 3) array [N]: mean forces in the last step
    impulses: Floats  # (h, 3) array [N s]: their impulses since the start of a call
    energy: Floats  # (t,) array [J]: of the tissue over the supports under each tool after the last step
    pushes: Floats  # (t,) array [N]: sums of the sizes of each tool's forces on held nodes in the last step


class ToolShapes(NamedTuple):
    """Shapes of t rigid tools."""

    kind: NDArray[np.int64]  # (t,) array: shape of every tool
    sizes: Floats  # (t, 3) array [m]
    friction: Floats  # (t,) array
    curvature: Floats  # (t,) array [1/m]: largest curvature of every tool
    radius: Floats  # (t,) array [m]: radius about its origin that contains a tool


class Patches(NamedTuple):
    """Patches: p of the n nodes and of the edge midpoints of the surface, as weighted means of nodes."""

    points: Floats  # (p, 3) array [m]: reference positions
    # (p, 2) array: nodes at the ends of every patch's edge; for the patch of a node twice the node
    ends: NDArray[np.int64]
    lengths: Floats  # (p,) array [m]: lengths of these edges at rest
    start: NDArray[np.int64]  # (p + 1,) array: first entry of every patch in the next two arrays
    # nodes, weights: (c,) arrays: nodes of the patches and their weights
    nodes: NDArray[np.int64]
    weights: Floats
    prescribed_until: Floats  # (p,) array [s]: time until which a patch is constrained
    slide_of: NDArray[np.int64]  # (n,) array: index in `slide` of a node that slides on a support; -1 for others
    slide: Floats  # (r, 3, 3) array: projections on the directions in which sliding nodes are free
    radius: float  # [m]: largest distance of a patch from its node
    gain: float  # largest displacement of a patch over that of its nodes: the largest sum of absolute weights


class Candidates(NamedTuple):
    """Pairs of a tool and a patch that the tool can reach, k in all."""

    start: NDArray[np.int64]  # (t + 1,) array: first candidate of every tool, and their number
    # patch, tool: (k,) arrays: patch and tool of every candidate
    patch: NDArray[np.int64]
    tool: NDArray[np.int64]


class Gaps(NamedTuple):
    """Gaps [m] between a tool and a patch."""

    overlap: float  # depth of a patch in a tool beyond which it is not pushed out in a single step
    contact: float  # gap below which a patch is in contact at the end of a call
    search: float  # gap below which a patch is included in the sweeps


class ContactWork(NamedTuple):
    """What the steps of a call change."""

    frames: Floats  # (t, 2, 3, 4) array: rotations and positions of the tools before and after a step
    # (t,) array: number of candidates of every tool that are near it, so that a step looks at them; by default all
    near_count: NDArray[np.int64]
    near: NDArray[np.int64]  # (k,) array: the near candidates of every tool in order, from its first candidate on
    active_count: NDArray[np.int64]  # (1,) array: number of active candidates, within `Gaps.search`
    active: NDArray[np.int64]  # (k,) array: the active candidates
    patch_impulses: Floats  # (k, 4) array: impulses of the candidates [N s] and 1 / m [1/kg]; zero unless active
    # (k, 4) array [m]: positions of the active candidates at the start of a step, and the gaps that they may keep in it
    places: Floats
    inverse_mass: Floats  # (n,) array [1/kg]: 1 / mass of the nodes near the active patches; zero for constrained nodes
    step_impulses: Floats  # (n, 3) array [N s]: nodal impulses of the present step
    nodal_impulses: Floats  # (n, 3) array [N s]: nodal impulses since the start of a call
    # (t, 6) array [N s], [N m s]: impulse of every tool on the body and its moment about the tool's origin, since the
    # start of a call
    tool_impulses: Floats


class Contacts(NamedTuple):
    """Rigid tools and contact patches, for the compiled step."""

    tools: ToolShapes
    patches: Patches
    candidates: Candidates
    gaps: Gaps
    work: ContactWork
    held: HeldNodes
    sites: BladeSites


HELD_SCRATCH = ("forces", "impulses", "energy", "pushes")


def contact_work(candidates: Candidates, nodes: int) -> ContactWork:
    """Return work arrays for the candidates of a body with a number of nodes."""
    count, tools = len(candidates.patch), len(candidates.start) - 1
    return ContactWork(
        frames=np.zeros((tools, 2, 3, 4)),
        near_count=np.diff(candidates.start),
        near=np.arange(count),
        active_count=np.zeros(1, dtype=np.int64),
        active=np.zeros(count, dtype=np.int64),
        patch_impulses=np.zeros((count, 4)),
        places=np.zeros((count, 4)),
        inverse_mass=np.zeros(nodes),
        step_impulses=np.zeros((nodes, 3)),
        nodal_impulses=np.zeros((nodes, 3)),
        tool_impulses=np.zeros((tools, 6)),
    )


def with_scratch(contacts: Contacts) -> Contacts:
    """Return the same tools and patches with new work arrays."""
    held = contacts.held._replace(**{name: np.zeros_like(getattr(contacts.held, name)) for name in HELD_SCRATCH})
    sites = contacts.sites._replace(impulses=np.zeros_like(contacts.sites.impulses), works=np.zeros(2))
    work = contact_work(contacts.candidates, len(contacts.work.inverse_mass))
    return contacts._replace(work=work, held=held, sites=sites)


def held_nodes(nodes: Ints, points: Floats, masses: Floats, rate: float, reach: NDArray[np.bool_]) -> HeldNodes:
    """Return held nodes (h,) at points (h, 3) [m] with masses (h,) [kg], without forces.

    `rate` [1/s] is the speed of the fastest waves over the spacing; `reach` is a mask (t, h).
    """
    return HeldNodes(
        nodes=nodes,
        points=np.ascontiguousarray(points),
        stiffness=masses * rate**2,
        impedance=SLIDING_RESISTANCE * masses * rate,
        reach=np.ascontiguousarray(reach),
        forces=np.zeros((len(nodes), 3)),
        impulses=np.zeros((len(nodes), 3)),
        energy=np.zeros(len(reach)),
        pushes=np.zeros(len(reach)),
    )


@kernel_njit(forceinline=True)
def project(slide, k, x, y, z):
    """Return a vector projected on the free directions of sliding node k; for k = -1 the vector itself."""
    if k < 0:
        return x, y, z
    return (
        slide[k, 0, 0] * x + slide[k, 0, 1] * y + slide[k, 0, 2] * z,
        slide[k, 1, 0] * x + slide[k, 1, 1] * y + slide[k, 1, 2] * z,
        slide[k, 2, 0] * x + slide[k, 2, 1] * y + slide[k, 2, 2] * z,
    )


@kernel_njit()
def signed_distance(kind, sizes, x, y, z):
    """Return a point's distance [m] to the surface of a tool, in its frame, negative inside, and the outward normal."""
    if kind == PLANE:
        return z, 0.0, 0.0, 1.0
    if kind == CAPSULE:
        z -= min(max(z, -sizes[1]), sizes[1])
        length = np.sqrt(x * x + y * y + z * z)
        if length == 0.0:  # on the axis: any direction across it
            return -sizes[0], 1.0, 0.0, 0.0
        return length - sizes[0], x / length, y / length, z / length
    across = np.sqrt(x * x + y * y)
    ux, uy = (x / across, y / across) if across > 0.0 else (1.0, 0.0)
    # distances beyond the inner cylinder, which is smaller by the rounding
    a, b = across - (sizes[0] - sizes[2]), sizes[2] - z
    if a > 0.0 and b > 0.0:
        length = np.sqrt(a * a + b * b)
        return length - sizes[2], a / length * ux, a / length * uy, -b / length
    if a > b:
        return a - sizes[2], ux, uy, 0.0
    return b - sizes[2], 0.0, 0.0, -1.0


@kernel_njit()
def rotation(pose, frame):
    """Write the rotation matrix and the position of a pose (7,) into a frame (3, 4)."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    frame[0, 0], frame[0, 1], frame[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    frame[1, 0], frame[1, 1], frame[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    frame[2, 0], frame[2, 1], frame[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    frame[0, 3], frame[1, 3], frame[2, 3] = pose[0], pose[1], pose[2]


@kernel_njit()
def gap(kind, sizes, frame, x, y, z):
    """Return the signed distance [m] and outward normal of a point in space, as `signed_distance`."""
    x, y, z = x - frame[0, 3], y - frame[1, 3], z - frame[2, 3]
    g, a, b, c = signed_distance(
        kind,
        sizes,
        frame[0, 0] * x + frame[1, 0] * y + frame[2, 0] * z,
        frame[0, 1] * x + frame[1, 1] * y + frame[2, 1] * z,
        frame[0, 2] * x + frame[1, 2] * y + frame[2, 2] * z,
    )
    return (
        g,
        frame[0, 0] * a + frame[0, 1] * b + frame[0, 2] * c,
        frame[1, 0] * a + frame[1, 1] * b + frame[1, 2] * c,
        frame[2, 0] * a + frame[2, 1] * b + frame[2, 2] * c,
    )


@kernel_njit()
def material_velocity(before, after, step, x, y, z):
    """Return the mean velocity [m/s] of the tool's material point that ends a step at a point in space."""
    p = x - after[0, 3], y - after[1, 3], z - after[2, 3]
    a = after[0, 0] * p[0] + after[1, 0] * p[1] + after[2, 0] * p[2]
    b = after[0, 1] * p[0] + after[1, 1] * p[1] + after[2, 1] * p[2]
    c = after[0, 2] * p[0] + after[1, 2] * p[1] + after[2, 2] * p[2]
    return (
        (x - before[0, 3] - before[0, 0] * a - before[0, 1] * b - before[0, 2] * c) / step,
        (y - before[1, 3] - before[1, 0] * a - before[1, 1] * b - before[1, 2] * c) / step,
        (z - before[2, 3] - before[2, 0] * a - before[2, 1] * b - before[2, 2] * c) / step,
    )


@kernel_njit()
def coulomb(normal, friction, wx, wy, wz, nx, ny, nz):
    """Return the tangential impulse (3) for a normal impulse by Coulomb's law, both over the mass [m/s].

    The velocity `w` [m/s] is relative to the tool; its part along the unit normal `n` is ignored.
    """
    along = wx * nx + wy * ny + wz * nz
    wx, wy, wz = wx - along * nx, wy - along * ny, wz - along * nz
    speed = np.sqrt(wx * wx + wy * wy + wz * wz)
    if friction * normal >= speed:  # sticks
        return -wx, -wy, -wz
    share = friction * normal / speed
    return -share * wx, -share * wy, -share * wz


@kernel_njit()
def patch(patches, i, ahead, u, velocity):
    """Return the position (3) [m] of a patch after a time [s], and its velocity (3) [m/s]."""
    x, y, z = patches.points[i, 0], patches.points[i, 1], patches.points[i, 2]
    vx, vy, vz = 0.0, 0.0, 0.0
    for c in range(patches.start[i], patches.start[i + 1]):
        j, w = patches.nodes[c], patches.weights[c]
        x, y, z = x + w * u[j, 0], y + w * u[j, 1], z + w * u[j, 2]
        vx, vy, vz = vx + w * velocity[j, 0], vy + w * velocity[j, 1], vz + w * velocity[j, 2]
    return x + ahead * vx, y + ahead * vy, z + ahead * vz, vx, vy, vz


@kernel_njit()
def compute_patch_positions(contacts, u, positions):
    """Write the positions (k, 3) [m] of the first k patches for displacements u (n, 3) [m]."""
    patches = reference(contacts.patches)
    for i in range(positions.shape[0]):
        x, y, z, _, _, _ = patch(patches, i, 0.0, u, u)
        positions[i, 0], positions[i, 1], positions[i, 2] = x, y, z


@kernel_njit(forceinline=True)
def chord_depth(length, curvature):
    """Return the depth [m] of an edge midpoint between two points on a tool; at most a quarter of the edge."""
    return min(0.125 * length * length * curvature, 0.25 * length)


def curvatures(kinds: Ints, sizes: Floats) -> Floats:
    """Return the largest curvature [1/m] of tools (t,): of the rounding of a punch, zero for a plane."""
    radius = np.where(kinds == PUNCH, sizes[:, 2], sizes[:, 0])
    with np.errstate(divide="ignore"):
        return np.where(kinds == PLANE, 0.0, 1.0 / radius)


@kernel_njit(allocates=True)
def compute_gaps(kind, sizes, pose, positions, result):
    """Write the signed distances [m] of positions (k, 3) to a tool in a pose (7,)."""
    frame = np.zeros((3, 4))
    rotation(pose, frame)
    for i in range(positions.shape[0]):
        result[i] = gap(kind, sizes, frame, positions[i, 0], positions[i, 1], positions[i, 2])[0]


def contacts(
    loads: Sequence[Contact],
    cloud: Cloud,
    prescribed_until: Floats,
    sliding: tuple[NDArray[np.int64], Floats],
    patches: sparse.csr_array | None = None,
    removed: Ints | None = None,
    edges: Ints | None = None,
) -> Contacts:
    """Prepare rigid tools for a cloud.

    A node is constrained until the time `prescribed_until` (n,) [s]. `sliding` is the pair of `slide_of` (n,) and
    `slide` (r, 3, 3). `patches` (n, n) are the weights of the nodal displacements in those of the contact patches; by
    default the patches are the nodes. No tool reaches `removed` nodes. `edges` (e, 2) are pairs of surface nodes at
    whose midpoints tools meet patches, too.
    """
    _check_tools(loads, cloud)
    if patches is None and any(load.tool.kind == BLADE for load in loads):
        raise InputError("model of a Blade must be a Solid in the energy form, got another; use form='energy'")
    count, pairs = len(cloud) if loads else 0, np.zeros((0, 2), dtype=np.int64)
    if loads and edges is not None:
        pairs = np.asarray(edges, dtype=np.int64)
    table = sparse.csr_array(sparse.eye_array(count)) if patches is None else patches
    table = sparse.csr_array(sparse.vstack([table, 0.5 * (table[pairs[:, 0]] + table[pairs[:, 1]])]))
    points = np.pad(cloud.points, ((0, 0), (0, 3 - cloud.points.shape[1]))).astype(float)
    ends = np.concatenate([np.repeat(np.arange(len(points))[:, None], 2, axis=1), pairs])
    # with the interior nodes: a tool that presses deep acts on them below a stretched surface
    nodes = [_candidates(load, cloud, pairs, removed) for load in loads]
    sizes = np.array([load.tool.sizes for load in loads]).reshape(-1, 3)
    kind = np.array([load.tool.kind for load in loads], dtype=np.int64)
    candidates = Candidates(
        start=np.cumsum([0, *map(len, nodes)]),
        patch=np.concatenate([np.zeros(0, dtype=np.int64), *nodes]),
        tool=np.repeat(np.arange(len(loads)), [len(n) for n in nodes]),
    )
    none = np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0)
    return Contacts(
        tools=ToolShapes(
            kind=kind,
            sizes=sizes,
            friction=np.array([float(load.friction) for load in loads]),
            curvature=curvatures(kind, sizes),
            radius=np.where(kind == CAPSULE, sizes[:, 0] + sizes[:, 1], np.inf),
        ),
        patches=Patches(
            points=points[ends].mean(axis=1),
            ends=ends,
            lengths=np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1),
            start=table.indptr.astype(np.int64),
            nodes=table.indices.astype(np.int64),
            weights=np.asarray(table.data, dtype=float),
            prescribed_until=prescribed_until[ends].max(axis=1),
            slide_of=sliding[0],
            slide=sliding[1],
            radius=0.0 if patches is None else PATCH_RADIUS * cloud.spacing,
            gain=float(abs(table).sum(axis=1).max(initial=1.0)),
        ),
        candidates=candidates,
        gaps=Gaps(
            overlap=PATCH_OVERLAP * cloud.spacing,
            contact=CONTACT_GAP["nodes" if patches is None else "patches"] * cloud.spacing,
            search=SEARCH_GAP * cloud.spacing,
        ),
        work=contact_work(candidates, count),
        held=held_nodes(*none, 0.0, np.zeros((len(loads), 0), bool)),
        sites=no_sites(),
    )


def _candidates(load: Contact, cloud: Cloud, pairs: Ints, removed: Ints | None) -> NDArray[np.int64]:
    """Return the patches that a tool can reach; none for a blade, which touches its sites."""
    if load.tool.kind == BLADE:
        return np.zeros(0, dtype=np.int64)
    reached = np.zeros(len(cloud), dtype=bool)
    reached[slice(None) if load.group is None else cloud.group(load.group)] = True
    if removed is not None:
        reached[removed] = False
    return np.concatenate([np.flatnonzero(reached), len(cloud) + np.flatnonzero(reached[pairs].all(axis=1))])


def least_radius(cloud: Cloud) -> float:
    """Return the least radius [m] of a tool: runs of solids detect one between nodes, a sheet has no inner nodes."""
    return cloud.spacing * (1 if cloud.points.shape[1] == 3 else 2)


def _check_tools(loads: Sequence[Contact], cloud: Cloud) -> None:
    """Raise `InputError` for tools of one name, and for tools that could pass between nodes."""
    names = [load.name for load in loads]
    for load in loads:
        if names.count(load.name) > 1:
            raise InputError(f"name of every Contact must be unique, got {load.name!r} twice; choose another name")
        least = least_radius(cloud)
        if load.tool.kind not in (PLANE, BONDED, BLADE) and load.tool.sizes[0] < least:
            raise InputError(
                f"radius of Contact {load.name!r} must be at least {least:g} m for a spacing of {cloud.spacing:g} m, "
                f"got {load.tool.sizes[0]:g} m; use a larger tool or a finer spacing"
            )
