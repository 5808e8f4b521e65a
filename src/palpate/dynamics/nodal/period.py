"""One compiled period of the real-time loop of a full body.

The body takes steps of one length that need not divide the period: after a period it is behind the clock by less
than a step. Displacements belong to the ends of steps and velocities to their middles (leapfrog), so that a step
costs one evaluation of the force:

    v_{n+1/2} = v_{n-1/2} + dt a(u_n + beta v_{n-1/2}),      u_{n+1} = u_n + dt v_{n+1/2}.

Tools move evenly to their targets during a period. The force on one is the mean over the steps of the period. The
stable step follows from a power iteration on the present tangent, one iteration every `ESTIMATE_PERIODS`; it is at
most that at rest. A period in which a node moves too far, or after which the body has more kinetic energy than the
tool has done work, is repeated: with shorter steps, then with the tool at rest, at last with a body that has lost its
velocities. A tool moves by at most a share of the spacing in a step. It is held where it would crush tissue that is
stiff already, and where it would pass between the nodes of the surface. Then it follows its target later. The
functions allocate nothing and do not call Python.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import prange

from palpate.arrays import Floats, Ints
from palpate.dynamics.compiled.cache import kernel_njit, law_digest, law_njit
from palpate.dynamics.compiled.passes import Formulation, internal_force
from palpate.dynamics.compiled.reference import reference
from palpate.dynamics.contact.geometry import Contacts, project
from palpate.dynamics.contact.grip import (
    COUNT,
    FRESH,
    Grip,
    bear_impulses,
    begin_grip,
    hold_nodes,
    store_velocities,
)
from palpate.dynamics.contact.impulses import list_near, push_patches
from palpate.dynamics.contact.penetration import SLOW_DEPTH, deepest_triangle, way_above_surface
from palpate.dynamics.loads.prepared import LoadSites
from palpate.dynamics.loads.supports import FIXED
from palpate.dynamics.material.relaxation import HistoryCopy, copy_field, copy_history, copy_values, reset_history
from palpate.dynamics.nodal.central_difference import (
    Damping,
    NodalData,
    StepScratch,
    foundation_force,
    kick_node,
)
from palpate.dynamics.nodal.mass_tailoring import MassTailoring, subtract_inertia
from palpate.dynamics.nodal.tool_path import (
    END,
    HOME,
    LISTED_AT,
    SAVED,
    START,
    frame_way,
    limit_path,
    limit_to_cut,
    place_tools,
    set_path,
    write_place,
)
from palpate.dynamics.run.period_report import FORCES, KINETIC, STATUS, STEPS, STRAIN, TRUST

ESTIMATE_PERIODS = 16  # between two iterations for the highest frequency
FREQUENCY_MARGIN = 1.05  # of the estimate, because an iteration converges from below
SLOWEST_DECREASE = 0.9  # of the frequency from one estimate to the next
STEP_SAFETY = 0.85  # step over the stable one
ITERATION_NOISE = 0.005  # added to the vector of the iteration, so that another mode can grow
MAX_STEPS = 400  # in a period; beyond it the body's time runs slower
MAX_ATTEMPTS, STIFFENING_FACTOR = 6, 1.6  # of a period, and factor of the frequency in the next attempt
MAX_ENERGY_ATTEMPTS = 2  # repetitions after which a gain of energy is accepted that is not of this period
HELD_ATTEMPT, STOPPED_ATTEMPT = 3, 5  # from which on the tool is held, and the body loses its velocities
MAX_MOVING_RATIO = 6.0  # largest frequency over that at rest at which the tool moves on
STIFF_RATIO, STIFF_ESTIMATE = 1.5, 4  # frequency over that at rest from which on it is estimated after fewer periods
MAX_FREQUENCY_RATIO = 100.0  # of the estimate over the frequency at rest
MAX_GAIN, LEAST_ENERGY = 0.05, 1e-9  # kinetic energy beyond the work, relative to all work; [J] that is rounding
BLOCK_NODES = 256  # nodes of a sum

# entries of `NodalPeriodData.clock`
BEHIND, STEP, FREQUENCY, UNTIL_ESTIMATE, WORK, LOST, KINETIC_ENERGY, GIVEN, NEXT_BEHIND = range(9)
REPEATED, GAINED, HELD, ESTIMATE, RESTED, NEAR_MARGIN, BASE_FREQUENCY = range(9, 16)
NO_BLADE = -1


class ContactReport(NamedTuple):
    """Forces on the patches in contact, as means over the last period."""

    node: Ints  # (k,) array: nodes of the patches; one can be there several times
    tool: Ints  # (k,) array: tools that touch them
    push: Floats  # (k, 3) array [N]
    numbers: Ints  # (3,) array: the first is the number of patches in contact


class NodalPeriodData(NamedTuple):
    """Constants and state of the compiled period of a full body.

    Parameters
    ----------
    passes, taut_passes : tuples
        Body and work arrays of the steps; with fibres that carry compression, for the frequency.
    sites : LoadSites
        Of supports and foundations.
    contacts : Contacts
        With t tools.
    grip : Grip
        Nodes that forceps hold.
    clock : (16,) array
        Time [s] by which the body is behind, step [s], highest frequency [rad/s], periods until its next
        estimate, work and dissipation since rest, kinetic energy, energy of a state that was given [J], the
        time by which the body will be behind, number of periods that were repeated with shorter steps, gains
        of energy that shorter steps did not cure [J], number of periods in which the tool was held, the last
        estimate of the frequency [rad/s], 1 if the last period left the body at rest, the margin [m] of the
        list of candidates near the tools, negative without a list, and the highest frequency at rest that the
        present one is based on [rad/s].
    clear_way : (t,) array [m]
        Distance that nodes and a tool may move before the surface can be so deep in the tool that it is slowed.
    late : (t,) array
        1 for tools that do not reach their target in the present period.
    sums : (b, 5) array
        Sums of every block of nodes.
    secant : (3 t + 3, 3 t) array
        Contact stiffness [N/m], positions and forces of the tools at its last update, and scratch.
    tool_force : (12 t,) array
        Forces on the tools' coordinates in the last period with a step.
    path : (t, 6, 3, 4) array
        Frames of each tool at the start and the end of a period, at zero displacement, before the first
        step, where it cut the body last, and where the candidates near it were listed last.
    resting_frequency : float [rad/s]
        Highest frequency at rest, with the tailored mass and foundations.
    vector, noise : (n, 3) arrays
        Of the power iteration.
    amplitude : float [m]
        Displacement of its difference quotient.
    reach, tool_reach, blade_reach, cut_reach : float [m]
        Largest displacements of a node, of a tool and of a blade in a step, and of the blade since its last cut.
    blade : int
        Number of the tool that is a blade, or NO_BLADE.
    triangles : (t, 3) array
        Of the surface.
    surface_depth : float [m]
        Depth of the surface in a tool beyond which the tool is held.
    listed : (n, 3) array [m]
        Displacements for which the candidates near the tools were listed last.
    saved : (3, n, 3) array
        Displacements, velocities and the last internal forces at the start of the period.
    saved_work : (2,) array [J]
        Work and dissipation at the start of the period.
    saved_history : HistoryCopy
        History variables at the start of the period.
    """

    passes: Any
    taut_passes: Any
    nodes: NodalData
    damping: Damping
    sites: LoadSites
    contacts: Contacts
    grip: Grip
    scratch: StepScratch
    clock: Floats
    clear_way: Floats
    late: Ints
    sums: Floats
    secant: Floats
    tool_force: Floats
    path: Floats
    tailoring: MassTailoring
    resting_frequency: float
    vector: Floats
    noise: Floats
    amplitude: float
    reach: float
    tool_reach: float
    blade_reach: float
    cut_reach: float
    blade: int
    triangles: Ints
    surface_depth: float
    listed: Floats
    saved: Floats
    saved_work: Floats
    saved_history: HistoryCopy
    contact_work: ContactReport


@kernel_njit(inner=True)
def is_absent(contacts, t):  # type: ignore[no-untyped-def]
    """Return True for a tool that no point can be in: a place without a tool, or forceps, which hold nodes."""
    return contacts.sizes[t, 0] == -np.inf


@kernel_njit(inner=True)
def _pushes(data, t):  # type: ignore[no-untyped-def]
    """Return True if a tool moves along its last force on the body."""
    work = 0.0
    for i in range(3):
        work += data.tool_force[12 * t + i] * (data.path[t, END, i, 3] - data.path[t, START, i, 3])
    return work > 0.0


@kernel_njit(inner=True)
def _crushes(data, t):  # type: ignore[no-untyped-def]
    """Return True if a tool would move on into tissue that is stiff already."""
    if data.clock[ESTIMATE] < MAX_MOVING_RATIO * data.resting_frequency:
        return False
    return _pushes(data, t)


@kernel_njit(inner=True)
def _hold_above_surface(data, t, u):  # type: ignore[no-untyped-def]
    """Hold a tool that pushes on where the surface is so deep in it that it would pass between nodes; slow it before.

    Returns
    -------
    late : bool
        True if the tool's way is shorter.
    depth : float
        Depth of the surface over that where the tool is held; 0 where it is far less.
    """
    contacts, limit = data.contacts, data.surface_depth
    if contacts.active_count[0] == 0 or data.clear_way[t] > 0.0 or is_absent(contacts, t):
        return False, 0.0
    least = SLOW_DEPTH * limit
    depth = deepest_triangle(contacts, t, data.path[t, START], data.triangles, u, 0.0)[0]
    data.clear_way[t] = (least - depth) / contacts.patch_gain
    if depth <= least:
        return False, 0.0
    return _pushes(data, t) and limit_path(data.path[t], way_above_surface(depth, limit)), depth / limit


@kernel_njit(inner=True)
def _choose_paths(data, u, period):  # type: ignore[no-untyped-def]
    """Mark the tools that are late, and shorten their paths; return the largest depth of `_hold_above_surface`."""
    deepest = 0.0
    for t in range(data.path.shape[0]):
        reach = data.blade_reach if t == data.blade else data.tool_reach
        late = limit_path(data.path[t], reach * max(1.0, period / data.clock[STEP]))
        if t == data.blade:
            late = limit_to_cut(data.path[t], data.cut_reach) or late
        if _crushes(data, t):
            copy_values(data.path[t, START], data.path[t, END])
            late = True
        held, depth = _hold_above_surface(data, t, u)
        data.late[t] = 1 if held or late else 0
        deepest = max(deepest, depth)
    return deepest


@kernel_njit(inner=True)
def _report_contact(data, duration, report):  # type: ignore[no-untyped-def]
    """Write the mean forces of the tools over a time [s] and those on the patches.

    The forces conjugate to the entries of R - I are G = S R with S the moment's cross product; see
    `palpate.reduction.contact.gauss_seidel.press`.
    """
    contacts, contact = data.contacts, data.contact_work
    for t in range(data.path.shape[0]):
        first, turned = FORCES + 12 * t, data.path[t, END]
        for i in range(3):
            k, m = (i + 1) % 3, (i + 2) % 3
            report[first + i] = contacts.tool_impulses[t, i] / duration
            half = 0.5 * contacts.tool_impulses[t, 3 + i] / duration
            for j in range(3):
                turn_k, turn_m = 0.0, 0.0  # of R = frame home'
                for c in range(3):
                    turn_k += turned[k, c] * data.path[t, HOME, j, c]
                    turn_m += turned[m, c] * data.path[t, HOME, j, c]
                report[first + 3 + 3 * m + j] += half * turn_k
                report[first + 3 + 3 * k + j] -= half * turn_m
    count = 0
    for a in range(contacts.active_count[0]):
        k = contacts.active[a]
        push = contacts.patch_impulses[k]
        if push[0] != 0.0 or push[1] != 0.0 or push[2] != 0.0:
            ends = contacts.ends[contacts.nodes[k]]
            for e in range(1 if ends[0] == ends[1] else 2):  # half of the push on a middle at each end
                share = 1.0 if ends[0] == ends[1] else 0.5
                contact.node[count], contact.tool[count] = ends[e], contacts.tool[k]
                for c in range(3):
                    contact.push[count, c] = share * push[c] / data.clock[STEP]
                count += 1
    for t in range(data.path.shape[0]):
        for k in range(data.grip.numbers[t, COUNT]):
            contact.node[count], contact.tool[count] = data.grip.node[t, k], t
            for c in range(3):
                contact.push[count, c] = data.grip.impulse[t, k, c] / data.clock[STEP]
            count += 1
    contact.numbers[0] = count


@kernel_njit(inner=True, parallel=True)
def _kick_blocks(sites, nodes, scratch, previous, step, alpha, u, velocity, sums):  # type: ignore[no-untyped-def]
    """Accelerate the nodes by a step; write work of surface loads and dissipation of every block [J] into `sums`.

    The last sum is the largest squared velocity.

    The energy that the damping beta K dissipates is the sum of V (beta v) . (previous - force); see
    `palpate.dynamics.nodal.central_difference.damping_work`. Arrays that are written are arguments of their own:
    Numba drops writes to those of a tuple from a parallel loop.
    """
    half = 0.5 * alpha * step
    shares = (1.0 - half) / (1.0 + half), step / (1.0 + half)
    for b in prange(sums.shape[0]):
        work, square, lost, largest = 0.0, 0.0, 0.0, 0.0
        first = np.int64(b) * BLOCK_NODES
        for i in range(first, min(first + BLOCK_NODES, velocity.shape[0])):
            for c in range(3):
                moved = nodes.volumes[i] * (scratch.damped[i, c] - u[i, c])
                lost += moved * (previous[i, c] - scratch.force[i, c])
                previous[i, c] = scratch.force[i, c]
            if sites.kind[i] != FIXED:
                node_sums = kick_node(
                    i, sites.slide_of[i], sites.slide, nodes, scratch, (0.0, 0.0, 0.0), shares, velocity
                )  # fmt: skip
                work, square = work + node_sums[0], square + node_sums[1]
                largest = max(largest, velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2)
        sums[b, 4] = largest
        sums[b, 0], sums[b, 1] = work * step, lost + alpha * nodes.density * square * step


@kernel_njit(inner=True, parallel=True)
def _drift_blocks(kind, nodes, damped, surface, step, beta, u, velocity, sums):  # type: ignore[no-untyped-def]
    """Move the nodes by a step, and prepare the next force.

    Writes the kinetic energy [J] and the largest squared velocity of every block into `sums`; the latter is infinite
    where a velocity is not a number.
    """
    for b in prange(sums.shape[0]):
        energy, largest = 0.0, 0.0
        first = np.int64(b) * BLOCK_NODES
        for i in range(first, min(first + BLOCK_NODES, velocity.shape[0])):
            square = velocity[i, 0] ** 2 + velocity[i, 1] ** 2 + velocity[i, 2] ** 2
            energy += 0.5 * nodes.density * nodes.volumes[i] * square
            if not square <= largest:
                largest = square if square < np.inf else np.inf
            for c in range(3):
                if kind[i] != FIXED:
                    u[i, c] += step * velocity[i, c]
                damped[i, c] = u[i, c] + beta * velocity[i, c]
                surface[i, c] = 0.0
        sums[b, 2], sums[b, 3] = energy, largest


@kernel_njit(inner=True)
def _save(data, u, velocity):  # type: ignore[no-untyped-def]
    """Copy the state at the start of a period."""
    copy_field(u, data.saved[0])
    copy_field(velocity, data.saved[1])
    copy_field(data.scratch.previous, data.saved[2])
    copy_history(data.passes[1].history, data.saved_history)
    for t in range(data.path.shape[0]):
        copy_values(data.contacts.frames[t, 1], data.path[t, SAVED])
    data.saved_work[0], data.saved_work[1] = data.clock[WORK], data.clock[LOST]


@kernel_njit(inner=True)
def _restore(data, u, velocity):  # type: ignore[no-untyped-def]
    """Set the state to that at the start of the period; the contact starts from zero impulses."""
    copy_field(data.saved[0], u)
    copy_field(data.saved[1], velocity)
    copy_field(data.saved[2], data.scratch.previous)
    copy_history(data.saved_history, data.passes[1].history)
    for t in range(data.path.shape[0]):
        copy_values(data.path[t, SAVED], data.contacts.frames[t, 1])
    data.contacts.patch_impulses[:], data.contacts.step_impulses[:] = 0.0, 0.0
    data.clock[WORK], data.clock[LOST] = data.saved_work[0], data.saved_work[1]


@kernel_njit(inner=True)
def _reach(data, t):  # type: ignore[no-untyped-def]
    """Return the distance [m] from the origin of a tool up to which its way counts for the list of candidates."""
    contacts = data.contacts
    return contacts.tool_radius[t] + contacts.search_gap + contacts.patch_radius + max(data.clock[NEAR_MARGIN], 0.0)


@kernel_njit(inner=True)
def _way_since_list(data, u):  # type: ignore[no-untyped-def]
    """Return a bound of the way [m] of a node and a point of a tool since the candidates were listed."""
    before, largest = data.listed, 0.0
    for i in range(u.shape[0]):
        square = (u[i, 0] - before[i, 0]) ** 2 + (u[i, 1] - before[i, 1]) ** 2 + (u[i, 2] - before[i, 2]) ** 2
        largest = max(largest, square)
    farthest = 0.0
    for t in range(data.path.shape[0]):
        if not is_absent(data.contacts, t):
            way = frame_way(data.path[t, LISTED_AT], data.contacts.frames[t, 1], _reach(data, t))
            farthest = max(farthest, way)
    return np.sqrt(largest) + farthest


@kernel_njit(inner=True)
def _tool_way(data):  # type: ignore[no-untyped-def]
    """Return the largest way [m] of a point of a tool in the present step, and note it for each tool."""
    farthest = 0.0
    for t in range(data.path.shape[0]):
        if not is_absent(data.contacts, t):
            way = frame_way(data.contacts.frames[t, 0], data.contacts.frames[t, 1], _reach(data, t))
            data.clear_way[t] -= way
            farthest = max(farthest, way)
    return farthest


@kernel_njit(inner=True)
def _held_count(grip):  # type: ignore[no-untyped-def]
    """Return the number of nodes that forceps hold."""
    count = 0
    for t in range(grip.numbers.shape[0]):
        count += grip.numbers[t, COUNT]
    return count


@kernel_njit(inner=True)
def _total(sums, k):  # type: ignore[no-untyped-def]
    """Return the sum over the blocks, equal for any number of threads."""
    total = 0.0
    for b in range(sums.shape[0]):
        total += sums[b, k]
    return total


@kernel_njit(inner=True)
def _largest(sums, k):  # type: ignore[no-untyped-def]
    """Return the largest number of all blocks."""
    largest = 0.0
    for b in range(sums.shape[0]):
        if sums[b, k] > largest:
            largest = sums[b, k]
    return largest


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
        period [s] while the tools move evenly to `target` (12 t,). A tool that is held or late does not reach it:
        then `target` gets where it is. The entries of the `report` (8 + 12 t,) are those of
        `palpate.dynamics.run.period_report`. The state is unchanged if the period fails.
    """
    digest = law_digest(__name__, formulation.digest)
    after, step_force = formulation.after, internal_force(formulation.of_steps)

    @law_njit(digest, inner=True)
    def estimate(data, u):  # type: ignore[no-untyped-def]
        """Do one power iteration for the highest frequency."""
        vector, noise, scratch, sites = data.vector, data.noise, data.scratch, data.sites
        largest = 0.0
        for i in range(u.shape[0]):
            for c in range(3):
                largest = max(largest, abs(vector[i, c]))
        if not 0.0 < largest < np.inf:
            copy_field(noise, vector)
            largest = 1.0
        moved, largest_moved = scratch.surface, 0.0
        for i in range(u.shape[0]):
            for c in range(3):
                moved[i, c] = vector[i, c] / largest + ITERATION_NOISE * noise[i, c] if sites.kind[i] != FIXED else 0.0
                largest_moved = max(largest_moved, abs(moved[i, c]))
        size = 0.0
        for i in range(u.shape[0]):
            for c in range(3):
                moved[i, c] *= data.amplitude / largest_moved
                size += moved[i, c] ** 2
                scratch.damped[i, c] = u[i, c] + moved[i, c]
        body, work = data.taut_passes
        after(work, 0.0)
        step_force(scratch.damped, body, work, moved)
        step_force(u, body, work, scratch.force)
        subtract_inertia(
            data.tailoring,
            data.nodes.volumes,
            data.nodes.density,
            -1.0,
            moved,
            scratch.force,
            0.0,
            moved,
            scratch.force,
        )
        grown = 0.0
        for i in range(u.shape[0]):
            for c in range(3):
                vector[i, c] = (
                    (scratch.force[i, c] - moved[i, c]) / data.nodes.density if sites.kind[i] != FIXED else 0.0
                )
            if sites.slide_of[i] >= 0:
                free = project(sites.slide, sites.slide_of[i], vector[i, 0], vector[i, 1], vector[i, 2])
                vector[i, 0], vector[i, 1], vector[i, 2] = free
            for c in range(3):
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
        clock[FREQUENCY] *= max(1.0, data.resting_frequency / clock[BASE_FREQUENCY])  # of modes that a cut has changed
        clock[BASE_FREQUENCY] = data.resting_frequency
        clock[UNTIL_ESTIMATE] -= 1.0
        if clock[UNTIL_ESTIMATE] <= 0.0:
            frequency = estimate(data, u)
            if frequency > 0.0 and frequency < np.inf:
                least, most = data.resting_frequency, MAX_FREQUENCY_RATIO * data.resting_frequency
                clock[ESTIMATE] = min(max(FREQUENCY_MARGIN * frequency, least), most)
                # an iteration that has not converged must not lengthen the step at once
                clock[FREQUENCY] = min(max(clock[ESTIMATE], SLOWEST_DECREASE * clock[FREQUENCY]), most)
            is_stiff = clock[FREQUENCY] > STIFF_RATIO * data.resting_frequency
            clock[UNTIL_ESTIMATE] = STIFF_ESTIMATE if is_stiff else ESTIMATE_PERIODS
        set_step(data)

    @law_njit(digest, inner=True)
    def take_steps(data, u, velocity, period):  # type: ignore[no-untyped-def]
        """Take the steps of a period; return their number, or -1 if a node moves too far in one."""
        clock, scratch, sites, contacts, path = data.clock, data.scratch, data.sites, data.contacts, data.path
        (body, work), grip, nodes, damping = data.passes, data.grip, data.nodes, data.damping
        begin_grip(grip, contacts.points, u, contacts.frames)
        step, behind = clock[STEP], clock[BEHIND]
        count = int((behind + period) / step * (1.0 + 1e-12))
        if count > MAX_STEPS:
            count = MAX_STEPS
            behind = count * step - period
        if count == 0:
            clock[KINETIC_ENERGY], clock[NEXT_BEHIND] = kinetic_energy(nodes, velocity), behind + period
            return 0
        _drift_blocks(sites.kind, nodes, scratch.damped, scratch.surface, 0.0, damping.beta, u, velocity, data.sums)
        way = _way_since_list(data, u)
        for s in range(count):
            share = min(1.0, ((s + 1) * step - behind) / period)
            place_tools(path, share, contacts.frames)
            way += _tool_way(data)
            after(work, step)
            step_force(scratch.damped, body, work, scratch.force)
            foundation_force(sites, u, velocity, nodes.volumes, scratch.surface)
            subtract_inertia(
                data.tailoring, nodes.volumes, nodes.density, 1.0, scratch.surface, scratch.force, 1.0 / step,
                contacts.step_impulses, scratch.surface,
            )  # fmt: skip
            store_velocities(grip, velocity)
            _kick_blocks(sites, nodes, scratch, scratch.previous, step, damping.alpha, u, velocity, data.sums)
            works = hold_nodes(grip, contacts, nodes, scratch.surface, damping.alpha, step, u, velocity)
            clock[WORK] += _total(data.sums, 0) + works[0]
            clock[LOST] += _total(data.sums, 1) + works[1]
            ahead = step * np.sqrt(_largest(data.sums, 4))
            if not way + ahead <= clock[NEAR_MARGIN]:
                clock[NEAR_MARGIN], way = data.reach + ahead, 0.0
                list_near(contacts, clock[NEAR_MARGIN], u)
                copy_field(u, data.listed)
                for t in range(path.shape[0]):
                    data.clear_way[t] = 0.0
                    copy_values(contacts.frames[t, 1], path[t, LISTED_AT])
            works = push_patches(
                contacts, False, (step, step, step, 0.0), 1.0, u, velocity,
                (nodes, scratch, damping.alpha, (0.0, 0.0, 0.0)),
            )  # fmt: skip
            clock[WORK] += works[0]
            clock[LOST] += works[1]
            if _held_count(grip) > 0:
                clock[WORK] += bear_impulses(grip, contacts, step, u, velocity)
            _drift_blocks(
                sites.kind, nodes, scratch.damped, scratch.surface, step, damping.beta, u, velocity, data.sums
            )
            moved = step * np.sqrt(_largest(data.sums, 3))
            if not moved < data.reach:
                return -1
            for t in range(path.shape[0]):
                data.clear_way[t] -= moved
            way += moved
        clock[KINETIC_ENERGY] = _total(data.sums, 2)
        clock[NEXT_BEHIND] = behind + period - count * step
        return count

    @law_njit(digest, inner=True)
    def run_period(data, q, v, target, period, report):  # type: ignore[no-untyped-def]
        n, clock, contacts = data.nodes.volumes.shape[0], data.clock, data.contacts
        u, velocity = q.reshape((n, 3)), v.reshape((n, 3))
        history = data.passes[1].history
        for k in range(FORCES):
            report[k] = 0.0
        # the start of a run, or a reset; a body that is pressed over a support alone is at rest, too
        at_rest = clock[RESTED] == 0.0 and not q.any() and not v.any()
        if at_rest:
            reset_history(history)
            clock[BEHIND], clock[WORK], clock[LOST], clock[KINETIC_ENERGY], clock[GIVEN] = 0.0, 0.0, 0.0, 0.0, 0.0
            clock[REPEATED], clock[GAINED], clock[HELD] = 0.0, 0.0, 0.0
            for i in range(n):
                for c in range(3):
                    data.scratch.previous[i, c] = 0.0
            clock[FREQUENCY], clock[UNTIL_ESTIMATE] = data.resting_frequency, ESTIMATE_PERIODS
            clock[ESTIMATE], clock[NEAR_MARGIN] = data.resting_frequency, -1.0
            contacts.patch_impulses[:], contacts.step_impulses[:] = 0.0, 0.0
        for t in range(data.path.shape[0]):
            path, holds = data.path[t], data.grip.numbers[t, COUNT] > 0
            set_path(path, target[12 * t : 12 * (t + 1)], at_rest and not holds)
            if at_rest:
                if holds:  # the nodes as they are at rest
                    copy_values(path[HOME], path[START])
                    data.grip.numbers[t, FRESH] = 1
                copy_values(path[START], contacts.frames[t, 1])
        kinetic = kinetic_energy(data.nodes, velocity)
        clock[GIVEN] += kinetic - clock[KINETIC_ENERGY]  # of velocities that were set
        excess_before = kinetic - (clock[GIVEN] + clock[WORK] - clock[LOST])
        choose_step(data, u)
        depth = _choose_paths(data, u, period)
        _save(data, u, velocity)
        count, frequency_before = -1, clock[FREQUENCY]
        for attempt in range(MAX_ATTEMPTS):
            if attempt > 0:
                _restore(data, u, velocity)
                clock[FREQUENCY] *= STIFFENING_FACTOR
                clock[REPEATED] += 1.0 if attempt == 1 else 0.0
                set_step(data)
                if attempt >= HELD_ATTEMPT:
                    for t in range(data.path.shape[0]):
                        copy_values(data.path[t, START], data.path[t, END])
                        data.late[t] = 1
                if attempt >= STOPPED_ATTEMPT:
                    clock[LOST] += kinetic_energy(data.nodes, velocity)
                    for i in range(n):
                        for c in range(3):
                            velocity[i, c] = 0.0
            contacts.tool_impulses[:] = 0.0
            count = take_steps(data, u, velocity, period)
            if count < 0:
                continue
            excess = clock[KINETIC_ENERGY] - (clock[GIVEN] + clock[WORK] - clock[LOST])
            allowed = MAX_GAIN * max(abs(clock[WORK]), abs(clock[LOST]), abs(clock[GIVEN])) + LEAST_ENERGY
            if excess <= allowed:
                break
            # shorter steps make no difference, and the period has no gain: the sums of work have drifted
            drifted = excess - excess_before <= allowed
            if attempt >= MAX_ENERGY_ATTEMPTS and (drifted or attempt == MAX_ATTEMPTS - 1):
                clock[GIVEN] += excess
                clock[GAINED] += excess
                break
        if count < 0:
            _restore(data, u, velocity)
            clock[FREQUENCY], clock[KINETIC_ENERGY] = frequency_before, kinetic
            report[STATUS] = 1.0
            return
        clock[BEHIND] = clock[NEXT_BEHIND]
        held = False
        for t in range(data.path.shape[0]):
            if data.late[t] == 1:
                held = True
                write_place(data.path[t], target[12 * t : 12 * (t + 1)])
        clock[HELD] += 1.0 if held else 0.0
        if count > 0:
            for k in range(FORCES, report.shape[0]):
                report[k] = 0.0
            _report_contact(data, count * clock[STEP], report)
            for k in range(FORCES, report.shape[0]):
                data.tool_force[k - FORCES] = report[k]
        for k in range(FORCES, report.shape[0]):
            report[k] = data.tool_force[k - FORCES]
        if attempt >= MAX_ENERGY_ATTEMPTS:  # shorter steps did not help
            clock[FREQUENCY] = min(STIFFENING_FACTOR * frequency_before, MAX_FREQUENCY_RATIO * data.resting_frequency)
        clock[RESTED] = 0.0 if q.any() or v.any() else 1.0
        report[STEPS], report[TRUST] = count, depth
        report[KINETIC] = clock[KINETIC_ENERGY]
        report[STRAIN] = max(0.0, clock[GIVEN] + clock[WORK] - clock[LOST] - report[KINETIC])

    @law_njit(digest, inline="always")
    def advance(data, q, v, target, period, report):  # type: ignore[no-untyped-def]
        run_period(reference(data), q, v, target, period, report)

    return advance
