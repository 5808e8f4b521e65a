"""The stable step of a full body in the engine, from a power iteration on the present tangent, compiled.

An iteration with the mass M and the tangent K of the energy, at the displacements u, is

    w = M^-1 (f(u) - f(u + d)) ~ M^-1 K d,      omega^2 ~ |w| / |d|,

and the next direction d is w, with some noise so that another mode can grow. Central differences with the damping
beta K are stable up to the step (sqrt(z^2 + 4) - z) / omega, z = beta omega (Belytschko, Liu and Moran, Nonlinear
Finite Elements for Continua and Structures, Wiley 2000).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.passes import Formulation, internal_force
from palpate.dynamics.contact.geometry import project
from palpate.dynamics.loads.supports import FIXED
from palpate.dynamics.material.relaxation import copy_field
from palpate.dynamics.nodal.mass_scaling import subtract_inertia
from palpate.dynamics.nodal.period_data import BASE_FREQUENCY, ESTIMATE, FREQUENCY, STEP, UNTIL_ESTIMATE

ESTIMATE_PERIODS = 16  # between two iterations for the highest frequency
FREQUENCY_MARGIN = 1.05  # of the estimate, because an iteration converges from below
SLOWEST_DECREASE = 0.9  # of the frequency from one estimate to the next
STEP_SAFETY = 0.85  # step over the stable one
ITERATION_NOISE = 0.005  # added to the vector of the iteration, so that another mode can grow
STIFF_RATIO, STIFF_ESTIMATE = 1.5, 4  # frequency over that at rest from which on it is estimated after fewer periods
MAX_FREQUENCY_RATIO = 100.0  # of the estimate over the frequency at rest


@kernel_njit(inner=True)
def set_step(data):
    """Set the step to a share of the stable one."""
    stepping = data.stepping
    z = data.body.damping.beta * stepping[FREQUENCY]
    stepping[STEP] = STEP_SAFETY * (np.sqrt(z * z + 4.0) - z) / stepping[FREQUENCY]


@kernel_njit(inline="always")
def _last_size(iteration):
    """Return the largest entry of the last image, which is replaced by noise where it has none."""
    vector, largest = iteration.vector, 0.0
    for i in range(vector.shape[0]):
        for c in range(3):
            largest = max(largest, abs(vector[i, c]))
    if 0.0 < largest < np.inf:
        return largest
    copy_field(iteration.noise, vector)
    return 1.0


@kernel_njit(inline="always")
def _write_direction(iteration, kind, u, moved, ahead):
    """Write the direction d (n, 3) [m], zero at fixed nodes, and u + d; return |d|^2 [m^2]."""
    vector, noise, largest = iteration.vector, iteration.noise, _last_size(iteration)
    largest_moved, size = 0.0, 0.0
    for i in range(u.shape[0]):
        for c in range(3):
            moved[i, c] = vector[i, c] / largest + ITERATION_NOISE * noise[i, c] if kind[i] != FIXED else 0.0
            largest_moved = max(largest_moved, abs(moved[i, c]))
    for i in range(u.shape[0]):
        for c in range(3):
            moved[i, c] *= iteration.amplitude / largest_moved
            size += moved[i, c] ** 2
            ahead[i, c] = u[i, c] + moved[i, c]
    return size


@kernel_njit(inline="always")
def _write_image(vector, sites, density, force, force_ahead):
    """Write the image w (n, 3) of a direction, with what supports leave of it; return |w|^2."""
    grown = 0.0
    for i in range(vector.shape[0]):
        for c in range(3):
            vector[i, c] = (force[i, c] - force_ahead[i, c]) / density if sites.kind[i] != FIXED else 0.0
        if sites.slide_of[i] >= 0:
            free = project(sites.slide, sites.slide_of[i], vector[i, 0], vector[i, 1], vector[i, 2])
            vector[i, 0], vector[i, 1], vector[i, 2] = free
        for c in range(3):
            grown += vector[i, c] ** 2
    return grown


@kernel_njit(inline="always")
def _take_estimate(data, frequency):
    """Set the highest frequency, which decreases slowly, to an estimate [rad/s], and when the next one is due."""
    stepping, resting = data.stepping, data.body.resting_frequency
    if frequency > 0.0 and frequency < np.inf:
        most = MAX_FREQUENCY_RATIO * resting
        stepping[ESTIMATE] = min(max(FREQUENCY_MARGIN * frequency, resting), most)
        # an iteration that has not converged must not lengthen the step at once
        stepping[FREQUENCY] = min(max(stepping[ESTIMATE], SLOWEST_DECREASE * stepping[FREQUENCY]), most)
    is_stiff = stepping[FREQUENCY] > STIFF_RATIO * resting
    stepping[UNTIL_ESTIMATE] = STIFF_ESTIMATE if is_stiff else ESTIMATE_PERIODS


@cache
def step_control(formulation: Formulation) -> Any:
    """Compile ``choose_step(data, u)``, which sets the step of a period."""
    digest = law_digest(__name__, formulation.digest)
    after, step_force = formulation.after, internal_force(formulation.of_steps)

    @law_njit(digest, inline="always")
    def estimate(data, u):
        """Do one power iteration; return the highest frequency [rad/s]."""
        body, scratch, density = data.body, data.scratch, data.body.nodes.density
        moved = scratch.surface  # then the force at u + d
        size = _write_direction(data.iteration, body.sites.kind, u, moved, scratch.damped)
        constants, work = body.tension_compression_passes
        after(work, 0.0)
        step_force(scratch.damped, constants, work, moved)
        step_force(u, constants, work, scratch.force)
        subtract_inertia(
            body.mass_scaling, body.nodes.volumes, density, -1.0, moved, scratch.force, 0.0, moved, scratch.force
        )
        grown = _write_image(data.iteration.vector, body.sites, density, scratch.force, moved)
        return np.sqrt(np.sqrt(grown / size))

    @law_njit(digest, inline="always")
    def choose_step(data, u):
        """Update the stable step, every few periods by an estimate."""
        stepping, resting = data.stepping, data.body.resting_frequency
        stepping[FREQUENCY] *= max(1.0, resting / stepping[BASE_FREQUENCY])  # of modes that a cut has changed
        stepping[BASE_FREQUENCY] = resting
        stepping[UNTIL_ESTIMATE] -= 1.0
        if stepping[UNTIL_ESTIMATE] <= 0.0:
            _take_estimate(data, estimate(data, u))
        set_step(data)

    return choose_step
