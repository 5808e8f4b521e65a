"""One compiled period of the real-time loop of a reduced model.

During a period the tool moves evenly to its target, so its coordinates have no acceleration. The
change of their rates at the start of the period requires an impulse. Forces on the tool are means over
the period. The functions allocate nothing and do not call Python.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.compiled.cache import kernel_njit, law_digest, law_njit
from palpate.dynamics.compiled.lanes import column_work
from palpate.dynamics.compiled.reference import reference
from palpate.dynamics.contact.penetration import MAX_SURFACE_DEPTH
from palpate.dynamics.material.relaxation import HistoryCopy, copy_field, copy_history, copy_values, reset_history
from palpate.dynamics.run.period_report import FORCES, KINETIC, STATUS, STEPS, STRAIN, TRUST
from palpate.reduction.contact.gauss_seidel import (
    approach_speed,
    compliance_energy,
    contact_nearness,
    press,
    set_tool_paths,
    tool_energy,
)
from palpate.reduction.contact.penetration import hold_above_surface, store_depths
from palpate.reduction.contact.surface import PAIRS, ContactScratch, ContactSurface, RigidTools
from palpate.reduction.contact.tangent import ContactSystem
from palpate.reduction.galerkin.central_difference import drift, kick_coordinates, trial_coordinates
from palpate.reduction.hyper.error_indicator import touch_speed, trust_of_tools
from palpate.reduction.hyper.foundation import Springs, add_spring_forces
from palpate.reduction.hyper.implicit import FORCE as NEWTON_FORCE
from palpate.reduction.hyper.implicit import LOAD as NEWTON_LOAD
from palpate.reduction.hyper.implicit import RATE as NEWTON_RATE
from palpate.reduction.hyper.implicit import ImplicitData, cholesky_factor, cholesky_solve, implicit_step
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.sampled_energy import ProbeScratches, collect_forces, sampled_energy, scratch

STEP_SAFETY = 0.8  # explicit step over the stable one, whose frequency one power iteration a period estimates
MAX_SUBSTEPS = 1000  # explicit steps in a period
REFINEMENT_FACTOR, MAX_ATTEMPTS = 4, 4  # factor of the steps in a repeated period, and most attempts
MAX_GAIN = 0.5  # largest gain of energy in a period without contact, relative to energy and work
LEAST_ENERGY = 1e-12  # [J] below which a gain is rounding

# rows of `PeriodData.vectors`
POWER_SHAPE, WORK, FORCE, RATE, VELOCITY_CHANGE, SAVED_COORDINATES, SAVED_VELOCITIES, TOOL_RATES = range(8)
REST_FREQUENCY, FREQUENCY, NEXT_COLUMN, ENERGY = range(4)  # entries of `PeriodData.tracking`
AT_STATE, ALONG_SHAPE, ALONG_COLUMN = range(3)  # rows of `Probes.forces`


class ResidualFields(NamedTuple):
    """Constants and work arrays of the residual norm."""

    # (b, w, 9, LANES) array: derivatives of the w residual fields at the integration points
    table: NDArray[np.float32] | Floats
    # constant, mass: (w, m) arrays: stiffness of the hourglass residual, and mass matrix, of residual fields and
    # coordinates
    constant: Floats
    mass: Floats
    springs: Springs  # of foundations, on the residual fields
    columns: NDArray[np.float32]  # (k, 3, w) array: the residual fields at the nodes of the contact surface
    forces: Floats  # (w,) array [N times the unit of the fields]: internal forces and those of springs
    partial: Floats  # (w, LANES) array: scratch


class IndicatorData(NamedTuple):
    """Data of the error indicator."""

    # training_states, mass_root: (t, m), (m, m) arrays: training states times the root; transposed root of the mass
    # matrix divided by the body's mass
    training_states: Floats
    mass_root: Floats
    # distance_scale, residual_scale: float [m]
    distance_scale: float
    residual_scale: float
    flexibility_scale: float  # [J]
    speed_scale: float  # [m/s]
    nearness_scale: float  # see `palpate.reduction.hyper.data.ReducedData`
    nearness: Floats  # (k,) array: of the surface nodes to supports
    trained_tools: int  # largest number of tools in contact at once in the held-out runs
    body_mass: float  # [kg]
    residual_fields: ResidualFields


class Probes(NamedTuple):
    """Forces at the coordinates, and next to them along the shape of the power iteration and one coordinate."""

    rows: Floats  # (2, m)
    forces: Floats  # (3, m)
    scratches: ProbeScratches


def probes(body: ImplicitData) -> Probes:
    """Return zeroed probes of a body; the first scratch is that of its steps."""
    count, points = len(body.mass), body.integration_points
    along_shape, along_column = (scratch(points, body.scratch.history) for _ in range(2))
    return Probes(np.zeros((2, count)), np.zeros((3, count)), ProbeScratches(body.scratch, along_shape, along_column))


class PeriodStart(NamedTuple):
    """Copies of the history variables, of contact forces and positions, and of the frames of tools."""

    history: HistoryCopy
    force: Floats
    place: Floats
    frames: Floats


class PeriodData(NamedTuple):
    """Constants and work arrays of the compiled period."""

    modes: int
    step: float  # [s]: of the implicit rule, 0 for explicit steps
    body: ImplicitData  # mass, damping, integration points and springs of the coordinates
    constrained_inverse_mass: Floats  # (modes, modes) array: inverse of the modes' block of the mass matrix
    indicator: IndicatorData
    vectors: Floats  # (8, m) array: work arrays; the first is the state of the power iteration
    probes: Probes
    tangent: Floats  # (m, m) array: each period updates one column
    condensed: Floats  # (m, m) array
    # (4,) array: frequency [rad/s] at rest and now; next column of the tangent; energy [J] after the last period
    tracking: Floats
    substep: Floats  # (1,) array [s]: last explicit step
    # path, holds, no_loads: (s + 3, l), (s,), (s, m) arrays: path of the tool during the implicit steps of a period,
    # that it is prescribed, and zero loads
    path: Floats
    holds: NDArray[np.bool_]
    no_loads: Floats
    # contact_surface, contact_work, tools: of tools in contact (`palpate.reduction.contact.gauss_seidel`); empty for a
    # prescribed group
    contact_surface: ContactSurface
    contact_work: ContactScratch
    tools: RigidTools
    home: Floats  # (t, 3, 4) array [-], [m]: rotations and positions of those tools at zero displacement
    system: ContactSystem  # of the contact stiffness (`palpate.reduction.contact.tangent`)
    start: PeriodStart  # from which a period is repeated


@kernel_njit(inner=True)
def has_residual_fields(data):  # type: ignore[no-untyped-def]
    """Return whether there are residual fields; the loops over their derivatives run at least once."""
    return data.indicator.residual_fields.forces.shape[0] > 0


@kernel_njit()
def save_start(data):  # type: ignore[no-untyped-def]
    """Save history variables and contact at the start of a period."""
    contact, start = data.contact_work, data.start
    copy_history(data.body.scratch.history, start.history)
    for t in range(data.tools.kind.shape[0]):
        if data.tools.sizes[t, 0] != -np.inf:  # an absent tool has no forces
            copy_field(contact.force[t], start.force[t])
            copy_field(contact.place[t], start.place[t])
    copy_values(data.tools.frames, start.frames)


@kernel_njit()
def restore_start(data):  # type: ignore[no-untyped-def]
    """Restore what `save_start` has saved."""
    contact, start = data.contact_work, data.start
    copy_history(start.history, data.body.scratch.history)
    for t in range(data.tools.kind.shape[0]):
        if data.tools.sizes[t, 0] != -np.inf:
            copy_field(start.force[t], contact.force[t])
            copy_field(start.place[t], contact.place[t])
    copy_values(start.frames, data.tools.frames)
    contact.busy[:] = True


@cache
def period_functions(law: MaterialPoint, single: bool) -> tuple[Any, Any]:
    """Compile the period of a law.

    Returns
    -------
    advance, stiffness : functions
        ``advance(data, q, v, target, period, report)`` advances coordinates and velocities (m,) by a
        period [s] while the tool's coordinates move evenly to `target` (l,). The `report` (8 + l,) has the
        entries of `palpate.dynamics.run.period_report`. The state is unchanged if the period fails. The
        forces in the report are means over the period. ``stiffness(data, q, out)`` writes the derivatives
        (l, l) of the static forces by the tool's coordinates, from the tangents of the last m periods.
    """
    digest = law_digest(__name__, "period", law.digest, single)
    compiled = sampled_energy(law, single)
    force, probe_forces, work = compiled.force, compiled.probe, column_work[single]
    average, _ = implicit_step(law, single)

    @law_njit(digest, inner=True, fastmath={"contract"})
    def probe(data, q):  # type: ignore[no-untyped-def]
        """Evaluate the forces that `update_tangent` requires, and return the strain energy [J] of the coordinates."""
        modes, count, shape, rows = data.modes, q.shape[0], data.vectors[POWER_SHAPE], data.probes.rows
        largest = 0.0
        for m in range(modes):
            largest = max(largest, abs(shape[m]) / data.body.differences[m])
        if not 0.0 < largest < np.inf:  # also where the vector of a crushed body is not a number
            for m in range(modes):
                shape[m] = data.body.differences[m]
            largest = 1.0
        for m in range(count):
            rows[AT_STATE, m], rows[ALONG_SHAPE, m] = q[m], q[m]
        for m in range(modes):
            shape[m] /= largest
            rows[ALONG_SHAPE, m] += shape[m]
        column, probes = int(data.tracking[NEXT_COLUMN]), data.probes
        change, points = data.body.differences[column], data.body.integration_points
        return probe_forces(rows, column, change, points, probes.scratches, probes.forces)

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def update_tangent(data):  # type: ignore[no-untyped-def]
        """Do one power iteration for the highest frequency, and update one column of the tangent."""
        modes, count = data.modes, data.tangent.shape[0]
        shape, image, change = data.vectors[POWER_SHAPE], data.vectors[WORK], data.vectors[RATE]
        behind, ahead, along = (
            data.probes.forces[AT_STATE],
            data.probes.forces[ALONG_SHAPE],
            data.probes.forces[ALONG_COLUMN],
        )
        size, grown = 0.0, 0.0
        for m in range(modes):
            change[m] = behind[m] - ahead[m]
        for m in range(modes):
            value = 0.0
            for k in range(modes):
                value += data.constrained_inverse_mass[m, k] * change[k]
            image[m] = value
        for m in range(modes):
            inertia, reference = 0.0, 0.0
            for k in range(modes):
                inertia += data.body.mass[m, k] * image[k]
                reference += data.body.mass[m, k] * shape[k]
            grown += inertia * image[m]
            size += reference * shape[m]
        for m in range(modes):
            shape[m] = image[m]
        if grown > 0.0 and size > 0.0:
            data.tracking[FREQUENCY] = np.sqrt(np.sqrt(grown / size))
        column = int(data.tracking[NEXT_COLUMN])
        data.tracking[NEXT_COLUMN] = (column + 1) % count
        for m in range(count):
            data.tangent[m, column] = (behind[m] - along[m]) / data.body.differences[column]
            if data.body.springs.stiffness.shape[0] > 0:
                data.tangent[m, column] += data.body.springs.stiffness[m, column]

    @law_njit(digest, inner=True)
    def residual_forces(data, at, q, v):  # type: ignore[no-untyped-def]
        """Write the forces on the residual fields of springs, and of the stresses of the last force at `at`."""
        fields, stress = data.indicator.residual_fields, data.body.scratch.stress
        fields.partial[:] = 0.0
        for b in range(fields.table.shape[0]):
            work(fields.table[b].ctypes.data, stress[b].ctypes.data, fields.partial.ctypes.data, fields.forces.shape[0])
        collect_forces(fields.partial, fields.constant, at, fields.forces)
        add_spring_forces(fields.springs, q, v, fields.forces)

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def substeps(data, q, v, speeds, period, report, refinement):  # type: ignore[no-untyped-def]
        """Take explicit steps over a period, shorter than stable ones by a factor; return their number."""
        modes, count = data.modes, q.shape[0]
        at, result = data.vectors[WORK], data.vectors[FORCE]
        even = data.path[:3]  # the tools move evenly
        even[:] = 0.0
        springs, points, scratch, mass = (
            data.body.springs,
            data.body.integration_points,
            data.body.scratch,
            data.body.mass,
        )
        beta, clock, moved = data.body.stiffness_damping, data.body.scratch.history.interval, speeds[modes:]
        no_load, constrained_inverse = data.no_loads[0], data.constrained_inverse_mass
        alpha, mean = data.body.mass_damping, data.vectors[RATE]
        frequency = max(data.tracking[REST_FREQUENCY], data.tracking[FREQUENCY])
        frequency = np.sqrt(frequency**2 + springs.highest_squared)
        z = beta * frequency + springs.decay_rate / frequency
        stable = STEP_SAFETY * (np.sqrt(z * z + 4.0) - z) / frequency
        steps = MAX_SUBSTEPS
        if refinement * period < MAX_SUBSTEPS * stable:  # False for NaN
            steps = refinement * int(np.ceil(period / stable))
        step = period / steps
        data.substep[0] = step
        for j in range(modes, count):
            even[0, j - modes], even[2, j - modes] = -step * speeds[j], step * speeds[j]
        for s in range(steps):
            trial_coordinates(q, v, beta, moved, False, at)
            clock[0] = clock[1]
            force(at, points, scratch, result)
            add_spring_forces(springs, q, v, result)
            if s == steps - 1 and has_residual_fields(data):
                residual_forces(data, at, q, v)
            clock[0], clock[1] = 0.0, step
            kick_coordinates(v, result, no_load, even, 0, step, step, True, mass, constrained_inverse, alpha, mean)
            for j in range(modes, count):
                report[FORCES + j - modes] -= result[j] / steps
            if data.tools.kind.shape[0] > 0:
                press(data, q, v, at, step, period, (s + 1.0) / steps, report[FORCES:])
            drift(q, v, modes, step)
            for j in range(modes, count):
                q[j] += step * speeds[j]
        return steps

    @law_njit(digest, inner=True, fastmath={"contract"})
    def implicit(data, q, v, period, report, lifting, holds, loads):  # type: ignore[no-untyped-def]
        """Take implicit steps over a period; return their number, or -1 if one did not converge."""
        steps, count = loads.shape[0], q.shape[0]
        step = period / steps
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
                    value += data.body.mass[j, m] * rate[m]
                report[FORCES + j - data.modes] += value / steps
        return steps

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def distance(data, q):  # type: ignore[no-untyped-def]
        """Return the distance to the nearest training state, divided by its scale."""
        place, count, nearest = data.vectors[WORK], q.shape[0], np.inf
        for m in range(count):
            value = 0.0
            for k in range(count):
                value += data.indicator.mass_root[m, k] * q[k]
            place[m] = value
        for t in range(data.indicator.training_states.shape[0]):
            square = 0.0
            for m in range(count):
                difference = place[m] - data.indicator.training_states[t, m]
                square += difference * difference
            nearest = min(nearest, square)
        return np.sqrt(nearest) / data.indicator.distance_scale

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def residual_norm(data, q, v):  # type: ignore[no-untyped-def]
        """Return the norm of the unbalanced forces on the residual fields, divided by its scale.

        It is that at the beginning of the last explicit step, whose forces are known.
        """
        fields, contact, result, rate = (
            data.indicator.residual_fields,
            data.contact_work,
            data.vectors[FORCE],
            data.vectors[WORK],
        )
        count, total = q.shape[0], 0.0
        if data.step > 0.0:
            trial_coordinates(q, v, data.body.stiffness_damping, v[data.modes :], False, rate)
            force(rate, data.body.integration_points, data.body.scratch, result)
            add_spring_forces(data.body.springs, q, v, result)
            residual_forces(data, rate, q, v)
            for k in range(data.modes):
                for j in range(data.modes, count):
                    result[k] -= data.body.mass[k, j] * data.body.mass_damping * v[j]
        for m in range(data.modes):
            value = 0.0
            for k in range(data.modes):
                value += data.constrained_inverse_mass[m, k] * (result[k] + data.tools.load[k])
            rate[m] = value
        for j in range(data.modes, count):
            rate[j] = data.body.mass_damping * v[j]  # the tools move evenly
        for e in range(contact.numbers[PAIRS]):
            for d in range(3):
                push = contact.push[e, d]
                for j in range(fields.forces.shape[0] if push != 0.0 else 0):
                    fields.forces[j] += fields.columns[contact.node[e], d, j] * push
        for j in range(fields.forces.shape[0]):
            unbalanced = -fields.forces[j]
            for m in range(count):
                unbalanced += fields.mass[j, m] * rate[m]
            total += unbalanced * unbalanced
        return np.sqrt(total) / data.indicator.residual_scale

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def change_rates(data, q, v, target, period):  # type: ignore[no-untyped-def]
        """Write the rates of the tool in a period, and the change of all velocities that they cause at its start."""
        modes, count, mass, constrained_inverse = data.modes, q.shape[0], data.body.mass, data.constrained_inverse_mass
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

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def begin(data, q, v, period, report):  # type: ignore[no-untyped-def]
        """Set the state at the start of a period, and the impulses of the tool there."""
        count, vectors, mass = q.shape[0], data.vectors, data.body.mass
        change = vectors[VELOCITY_CHANGE]
        for m in range(count):
            q[m], v[m] = vectors[SAVED_COORDINATES, m], vectors[SAVED_VELOCITIES, m] + change[m]
        report[:] = 0.0
        for j in range(data.modes, count):
            for k in range(count):
                report[FORCES + j - data.modes] += mass[j, k] * change[k] / period

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def finish(data, q, v, target, period, report, flexible):  # type: ignore[no-untyped-def]
        """Write the energies at the end of a period, and `probe`; return whether state and energy balance are right."""
        modes, count, mass, speeds = data.modes, q.shape[0], data.body.mass, data.vectors[TOOL_RATES]
        work = 0.0
        for j in range(modes, count):  # remove rounding errors
            q[j] = target[j - modes]
            v[j] = speeds[j]
            work += period * speeds[j] * report[FORCES + j - modes]
        kinetic = 0.0
        for m in range(count):
            if not (np.isfinite(q[m]) and np.isfinite(v[m])):
                return False
            momentum = 0.0
            for k in range(count):
                momentum += mass[m, k] * v[k]
            kinetic += 0.5 * v[m] * momentum
        report[KINETIC] = kinetic
        report[STRAIN] = probe(data, q) + flexible
        before, after = data.tracking[ENERGY], report[KINETIC] + report[STRAIN]
        if data.step > 0.0 or data.tools.kind.shape[0] > 0:
            return np.isfinite(after)
        return after - before - work <= MAX_GAIN * max(before, after, abs(work), LEAST_ENERGY)  # False for NaN

    @law_njit(digest, inline="always", fastmath={"contract"})
    def advance(given, q, v, target, period, report):  # type: ignore[no-untyped-def]
        data = reference(given)  # functions for a caller that has a record are those of the engine
        count, vectors = q.shape[0], data.vectors
        saved_q, saved_v = vectors[SAVED_COORDINATES], vectors[SAVED_VELOCITIES]
        for m in range(count):
            saved_q[m], saved_v[m] = q[m], v[m]
        at_rest = not q.any() and not v.any()
        if at_rest:  # the start of a run, or a reset
            reset_history(data.body.scratch.history)
            data.contact_work.force[:] = 0.0
            data.system.numbers[:] = 0
            data.tracking[ENERGY] = 0.0
        change_rates(data, q, v, target, period)
        set_tool_paths(data.tools, data.home, target, at_rest)
        hold_above_surface(data.contact_surface, data.contact_work, data.tools, data.home, target)
        save_start(data)
        attempts = 1 if data.step > 0.0 else MAX_ATTEMPTS
        refinement, taken, good, flexible = 1, 0, False, 0.0
        for attempt in range(attempts):
            if attempt > 0:  # the body has stiffened faster than the estimate of its frequency
                restore_start(data)
                refinement *= REFINEMENT_FACTOR
            begin(data, q, v, period, report)
            if data.step > 0.0:
                steps = max(1, int(np.round(period / data.step)))
                taken = implicit(
                    data, q, v, period, report, data.path[: steps + 3], data.holds[:steps], data.no_loads[:steps]
                )
            else:
                taken = substeps(data, q, v, vectors[TOOL_RATES], period, report, refinement)
            flexible = compliance_energy(data.contact_surface, data.contact_work)
            over_supports = 0.0
            for energy in data.tools.held.energy:
                over_supports += energy
            good = taken > 0 and finish(data, q, v, target, period, report, flexible + over_supports)
            if good or taken == MAX_SUBSTEPS:
                break
        if not good:
            for m in range(count):
                q[m], v[m] = saved_q[m], saved_v[m]
            report[STATUS] = 1.0
            return
        data.tracking[ENERGY] = report[KINETIC] + report[STRAIN]
        update_tangent(data)
        report[TRUST] = distance(data, q)
        if has_residual_fields(data):
            report[TRUST] = max(report[TRUST], residual_norm(data, q, v))
        touching = np.sqrt(2.0 * report[KINETIC] / data.indicator.body_mass)
        between = 0.0  # depth of the surface between nodes, where the tool is not trusted
        nearest, tools_in_contact = 0.0, 0
        if data.tools.kind.shape[0] > 0:
            touching = 0.0
            for t in range(data.tools.kind.shape[0]):
                near, touches = contact_nearness(data.indicator.nearness, data.contact_work, t)
                nearest, tools_in_contact = max(nearest, near), tools_in_contact + touches
                speed = approach_speed(data.contact_work, data.tools.path[t], period, t)
                energy = tool_energy(data.contact_surface, data.contact_work, t)
                touching = max(touching, touch_speed(speed, energy, data.indicator.flexibility_scale))
            store_depths(data.contact_surface, data.contact_work, data.tools)
            for depth in data.contact_work.depth:
                between = max(between, depth / (MAX_SURFACE_DEPTH * data.contact_surface.spacing))
        report[TRUST] = max(
            report[TRUST],
            np.sqrt(flexible / data.indicator.flexibility_scale),
            touching / data.indicator.speed_scale,
            nearest / data.indicator.nearness_scale,
            trust_of_tools(tools_in_contact, data.indicator.trained_tools),
            between if between > 1.0 else 0.0,
        )
        report[STEPS] = taken

    @law_njit(digest, inline="always", fastmath={"contract"})
    def stiffness(data, q, out):  # type: ignore[no-untyped-def]
        modes, count = data.modes, q.shape[0]
        tangent, condensed, column = data.tangent, data.condensed, data.vectors[WORK]
        for m in range(count):
            for k in range(count):
                condensed[m, k] = 0.5 * (tangent[m, k] + tangent[k, m])
        definite = cholesky_factor(condensed, modes)
        for j in range(count - modes):
            for m in range(modes):
                column[m] = 0.5 * (tangent[m, modes + j] + tangent[modes + j, m]) if definite else 0.0
            if definite:
                cholesky_solve(condensed, modes, column)
            for i in range(count - modes):
                value = 0.5 * (tangent[modes + i, modes + j] + tangent[modes + j, modes + i])
                for m in range(modes):
                    value -= 0.5 * (tangent[modes + i, m] + tangent[m, modes + i]) * column[m]
                out[i, j] = value

    return advance, stiffness
