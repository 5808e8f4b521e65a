"""The steps of a reduced model in a period of the engine, compiled: explicit ones, or energy-conserving implicit ones.

An explicit step is symplectic (semi-implicit) Euler with the forces at a + beta v. Then tools in contact change the
velocities by projected Gauss-Seidel (`palpate.reduction.contact.gauss_seidel`):

    v += dt m^-1 (f(a + beta v) - alpha m v),      v += dt m^-1 (forces of the tools),      a += dt v.

The tools of a prescribed group move evenly in a period, and have no acceleration. An implicit step is that of
`palpate.reduction.hyper.implicit` (average vector field method).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.dynamics.run.period_report import FORCES
from palpate.realtime.bodies.error_indicator import residual_force_function
from palpate.realtime.bodies.period_data import (
    FORCE,
    FREQUENCY,
    RATE,
    REST_FREQUENCY,
    TOOL_RATES,
    WORK,
    has_residual_fields,
)
from palpate.reduction.contact.gauss_seidel import press
from palpate.reduction.galerkin.central_difference import drift, kick_coordinates, trial_coordinates
from palpate.reduction.hyper.foundation import add_spring_forces
from palpate.reduction.hyper.implicit import implicit_step
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.newton import FORCE as NEWTON_FORCE
from palpate.reduction.hyper.newton import LOAD as NEWTON_LOAD
from palpate.reduction.hyper.newton import RATE as NEWTON_RATE
from palpate.reduction.hyper.sampled_energy import sampled_energy

STEP_SAFETY = 0.8  # explicit step over the stable one, whose frequency one power iteration a period estimates
MAX_SUBSTEPS = 1000  # explicit steps in a period


@kernel_njit(inline="always", fastmath={"contract", "reassoc"})
def _step_count(data, period, refinement):
    """Return the number of explicit steps in a period [s], shorter than stable ones by a factor."""
    springs = data.body.springs
    frequency = max(data.tracking[REST_FREQUENCY], data.tracking[FREQUENCY])
    frequency = np.sqrt(frequency**2 + springs.highest_squared)
    z = data.body.constants.stiffness_damping * frequency + springs.decay_rate / frequency
    stable = STEP_SAFETY * (np.sqrt(z * z + 4.0) - z) / frequency
    if refinement * period < MAX_SUBSTEPS * stable:  # False for NaN
        return refinement * int(np.ceil(period / stable))
    return MAX_SUBSTEPS


@kernel_njit(inline="always", fastmath={"contract", "reassoc"})
def _set_even_path(data, step):
    """Write the path of the tool about a step [s]: it moves evenly."""
    even, speeds = data.path.lifting[:3], data.vectors[TOOL_RATES]
    even[:] = 0.0
    for j in range(even.shape[1]):
        even[0, j], even[2, j] = -step * speeds[data.modes + j], step * speeds[data.modes + j]


@kernel_njit(inline="always", fastmath={"contract", "reassoc"})
def _kick(data, v, step):
    """Accelerate the coordinates; the forces become those that prescribed ones leave to their tool."""
    constants, path = data.body.constants, data.path
    kick_coordinates(
        v, data.vectors[FORCE], path.no_loads[0], path.lifting[:3], 0, step, step, True, constants.mass,
        constants.constrained_inverse_mass, constants.mass_damping, data.vectors[RATE],
    )  # fmt: skip


@cache
def explicit_steps(law: MaterialPoint, single: bool, touched: bool) -> Any:
    """Compile the explicit steps of a period, without contact for a body that is not `touched`.

    ``explicit(data, q, v, period, report, refinement)`` returns the number of steps, which are shorter than stable ones
    by a factor. It adds the mean forces of the tools to the report.
    """
    digest = law_digest(__name__, law.digest, single, touched)
    force, residual_forces = sampled_energy(law, single).force, residual_force_function(law, single)

    @law_njit(digest, inline="always", fastmath={"contract", "reassoc"})
    def write_forces(data, q, v, step):
        """Write f(a + beta v) and the forces of springs; history variables advance by the last step [s]."""
        at, result, interval = data.vectors[WORK], data.vectors[FORCE], data.body.scratch.history.interval
        trial_coordinates(q, v, data.body.constants.stiffness_damping, v[data.modes :], False, at)
        interval[0] = interval[1]
        force(at, data.body.constants.cubature_points, data.body.scratch, result)
        add_spring_forces(data.body.springs, q, v, result)
        interval[0], interval[1] = 0.0, step

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def explicit(data, q, v, period, report, refinement):
        modes, count, speeds, at = data.modes, q.shape[0], data.vectors[TOOL_RATES], data.vectors[WORK]
        steps = _step_count(data, period, refinement)
        step = period / steps
        data.substep[0] = step
        _set_even_path(data, step)
        for s in range(steps):
            write_forces(data, q, v, step)
            if s == steps - 1 and has_residual_fields(data):
                residual_forces(data, at, q, v)
            _kick(data, v, step)
            for j in range(modes, count):
                report[FORCES + j - modes] -= data.vectors[FORCE, j] / steps
            if touched:
                press(data, q, v, at, step, period, (s + 1.0) / steps, report[FORCES:])
            drift(q, v, modes, step)
            for j in range(modes, count):
                q[j] += step * speeds[j]
        return steps

    return explicit


@cache
def implicit_steps(law: MaterialPoint, single: bool) -> Any:
    """Compile the implicit steps of a period.

    ``implicit(data, q, v, period, report, refinement)`` returns the number of steps, or -1 if one did not converge. It
    adds the mean forces of the tools to the report. The refinement has no effect.
    """
    average = implicit_step(law, single)

    @law_njit(law_digest(__name__, law.digest, single, "implicit"), inner=True, fastmath={"contract"})
    def implicit(data, q, v, period, report, refinement):
        most = data.path.no_loads.shape[0]  # of the longest period; in a longer one they are longer
        steps, count = min(max(1, int(np.round(period / data.step))), most), q.shape[0]
        step, lifting, holds, loads = period / steps, data.path.lifting, data.path.holds, data.path.no_loads
        for j in range(data.modes, count):
            for s in range(steps + 3):
                lifting[s, j - data.modes] = q[j] + (s - 1) * step * v[j]
        vectors = data.body.newton.vectors
        result, rate, load = vectors[NEWTON_FORCE], vectors[NEWTON_RATE], vectors[NEWTON_LOAD]
        for s in range(steps):
            _, _, _, taken = average(q, v, lifting[s : s + 4], holds[s : s + 1], step, loads[s : s + 1], data.body)
            if taken < 1:
                return -1
            for j in range(data.modes, count):
                value = -result[j] - load[j]
                for m in range(count):
                    value += data.body.constants.mass[j, m] * rate[m]
                report[FORCES + j - data.modes] += value / steps
        return steps

    return implicit
