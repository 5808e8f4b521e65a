"""The compiled explicit step of coordinates: damping, prescribed coordinates and kicks.

With the coordinates a of modes and of l lifting functions, which come last, the mass matrix m and the
generalised forces f and loads g,

    m (a'' + alpha a') = f(a + beta a') + g(t).

The coordinates of the lifting functions are prescribed until their tool releases the body. The step is that
of `palpate.dynamics.nodal.central_difference`. The Galerkin model, the hyper-reduced model and the engine
use these functions. Histories `lifting` (s + 2, l) of prescribed coordinates have one time before the
first step and one after the last.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit


@kernel_njit(inline="always", fastmath={"contract"})
def prescribe(a, v, lifting, s, step):
    """Set the prescribed coordinates of step s, and their mean velocities in the step before."""
    first = a.shape[0] - lifting.shape[1]
    for j in range(first, a.shape[0]):
        a[j] = lifting[s + 1, j - first]
        v[j] = (lifting[s + 1, j - first] - lifting[s, j - first]) / step


@kernel_njit(inline="always", fastmath={"contract"})
def trial_coordinates(a, v, beta, wave_speed, prescribed, at):
    """Write a + beta v, at which the forces are evaluated.

    Prescribed velocities are limited to `wave_speed` (l,) there. Those of a jump would grow as 1 / step.
    """
    first = a.shape[0] - wave_speed.shape[0]
    for m in range(a.shape[0]):
        at[m] = a[m] + beta * v[m]
    if prescribed:
        for j in range(first, a.shape[0]):
            if abs(v[j]) > wave_speed[j - first]:
                at[j] = a[j] + beta * np.sign(v[j]) * wave_speed[j - first]


@kernel_njit(inline="always", fastmath={"contract"})
def damping_work(at, a, force, previous):
    """Return the energy beta v . (previous - force) that damping dissipates in a step, and copy the force."""
    work = 0.0
    for m in range(a.shape[0]):
        work += (at[m] - a[m]) * (previous[m] - force[m])
        previous[m] = force[m]
    return work


@kernel_njit(inline="always", fastmath={"contract"})
def kick_coordinates(v, rate, loads, lifting, s, step, kick, prescribed, mass, response, alpha, mean):
    """Accelerate the coordinates that obey the equations of motion over a time `kick`; return the loads' work.

    `rate` (m + l,) are the generalised forces. Those of prescribed coordinates are what the tools leave to be
    done afterwards. `response` is the inverse of the moving coordinates' block of the mass matrix. The damping
    alpha m acts on the mean velocities of the kick, which are written to `mean` (m + l,).
    """
    count, first, work = v.shape[0], v.shape[0] - lifting.shape[1], 0.0
    if prescribed:
        for m in range(count):
            for j in range(first, count):
                bend = lifting[s + 2, j - first] - 2 * lifting[s + 1, j - first] + lifting[s, j - first]
                rate[m] -= mass[m, j] * bend / step**2
        for j in range(first, count):
            mean[j] = (lifting[s + 2, j - first] - lifting[s, j - first]) / (2 * step)
        if alpha > 0.0:
            for m in range(count):
                for j in range(first, count):
                    rate[m] -= alpha * mass[m, j] * mean[j]
    moving = first if prescribed else count
    for m in range(moving):
        value = 0.0
        for k in range(moving):
            value += response[m, k] * rate[k]
        before = v[m]
        v[m] = before + kick / (1.0 + 0.5 * alpha * kick) * (value - alpha * before)
        mean[m] = 0.5 * (before + v[m])
        work += kick * loads[m] * 0.5 * (before + v[m])
        for j in range(moving, count):
            rate[j] -= mass[j, m] * value
    return work


@kernel_njit(inline="always", fastmath={"contract"})
def mass_damping_loss(alpha, mass, mean, kick):
    """Return the energy [J] that the damping alpha m dissipates at the mean velocities of a time `kick`."""
    lost = 0.0
    if alpha > 0.0:
        for m in range(mean.shape[0]):
            for k in range(mean.shape[0]):
                lost += mean[m] * mass[m, k] * mean[k]
    return alpha * kick * lost


@kernel_njit(inline="always", fastmath={"contract"})
def prescribed_work(rate, loads, lifting, s, step, kick, scale):
    """Return the work of loads on prescribed coordinates over a time `kick`, and of their tools over a step.

    `scale` turns the entries of `rate` into generalised forces in the units of the loads.
    """
    first, work, tools = rate.shape[0] - lifting.shape[1], 0.0, 0.0
    for j in range(first, rate.shape[0]):
        speed = (lifting[s + 2, j - first] - lifting[s, j - first]) / (2 * step)
        work += kick * loads[j] * speed
        tools -= step * scale * rate[j] * speed
    return work, tools


@kernel_njit(inline="always", fastmath={"contract"})
def drift(a, v, moving, step):
    """Advance the first coordinates by a step."""
    for m in range(moving):
        a[m] += step * v[m]
