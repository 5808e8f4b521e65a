"""The compiled energy-conserving implicit step of a sampled reduced model.

With the coordinates a of modes and lifting functions, the mass matrix m, the sampled force f and the
loads g, the step solves for the mean velocity w,

    m (2 (w - v_n) / dt + alpha w) = mean of f(a_n + s dt w + beta w) + g(t_n + dt / 2),
    a_{n+1} = a_n + dt w,    v_{n+1} = 2 w - v_n,

by Newton's method (`palpate.reduction.hyper.newton`). The mean is over the step,
0 < s < 1, by Gauss's rule with two points: the average vector field method (Quispel and McLaren,
J. Phys. A 41, 2008). Its work equals the change of the energy. So the energy of a free body is
conserved for any step, as far as two points integrate it. (With the midpoint rule, one point, the
energy of a bent beam drifted by half in 20 s with steps of 1 ms.)
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.reference import reference
from palpate.reduction.galerkin.central_difference import mass_damping_loss
from palpate.reduction.hyper.constants import ReducedConstants
from palpate.reduction.hyper.foundation import Springs
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.newton import (
    ELASTIC,
    FACTOR_STEP,
    FAILURES,
    FORCE,
    LOAD,
    MEAN_VELOCITY,
    RATE,
    TRIAL,
    UPDATE,
    NewtonScratch,
    mean_force_function,
    mean_loads,
    newton_solver,
    write_rates,
)
from palpate.reduction.hyper.sampled_energy import Scratch


class ImplicitData(NamedTuple):
    """Constants and work arrays of the implicit step."""

    constants: ReducedConstants
    tolerance: float  # largest Newton update, in units of the constants' `differences`
    scratch: Scratch
    springs: Springs  # on the coordinates
    newton: NewtonScratch


@kernel_njit(inline="always", fastmath={"contract"})
def _begin_step(data, v, lifting, s, step, moving):
    """Start with the present velocities, and prescribe the mean velocities of lifting coordinates and their rates."""
    w, rate, first = data.newton.vectors[MEAN_VELOCITY], data.newton.vectors[RATE], v.shape[0] - lifting.shape[1]
    for j in range(v.shape[0]):
        w[j] = v[j]
    for j in range(moving, v.shape[0]):
        c = lifting[:, j - first]
        w[j] = (c[s + 2] - c[s + 1]) / step
        rate[j] = (c[s + 3] - c[s + 2] - c[s + 1] + c[s]) / (2.0 * step * step) + data.constants.mass_damping * w[j]


@kernel_njit(inline="always", fastmath={"contract"})
def _add_works(data, step, moving, total, lost, tool_work):
    """Return the work of loads, the dissipation and the work of tools [J] with those of a step."""
    vectors, mass = data.newton.vectors, data.constants.mass
    w, result, rate = vectors[MEAN_VELOCITY], vectors[FORCE], vectors[RATE]
    elastic, load, count = vectors[ELASTIC], vectors[LOAD], w.shape[0]
    for j in range(count):
        total += step * load[j] * w[j]
        lost += step * w[j] * (elastic[j] - result[j])
    lost += mass_damping_loss(data.constants.mass_damping, mass, w, step)
    for j in range(moving, count):
        value = -result[j] - load[j]
        for k in range(count):
            value += mass[j, k] * rate[k]
        tool_work += step * value * w[j]
    return total, lost, tool_work


@kernel_njit(inline="always", fastmath={"contract"})
def _advance(data, a, v, lifting, s, step, moving):
    """Move the coordinates by a step; the prescribed ones are where their tools are."""
    w, first = data.newton.vectors[MEAN_VELOCITY], a.shape[0] - lifting.shape[1]
    for j in range(a.shape[0]):
        a[j] += step * w[j]
        v[j] = 2.0 * w[j] - v[j]
    for j in range(moving, a.shape[0]):
        c = lifting[:, j - first]
        a[j], v[j] = c[s + 2], (c[s + 3] - c[s + 1]) / (2.0 * step)


@cache
def implicit_step(law: MaterialPoint, single: bool) -> Any:
    """Compile the implicit step of sampled models of a law.

    ``implicit(a, v, lifting, holds, step, loads, data)`` advances coordinates and velocities (m + l,) in place.
    `lifting` (s + 3, l) has one time before the first step and one after the last, and `holds` (s,) is True while tools
    prescribe the lifting coordinates. `data` is an `ImplicitData`.
    """
    digest = law_digest(__name__, "implicit step", law.digest, single)
    solve, mean_force = newton_solver(law, single), mean_force_function(law, single)

    @law_njit(digest, nogil=True, fastmath={"contract"})
    def implicit(a, v, lifting, holds, step, loads, handle):
        """Advance by the number of loads; return the work [J] of loads, the dissipation, the work of tools, and steps.

        The number of steps is less than that of the loads if a step did not converge.
        """
        data, count, first = reference(handle), a.shape[0], a.shape[0] - lifting.shape[1]
        total, lost, tool_work = 0.0, 0.0, 0.0
        newton, vectors = data.newton, data.newton.vectors
        w, at = vectors[MEAN_VELOCITY], vectors[TRIAL]
        for s in range(loads.shape[0]):
            moving = first if holds[s] else count
            _begin_step(data, v, lifting, s, step, moving)
            if not solve(a, v, step, loads[s], data, moving):
                newton.counts[FAILURES] += 1
                newton.factored[FACTOR_STEP] = 0.0
                return total, lost, tool_work, s
            write_rates(data, v, step, moving)
            mean_loads(a, w, step, loads[s], data.springs, at, vectors[LOAD])
            mean_force(a, w, step, 0.0, data, at, vectors[UPDATE], vectors[ELASTIC])
            total, lost, tool_work = _add_works(data, step, moving, total, lost, tool_work)
            _advance(data, a, v, lifting, s, step, moving)
        return total, lost, tool_work, loads.shape[0]

    return implicit
