"""The functions of an exported library, compiled from the kernels of the engine.

They take arrays of the model's memory and numbers, allocate nothing, and return a status.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.compiled.jit import kernel_njit, law_njit
from palpate.dynamics.contact.kinds import BONDED, PLANE
from palpate.realtime.bodies.change_tool import replace_tool
from palpate.realtime.instrumented import TOOLS
from palpate.realtime.period import (
    CLAMP,
    FAILED,
    FORCE,
    IGNORE,
    Settings,
    compile_period,
    functions_digest,
    place_work,
    reset_work,
    take_pose,
)
from palpate.realtime.record import HEADER_SIZE, TOOL_SIZE, field_offset
from palpate.reduction.contact.surface import PAIRS
from palpate.reduction.hyper.error_indicator import curve_bound

TAKEN_STATUS, POSE_STATUS, DIVERGED_STATUS, INVALID_STATUS = range(4)
OPTION_NAMES = ("period", "force_limit", "max_speed", "max_angular_speed", "stiffness_every", "out_of_training")
OPTION_PERIOD, FORCE_LIMIT, MAX_SPEED, MAX_ANGULAR_SPEED, STIFFNESS_EVERY, OUT_OF_TRAINING = range(len(OPTION_NAMES))
WORST_TRUST, RECORD_FORCE = field_offset("worst_trust"), field_offset("force")
FORCE_NUMBERS = 15  # of force, moment and stiffness, which follow each other
MIN_PERIOD, MAX_PERIOD = 5e-5, 0.02  # [s]


@kernel_njit(inner=True)
def _is_finite(values):
    total = 0.0
    for i in range(values.shape[0]):
        total += 0.0 * values[i]  # 0, or not a number
    return total == 0.0


@cache
def compile_step(advance: Any, stiffness: Any) -> Any:
    """Compile the step of a library around the functions of an instrumented model.

    ``step(data, work, pose, options, curve, bound)`` takes a period towards poses (t, 7), and writes the record and the
    error bounds (t,) [N] of the forces. It returns 0; 1 if a pose is not finite or jumps, and its last one is kept; 2
    if the state has diverged; 3 if an option is not valid.
    """
    take_period = compile_period(advance, stiffness)
    digest, _ = functions_digest(__name__, advance, stiffness)

    @law_njit(digest)
    def step(data, work, pose, options, curve, bound):
        if work.record[FAILED] != 0.0:
            return DIVERGED_STATUS
        if not MIN_PERIOD <= options[OPTION_PERIOD] <= MAX_PERIOD:
            return INVALID_STATUS
        if not (options[FORCE_LIMIT] > 0.0 and options[MAX_SPEED] > 0.0 and options[MAX_ANGULAR_SPEED] > 0.0):
            return INVALID_STATUS
        if not 0.0 <= options[STIFFNESS_EVERY] <= 1e6:
            return INVALID_STATUS
        if options[OUT_OF_TRAINING] != CLAMP and options[OUT_OF_TRAINING] != IGNORE:
            return INVALID_STATUS
        tools, is_taken = pose.shape[0], True
        for t in range(tools):
            is_taken = take_pose(work, t, pose[t]) and is_taken
        period = options[OPTION_PERIOD]
        settings = Settings(
            int(1e9 * period + 0.5), 0, period * options[MAX_SPEED], period * options[MAX_ANGULAR_SPEED],
            options[FORCE_LIMIT], int(options[STIFFNESS_EVERY]), int(options[OUT_OF_TRAINING]), 0,
        )  # fmt: skip
        valid = take_period(data, work, settings)
        for t in range(tools):
            square, first = 0.0, HEADER_SIZE + TOOL_SIZE * t + FORCE
            for i in range(3):
                square += work.record[first + i] ** 2
            bound[t] = curve_bound(curve, work.record[WORST_TRUST], np.sqrt(square))
            if not valid:
                work.record[first : first + FORCE_NUMBERS] = 0.0  # a device would hold the last one
        if not valid:
            work.record[RECORD_FORCE : RECORD_FORCE + FORCE_NUMBERS] = 0.0
            return DIVERGED_STATUS
        return TAKEN_STATUS if is_taken else POSE_STATUS

    return step


@kernel_njit(inner=True)
def _rest_tool(data, t):
    """Set the tool at the end of a coupling to rest at zero displacement."""
    coupling, tools = data.coupling, data.coupling.position.shape[0]
    for i in range(3):
        coupling.position[t, i], coupling.velocity[t, i] = 0.0, 0.0
        coupling.device[t, i], coupling.force[t, i] = 0.0, 0.0
        data.values[TOOLS + 3 * t + i], data.values[TOOLS + 3 * (tools + t) + i] = 0.0, 0.0


@kernel_njit()
def reset_model(data, work, rest):
    """Set body and tools to rest; the tools and the moduli stay."""
    reset_work(work, rest)
    for t in range(data.coupling.position.shape[0]):
        _rest_tool(data, t)
    return TAKEN_STATUS


@kernel_njit(inner=True)
def _are_held(inner, t, radius, point):
    """Return whether other forceps hold a node within a radius of a point at rest."""
    tools, points = inner.tools, inner.contact_surface.points
    for i in range(points.shape[0]):
        square = 0.0
        for d in range(3):
            square += (points[i, d] - point[d]) ** 2
        for other in range(tools.kind.shape[0]):
            away = 0.0
            for d in range(3):
                away += (points[i, d] - tools.origins[other, d]) ** 2
            held = other != t and tools.kind[other] == BONDED and away <= tools.sizes[other, 0] ** 2
            if held and square <= radius**2:
                return True
    return False


@kernel_njit()
def exchange_tool(data, work, index, kind, sizes, friction, point, pose):
    """Replace a tool (1,) by one of a kind (1,) at a pose (7,), or by none if the kind is negative.

    Later displacements are relative to that pose. Returns 3, and changes nothing, if a number is out of range, or for
    forceps on nodes that others hold.
    """
    if not 0 <= index[0] < data.inner.tools.kind.shape[0]:  # without any, a tool moves a group
        return INVALID_STATUS
    valid = kind[0] <= BONDED and _is_finite(sizes) and _is_finite(point) and _is_finite(pose) and friction[0] >= 0.0
    square = pose[3] ** 2 + pose[4] ** 2 + pose[5] ** 2 + pose[6] ** 2
    valid = valid and abs(square - 1.0) < 1e-6 and friction[0] < np.inf
    for k in range(3):
        valid = valid and sizes[k] >= 0.0
    if not valid or (kind[0] >= 0 and kind[0] != PLANE and not sizes[0] > 0.0):
        return INVALID_STATUS
    if kind[0] == BONDED and _are_held(data.inner, index[0], sizes[0], point):
        return INVALID_STATUS
    replace_tool(data.inner, index[0], kind[0], sizes, friction[0], point, pose)
    for i in range(7):
        work.pose[index[0], i] = 1.0 if i == 3 else 0.0
    place_work(work, index[0])
    _rest_tool(data, index[0])
    return TAKEN_STATUS


@kernel_njit()
def write_vertices(data, q, rest, columns, patch_columns, places, fields, vertices):
    """Write the positions (n, 3) [m] of the surface: of the modes and, at contact nodes, of the surface compliance.

    `columns` (n, 3, m) are displacements of vertices, `patch_columns` those of the patches that tools meet. `places`
    (n,) are rows of contact nodes, or -1. `fields` (3 c + 3 k + 3 c,) are forces on carriers and on nodes, and
    displacements of carriers.
    """
    inner = data.inner
    compliance, contact, tools = inner.contact_surface.compliance, inner.contact_work, inner.tools
    count, carriers = contact.numbers[PAIRS], compliance.flexibility.shape[0]
    nodes, held = compliance.members.shape[0] // 2, 0
    for e in range(count):  # forceps hold nodes, which are then drawn themselves
        if tools.kind[contact.tool[e]] == BONDED:
            contact.pair_of[contact.node[e]] = 1
            held += 1
    _spread_forces(compliance, contact, count, carriers, fields)
    for i in range(vertices.shape[0]):
        x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
        bonded = held > 0 and (held == count or (places[i] >= 0 and contact.pair_of[places[i]] == 1))
        table = columns if bonded else patch_columns
        for m in range(q.shape[0]):
            x += table[i, 0, m] * q[m]
            y += table[i, 1, m] * q[m]
            z += table[i, 2, m] * q[m]
        if places[i] >= 0 and count > 0:
            moved = _compliance_displacement(compliance, places[i] + nodes if bonded else places[i], carriers, fields)
            x, y, z = x + moved[0], y + moved[1], z + moved[2]
        vertices[i, 0], vertices[i, 1], vertices[i, 2] = x, y, z
    for e in range(count):
        contact.pair_of[contact.node[e]] = 0
    return TAKEN_STATUS


@kernel_njit(inner=True)
def _spread_forces(compliance, contact, count, carriers, fields):
    """Distribute the forces of the pairs, times the secant factors of their tools, to carriers and nodes.

    Then write the displacements of the carriers.
    """
    for k in range(fields.shape[0]):
        fields[k] = 0.0
    if count == 0:
        return
    first = fields.shape[0] - carriers
    for e in range(count):
        row = contact.point[e]
        for d in range(3):
            push = contact.active.factor[contact.tool[e]] * contact.push[e, d]
            for a in range(compliance.carriers.shape[1]):
                fields[3 * compliance.carriers[row, a] + d] += compliance.weights[row, a] * push
            for a in range(compliance.members.shape[1]):
                fields[carriers + 3 * compliance.members[row, a] + d] += compliance.shares[row, a] * push
    for i in range(carriers):
        total = 0.0
        for j in range(carriers):
            total += compliance.flexibility[i, j] * fields[j]
        fields[first + i] = total


@kernel_njit(inner=True)
def _compliance_displacement(compliance, row, carriers, fields):
    """Return the displacement (3) [m] of a row under the spread forces, at the secant factor 1."""
    first = fields.shape[0] - carriers
    x, y, z = 0.0, 0.0, 0.0
    for a in range(compliance.carriers.shape[1]):
        k, w = first + 3 * compliance.carriers[row, a], compliance.weights[row, a]
        x, y, z = x + w * fields[k], y + w * fields[k + 1], z + w * fields[k + 2]
    for a in range(compliance.members.shape[1] if compliance.nearby.shape[1] else 0):
        n, w = compliance.members[row, a], compliance.shares[row, a]
        for k in range(compliance.nearby.shape[1] if w != 0.0 else 0):
            at = carriers + 3 * compliance.nearby[n, k]
            for d in range(3):
                push = w * fields[at + d]
                x += compliance.near_field[n, k, 0, d] * push
                y += compliance.near_field[n, k, 1, d] * push
                z += compliance.near_field[n, k, 2, d] * push
    return x, y, z
