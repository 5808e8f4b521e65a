"""Contact of a reduced body with rigid tools, compiled: Coulomb's law on a surface with a compliance of its own.

Few modes cannot dent a body under a small tool. What they leave is nearly static and local, a compliance of the surface
beside the modes (`palpate.reduction.contact.compliance`): touched nodes are at

    x_i = X_i + sum over columns of C_im a_m + sum over touched nodes of G_ij f_j,

with the tools' forces f_j [N] on the nodes. G is positive definite, so that without friction one set of forces keeps
all nodes out of all tools. They are found by Gauss and Seidel's sweeps from those of the step before: each node in turn
gets the normal force that puts it onto its tool, and the tangential one that stops its sliding, at most mu times the
normal one (Coulomb).

A step asks one node of every cluster of surface nodes how far it is, and visits the nodes of the clusters near a tool.
"""

from __future__ import annotations

import numpy as np

from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.contact.geometry import gap, material_velocity
from palpate.dynamics.contact.tools import HELD
from palpate.reduction.contact.compliance import pair, refresh, softness, stored

__all__ = ["aim", "dent_energy", "press", "relax", "settle"]

STRETCH = 1.5  # by which a cluster may grow
SWEEPS, ENOUGH = 60, 1e-3  # most sweeps; of the deepest dent: change of a place in a sweep that ends them


@kernel_njit(fastmath={"contract"})
def _modal(skin, i, coordinates, out):  # type: ignore[no-untyped-def]
    """Write the displacement that the coordinates make at a node."""
    x, y, z = 0.0, 0.0, 0.0
    for m in range(coordinates.shape[0]):
        x += skin.columns[i, 0, m] * coordinates[m]
        y += skin.columns[i, 1, m] * coordinates[m]
        z += skin.columns[i, 2, m] * coordinates[m]
    out[0], out[1], out[2] = x, y, z


@kernel_njit()
def _list(skin, touch, tools, t, i, x, y, z, v, step, count):  # type: ignore[no-untyped-def]
    """List a node that the coordinates put at a place; return how many are listed."""
    new, out = True, touch.wide
    for d in range(3):
        new = new and touch.force[t, i, d] == 0.0
    touch.node[count], touch.tool[count] = i, t
    touch.point[count] = i + skin.points.shape[0] if tools.kind[t] == HELD else i
    touch.modal[count, 0], touch.modal[count, 1], touch.modal[count, 2] = x, y, z
    if new:
        _modal(skin, i, v, out)
    for d in range(3):
        touch.push[count, d] = touch.force[t, i, d]
        touch.before[count, d] = touch.modal[count, d] - step * out[d] if new else touch.place[t, i, d]
    return count + 1


@kernel_njit(inline="always")
def _held_at(skin, tools, t, i):  # type: ignore[no-untyped-def]
    """Return where forceps hold a node."""
    frame, origin = tools.frames[t, 1], tools.origins[t]
    x, y, z = skin.points[i, 0] - origin[0], skin.points[i, 1] - origin[1], skin.points[i, 2] - origin[2]
    return (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + frame[0, 3],
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + frame[1, 3],
        frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z + frame[2, 3],
    )


@kernel_njit()
def _hold(skin, touch, tools, t, a, v, step, count):  # type: ignore[no-untyped-def]
    """List the nodes that forceps hold; return how many are listed, and how far the farthest must be moved [m]."""
    origin, reach, farthest, out = tools.origins[t], tools.sizes[t, 0] * (1.0 + 1e-9), 0.0, touch.wide
    open_ = not tools.frames[t, 1, 0, 3] < np.inf  # a pose that is no number lets go
    for c in range(skin.leader.shape[0]):
        i, square = skin.leader[c], 0.0
        for d in range(3):
            square += (skin.points[i, d] - origin[d]) ** 2
        if np.sqrt(square) > reach + skin.extent[c]:
            continue
        for i in range(skin.start[c], skin.start[c + 1]):
            square = 0.0
            for d in range(3):
                square += (skin.points[i, d] - origin[d]) ** 2
            if square > reach * reach:
                continue
            if open_:
                touch.force[t, i, :] = 0.0
                continue
            _modal(skin, i, a, out)
            x, y, z = skin.points[i, 0] + out[0], skin.points[i, 1] + out[1], skin.points[i, 2] + out[2]
            tx, ty, tz = _held_at(skin, tools, t, i)
            farthest = max(farthest, abs(x - tx), abs(y - ty), abs(z - tz))
            count = _list(skin, touch, tools, t, i, x, y, z, v, step, count)
    return count, farthest


@kernel_njit()
def _find(skin, touch, tools, a, v, step):  # type: ignore[no-untyped-def]
    """List the nodes that the coordinates alone would put inside a tool; return how deep the deepest is [m]."""
    count, deepest, depth, out = 0, 0.0, 0.0, touch.wide
    for t in range(tools.kind.shape[0]):
        kind, sizes, frame = tools.kind[t], tools.sizes[t], tools.frames[t, 1]
        if kind == HELD:
            count, depth = _hold(skin, touch, tools, t, a, v, step, count)
            deepest = max(deepest, depth)
            continue
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
                count = _list(skin, touch, tools, t, i, x, y, z, v, step, count)
    touch.numbers[0] = count
    return deepest


@kernel_njit(inline="always")
def _spread(skin, touch, kept, e, x, y, z):  # type: ignore[no-untyped-def]
    """Move all touched nodes by what a change of one force does."""
    i, h, now, node = touch.point[e], touch.soft[touch.tool[e]], touch.now, touch.point
    x, y, z = h * x, h * y, h * z
    if not kept:
        block = touch.near.block
        for f in range(touch.numbers[0]):
            pair(skin.compliance, node[f], i, block)
            for d in range(3):
                now[f, d] += block[d, 0] * x + block[d, 1] * y + block[d, 2] * z
        return
    matrix, slot = touch.near.matrix, touch.near.slot
    s = slot[i]  # its row lies together; the matrix is symmetric
    for f in range(touch.numbers[0]):
        r = slot[node[f]]
        for d in range(3):
            now[f, d] += matrix[s, r, 0, d] * x + matrix[s, r, 1, d] * y + matrix[s, r, 2, d] * z


@kernel_njit(inline="always")
def _own(skin, touch, kept, e, nx, ny, nz):  # type: ignore[no-untyped-def]
    """Return a touched node's own compliance along a normal, and at least its largest across it [m/N]."""
    own, matrix, i, h = touch.near.block, touch.near.matrix, touch.point[e], touch.soft[touch.tool[e]]
    if kept:
        s = touch.near.slot[i]
        for c in range(3):
            for d in range(3):
                own[c, d] = matrix[s, s, c, d]
    else:
        pair(skin.compliance, i, i, own)
    along = nx * (own[0, 0] * nx + 2 * own[0, 1] * ny) + ny * (own[1, 1] * ny + 2 * own[1, 2] * nz)
    along = h * (along + nz * (own[2, 2] * nz + 2 * own[0, 2] * nx))
    return along, h * (own[0, 0] + own[1, 1] + own[2, 2]) - along


@kernel_njit(inline="always")
def _give(skin, touch, kept, e, fx, fy, fz):  # type: ignore[no-untyped-def]
    """Give a node a force, and move all; return the largest change of a component [N]."""
    push = touch.push
    x, y, z = fx - push[e, 0], fy - push[e, 1], fz - push[e, 2]
    push[e, 0], push[e, 1], push[e, 2] = fx, fy, fz
    if x != 0.0 or y != 0.0 or z != 0.0:
        _spread(skin, touch, kept, e, x, y, z)
    return max(abs(x), abs(y), abs(z))


@kernel_njit(inline="always")
def relax(skin, touch, tools, kept, step, e):  # type: ignore[no-untyped-def]
    """Give one node the force that its tool asks for; return how far that moves it [m]."""
    t = touch.tool[e]
    x, y, z = touch.now[e, 0], touch.now[e, 1], touch.now[e, 2]
    px, py, pz = touch.push[e, 0], touch.push[e, 1], touch.push[e, 2]
    if tools.kind[t] == HELD:
        tx, ty, tz = _held_at(skin, tools, t, touch.node[e])
        most = sum(_own(skin, touch, kept, e, 1.0, 0.0, 0.0))
        fx, fy, fz = px - (x - tx) / most, py - (y - ty) / most, pz - (z - tz) / most
        return _give(skin, touch, kept, e, fx, fy, fz) * most
    g, nx, ny, nz = gap(tools.kind[t], tools.sizes[t], tools.frames[t, 1], x, y, z)
    along, across = _own(skin, touch, kept, e, nx, ny, nz)
    normal = px * nx + py * ny + pz * nz - g / along
    if normal <= 0.0:
        fx, fy, fz = 0.0, 0.0, 0.0
    elif tools.friction[t] == 0.0:
        fx, fy, fz = normal * nx, normal * ny, normal * nz
    else:
        tx, ty, tz = material_velocity(tools.frames[t, 0], tools.frames[t, 1], step, x - g * nx, y - g * ny, z - g * nz)
        # the tangential force that ends the sliding of this step
        fx = px - (x - touch.before[e, 0] - step * tx) / across
        fy = py - (y - touch.before[e, 1] - step * ty) / across
        fz = pz - (z - touch.before[e, 2] - step * tz) / across
        inward = fx * nx + fy * ny + fz * nz
        fx, fy, fz = fx - inward * nx, fy - inward * ny, fz - inward * nz
        size, most = np.sqrt(fx * fx + fy * fy + fz * fz), tools.friction[t] * normal
        share = most / size if size > most else 1.0
        fx, fy, fz = share * fx + normal * nx, share * fy + normal * ny, share * fz + normal * nz
    return _give(skin, touch, kept, e, fx, fy, fz) * max(along, across)


@kernel_njit()
def _harden(skin, touch, tools):  # type: ignore[no-untyped-def]
    """Tell how soft the surface is under each tool, by the forces of the step before; forceps do not harden it."""
    for t in range(touch.soft.shape[0]):
        if tools.kind[t] == HELD:
            touch.soft[t] = skin.compliance.grip
            continue
        x, y, z = 0.0, 0.0, 0.0
        for e in range(touch.numbers[0]):
            if touch.tool[e] == t:
                x, y, z = x + touch.push[e, 0], y + touch.push[e, 1], z + touch.push[e, 2]
        touch.soft[t] = softness(skin.compliance.hardening, np.sqrt(x * x + y * y + z * z))


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
    kept = refresh(skin.compliance, touch.near, touch.point, count)
    _harden(skin, touch, tools)
    for e in range(count):
        for d in range(3):
            touch.now[e, d] = touch.modal[e, d]
    for e in range(count):
        x, y, z = touch.push[e, 0], touch.push[e, 1], touch.push[e, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            _spread(skin, touch, kept, e, x, y, z)
    largest = 0.0
    for sweep in range(SWEEPS):
        largest = 0.0
        for e in range(count):
            largest = max(largest, relax(skin, touch, tools, kept, step, e))
        touch.numbers[1] = sweep + 1
        if largest < ENOUGH * deepest:
            break
    if largest >= ENOUGH * deepest:
        touch.numbers[2] += 1
    return _keep(skin, touch, tools, step)


@kernel_njit()
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


@kernel_njit()
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


@kernel_njit()
def dent_energy(skin, touch):  # type: ignore[no-untyped-def]
    """Return the energy [J] of the surface's own compliance."""
    total, hardening = 0.0, skin.compliance.hardening
    for t in range(touch.soft.shape[0]):
        x, y, z, half, held = 0.0, 0.0, 0.0, 0.0, False
        for e in range(touch.numbers[0]):
            if touch.tool[e] != t:
                continue
            held = touch.point[e] >= skin.points.shape[0]
            x, y, z = x + touch.push[e, 0], y + touch.push[e, 1], z + touch.push[e, 2]
            for d in range(3):
                half += 0.5 * touch.push[e, d] * (touch.now[e, d] - touch.modal[e, d])
        total += half if held else stored(hardening, np.sqrt(x * x + y * y + z * z)) * half
    return total
