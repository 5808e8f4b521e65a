"""The error indicator of a reduced model in the engine: the largest of some measures, each over its scale, compiled.

It is that of a run (`palpate.reduction.hyper.error_indicator`), with the residual norm at the beginning of the last
explicit step, or at the end of the period with implicit steps.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.lanes import column_work
from palpate.dynamics.contact.penetration import MAX_SURFACE_DEPTH
from palpate.realtime.bodies.period_data import FORCE, WORK, has_residual_fields
from palpate.reduction.contact.gauss_seidel import approach_speed, contact_nearness, tool_energy
from palpate.reduction.contact.penetration import store_depths
from palpate.reduction.contact.surface import PAIRS
from palpate.reduction.galerkin.central_difference import trial_coordinates
from palpate.reduction.hyper.error_indicator import touch_speed, trust_of_tools
from palpate.reduction.hyper.foundation import add_spring_forces
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.sampled_energy import collect_forces, sampled_energy


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _distance(data, q):
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
    return np.sqrt(nearest) / data.indicator.scales.distance_scale


@kernel_njit(inline="always", fastmath={"contract"})
def _touch_of_tools(data, period):
    """Return the largest touch speed [m/s] of the tools, the nearness of the nearest to supports, and their number."""
    touching, nearest, count = 0.0, 0.0, 0
    for t in range(data.tools.kind.shape[0]):
        near, touches = contact_nearness(data.indicator.nearness, data.contact_work, t, data.tools.held.pushes[t])
        nearest, count = max(nearest, near), count + touches
        speed = approach_speed(data.contact_work, data.tools.path[t], period, t)
        energy = tool_energy(data.contact_surface, data.contact_work, t)
        touching = max(touching, touch_speed(speed, energy, data.indicator.scales.flexibility_scale))
    return touching, nearest, count


@kernel_njit(inline="always", fastmath={"contract"})
def _depth_between(data):
    """Return the depth of the surface between nodes in a tool, over the largest trusted one; 0 where it is less."""
    between = 0.0
    store_depths(data.contact_surface, data.contact_work, data.tools)
    for depth in data.contact_work.depth:
        between = max(between, depth / (MAX_SURFACE_DEPTH * data.contact_surface.spacing))
    return between if between > 1.0 else 0.0


@cache
def residual_force_function(law: MaterialPoint, single: bool) -> Any:
    """Compile the forces on the residual fields.

    ``residual_forces(data, at, q, v)`` writes those of springs, and of the stresses of the last force at `at`.
    """
    work = column_work[single]

    @law_njit(law_digest(__name__, law.digest, single), inner=True)
    def residual_forces(data, at, q, v):
        fields, stress = data.indicator.residual_fields, data.body.scratch.stress
        fields.partial[:] = 0.0
        for b in range(fields.table.shape[0]):
            work(fields.table[b].ctypes.data, stress[b].ctypes.data, fields.partial.ctypes.data, fields.forces.shape[0])
        collect_forces(fields.partial, fields.constant, at, fields.forces)
        add_spring_forces(fields.springs, q, v, fields.forces)

    return residual_forces


@kernel_njit(inline="always", fastmath={"contract", "reassoc"})
def _write_accelerations(data, v):
    """Write the accelerations that the forces in `FORCE` and those of the tools cause, with the damping of the tools.

    Tools move evenly.
    """
    result, rate = data.vectors[FORCE], data.vectors[WORK]
    for m in range(data.modes):
        value = 0.0
        for k in range(data.modes):
            value += data.body.constants.constrained_inverse_mass[m, k] * (result[k] + data.tools.load[k])
        rate[m] = value
    for j in range(data.modes, v.shape[0]):
        rate[j] = data.body.constants.mass_damping * v[j]


@kernel_njit(inline="always", fastmath={"contract", "reassoc"})
def _add_contact_forces(fields, contact):
    """Add the forces of the tools on the contact nodes to those on the residual fields."""
    for e in range(contact.numbers[PAIRS]):
        for d in range(3):
            push = contact.push[e, d]
            for j in range(fields.forces.shape[0] if push != 0.0 else 0):
                fields.forces[j] += fields.columns[contact.node[e], d, j] * push


@kernel_njit(inline="always", fastmath={"contract", "reassoc"})
def _norm_of_residual(fields, rate):
    """Return the norm of inertia minus forces on the residual fields."""
    total = 0.0
    for j in range(fields.forces.shape[0]):
        unbalanced = -fields.forces[j]
        for m in range(rate.shape[0]):
            unbalanced += fields.mass[j, m] * rate[m]
        total += unbalanced * unbalanced
    return np.sqrt(total)


@cache
def residual_norm_function(law: MaterialPoint, single: bool, implicit: bool) -> Any:
    """Compile the residual norm.

    ``residual_norm(data, q, v)`` returns the norm of the unbalanced forces on the residual fields, divided by its
    scale. It is that at the beginning of the last explicit step, whose forces are known, or at the end of the period
    with implicit steps.
    """
    digest = law_digest(__name__, "residual norm", law.digest, single, implicit)
    force, residual_forces = sampled_energy(law, single).force, residual_force_function(law, single)

    @law_njit(digest, inline="always", fastmath={"contract", "reassoc"})
    def write_forces(data, q, v):
        """Write the forces at the end of the period."""
        result, at = data.vectors[FORCE], data.vectors[WORK]
        trial_coordinates(q, v, data.body.constants.stiffness_damping, v[data.modes :], False, at)
        force(at, data.body.constants.cubature_points, data.body.scratch, result)
        add_spring_forces(data.body.springs, q, v, result)
        residual_forces(data, at, q, v)
        for k in range(data.modes):
            for j in range(data.modes, q.shape[0]):
                result[k] -= data.body.constants.mass[k, j] * data.body.constants.mass_damping * v[j]

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def residual_norm(data, q, v):
        fields = data.indicator.residual_fields
        if implicit:
            write_forces(data, q, v)
        _write_accelerations(data, v)
        _add_contact_forces(fields, data.contact_work)
        return _norm_of_residual(fields, data.vectors[WORK]) / data.indicator.scales.residual_scale

    return residual_norm


@cache
def error_indicator_function(law: MaterialPoint, single: bool, implicit: bool, touched: bool) -> Any:
    """Compile the error indicator of a body, for implicit or explicit steps, and with contact if it is `touched`.

    ``error_indicator(data, q, v, period, kinetic, flexible)`` returns the error indicator at the end of a period [s],
    by the kinetic energy and that of the surface compliance [J].
    """
    digest = law_digest(__name__, law.digest, single, implicit, touched)
    residual_norm = residual_norm_function(law, single, implicit)

    @law_njit(digest, inner=True, fastmath={"contract"})
    def error_indicator(data, q, v, period, kinetic, flexible):
        indicator, trust, between = data.indicator, _distance(data, q), 0.0
        if has_residual_fields(data):
            trust = max(trust, residual_norm(data, q, v))
        touching, nearest, tools_in_contact = np.sqrt(2.0 * kinetic / indicator.body_mass), 0.0, 0
        if touched:
            touching, nearest, tools_in_contact = _touch_of_tools(data, period)
            between = _depth_between(data)
        return max(
            trust,
            np.sqrt(flexible / data.indicator.scales.flexibility_scale),
            touching / indicator.scales.speed_scale,
            nearest / indicator.scales.nearness_scale,
            trust_of_tools(tools_in_contact, indicator.scales.trained_tools),
            between,
        )

    return error_indicator
