"""Contact of a reduced body with rigid tools, compiled: the surface's own compliance, and Coulomb's law on it.

Few modes cannot dent a body under a small tool. What they leave is nearly static and local: the *residual flexibility*
of component mode synthesis (MacNeal, Computers & Structures 1, 1971). Here it is one kernel for the whole surface,

    x_i = X_i + sum over columns of C_im a_m + sum over touched nodes of g(|X_i - X_j|) f_j,

with the tools' forces f_j [N] on the nodes. A kernel that is a sum of falling exponentials (`palpate.reduction.dents`)
makes a positive definite matrix of any set of nodes, so that without friction one set of forces keeps all nodes out of
all tools. They are found by Gauss and Seidel's sweeps from those of the step before: each node in turn gets the normal
force that puts it onto its tool, and the tangential one that stops its sliding, at most mu times the normal one
(Coulomb).

A step asks one node of every cluster of surface nodes how far it is, and visits the nodes of the clusters near a tool.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.dynamics.compiled import kernel_njit
from palpate.dynamics.contact import Contacts, gap, material_velocity

__all__ = ["Dents", "Skin", "Tools", "Touch", "aim", "dent_energy", "press", "settle", "skin", "tools_of", "touched"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CLUSTER = 32  # surface nodes in a cluster, about
STRETCH = 1.5  # by which a cluster may grow
SWEEPS, ENOUGH = 60, 1e-4  # most sweeps; of the deepest dent: change of a place in a sweep that ends them
DENSE = 512  # touched nodes up to which the kernel between them is kept as a matrix


class Dents(NamedTuple):
    """The compliance of a body's surface beside its modes.

    Parameters
    ----------
    nodes : (k,) int array
        Nodes that tools may touch.
    lengths, compliances : (e,) arrays [m], [m/N]
        Of the exponentials.
    own : float [m/N]
        More compliance of a node under its own force.
    """

    nodes: NDArray[np.int64]
    lengths: Floats
    compliances: Floats
    own: float

    def kernel(self, distances: Floats) -> Floats:
        """Return g [m/N] at some distances [m]; at 0 with the node's own."""
        falling = np.exp(-distances[..., None] / self.lengths) @ self.compliances
        return np.asarray(falling + np.where(distances == 0, self.own, 0.0))


class Skin(NamedTuple):
    """The part of a reduced body that tools touch."""

    nodes: Ints  # (k,) surface nodes, by cluster
    points: Floats  # (k, 3) reference places [m]
    columns: NDArray[np.float32]  # (k, 3, m) their displacements by unit coordinates
    start: Ints  # (c + 1,) of the clusters
    leader: Ints  # (c,) a node in the middle of each
    extent: Floats  # (c,) how far from it others are at rest [m]
    kernel: Floats  # (t,) g at even distances [m/N]
    interval: float  # between them [m]
    own: float  # g of a node's own force [m/N]


class Tools(NamedTuple):
    """Rigid tools, and what they do."""

    kind: Ints  # (t,) of their shapes
    sizes: Floats  # (t, 3) [m]
    friction: Floats  # (t,)
    frames: Floats  # (t, 2, 3, 4) rotations and places [m] before and after a step
    load: Floats  # (m,) forces on the coordinates
    impulses: Floats  # (t, 6) [N s] and moments about the origins [N m s] on the body, added up
    given: Floats  # (k, 3) impulses [N s] on the nodes, added up
    way: Floats  # (2, 3, 4) in real time: a tool's frames before and after a period


class Touch(NamedTuple):
    """What one step hands to the next, and scratch."""

    force: Floats  # (t, k, 3) [N]
    place: Floats  # (t, k, 3) [m], of the nodes that are touched
    busy: NDArray[np.bool_]  # (t, c) clusters that were near the tool in the last step
    node: Ints  # (e,) touched: place in the skin, of each pair of a node and a tool
    tool: Ints  # (e,)
    modal: Floats  # (e, 3) [m]
    now: Floats  # (e, 3) [m]
    before: Floats  # (e, 3) [m]
    push: Floats  # (e, 3) [N]
    wide: Floats  # (3,)
    near: Floats  # (DENSE, DENSE) kernel [m/N]
    numbers: Ints  # (3,) pairs now, sweeps of the last step, steps whose sweeps did not end


def skin(nodes: Ints, points: Floats, columns: Floats, kernel: Floats, interval: float, own: float) -> Skin:
    """Lay out surface nodes (k,) at points (k, 3) with columns (m, k, 3) in clusters."""
    order, start = _clusters(points, CLUSTER)
    points, leader, extent = points[order], [], []
    for begin, end in pairwise(start):
        own_points = points[begin:end]
        middle = int(np.argmin(np.linalg.norm(own_points - own_points.mean(axis=0), axis=1)))
        leader.append(begin + middle)
        extent.append(np.linalg.norm(own_points - own_points[middle], axis=1).max())
    return Skin(
        np.asarray(nodes)[order], np.ascontiguousarray(points),
        np.ascontiguousarray(columns[:, order].transpose(1, 2, 0), dtype=np.float32),
        start, np.array(leader, dtype=np.int64), np.array(extent, dtype=float),
        np.ascontiguousarray(kernel), interval, own,
    )  # fmt: skip


def _clusters(points: Floats, size: int) -> tuple[Ints, Ints]:
    """Halve a set of points across its longest extent until no part has more than `size`."""
    parts, done = [np.arange(len(points))] if len(points) else [], [np.zeros(0, dtype=np.int64)]
    while parts:
        part = parts.pop()
        if len(part) <= size:
            done.append(part)
            continue
        axis = int(np.argmax(np.ptp(points[part], axis=0)))
        ordered = part[np.argsort(points[part, axis], kind="stable")]
        parts += [ordered[len(part) // 2 :], ordered[: len(part) // 2]]
    return np.concatenate(done), np.cumsum([len(part) for part in done], dtype=np.int64)


def tools_of(contacts: Contacts | None, of: Skin) -> Tools:
    """Make tools ready that a full model would know as `contacts`; None for no tool."""
    kind = np.zeros(0, dtype=np.int64) if contacts is None else contacts.kind
    sizes, friction = (np.zeros((0, 3)), np.zeros(0)) if contacts is None else (contacts.sizes, contacts.friction)
    return Tools(
        kind, sizes, friction, np.zeros((len(kind), 2, 3, 4)), np.zeros(of.columns.shape[2]),
        np.zeros((len(kind), 6)), np.zeros((len(of.nodes), 3)), np.zeros((2, 3, 4)),
    )  # fmt: skip


def touched(of: Skin, tools: int) -> Touch:
    """Allocate for a number of tools; none touches."""
    most, by_tool = tools * len(of.nodes), (tools, len(of.nodes), 3)
    modal, now, before, push = np.zeros((4, most, 3))
    return Touch(
        np.zeros(by_tool), np.zeros(by_tool), np.ones((tools, len(of.leader)), dtype=np.bool_),
        np.zeros(most, dtype=np.int64), np.zeros(most, dtype=np.int64),
        modal, now, before, push, np.zeros(3), np.zeros((min(most, DENSE),) * 2), np.zeros(3, dtype=np.int64),
    )  # fmt: skip


@njit(cache=True, fastmath={"contract"})
def _modal(skin, i, coordinates, out):  # type: ignore[no-untyped-def]
    """Write the displacement that the coordinates make at a node."""
    x, y, z = 0.0, 0.0, 0.0
    for m in range(coordinates.shape[0]):
        x += skin.columns[i, 0, m] * coordinates[m]
        y += skin.columns[i, 1, m] * coordinates[m]
        z += skin.columns[i, 2, m] * coordinates[m]
    out[0], out[1], out[2] = x, y, z


@njit(cache=True, fastmath={"contract"})
def _kernel(skin, i, j):  # type: ignore[no-untyped-def]
    if i == j:
        return skin.own
    x = skin.points[i, 0] - skin.points[j, 0]
    y = skin.points[i, 1] - skin.points[j, 1]
    z = skin.points[i, 2] - skin.points[j, 2]
    at = np.sqrt(x * x + y * y + z * z) / skin.interval
    k = int(at)
    if k + 1 >= skin.kernel.shape[0]:
        return 0.0
    return skin.kernel[k] + (at - k) * (skin.kernel[k + 1] - skin.kernel[k])


@njit(cache=True)
def _find(skin, touch, tools, a, v, step):  # type: ignore[no-untyped-def]
    """List the nodes that the coordinates alone would put inside a tool; return how deep the deepest is [m]."""
    count, deepest, depth, out = 0, 0.0, 0.0, touch.wide
    for t in range(tools.kind.shape[0]):
        kind, sizes, frame = tools.kind[t], tools.sizes[t], tools.frames[t, 1]
        for c in range(skin.leader.shape[0]):
            i = skin.leader[c]
            _modal(skin, i, a, out)
            x, y, z = skin.points[i, 0] + out[0], skin.points[i, 1] + out[1], skin.points[i, 2] + out[2]
            far = gap(kind, sizes, frame, x, y, z)[0] > STRETCH * skin.extent[c]
            if far and not touch.busy[t, c]:
                continue
            touch.busy[t, c] = not far
            for i in range(skin.start[c], skin.start[c + 1]):
                inside = False
                if not far:
                    _modal(skin, i, a, out)
                    x, y, z = skin.points[i, 0] + out[0], skin.points[i, 1] + out[1], skin.points[i, 2] + out[2]
                    depth = -gap(kind, sizes, frame, x, y, z)[0]
                    inside = depth > 0.0
                if not inside:
                    touch.force[t, i, :] = 0.0
                    continue
                deepest = max(deepest, depth)
                new = True
                for d in range(3):
                    new = new and touch.force[t, i, d] == 0.0
                touch.node[count], touch.tool[count] = i, t
                touch.modal[count, 0], touch.modal[count, 1], touch.modal[count, 2] = x, y, z
                if new:
                    _modal(skin, i, v, out)
                for d in range(3):
                    touch.push[count, d] = touch.force[t, i, d]
                    touch.before[count, d] = touch.modal[count, d] - step * out[d] if new else touch.place[t, i, d]
                count += 1
    touch.numbers[0] = count
    return deepest


@njit(cache=True, fastmath={"contract"})
def _spread(skin, touch, e, x, y, z):  # type: ignore[no-untyped-def]
    """Move all touched nodes by what a change of one force does."""
    count = touch.numbers[0]
    if count <= touch.near.shape[0]:
        for f in range(count):
            g = touch.near[e, f]
            touch.now[f, 0] += g * x
            touch.now[f, 1] += g * y
            touch.now[f, 2] += g * z
    else:
        for f in range(count):
            g = _kernel(skin, touch.node[e], touch.node[f])
            touch.now[f, 0] += g * x
            touch.now[f, 1] += g * y
            touch.now[f, 2] += g * z


@njit(cache=True)
def _relax(skin, touch, tools, step, e):  # type: ignore[no-untyped-def]
    """Give one node the force that its tool asks for; return how far that moves it [m]."""
    t = touch.tool[e]
    x, y, z = touch.now[e, 0], touch.now[e, 1], touch.now[e, 2]
    g, nx, ny, nz = gap(tools.kind[t], tools.sizes[t], tools.frames[t, 1], x, y, z)
    px, py, pz = touch.push[e, 0], touch.push[e, 1], touch.push[e, 2]
    normal = px * nx + py * ny + pz * nz - g / skin.own
    if normal <= 0.0:
        fx, fy, fz = 0.0, 0.0, 0.0
    elif tools.friction[t] == 0.0:
        fx, fy, fz = normal * nx, normal * ny, normal * nz
    else:
        tx, ty, tz = material_velocity(tools.frames[t, 0], tools.frames[t, 1], step, x - g * nx, y - g * ny, z - g * nz)
        # the tangential force that ends the sliding of this step
        fx = px - (x - touch.before[e, 0] - step * tx) / skin.own
        fy = py - (y - touch.before[e, 1] - step * ty) / skin.own
        fz = pz - (z - touch.before[e, 2] - step * tz) / skin.own
        along = fx * nx + fy * ny + fz * nz
        fx, fy, fz = fx - along * nx, fy - along * ny, fz - along * nz
        size, most = np.sqrt(fx * fx + fy * fy + fz * fz), tools.friction[t] * normal
        share = most / size if size > most else 1.0
        fx, fy, fz = share * fx + normal * nx, share * fy + normal * ny, share * fz + normal * nz
    touch.push[e, 0], touch.push[e, 1], touch.push[e, 2] = fx, fy, fz
    fx, fy, fz = fx - px, fy - py, fz - pz
    if fx != 0.0 or fy != 0.0 or fz != 0.0:
        _spread(skin, touch, e, fx, fy, fz)
    return skin.own * max(abs(fx), abs(fy), abs(fz))


@kernel_njit()
def settle(skin, touch, tools, a, v, step):  # type: ignore[no-untyped-def]
    """Find the forces of the tools on a body whose coordinates without them are a at the end of a step.

    Parameters
    ----------
    skin, touch, tools : Skin, Touch, Tools
        `tools.load` gets the forces on the coordinates; impulses and moments are added up.
    a, v : (m,) arrays
    step : float [s]

    Returns
    -------
    work, lost : float [J]
        Of the tools, and what friction takes of it.
    """
    tools.load[:] = 0.0
    deepest = _find(skin, touch, tools, a, v, step)
    count = touch.numbers[0]
    touch.numbers[1] = 0
    if count == 0:
        return 0.0, 0.0
    if count <= touch.near.shape[0]:
        for e in range(count):
            for f in range(e + 1):
                touch.near[e, f] = _kernel(skin, touch.node[e], touch.node[f])
                touch.near[f, e] = touch.near[e, f]
    for e in range(count):
        for d in range(3):
            touch.now[e, d] = touch.modal[e, d]
    for e in range(count):
        x, y, z = touch.push[e, 0], touch.push[e, 1], touch.push[e, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            _spread(skin, touch, e, x, y, z)
    largest = 0.0
    for sweep in range(SWEEPS):
        largest = 0.0
        for e in range(count):
            largest = max(largest, _relax(skin, touch, tools, step, e))
        touch.numbers[1] = sweep + 1
        if largest < ENOUGH * deepest:
            break
    if largest >= ENOUGH * deepest:
        touch.numbers[2] += 1
    return _keep(skin, touch, tools, step)


@njit(cache=True)
def _keep(skin, touch, tools, step):  # type: ignore[no-untyped-def]
    """Keep what was found for the next step, and add up what the tools do; return works as `settle`."""
    work, lost = 0.0, 0.0
    for e in range(touch.numbers[0]):
        i, t = touch.node[e], touch.tool[e]
        origin, place, push = tools.frames[t, 1, :, 3], touch.now[e], touch.push[e]
        speed = material_velocity(tools.frames[t, 0], tools.frames[t, 1], step, place[0], place[1], place[2])
        for d in range(3):
            b, c = (d + 1) % 3, (d + 2) % 3
            moment = (place[b] - origin[b]) * push[c] - (place[c] - origin[c]) * push[b]
            touch.force[t, i, d], touch.place[t, i, d] = push[d], place[d]
            tools.impulses[t, d] += step * push[d]
            tools.impulses[t, 3 + d] += step * moment
            tools.given[i, d] += step * push[d]
            work += step * push[d] * speed[d]
            lost += push[d] * (step * speed[d] - (place[d] - touch.before[e, d]))
            if push[d] != 0.0:
                for m in range(tools.load.shape[0]):
                    tools.load[m] += skin.columns[i, d, m] * push[d]
    return work, lost


@njit(cache=True)
def aim(tools, home, target, still):  # type: ignore[no-untyped-def]
    """Let a tool go, in a period, to a pose as `palpate.realtime` has it: displacement and R - I, (12,)."""
    if tools.kind.shape[0] == 0:
        return
    there = True
    for i in range(12):
        there = there and target[i] == 0.0
    for i in range(3):
        for j in range(3):
            tools.way[1, i, j] = target[3 + 3 * i + j] + (1.0 if i == j else 0.0)
        tools.way[1, i, 3] = home[i] + target[i]
        for j in range(4):
            if still and there:  # begun, or begun again
                tools.frames[0, 1, i, j] = tools.way[1, i, j]
            tools.way[0, i, j] = tools.frames[0, 1, i, j]


@kernel_njit()
def press(skin, touch, tools, q, v, response, at, step, period, share, report):  # type: ignore[no-untyped-def]
    """Let the tool push a body in a step [s] that ends at a share of the tool's way in a period [s].

    The velocities v (m,) change; the report's entries from the ninth on get the means of the forces that are conjugate
    to the tool's displacement and to the entries of its rotation R: for those G = S R, S the moment's cross product.
    """
    for i in range(3):
        for j in range(4):
            tools.frames[0, 0, i, j] = tools.frames[0, 1, i, j]
            tools.frames[0, 1, i, j] = tools.way[0, i, j] + share * (tools.way[1, i, j] - tools.way[0, i, j])
    for m in range(q.shape[0]):
        at[m] = q[m] + step * v[m]
    tools.impulses[:] = 0.0
    settle(skin, touch, tools, at, v, step)
    for m in range(q.shape[0]):
        for k in range(q.shape[0]):
            v[m] += step * response[m, k] * tools.load[k]
    for i in range(3):
        k, m = (i + 1) % 3, (i + 2) % 3
        report[8 + i] += tools.impulses[0, i] / period
        half = 0.5 * tools.impulses[0, 3 + i] / period
        for j in range(3):
            report[11 + 3 * m + j] += half * tools.frames[0, 1, k, j]
            report[11 + 3 * k + j] -= half * tools.frames[0, 1, m, j]


@njit(cache=True)
def dent_energy(touch):  # type: ignore[no-untyped-def]
    """Return the energy [J] of the surface's own compliance."""
    total = 0.0
    for e in range(touch.numbers[0]):
        for d in range(3):
            total += 0.5 * touch.push[e, d] * (touch.now[e, d] - touch.modal[e, d])
    return total
