"""The compiled step of the Galerkin model: passes of the full model on derivatives from few coordinates."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from numba import prange

from palpate.compiled.jit import kernel_njit, law_njit
from palpate.compiled.passes import Formulation
from palpate.core.arrays import Floats
from palpate.dynamics.nodal.central_difference import surface_force
from palpate.dynamics.nodal.model import NodalWork
from palpate.reduction.galerkin.central_difference import (
    damping_work,
    drift,
    kick_coordinates,
    mass_damping_loss,
    prescribe,
    prescribed_work,
    trial_coordinates,
)


class BodyData(NamedTuple):
    """Constants of the full model."""

    body: Any
    volumes: Floats  # (n,) [m^3]
    slot: Any  # place of each node in the blocks
    half_cell: float
    density: float  # [kg/m^3]
    stiffness_damping: float  # [s]
    mass_damping: float  # [1/s]


class BasisData(NamedTuple):
    """Basis vectors and test functions, with their products."""

    table: Floats  # (b, m, numbers, LANES) derivatives of the basis vectors
    vectors: Floats  # (m, n, 3)
    test: Floats  # (m, 3 n)
    mass: Floats  # (m, m)
    kinetic: Floats  # (m, m) [kg] mass matrix of the kinetic energy
    gravity_test: Floats  # (m, 3)
    gravity_work: Floats  # (m, 3)
    wave_speed: Floats  # (l,) largest rates of the lifting coordinates in the damping forces


class GalerkinWork(NamedTuple):
    """Scratch arrays of a Galerkin model for one thread, with n nodes, b blocks and m coordinates."""

    full: NodalWork
    # force, surface: (n, 3) arrays [N/m^3]: internal force, and surface loads
    force: Floats  # (n, 3)
    surface: Floats  # (n, 3)
    # (b, m) array: partial sums of the projection
    partial: Floats  # (b, m)
    # coordinates, result, previous, rates, mean, power: (m,) arrays: trial coordinates; projected force, and the
    # previous one; accelerations; mean velocities; power of the surface forces
    coordinates: Floats  # (m,)
    result: Floats  # (m,)
    previous: Floats  # (m,)
    rates: Floats  # (m,)
    mean: Floats  # (m,) velocities
    power: Floats  # (m,)


@kernel_njit(parallel=True, fastmath={"contract", "reassoc"})
def _project(test, force, result):
    """Write the sum over the nodes of test[m] . force for every m, each by one thread, in one order."""
    flat = force.reshape(-1)
    for m in prange(test.shape[0]):
        total = 0.0
        row = test[m]
        for k in range(flat.shape[0]):
            total += row[k] * flat[k]
        result[m] = total


@kernel_njit(inner=True)
def _add_surface_forces(sites, body, basis, work):
    """Add the surface forces to the projected force, and their power on each coordinate to `work.power`."""
    surface, power, result, vectors, test = work.surface, work.power, work.result, basis.vectors, basis.test
    for nodes in (sites.dead_node, sites.pressure_node):
        for k in range(nodes.shape[0]):
            i = nodes[k]
            for c in range(3):
                value = surface[i, c]
                surface[i, c] = 0.0  # a node with two loads counts once
                for m in range(vectors.shape[0]):
                    power[m] += body.volumes[i] * value * vectors[m, i, c]
                for m in range(result.shape[0]):
                    result[m] += body.half_cell * value * test[m, 3 * i + c]


@cache
def reduced_step(formulation: Formulation) -> tuple[Any, Any]:
    """Compile the projected force and the steps of a Galerkin model.

    ``projected_force(coordinates, body, basis, work)`` writes to `work.result`. ``advance(a, velocity, lifting, holds,
    step, loads, responses, body, basis, work)`` advances coordinates and velocities (m,) in place, and returns the work
    of the loads, the dissipation, and the work of the tools [J]. `loads` are sites and history, `responses` the inverse
    mass matrices of the modes and of all coordinates.
    """
    digest, respond, finish = formulation.digest, formulation.respond_to_columns, formulation.finish
    project = formulation.project

    if project is None:

        @law_njit(digest)
        def projected_force(coordinates, body, basis, work):
            respond(coordinates, basis.table, body.body, work.full.passes)
            finish(body.body, work.full.passes, work.force)
            _project(basis.test, work.force, work.result)

    else:

        @law_njit(digest)
        def projected_force(coordinates, body, basis, work):
            respond(coordinates, basis.table, body.body, work.full.passes)
            project(basis.table, body.body, work.full.passes, body.volumes, work.partial, work.result)

    @law_njit(digest)
    def advance(a, velocity, lifting, holds, step, loads, responses, body, basis, work):
        beta, density, result, power = body.stiffness_damping, body.density, work.result, work.power
        sites, schedule = loads
        alpha, kinetic = body.mass_damping, basis.kinetic
        total, lost, tool_work, steps = 0.0, 0.0, 0.0, lifting.shape[0] - 3
        count, first = a.shape[0], a.shape[0] - lifting.shape[1]
        for s in range(steps + 1):
            if holds[s]:
                prescribe(a, velocity, lifting, s, step)
            trial_coordinates(a, velocity, beta, basis.wave_speed, holds[s], work.coordinates)
            projected_force(work.coordinates, body, basis, work)
            change = damping_work(work.coordinates, a, result, work.previous)
            if s > 0:
                lost += change
            surface_force(sites, schedule, s, body.volumes, body.slot, work.full.passes.cofactor, work.surface)
            power[:] = 0.0
            _add_surface_forces(sites, body, basis, work)
            for m in range(count):
                work.rates[m] = result[m] / density
                for c in range(3):
                    work.rates[m] += basis.gravity_test[m, c] * schedule.gravity[s, c]
                    power[m] += basis.gravity_work[m, c] * schedule.gravity[s, c]
            kick = 0.5 * step if s in (0, steps) else step
            prescribed = holds[min(s + 1, steps)]
            response = responses[0] if prescribed else responses[1]
            total += kick_coordinates(
                velocity, work.rates, power, lifting, s, step, kick, prescribed, basis.mass, response, alpha, work.mean
            )
            lost += mass_damping_loss(alpha, kinetic, work.mean, kick)
            if prescribed:
                works = prescribed_work(work.rates, power, lifting, s, step, kick, density)
                total += works[0]
                if s < steps:  # the next call evaluates the last time
                    tool_work += works[1]
            if s < steps:
                drift(a, velocity, first if prescribed else count, step)
        return total, lost, tool_work

    return projected_force, advance
