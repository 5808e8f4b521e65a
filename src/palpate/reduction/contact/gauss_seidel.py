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
from palpate.dynamics.contact.tools import BONDED
from palpate.reduction.contact.compliance import energy_factor, pair, refresh, secant_factor

__all__ = ["aim", "compliance_energy", "press", "relax", "settle"]

STRETCH = 1.5  # by which a cluster may grow
SWEEPS, ENOUGH = 60, 1e-3  # most sweeps; of the deepest dent: change of a place in a sweep that ends them


@kernel_njit(fastmath={"contract"})
def _modal(contact_surface, i, coordinates, out):  # type: ignore[no-untyped-def]
    """Write the displacement that the coordinates make at a node."""
    x, y, z = 0.0, 0.0, 0.0
    for m in range(coordinates.shape[0]):
        x += contact_surface.columns[i, 0, m] * coordinates[m]
        y += contact_surface.columns[i, 1, m] * coordinates[m]
        z += contact_surface.columns[i, 2, m] * coordinates[m]
    out[0], out[1], out[2] = x, y, z


@kernel_njit()
def _list(contact_surface, contact_state, tools, t, i, x, y, z, v, step, count):  # type: ignore[no-untyped-def]
    """List a node that the coordinates put at a place; return how many are listed."""
    new, out = True, contact_state.wide
    for d in range(3):
        new = new and contact_state.force[t, i, d] == 0.0
    contact_state.node[count], contact_state.tool[count] = i, t
    contact_state.point[count] = i + contact_surface.points.shape[0] if tools.kind[t] == BONDED else i
    contact_state.modal[count, 0], contact_state.modal[count, 1], contact_state.modal[count, 2] = x, y, z
    if new:
        _modal(contact_surface, i, v, out)
    for d in range(3):
        contact_state.push[count, d] = contact_state.force[t, i, d]
        contact_state.before[count, d] = (
            contact_state.modal[count, d] - step * out[d] if new else contact_state.place[t, i, d]
        )
    return count + 1


@kernel_njit(inline="always")
def _held_at(contact_surface, tools, t, i):  # type: ignore[no-untyped-def]
    """Return where forceps hold a node."""
    frame, origin = tools.frames[t, 1], tools.origins[t]
    x, y, z = (
        contact_surface.points[i, 0] - origin[0],
        contact_surface.points[i, 1] - origin[1],
        contact_surface.points[i, 2] - origin[2],
    )
    return (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + frame[0, 3],
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + frame[1, 3],
        frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z + frame[2, 3],
    )


@kernel_njit()
def _hold(contact_surface, contact_state, tools, t, a, v, step, count):  # type: ignore[no-untyped-def]
    """List the nodes that forceps hold; return how many are listed, and how far the farthest must be moved [m]."""
    origin, reach, farthest, out = tools.origins[t], tools.sizes[t, 0] * (1.0 + 1e-9), 0.0, contact_state.wide
    open_ = not tools.frames[t, 1, 0, 3] < np.inf  # a pose that is no number lets go
    for c in range(contact_surface.leader.shape[0]):
        i, square = contact_surface.leader[c], 0.0
        for d in range(3):
            square += (contact_surface.points[i, d] - origin[d]) ** 2
        if np.sqrt(square) > reach + contact_surface.extent[c]:
            continue
        for i in range(contact_surface.start[c], contact_surface.start[c + 1]):
            square = 0.0
            for d in range(3):
                square += (contact_surface.points[i, d] - origin[d]) ** 2
            if square > reach * reach:
                continue
            if open_:
                contact_state.force[t, i, :] = 0.0
                continue
            _modal(contact_surface, i, a, out)
            x, y, z = (
                contact_surface.points[i, 0] + out[0],
                contact_surface.points[i, 1] + out[1],
                contact_surface.points[i, 2] + out[2],
            )
            tx, ty, tz = _held_at(contact_surface, tools, t, i)
            farthest = max(farthest, abs(x - tx), abs(y - ty), abs(z - tz))
            count = _list(contact_surface, contact_state, tools, t, i, x, y, z, v, step, count)
    return count, farthest


@kernel_njit()
def _find(contact_surface, contact_state, tools, a, v, step):  # type: ignore[no-untyped-def]
    """List the nodes that the coordinates alone would put inside a tool; return how deep the deepest is [m]."""
    count, deepest, depth, out = 0, 0.0, 0.0, contact_state.wide
    for t in range(tools.kind.shape[0]):
        kind, sizes, frame = tools.kind[t], tools.sizes[t], tools.frames[t, 1]
        if kind == BONDED:
            count, depth = _hold(contact_surface, contact_state, tools, t, a, v, step, count)
            deepest = max(deepest, depth)
            continue
        for c in range(contact_surface.leader.shape[0]):
            i = contact_surface.leader[c]
            _modal(contact_surface, i, a, out)
            x, y, z = (
                contact_surface.points[i, 0] + out[0],
                contact_surface.points[i, 1] + out[1],
                contact_surface.points[i, 2] + out[2],
            )
            far = gap(kind, sizes, frame, x, y, z)[0] > STRETCH * contact_surface.extent[c]
            if far and not contact_state.busy[t, c]:
                continue
            contact_state.busy[t, c] = not far
            for i in range(contact_surface.start[c], contact_surface.start[c + 1]):
                interior = False
                if not far:
                    _modal(contact_surface, i, a, out)
                    x, y, z = (
                        contact_surface.points[i, 0] + out[0],
                        contact_surface.points[i, 1] + out[1],
                        contact_surface.points[i, 2] + out[2],
                    )
                    depth = -gap(kind, sizes, frame, x, y, z)[0]
                    interior = depth > 0.0
                if not interior:
                    contact_state.force[t, i, :] = 0.0
                    continue
                deepest = max(deepest, depth)
                count = _list(contact_surface, contact_state, tools, t, i, x, y, z, v, step, count)
    contact_state.numbers[0] = count
    return deepest


@kernel_njit(inline="always")
def _spread(contact_surface, contact_state, kept, e, x, y, z):  # type: ignore[no-untyped-def]
    """Move all touched nodes by what a change of one force does."""
    i, h, now, node = (
        contact_state.point[e],
        contact_state.soft[contact_state.tool[e]],
        contact_state.now,
        contact_state.point,
    )
    x, y, z = h * x, h * y, h * z
    if not kept:
        block = contact_state.active.block
        for f in range(contact_state.numbers[0]):
            pair(contact_surface.compliance, node[f], i, block)
            for d in range(3):
                now[f, d] += block[d, 0] * x + block[d, 1] * y + block[d, 2] * z
        return
    matrix, slot = contact_state.active.matrix, contact_state.active.slot
    s = slot[i]  # its row lies together; the matrix is symmetric
    for f in range(contact_state.numbers[0]):
        r = slot[node[f]]
        for d in range(3):
            now[f, d] += matrix[s, r, 0, d] * x + matrix[s, r, 1, d] * y + matrix[s, r, 2, d] * z


@kernel_njit(inline="always")
def _own(contact_surface, contact_state, kept, e, nx, ny, nz):  # type: ignore[no-untyped-def]
    """Return a touched node's own compliance along a normal, and at least its largest across it [m/N]."""
    own, matrix, i, h = (
        contact_state.active.block,
        contact_state.active.matrix,
        contact_state.point[e],
        contact_state.soft[contact_state.tool[e]],
    )
    if kept:
        s = contact_state.active.slot[i]
        for c in range(3):
            for d in range(3):
                own[c, d] = matrix[s, s, c, d]
    else:
        pair(contact_surface.compliance, i, i, own)
    along = nx * (own[0, 0] * nx + 2 * own[0, 1] * ny) + ny * (own[1, 1] * ny + 2 * own[1, 2] * nz)
    along = h * (along + nz * (own[2, 2] * nz + 2 * own[0, 2] * nx))
    return along, h * (own[0, 0] + own[1, 1] + own[2, 2]) - along


@kernel_njit(inline="always")
def _give(contact_surface, contact_state, kept, e, fx, fy, fz):  # type: ignore[no-untyped-def]
    """Give a node a force, and move all; return the largest change of a component [N]."""
    push = contact_state.push
    x, y, z = fx - push[e, 0], fy - push[e, 1], fz - push[e, 2]
    push[e, 0], push[e, 1], push[e, 2] = fx, fy, fz
    if x != 0.0 or y != 0.0 or z != 0.0:
        _spread(contact_surface, contact_state, kept, e, x, y, z)
    return max(abs(x), abs(y), abs(z))


@kernel_njit(inline="always")
def relax(contact_surface, contact_state, tools, kept, step, e):  # type: ignore[no-untyped-def]
    """Give one node the force that its tool asks for; return how far that moves it [m]."""
    t = contact_state.tool[e]
    x, y, z = contact_state.now[e, 0], contact_state.now[e, 1], contact_state.now[e, 2]
    px, py, pz = contact_state.push[e, 0], contact_state.push[e, 1], contact_state.push[e, 2]
    if tools.kind[t] == BONDED:
        tx, ty, tz = _held_at(contact_surface, tools, t, contact_state.node[e])
        most = sum(_own(contact_surface, contact_state, kept, e, 1.0, 0.0, 0.0))
        fx, fy, fz = px - (x - tx) / most, py - (y - ty) / most, pz - (z - tz) / most
        return _give(contact_surface, contact_state, kept, e, fx, fy, fz) * most
    g, nx, ny, nz = gap(tools.kind[t], tools.sizes[t], tools.frames[t, 1], x, y, z)
    along, across = _own(contact_surface, contact_state, kept, e, nx, ny, nz)
    normal = px * nx + py * ny + pz * nz - g / along
    if normal <= 0.0:
        fx, fy, fz = 0.0, 0.0, 0.0
    elif tools.friction[t] == 0.0:
        fx, fy, fz = normal * nx, normal * ny, normal * nz
    else:
        tx, ty, tz = material_velocity(tools.frames[t, 0], tools.frames[t, 1], step, x - g * nx, y - g * ny, z - g * nz)
        # the tangential force that ends the sliding of this step
        fx = px - (x - contact_state.before[e, 0] - step * tx) / across
        fy = py - (y - contact_state.before[e, 1] - step * ty) / across
        fz = pz - (z - contact_state.before[e, 2] - step * tz) / across
        inward = fx * nx + fy * ny + fz * nz
        fx, fy, fz = fx - inward * nx, fy - inward * ny, fz - inward * nz
        size, most = np.sqrt(fx * fx + fy * fy + fz * fz), tools.friction[t] * normal
        share = most / size if size > most else 1.0
        fx, fy, fz = share * fx + normal * nx, share * fy + normal * ny, share * fz + normal * nz
    return _give(contact_surface, contact_state, kept, e, fx, fy, fz) * max(along, across)


@kernel_njit()
def _stiffen_contact(contact_surface, contact_state, tools):  # type: ignore[no-untyped-def]
    """Tell how soft the surface is under each tool, by the forces of the step before; forceps do not harden it."""
    for t in range(contact_state.soft.shape[0]):
        if tools.kind[t] == BONDED:
            contact_state.soft[t] = contact_surface.compliance.bonded_scale
            continue
        x, y, z = 0.0, 0.0, 0.0
        for e in range(contact_state.numbers[0]):
            if contact_state.tool[e] == t:
                x, y, z = x + contact_state.push[e, 0], y + contact_state.push[e, 1], z + contact_state.push[e, 2]
        contact_state.soft[t] = secant_factor(contact_surface.compliance.stiffening, np.sqrt(x * x + y * y + z * z))


@kernel_njit()
def settle(contact_surface, contact_state, tools, a, v, step):  # type: ignore[no-untyped-def]
    """Find the forces of the tools on a body whose coordinates without them are a at the end of a step.

    Parameters
    ----------
    skin, touch, tools : Skin, ContactScratch, Tools
        `tools.load` gets the forces on the coordinates; impulses and moments are added up.
    a, v : (m,) arrays
    step : float [s]

    Returns
    -------
    work, lost : float [J]
        Of the tools, and what friction takes of it.
    """
    tools.load[:] = 0.0
    deepest = _find(contact_surface, contact_state, tools, a, v, step)
    count = contact_state.numbers[0]
    contact_state.numbers[1] = 0
    if count == 0:
        return 0.0, 0.0
    kept = refresh(contact_surface.compliance, contact_state.active, contact_state.point, count)
    _stiffen_contact(contact_surface, contact_state, tools)
    for e in range(count):
        for d in range(3):
            contact_state.now[e, d] = contact_state.modal[e, d]
    for e in range(count):
        x, y, z = contact_state.push[e, 0], contact_state.push[e, 1], contact_state.push[e, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            _spread(contact_surface, contact_state, kept, e, x, y, z)
    largest = 0.0
    for sweep in range(SWEEPS):
        largest = 0.0
        for e in range(count):
            largest = max(largest, relax(contact_surface, contact_state, tools, kept, step, e))
        contact_state.numbers[1] = sweep + 1
        if largest < ENOUGH * deepest:
            break
    if largest >= ENOUGH * deepest:
        contact_state.numbers[2] += 1
    return _keep(contact_surface, contact_state, tools, step)


@kernel_njit()
def _keep(contact_surface, contact_state, tools, step):  # type: ignore[no-untyped-def]
    """Keep what was found for the next step, and add up what the tools do; return works as `settle`."""
    work, lost = 0.0, 0.0
    for e in range(contact_state.numbers[0]):
        i, t = contact_state.node[e], contact_state.tool[e]
        origin, place, push = tools.frames[t, 1, :, 3], contact_state.now[e], contact_state.push[e]
        speed = material_velocity(tools.frames[t, 0], tools.frames[t, 1], step, place[0], place[1], place[2])
        for d in range(3):
            b, c = (d + 1) % 3, (d + 2) % 3
            moment = (place[b] - origin[b]) * push[c] - (place[c] - origin[c]) * push[b]
            contact_state.force[t, i, d], contact_state.place[t, i, d] = push[d], place[d]
            tools.impulses[t, d] += step * push[d]
            tools.impulses[t, 3 + d] += step * moment
            tools.given[i, d] += step * push[d]
            work += step * push[d] * speed[d]
            lost += push[d] * (step * speed[d] - (place[d] - contact_state.before[e, d]))
            if push[d] != 0.0:
                for m in range(tools.load.shape[0]):
                    tools.load[m] += contact_surface.columns[i, d, m] * push[d]
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
def press(contact_surface, contact_state, tools, q, v, response, at, step, period, share, report):  # type: ignore[no-untyped-def]
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
    settle(contact_surface, contact_state, tools, at, v, step)
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
def compliance_energy(contact_surface, contact_state):  # type: ignore[no-untyped-def]
    """Return the energy [J] of the surface's own compliance."""
    total, stiffening = 0.0, contact_surface.compliance.stiffening
    for t in range(contact_state.soft.shape[0]):
        x, y, z, half, constrained_inverse_mass = 0.0, 0.0, 0.0, 0.0, False
        for e in range(contact_state.numbers[0]):
            if contact_state.tool[e] != t:
                continue
            constrained_inverse_mass = contact_state.point[e] >= contact_surface.points.shape[0]
            x, y, z = x + contact_state.push[e, 0], y + contact_state.push[e, 1], z + contact_state.push[e, 2]
            for d in range(3):
                half += 0.5 * contact_state.push[e, d] * (contact_state.now[e, d] - contact_state.modal[e, d])
        total += half if constrained_inverse_mass else energy_factor(stiffening, np.sqrt(x * x + y * y + z * z)) * half
    return total
