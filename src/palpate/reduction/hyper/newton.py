"""Newton's method for the mean velocities of an implicit step of a sampled reduced model, compiled.

With the coordinates a, the velocities v at the start of a step and their means w, it solves

    r(w) = <f> + <g> - m (2 (w - v) / dt + alpha w) = 0,      w += S^-1 r,
    S = (2 / dt + alpha) m + (dt / 2 + beta) K,      K = -df/da,

where <f> and <g> are mean internal and external forces over the step (`palpate.reduction.hyper.implicit`). The tangent
K of central differences is factorised by Cholesky's method, and reused as long as the iteration converges.
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
from palpate.reduction.hyper.foundation import add_spring_forces
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.sampled_energy import sampled_energy

GAUSS_POINTS = (0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0)  # of Gauss's rule in a step
MAX_ITERATIONS = 30  # of Newton's method in a step
DIVERGENCE_LIMIT = 1e12  # Newton update that ends a step, in units of `ReducedConstants.differences`
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


@kernel_njit(inner=True)
def _add_springs(step, springs, matrix, moving):
    """Add the springs to the matrix of the system for the mean velocities."""
    if springs.stiffness.shape[0] > 0:
        for i in range(moving):
            for k in range(moving):
                matrix[i, k] += 0.5 * step * springs.stiffness[i, k] + springs.damping[i, k]


@kernel_njit(inline="always", fastmath={"contract"})
def _factorise(data, step, moving):
    """Replace the tangent by the factor of S; that of its mass part where S is indefinite.

    Springs add dt / 2 times their stiffness, and their damping, to both.
    """
    newton, mass, beta, alpha = (
        data.newton,
        data.constants.mass,
        data.constants.stiffness_damping,
        data.constants.mass_damping,
    )
    for i in range(moving):
        for k in range(moving):
            inertia = 2.0 * mass[i, k] / step + alpha * mass[i, k]
            newton.factor[i, k] = inertia + (0.5 * step + beta) * newton.factor[i, k]
    _add_springs(step, data.springs, newton.factor, moving)
    newton.counts[TANGENTS] += 1
    if not cholesky_factor(newton.factor, moving):
        for i in range(moving):
            for k in range(moving):
                newton.factor[i, k] = 2.0 * mass[i, k] / step + alpha * mass[i, k]
        _add_springs(step, data.springs, newton.factor, moving)
        cholesky_factor(newton.factor, moving)
    newton.factored[FACTOR_STEP], newton.factored[FACTOR_SIZE] = step, moving


@kernel_njit(inner=True)
def mean_loads(a, w, step, external, springs, at, load):
    """Write the mean external and spring forces of a step with the mean velocities w."""
    for j in range(a.shape[0]):
        at[j] = a[j] + 0.5 * step * w[j]
        load[j] = external[j]
    add_spring_forces(springs, at, w, load)


@kernel_njit(inline="always", fastmath={"contract"})
def write_rates(data, v, step, moving):
    """Write the rates of the first mean velocities: that of a velocity, plus alpha times its mean."""
    w, rate = data.newton.vectors[MEAN_VELOCITY], data.newton.vectors[RATE]
    for m in range(moving):
        rate[m] = 2.0 * (w[m] - v[m]) / step + data.constants.mass_damping * w[m]


@kernel_njit(inline="always", fastmath={"contract"})
def _write_residual(data, moving):
    """Write the unbalanced forces r of the first coordinates."""
    vectors, mass = data.newton.vectors, data.constants.mass
    result, load, rate, residual = vectors[FORCE], vectors[LOAD], vectors[RATE], vectors[UPDATE]
    for m in range(moving):
        value = result[m] + load[m]
        for k in range(rate.shape[0]):
            value -= mass[m, k] * rate[k]
        residual[m] = value


@kernel_njit(inline="always", fastmath={"contract"})
def _update(data, step, moving):
    """Add the update to the mean velocities; return its largest part, in units of `ReducedConstants.differences`."""
    w, change, largest = data.newton.vectors[MEAN_VELOCITY], data.newton.vectors[UPDATE], 0.0
    for m in range(moving):
        w[m] += change[m]
        largest = max(largest, abs(change[m]) * step / data.constants.differences[m])
    return largest


@cache
def tangent_function(law: MaterialPoint, single: bool) -> Any:
    """Compile ``tangent(a, sizes, cubature_points, scratch, vectors, count, matrix)``, which writes -df/da."""
    digest = law_digest(__name__, "tangent", law.digest, single)
    force = sampled_energy(law, single).force

    @law_njit(digest, nogil=True, fastmath={"contract"})
    def tangent(a, sizes, given_points, given_scratch, vectors, count, matrix):
        """Write -df/da of the first `count` coordinates, by central differences of `sizes` [unit of a]."""
        cubature_points, scratch = reference(given_points), reference(given_scratch)
        probe, ahead, behind = vectors[PROBE], vectors[AHEAD], vectors[BEHIND]
        for m in range(count):
            copy_values(a, probe)
            probe[m] = a[m] + sizes[m]
            force(probe, cubature_points, scratch, ahead)
            probe[m] = a[m] - sizes[m]
            force(probe, cubature_points, scratch, behind)
            for k in range(count):
                matrix[k, m] = (behind[k] - ahead[k]) / (2.0 * sizes[m])

    return tangent


@cache
def mean_force_function(law: MaterialPoint, single: bool) -> Any:
    """Compile ``mean_force(a, w, step, beta, data, at, other, result)``, the mean internal force over a step."""
    digest = law_digest(__name__, "mean force", law.digest, single)
    force = sampled_energy(law, single).force

    @law_njit(digest, inner=True, fastmath={"contract"})
    def mean_force(a, w, step, beta, data, at, other, result):
        """Write the mean internal force over a step with the mean velocities w."""
        for j in range(a.shape[0]):
            at[j] = a[j] + (GAUSS_POINTS[0] * step + beta) * w[j]
        force(at, data.constants.cubature_points, data.scratch, other)
        for j in range(a.shape[0]):
            at[j] = a[j] + (GAUSS_POINTS[1] * step + beta) * w[j]
        force(at, data.constants.cubature_points, data.scratch, result)
        for j in range(a.shape[0]):
            result[j] = 0.5 * (result[j] + other[j])

    return mean_force


@cache
def newton_solver(law: MaterialPoint, single: bool) -> Any:
    """Compile Newton's method.

    ``solve(a, v, step, external, data, moving)`` writes the first `moving` mean velocities of a step, and returns
    whether it has converged. The others and their rates are prescribed. `data` is an `ImplicitData`.
    """
    digest = law_digest(__name__, "newton", law.digest, single)
    tangent, mean_force = tangent_function(law, single), mean_force_function(law, single)

    @law_njit(digest, inner=True, fastmath={"contract"})
    def refactor(a, step, data, moving):
        """Update the tangent and factorise the matrix of the system."""
        newton = data.newton
        tangent(
            a,
            data.constants.differences,
            data.constants.cubature_points,
            data.scratch,
            newton.vectors,
            moving,
            newton.factor,
        )
        _factorise(data, step, moving)

    @law_njit(digest, inner=True, fastmath={"contract"})
    def solve(a, v, step, external, data, moving):
        newton, vectors = data.newton, data.newton.vectors
        w, at, change = vectors[MEAN_VELOCITY], vectors[TRIAL], vectors[UPDATE]
        if newton.factored[FACTOR_STEP] != step or newton.factored[FACTOR_SIZE] != moving:
            refactor(a, step, data, moving)
        for iteration in range(MAX_ITERATIONS):
            mean_loads(a, w, step, external, data.springs, at, vectors[LOAD])
            mean_force(a, w, step, data.constants.stiffness_damping, data, at, change, vectors[FORCE])
            write_rates(data, v, step, moving)
            _write_residual(data, moving)
            cholesky_solve(newton.factor, moving, change)
            largest = _update(data, step, moving)
            newton.counts[ITERATIONS] += 1
            if largest < data.tolerance:
                return True
            if not largest < DIVERGENCE_LIMIT:
                return False
            for r in range(len(REFRESH_ITERATIONS)):
                if iteration == REFRESH_ITERATIONS[r]:
                    refactor(at, step, data, moving)
        return False

    return solve
