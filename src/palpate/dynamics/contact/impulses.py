"""The compiled contact impulses of rigid tools in one explicit step.

Patches of surface that would be inside a tool at the end of a step are moved onto its surface by an
impulse along its normal. This is the forward increment Lagrange multiplier method of Carpenter,
Taylor and Katona (Int. J. Numer. Meth. Engng 32, 1991). It requires no penalty stiffness, no patch
enters a tool, and the stable step is unchanged. The tangential impulse stops the sliding within the
Coulomb limit of mu times the normal impulse.

An impulse P on patch i is w_ij P on the nodes j. It changes the patch's velocity by P / m,
1 / m = sum of w_ij^2 / m_j, and those of the neighbouring patches. In a step of length dt, with the
velocity v that all other impulses leave the patch, the position x = X + u + dt v and the gap
g(x) < 0 to the tool in its next pose,

    P_n = - m g / dt,    P_t = - m w_t min(1, mu P_n / (m |w_t|)),

with w_t the sliding velocity relative to the tool's material point at that position. Patches that
share nodes are solved by Gauss-Seidel sweeps, from the impulses of the previous step (Moreau, in
Nonsmooth Mechanics and Applications, CISM 302, 1988). Impulses on the nodes and their reactions on
the tool are the same numbers, so momentum is exact. At the end of a call, patches in contact must
not move into the tool with their half kick; the same law holds for velocities.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numba import prange

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.reference import reference
from palpate.dynamics.contact.blade_impulses import clear_sites, push_sites, site_works
from palpate.dynamics.contact.geometry import (
    Contacts,
    chord_depth,
    coulomb,
    gap,
    material_velocity,
    patch,
    project,
    rotation,
)
from palpate.dynamics.contact.held import press_held_nodes
from palpate.dynamics.contact.kinds import BLADE

# what touches a body, by which its steps are compiled: no tool, tools, or tools with a blade among them
NO_TOOLS, RIGID_TOOLS, WITH_BLADE = range(3)

MAX_SWEEPS = 30
MIN_FREEDOM = 0.01  # of a sliding node: least squared part of a tool's normal along its free directions
RECOVERY_TIME = 0.01  # [s] in which a patch leaves a tool that was put down in it
BLOCK_CANDIDATES = 512  # of a part of the search
SWEEP_TOLERANCE = 1e-2  # largest change of an impulse in the last sweep, relative to the largest impulse


def contact_kind(contacts: Contacts) -> int:
    """Return what touches a body: NO_TOOLS, RIGID_TOOLS, or WITH_BLADE where a blade or faces of a cut do."""
    if len(contacts.sites.kind) or BLADE in contacts.tools.kind:
        return WITH_BLADE
    return RIGID_TOOLS if len(contacts.tools.kind) else NO_TOOLS


@kernel_njit(inner=True)
def _apply_to_patch(contacts, i, x, y, z, velocity):
    """Change the velocities of a patch's nodes by an impulse (3) [N s] on patch i."""
    inverse_mass = contacts.work.inverse_mass
    for c in range(contacts.patches.start[i], contacts.patches.start[i + 1]):
        j, w = contacts.patches.nodes[c], contacts.patches.weights[c]
        free_x, free_y, free_z = project(contacts.patches.slide, contacts.patches.slide_of[j], x, y, z)
        velocity[j, 0] += w * inverse_mass[j] * free_x
        velocity[j, 1] += w * inverse_mass[j] * free_y
        velocity[j, 2] += w * inverse_mass[j] * free_z


@kernel_njit(inner=True, parallel=True)
def _mark_near(contacts, t, margin, u, marks):
    """Write the candidates of a tool that are less than a margin [m] farther than active ones, and -1 for others."""
    first, last = contacts.candidates.start[t], contacts.candidates.start[t + 1]
    for block in prange((last - first + BLOCK_CANDIDATES - 1) // BLOCK_CANDIDATES):
        kind, sizes, frame = contacts.tools.kind[t], contacts.tools.sizes[t], contacts.work.frames[t, 1]
        near = contacts.gaps.search + contacts.patches.gain * margin
        around = near + contacts.patches.radius
        radius = contacts.tools.radius[t] + around
        begin = first + np.int64(block) * BLOCK_CANDIDATES
        for k in range(begin, min(begin + BLOCK_CANDIDATES, last)):
            i = contacts.candidates.patch[k]
            j = contacts.patches.ends[i, 0]
            x, y, z = (
                contacts.patches.points[i, 0] + u[j, 0],
                contacts.patches.points[i, 1] + u[j, 1],
                contacts.patches.points[i, 2] + u[j, 2],
            )
            square = (x - frame[0, 3]) ** 2 + (y - frame[1, 3]) ** 2 + (z - frame[2, 3]) ** 2
            marks[k] = -1
            if square < radius * radius and gap(kind, sizes, frame, x, y, z)[0] < around:  # then that of the patch
                x, y, z, _, _, _ = patch(contacts.patches, i, 0.0, u, u)
                depth = chord_depth(contacts.patches.lengths[i], contacts.tools.curvature[t])
                if gap(kind, sizes, frame, x, y, z)[0] + depth < near:
                    marks[k] = k


@kernel_njit(inner=True)
def list_near(contacts, margin, u):
    """List the candidates that are less than a margin [m] farther from their tool than those that a step needs.

    The list holds as long as no node and no point of a tool that may touch it has moved by more than the margin, both
    ways together.
    """
    impulses, near = contacts.work.patch_impulses, contacts.work.near
    for t in range(contacts.tools.kind.shape[0]):
        first = contacts.candidates.start[t]
        contacts.work.near_count[t] = 0
        if contacts.tools.sizes[t, 0] == -np.inf:  # an absent tool
            continue
        _mark_near(contacts, t, margin, u, near)
        count = first
        for k in range(first, contacts.candidates.start[t + 1]):
            if near[k] == k:
                near[count] = k
                count += 1
            elif impulses[k, 3] != 0.0:
                impulses[k] = 0.0
        contacts.work.near_count[t] = count - first


@kernel_njit(inner=True)
def _find_active_patches(contacts, ahead, step, ratio, time, u, velocity, mass, drag):
    """Find the patches near a tool, and apply `ratio` times their impulses of the previous step.

    A patch that was deep in the tool before the step keeps a part of that depth. Pushed out in a single step, it would
    gain energy that no work of the tool explains.
    """
    points, start, near, weights = (
        contacts.patches.points,
        contacts.patches.start,
        contacts.patches.nodes,
        contacts.patches.weights,
    )
    nodes, active, impulses, places = (
        contacts.candidates.patch,
        contacts.work.active,
        contacts.work.patch_impulses,
        contacts.work.places,
    )
    prescribed_until, inverse_mass = contacts.patches.prescribed_until, contacts.work.inverse_mass
    for k in active[: contacts.work.active_count[0]]:
        for c in range(start[nodes[k]], start[nodes[k] + 1]):
            contacts.work.step_impulses[near[c]] = 0.0
    count, search, around = 0, contacts.gaps.search, contacts.gaps.search + contacts.patches.radius
    for t in range(contacts.tools.kind.shape[0]):
        kind, sizes, frame = contacts.tools.kind[t], contacts.tools.sizes[t], contacts.work.frames[t, 1]
        radius = contacts.tools.radius[t] + around
        for k in contacts.work.near[
            contacts.candidates.start[t] : contacts.candidates.start[t] + contacts.work.near_count[t]
        ]:
            i = nodes[k]
            j = contacts.patches.ends[i, 0]
            x = points[i, 0] + u[j, 0] + ahead * velocity[j, 0]
            y = points[i, 1] + u[j, 1] + ahead * velocity[j, 1]
            z = points[i, 2] + u[j, 2] + ahead * velocity[j, 2]
            square = (x - frame[0, 3]) ** 2 + (y - frame[1, 3]) ** 2 + (z - frame[2, 3]) ** 2
            in_reach = (
                square < radius * radius and time > prescribed_until[i] and gap(kind, sizes, frame, x, y, z)[0] < around
            )
            depth = chord_depth(contacts.patches.lengths[i], contacts.tools.curvature[t])
            if in_reach:  # after the cheaper test of its node
                x, y, z, vx, vy, vz = patch(contacts.patches, i, 0.0, u, velocity)
                places[k, 0], places[k, 1], places[k, 2] = x, y, z
                distance, nx, ny, nz = gap(kind, sizes, frame, x + ahead * vx, y + ahead * vy, z + ahead * vz)
                in_reach = distance + depth < search
                if in_reach and contacts.patches.slide_of[j] >= 0:
                    nx, ny, nz = project(contacts.patches.slide, contacts.patches.slide_of[j], nx, ny, nz)
                    in_reach = nx * nx + ny * ny + nz * nz > MIN_FREEDOM
            if not in_reach:
                if impulses[k, 3] != 0.0:
                    impulses[k] = 0.0
                continue
            clearance = gap(kind, sizes, contacts.work.frames[t, 0], x, y, z)[0] + depth + contacts.gaps.overlap
            places[k, 3] = min(0.0, clearance) * max(0.0, 1.0 - step / RECOVERY_TIME)
            response = 0.0
            for c in range(start[i], start[i + 1]):
                j = near[c]
                inverse_mass[j] = 1.0 / (drag * mass[j]) if time > prescribed_until[j] else 0.0
                response += weights[c] ** 2 * inverse_mass[j]
            for c in range(3):
                impulses[k, c] *= ratio
            impulses[k, 3] = response
            _apply_to_patch(contacts, i, impulses[k, 0], impulses[k, 1], impulses[k, 2], velocity)
            active[count] = k
            count += 1
    contacts.work.active_count[0] = count


@kernel_njit(inner=True)
def _velocity_change(contacts, i, response, x, y, z):
    """Return the change of a patch's velocity by an impulse on it; `response` is that of a patch without supports."""
    if contacts.patches.slide.shape[0] == 0:
        return response * x, response * y, response * z
    change_x, change_y, change_z = 0.0, 0.0, 0.0
    for c in range(contacts.patches.start[i], contacts.patches.start[i + 1]):
        j = contacts.patches.nodes[c]
        share = contacts.patches.weights[c] ** 2 * contacts.work.inverse_mass[j]
        free_x, free_y, free_z = project(contacts.patches.slide, contacts.patches.slide_of[j], x, y, z)
        change_x, change_y, change_z = change_x + share * free_x, change_y + share * free_y, change_z + share * free_z
    return change_x, change_y, change_z


@kernel_njit(inner=True)
def _sweep(contacts, ends, step, velocity):
    """Update the impulse of every active patch; return the largest change and the largest impulse [m/s].

    With `ends` only patches in contact are pushed that move into the tool.
    """
    start, near, weights, places = (
        contacts.patches.start,
        contacts.patches.nodes,
        contacts.patches.weights,
        contacts.work.places,
    )
    kind, sizes, friction, frames = (
        contacts.tools.kind,
        contacts.tools.sizes,
        contacts.tools.friction,
        contacts.work.frames,
    )
    nodes, tool, impulses = contacts.candidates.patch, contacts.candidates.tool, contacts.work.patch_impulses
    changed, largest, ahead, tolerance = 0.0, 0.0, 0.0 if ends else step, contacts.gaps.contact
    for k in contacts.work.active[: contacts.work.active_count[0]]:
        i, t, response = nodes[k], tool[k], impulses[k, 3]
        ox, oy, oz = impulses[k, 0], impulses[k, 1], impulses[k, 2]
        vx, vy, vz = 0.0, 0.0, 0.0
        for c in range(start[i], start[i + 1]):
            j, w = near[c], weights[c]
            vx, vy, vz = vx + w * velocity[j, 0], vy + w * velocity[j, 1], vz + w * velocity[j, 2]
        x, y, z = places[k, 0] + ahead * vx, places[k, 1] + ahead * vy, places[k, 2] + ahead * vz
        g, nx, ny, nz = gap(kind[t], sizes[t], frames[t, 1], x, y, z)
        g += chord_depth(contacts.patches.lengths[i], contacts.tools.curvature[t])
        if not ends:  # the nearest place that the patch may take
            x, y, z = x - g * nx, y - g * ny, z - g * nz
        tx, ty, tz = material_velocity(frames[t, 0], frames[t, 1], step, x, y, z)
        own_x, own_y, own_z = _velocity_change(contacts, i, response, ox, oy, oz)
        if contacts.patches.slide.shape[0] > 0:
            rx, ry, rz = _velocity_change(contacts, i, response, nx, ny, nz)
            response = rx * nx + ry * ny + rz * nz
        # relative to the tool, without the present impulse
        wx, wy, wz = vx - tx - own_x, vy - ty - own_y, vz - tz - own_z
        if ends:
            normal = -(wx * nx + wy * ny + wz * nz) if g < tolerance else 0.0
        else:
            normal = own_x * nx + own_y * ny + own_z * nz
            normal -= (g - places[k, 3] if g < 0.0 else g) / step
        px, py, pz = 0.0, 0.0, 0.0
        if normal > 0.0:
            px, py, pz = coulomb(normal, friction[t], wx, wy, wz, nx, ny, nz)
            px, py, pz = (px + normal * nx) / response, (py + normal * ny) / response, (pz + normal * nz) / response
        impulses[k, 0], impulses[k, 1], impulses[k, 2] = px, py, pz
        largest = max(largest, response * max(abs(px), abs(py), abs(pz)))
        px, py, pz = px - ox, py - oy, pz - oz
        if px != 0.0 or py != 0.0 or pz != 0.0:
            changed = max(changed, response * max(abs(px), abs(py), abs(pz)))
            _apply_to_patch(contacts, i, px, py, pz, velocity)
    return changed, largest


@kernel_njit(inner=True)
def _add_step_impulses(contacts):
    """Add the impulses of the active patches to those of their nodes in the present step."""
    impulse = contacts.work.step_impulses
    for k in contacts.work.active[: contacts.work.active_count[0]]:
        i, push = contacts.candidates.patch[k], contacts.work.patch_impulses[k]
        for c in range(contacts.patches.start[i], contacts.patches.start[i + 1]):
            for d in range(3):
                impulse[contacts.patches.nodes[c], d] += contacts.patches.weights[c] * push[d]


@kernel_njit(inner=True)
def _add_patch_impulse(contacts, k, ahead, step, kick, u, velocity, data):
    """Add a patch's impulse to the sums of the call; return energies as `contact_impulses`.

    The work on a node is the impulse times the mean of its velocities before the kick and after all
    impulses, without the part that mass damping dissipates.
    """
    i, t, push, inverse_mass = (
        contacts.candidates.patch[k],
        contacts.candidates.tool[k],
        contacts.work.patch_impulses[k],
        contacts.work.inverse_mass,
    )
    nodes, scratch, gravity, drag = data
    origin, density = contacts.work.frames[t, 1, :, 3], nodes.density
    position = patch(contacts.patches, i, ahead, u, velocity)[:3]
    speed = material_velocity(
        contacts.work.frames[t, 0], contacts.work.frames[t, 1], step, position[0], position[1], position[2]
    )
    tools, on_nodes, loads = 0.0, 0.0, 0.0
    for d in range(3):
        a, b = (d + 1) % 3, (d + 2) % 3
        contacts.work.tool_impulses[t, d] += push[d]
        turn = (position[a] - origin[a]) * push[b] - (position[b] - origin[b]) * push[a]
        contacts.work.tool_impulses[t, 3 + d] += turn
        tools += push[d] * speed[d]
    for c in range(contacts.patches.start[i], contacts.patches.start[i + 1]):
        j, sliding = contacts.patches.nodes[c], contacts.patches.slide_of[contacts.patches.nodes[c]]
        # the part of the impulse that a support leaves to the node
        free = project(contacts.patches.slide, sliding, push[0], push[1], push[2])
        for d in range(3):
            share, moved, mean = (
                contacts.patches.weights[c] * push[d],
                contacts.patches.weights[c] * free[d],
                velocity[j, d],
            )
            contacts.work.nodal_impulses[j, d] += share
            if inverse_mass[j] > 0.0:
                surface = scratch.surface[j, d]
                kicked = kick * ((scratch.force[j, d] + nodes.half_cell * surface) / density + gravity[d])
                mean -= 0.5 * (kicked + contacts.work.step_impulses[j, d] * inverse_mass[j])
                loads += 0.5 * kick * nodes.volumes[j] * (surface + density * gravity[d]) * moved * inverse_mass[j]
                on_nodes += moved * mean / drag
            else:  # the constraint takes the impulse
                loads -= share * mean
                on_nodes += share * mean
    return tools, tools - on_nodes, loads


@cache
def push_patches(touch: int) -> Any:
    """Compile the impulses of the tools in a step, without those of a blade unless it is one of them.

    ``push(contacts, times, ratio, u, velocity, data)`` pushes the patches out of the tools, whose frames before and
    after the step are given. `times` are the time [s] from the present positions to those of the patches, 0 for the
    half kick at the end of a call; the lengths of the step and of the kick; the time at the end of the step. `ratio` is
    that of the first impulses to those of the step before. `data` are the nodal data, the scratch arrays of the step,
    alpha [1/s] of the damping alpha M, and gravity. It returns as `contact_impulses`.
    """
    cuts = touch == WITH_BLADE

    @law_njit(law_digest(__name__, "push", cuts), inner=True)
    def push(contacts, times, ratio, u, velocity, data):
        ahead, step, kick, time = times
        ends = ahead == 0.0
        nodes, scratch, alpha, gravity = data
        drag = 1.0 + 0.5 * alpha * kick  # by which damping resists an impulse, as it resists the other forces of a kick
        if cuts:
            clear_sites(contacts, time, nodes.mass, drag)
        _find_active_patches(contacts, ahead, step, ratio, time, u, velocity, nodes.mass, drag)
        for _ in range(MAX_SWEEPS):
            changed, largest = _sweep(contacts, ends, step, velocity)
            if changed <= SWEEP_TOLERANCE * largest:
                break
        _add_step_impulses(contacts)
        tools, lost, loads = 0.0, 0.0, 0.0
        if cuts:
            push_sites(contacts, ends, step, kick, u, velocity)
            tools, lost, loads = site_works(contacts, ends, step, kick, u, velocity, (nodes, scratch, gravity, drag))
        work, shapes = contacts.work, contacts.tools
        for k in work.active[: work.active_count[0]]:
            impulse = work.patch_impulses[k]
            if impulse[0] != 0.0 or impulse[1] != 0.0 or impulse[2] != 0.0:
                works = _add_patch_impulse(contacts, k, ahead, step, kick, u, velocity, (nodes, scratch, gravity, drag))
                tools, lost, loads = tools + works[0], lost + works[1], loads + works[2]
        held = press_held_nodes(
            reference(contacts.held), shapes.kind, shapes.sizes, shapes.friction, work.frames, step, kick,
            work.tool_impulses,
        )  # fmt: skip
        return tools + held[0], lost + held[1], loads

    return push


@cache
def contact_impulses(touch: int) -> Any:
    """Compile the impulses of the tools of a run; of an untouched body (`contact_kind`) the function does nothing.

    ``apply(contacts, schedule, s, step, kick, u, velocity, data)`` applies the impulses after the kick of step s. The
    last time of the load history has no step after it. `data` are the nodal data, the scratch arrays of the step
    (`palpate.dynamics.nodal.central_difference`), alpha [1/s] of the damping, and gravity. It returns three energies
    [J]: work of the tools; energy dissipated by friction and impact; change of the work of loads and constraints.
    """
    if touch == NO_TOOLS:
        return _no_impulses
    push = push_patches(touch)

    @law_njit(law_digest(__name__, "impulses", touch))
    def apply(contacts, schedule, s, step, kick, u, velocity, data):
        poses = schedule.poses
        ends = s == poses.shape[0] - 1
        first, ahead = (s - 1, 0.0) if ends else (s, step)
        for t in range(contacts.tools.kind.shape[0]):
            rotation(poses[first, t], contacts.work.frames[t, 0])
            rotation(poses[first + 1, t], contacts.work.frames[t, 1])
        # the first kick of a call is half of the others, and starts from zero impulses
        ratio = 0.0 if s == 0 else kick / (0.5 * step if s == 1 else step)
        time = schedule.times[min(s + 1, poses.shape[0] - 1)]
        return push(contacts, (ahead, step, kick, time), ratio, u, velocity, data)

    return apply


@kernel_njit(inline="always")
def _no_impulses(contacts, schedule, s, step, kick, u, velocity, data):
    """Do nothing; return as `contact_impulses`."""
    return 0.0, 0.0, 0.0
