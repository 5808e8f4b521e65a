"""The compiled implicit step of a sampled reduced model, which conserves energy, and the tangent of its forces.

With the coordinates a of modes and lifting columns, the mass matrix m, the sampled force f and the loads g, the step
solves for the mean velocity w,

    m 2 (w - v_n) / dt = mean of f(a_n + s dt w + beta w) + g(t_n + dt / 2),
    a_{n+1} = a_n + dt w,    v_{n+1} = 2 w - v_n,

by Newton's method with a tangent that is kept as long as it converges. The mean is over the step, 0 < s < 1, by Gauss's
rule with two points: the average vector field method (Quispel and McLaren, J. Phys. A 41, 2008). Its work is the change
of the energy, so that the energy of a free body stays, however large the step, as far as two points integrate it. (The
midpoint rule, one point, let the energy of a bent beam stray by half in 20 s with steps of 1 ms.)
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.compiled.cache import kernel_njit, law_digest, law_njit
from palpate.reduction.hyper.foundation import draw_back
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.sampled_energy import sampled_energy

__all__ = ["Newton", "cholesky_factor", "cholesky_solve", "implicit_step", "newton"]


POINTS = (0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0)  # of Gauss's rule in a step
MOST, REFRESH = 30, (4, 10, 18, 24)  # Newton iterations a step, and after how many the tangent is taken anew


class Newton(NamedTuple):
    """What the implicit step keeps from step to step, so that it allocates nothing."""

    factor: Floats  # (m, m) lower Cholesky factor of the system
    kept: Floats  # (2,) the step [s] that the factor is for, and the number of coordinates; 0 for none
    counts: NDArray[np.int64]  # (3,) iterations, tangents, steps that did not converge
    vectors: Floats  # (10, m); the first three are the tangent's


def newton(coordinates: int) -> Newton:
    """Allocate for a number of coordinates."""
    return Newton(
        np.zeros((coordinates, coordinates)), np.zeros(2), np.zeros(3, dtype=np.int64), np.zeros((10, coordinates))
    )


@kernel_njit(fastmath={"contract"})
def cholesky_factor(matrix, count):  # type: ignore[no-untyped-def]
    """Factorise in place the symmetric part of the first rows and columns; return whether it is positive definite."""
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
def cholesky_solve(factor, count, vector):  # type: ignore[no-untyped-def]
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
    """
    digest = law_digest(__name__, "implicit step", law.digest, single)
    force, _ = sampled_energy(law, single)

    @law_njit(digest, fastmath={"contract"})
    def tangent(a, sizes, integration_points, scratch, vectors, count, matrix):  # type: ignore[no-untyped-def]
        """Write -df/da of the first `count` coordinates, by differences of displacements of `sizes` [unit of a]."""
        moved, ahead, behind = vectors[0], vectors[1], vectors[2]
        for m in range(count):
            moved[:] = a
            moved[m] = a[m] + sizes[m]
            force(moved, integration_points, scratch, ahead)
            moved[m] = a[m] - sizes[m]
            force(moved, integration_points, scratch, behind)
            for k in range(count):
                matrix[k, m] = (behind[k] - ahead[k]) / (2.0 * sizes[m])

    @law_njit(digest, inner=True)
    def tie(step, springs, matrix, moving):  # type: ignore[no-untyped-def]
        """Add what springs do to the system that is solved for the mean velocities."""
        if springs.stiffness.shape[0] > 0:
            for i in range(moving):
                for k in range(moving):
                    matrix[i, k] += 0.5 * step * springs.stiffness[i, k] + springs.damping[i, k]

    @law_njit(digest, inner=True)
    def loaded(a, w, step, given, springs, at, load):  # type: ignore[no-untyped-def]
        """Write the mean loads of a step with the mean velocities w: those given, and the springs'."""
        for j in range(a.shape[0]):
            at[j] = a[j] + 0.5 * step * w[j]
            load[j] = given[j]
        draw_back(springs, at, w, load)

    @law_njit(digest, inner=True, fastmath={"contract"})
    def refactor(a, step, beta, mass, sizes, integration_points, scratch, springs, keep, moving):  # type: ignore[no-untyped-def]
        """Take the tangent anew and factorise 2 m / dt + (dt / 2 + beta) K; where that is indefinite, its mass part.

        Springs add dt / 2 of their stiffness, and their damping, to both.
        """
        tangent(a, sizes, integration_points, scratch, keep.vectors, moving, keep.factor)
        for i in range(moving):
            for k in range(moving):
                keep.factor[i, k] = 2.0 * mass[i, k] / step + (0.5 * step + beta) * keep.factor[i, k]
        tie(step, springs, keep.factor, moving)
        keep.counts[1] += 1
        if not cholesky_factor(keep.factor, moving):
            for i in range(moving):
                for k in range(moving):
                    keep.factor[i, k] = 2.0 * mass[i, k] / step
            tie(step, springs, keep.factor, moving)
            cholesky_factor(keep.factor, moving)
        keep.kept[0], keep.kept[1] = step, moving

    @law_njit(digest, inner=True, fastmath={"contract"})
    def mean_force(a, w, step, beta, at, integration_points, scratch, other, result):  # type: ignore[no-untyped-def]
        """Write the mean of the force over a step with the mean velocities w."""
        for j in range(a.shape[0]):
            at[j] = a[j] + (POINTS[0] * step + beta) * w[j]
        force(at, integration_points, scratch, other)
        for j in range(a.shape[0]):
            at[j] = a[j] + (POINTS[1] * step + beta) * w[j]
        force(at, integration_points, scratch, result)
        for j in range(a.shape[0]):
            result[j] = 0.5 * (result[j] + other[j])

    @law_njit(digest, inner=True, fastmath={"contract"})
    def solve(a, v, step, beta, given, mass, sizes, tolerance, integration_points, scratch, springs, keep, moving):  # type: ignore[no-untyped-def]
        """Find the mean velocities w of one implicit step; those from `moving` on are given, and their rates."""
        w, at, result, rate = keep.vectors[3], keep.vectors[4], keep.vectors[5], keep.vectors[6]
        change, load = keep.vectors[7], keep.vectors[9]
        count = a.shape[0]
        if keep.kept[0] != step or keep.kept[1] != moving:
            refactor(a, step, beta, mass, sizes, integration_points, scratch, springs, keep, moving)
        for iteration in range(MOST):
            loaded(a, w, step, given, springs, at, load)
            mean_force(a, w, step, beta, at, integration_points, scratch, change, result)
            for m in range(moving):
                rate[m] = 2.0 * (w[m] - v[m]) / step
            for m in range(moving):
                value = result[m] + load[m]
                for k in range(count):
                    value -= mass[m, k] * rate[k]
                change[m] = value
            cholesky_solve(keep.factor, moving, change)
            largest = 0.0
            for m in range(moving):
                w[m] += change[m]
                largest = max(largest, abs(change[m]) * step / sizes[m])
            keep.counts[0] += 1
            if largest < tolerance:
                return True
            if not largest < 1e12:
                return False
            for r in range(len(REFRESH)):
                if iteration == REFRESH[r]:
                    refactor(at, step, beta, mass, sizes, integration_points, scratch, springs, keep, moving)
        return False

    @law_njit(digest, fastmath={"contract"})
    def implicit(  # type: ignore[no-untyped-def]
        a, v, lifting, holds, step, beta, loads, mass, sizes, tolerance, integration_points, scratch, springs, keep
    ):
        """Advance by as many steps as there are loads; return the works [J] of loads, viscosity, tools, and the steps.

        Fewer steps than loads were taken where one did not converge.
        """
        count, first = a.shape[0], a.shape[0] - lifting.shape[1]
        total, lost, tools = 0.0, 0.0, 0.0
        w, at, result, rate = keep.vectors[3], keep.vectors[4], keep.vectors[5], keep.vectors[6]
        elastic, load = keep.vectors[8], keep.vectors[9]
        for s in range(loads.shape[0]):
            # lifting has one time before the first and one after the last
            moving = first if holds[s] else count
            for j in range(count):
                w[j] = v[j]
            for j in range(moving, count):
                c = lifting[:, j - first]
                w[j] = (c[s + 2] - c[s + 1]) / step
                rate[j] = (c[s + 3] - c[s + 2] - c[s + 1] + c[s]) / (2.0 * step * step)
            if not solve(
                a, v, step, beta, loads[s], mass, sizes, tolerance, integration_points, scratch, springs, keep, moving
            ):
                keep.counts[2] += 1
                keep.kept[0] = 0.0
                return total, lost, tools, s
            for m in range(moving):
                rate[m] = 2.0 * (w[m] - v[m]) / step
            loaded(a, w, step, loads[s], springs, at, load)
            mean_force(a, w, step, 0.0, at, integration_points, scratch, keep.vectors[7], elastic)
            for j in range(count):
                total += step * load[j] * w[j]
                lost += step * w[j] * (elastic[j] - result[j])
            for j in range(moving, count):
                value = -result[j] - load[j]
                for k in range(count):
                    value += mass[j, k] * rate[k]
                tools += step * value * w[j]
            for j in range(count):
                a[j] += step * w[j]
                v[j] = 2.0 * w[j] - v[j]
            for j in range(moving, count):
                c = lifting[:, j - first]
                a[j], v[j] = c[s + 2], (c[s + 3] - c[s + 1]) / (2.0 * step)
        return total, lost, tools, loads.shape[0]

    return implicit, tangent
