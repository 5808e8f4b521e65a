"""The compiled step of a reduced model: the full model's passes on derivatives lifted from few coordinates."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numba import prange

from palpate.dynamics.compiled.cache import kernel_njit, law_njit
from palpate.dynamics.compiled.passes import Formulation
from palpate.dynamics.nodal.central_difference import surface_force

__all__ = ["reduced_step"]


@kernel_njit(parallel=True, fastmath={"contract", "reassoc"})
def _project(test, force, result):  # type: ignore[no-untyped-def]
    """result[m] = sum over the nodes of test[m] . force; every mode by one thread, in one order."""
    flat = force.reshape(-1)
    for m in prange(test.shape[0]):
        total = 0.0
        row = test[m]
        for k in range(flat.shape[0]):
            total += row[k] * flat[k]
        result[m] = total


@kernel_njit()
def _tractions(sites, surface, modes, test, volumes, half_cell, result, power):  # type: ignore[no-untyped-def]
    """Add the tractions to the projected force, and the power of their parts on each coordinate to `power`."""
    for nodes in (sites.dead_node, sites.pressure_node):
        for k in range(nodes.shape[0]):
            i = nodes[k]
            for c in range(3):
                value = surface[i, c]
                surface[i, c] = 0.0  # a node that two loads share counts once
                for m in range(modes.shape[0]):
                    power[m] += volumes[i] * value * modes[m, i, c]
                for m in range(result.shape[0]):
                    result[m] += half_cell * value * test[m, 3 * i + c]


@cache
def reduced_step(formulation: Formulation) -> tuple[Any, Any]:
    """Compile the projected force and the steps of a reduced model.

    Returns
    -------
    projected_force, advance : functions
    """
    digest, respond, finish = formulation.digest, formulation.respond_to_columns, formulation.finish
    project = formulation.project

    if project is None:

        @law_njit(digest)
        def projected_force(columns, table, test, body, work, volumes, partial, force, result):  # type: ignore[no-untyped-def]
            respond(columns, table, body, work)
            finish(body, work, force)
            _project(test, force, result)

    else:

        @law_njit(digest)
        def projected_force(columns, table, test, body, work, volumes, partial, force, result):  # type: ignore[no-untyped-def]
            respond(columns, table, body, work)
            project(table, body, work, volumes, partial, result)

    @law_njit(digest)
    def advance(  # type: ignore[no-untyped-def]
        a,
        velocity,
        lifting,
        holds,
        step,
        beta,
        wave_speed,
        table,
        modes,
        test,
        mass,
        body,
        work,
        sites,
        schedule,
        gravity_test,
        gravity_work,
        held_response,
        free_response,
        volumes,
        density,
        half_cell,
        slot,
        force,
        partial,
        surface,
        columns,
        result,
        previous,
        rates,
        power,
    ):
        total, lost, tools, steps = 0.0, 0.0, 0.0, lifting.shape[0] - 3
        count, first = a.shape[0], a.shape[0] - lifting.shape[1]
        for s in range(steps + 1):
            # lifting has one time before the first and one after the last
            if holds[s]:
                for j in range(first, count):
                    a[j] = lifting[s + 1, j - first]
                    velocity[j] = (lifting[s + 1, j - first] - lifting[s, j - first]) / step
            for m in range(count):
                columns[m] = a[m] + beta * velocity[m]
            for j in range(first, count):
                if holds[s] and abs(velocity[j]) > wave_speed[j - first]:  # a jump, as in the full model
                    columns[j] = a[j] + beta * np.sign(velocity[j]) * wave_speed[j - first]
            projected_force(columns, table, test, body, work, volumes, partial, force, result)
            for m in range(count):
                if s > 0:
                    lost += (columns[m] - a[m]) * (previous[m] - result[m])
                previous[m] = result[m]
            surface_force(sites, schedule, s, volumes, slot, work.cofactor, surface)
            power[:] = 0.0
            _tractions(sites, surface, modes, test, volumes, half_cell, result, power)
            kick = 0.5 * step if s in (0, steps) else step
            held = holds[min(s + 1, steps)]
            moving = first if held else count  # coordinates that obey the equations of motion
            for m in range(count):
                rates[m] = result[m] / density
                for c in range(3):
                    rates[m] += gravity_test[m, c] * schedule.gravity[s, c]
                    power[m] += gravity_work[m, c] * schedule.gravity[s, c]
                if held:
                    for j in range(first, count):
                        bend = lifting[s + 2, j - first] - 2 * lifting[s + 1, j - first] + lifting[s, j - first]
                        rates[m] -= mass[m, j] * bend / step**2
            response = held_response if held else free_response
            for m in range(moving):
                rate = 0.0
                for k in range(moving):
                    rate += response[m, k] * rates[k]
                before = velocity[m]
                velocity[m] = before + kick * rate
                total += kick * power[m] * 0.5 * (before + velocity[m])
                for j in range(moving, count):
                    rates[j] -= mass[j, m] * rate
            for j in range(moving, count):
                speed = (lifting[s + 2, j - first] - lifting[s, j - first]) / (2 * step)
                total += kick * power[j] * speed
                if s < steps:  # the last time is the next call's first
                    tools -= step * density * rates[j] * speed
            if s < steps:
                for m in range(moving):
                    a[m] += step * velocity[m]
        return total, lost, tools

    return projected_force, advance
