"""The compiled energy-conserving implicit step of a sampled reduced model, and the tangent of its forces.

With the coordinates a of modes and lifting vectors, the mass matrix m, the sampled force f and the
loads g, the step solves for the mean velocity w,

    m (2 (w - v_n) / dt + alpha w) = mean of f(a_n + s dt w + beta w) + g(t_n + dt / 2),
    a_{n+1} = a_n + dt w,    v_{n+1} = 2 w - v_n,

by Newton's method with a tangent that is reused as long as it converges. The mean is over the step,
0 < s < 1, by Gauss's rule with two points: the average vector field method (Quispel and McLaren,
J. Phys. A 41, 2008). Its work equals the change of the energy. So the energy of a free body is
conserved for any step, as far as two points integrate it. (With the midpoint rule, one point, the
energy of a bent beam drifted by half in 20 s with steps of 1 ms.)
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.reference import reference
from palpate.core.arrays import Floats
from palpate.dynamics.material.relaxation import copy_values
from palpate.reduction.galerkin.central_difference import mass_damping_loss
from palpate.reduction.hyper.constants import ReducedConstants
from palpate.reduction.hyper.foundation import Springs, add_spring_forces
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.sampled_energy import Scratch, sampled_energy

GAUSS_POINTS = (0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0)  # of Gauss's rule in a step
MAX_ITERATIONS = 30  # of Newton's method in a step
REFRESH_ITERATIONS = (4, 10, 18, 24)  # iterations after which the tangent is updated

# rows of `NewtonScratch.vectors`
PROBE, AHEAD, BEHIND, MEAN_VELOCITY, TRIAL, FORCE, RATE, UPDATE, ELASTIC, LOAD = range(10)
FACTOR_STEP, FACTOR_SIZE = range(2)  # entries of `NewtonScratch.factored`
ITERATIONS, TANGENTS, FAILURES = range(3)  # entries of `NewtonScratch.counts`


class NewtonScratch(NamedTuple):
    """Cholesky factor, counters and work arrays of the implicit step, which a step does not allocate."""

    factor: Floats  # (m, m) lower Cholesky factor of the system
    factored: Floats  # (2,) step [s] and number of coordinates of the factor; 0 for none
    counts: NDArray[np.int64]  # (3,) iterations, tangents, steps that did not converge
    vectors: Floats  # (10, m); the first three are those of the tangent


class ImplicitData(NamedTuple):
    """Constants and work arrays of the implicit step."""

    constants: ReducedConstants
    tolerance: float  # largest Newton update, in units of the constants' `differences`
    scratch: Scratch
    springs: Springs  # on the coordinates
    newton: NewtonScratch


def newton_scratch(coordinates: int) -> NewtonScratch:
    """Return zeroed work arrays for a number of coordinates."""
    return NewtonScratch(
        np.zeros((coordinates, coordinates)), np.zeros(2), np.zeros(3, dtype=np.int64), np.zeros((10, coordinates))
    )


@kernel_njit(fastmath={"contract"})
def cholesky_factor(matrix, count):
    """Factorise the symmetric part of the leading block in place; return True if it is positive definite."""
    for j in range(count):
        for i in range(j, count):
            matrix[i, j] = 0.5 * (matrix[i, j] + matrix[j, i])
    for j in range(count):
        total = matrix[j, j]
        for k in range(j):
            total -= matrix[j, k] * matrix[j, k]
        if not total > 0.0:
            return False
        root = np.sqrt(total)
        matrix[j, j] = root
        for i in range(j + 1, count):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / root
    return True


@kernel_njit(fastmath={"contract"})
def cholesky_solve(factor, count, vector):
    """Solve in place with a Cholesky factor."""
    for i in range(count):
        value = vector[i]
        for k in range(i):
            value -= factor[i, k] * vector[k]
        vector[i] = value / factor[i, i]
    for i in range(count - 1, -1, -1):
        value = vector[i]
        for k in range(i + 1, count):
            value -= factor[k, i] * vector[k]
        vector[i] = value / factor[i, i]


@cache
def implicit_step(law: MaterialPoint, single: bool) -> tuple[Any, Any]:
    """Compile the implicit step of sampled models of a law.

    Parameters
    ----------
    law, single
        As for `palpate.reduction.hyper.sampled_energy.sampled_energy`.

    Returns
    -------
    implicit, tangent : functions
        ``implicit(a, v, lifting, holds, step, loads, data)`` advances coordinates and velocities (m + l,)
        in place. `lifting` (s + 3, l) has one time before the first step and one after the last, and
        `holds` (s,) is True while tools prescribe the lifting coordinates. `data` is an `ImplicitData`.
        ``tangent(a, sizes, integration_points, scratch, vectors, count, matrix)`` writes -df/da.
    """
    digest = law_digest(__name__, "implicit step", law.digest, single)
    force = sampled_energy(law, single).force

    @law_njit(digest, nogil=True, fastmath={"contract"})
    def tangent(a, sizes, given_points, given_scratch, vectors, count, matrix):
        """Write -df/da of the first `count` coordinates, by central differences of `sizes` [unit of a]."""
        integration_points, scratch = reference(given_points), reference(given_scratch)
        probe, ahead, behind = vectors[PROBE], vectors[AHEAD], vectors[BEHIND]
        for m in range(count):
            copy_values(a, probe)
            probe[m] = a[m] + sizes[m]
            force(probe, integration_points, scratch, ahead)
            probe[m] = a[m] - sizes[m]
            force(probe, integration_points, scratch, behind)
            for k in range(count):
                matrix[k, m] = (behind[k] - ahead[k]) / (2.0 * sizes[m])

    @law_njit(digest, inner=True, fastmath={"contract"})
    def add_springs(step, springs, matrix, moving):
        """Add the springs to the matrix of the system for the mean velocities."""
        if springs.stiffness.shape[0] > 0:
            for i in range(moving):
                for k in range(moving):
                    matrix[i, k] += 0.5 * step * springs.stiffness[i, k] + springs.damping[i, k]

    @law_njit(digest, inner=True, fastmath={"contract"})
    def mean_loads(a, w, step, external, springs, at, load):
        """Write the mean external and spring forces of a step with the mean velocities w."""
        for j in range(a.shape[0]):
            at[j] = a[j] + 0.5 * step * w[j]
            load[j] = external[j]
        add_spring_forces(springs, at, w, load)

    @law_njit(digest, inner=True, fastmath={"contract"})
    def refactor(a, step, data, moving):
        """Update the tangent and factorise (2 / dt + alpha) m + (dt / 2 + beta) K.

        The factor is that of the mass part where the matrix is indefinite.

        Springs add dt / 2 times their stiffness, and their damping, to both.
        """
        newton, mass, beta, alpha = (
            data.newton,
            data.constants.mass,
            data.constants.stiffness_damping,
            data.constants.mass_damping,
        )
        tangent(
            a,
            data.constants.differences,
            data.constants.integration_points,
            data.scratch,
            newton.vectors,
            moving,
            newton.factor,
        )
        for i in range(moving):
            for k in range(moving):
                inertia = 2.0 * mass[i, k] / step + alpha * mass[i, k]
                newton.factor[i, k] = inertia + (0.5 * step + beta) * newton.factor[i, k]
        add_springs(step, data.springs, newton.factor, moving)
        newton.counts[TANGENTS] += 1
        if not cholesky_factor(newton.factor, moving):
            for i in range(moving):
                for k in range(moving):
                    newton.factor[i, k] = 2.0 * mass[i, k] / step + alpha * mass[i, k]
            add_springs(step, data.springs, newton.factor, moving)
            cholesky_factor(newton.factor, moving)
        newton.factored[FACTOR_STEP], newton.factored[FACTOR_SIZE] = step, moving

    @law_njit(digest, inner=True, fastmath={"contract"})
    def mean_force(a, w, step, beta, data, at, other, result):
        """Write the mean internal force over a step with the mean velocities w."""
        for j in range(a.shape[0]):
            at[j] = a[j] + (GAUSS_POINTS[0] * step + beta) * w[j]
        force(at, data.constants.integration_points, data.scratch, other)
        for j in range(a.shape[0]):
            at[j] = a[j] + (GAUSS_POINTS[1] * step + beta) * w[j]
        force(at, data.constants.integration_points, data.scratch, result)
        for j in range(a.shape[0]):
            result[j] = 0.5 * (result[j] + other[j])

    @law_njit(digest, inner=True, fastmath={"contract"})
    def solve(a, v, step, external, data, moving):
        """Solve for the first `moving` mean velocities w of one step; the others and their rates are prescribed.

        A rate is that of a velocity, plus alpha times its mean.
        """
        newton, mass, vectors = data.newton, data.constants.mass, data.newton.vectors
        w, at, result, rate = vectors[MEAN_VELOCITY], vectors[TRIAL], vectors[FORCE], vectors[RATE]
        change, load = vectors[UPDATE], vectors[LOAD]
        count = a.shape[0]
        if newton.factored[FACTOR_STEP] != step or newton.factored[FACTOR_SIZE] != moving:
            refactor(a, step, data, moving)
        for iteration in range(MAX_ITERATIONS):
            mean_loads(a, w, step, external, data.springs, at, load)
            mean_force(a, w, step, data.constants.stiffness_damping, data, at, change, result)
            for m in range(moving):
                rate[m] = 2.0 * (w[m] - v[m]) / step + data.constants.mass_damping * w[m]
            for m in range(moving):
                value = result[m] + load[m]
                for k in range(count):
                    value -= mass[m, k] * rate[k]
                change[m] = value
            cholesky_solve(newton.factor, moving, change)
            largest = 0.0
            for m in range(moving):
                w[m] += change[m]
                largest = max(largest, abs(change[m]) * step / data.constants.differences[m])
            newton.counts[ITERATIONS] += 1
            if largest < data.tolerance:
                return True
            if not largest < 1e12:
                return False
            for r in range(len(REFRESH_ITERATIONS)):
                if iteration == REFRESH_ITERATIONS[r]:
                    refactor(at, step, data, moving)
        return False

    @law_njit(digest, nogil=True, fastmath={"contract"})
    def implicit(a, v, lifting, holds, step, loads, given):
        """Advance by the number of loads; return the work [J] of loads, the dissipation, the work of tools, and steps.

        The number of steps is less than that of the loads if a step did not converge.
        """
        data, count, first = reference(given), a.shape[0], a.shape[0] - lifting.shape[1]
        total, lost, tool_work = 0.0, 0.0, 0.0
        newton, mass, vectors = data.newton, data.constants.mass, data.newton.vectors
        w, at, result, rate = vectors[MEAN_VELOCITY], vectors[TRIAL], vectors[FORCE], vectors[RATE]
        elastic, load, alpha = vectors[ELASTIC], vectors[LOAD], data.constants.mass_damping
        for s in range(loads.shape[0]):
            # lifting has one time before the first and one after the last
            moving = first if holds[s] else count
            for j in range(count):
                w[j] = v[j]
            for j in range(moving, count):
                c = lifting[:, j - first]
                w[j] = (c[s + 2] - c[s + 1]) / step
                rate[j] = (c[s + 3] - c[s + 2] - c[s + 1] + c[s]) / (2.0 * step * step) + alpha * w[j]
            if not solve(a, v, step, loads[s], data, moving):
                newton.counts[FAILURES] += 1
                newton.factored[FACTOR_STEP] = 0.0
                return total, lost, tool_work, s
            for m in range(moving):
                rate[m] = 2.0 * (w[m] - v[m]) / step + alpha * w[m]
            mean_loads(a, w, step, loads[s], data.springs, at, load)
            mean_force(a, w, step, 0.0, data, at, vectors[UPDATE], elastic)
            for j in range(count):
                total += step * load[j] * w[j]
                lost += step * w[j] * (elastic[j] - result[j])
            lost += mass_damping_loss(alpha, mass, w, step)
            for j in range(moving, count):
                value = -result[j] - load[j]
                for k in range(count):
                    value += mass[j, k] * rate[k]
                tool_work += step * value * w[j]
            for j in range(count):
                a[j] += step * w[j]
                v[j] = 2.0 * w[j] - v[j]
            for j in range(moving, count):
                c = lifting[:, j - first]
                a[j], v[j] = c[s + 2], (c[s + 3] - c[s + 1]) / (2.0 * step)
        return total, lost, tool_work, loads.shape[0]

    return implicit, tangent
