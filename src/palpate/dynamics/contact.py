"""Contact of points with rigid tools, compiled: distances, Coulomb's law, and the impulses of one explicit step.

Nodes that would be inside a tool at the end of a step are put onto its surface by an impulse along its normal: the
forward increment Lagrange multipliers of Carpenter, Taylor and Katona (Int. J. Numer. Meth. Engng 32, 1991). Nothing
is penalised, so that no stiffness is chosen, no node enters a tool, and the stable step stays what it was. With the
normal impulse p the tangential one is what stops the sliding, but at most mu p (Coulomb).

In a step of length dt, with the velocity v after the kick by all other forces, the place x = X + u + dt v and the gap
g(x) < 0 to the tool where it will be,

    dv_n = - g / dt,    dv_t = - w_t min(1, mu dv_n / |w_t|),

w_t the sliding velocity against the tool's matter at that place. Impulses m (dv_n n + dv_t) on the nodes and their
opposites on the tool are the same numbers: momentum is exact. At the end of a call of some steps, nodes that touch a
tool must not move into it with their half kick; that is the same law for velocities.

Functions of a point take coordinates, not clouds, and know nothing of a discretisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.dynamics.tools import CAPSULE, PLANE, Contact, surface_nodes
from palpate.faults import InputError
from palpate.meshfree.cloud import Cloud

__all__ = ["Contacts", "contacts", "coulomb", "gap", "gaps", "material_velocity", "push", "rotation", "signed_distance"]

Floats = NDArray[np.float64]
TOUCHING = 1e-6  # of the spacing: gap below which a node counts as touching at the end of a step
SWEEPS = 3  # over the tools, where several may touch a node


class Contacts(NamedTuple):
    """Tools and the nodes that they can touch, for the compiled step."""

    kind: NDArray[np.int64]  # (t,) of the shapes
    sizes: Floats  # (t, 3) [m]
    friction: Floats  # (t,)
    start: NDArray[np.int64]  # (t + 1,)
    nodes: NDArray[np.int64]  # (k,)
    points: Floats  # (n, 3) reference places [m]
    held_until: Floats  # (n,) time [s] until which a node is held, and not pushed by tools
    tolerance: float  # gap [m] below which a node counts as touching
    frames: Floats  # (t, 2, 3, 4) rotations and places of the tools before and after a step
    bounds: Floats  # (t,) radius [m] about the origin beyond which a tool does not reach
    rows: Floats  # (k, 10) of the nodes pushed: node, change of velocity, velocity of the tool's matter, place
    impulse: Floats  # (n, 3) of the present step, by node [N s]
    total: Floats  # (t, 6) impulse [N s] and its moment about the tool's origin [N m s] on the body, since a call began


@njit(cache=True)
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


@njit(cache=True)
def rotation(pose, frame):  # type: ignore[no-untyped-def]
    """Write the rotation matrix and the place of a pose (7,) into a frame (3, 4)."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    frame[0, 0], frame[0, 1], frame[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    frame[1, 0], frame[1, 1], frame[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    frame[2, 0], frame[2, 1], frame[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    frame[0, 3], frame[1, 3], frame[2, 3] = pose[0], pose[1], pose[2]


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def _touch(contacts, t, ends, time, step, u, velocity):  # type: ignore[no-untyped-def]
    """Find the nodes that a tool pushes and how: nodes, changes of velocity and the tool's own velocity there.

    With `ends` the step is over, and only nodes that touch the tool and move into it are pushed.

    Returns
    -------
    int
        How many of the contacts' rows were written.
    """
    kind, sizes, before, after = contacts.kind[t], contacts.sizes[t], contacts.frames[t, 0], contacts.frames[t, 1]
    reach, count, ahead = contacts.bounds[t] + contacts.tolerance, 0, 0.0 if ends else step
    for k in range(contacts.start[t], contacts.start[t + 1]):
        i = contacts.nodes[k]
        x = contacts.points[i, 0] + u[i, 0] + ahead * velocity[i, 0]
        y = contacts.points[i, 1] + u[i, 1] + ahead * velocity[i, 1]
        z = contacts.points[i, 2] + u[i, 2] + ahead * velocity[i, 2]
        square = (x - after[0, 3]) ** 2 + (y - after[1, 3]) ** 2 + (z - after[2, 3]) ** 2
        if not square < reach * reach or time <= contacts.held_until[i]:
            continue
        g, nx, ny, nz = gap(kind, sizes, after, x, y, z)
        if g >= (contacts.tolerance if ends else 0.0):
            continue
        if not ends:  # the place on the surface
            x, y, z = x - g * nx, y - g * ny, z - g * nz
        tx, ty, tz = material_velocity(before, after, step, x, y, z)
        wx, wy, wz = velocity[i, 0] - tx, velocity[i, 1] - ty, velocity[i, 2] - tz
        normal = -(wx * nx + wy * ny + wz * nz) if ends else -g / step
        if normal <= 0.0:
            continue
        ax, ay, az = coulomb(normal, contacts.friction[t], wx, wy, wz, nx, ny, nz)
        row = contacts.rows[count]
        row[0], row[1], row[2], row[3] = i, ax + normal * nx, ay + normal * ny, az + normal * nz
        row[4], row[5], row[6], row[7], row[8], row[9] = tx, ty, tz, x, y, z
        count += 1
    return count


@njit(cache=True)
def _apply(contacts, t, count, kick, u, velocity, mass, force, surface, gravity, half_cell, volumes, density):  # type: ignore[no-untyped-def]
    """Push the nodes found; return the works [J]: of the tool, lost by friction and impact, more of the loads.

    Work on a node is the impulse times the mean of its velocities before the kick and after everything.
    """
    tools, lost, loads = 0.0, 0.0, 0.0
    origin = contacts.frames[t, 1, :, 3]
    for k in range(count):
        row = contacts.rows[k]
        i = int(row[0])
        for c in range(3):
            d, load = row[1 + c], surface[i, c] + density * gravity[c]
            earlier = contacts.impulse[i, c]
            now = velocity[i, c]
            given = (force[i, c] + half_cell * surface[i, c]) / density + gravity[c]
            before = now - kick * given - earlier / mass[i]
            velocity[i, c] = now + d
            work = mass[i] * d * 0.5 * (before + now + d) + earlier * 0.5 * d
            tools += mass[i] * d * row[4 + c]
            lost += mass[i] * d * row[4 + c] - work
            loads += 0.5 * kick * volumes[i] * load * d
            contacts.impulse[i, c] += mass[i] * d
            contacts.total[t, c] += mass[i] * d
        for c in range(3):
            a, b = (c + 1) % 3, (c + 2) % 3
            arm, other = row[7 + a] - origin[a], row[7 + b] - origin[b]
            contacts.total[t, 3 + c] += mass[i] * (arm * row[1 + b] - other * row[1 + a])
    return tools, lost, loads


@njit(cache=True)
def push(contacts, poses, s, time, step, kick, u, velocity, mass, force, surface, gravity, half_cell, volumes, density):  # type: ignore[no-untyped-def]
    """Let the tools push the nodes after the kick of step s; return the works [J] as `_apply` does.

    The last of the `poses` (s, t, 7) [m] has no step after it.
    """
    tools, lost, loads = 0.0, 0.0, 0.0
    ends = s == poses.shape[0] - 1
    first = s - 1 if ends else s
    for k in range(contacts.nodes.shape[0]):
        contacts.impulse[contacts.nodes[k]] = 0.0
    several = contacts.kind.shape[0] > 1
    for t in range(contacts.kind.shape[0]):
        rotation(poses[first, t], contacts.frames[t, 0])
        rotation(poses[first + 1, t], contacts.frames[t, 1])
    for _ in range(SWEEPS if several else 1):
        found = 0
        for t in range(contacts.kind.shape[0]):
            count = _touch(contacts, t, ends, time, step, u, velocity)
            works = _apply(
                contacts, t, count, kick, u, velocity, mass, force, surface, gravity, half_cell, volumes, density
            )
            tools, lost, loads, found = tools + works[0], lost + works[1], loads + works[2], found + count
        if found == 0:
            break
    return tools, lost, loads


@njit(cache=True)
def gaps(kind, sizes, pose, places, result):  # type: ignore[no-untyped-def]
    """Write the signed distances [m] of places (k, 3) to a tool in a pose (7,)."""
    frame = np.zeros((3, 4))
    rotation(pose, frame)
    for i in range(places.shape[0]):
        result[i] = gap(kind, sizes, frame, places[i, 0], places[i, 1], places[i, 2])[0]


def contacts(loads: Sequence[Contact], cloud: Cloud, held_until: Floats) -> Contacts:
    """Make tools ready for a cloud.

    Parameters
    ----------
    loads : sequence of Contact
    cloud : Cloud
    held_until : (n,) array [s]
        When tools that hold nodes let go.

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
        if load.tool.kind != PLANE and radius < cloud.spacing * (1 if cloud.points.shape[1] == 3 else 2):
            raise InputError(
                f"Contact {load.name!r}: a radius of {radius:g} m could slip between nodes {cloud.spacing:g} m apart; "
                "use a larger tool or a finer spacing"
            )
    nodes = [surface_nodes(cloud) if load.group is None else cloud.group(load.group) for load in loads]
    points = np.pad(cloud.points, ((0, 0), (0, 3 - cloud.points.shape[1])))
    sizes = np.array([load.tool.sizes for load in loads]).reshape(-1, 3)
    kind = np.array([load.tool.kind for load in loads], dtype=np.int64)
    count = len(loads)
    return Contacts(
        kind,
        sizes,
        np.array([float(load.friction) for load in loads]),
        np.cumsum([0, *(len(n) for n in nodes)]),
        np.concatenate([np.zeros(0, dtype=np.int64), *nodes]),
        np.ascontiguousarray(points, dtype=float),
        held_until,
        TOUCHING * cloud.spacing,
        np.zeros((count, 2, 3, 4)),
        np.where(kind == CAPSULE, sizes[:, 0] + sizes[:, 1], np.inf),
        np.zeros((max((len(n) for n in nodes), default=0), 10)),
        np.zeros((len(cloud) if count else 0, 3)),
        np.zeros((count, 6)),
    )
