"""One compiled period of the real-time loop of a full body.

The body takes steps of one length that need not divide the period: after a period it is behind the clock by less
than a step. Displacements belong to the ends of steps and velocities to their middles (leapfrog), so that a step
costs one evaluation of the force:

    v_{n+1/2} = v_{n-1/2} + dt a(u_n + beta v_{n-1/2}),      u_{n+1} = u_n + dt v_{n+1/2}.

The tool moves evenly to its target during a period. The force on it is the mean over the steps of the period. The
stable step follows from a power iteration on the present tangent, one iteration every `ESTIMATE_PERIODS`; it is at
most that at rest. A period in which a node moves too far, or after which the body has more kinetic energy than the
tool has done work, is repeated with shorter steps. The functions allocate nothing and do not call Python.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from palpate.arrays import Floats, Ints
from palpate.dynamics.compiled.cache import kernel_njit, law_digest, law_njit
from palpate.dynamics.compiled.passes import Formulation, internal_force
from palpate.dynamics.contact.geometry import Contacts
from palpate.dynamics.contact.impulses import push_patches
from palpate.dynamics.loads.prepared import LoadSites
from palpate.dynamics.material.relaxation import HistoryCopy, copy_history, copy_values, reset_history
from palpate.dynamics.nodal.central_difference import (
    Damping,
    NodalData,
    StepScratch,
    damping_work,
    drift_nodes,
    foundation_force,
    kick_nodes,
)
from palpate.dynamics.run.period_report import FORCES, KINETIC, STATUS, STEPS, STRAIN

__all__ = ["ContactReport", "NodalPeriodData", "nodal_period"]

ESTIMATE_PERIODS = 16  # between two iterations for the highest frequency
FREQUENCY_MARGIN = 1.05  # of the estimate, because an iteration converges from below
SLOWEST_DECREASE = 0.9  # of the frequency from one estimate to the next
STEP_SAFETY = 0.85  # step over the stable one
NOISE = 0.005  # added to the vector of the iteration, so that another mode can grow
MAX_STEPS = 400  # in a period; beyond it the body's time runs slower
MAX_ATTEMPTS, STIFFENING = 6, 1.6  # of a period, and factor of the frequency in the next attempt
TRIALS_OF_ENERGY = 2  # repetitions after which a gain of energy is accepted
MAX_GAIN, LEAST_ENERGY = 0.05, 1e-9  # kinetic energy beyond the work, relative to all work; [J] that is rounding

# entries of `NodalPeriodData.clock`
BEHIND, STEP, FREQUENCY, UNTIL_ESTIMATE, WORK, LOST, KINETIC_ENERGY, GIVEN, NEXT_BEHIND = range(9)
# frames in `NodalPeriodData.path`
START, END, HOME = range(3)


class ContactReport(NamedTuple):
    """Forces on the patches in contact, as means over the last period.

    Parameters
    ----------
    node : (n,) array
        Nodes of the patches.
    push : (n, 3) array [N]
    numbers : (3,) array
        The first is the number of patches in contact.
    """

    node: Ints
    push: Floats
    numbers: Ints


class NodalPeriodData(NamedTuple):
    """Constants and state of the compiled period of a full body.

    Parameters
    ----------
    passes, taut_passes : tuples
        Body and work arrays of the formulation; with fibres that carry compression for the frequency.
    nodes : NodalData
    damping : Damping
    sites : LoadSites
        Of supports and foundations.
    contacts : Contacts
        With one tool.
    scratch : StepScratch
    clock : (9,) array
        Time [s] by which the body is behind, step [s], highest frequency [rad/s], periods until its next
        estimate, work and dissipation since rest, kinetic energy, energy of a state that was given [J], and the
        time by which the body will be behind.
    tool_force : (12,) array
        Forces on the tool's coordinates in the last period with a step.
    path : (3, 3, 4) array
        Frames of the tool at the start and the end of a period, and at zero displacement.
    resting_frequency : float [rad/s]
        Highest frequency at rest, with foundations.
    vector, noise : (n, 3) arrays
        Of the power iteration.
    amplitude : float [m]
        Displacement of its difference quotient.
    reach : float [m]
        Largest way of a node in a step.
    saved : (2, n, 3) array
        Displacements and velocities at the start of the period.
    saved_history : HistoryCopy
        History variables at the start of the period.
    contact_work : ContactReport
    free : (0,) bool array
        No node has a prescribed motion.
    """

    passes: Any
    taut_passes: Any
    nodes: NodalData
    damping: Damping
    sites: LoadSites
    contacts: Contacts
    scratch: StepScratch
    clock: Floats
    tool_force: Floats
    path: Floats
    resting_frequency: float
    vector: Floats
    noise: Floats
    amplitude: float
    reach: float
    saved: Floats
    saved_history: HistoryCopy
    contact_work: ContactReport
    free: Any


@kernel_njit()
def set_path(path, target, at_rest):  # type: ignore[no-untyped-def]
    """Set the frames of the tool for a period that ends at a target (12,): displacement and R - I, from home."""
    copy_values(path[END], path[START])
    for i in range(3):
        for j in range(3):
            value = 0.0
            for k in range(3):
                value += (target[3 + 3 * i + k] + (1.0 if i == k else 0.0)) * path[HOME, k, j]
            path[END, i, j] = value
        path[END, i, 3] = path[HOME, i, 3] + target[i]
    if at_rest:
        copy_values(path[END], path[START])


@kernel_njit(inner=True)
def _place_tool(path, share, frames):  # type: ignore[no-untyped-def]
    """Move the frame of the tool to a share of its path; the last one becomes that before the step."""
    for i in range(3):
        for j in range(4):
            frames[0, i, j] = frames[1, i, j]
            frames[1, i, j] = path[START, i, j] + share * (path[END, i, j] - path[START, i, j])


@kernel_njit(inner=True)
def _report_contact(data, duration, report):  # type: ignore[no-untyped-def]
    """Write the mean force of the tool over a time [s] and those on the patches.

    The forces conjugate to the entries of R - I are G = S R with S the moment's cross product; see
    `palpate.reduction.contact.gauss_seidel.press`.
    """
    contacts, contact, turned = data.contacts, data.contact_work, data.path[END]
    for i in range(3):
        k, m = (i + 1) % 3, (i + 2) % 3
        report[FORCES + i] = contacts.tool_impulses[0, i] / duration
        half = 0.5 * contacts.tool_impulses[0, 3 + i] / duration
        for j in range(3):
            turn_k, turn_m = 0.0, 0.0  # of R = frame home'
            for c in range(3):
                turn_k += turned[k, c] * data.path[HOME, j, c]
                turn_m += turned[m, c] * data.path[HOME, j, c]
            report[FORCES + 3 + 3 * m + j] += half * turn_k
            report[FORCES + 3 + 3 * k + j] -= half * turn_m
    count = 0
    for e in range(contacts.active_count[0]):
        k = contacts.active[e]
        push = contacts.patch_impulses[k]
        if push[0] != 0.0 or push[1] != 0.0 or push[2] != 0.0:
            contact.node[count] = contacts.nodes[k]
            for c in range(3):
                contact.push[count, c] = push[c] / data.clock[STEP]
            count += 1
    contact.numbers[0] = count


@kernel_njit(inner=True)
def kinetic_energy(nodes, velocity):  # type: ignore[no-untyped-def]
    """Return the kinetic energy [J] of nodes with velocities (n, 3)."""
    total = 0.0
    for i in range(velocity.shape[0]):
        square = velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2
        total += 0.5 * nodes.density * nodes.volumes[i] * square
    return total


@cache
def nodal_period(formulation: Formulation) -> Any:
    """Compile the period of a full body.

    Returns
    -------
    function
        ``advance(data, q, v, target, period, report)`` advances displacements and velocities (3 n,) by about a
        period [s] while the tool moves evenly to `target` (12,). The entries of the `report` (20,) are those of
        `palpate.dynamics.run.period_report`. The state is unchanged if the period fails.
    """
    digest = law_digest(__name__, formulation.digest)
    force_of, after = internal_force(formulation), formulation.after

    @law_njit(digest, inner=True)
    def estimate(data, u):  # type: ignore[no-untyped-def]
        """Do one power iteration for the highest frequency."""
        vector, noise, scratch, sites = data.vector, data.noise, data.scratch, data.sites
        largest = 0.0
        for i in range(u.shape[0]):
            for c in range(3):
                largest = max(largest, abs(vector[i, c]))
        if not 0.0 < largest < np.inf:
            copy_values(noise, vector)
            largest = 1.0
        moved, largest_moved = scratch.surface, 0.0
        for i in range(u.shape[0]):
            for c in range(3):
                free = sites.kind[i] == 0
                moved[i, c] = vector[i, c] / largest + NOISE * noise[i, c] if free else 0.0
                largest_moved = max(largest_moved, abs(moved[i, c]))
        size = 0.0
        for i in range(u.shape[0]):
            for c in range(3):
                moved[i, c] *= data.amplitude / largest_moved
                size += moved[i, c] ** 2
                scratch.damped[i, c] = u[i, c] + moved[i, c]
        body, work = data.taut_passes
        after(work, 0.0)
        force_of(scratch.damped, body, work, moved)
        force_of(u, body, work, scratch.force)
        grown = 0.0
        for i in range(u.shape[0]):
            for c in range(3):
                image = (scratch.force[i, c] - moved[i, c]) / data.nodes.density
                vector[i, c] = image if sites.kind[i] == 0 else 0.0
                grown += vector[i, c] ** 2
        return np.sqrt(np.sqrt(grown / size))

    @law_njit(digest, inner=True)
    def set_step(data):  # type: ignore[no-untyped-def]
        clock = data.clock
        z = data.damping.beta * clock[FREQUENCY]
        clock[STEP] = STEP_SAFETY * (np.sqrt(z * z + 4.0) - z) / clock[FREQUENCY]

    @law_njit(digest, inner=True)
    def choose_step(data, u):  # type: ignore[no-untyped-def]
        """Update the stable step."""
        clock = data.clock
        clock[UNTIL_ESTIMATE] -= 1.0
        if clock[UNTIL_ESTIMATE] <= 0.0:
            clock[UNTIL_ESTIMATE] = ESTIMATE_PERIODS
            frequency = estimate(data, u)
            if frequency > 0.0 and frequency < np.inf:
                # an iteration that has not converged must not lengthen the step at once
                clock[FREQUENCY] = max(
                    FREQUENCY_MARGIN * frequency, SLOWEST_DECREASE * clock[FREQUENCY], data.resting_frequency
                )
        set_step(data)

    @law_njit(digest, inner=True)
    def take_steps(data, u, velocity, period):  # type: ignore[no-untyped-def]
        """Take the steps of a period; return their number, or -1 if a node moves too far in one."""
        clock, scratch, sites, contacts, path = data.clock, data.scratch, data.sites, data.contacts, data.path
        body, work = data.passes
        step, behind = clock[STEP], clock[BEHIND]
        count = int((behind + period) / step * (1.0 + 1e-12))
        if count > MAX_STEPS:
            count = MAX_STEPS
            behind = count * step - period
        for s in range(count):
            share = min(1.0, ((s + 1) * step - behind) / period)
            _place_tool(path, share, contacts.frames[0])
            for i in range(u.shape[0]):
                for c in range(3):
                    scratch.damped[i, c] = u[i, c] + data.damping.beta * velocity[i, c]
                    scratch.surface[i, c] = 0.0
            after(work, step)
            force_of(scratch.damped, body, work, scratch.force)
            clock[LOST] += damping_work(data.nodes.volumes, u, scratch)
            foundation_force(sites, u, velocity, data.nodes.volumes, scratch.surface)
            works = kick_nodes(
                sites, data.free, data.nodes, scratch, (0.0, 0.0, 0.0), step, velocity, data.damping.alpha
            )
            clock[WORK] += works[0]
            clock[LOST] += works[1]
            works = push_patches(
                contacts, False, (step, step, step, 0.0), 1.0, u, velocity, (data.nodes, scratch, (0.0, 0.0, 0.0))
            )
            clock[WORK] += works[0]
            clock[LOST] += works[1]
            for i in range(u.shape[0]):
                square = velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2
                if not square * step * step < data.reach * data.reach:  # also if it is not a number
                    return -1
            drift_nodes(sites, data.free, u, step, u, velocity)
        clock[NEXT_BEHIND] = behind + period - count * step
        return count

    @law_njit(digest)
    def advance(data, q, v, target, period, report):  # type: ignore[no-untyped-def]
        n, clock, contacts = data.nodes.volumes.shape[0], data.clock, data.contacts
        u, velocity = q.reshape((n, 3)), v.reshape((n, 3))
        history = data.passes[1].history
        for k in range(FORCES):
            report[k] = 0.0
        at_rest = not q.any() and not v.any()
        if at_rest:  # the start of a run, or a reset
            reset_history(history)
            clock[BEHIND], clock[WORK], clock[LOST], clock[KINETIC_ENERGY], clock[GIVEN] = 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(n):
                for c in range(3):
                    data.scratch.previous[i, c] = 0.0
            clock[FREQUENCY], clock[UNTIL_ESTIMATE] = data.resting_frequency, ESTIMATE_PERIODS
            contacts.patch_impulses[:] = 0.0
        set_path(data.path, target, at_rest)
        if at_rest:
            copy_values(data.path[END], contacts.frames[0, 1])
        clock[GIVEN] += kinetic_energy(data.nodes, velocity) - clock[KINETIC_ENERGY]  # of velocities that were set
        choose_step(data, u)
        if at_rest:  # whose clock starts in every period: longer steps would never begin
            clock[STEP] = min(clock[STEP], period)
        copy_values(u, data.saved[0])
        copy_values(velocity, data.saved[1])
        copy_history(history, data.saved_history)
        count, work_before, lost_before = -1, clock[WORK], clock[LOST]
        for attempt in range(MAX_ATTEMPTS):
            if attempt > 0:
                copy_values(data.saved[0], u)
                copy_values(data.saved[1], velocity)
                copy_history(data.saved_history, history)
                copy_values(data.path[START], contacts.frames[0, 1])
                contacts.patch_impulses[:] = 0.0
                clock[WORK], clock[LOST] = work_before, lost_before
                clock[FREQUENCY] *= STIFFENING
                set_step(data)
            contacts.tool_impulses[:] = 0.0
            count = take_steps(data, u, velocity, period)
            if count < 0:
                continue
            clock[KINETIC_ENERGY] = kinetic_energy(data.nodes, velocity)
            excess = clock[KINETIC_ENERGY] - (clock[GIVEN] + clock[WORK] - clock[LOST])
            if excess <= MAX_GAIN * abs(clock[WORK]) + LEAST_ENERGY:
                break
            if attempt == TRIALS_OF_ENERGY:  # shorter steps make no difference: the sums of work have drifted
                clock[GIVEN] += excess
                break
        if count < 0:
            copy_values(data.saved[0], u)
            copy_values(data.saved[1], velocity)
            report[STATUS] = 1.0
            return
        clock[BEHIND] = clock[NEXT_BEHIND]
        if count > 0:
            for k in range(FORCES, report.shape[0]):
                report[k] = 0.0
            _report_contact(data, count * clock[STEP], report)
            for k in range(FORCES, report.shape[0]):
                data.tool_force[k - FORCES] = report[k]
        for k in range(FORCES, report.shape[0]):
            report[k] = data.tool_force[k - FORCES]
        report[STEPS] = count
        report[KINETIC] = clock[KINETIC_ENERGY]
        report[STRAIN] = max(0.0, clock[GIVEN] + clock[WORK] - clock[LOST] - report[KINETIC])

    return advance
