"""Rigid tools and what they touch, compiled: distances, velocities, Coulomb's law, and the patches of a surface.

A patch i is at X_i + sum of w_ij u_j: a node itself, or in the energy form the surface around it
(`palpate.meshfree.patches`). Functions of a point take coordinates, not clouds, and know nothing of a discretisation.
The impulses of a step are in `palpate.dynamics.contact.impulses`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.contact.tools import BONDED, CAPSULE, PLANE, Contact
from palpate.faults import InputError
from palpate.meshfree.cloud import Cloud

__all__ = [
    "Contacts",
    "contacts",
    "coulomb",
    "gap",
    "gaps",
    "material_velocity",
    "patch",
    "patch_places",
    "rotation",
    "signed_distance",
]

TOUCHING = 1e-6, 1e-3  # of the spacing: gap below which a node, or a patch, counts as touching at the end of a step
CLOSE = 0.1  # of the spacing: gap below which a patch is asked in every sweep
SPREAD = 3.0  # spacings from a node within which its patch is sought


class Contacts(NamedTuple):
    """Tools and the patches that they can touch, for the compiled step."""

    kind: NDArray[np.int64]  # (t,) of the shapes
    sizes: Floats  # (t, 3) [m]
    friction: Floats  # (t,)
    start: NDArray[np.int64]  # (t + 1,)
    nodes: NDArray[np.int64]  # (k,)
    points: Floats  # (n, 3) reference places [m]
    first: NDArray[np.int64]  # (n + 1,) of the nodes that carry each node's patch
    near: NDArray[np.int64]  # (c,)
    weights: Floats  # (c,)
    prescribed_until: Floats  # (n,) time [s] until which a node is held, and not pushed by tools
    tolerance: float  # gap [m] below which a patch counts as touching
    close: float  # gap [m] below which it is asked in every sweep
    spread: float  # how far [m] from its node a patch is sought
    frames: Floats  # (t, 2, 3, 4) rotations and places of the tools before and after a step
    bounds: Floats  # (t,) radius [m] about the origin beyond which a tool does not reach
    tool: NDArray[np.int64]  # (k,) that may touch the node
    found: NDArray[np.int64]  # (1,) how many nodes there are whose patches are close to a tool
    active: NDArray[np.int64]  # (k,) which these are
    pushes: Floats  # (k, 4) their impulses [N s], and 1 / m [1/kg]; zero for all others
    rate: Floats  # (n,) 1 / mass of the nodes near them [1/kg], zero where they are held
    impulse: Floats  # (n, 3) of the present step, by node [N s]
    given: Floats  # (n, 3) impulse by node [N s], since a call began
    total: Floats  # (t, 6) impulse [N s] and its moment about the tool's origin [N m s] on the body, since a call began


@kernel_njit()
def signed_distance(kind, sizes, x, y, z):  # type: ignore[no-untyped-def]
    """Return the distance [m] of a point in the tool's frame to its surface, negative inside, and the outward normal.

    Returns
    -------
    tuple of four floats
        Distance and the normal's three components.
    """
    if kind == PLANE:
        return z, 0.0, 0.0, 1.0
    if kind == CAPSULE:
        z -= min(max(z, -sizes[1]), sizes[1])
        length = np.sqrt(x * x + y * y + z * z)
        if length == 0.0:  # on the axis: some direction across it
            return -sizes[0], 1.0, 0.0, 0.0
        return length - sizes[0], x / length, y / length, z / length
    across = np.sqrt(x * x + y * y)
    ux, uy = (x / across, y / across) if across > 0.0 else (1.0, 0.0)
    # how far beyond the inner cylinder, smaller by the rounding, the point is
    a, b = across - (sizes[0] - sizes[2]), sizes[2] - z
    if a > 0.0 and b > 0.0:
        length = np.sqrt(a * a + b * b)
        return length - sizes[2], a / length * ux, a / length * uy, -b / length
    if a > b:
        return a - sizes[2], ux, uy, 0.0
    return b - sizes[2], 0.0, 0.0, -1.0


@kernel_njit()
def rotation(pose, frame):  # type: ignore[no-untyped-def]
    """Write the rotation matrix and the place of a pose (7,) into a frame (3, 4)."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    frame[0, 0], frame[0, 1], frame[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    frame[1, 0], frame[1, 1], frame[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    frame[2, 0], frame[2, 1], frame[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    frame[0, 3], frame[1, 3], frame[2, 3] = pose[0], pose[1], pose[2]


@kernel_njit()
def gap(kind, sizes, frame, x, y, z):  # type: ignore[no-untyped-def]
    """Return signed distance [m] and outward normal, as `signed_distance`, of a point in space to a tool in a frame."""
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
def material_velocity(before, after, step, x, y, z):  # type: ignore[no-untyped-def]
    """Return the mean velocity [m/s] over a step of the tool's matter that ends the step at a point in space."""
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
def coulomb(normal, friction, wx, wy, wz, nx, ny, nz):  # type: ignore[no-untyped-def]
    """Return the tangential part (3) that goes with a normal impulse, by Coulomb's law.

    Parameters
    ----------
    normal : float
        Impulse along the normal, in units of the velocity: over the mass.
    friction : float
    wx, wy, wz : float [m/s]
        Velocity against the tool's; only its part across the normal counts.
    nx, ny, nz : float
        Unit normal.
    """
    along = wx * nx + wy * ny + wz * nz
    wx, wy, wz = wx - along * nx, wy - along * ny, wz - along * nz
    speed = np.sqrt(wx * wx + wy * wy + wz * wz)
    if friction * normal >= speed:  # sticks
        return -wx, -wy, -wz
    share = friction * normal / speed
    return -share * wx, -share * wy, -share * wz


@kernel_njit()
def patch(points, first, near, weights, i, ahead, u, velocity):  # type: ignore[no-untyped-def]
    """Return the place (3) [m] of a patch some time ahead [s], and its velocity (3) [m/s]."""
    x, y, z = points[i, 0], points[i, 1], points[i, 2]
    vx, vy, vz = 0.0, 0.0, 0.0
    for c in range(first[i], first[i + 1]):
        j, w = near[c], weights[c]
        x, y, z = x + w * u[j, 0], y + w * u[j, 1], z + w * u[j, 2]
        vx, vy, vz = vx + w * velocity[j, 0], vy + w * velocity[j, 1], vz + w * velocity[j, 2]
    return x + ahead * vx, y + ahead * vy, z + ahead * vz, vx, vy, vz


@kernel_njit()
def patch_places(contacts, u, places):  # type: ignore[no-untyped-def]
    """Write the places (n, 3) [m] of all patches for displacements u (n, 3) [m]."""
    for i in range(u.shape[0]):
        x, y, z, _, _, _ = patch(contacts.points, contacts.first, contacts.near, contacts.weights, i, 0.0, u, u)
        places[i, 0], places[i, 1], places[i, 2] = x, y, z


@kernel_njit()
def gaps(kind, sizes, pose, places, result):  # type: ignore[no-untyped-def]
    """Write the signed distances [m] of places (k, 3) to a tool in a pose (7,)."""
    frame = np.zeros((3, 4))
    rotation(pose, frame)
    for i in range(places.shape[0]):
        result[i] = gap(kind, sizes, frame, places[i, 0], places[i, 1], places[i, 2])[0]


def contacts(
    loads: Sequence[Contact], cloud: Cloud, prescribed_until: Floats, patches: sparse.csr_array | None = None
) -> Contacts:
    """Make tools ready for a cloud.

    Parameters
    ----------
    loads : sequence of Contact
    cloud : Cloud
    prescribed_until : (n,) array [s]
        When tools that hold nodes let go.
    patches : csr_array, optional
        (n, n) weights of the nodes in the displacements of the patches that tools touch; by default the nodes.

    Raises
    ------
    InputError
        An unknown group, two tools of one name, or a tool that could slip between the nodes.
    """
    names = [load.name for load in loads]
    for load in loads:
        if names.count(load.name) > 1:
            raise InputError(f"two tools are named {load.name!r}: give every Contact a name of its own")
        radius = load.tool.sizes[0]
        # a solid's run notices a tool between its nodes; a membrane has no inside
        if load.tool.kind not in (PLANE, BONDED) and radius < cloud.spacing * (1 if cloud.points.shape[1] == 3 else 2):
            raise InputError(
                f"Contact {load.name!r}: a radius of {radius:g} m could slip between nodes {cloud.spacing:g} m apart; "
                "use a larger tool or a finer spacing"
            )
    # those inside too: a tool that presses deep meets them below a stretched surface
    nodes = [np.arange(len(cloud)) if load.group is None else cloud.group(load.group) for load in loads]
    points = np.pad(cloud.points, ((0, 0), (0, 3 - cloud.points.shape[1])))
    sizes = np.array([load.tool.sizes for load in loads]).reshape(-1, 3)
    kind = np.array([load.tool.kind for load in loads], dtype=np.int64)
    count, held, sizes_of = len(loads), len(cloud) if loads else 0, [len(n) for n in nodes]
    table = sparse.csr_array(sparse.eye_array(held)) if patches is None else patches
    return Contacts(
        kind,
        sizes,
        np.array([float(load.friction) for load in loads]),
        np.cumsum([0, *sizes_of]),
        np.concatenate([np.zeros(0, dtype=np.int64), *nodes]),
        np.ascontiguousarray(points, dtype=float),
        table.indptr.astype(np.int64),
        table.indices.astype(np.int64),
        np.asarray(table.data, dtype=float),
        prescribed_until,
        TOUCHING[patches is not None] * cloud.spacing,
        CLOSE * cloud.spacing,
        0.0 if patches is None else SPREAD * cloud.spacing,
        np.zeros((count, 2, 3, 4)),
        np.where(kind == CAPSULE, sizes[:, 0] + sizes[:, 1], np.inf),
        np.repeat(np.arange(count), sizes_of),
        np.zeros(1, dtype=np.int64),
        np.zeros(sum(sizes_of), dtype=np.int64),
        np.zeros((sum(sizes_of), 4)),
        np.zeros(held),
        np.zeros((held, 3)),
        np.zeros((held, 3)),
        np.zeros((count, 6)),
    )
