"""The compiled explicit step of a sampled reduced model.

With the coordinates a of modes and lifting columns, the mass matrix m, the sampled force f and the loads g,

    m a'' = f(a + beta a') + g(t),

where the coordinates of lifting columns are known while their tool holds the body. The step is that of
`palpate.dynamics.nodal.central_difference`; an implicit one is in `palpate.reduction.hyper.implicit`.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.dynamics.compiled.cache import law_digest, law_njit
from palpate.dynamics.contact.geometry import rotation
from palpate.reduction.contact.gauss_seidel import settle
from palpate.reduction.hyper.foundation import draw_back
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.sampled_energy import sampled_energy

__all__ = ["explicit_step"]


@cache
def explicit_step(law: MaterialPoint, single: bool) -> Any:
    """Compile the explicit step of sampled models of a law.

    Parameters
    ----------
    law, single
        As for `palpate.reduction.hyper.sampled_energy.sampled_energy`.
    """
    digest = law_digest(__name__, "explicit step", law.digest, single)
    force, _ = sampled_energy(law, single)

    @law_njit(digest, fastmath={"contract"})
    def explicit(  # type: ignore[no-untyped-def]
        a,
        v,
        lifting,
        holds,
        step,
        beta,
        wave_speed,
        loads,
        mass,
        held_response,
        free_response,
        integration_points,
        scratch,
        springs,
        keep,
        poses,
        contact_surface,
        contact_state,
        tooling,
    ):
        """Advance by one step less than there are loads; return the works [J] of loads, viscosity and tools.

        Tools that touch the body (`palpate.reduction.contact.gauss_seidel`) have `poses` (s, t, 7) at the times of the loads; their
        work is among that of the loads, and what friction takes is among that of viscosity. The forces of springs are
        added to the loads.
        """
        count, first, steps = a.shape[0], a.shape[0] - lifting.shape[1], loads.shape[0] - 1
        total, lost, tools = 0.0, 0.0, 0.0
        at, result, previous, rate = keep.vectors[0], keep.vectors[1], keep.vectors[2], keep.vectors[3]
        for s in range(steps + 1):
            if holds[s]:
                for j in range(first, count):
                    a[j] = lifting[s + 1, j - first]
                    v[j] = (lifting[s + 1, j - first] - lifting[s, j - first]) / step
            for m in range(count):
                at[m] = a[m] + beta * v[m]
            for j in range(first, count):
                if holds[s] and abs(v[j]) > wave_speed[j - first]:  # a jump, as in the full model
                    at[j] = a[j] + beta * np.sign(v[j]) * wave_speed[j - first]
            scratch.history.interval[0] = step if s > 0 else 0.0
            force(at, integration_points, scratch, result)
            draw_back(springs, a, v, loads[s])
            for m in range(count):
                if s > 0:
                    lost += (at[m] - a[m]) * (previous[m] - result[m])
                previous[m] = result[m]
            kick = 0.5 * step if s in (0, steps) else step
            constrained_inverse_mass = holds[min(s + 1, steps)]
            moving = first if constrained_inverse_mass else count  # coordinates that obey the equations of motion
            for m in range(count):
                rate[m] = result[m] + loads[s, m]
                if constrained_inverse_mass:
                    for j in range(first, count):
                        bend = lifting[s + 2, j - first] - 2 * lifting[s + 1, j - first] + lifting[s, j - first]
                        rate[m] -= mass[m, j] * bend / step**2
            response = held_response if constrained_inverse_mass else free_response
            for m in range(moving):
                value = 0.0
                for k in range(moving):
                    value += response[m, k] * rate[k]
                before = v[m]
                v[m] = before + kick * value
                total += kick * loads[s, m] * 0.5 * (before + v[m])
                for j in range(moving, count):
                    rate[j] -= mass[j, m] * value
            if s < steps and tooling.kind.shape[0] > 0:
                for t in range(tooling.kind.shape[0]):
                    rotation(poses[s, t], tooling.frames[t, 0])
                    rotation(poses[s + 1, t], tooling.frames[t, 1])
                for m in range(count):
                    at[m] = a[m] + step * v[m] if m < moving else lifting[s + 2, m - first]
                works = settle(contact_surface, contact_state, tooling, at, v, step)
                total, lost = total + works[0], lost + works[1]
                for m in range(moving):
                    value = 0.0
                    for k in range(moving):
                        value += step * response[m, k] * tooling.load[k]
                    v[m] += value
                    total += 0.5 * kick * loads[s, m] * value  # the loads' work is that at the mean velocity
                for j in range(moving, count):
                    rate[j] += tooling.load[j]
            for j in range(moving, count):
                speed = (lifting[s + 2, j - first] - lifting[s, j - first]) / (2 * step)
                total += kick * loads[s, j] * speed
                if s < steps:  # the last time is the next call's first
                    tools -= step * rate[j] * speed
            if s < steps:
                for m in range(moving):
                    a[m] += step * v[m]
        scratch.history.interval[0] = 0.0
        return total, lost, tools

    return explicit
