"""One compiled period of the real-time loop of a reduced model.

During a period the tool moves evenly to its target, so its coordinates have no acceleration. The
change of their rates at the start of the period requires an impulse. Forces on the tool are means over
the period. The functions allocate nothing and do not call Python. A period is: the rates of the tool, some steps
(`reduced_steps.py`), the balance of energy, a column of the tangent (`tangent_columns.py`), and the error indicator.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.reference import reference
from palpate.dynamics.material.relaxation import copy_field, copy_history, copy_values, reset_history
from palpate.dynamics.run.period_report import FORCES, KINETIC, STATUS, STEPS, STRAIN, TRUST
from palpate.realtime.bodies.error_indicator import error_indicator_function
from palpate.realtime.bodies.period_data import (
    ENERGY,
    SAVED_COORDINATES,
    SAVED_VELOCITIES,
    TOOL_RATES,
    VELOCITY_CHANGE,
)
from palpate.realtime.bodies.reduced_steps import MAX_SUBSTEPS, explicit_steps, implicit_steps
from palpate.realtime.bodies.tangent_columns import probe_function, static_stiffness, update_tangent
from palpate.reduction.contact.gauss_seidel import compliance_energy, set_tool_paths
from palpate.reduction.contact.penetration import hold_above_surface
from palpate.reduction.hyper.material_point import MaterialPoint

REFINEMENT_FACTOR, MAX_ATTEMPTS = 4, 4  # factor of the steps in a repeated period, and most attempts
MAX_GAIN = 0.5  # largest gain of energy in a period without contact, relative to energy and work
MIN_ENERGY = 1e-12  # [J] below which a gain is rounding


@kernel_njit()
def save_start(data):
    """Save history variables and contact at the start of a period."""
    contact, start = data.contact_work, data.start
    copy_history(data.body.scratch.history, start.history)
    for t in range(data.tools.kind.shape[0]):
        if data.tools.sizes[t, 0] != -np.inf:  # an absent tool has no forces
            copy_field(contact.force[t], start.force[t])
            copy_field(contact.place[t], start.place[t])
    copy_values(data.tools.frames, start.frames)


@kernel_njit()
def restore_start(data):
    """Restore what `save_start` has saved."""
    contact, start = data.contact_work, data.start
    copy_history(start.history, data.body.scratch.history)
    for t in range(data.tools.kind.shape[0]):
        if data.tools.sizes[t, 0] != -np.inf:
            copy_field(start.force[t], contact.force[t])
            copy_field(start.place[t], contact.place[t])
    copy_values(start.frames, data.tools.frames)
    contact.busy[:] = True


@kernel_njit(inline="always")
def _reset(data):
    """Forget the motion before a start or a reset."""
    reset_history(data.body.scratch.history)
    data.contact_work.force[:] = 0.0
    data.system.numbers[:] = 0
    data.tracking[ENERGY] = 0.0


@kernel_njit(inline="always")
def _store_state(data, q, v):
    """Copy the coordinates and velocities at the start of a period."""
    for m in range(q.shape[0]):
        data.vectors[SAVED_COORDINATES, m], data.vectors[SAVED_VELOCITIES, m] = q[m], v[m]


@kernel_njit(inline="always")
def _refuse(data, q, v, report):
    """Return to the state at the start of a period that fails."""
    for m in range(q.shape[0]):
        q[m], v[m] = data.vectors[SAVED_COORDINATES, m], data.vectors[SAVED_VELOCITIES, m]
    report[STATUS] = 1.0


@kernel_njit(inline="always", fastmath={"contract"})
def _energy_over_supports(tools):
    """Return the energy [J] of the tissue over supports under the tools."""
    total = 0.0
    for energy in tools.held.energy:
        total += energy
    return total


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _change_rates(data, q, v, target, period):
    """Write the rates of the tool in a period, and the change of all velocities that they cause at its start."""
    modes, count, mass, constrained_inverse = (
        data.modes,
        q.shape[0],
        data.body.constants.mass,
        data.body.constants.constrained_inverse_mass,
    )
    speeds, change = data.vectors[TOOL_RATES], data.vectors[VELOCITY_CHANGE]
    for j in range(modes, count):
        speeds[j] = (target[j - modes] - q[j]) / period
        change[j] = speeds[j] - v[j]
    for m in range(modes):
        value = 0.0
        for k in range(modes):
            for j in range(modes, count):
                value -= constrained_inverse[m, k] * mass[k, j] * change[j]
        change[m] = value


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _begin(data, q, v, period, report):
    """Set the state at the start of a period, and the impulses of the tool there."""
    count, vectors, mass = q.shape[0], data.vectors, data.body.constants.mass
    change = vectors[VELOCITY_CHANGE]
    for m in range(count):
        q[m], v[m] = vectors[SAVED_COORDINATES, m], vectors[SAVED_VELOCITIES, m] + change[m]
    report[:] = 0.0
    for j in range(data.modes, count):
        for k in range(count):
            report[FORCES + j - data.modes] += mass[j, k] * change[k] / period


@kernel_njit(inline="always", fastmath={"contract", "reassoc"})
def _end_tool_paths(data, q, v, target, period, report):
    """Set the tool to its target without rounding errors; return its work [J] in the period."""
    work, speeds = 0.0, data.vectors[TOOL_RATES]
    for j in range(data.modes, q.shape[0]):
        q[j] = target[j - data.modes]
        v[j] = speeds[j]
        work += period * speeds[j] * report[FORCES + j - data.modes]
    return work


@kernel_njit(inner=True)
def _is_finite(values):
    """Return whether all numbers are finite."""
    total = 0.0
    for value in values:
        total += 0.0 * value  # 0, or not a number
    return total == 0.0


@kernel_njit(inline="always", fastmath={"contract", "reassoc"})
def _kinetic_energy(mass, v):
    """Return the kinetic energy [J]."""
    kinetic = 0.0
    for m in range(v.shape[0]):
        momentum = 0.0
        for k in range(v.shape[0]):
            momentum += mass[m, k] * v[k]
        kinetic += 0.5 * v[m] * momentum
    return kinetic


@cache
def _finish_function(law: MaterialPoint, single: bool, may_gain: bool) -> Any:
    """Compile ``finish(data, q, v, target, period, report, flexible)``.

    It writes the energies at the end of a period, and `probe`; it returns whether state and energy balance are right.
    The energy may grow for implicit steps and with tools in contact.
    """
    probe = probe_function(law, single)

    @law_njit(
        law_digest(__name__, "finish", law.digest, single, may_gain), inner=True, fastmath={"contract", "reassoc"}
    )
    def finish(data, q, v, target, period, report, flexible):
        work = _end_tool_paths(data, q, v, target, period, report)
        if not (_is_finite(q) and _is_finite(v)):
            return False
        report[KINETIC] = _kinetic_energy(data.body.constants.mass, v)
        report[STRAIN] = probe(data, q) + flexible
        before, after = data.tracking[ENERGY], report[KINETIC] + report[STRAIN]
        if may_gain:
            return np.isfinite(after)
        return after - before - work <= MAX_GAIN * max(before, after, abs(work), MIN_ENERGY)  # False for NaN

    return finish


@cache
def _steps_function(law: MaterialPoint, single: bool, implicit: bool, touched: bool) -> Any:
    """Compile ``take_steps(data, q, v, target, period, report)``, the steps of a period."""
    digest = law_digest(__name__, "steps", law.digest, single, implicit, touched)
    step = implicit_steps(law, single) if implicit else explicit_steps(law, single, touched)
    finish, attempts = _finish_function(law, single, implicit or touched), 1 if implicit else MAX_ATTEMPTS

    @law_njit(digest, inline="always", fastmath={"contract"})
    def take_steps(data, q, v, target, period, report):
        """Take the steps of a period, again with shorter ones where the body has stiffened faster than its estimate.

        Returns the number of steps, 0 if the period fails, and the energy [J] of the surface compliance.
        """
        refinement, flexible = 1, 0.0
        for attempt in range(attempts):
            if attempt > 0:
                restore_start(data)
                refinement *= REFINEMENT_FACTOR
            _begin(data, q, v, period, report)
            taken = step(data, q, v, period, report, refinement)
            static = 0.0
            if touched:
                flexible = compliance_energy(data.contact_surface, data.contact_work)
                static = flexible + _energy_over_supports(data.tools)
            if taken > 0 and finish(data, q, v, target, period, report, static):
                return taken, flexible
            if taken == MAX_SUBSTEPS:
                break
        return 0, flexible

    return take_steps


@cache
def period_functions(law: MaterialPoint, single: bool, implicit: bool, touched: bool) -> tuple[Any, Any]:
    """Compile the period of a law, `advance` and `stiffness`, with implicit or explicit steps.

    The period of a body without tools in contact, not `touched`, does not contain contact.

    ``advance(data, q, v, target, period, report)`` advances coordinates and velocities (m,) by a period [s] while the
    tool's coordinates move evenly to `target` (l,). The `report` (8 + l,) has the entries of
    `palpate.dynamics.run.period_report`. The state is unchanged if the period fails. The forces in the report are means
    over the period. ``stiffness(data, q, out)`` writes the derivatives (l, l) of the static forces by the tool's
    coordinates, from the tangents of the last m periods.
    """
    digest = law_digest(__name__, "period", law.digest, single, implicit, touched)
    take_steps = _steps_function(law, single, implicit, touched)
    error_indicator = error_indicator_function(law, single, implicit, touched)

    @law_njit(digest, fastmath={"contract"})
    def advance(handle, q, v, target, period, report):
        data = reference(handle)  # functions for a caller that has a record are those of the engine
        _store_state(data, q, v)
        at_rest = not q.any() and not v.any()
        if at_rest:  # the start of a run, or a reset
            _reset(data)
        _change_rates(data, q, v, target, period)
        if touched:
            set_tool_paths(data.tools, data.home, target, at_rest)
            hold_above_surface(data.contact_surface, data.contact_work, data.tools, data.home, target)
        save_start(data)
        taken, flexible = take_steps(data, q, v, target, period, report)
        if taken == 0:
            _refuse(data, q, v, report)
            return
        data.tracking[ENERGY] = report[KINETIC] + report[STRAIN]
        update_tangent(data)
        report[TRUST] = error_indicator(data, q, v, period, report[KINETIC], flexible)
        report[STEPS] = taken

    return advance, static_stiffness
