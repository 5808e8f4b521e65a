"""The functions of an exported library, compiled from the kernels of the engine.

They take arrays of the model's memory and numbers, allocate nothing, and return a status.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.dynamics.compiled.cache import kernel_njit, law_njit
from palpate.dynamics.contact.kinds import BONDED, PLANE
from palpate.realtime.bodies.change_tool import replace_tool
from palpate.realtime.observable import DEVICE_FORCE, TOOL_POSITION
from palpate.realtime.period import (
    CLAMP,
    FAILED,
    IGNORE,
    Settings,
    compile_period,
    functions_digest,
    place_work,
    reset_work,
)
from palpate.realtime.pose import request_pose
from palpate.realtime.record import field_offset
from palpate.reduction.contact.surface import PAIRS
from palpate.reduction.hyper.error_indicator import curve_bound

TAKEN_STATUS, POSE_STATUS, DIVERGED_STATUS, INVALID_STATUS = range(4)
OPTION_NAMES = ("period", "force_limit", "max_speed", "max_angular_speed", "stiffness_every", "on_distrust")
OPTION_PERIOD, FORCE_LIMIT, MAX_SPEED, MAX_ANGULAR_SPEED, STIFFNESS_EVERY, ON_DISTRUST = range(len(OPTION_NAMES))
WORST_TRUST, RECORD_FORCE = field_offset("worst_trust"), field_offset("force")
FORCE_NUMBERS = 15  # of force, moment and stiffness, which follow each other
MIN_PERIOD, MAX_PERIOD = 5e-5, 0.02  # [s]


@kernel_njit(inner=True)
def _is_finite(values):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(values.shape[0]):
        total += 0.0 * values[i]  # 0, or not a number
    return total == 0.0


@cache
def compile_step(advance: Any, stiffness: Any) -> Any:
    """Compile the step of a library around the functions of an observable model.

    Returns
    -------
    function
        ``step(data, work, pose, options, curve, bound)`` takes a period towards a pose (7,), and writes the record and
        the error bound [N] of the force. It returns 0; 1 if the pose is not finite or jumps, and the last one is kept;
        2 if the state has diverged; 3 if an option is not valid.
    """
    take_period = compile_period(advance, stiffness)
    digest, _ = functions_digest(__name__, advance, stiffness)

    @law_njit(digest, cached=False)
    def step(data, work, pose, options, curve, bound):  # type: ignore[no-untyped-def]
        if work.record[FAILED] != 0.0:
            return DIVERGED_STATUS
        if not MIN_PERIOD <= options[OPTION_PERIOD] <= MAX_PERIOD:
            return INVALID_STATUS
        if not (options[FORCE_LIMIT] > 0.0 and options[MAX_SPEED] > 0.0 and options[MAX_ANGULAR_SPEED] > 0.0):
            return INVALID_STATUS
        if not 0.0 <= options[STIFFNESS_EVERY] <= 1e6:
            return INVALID_STATUS
        if options[ON_DISTRUST] != CLAMP and options[ON_DISTRUST] != IGNORE:
            return INVALID_STATUS
        is_taken = request_pose(work.wanted, pose)
        period = options[OPTION_PERIOD]
        settings = Settings(
            int(1e9 * period + 0.5), 0, period * options[MAX_SPEED], period * options[MAX_ANGULAR_SPEED],
            options[FORCE_LIMIT], int(options[STIFFNESS_EVERY]), int(options[ON_DISTRUST]), 0,
        )  # fmt: skip
        valid = take_period(data, work, settings)
        square = 0.0
        for i in range(3):
            square += work.record[RECORD_FORCE + i] ** 2
        bound[0] = curve_bound(curve, work.record[WORST_TRUST], np.sqrt(square))
        if not valid:
            work.record[RECORD_FORCE : RECORD_FORCE + FORCE_NUMBERS] = 0.0  # a device would hold the last one
            return DIVERGED_STATUS
        return TAKEN_STATUS if is_taken else POSE_STATUS

    return step


@kernel_njit(inner=True)
def _rest_tool(data):  # type: ignore[no-untyped-def]
    """Set the tool at the end of the coupling to rest at zero displacement."""
    coupling = data.coupling
    for i in range(3):
        coupling.position[i], coupling.velocity[i], coupling.device[i], coupling.force[i] = 0.0, 0.0, 0.0, 0.0
        data.values[TOOL_POSITION + i], data.values[DEVICE_FORCE + i] = 0.0, 0.0


@kernel_njit()
def reset_model(data, work, rest):  # type: ignore[no-untyped-def]
    """Set body and tool to rest; the tool and the moduli stay."""
    reset_work(work, rest)
    _rest_tool(data)
    return TAKEN_STATUS


@kernel_njit()
def exchange_tool(data, work, kind, sizes, friction, point, pose):  # type: ignore[no-untyped-def]
    """Replace the tool by one of a kind (1,) at a pose (7,), or by none if the kind is negative.

    Later displacements are relative to that pose. Returns 3, and changes nothing, if a number is out of range.
    """
    if data.inner.tools.kind.shape[0] == 0:  # a tool that moves a group
        return INVALID_STATUS
    valid = kind[0] <= BONDED and _is_finite(sizes) and _is_finite(point) and _is_finite(pose) and friction[0] >= 0.0
    square = pose[3] ** 2 + pose[4] ** 2 + pose[5] ** 2 + pose[6] ** 2
    valid = valid and abs(square - 1.0) < 1e-6 and friction[0] < np.inf
    for k in range(3):
        valid = valid and sizes[k] >= 0.0
    if not valid or (kind[0] >= 0 and kind[0] != PLANE and not sizes[0] > 0.0):
        return INVALID_STATUS
    replace_tool(data.inner, kind[0], sizes, friction[0], point, pose)
    for i in range(7):
        work.pose[i] = 1.0 if i == 3 else 0.0
    place_work(work)
    _rest_tool(data)
    return TAKEN_STATUS


@kernel_njit()
def write_vertices(data, q, rest, columns, patch_columns, places, fields, vertices):  # type: ignore[no-untyped-def]
    """Write the positions (n, 3) [m] of the surface: of the modes and, at contact nodes, of the surface compliance.

    `columns` (n, 3, m) are displacements of vertices, `patch_columns` those of the patches that tools meet. `places`
    (n,) are rows of contact nodes, or -1. `fields` (3 c + 3 k + 3 c,) are forces on carriers and on nodes, and
    displacements of carriers.
    """
    inner = data.inner
    compliance, contact, tools = inner.contact_surface.compliance, inner.contact_work, inner.tools
    count, carriers = contact.numbers[PAIRS], compliance.flexibility.shape[0]
    nodes = compliance.members.shape[0] // 2
    bonded = tools.kind.shape[0] > 0 and tools.kind[0] == BONDED
    table = columns if bonded else patch_columns
    factor = 0.0 if count == 0 else compliance.bonded_scale if bonded else contact.factor[0]
    _spread_forces(compliance, contact, count, carriers, fields)
    for i in range(vertices.shape[0]):
        x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
        for m in range(q.shape[0]):
            x += table[i, 0, m] * q[m]
            y += table[i, 1, m] * q[m]
            z += table[i, 2, m] * q[m]
        if places[i] >= 0 and count > 0:
            row = places[i] + nodes if bonded else places[i]
            moved = _compliance_displacement(compliance, row, carriers, fields)
            x, y, z = x + factor * moved[0], y + factor * moved[1], z + factor * moved[2]
        vertices[i, 0], vertices[i, 1], vertices[i, 2] = x, y, z
    return TAKEN_STATUS


@kernel_njit(inner=True)
def _spread_forces(compliance, contact, count, carriers, fields):  # type: ignore[no-untyped-def]
    """Distribute the forces of the pairs to carriers and nodes, and write the displacements of the carriers."""
    for k in range(fields.shape[0]):
        fields[k] = 0.0
    if count == 0:
        return
    first = fields.shape[0] - carriers
    for e in range(count):
        row = contact.point[e]
        for d in range(3):
            push = contact.push[e, d]
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
def _compliance_displacement(compliance, row, carriers, fields):  # type: ignore[no-untyped-def]
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
