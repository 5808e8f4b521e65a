"""One compiled period of the real-time loop of a full body.

The body takes leapfrog steps of one length (`palpate.dynamics.nodal.leapfrog`) that need not divide the period: after a
period it is behind the clock by less than a step. Tools move evenly to their targets during a period. The force on one
is the mean over the steps of the period. The stable step follows from a power iteration on the present tangent
(`palpate.dynamics.nodal.step_control`); it is at most that at rest. A period in which a node moves too far, or after
which the body has more kinetic energy than the tool has done work, is repeated: with shorter steps, then with the tool
at rest, at last with a body that has lost its velocities. The functions allocate nothing and do not call Python.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.passes import Formulation
from palpate.compiled.reference import reference
from palpate.dynamics.contact.grip import COUNT, FRESH
from palpate.dynamics.material.relaxation import copy_field, copy_history, copy_values, reset_history
from palpate.dynamics.nodal.leapfrog import kinetic_energy, leapfrog
from palpate.dynamics.nodal.period_data import (
    BEHIND,
    ESTIMATE,
    FREQUENCY,
    GAINED,
    GIVEN,
    HELD,
    KINETIC_ENERGY,
    LOST,
    NEXT_BEHIND,
    RECENT_ENERGY,
    REPEATED,
    RESTED,
    STEP,
    UNTIL_ESTIMATE,
    WORK,
)
from palpate.dynamics.nodal.step_control import ESTIMATE_PERIODS, MAX_FREQUENCY_RATIO, set_step, step_control
from palpate.dynamics.nodal.tool_limits import choose_paths, stop_tool
from palpate.dynamics.nodal.tool_path import END, HOME, SAVED, START, set_path, write_place
from palpate.dynamics.run.period_report import FORCES, KINETIC, STATUS, STEPS, STRAIN, TRUST

MAX_ATTEMPTS, STIFFENING_FACTOR = 6, 1.6  # of a period, and factor of the frequency in the next attempt
MAX_ENERGY_ATTEMPTS = 2  # repetitions after which a gain of energy is accepted that is not of this period
HELD_ATTEMPT, STOPPED_ATTEMPT = 3, 5  # from which on the tool is held, and the body loses its velocities
MAX_GAIN, MIN_ENERGY = 0.05, 1e-9  # kinetic energy beyond the work, relative to all work; [J] that is rounding
UNREST_TIME = 0.1  # [s] in which the largest kinetic energy is forgotten


@kernel_njit(inline="always")
def _clear(values):
    for i in range(values.shape[0]):
        for c in range(3):
            values[i, c] = 0.0


@kernel_njit(inline="always")
def _clear_impulses(contacts):
    """Let the contact start from zero impulses."""
    contacts.work.patch_impulses[:], contacts.work.step_impulses[:] = 0.0, 0.0


@kernel_njit(inner=True)
def _save(data, u, velocity):
    """Copy the state at the start of a period."""
    tools, start = data.tools, data.start
    copy_field(u, start.fields[0])
    copy_field(velocity, start.fields[1])
    copy_field(data.scratch.previous, start.fields[2])
    copy_history(data.body.passes[1].history, start.history)
    for t in range(tools.path.shape[0]):
        copy_values(tools.contacts.work.frames[t, 1], tools.path[t, SAVED])
    start.works[0], start.works[1] = data.energies[WORK], data.energies[LOST]


@kernel_njit(inner=True)
def _restore(data, u, velocity):
    """Set the state to that at the start of the period."""
    tools, start = data.tools, data.start
    copy_field(start.fields[0], u)
    copy_field(start.fields[1], velocity)
    copy_field(start.fields[2], data.scratch.previous)
    copy_history(start.history, data.body.passes[1].history)
    for t in range(tools.path.shape[0]):
        copy_values(tools.path[t, SAVED], tools.contacts.work.frames[t, 1])
    _clear_impulses(tools.contacts)
    data.energies[WORK], data.energies[LOST] = start.works[0], start.works[1]


@kernel_njit(inline="always")
def _begin_at_rest(data):
    """Forget the motion before a start or a reset."""
    stepping, energies, counts, resting = data.stepping, data.energies, data.counts, data.body.resting_frequency
    reset_history(data.body.passes[1].history)
    energies[:], stepping[BEHIND] = 0.0, 0.0
    counts[REPEATED], counts[HELD] = 0.0, 0.0
    _clear(data.scratch.previous)
    stepping[FREQUENCY], stepping[ESTIMATE], stepping[UNTIL_ESTIMATE] = resting, resting, ESTIMATE_PERIODS
    data.tools.near_margin[0] = -1.0
    _clear_impulses(data.tools.contacts)


@kernel_njit(inline="always")
def _set_paths(tools, target, at_rest):
    """Set the paths of the tools to their targets (12 t,)."""
    for t in range(tools.path.shape[0]):
        path, holds = tools.path[t], tools.grip.numbers[t, COUNT] > 0
        set_path(path, target[12 * t : 12 * (t + 1)], at_rest and not holds)
        if at_rest:
            if holds:  # the nodes as they are at rest
                copy_values(path[HOME], path[START])
                tools.grip.numbers[t, FRESH] = 1
            copy_values(path[START], tools.contacts.work.frames[t, 1])


@kernel_njit(inline="always")
def _begin_again(data, attempt, u, velocity):
    """Return to the start of the period: with shorter steps, then with the tools held, at last without velocities."""
    stepping, tools = data.stepping, data.tools
    _restore(data, u, velocity)
    stepping[FREQUENCY] *= STIFFENING_FACTOR
    data.counts[REPEATED] += 1.0 if attempt == 1 else 0.0
    set_step(data)
    if attempt >= HELD_ATTEMPT:
        for t in range(tools.path.shape[0]):
            stop_tool(tools, t)
            tools.late[t] = 1
    if attempt >= STOPPED_ATTEMPT:
        data.energies[LOST] += kinetic_energy(data.body.nodes, velocity)
        _clear(velocity)


@kernel_njit(inline="always")
def _energy_left(energies):
    """Return the energy [J] that was given or worked since rest, and not dissipated."""
    return energies[GIVEN] + energies[WORK] - energies[LOST]


@kernel_njit(inline="always")
def _is_balanced(energies, attempt, excess_before):
    """Return True for a period without a gain of energy, or whose gain shorter steps do not cure; note the latter."""
    excess = energies[KINETIC_ENERGY] - _energy_left(energies)
    allowed = MAX_GAIN * max(abs(energies[WORK]), abs(energies[LOST]), abs(energies[GIVEN])) + MIN_ENERGY
    if excess <= allowed:
        return True
    # shorter steps make no difference, and the period has no gain: the sums of work have drifted
    drifted = excess - excess_before <= allowed
    if attempt >= MAX_ENERGY_ATTEMPTS and (drifted or attempt == MAX_ATTEMPTS - 1):
        energies[GIVEN] += excess
        energies[GAINED] += excess
        return True
    return False


@kernel_njit(inline="always")
def _write_places(data, target):
    """Write into the targets (12 t,) of late tools where they are."""
    tools, held = data.tools, False
    for t in range(tools.path.shape[0]):
        if tools.late[t] == 1:
            held = True
            write_place(tools.path[t], target[12 * t : 12 * (t + 1)])
    data.counts[HELD] += 1.0 if held else 0.0


@kernel_njit(inline="always")
def _write_tool_forces(tools, duration, report):
    """Write the mean forces of the tools over a time [s].

    The forces conjugate to the entries of R - I are G = S R with S the moment's cross product; see
    `palpate.reduction.contact.gauss_seidel.press`.
    """
    impulses = tools.contacts.work.tool_impulses
    for t in range(tools.path.shape[0]):
        first, turned = FORCES + 12 * t, tools.path[t, END]
        for i in range(3):
            k, m = (i + 1) % 3, (i + 2) % 3
            report[first + i] = impulses[t, i] / duration
            half = 0.5 * impulses[t, 3 + i] / duration
            for j in range(3):
                turn_k, turn_m = 0.0, 0.0  # of R = frame home'
                for c in range(3):
                    turn_k += turned[k, c] * tools.path[t, HOME, j, c]
                    turn_m += turned[m, c] * tools.path[t, HOME, j, c]
                report[first + 3 + 3 * m + j] += half * turn_k
                report[first + 3 + 3 * k + j] -= half * turn_m


@kernel_njit(inline="always")
def _list_pushes(data):
    """List the forces on patches and on nodes that forceps hold, of the last step."""
    contacts, grip, contact = data.tools.contacts, data.tools.grip, data.contact_work
    step, count = data.stepping[STEP], 0
    for a in range(contacts.work.active_count[0]):
        k = contacts.work.active[a]
        push = contacts.work.patch_impulses[k]
        if push[0] != 0.0 or push[1] != 0.0 or push[2] != 0.0:
            ends = contacts.patches.ends[contacts.candidates.patch[k]]
            for e in range(1 if ends[0] == ends[1] else 2):  # half of the push on an edge midpoint at each end
                share = 1.0 if ends[0] == ends[1] else 0.5
                contact.node[count], contact.tool[count] = ends[e], contacts.candidates.tool[k]
                for c in range(3):
                    contact.push[count, c] = share * push[c] / step
                count += 1
    for t in range(data.tools.path.shape[0]):
        for k in range(grip.numbers[t, COUNT]):
            contact.node[count], contact.tool[count] = grip.node[t, k], t
            for c in range(3):
                contact.push[count, c] = grip.impulse[t, k, c] / step
            count += 1
    contact.numbers[0] = count


@kernel_njit(inline="always")
def _report_forces(data, count, report):
    """Write the forces of the tools as means over the steps of the period, or those of the last one with a step."""
    force = data.tools.force
    for k in range(FORCES, report.shape[0]):
        report[k] = 0.0 if count > 0 else force[k - FORCES]
    if count > 0:
        _write_tool_forces(data.tools, count * data.stepping[STEP], report)
        _list_pushes(data)
        for k in range(FORCES, report.shape[0]):
            force[k - FORCES] = report[k]


@cache
def nodal_period(formulation: Formulation, touch: int) -> Any:
    """Compile the period of a full body, which a blade can cut if `touch` is WITH_BLADE, not RIGID_TOOLS.

    ``advance(data, q, v, target, period, report)`` advances displacements and velocities (3 n,) by about a period [s]
    while the tools move evenly to `target` (12 t,). A tool that is held or late does not reach it: then `target` gets
    where it is. The entries of the `report` (8 + 12 t,) are those of `palpate.dynamics.run.period_report`. The state is
    unchanged if the period fails.
    """
    digest = law_digest(__name__, formulation.digest, touch)
    choose_step, take_steps = step_control(formulation), leapfrog(formulation, touch)

    @law_njit(digest)
    def advance(handle, q, v, target, period, report):
        data = reference(handle)
        n, tools, stepping, energies = data.body.nodes.volumes.shape[0], data.tools, data.stepping, data.energies
        u, velocity = q.reshape((n, 3)), v.reshape((n, 3))
        for k in range(FORCES):
            report[k] = 0.0
        # the start of a run, or a reset; a body that is pressed over a support alone is at rest, too
        at_rest = data.counts[RESTED] == 0.0 and not q.any() and not v.any()
        if at_rest:
            _begin_at_rest(data)
        _set_paths(tools, target, at_rest)
        kinetic = kinetic_energy(data.body.nodes, velocity)
        energies[GIVEN] += kinetic - energies[KINETIC_ENERGY]  # of velocities that were set
        excess_before = kinetic - _energy_left(energies)
        choose_step(data, u)
        depth = choose_paths(data, u, period)
        _save(data, u, velocity)
        count, frequency_before = -1, stepping[FREQUENCY]
        for attempt in range(MAX_ATTEMPTS):
            if attempt > 0:
                _begin_again(data, attempt, u, velocity)
            tools.contacts.work.tool_impulses[:] = 0.0
            count = take_steps(data, u, velocity, period)
            if count >= 0 and _is_balanced(energies, attempt, excess_before):
                break
        if count < 0:
            _restore(data, u, velocity)
            stepping[FREQUENCY], energies[KINETIC_ENERGY] = frequency_before, kinetic
            report[STATUS] = 1.0
            return
        stepping[BEHIND] = stepping[NEXT_BEHIND]
        _write_places(data, target)
        _report_forces(data, count, report)
        if attempt >= MAX_ENERGY_ATTEMPTS:  # shorter steps did not help
            most = MAX_FREQUENCY_RATIO * data.body.resting_frequency
            stepping[FREQUENCY] = min(STIFFENING_FACTOR * frequency_before, most)
        data.counts[RESTED] = 0.0 if q.any() or v.any() else 1.0
        energies[RECENT_ENERGY] = max(energies[KINETIC_ENERGY], energies[RECENT_ENERGY] * np.exp(-period / UNREST_TIME))
        report[STEPS], report[TRUST], report[KINETIC] = count, depth, energies[KINETIC_ENERGY]
        report[STRAIN] = max(0.0, _energy_left(energies) - report[KINETIC])

    return advance
