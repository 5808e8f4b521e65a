"""Leapfrog steps of a full body in the engine, compiled: central differences that cost one force a step.

Displacements belong to the ends of steps and velocities to their middles,

    v_{n+1/2} = v_{n-1/2} + dt a(u_n + beta v_{n-1/2}),      u_{n+1} = u_n + dt v_{n+1/2}.

A step of `leapfrog` is: forces, kick, impulses of the tools (`palpate.dynamics.contact.impulses`), drift. Sums over
the nodes are those of blocks, so that they are equal for any number of threads.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numba import prange

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.passes import Formulation, internal_force
from palpate.dynamics.contact.grip import COUNT, bear_impulses, begin_grip, hold_nodes, store_velocities
from palpate.dynamics.contact.impulses import list_near, push_patches
from palpate.dynamics.loads.supports import FIXED
from palpate.dynamics.material.relaxation import copy_field, copy_values
from palpate.dynamics.nodal.central_difference import foundation_force, kick_node
from palpate.dynamics.nodal.mass_scaling import subtract_inertia
from palpate.dynamics.nodal.period_data import (
    BEHIND,
    BLOCK_NODES,
    DRIFT_SQUARE,
    KICK_SQUARE,
    KINETIC_ENERGY,
    KINETIC_SUM,
    LOST,
    LOST_SUM,
    NEXT_BEHIND,
    STEP,
    WORK,
    WORK_SUM,
)
from palpate.dynamics.nodal.tool_limits import is_absent
from palpate.dynamics.nodal.tool_path import LISTED_AT, frame_way, place_tools

MAX_STEPS = 400  # in a period; beyond it the body's time runs slower


@kernel_njit(inner=True, parallel=True)
def _kick_blocks(sites, nodes, scratch, previous, step, alpha, u, velocity, sums):
    """Accelerate the nodes by a step; write work of surface loads and dissipation of every block [J] into `sums`.

    The last sum is the largest squared velocity.

    The energy that the damping beta K dissipates is the sum of V (beta v) . (previous - force); see
    `palpate.dynamics.nodal.central_difference.damping_work`. Arrays that are written are arguments of their own:
    Numba drops writes to those of a tuple from a parallel loop.
    """
    half = 0.5 * alpha * step
    shares = (1.0 - half) / (1.0 + half), step / (1.0 + half)
    for b in prange(sums.shape[0]):
        work, square, lost, largest = 0.0, 0.0, 0.0, 0.0
        first = np.int64(b) * BLOCK_NODES
        for i in range(first, min(first + BLOCK_NODES, velocity.shape[0])):
            for c in range(3):
                moved = nodes.volumes[i] * (scratch.damped[i, c] - u[i, c])
                lost += moved * (previous[i, c] - scratch.force[i, c])
                previous[i, c] = scratch.force[i, c]
            if sites.kind[i] != FIXED:
                node_sums = kick_node(
                    i, sites.slide_of[i], sites.slide, nodes, scratch, (0.0, 0.0, 0.0), shares, velocity
                )  # fmt: skip
                work, square = work + node_sums[0], square + node_sums[1]
                largest = max(largest, velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2)
        sums[b, KICK_SQUARE] = largest
        sums[b, WORK_SUM], sums[b, LOST_SUM] = work * step, lost + alpha * nodes.density * square * step


@kernel_njit(inner=True, parallel=True)
def _drift_blocks(kind, nodes, damped, surface, step, beta, u, velocity, sums):
    """Move the nodes by a step, and prepare the next force.

    Writes the kinetic energy [J] and the largest squared velocity of every block into `sums`; the latter is infinite
    where a velocity is not a number.
    """
    for b in prange(sums.shape[0]):
        energy, largest = 0.0, 0.0
        first = np.int64(b) * BLOCK_NODES
        for i in range(first, min(first + BLOCK_NODES, velocity.shape[0])):
            square = velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2
            energy += 0.5 * nodes.density * nodes.volumes[i] * square
            if not square <= largest:
                largest = square if square < np.inf else np.inf
            for c in range(3):
                if kind[i] != FIXED:
                    u[i, c] += step * velocity[i, c]
                damped[i, c] = u[i, c] + beta * velocity[i, c]
                surface[i, c] = 0.0
        sums[b, KINETIC_SUM], sums[b, DRIFT_SQUARE] = energy, largest


@kernel_njit(inline="always")
def _total(sums, k):
    """Return the sum over the blocks, equal for any number of threads."""
    total = 0.0
    for b in range(sums.shape[0]):
        total += sums[b, k]
    return total


@kernel_njit(inline="always")
def _largest(sums, k):
    """Return the largest number of all blocks."""
    largest = 0.0
    for b in range(sums.shape[0]):
        if sums[b, k] > largest:
            largest = sums[b, k]
    return largest


@kernel_njit(inner=True)
def kinetic_energy(nodes, velocity):
    """Return the kinetic energy [J] of nodes with velocities (n, 3)."""
    total = 0.0
    for i in range(velocity.shape[0]):
        square = velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2
        total += 0.5 * nodes.density * nodes.volumes[i] * square
    return total


@kernel_njit(inner=True)
def _reach(data, t):
    """Return the distance [m] from the origin of a tool up to which its way counts for the list of candidates."""
    contacts = data.tools.contacts
    margin = max(data.tools.near_margin[0], 0.0)
    return contacts.tools.radius[t] + contacts.gaps.search + contacts.patches.radius + margin


@kernel_njit(inner=True)
def _way_since_list(data, u):
    """Return a bound of the way [m] of a node and a point of a tool since the candidates were listed."""
    tools, before, largest = data.tools, data.tools.listed, 0.0
    for i in range(u.shape[0]):
        square = (u[i, 0] - before[i, 0]) ** 2 + (u[i, 1] - before[i, 1]) ** 2 + (u[i, 2] - before[i, 2]) ** 2
        largest = max(largest, square)
    farthest = 0.0
    for t in range(tools.path.shape[0]):
        if not is_absent(tools.contacts, t):
            way = frame_way(tools.path[t, LISTED_AT], tools.contacts.work.frames[t, 1], _reach(data, t))
            farthest = max(farthest, way)
    return np.sqrt(largest) + farthest


@kernel_njit(inner=True)
def _tool_way(data):
    """Return the largest way [m] of a point of a tool in the present step, and note it for each tool."""
    tools, frames, farthest = data.tools, data.tools.contacts.work.frames, 0.0
    for t in range(tools.path.shape[0]):
        if not is_absent(tools.contacts, t):
            way = frame_way(frames[t, 0], frames[t, 1], _reach(data, t))
            tools.clear_way[t] -= way
            farthest = max(farthest, way)
    return farthest


@kernel_njit(inline="always")
def _held_count(grip):
    """Return the number of nodes that forceps hold."""
    count = 0
    for t in range(grip.numbers.shape[0]):
        count += grip.numbers[t, COUNT]
    return count


@kernel_njit(inline="always")
def _steps_in(stepping, period):
    """Return the number of steps that end within a period [s], and the time [s] by which the body is behind before."""
    step, behind = stepping[STEP], stepping[BEHIND]
    count = int((behind + period) / step * (1.0 + 1e-12))
    if count > MAX_STEPS:
        return MAX_STEPS, MAX_STEPS * step - period
    return count, behind


@kernel_njit(inline="always")
def _kick(data, step, u, velocity):
    """Accelerate the nodes, v += dt a with the damping alpha M; then those that forceps hold, to their places."""
    body, tools, scratch, alpha, energies = data.body, data.tools, data.scratch, data.body.damping.alpha, data.energies
    store_velocities(tools.grip, velocity)
    _kick_blocks(body.sites, body.nodes, scratch, scratch.previous, step, alpha, u, velocity, data.sums)
    works = hold_nodes(tools.grip, tools.contacts, body.nodes, scratch.surface, alpha, step, u, velocity)
    energies[WORK] += _total(data.sums, WORK_SUM) + works[0]
    energies[LOST] += _total(data.sums, LOST_SUM) + works[1]


@kernel_njit(inline="always")
def _list_candidates(data, step, way, u):
    """List the candidates near the tools where the next drift may lead beyond the list; return the way [m] since."""
    tools = data.tools
    ahead = step * np.sqrt(_largest(data.sums, KICK_SQUARE))
    if way + ahead <= tools.near_margin[0]:
        return way
    tools.near_margin[0] = data.limits.node + ahead
    list_near(tools.contacts, tools.near_margin[0], u)
    copy_field(u, tools.listed)
    for t in range(tools.path.shape[0]):
        tools.clear_way[t] = 0.0
        copy_values(tools.contacts.work.frames[t, 1], tools.path[t, LISTED_AT])
    return 0.0


@kernel_njit(inline="always")
def _drift(data, step, u, velocity):
    """Move the nodes, u += dt v; return the largest way [m]."""
    body, scratch = data.body, data.scratch
    _drift_blocks(
        body.sites.kind, body.nodes, scratch.damped, scratch.surface, step, body.damping.beta, u, velocity, data.sums
    )
    return step * np.sqrt(_largest(data.sums, DRIFT_SQUARE))


@cache
def leapfrog(formulation: Formulation, touch: int) -> Any:
    """Compile the steps of a period, of a body that tools touch, or a blade among them cuts.

    ``take_steps(data, u, velocity, period)`` returns the number of steps, or -1 if a node moves too far in one.
    """
    digest = law_digest(__name__, formulation.digest, touch)
    after, step_force, push_tools = formulation.after, internal_force(formulation.of_steps), push_patches(touch)

    @law_njit(digest, inline="always")
    def push(data, step, u, velocity):
        """Apply the impulses of the tools, projected on Coulomb's cone; forceps bear those on their nodes."""
        tools, energies = data.tools, data.energies
        loads = data.body.nodes, data.scratch, data.body.damping.alpha, (0.0, 0.0, 0.0)
        works = push_tools(tools.contacts, (step, step, step, 0.0), 1.0, u, velocity, loads)
        energies[WORK] += works[0]
        energies[LOST] += works[1]
        if _held_count(tools.grip) > 0:
            energies[WORK] += bear_impulses(tools.grip, tools.contacts, step, u, velocity)

    @law_njit(digest, inline="always")
    def write_forces(data, constants, work, step, u, velocity):
        """Write the force densities f(u + beta v) and of foundations, less the inertia of the additional mass."""
        body, scratch, nodes = data.body, data.scratch, data.body.nodes
        after(work, step)
        step_force(scratch.damped, constants, work, scratch.force)
        foundation_force(body.sites, u, velocity, nodes.volumes, scratch.surface)
        subtract_inertia(
            body.mass_scaling, nodes.volumes, nodes.density, 1.0, scratch.surface, scratch.force, 1.0 / step,
            data.tools.contacts.work.step_impulses, scratch.surface,
        )  # fmt: skip

    @law_njit(digest, inline="always")
    def take_steps(data, u, velocity, period):
        stepping, energies, tools, step = data.stepping, data.energies, data.tools, data.stepping[STEP]
        begin_grip(tools.grip, tools.contacts.patches.points, u, tools.contacts.work.frames)
        count, behind = _steps_in(stepping, period)
        if count == 0:
            energies[KINETIC_ENERGY], stepping[NEXT_BEHIND] = kinetic_energy(data.body.nodes, velocity), behind + period
            return 0
        _drift(data, 0.0, u, velocity)
        way = _way_since_list(data, u)
        constants, work = data.body.passes
        for s in range(count):
            place_tools(tools.path, min(1.0, ((s + 1) * step - behind) / period), tools.contacts.work.frames)
            way += _tool_way(data)
            write_forces(data, constants, work, step, u, velocity)
            _kick(data, step, u, velocity)
            way = _list_candidates(data, step, way, u)
            push(data, step, u, velocity)
            moved = _drift(data, step, u, velocity)
            if not moved < data.limits.node:
                return -1
            for t in range(tools.path.shape[0]):
                tools.clear_way[t] -= moved
            way += moved
        energies[KINETIC_ENERGY] = _total(data.sums, KINETIC_SUM)
        stepping[NEXT_BEHIND] = behind + period - count * step
        return count

    return take_steps
