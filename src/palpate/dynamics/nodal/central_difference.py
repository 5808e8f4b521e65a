"""The explicit central-difference step, compiled.

Displacements stand at the times t_n, velocities between them:

    v_{n+1/2} = v_{n-1/2} + dt a(u_n + beta v_{n-1/2}, t_n),      u_{n+1} = u_n + dt v_{n+1/2}.

Evaluating the internal force at u + beta v is the stiffness-proportional damping C = beta K of (29), at no cost. A
call advances some steps of one length and starts and ends with half a kick, so that its states hold displacements and
velocities of the same time.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.dynamics.compiled.cache import kernel_njit, law_njit
from palpate.dynamics.compiled.lanes import LANES
from palpate.dynamics.compiled.passes import Formulation, internal_force
from palpate.dynamics.contact.impulses import push
from palpate.dynamics.loads.prepared import FIXED, FREE

__all__ = ["foundation_force", "full_step", "surface_force"]


@kernel_njit()
def surface_force(places, schedule, s, volumes, slot, cofactor, surface):  # type: ignore[no-untyped-def]
    """Write the tractions of step s, as force per nodal volume [N/m^3], at the loaded nodes of `surface`."""
    for k in range(places.dead_node.shape[0]):
        surface[places.dead_node[k]] = 0.0
    for k in range(places.pressure_node.shape[0]):
        surface[places.pressure_node[k]] = 0.0
    for k in range(places.foundation_node.shape[0]):
        surface[places.foundation_node[k]] = 0.0
    for g in range(places.dead_start.shape[0] - 1):
        for k in range(places.dead_start[g], places.dead_start[g + 1]):
            i = places.dead_node[k]
            for c in range(3):
                force = 0.0
                for a in range(places.dead_pattern.shape[1]):
                    force += places.dead_pattern[k, a, c] * schedule.amplitudes[s, g, a]
                surface[i, c] += force / volumes[i]
    for g in range(places.pressure_start.shape[0] - 1):
        for k in range(places.pressure_start[g], places.pressure_start[g + 1]):
            i = places.pressure_node[k]
            block, lane = slot[i] // LANES, slot[i] % LANES
            for c in range(3):
                area = 0.0
                for d in range(3):
                    area += cofactor[block, 3 * c + d, lane] * places.pressure_area[k, d]
                surface[i, c] -= schedule.pressure[s, g] * area / volumes[i]


@kernel_njit()
def foundation_force(places, u, velocity, volumes, surface):  # type: ignore[no-untyped-def]
    """Add the forces of elastic foundations, as force per nodal volume [N/m^3], to `surface`."""
    for k in range(places.foundation_node.shape[0]):
        i = places.foundation_node[k]
        for c in range(3):
            pull = places.foundation_spring[k] * u[i, c] + places.foundation_dashpot[k] * velocity[i, c]
            surface[i, c] -= pull / volumes[i]


@kernel_njit(forceinline=True)
def _kick_node(i, force, surface, gravity, half_cell, volumes, density, kick, velocity):  # type: ignore[no-untyped-def]
    work = 0.0
    for c in range(3):
        before = velocity[i, c]
        after = before + kick * ((force[i, c] + half_cell * surface[i, c]) / density + gravity[c])
        work += volumes[i] * (surface[i, c] + density * gravity[c]) * 0.5 * (before + after)
        velocity[i, c] = after
    return work


@kernel_njit()
def _kick(places, holds, force, surface, gravity, half_cell, volumes, density, kick, velocity):  # type: ignore[no-untyped-def]
    """Accelerate the free nodes over the time `kick`; return the work [J] of tractions and gravity on them."""
    work = 0.0
    for i in range(places.kind.shape[0]):
        if places.kind[i] == FREE:
            work += _kick_node(i, force, surface, gravity, half_cell, volumes, density, kick, velocity)
    for k in range(places.prescribed.shape[0]):
        if not holds[k]:
            i = places.prescribed[k]
            work += _kick_node(i, force, surface, gravity, half_cell, volumes, density, kick, velocity)
    return work * kick


@kernel_njit()
def _viscous_work(force, previous, volumes, u, at):  # type: ignore[no-untyped-def]
    """Return sum of V (beta v) . (previous - force) [J], and keep the force as the next previous one.

    Between two evaluations the internal force changes by -K v dt, so that this sum is what viscosity takes from the
    body in a step, beta v . K v dt.
    """
    work = 0.0
    for i in range(force.shape[0]):
        for c in range(3):
            work += volumes[i] * (at[i, c] - u[i, c]) * (previous[i, c] - force[i, c])
            previous[i, c] = force[i, c]
    return work


@kernel_njit()
def _slow_jumps(prescribed, holds, u, velocity, beta, wave_speed, at):  # type: ignore[no-untyped-def]
    """Let no driven node be faster than `fastest` in the viscous forces: those of a jump would grow as 1 / step."""
    for k in range(prescribed.shape[0]):
        if not holds[k]:
            continue
        i = prescribed[k]
        speed = np.sqrt(velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2)
        if speed > wave_speed:
            for c in range(3):
                at[i, c] = u[i, c] + beta * velocity[i, c] * wave_speed / speed


@kernel_njit()
def _drive(places, holds, target, step, kick, u, force, surface, gravity, half_cell, volumes, density, velocity):  # type: ignore[no-untyped-def]
    """Give the driven nodes the velocity that brings them to their target after `step`; return the tools' work [J].

    A tool's force is what the node's acceleration needs beyond the other forces on it; those act over the time `kick`.
    """
    work = 0.0
    for k in range(places.prescribed.shape[0]):
        if not holds[k]:
            continue
        i = places.prescribed[k]
        for c in range(3):
            before, after = velocity[i, c], (target[k, c] - u[i, c]) / step
            inertia = density * ((after - before) / step - gravity[c])
            work += volumes[i] * (inertia - force[i, c] - half_cell * surface[i, c]) * 0.5 * (before + after)
            places.impulses[k, c] += volumes[i] * density * (after - before)
            velocity[i, c] = after
    _bear(places, holds, kick, force, surface, gravity, half_cell, volumes, density)
    return work * step


@kernel_njit()
def _bear(places, holds, kick, force, surface, gravity, half_cell, volumes, density):  # type: ignore[no-untyped-def]
    """Let what drives nodes bear the other forces on them over the time `kick`."""
    for k in range(places.prescribed.shape[0]):
        if holds[k]:
            i = places.prescribed[k]
            for c in range(3):
                other = force[i, c] + half_cell * surface[i, c] + density * gravity[c]
                places.impulses[k, c] -= kick * volumes[i] * other


@cache
def full_step(formulation: Formulation) -> Any:
    """Compile the steps of a body whose unknowns are nodal displacements.

    Returns
    -------
    function
        ``advance(u, velocity, step, beta, fastest, body, work, places, contacts, schedule, volumes, mass, density,
        slot, half_cell, force, previous, surface, at)`` advances `u` and `velocity` (n, 3) in place by as many steps as
        the schedule has times less one, and returns the work [J] of tractions, gravity and the tools that touch the
        body, the energy [J] lost to viscosity, friction and impact, and the work [J] of the nodal forces that drive
        nodes.
    """
    force_of, after = internal_force(formulation), formulation.after

    @law_njit(formulation.digest)
    def advance(  # type: ignore[no-untyped-def]
        u,
        velocity,
        step,
        beta,
        wave_speed,
        body,
        work,
        places,
        contacts,
        schedule,
        volumes,
        mass,
        density,
        slot,
        half_cell,
        force,
        previous,
        surface,
        at,
    ):
        total, lost, tools = 0.0, 0.0, 0.0
        steps, touched = schedule.motion.shape[0] - 1, contacts.kind.shape[0] > 0
        for s in range(steps + 1):
            for i in range(u.shape[0]):
                for c in range(3):
                    at[i, c] = u[i, c] + beta * velocity[i, c]
            _slow_jumps(places.prescribed, schedule.holds[s], u, velocity, beta, wave_speed, at)
            after(work, step if s > 0 else 0.0)
            force_of(at, body, work, force)
            change = _viscous_work(force, previous, volumes, u, at)
            if s > 0:
                lost += change
            surface_force(places, schedule, s, volumes, slot, work.cofactor, surface)
            foundation_force(places, u, velocity, volumes, surface)
            kick = 0.5 * step if s in (0, steps) else step
            gravity, target = schedule.gravity[s], schedule.motion[min(s + 1, steps)]
            holds = schedule.holds[min(s + 1, steps)]
            total += _kick(places, holds, force, surface, gravity, half_cell, volumes, density, kick, velocity)
            if s < steps:
                tools += _drive(
                    places, holds, target, step, kick, u, force, surface, gravity, half_cell, volumes, density, velocity
                )  # fmt: skip
            else:
                _bear(places, holds, kick, force, surface, gravity, half_cell, volumes, density)
            if touched:
                works = push(
                    contacts, schedule.poses, s, schedule.times[min(s + 1, steps)], step, kick, u, velocity, mass,
                    force, surface, gravity, half_cell, volumes, density,
                )  # fmt: skip
                total, lost = total + works[0] + works[2], lost + works[1]
            if s == steps:
                break
            for i in range(u.shape[0]):
                if places.kind[i] != FIXED:
                    for c in range(3):
                        u[i, c] += step * velocity[i, c]
            for k in range(places.prescribed.shape[0]):
                if holds[k]:
                    for c in range(3):
                        u[places.prescribed[k], c] = target[k, c]
        after(work, 0.0)
        return total, lost, tools

    return advance
