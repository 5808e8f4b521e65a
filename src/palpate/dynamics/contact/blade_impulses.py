"""The compiled impulses of blades in one explicit step.

A site is a point of the tissue at the blade, whose displacement is a weighted sum over nodes. Its impulse in a step
follows from the velocity of the tissue relative to the blade, by sweeps over all sites, as in
`palpate.dynamics.contact.impulses`. At the edge an impulse stops the tissue that moves into it, within the force
that cuts, which is smaller for an edge that is drawn along itself. At a side, one along its normal keeps the face of
the cut out of the blade, and one across it stops its sliding within the friction.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.dynamics.contact.blade_sites import EDGE_SITE, FACE_SITE, PAIR_SITE
from palpate.dynamics.contact.geometry import project

MAX_SITE_SWEEPS, SITE_TOLERANCE = 30, 3e-2  # of the impulses in a step, and largest change in the last one, relative
RECOVERY_TIME = 0.01  # [s] in which a face leaves a blade that it is in


@kernel_njit(inner=True)
def clear_sites(contacts, time, mass, drag):
    """Prepare the nodes of the sites for the impulses of a step that ends at a time [s]."""
    sites = contacts.sites
    for e in range(sites.nodes.shape[0]):
        j = sites.nodes[e]
        contacts.work.inverse_mass[j] = 1.0 / (drag * mass[j]) if time > contacts.patches.prescribed_until[j] else 0.0
        for c in range(3):
            contacts.work.step_impulses[j, c] = 0.0


@kernel_njit(inner=True)
def _turned(frame, v):
    """Return a vector of the tool's frame in space."""
    return (
        frame[0, 0] * v[0] + frame[0, 1] * v[1] + frame[0, 2] * v[2],
        frame[1, 0] * v[0] + frame[1, 1] * v[1] + frame[1, 2] * v[2],
        frame[2, 0] * v[0] + frame[2, 1] * v[1] + frame[2, 2] * v[2],
    )


@kernel_njit(inner=True)
def _tissue(sites, s, u, velocity, inverse_mass):
    """Return the position (3) and the velocity (3) of the tissue at a site, and the sum of w^2 / m."""
    x, y, z = sites.points[s, 0], sites.points[s, 1], sites.points[s, 2]
    vx, vy, vz, response = 0.0, 0.0, 0.0, 0.0
    for e in range(sites.start[s], sites.start[s + 1]):
        j, w = sites.nodes[e], sites.weights[e]
        response += w * w * inverse_mass[j]
        x, y, z = x + w * u[j, 0], y + w * u[j, 1], z + w * u[j, 2]
        vx, vy, vz = vx + w * velocity[j, 0], vy + w * velocity[j, 1], vz + w * velocity[j, 2]
    return (x, y, z), (vx, vy, vz), response


@kernel_njit(inner=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel_njit(inner=True)
def _slip(sites, s, place, at, frame, normal):
    """Return how far [m] an edge at a point of its frame is beyond the tissue at its site."""
    return (
        (at[0] + frame[0, 3] - place[0] - sites.offsets[s, 0]) * normal[0]
        + (at[1] + frame[1, 3] - place[1] - sites.offsets[s, 1]) * normal[1]
        + (at[2] + frame[2, 3] - place[2] - sites.offsets[s, 2]) * normal[2]
    )


@kernel_njit(inner=True)
def _edge_impulse(frame, direction, relative, response, most, before, clear):
    """Return the impulse of the edge on the tissue, in place of the one before in this step, for a push at most `most`.

    The force opposes the velocity w of the tissue relative to the edge, and its power is that of the normal part times
    the force of a straight push: F = F_push w_n w / |w|^2 (Atkins, Xu and Jeronimidis, Journal of Materials Science 39,
    2004). With the velocity after the impulse, w' = (1 - most w_n / (m |w|^2)) w; the tissue stops where this is
    negative. `clear` is the speed at which the edge just reaches the front at the end of the step. A blade that moves
    more across its flat than ahead takes the tissue with it.
    """
    normal, tangent = _turned(frame, direction), _turned(frame, (-direction[2], 0.0, direction[0]))
    flat = _turned(frame, (0.0, 1.0, 0.0))
    advance = _dot(before, normal) * response - _dot(relative, normal) - clear
    across = _dot(relative, flat) - _dot(before, flat) * response
    slide = _dot(relative, tangent) - _dot(before, tangent) * response
    push, pull, hold = 0.0, 0.0, -across / response
    if advance > 0.0:
        turned = across if abs(across) < advance else 0.0
        square = advance * advance + turned * turned + slide * slide
        share = min(1.0, most * response * advance / square) / response
        push, pull = share * advance, -share * slide
        if turned != 0.0:
            hold = -share * across
    return (
        push * normal[0] + pull * tangent[0] + hold * flat[0],
        push * normal[1] + pull * tangent[1] + hold * flat[1],
        push * normal[2] + pull * tangent[2] + hold * flat[2],
    )


@kernel_njit(inner=True)
def _face_impulse(normal, along, relative, response, needed, most, before):
    """Return the impulse for a change `needed` [m/s] of a face's normal velocity, with its friction."""
    size = _dot(before, normal)
    pressed = max(size + needed / response, 0.0)
    x = before[0] - size * normal[0] - (relative[0] - along * normal[0]) / response
    y = before[1] - size * normal[1] - (relative[1] - along * normal[1]) / response
    z = before[2] - size * normal[2] - (relative[2] - along * normal[2]) / response
    length = np.sqrt(x * x + y * y + z * z)
    share = 1.0 if length <= most else most / length
    return share * x + pressed * normal[0], share * y + pressed * normal[1], share * z + pressed * normal[2]


@kernel_njit(inner=True)
def _push_pair(contacts, s, ends, step, u, velocity):
    """Push the faces of a cut apart that would enter each other; return the squared change and the squared impulse."""
    sites = contacts.sites
    opening, speed, response = _tissue(sites, s, u, velocity, contacts.work.inverse_mass)
    normal = sites.directions[s]
    gap, along, old = _dot(opening, normal), _dot(speed, normal), _dot(sites.impulses[s], normal)
    if ends:  # moves no node
        needed = -along if gap < contacts.gaps.contact else -np.inf
    else:
        needed = (max(0.0, 1.0 - step / RECOVERY_TIME) * min(gap, 0.0) - gap) / step - along
    new = max(old + needed / response, 0.0) if response > 0.0 else 0.0
    if new != old:
        _add_impulse(contacts, s, (new - old) * normal[0], (new - old) * normal[1], (new - old) * normal[2], velocity)
    return (new - old) ** 2, new**2


@kernel_njit(inner=True)
def _add_impulse(contacts, s, x, y, z, velocity):
    """Distribute an impulse (3) [N s] on a site to its nodes, and change their velocities."""
    sites = contacts.sites
    for e in range(sites.start[s], sites.start[s + 1]):
        j, w = sites.nodes[e], sites.weights[e]
        free = project(contacts.patches.slide, contacts.patches.slide_of[j], x, y, z)
        contacts.work.step_impulses[j, 0] += w * x
        contacts.work.step_impulses[j, 1] += w * y
        contacts.work.step_impulses[j, 2] += w * z
        for c in range(3):
            velocity[j, c] += w * contacts.work.inverse_mass[j] * free[c]
    sites.impulses[s, 0] += x
    sites.impulses[s, 1] += y
    sites.impulses[s, 2] += z


@kernel_njit(inner=True)
def push_sites(contacts, ends, step, kick, u, velocity):
    """Change the velocities of the nodes by the impulses of the sites in a step; see `push_patches`."""
    sites = contacts.sites
    sites.impulses[:] = 0.0
    for _ in range(MAX_SITE_SWEEPS):
        changed, largest = 0.0, 0.0
        for s in range(sites.tool.shape[0]):
            if sites.kind[s] == PAIR_SITE:
                change, size = _push_pair(contacts, s, ends, step, u, velocity)
                changed, largest = max(changed, change), max(largest, size)
            if sites.tool[s] < 0:
                continue
            first, last = contacts.work.frames[sites.tool[s], 0], contacts.work.frames[sites.tool[s], 1]
            place, speed, response = _tissue(sites, s, u, velocity, contacts.work.inverse_mass)
            if not response > 0.0:
                continue
            start, end = _turned(first, sites.places[s]), _turned(last, sites.places[s])
            normal = _turned(last, sites.directions[s])
            relative = (
                speed[0] - (end[0] + last[0, 3] - start[0] - first[0, 3]) / step,
                speed[1] - (end[1] + last[1, 3] - start[1] - first[1, 3]) / step,
                speed[2] - (end[2] + last[2, 3] - start[2] - first[2, 3]) / step,
            )
            along = _dot(relative, normal)
            old = sites.impulses[s, 0], sites.impulses[s, 1], sites.impulses[s, 2]
            if sites.kind[s] == EDGE_SITE:
                if ends:  # moves no node
                    behind = sites.slips[s] - _slip(sites, s, place, end, last, normal)
                    clear = 0.0 if behind < contacts.gaps.contact else np.inf
                else:
                    clear = (sites.slips[s] - _slip(sites, s, place, start, first, normal)) / step
                new = _edge_impulse(last, sites.directions[s], relative, response, sites.limits[s] * kick, old, clear)
            else:
                at, origin = (end, last[:, 3]) if ends else (start, first[:, 3])
                away = place[0] - at[0] - origin[0], place[1] - at[1] - origin[1], place[2] - at[2] - origin[2]
                gap = _dot(away, normal)
                if ends:  # moves no node
                    needed = -along if gap < contacts.gaps.contact else -np.inf
                else:
                    needed = (max(0.0, 1.0 - step / RECOVERY_TIME) * min(gap, 0.0) - gap) / step - along
                new = _face_impulse(normal, along, relative, response, needed, sites.limits[s] * kick, old)
            change = new[0] - old[0], new[1] - old[1], new[2] - old[2]
            _add_impulse(contacts, s, change[0], change[1], change[2], velocity)
            changed, largest = max(changed, _dot(change, change)), max(largest, _dot(new, new))
        if changed <= SITE_TOLERANCE**2 * largest:
            break


@kernel_njit(inner=True)
def site_works(contacts, ends, step, kick, u, velocity, data):
    """Add the impulses of the sites to the sums of the call; return energies as `contact_impulses`."""
    nodes, scratch, gravity, drag = data
    sites, density = contacts.sites, nodes.density
    for s in range(sites.tool.shape[0]):
        if sites.kind[s] == EDGE_SITE and sites.tool[s] >= 0:
            last = contacts.work.frames[sites.tool[s], 1]
            place, speed, _ = _tissue(sites, s, u, velocity, contacts.work.inverse_mass)
            ahead = 0.0 if ends else step
            end = place[0] + ahead * speed[0], place[1] + ahead * speed[1], place[2] + ahead * speed[2]
            normal, at = _turned(last, sites.directions[s]), _turned(last, sites.places[s])
            sites.slips[s] = max(sites.slips[s], _slip(sites, s, end, at, last, normal))
    tools, lost, loads = 0.0, 0.0, 0.0
    for s in range(sites.tool.shape[0]):
        push, t = sites.impulses[s], sites.tool[s]
        if push[0] == 0.0 and push[1] == 0.0 and push[2] == 0.0:
            continue
        power, on_nodes, rubbed = 0.0, 0.0, 0.0
        along = push[0], push[1], push[2]  # the face
        if t >= 0:
            first, last = contacts.work.frames[t, 0], contacts.work.frames[t, 1]
            start, end = _turned(first, sites.places[s]), _turned(last, sites.places[s])
            for d in range(3):
                a, b = (d + 1) % 3, (d + 2) % 3
                contacts.work.tool_impulses[t, d] += push[d]
                contacts.work.tool_impulses[t, 3 + d] += end[a] * push[b] - end[b] * push[a]
                power += push[d] * (end[d] + last[d, 3] - start[d] - first[d, 3]) / step
            if sites.kind[s] == FACE_SITE:
                normal = _turned(last, sites.directions[s])
                pressed = _dot(along, normal)
                along = along[0] - pressed * normal[0], along[1] - pressed * normal[1], along[2] - pressed * normal[2]
                for d in range(3):
                    rubbed += along[d] * (end[d] + last[d, 3] - start[d] - first[d, 3]) / step
        for e in range(sites.start[s], sites.start[s + 1]):
            j, w = sites.nodes[e], sites.weights[e]
            free = project(contacts.patches.slide, contacts.patches.slide_of[j], push[0], push[1], push[2])
            inverse_mass = contacts.work.inverse_mass[j]
            for d in range(3):
                contacts.work.nodal_impulses[j, d] += w * push[d]
                mean, surface = velocity[j, d], scratch.surface[j, d]
                if inverse_mass > 0.0:
                    kicked = kick * ((scratch.force[j, d] + nodes.half_cell * surface) / density + gravity[d])
                    mean -= 0.5 * (kicked + contacts.work.step_impulses[j, d] * inverse_mass)
                    loads += (
                        0.5 * kick * nodes.volumes[j] * (surface + density * gravity[d]) * w * free[d] * inverse_mass
                    )
                    on_nodes += w * free[d] * mean / drag
                else:  # the constraint takes the impulse
                    loads -= w * push[d] * mean
                    on_nodes += w * push[d] * mean
                rubbed -= w * along[d] * mean
        if sites.kind[s] == EDGE_SITE:
            sites.works[EDGE_SITE] += power - on_nodes
        elif sites.kind[s] == FACE_SITE:  # without what an impulse along the normal takes
            sites.works[FACE_SITE] += rubbed
        tools, lost = tools + power, lost + power - on_nodes
    return tools, lost, loads
