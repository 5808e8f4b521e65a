"""The compiled explicit central-difference step.

With displacements at the times t_n and velocities between them,

    v_{n+1/2} = v_{n-1/2} + dt a(u_n + beta v_{n-1/2}, t_n),      u_{n+1} = u_n + dt v_{n+1/2}.

The internal force at u + beta v yields the stiffness-proportional part of C = alpha M + beta K, as in (29),
at no cost. The mass-proportional part acts on the mean velocity of a kick,

    (1 + alpha dt / 2) v_{n+1/2} = (1 - alpha dt / 2) v_{n-1/2} + dt a,

which is stable for every alpha. A call advances some steps of one length. It starts and ends with half a
kick, so that its states hold displacements and velocities of the same time.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.lanes import LANES
from palpate.compiled.passes import Formulation, internal_force
from palpate.compiled.reference import reference
from palpate.core.arrays import Floats, Ints
from palpate.dynamics.contact.geometry import project
from palpate.dynamics.contact.impulses import contact_impulses
from palpate.dynamics.loads.supports import FIXED, FREE, SLIDING


class NodalData(NamedTuple):
    """Constants of the nodes of a body."""

    volumes: Floats  # (n,) array [m^3]
    mass: Floats  # (n,) array [kg]: masses in the inner product of the nodal forces
    density: float  # [kg/m^3]
    slot: Ints  # (n,) array: position of every node in the blocks of lanes
    half_cell: float  # half the c of the half-cell balance at the boundary


class Damping(NamedTuple):
    """Damping proportional to mass and stiffness, C = alpha M + beta K."""

    alpha: float  # [1/s]
    beta: float  # [s]
    wave_speed: float  # [m/s]: largest velocity of prescribed nodes in the damping forces


class StepScratch(NamedTuple):
    """Nodal arrays (n, 3) that a step overwrites."""

    # force, previous: arrays [N/m^3]: internal force density of the present and the previous evaluation
    force: Floats
    previous: Floats
    surface: Floats  # array [N/m^3]: surface loads per nodal volume
    damped: Floats  # array [m]: displacements u + beta v of the evaluation


def step_scratch(nodes: int) -> StepScratch:
    """Allocate the nodal arrays of a step."""
    return StepScratch(*(np.zeros((nodes, 3)) for _ in range(4)))


@kernel_njit()
def surface_force(sites, schedule, s, volumes, slot, cofactor, surface):
    """Write the surface loads of step s per nodal volume [N/m^3] into `surface`, at the loaded nodes."""
    for k in range(sites.dead_node.shape[0]):
        surface[sites.dead_node[k]] = 0.0
    for k in range(sites.pressure_node.shape[0]):
        surface[sites.pressure_node[k]] = 0.0
    for k in range(sites.foundation_node.shape[0]):
        surface[sites.foundation_node[k]] = 0.0
    for g in range(sites.dead_start.shape[0] - 1):
        for k in range(sites.dead_start[g], sites.dead_start[g + 1]):
            i = sites.dead_node[k]
            for c in range(3):
                force = 0.0
                for a in range(sites.dead_pattern.shape[1]):
                    force += sites.dead_pattern[k, a, c] * schedule.amplitudes[s, g, a]
                surface[i, c] += force / volumes[i]
    for g in range(sites.pressure_start.shape[0] - 1):
        for k in range(sites.pressure_start[g], sites.pressure_start[g + 1]):
            i = sites.pressure_node[k]
            block, lane = slot[i] // LANES, slot[i] % LANES
            for c in range(3):
                area = 0.0
                for d in range(3):
                    area += cofactor[block, 3 * c + d, lane] * sites.pressure_area[k, d]
                surface[i, c] -= schedule.pressure[s, g] * area / volumes[i]


@kernel_njit()
def foundation_force(sites, u, velocity, volumes, surface):
    """Add the forces of elastic foundations per nodal volume [N/m^3] to `surface`."""
    for k in range(sites.foundation_node.shape[0]):
        i = sites.foundation_node[k]
        for c in range(3):
            force = sites.foundation_spring[k] * u[i, c] + sites.foundation_dashpot[k] * velocity[i, c]
            surface[i, c] -= force / volumes[i]


@kernel_njit(inner=True, forceinline=True)
def kick_node(i, k, slide, nodes, scratch, gravity, kick, velocity):
    """Accelerate a node by a kick: the share of its velocity that remains, and the time of the force.

    Node k of the sliding ones moves along its support; k is -1 for others. Returns the power of loads [W], and the sum
    of volume times squared mean velocity.
    """
    work, square, density, half_cell = 0.0, 0.0, nodes.density, nodes.half_cell
    rate = project(
        slide,
        k,
        (scratch.force[i, 0] + half_cell * scratch.surface[i, 0]) / density + gravity[0],
        (scratch.force[i, 1] + half_cell * scratch.surface[i, 1]) / density + gravity[1],
        (scratch.force[i, 2] + half_cell * scratch.surface[i, 2]) / density + gravity[2],
    )
    for c in range(3):
        before = velocity[i, c]
        after = kick[0] * before + kick[1] * rate[c]
        mean = 0.5 * (before + after)
        work += nodes.volumes[i] * (scratch.surface[i, c] + density * gravity[c]) * mean
        square += nodes.volumes[i] * mean * mean
        velocity[i, c] = after
    return work, square


@kernel_njit(inner=True)
def kick_nodes(sites, constrained, nodes, scratch, gravity, kick, velocity, alpha):
    """Accelerate the nodes that can move over the time `kick`.

    Returns two energies [J]: the work of surface loads and gravity, and what the damping alpha M dissipates.
    """
    work, square, half = 0.0, 0.0, 0.5 * alpha * kick
    shares = (1.0 - half) / (1.0 + half), kick / (1.0 + half)
    for i in range(sites.kind.shape[0]):
        if sites.kind[i] == FREE:
            sums = kick_node(i, np.int64(-1), sites.slide, nodes, scratch, gravity, shares, velocity)
            work, square = work + sums[0], square + sums[1]
    for i in sites.sliding:
        if sites.kind[i] == SLIDING:
            sums = kick_node(i, sites.slide_of[i], sites.slide, nodes, scratch, gravity, shares, velocity)
            work, square = work + sums[0], square + sums[1]
    for k in range(sites.prescribed.shape[0]):
        if not constrained[k]:
            i = sites.prescribed[k]
            sums = kick_node(i, sites.slide_of[i], sites.slide, nodes, scratch, gravity, shares, velocity)
            work, square = work + sums[0], square + sums[1]
    return work * kick, alpha * nodes.density * square * kick


@kernel_njit(inner=True)
def damping_work(volumes, u, scratch):
    """Return sum of V (beta v) . (previous - force) [J], and copy the force to the previous one.

    Between two evaluations the internal force changes by -K v dt. So this sum is the energy that
    damping dissipates in a step, beta v . K v dt.
    """
    work, force, previous = 0.0, scratch.force, scratch.previous
    for i in range(force.shape[0]):
        for c in range(3):
            work += volumes[i] * (scratch.damped[i, c] - u[i, c]) * (previous[i, c] - force[i, c])
            previous[i, c] = force[i, c]
    return work


@kernel_njit(inner=True)
def _limit_prescribed_velocity(prescribed, constrained, u, velocity, damping, damped):
    """Limit prescribed velocities to `wave_speed` in the damping forces.

    Those of a jump would grow as 1 / step.
    """
    for k in range(prescribed.shape[0]):
        if not constrained[k]:
            continue
        i = prescribed[k]
        speed = np.sqrt(velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2)
        if speed > damping.wave_speed:
            for c in range(3):
                damped[i, c] = u[i, c] + damping.beta * velocity[i, c] * damping.wave_speed / speed


@kernel_njit(inner=True)
def _set_prescribed_velocity(sites, constrained, target, step, u, velocity, nodes, loads):
    """Set the velocities that bring prescribed nodes to `target` after a step.

    The force of a tool is the node's inertia and damping minus the other forces. `loads` are the scratch arrays,
    gravity and alpha. Returns two energies [J]: the work of the tools, and what the damping alpha M dissipates.
    """
    work, lost, density = 0.0, 0.0, nodes.density
    scratch, gravity, alpha = loads
    for k in range(sites.prescribed.shape[0]):
        if not constrained[k]:
            continue
        i = sites.prescribed[k]
        for c in range(3):
            before, after = velocity[i, c], (target[k, c] - u[i, c]) / step
            damping = alpha * 0.5 * (before + after)
            inertia = density * ((after - before) / step + damping - gravity[c])
            other = inertia - scratch.force[i, c] - nodes.half_cell * scratch.surface[i, c]
            work += nodes.volumes[i] * other * 0.5 * (before + after)
            lost += nodes.volumes[i] * density * damping * 0.5 * (before + after)
            sites.impulses[k, c] += nodes.volumes[i] * density * (after - before + step * damping)
            velocity[i, c] = after
    return work * step, lost * step


@kernel_njit(inner=True)
def _add_constraint_impulses(sites, constrained, nodes, scratch, gravity, kick):
    """Subtract the impulses of the other forces on constrained nodes over the time `kick`."""
    for k in range(sites.prescribed.shape[0]):
        if constrained[k]:
            i = sites.prescribed[k]
            for c in range(3):
                other = scratch.force[i, c] + nodes.half_cell * scratch.surface[i, c] + nodes.density * gravity[c]
                sites.impulses[k, c] -= kick * nodes.volumes[i] * other


@kernel_njit(inner=True)
def drift_nodes(sites, constrained, target, step, u, velocity):
    """Advance the displacements by a step; prescribed nodes are at their target exactly."""
    for i in range(u.shape[0]):
        if sites.kind[i] != FIXED:
            for c in range(3):
                u[i, c] += step * velocity[i, c]
    for k in range(sites.prescribed.shape[0]):
        if constrained[k]:
            for c in range(3):
                u[sites.prescribed[k], c] = target[k, c]


@cache
def full_step(formulation: Formulation, touch: int) -> Any:
    """Compile the steps of a body whose unknowns are nodal displacements.

    The steps of an untouched body have no contact (`palpate.dynamics.contact.impulses`).

    ``advance(u, velocity, step, damping, passes, loads, nodes, scratch)`` advances `u` and `velocity` (n, 3) in place
    by one step less than the number of times of the load history. ``passes`` are the body and work arrays of the
    formulation, ``loads`` the sites, contacts and load history. It returns three energies [J]: the work of surface
    loads, gravity and tools in contact; the energy dissipated by damping, friction and impact; the work of the forces
    on prescribed nodes.
    """
    force_of, after = internal_force(formulation), formulation.after
    apply_contact_impulses = contact_impulses(touch)

    @law_njit(law_digest(__name__, formulation.digest, touch))
    def advance(u, velocity, step, damping, passes, loads, given_nodes, given_scratch):
        body, work = passes
        # by their addresses, as the engine passes them, so that both use the same compiled functions
        sites, contacts, schedule = reference(loads[0]), reference(loads[1]), reference(loads[2])
        nodes, scratch = reference(given_nodes), reference(given_scratch)
        total, lost, tools = 0.0, 0.0, 0.0
        steps = schedule.motion.shape[0] - 1
        for s in range(steps + 1):
            for i in range(u.shape[0]):
                for c in range(3):
                    scratch.damped[i, c] = u[i, c] + damping.beta * velocity[i, c]
            _limit_prescribed_velocity(sites.prescribed, schedule.constrained[s], u, velocity, damping, scratch.damped)
            after(work, step if s > 0 else 0.0)
            force_of(scratch.damped, body, work, scratch.force)
            change = damping_work(nodes.volumes, u, scratch)
            if s > 0:
                lost += change
            surface_force(sites, schedule, s, nodes.volumes, nodes.slot, work.cofactor, scratch.surface)
            foundation_force(sites, u, velocity, nodes.volumes, scratch.surface)
            kick = 0.5 * step if s in (0, steps) else step
            field, target = schedule.gravity[s], schedule.motion[min(s + 1, steps)]
            gravity = field[0], field[1], field[2]
            constrained = schedule.constrained[min(s + 1, steps)]
            works = kick_nodes(sites, constrained, nodes, scratch, gravity, kick, velocity, damping.alpha)
            total, lost = total + works[0], lost + works[1]
            if s < steps:
                works = _set_prescribed_velocity(
                    sites, constrained, target, step, u, velocity, nodes, (scratch, gravity, damping.alpha)
                )
                tools, lost = tools + works[0], lost + works[1]
            _add_constraint_impulses(sites, constrained, nodes, scratch, gravity, kick)
            data = nodes, scratch, damping.alpha, gravity
            works = apply_contact_impulses(contacts, schedule, s, step, kick, u, velocity, data)
            total, lost = total + works[0] + works[2], lost + works[1]
            if s == steps:
                break
            drift_nodes(sites, constrained, target, step, u, velocity)
        after(work, 0.0)
        return total, lost, tools

    return advance
