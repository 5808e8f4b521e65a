"""Contact of a reduced body with rigid tools: projected Gauss-Seidel for Coulomb's law, compiled.

Few modes cannot represent the indentation under a small tool. The remainder is nearly static and
local: a compliance of the surface in addition to the modes (`palpate.reduction.contact.compliance`).
Nodes in contact are at

    x_i = X_i + sum over basis vectors of C_im a_m + sum over nodes in contact of G_ij f_j,

with the forces f_j [N] of the tools on the nodes. G is positive definite. So without friction exactly
one set of forces keeps all nodes outside all tools. Gauss-Seidel sweeps find it, starting from the
forces of the previous step. Each node in turn receives the normal force that puts it onto its tool,
and the tangential force that stops its sliding, at most mu times the normal one (Coulomb).

A step computes the distance of one node of every cluster of surface nodes, and visits only the nodes
of the clusters near a tool.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.dynamics.contact.geometry import gap, material_velocity
from palpate.dynamics.contact.held import press_held_nodes
from palpate.dynamics.contact.kinds import BONDED
from palpate.meshfree.cloud import MOVED_MARGIN
from palpate.reduction.contact.compliance import energy_factor, pair, refresh, secant_factor, stiffened_force
from palpate.reduction.contact.surface import HELD_NEARNESS, PAIRS, SWEEPS, UNCONVERGED

CLUSTER_STRETCH = 1.5  # largest extent of a cluster over that at rest
MAX_SWEEPS = 60
SWEEP_TOLERANCE = 1e-3  # largest change of a position in the last sweep, as a fraction of the deepest penetration
PATH_START, PATH_END, PATH_NOW = range(3)  # entries of `RigidTools.path`


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _modal_displacement(surface, i, coordinates, out):
    """Write the displacement of a node by the coordinates."""
    x, y, z = 0.0, 0.0, 0.0
    for m in range(coordinates.shape[0]):
        x += surface.columns[i, 0, m] * coordinates[m]
        y += surface.columns[i, 1, m] * coordinates[m]
        z += surface.columns[i, 2, m] * coordinates[m]
    out[0], out[1], out[2] = x, y, z


@kernel_njit(inner=True, fastmath={"contract"})
def _list_node(surface, contact, tools, t, i, x, y, z, v, step, count):
    """List a node at its modal position as a contact pair; return the number of pairs."""
    new, out = True, contact.displacement
    for d in range(3):
        new = new and contact.force[t, i, d] == 0.0
    contact.node[count], contact.tool[count] = i, t
    contact.point[count] = i + surface.points.shape[0] if tools.kind[t] == BONDED else i
    contact.modal[count, 0], contact.modal[count, 1], contact.modal[count, 2] = x, y, z
    if new:
        _modal_displacement(surface, i, v, out)
    for d in range(3):
        contact.push[count, d] = contact.force[t, i, d]
        contact.before[count, d] = contact.modal[count, d] - step * out[d] if new else contact.place[t, i, d]
    return count + 1


@kernel_njit(inline="always")
def _bonded_position(surface, tools, t, i):
    """Return the position of a node bonded to forceps."""
    frame, origin = tools.frames[t, 1], tools.origins[t]
    point = surface.points[i]
    x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
    return (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + frame[0, 3],
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + frame[1, 3],
        frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z + frame[2, 3],
    )


@kernel_njit(inner=True, fastmath={"contract"})
def _list_bonded(surface, contact, tools, t, a, v, step, count):
    """List the nodes that forceps hold; return the number of pairs and the largest displacement to the tool [m]."""
    origin, radius = tools.origins[t], tools.sizes[t, 0] * (1.0 + 1e-9) + MOVED_MARGIN * surface.spacing
    farthest, out = 0.0, contact.displacement
    released = not tools.frames[t, 1, 0, 3] < np.inf  # a pose of NaN releases the nodes
    for c in range(surface.leader.shape[0]):
        i, square = surface.leader[c], 0.0
        for d in range(3):
            square += (surface.points[i, d] - origin[d]) ** 2
        if np.sqrt(square) > radius + surface.extent[c]:
            continue
        for i in range(surface.start[c], surface.start[c + 1]):
            square = 0.0
            for d in range(3):
                square += (surface.points[i, d] - origin[d]) ** 2
            if square > radius * radius:
                continue
            if released:
                contact.force[t, i, :] = 0.0
                continue
            _modal_displacement(surface, i, a, out)
            point = surface.points[i]
            x, y, z = point[0] + out[0], point[1] + out[1], point[2] + out[2]
            tx, ty, tz = _bonded_position(surface, tools, t, i)
            farthest = max(farthest, abs(x - tx), abs(y - ty), abs(z - tz))
            count = _list_node(surface, contact, tools, t, i, x, y, z, v, step, count)
    return count, farthest


@kernel_njit(inner=True, fastmath={"contract"})
def _detect(surface, contact, tools, a, v, step):
    """List the nodes whose modal position is inside a tool; return the deepest penetration [m]."""
    count, deepest, depth, out = np.int64(0), 0.0, 0.0, contact.displacement  # a literal 0 is another type
    for t in range(tools.kind.shape[0]):
        kind, sizes, frame = tools.kind[t], tools.sizes[t], tools.frames[t, 1]
        if kind == BONDED:
            count, depth = _list_bonded(surface, contact, tools, t, a, v, step, count)
            deepest = max(deepest, depth)
            continue
        if sizes[0] == -np.inf:  # an absent tool
            continue
        for c in range(surface.leader.shape[0]):
            i = surface.leader[c]
            _modal_displacement(surface, i, a, out)
            point = surface.points[i]
            x, y, z = point[0] + out[0], point[1] + out[1], point[2] + out[2]
            far = gap(kind, sizes, frame, x, y, z)[0] > CLUSTER_STRETCH * surface.extent[c]
            if far and not contact.busy[t, c]:
                continue
            contact.busy[t, c] = not far
            for i in range(surface.start[c], surface.start[c + 1]):
                interior = False
                if not far:
                    _modal_displacement(surface, i, a, out)
                    point = surface.points[i]
                    x, y, z = point[0] + out[0], point[1] + out[1], point[2] + out[2]
                    depth = -gap(kind, sizes, frame, x, y, z)[0]
                    interior = depth > 0.0
                if not interior:
                    contact.force[t, i, :] = 0.0
                    continue
                deepest = max(deepest, depth)
                count = _list_node(surface, contact, tools, t, i, x, y, z, v, step, count)
    contact.numbers[PAIRS] = count
    return deepest


@kernel_njit(inline="always")
def _propagate(surface, contact, cached, e, x, y, z):
    """Move all nodes in contact by the change (x, y, z) of one force."""
    i, h = contact.point[e], contact.active.factor[contact.tool[e]]
    now, node = contact.now, contact.point
    x, y, z = h * x, h * y, h * z
    if not cached:
        block = contact.active.block
        for f in range(contact.numbers[PAIRS]):
            pair(surface.compliance, node[f], i, block)
            for d in range(3):
                now[f, d] += block[d, 0] * x + block[d, 1] * y + block[d, 2] * z
        return
    matrix, slot = contact.active.matrix, contact.active.slot
    s = slot[i]  # its row lies together; the matrix is symmetric
    for f in range(contact.numbers[PAIRS]):
        r = slot[node[f]]
        for d in range(3):
            now[f, d] += matrix[s, r, 0, d] * x + matrix[s, r, 1, d] * y + matrix[s, r, 2, d] * z


@kernel_njit(inline="always")
def _own_compliance(surface, contact, cached, e, nx, ny, nz):
    """Return a node's own compliance along a normal, and an upper bound of that across it [m/N]."""
    block, matrix = contact.active.block, contact.active.matrix
    i, h = contact.point[e], contact.active.factor[contact.tool[e]]
    if cached:
        s = contact.active.slot[i]
        for c in range(3):
            for d in range(3):
                block[c, d] = matrix[s, s, c, d]
    else:
        pair(surface.compliance, i, i, block)
    along = nx * (block[0, 0] * nx + 2 * block[0, 1] * ny) + ny * (block[1, 1] * ny + 2 * block[1, 2] * nz)
    along = h * (along + nz * (block[2, 2] * nz + 2 * block[0, 2] * nx))
    return along, h * (block[0, 0] + block[1, 1] + block[2, 2]) - along


@kernel_njit(inline="always")
def _set_force(surface, contact, cached, e, fx, fy, fz):
    """Set the force on a node and move all nodes; return the largest change of a component [N]."""
    push = contact.push
    x, y, z = fx - push[e, 0], fy - push[e, 1], fz - push[e, 2]
    push[e, 0], push[e, 1], push[e, 2] = fx, fy, fz
    if x != 0.0 or y != 0.0 or z != 0.0:
        _propagate(surface, contact, cached, e, x, y, z)
    return max(abs(x), abs(y), abs(z))


@kernel_njit(inline="always")
def relax(surface, contact, tools, cached, step, e):
    """Update the force on one node by its contact law; return a bound of the node's displacement [m]."""
    t = contact.tool[e]
    x, y, z = contact.now[e, 0], contact.now[e, 1], contact.now[e, 2]
    px, py, pz = contact.push[e, 0], contact.push[e, 1], contact.push[e, 2]
    if tools.kind[t] == BONDED:
        tx, ty, tz = _bonded_position(surface, tools, t, contact.node[e])
        largest = sum(_own_compliance(surface, contact, cached, e, 1.0, 0.0, 0.0))
        fx, fy, fz = px - (x - tx) / largest, py - (y - ty) / largest, pz - (z - tz) / largest
        return _set_force(surface, contact, cached, e, fx, fy, fz) * largest
    g, nx, ny, nz = gap(tools.kind[t], tools.sizes[t], tools.frames[t, 1], x, y, z)
    along, across = _own_compliance(surface, contact, cached, e, nx, ny, nz)
    normal = px * nx + py * ny + pz * nz - g / along
    if normal <= 0.0:
        fx, fy, fz = 0.0, 0.0, 0.0
    elif tools.friction[t] == 0.0:
        fx, fy, fz = normal * nx, normal * ny, normal * nz
    else:
        tx, ty, tz = material_velocity(tools.frames[t, 0], tools.frames[t, 1], step, x - g * nx, y - g * ny, z - g * nz)
        # the tangential force that stops the sliding of this step
        fx = px - (x - contact.before[e, 0] - step * tx) / across
        fy = py - (y - contact.before[e, 1] - step * ty) / across
        fz = pz - (z - contact.before[e, 2] - step * tz) / across
        inward = fx * nx + fy * ny + fz * nz
        fx, fy, fz = fx - inward * nx, fy - inward * ny, fz - inward * nz
        size, limit = np.sqrt(fx * fx + fy * fy + fz * fz), tools.friction[t] * normal
        share = limit / size if size > limit else 1.0
        fx, fy, fz = share * fx + normal * nx, share * fy + normal * ny, share * fz + normal * nz
    return _set_force(surface, contact, cached, e, fx, fy, fz) * max(along, across)


@kernel_njit(inner=True, fastmath={"contract"})
def _tool_force(contact, t):
    """Return the size [N] of the sum of a tool's forces on the nodes."""
    x, y, z = 0.0, 0.0, 0.0
    for e in range(contact.numbers[PAIRS]):
        if contact.tool[e] == t:
            x, y, z = x + contact.push[e, 0], y + contact.push[e, 1], z + contact.push[e, 2]
    return np.sqrt(x * x + y * y + z * z)


@kernel_njit(inner=True, fastmath={"contract"})
def _start_factors(surface, contact, tools):
    """Set the secant factors of the compliance by the tools' last forces; forceps have the bonded scale."""
    for t in range(contact.active.factor.shape[0]):
        if tools.kind[t] == BONDED:
            contact.active.factor[t] = surface.compliance.bonded_scale
        else:
            contact.active.factor[t] = secant_factor(surface.compliance.stiffening, _tool_force(contact, t))


@kernel_njit(inner=True, fastmath={"contract"})
def _scale_forces(surface, contact, tools, step, response, moving):
    """Scale the forces of every tool by `stiffened_force`, and add up their forces on the coordinates.

    The sweeps solve for the product of forces and secant factor, on which the positions depend. A factor
    of the last step's force would lag behind the force, and add energy.
    """
    tools.load[:] = 0.0
    for t in range(contact.active.factor.shape[0]):
        load, factor, scale, compliant, moved = tools.own_load, contact.active.factor[t], 1.0, 0.0, 0.0
        load[:] = 0.0
        for e in range(contact.numbers[PAIRS]):
            if contact.tool[e] == t:
                for d in range(3):
                    push = contact.push[e, d]
                    compliant += push * (contact.now[e, d] - contact.modal[e, d])
                    for m in range(load.shape[0] if push != 0.0 else 0):
                        load[m] += surface.columns[contact.node[e], d, m] * push
        if tools.kind[t] != BONDED and compliant > 0.0:
            for m in range(moving):
                value = 0.0
                for k in range(moving):
                    value += response[m, k] * load[k]
                moved += load[m] * value
            size, inertia = _tool_force(contact, t), factor * step * step * moved / compliant
            contact.active.factor[t], left = stiffened_force(surface.compliance.stiffening, factor * size, inertia)
            scale = left * factor / contact.active.factor[t]
            for e in range(contact.numbers[PAIRS]):
                if contact.tool[e] == t:
                    for d in range(3):
                        contact.push[e, d] *= scale
        for m in range(load.shape[0]):
            tools.load[m] += scale * load[m]


@kernel_njit(fastmath={"contract"})
def solve_contact(surface, contact, tools, a, v, step, response, moving):
    """Solve for the forces of the tools at the end of a step [s].

    `a` and `v` (m,) are coordinates and velocities without the forces of this step. `response` (m, m) [1/kg] is the
    inverse mass matrix of the first `moving` coordinates, which are not prescribed.

    `tools.load` receives the forces on the coordinates; impulses and moments accumulate. Returns the work of the tools
    and the part that friction dissipates [J].
    """
    tools.load[:] = 0.0
    held = press_held_nodes(
        tools.held, tools.kind, tools.sizes, tools.friction, tools.frames, step, step, tools.impulses
    )
    deepest = _detect(surface, contact, tools, a, v, step)
    count = contact.numbers[PAIRS]
    contact.numbers[SWEEPS] = 0
    if count == 0:
        return held
    cached = refresh(surface.compliance, contact.active, contact.point, count)
    _start_factors(surface, contact, tools)
    for e in range(count):
        for d in range(3):
            contact.now[e, d] = contact.modal[e, d]
    for e in range(count):
        x, y, z = contact.push[e, 0], contact.push[e, 1], contact.push[e, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            _propagate(surface, contact, cached, e, x, y, z)
    largest = 0.0
    for sweep in range(MAX_SWEEPS):
        largest = 0.0
        for e in range(count):
            largest = max(largest, relax(surface, contact, tools, cached, step, e))
        contact.numbers[SWEEPS] = sweep + 1
        if largest < SWEEP_TOLERANCE * deepest:
            break
    if largest >= SWEEP_TOLERANCE * deepest:
        contact.numbers[UNCONVERGED] += 1
    _scale_forces(surface, contact, tools, step, response, moving)
    work, lost = _store(surface, contact, tools, step)
    return work + held[0], lost + held[1]


@kernel_njit(inner=True, fastmath={"contract"})
def _store(surface, contact, tools, step):
    """Store forces and positions for the next step, and add up the impulses; return the work as `solve_contact`."""
    work, lost = 0.0, 0.0
    for e in range(contact.numbers[PAIRS]):
        i, t = contact.node[e], contact.tool[e]
        origin, place, push = tools.frames[t, 1, :, 3], contact.now[e], contact.push[e]
        speed = material_velocity(tools.frames[t, 0], tools.frames[t, 1], step, place[0], place[1], place[2])
        for d in range(3):
            b, c = (d + 1) % 3, (d + 2) % 3
            moment = (place[b] - origin[b]) * push[c] - (place[c] - origin[c]) * push[b]
            contact.force[t, i, d], contact.place[t, i, d] = push[d], place[d]
            tools.impulses[t, d] += step * push[d]
            tools.impulses[t, 3 + d] += step * moment
            tools.nodal_impulses[i, d] += step * push[d]
            work += step * push[d] * speed[d]
            lost += push[d] * (step * speed[d] - (place[d] - contact.before[e, d]))
    return work, lost


@kernel_njit(inner=True, fastmath={"contract"})
def set_tool_paths(tools, home, target, at_rest):
    """Set the paths of tools during a period to target poses (12 t,): displacement and R - I of each, from home.

    The path starts at the target if body and target are at rest, at the start of a run.
    """
    for t in range(tools.kind.shape[0]):
        path, first, target_at_rest = tools.path[t], 12 * t, True
        for i in range(12):
            target_at_rest = target_at_rest and target[first + i] == 0.0
        for i in range(3):
            for j in range(4):
                path[PATH_START, i, j] = path[PATH_END, i, j]
            for j in range(3):
                path[PATH_END, i, j] = target[first + 3 + 3 * i + j] + (1.0 if i == j else 0.0)
            path[PATH_END, i, 3] = home[t, i, 3] + target[first + i]
        if at_rest and target_at_rest:
            for i in range(3):
                for j in range(4):
                    path[PATH_START, i, j] = path[PATH_END, i, j]
        if at_rest:
            place_frame(path[PATH_START], home[t], tools.frames[t, 1])


@kernel_njit(inline="always")
def place_frame(turned, home, frame):
    """Write the frame (3, 4) of a tool at home that is turned and then placed by another."""
    for i in range(3):
        for j in range(3):
            frame[i, j] = turned[i, 0] * home[0, j] + turned[i, 1] * home[1, j] + turned[i, 2] * home[2, j]
        frame[i, 3] = turned[i, 3]


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def kick_by_load(v, step, response, load):
    """Accelerate coordinates (m,) by a load on them during a step [s]."""
    for m in range(v.shape[0]):
        value = 0.0
        for k in range(v.shape[0]):
            value += response[m, k] * load[k]
        v[m] += step * value


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def press(data, q, v, at, step, period, share, tool_forces):
    """Advance the tools to a fraction of their paths in a period [s], and apply their forces in a step [s].

    `share` is the fraction at the end of the step. The velocities `v` (m,) change; `at` (m,) is scratch. `tool_forces`
    (12 t,) receives the means of the forces that are conjugate to each tool's displacement and to the entries of its
    rotation R from home. For the latter they are G = S R, with S the moment's cross product.
    """
    tools, response = data.tools, data.body.constants.constrained_inverse_mass
    for t in range(tools.kind.shape[0]):
        path = tools.path[t]
        for i in range(3):
            for j in range(4):
                tools.frames[t, 0, i, j] = tools.frames[t, 1, i, j]
                path[PATH_NOW, i, j] = path[PATH_START, i, j] + share * (path[PATH_END, i, j] - path[PATH_START, i, j])
        place_frame(path[PATH_NOW], data.home[t], tools.frames[t, 1])
    for m in range(q.shape[0]):
        at[m] = q[m] + step * v[m]
    tools.impulses[:] = 0.0
    solve_contact(data.contact_surface, data.contact_work, tools, at, v, step, response, q.shape[0])
    drag = 1.0 + 0.5 * data.body.constants.mass_damping * step  # as that of the other forces in a kick
    kick_by_load(v, step / drag, response, tools.load)
    for t in range(tools.kind.shape[0]):
        first, turned = 12 * t, tools.path[t, PATH_NOW]
        for i in range(3):
            k, m = (i + 1) % 3, (i + 2) % 3
            tool_forces[first + i] += tools.impulses[t, i] / period
            half = 0.5 * tools.impulses[t, 3 + i] / period
            for j in range(3):
                tool_forces[first + 3 + 3 * m + j] += half * turned[k, j]
                tool_forces[first + 3 + 3 * k + j] -= half * turned[m, j]


@kernel_njit(inner=True, fastmath={"contract"})
def approach_speed(contact, path, period, t):
    """Return the speed [m/s] of tool t on its path in a period [s] along its force on the body, at least 0."""
    square, power = 0.0, 0.0
    for d in range(3):
        total = 0.0
        for e in range(contact.numbers[PAIRS]):
            if contact.tool[e] == t:
                total += contact.push[e, d]
        square += total * total
        power += total * (path[PATH_END, d, 3] - path[PATH_START, d, 3]) / period
    return max(power, 0.0) / np.sqrt(square) if square > 0.0 else 0.0


@kernel_njit(inner=True, fastmath={"contract"})
def contact_nearness(nearness, contact, t, held=0.0):
    """Return `palpate.reduction.hyper.error_indicator.support_nearness` of tool t, and 1 if it touches, or 0."""
    total, size = HELD_NEARNESS * held, held
    for e in range(contact.numbers[PAIRS]):
        push = contact.push[e]
        square = push[0] ** 2 + push[1] ** 2 + push[2] ** 2
        if contact.tool[e] == t and square > 0.0:
            size += np.sqrt(square)
            total += np.sqrt(square) * nearness[contact.node[e]]
    return (total / size, 1) if size > 0.0 else (0.0, 0)


@kernel_njit(inner=True, fastmath={"contract"})
def tool_energy(surface, contact, t):
    """Return the energy [J] of the surface compliance under one tool."""
    x, y, z, half, bonded = 0.0, 0.0, 0.0, 0.0, False
    for e in range(contact.numbers[PAIRS]):
        if contact.tool[e] != t:
            continue
        bonded = contact.point[e] >= surface.points.shape[0]
        x, y, z = x + contact.push[e, 0], y + contact.push[e, 1], z + contact.push[e, 2]
        for d in range(3):
            half += 0.5 * contact.push[e, d] * (contact.now[e, d] - contact.modal[e, d])
    return half if bonded else energy_factor(surface.compliance.stiffening, np.sqrt(x * x + y * y + z * z)) * half


@kernel_njit(inner=True, fastmath={"contract"})
def compliance_energy(surface, contact):
    """Return the energy [J] of the surface compliance."""
    total = 0.0
    for t in range(contact.active.factor.shape[0]):
        total += tool_energy(surface, contact, t)
    return max(total, 0.0)
