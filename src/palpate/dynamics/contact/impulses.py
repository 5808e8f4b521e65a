"""The impulses of rigid tools on a body in one explicit step, compiled.

Patches of surface that would be inside a tool at the end of a step are put onto its surface by an impulse along its
normal: the forward increment Lagrange multipliers of Carpenter, Taylor and Katona (Int. J. Numer. Meth. Engng 32,
1991). Nothing is penalised, so that no stiffness is chosen, no patch enters a tool, and the stable step stays what it
was. With the normal impulse p the tangential one is what stops the sliding, but at most mu p (Coulomb).

An impulse P on patch i is w_ij P on the nodes j, changes the patch's velocity by P / m, 1 / m = sum of w_ij^2 / m_j,
and those of the patches around. In a step of length dt, with the velocity v that all other impulses leave the patch,
the place x = X + u + dt v and the gap g(x) < 0 to the tool where it will be,

    P_n = - m g / dt,    P_t = - m w_t min(1, mu P_n / (m |w_t|)),

w_t the sliding velocity against the tool's matter at that place. Where patches share nodes, Gauss and Seidel's sweeps
find impulses that do this on all of them, from those of the step before (Moreau, in Nonsmooth Mechanics and
Applications, CISM 302, 1988). Impulses on the nodes and their opposites on the tool are the same numbers: momentum is
exact. At the end of a call of some steps, patches that touch a tool must not move into it with their half kick; that is
the same law for velocities.
"""

from __future__ import annotations

from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.contact.geometry import coulomb, gap, material_velocity, patch, rotation

__all__ = ["push"]

SWEEPS, ENOUGH = 30, 3e-2  # most sweeps; change of an impulse, of the largest, that ends them


@kernel_njit(inner=True)
def _give(first, near, weights, rate, i, x, y, z, impulse, velocity):  # type: ignore[no-untyped-def]
    """Give the nodes of a patch, with `rate` their 1 / mass, their shares of an impulse (3) [N s]."""
    for c in range(first[i], first[i + 1]):
        j, w = near[c], weights[c]
        impulse[j, 0] += w * x
        impulse[j, 1] += w * y
        impulse[j, 2] += w * z
        velocity[j, 0] += w * rate[j] * x
        velocity[j, 1] += w * rate[j] * y
        velocity[j, 2] += w * rate[j] * z


@kernel_njit(inner=True)
def _begin(contacts, ahead, again, time, u, velocity, mass):  # type: ignore[no-untyped-def]
    """Find the patches that are close to a tool, and push them `again` times as much as in the step before."""
    points, first, near, weights = contacts.points, contacts.first, contacts.near, contacts.weights
    nodes, prescribed_until, active, pushes = (
        contacts.nodes,
        contacts.prescribed_until,
        contacts.active,
        contacts.pushes,
    )
    rate, impulse = contacts.rate, contacts.impulse
    for k in active[: contacts.found[0]]:
        for c in range(first[nodes[k]], first[nodes[k] + 1]):
            impulse[near[c]] = 0.0
    count, close, around = 0, contacts.close, contacts.close + contacts.spread
    for t in range(contacts.kind.shape[0]):
        kind, sizes, frame = contacts.kind[t], contacts.sizes[t], contacts.frames[t, 1]
        reach = contacts.bounds[t] + around
        for k in range(contacts.start[t], contacts.start[t + 1]):
            i = nodes[k]
            x = points[i, 0] + u[i, 0] + ahead * velocity[i, 0]
            y = points[i, 1] + u[i, 1] + ahead * velocity[i, 1]
            z = points[i, 2] + u[i, 2] + ahead * velocity[i, 2]
            square = (x - frame[0, 3]) ** 2 + (y - frame[1, 3]) ** 2 + (z - frame[2, 3]) ** 2
            found = (
                square < reach * reach and time > prescribed_until[i] and gap(kind, sizes, frame, x, y, z)[0] < around
            )
            if found:  # its node, which costs less to ask
                x, y, z, _, _, _ = patch(points, first, near, weights, i, ahead, u, velocity)
                found = gap(kind, sizes, frame, x, y, z)[0] < close
            if not found:
                if pushes[k, 3] != 0.0:
                    pushes[k] = 0.0
                continue
            response = 0.0
            for c in range(first[i], first[i + 1]):
                j = near[c]
                rate[j] = 1.0 / mass[j] if time > prescribed_until[j] else 0.0
                response += weights[c] ** 2 * rate[j]
            pushes[k] *= again
            pushes[k, 3] = response
            _give(first, near, weights, rate, i, pushes[k, 0], pushes[k, 1], pushes[k, 2], impulse, velocity)
            active[count] = k
            count += 1
    contacts.found[0] = count


@kernel_njit(inner=True)
def _sweep(contacts, ends, step, u, velocity):  # type: ignore[no-untyped-def]
    """Give every close patch the impulse that its tool asks for; return the largest change, and the largest [m/s].

    With `ends` the step is over, and only patches that touch the tool and move into it are pushed.
    """
    points, first, near, weights = contacts.points, contacts.first, contacts.near, contacts.weights
    kind, sizes, friction, frames = contacts.kind, contacts.sizes, contacts.friction, contacts.frames
    nodes, tool, pushes, rate, impulse = contacts.nodes, contacts.tool, contacts.pushes, contacts.rate, contacts.impulse
    changed, largest, ahead, tolerance = 0.0, 0.0, 0.0 if ends else step, contacts.tolerance
    for k in contacts.active[: contacts.found[0]]:
        i, t, response = nodes[k], tool[k], pushes[k, 3]
        ox, oy, oz = pushes[k, 0], pushes[k, 1], pushes[k, 2]
        x, y, z, vx, vy, vz = patch(points, first, near, weights, i, ahead, u, velocity)
        g, nx, ny, nz = gap(kind[t], sizes[t], frames[t, 1], x, y, z)
        if not ends:  # the place on the surface
            x, y, z = x - g * nx, y - g * ny, z - g * nz
        tx, ty, tz = material_velocity(frames[t, 0], frames[t, 1], step, x, y, z)
        # against the tool's matter, without the impulse so far
        wx, wy, wz = vx - tx - response * ox, vy - ty - response * oy, vz - tz - response * oz
        if ends:
            normal = -(wx * nx + wy * ny + wz * nz) if g < tolerance else 0.0
        else:
            normal = response * (ox * nx + oy * ny + oz * nz) - g / step
        px, py, pz = 0.0, 0.0, 0.0
        if normal > 0.0:
            px, py, pz = coulomb(normal, friction[t], wx, wy, wz, nx, ny, nz)
            px, py, pz = (px + normal * nx) / response, (py + normal * ny) / response, (pz + normal * nz) / response
        pushes[k, 0], pushes[k, 1], pushes[k, 2] = px, py, pz
        largest = max(largest, response * max(abs(px), abs(py), abs(pz)))
        px, py, pz = px - ox, py - oy, pz - oz
        if px != 0.0 or py != 0.0 or pz != 0.0:
            changed = max(changed, response * max(abs(px), abs(py), abs(pz)))
            _give(first, near, weights, rate, i, px, py, pz, impulse, velocity)
    return changed, largest


@kernel_njit(inner=True)
def _add_up(contacts, k, ahead, step, u, velocity, kick, loading):  # type: ignore[no-untyped-def]
    """Add one patch's impulse to what the tools have given; return works [J] as `push` does.

    Work on a node is the impulse times the mean of its velocities before the kick and after everything.
    """
    i, t, push, rate = contacts.nodes[k], contacts.tool[k], contacts.pushes[k], contacts.rate
    force, surface, gravity, half_cell, volumes, density = loading
    origin = contacts.frames[t, 1, :, 3]
    place = patch(contacts.points, contacts.first, contacts.near, contacts.weights, i, ahead, u, velocity)[:3]
    speed = material_velocity(contacts.frames[t, 0], contacts.frames[t, 1], step, place[0], place[1], place[2])
    tools, given, loads = 0.0, 0.0, 0.0
    for d in range(3):
        a, b = (d + 1) % 3, (d + 2) % 3
        contacts.total[t, d] += push[d]
        contacts.total[t, 3 + d] += (place[a] - origin[a]) * push[b] - (place[b] - origin[b]) * push[a]
        tools += push[d] * speed[d]
    for c in range(contacts.first[i], contacts.first[i + 1]):
        j = contacts.near[c]
        for d in range(3):
            share, mean = contacts.weights[c] * push[d], velocity[j, d]
            contacts.given[j, d] += share
            if rate[j] > 0.0:
                kicked = kick * ((force[j, d] + half_cell * surface[j, d]) / density + gravity[d])
                mean -= 0.5 * (kicked + contacts.impulse[j, d] * rate[j])
                loads += 0.5 * kick * volumes[j] * (surface[j, d] + density * gravity[d]) * share * rate[j]
            else:  # what holds the node takes it
                loads -= share * mean
            given += share * mean
    return tools, tools - given, loads


@kernel_njit()
def push(contacts, poses, s, time, step, kick, u, velocity, mass, force, surface, gravity, half_cell, volumes, density):  # type: ignore[no-untyped-def]
    """Let the tools push the body after the kick of step s.

    The last of the `poses` (s, t, 7) [m] has no step after it.

    Returns
    -------
    tools, lost, loads : float [J]
        Works of the tools, lost by friction and impact, and more of the loads and of what holds nodes.
    """
    ends = s == poses.shape[0] - 1
    first, ahead = (s - 1, 0.0) if ends else (s, step)
    for t in range(contacts.kind.shape[0]):
        rotation(poses[first, t], contacts.frames[t, 0])
        rotation(poses[first + 1, t], contacts.frames[t, 1])
    # the first kick of a call is half of the others, and begins anew
    again = 0.0 if s == 0 else kick / (0.5 * step if s == 1 else step)
    _begin(contacts, ahead, again, time, u, velocity, mass)
    for _ in range(SWEEPS):
        changed, largest = _sweep(contacts, ends, step, u, velocity)
        if changed <= ENOUGH * largest:
            break
    tools, lost, loads = 0.0, 0.0, 0.0
    loading = (force, surface, gravity, half_cell, volumes, density)
    for k in contacts.active[: contacts.found[0]]:
        if contacts.pushes[k, 0] != 0.0 or contacts.pushes[k, 1] != 0.0 or contacts.pushes[k, 2] != 0.0:
            works = _add_up(contacts, k, ahead, step, u, velocity, kick, loading)
            tools, lost, loads = tools + works[0], lost + works[1], loads + works[2]
    return tools, lost, loads
