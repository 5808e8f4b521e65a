"""How far the tools of a full body may move in a period of the engine, compiled.

A tool moves by at most a share of the spacing in a step. It is held where it would crush tissue that is stiff already,
and where it would pass between the nodes of the surface. Then it follows its target later.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.dynamics.contact.penetration import SLOW_DEPTH, deepest_triangle, way_above_surface
from palpate.dynamics.material.relaxation import copy_values
from palpate.dynamics.nodal.period_data import ESTIMATE, STEP
from palpate.dynamics.nodal.tool_path import END, START, limit_path, limit_to_cut

MAX_MOVING_RATIO = 6.0  # largest frequency over that at rest at which the tool moves on


@kernel_njit(inner=True)
def is_absent(contacts, t):
    """Return True for a tool that no point can be in: a place without a tool, or forceps, which hold nodes."""
    return contacts.tools.sizes[t, 0] == -np.inf


@kernel_njit(inner=True)
def _pushes(tools, t):
    """Return True if a tool moves along its last force on the body."""
    work = 0.0
    for i in range(3):
        work += tools.force[12 * t + i] * (tools.path[t, END, i, 3] - tools.path[t, START, i, 3])
    return work > 0.0


@kernel_njit(inner=True)
def _crushes(data, t):
    """Return True if a tool would move on into tissue that is stiff already."""
    if data.stepping[ESTIMATE] < MAX_MOVING_RATIO * data.body.resting_frequency:
        return False
    return _pushes(data.tools, t)


@kernel_njit(inner=True)
def _hold_above_surface(data, t, u):
    """Hold a tool that pushes on where the surface is so deep in it that it would pass between nodes; slow it before.

    Returns True if the tool's way is shorter, and the depth of the surface over that where the tool is held. The depth
    is 0 where it is far less.
    """
    tools, contacts, limit = data.tools, data.tools.contacts, data.limits.surface_depth
    if contacts.work.active_count[0] == 0 or tools.clear_way[t] > 0.0 or is_absent(contacts, t):
        return False, 0.0
    least = SLOW_DEPTH * limit
    depth = deepest_triangle(contacts, t, tools.path[t, START], data.body.triangles, u, 0.0)[0]
    tools.clear_way[t] = (least - depth) / contacts.patches.gain
    if depth <= least:
        return False, 0.0
    return _pushes(tools, t) and limit_path(tools.path[t], way_above_surface(depth, limit)), depth / limit


@kernel_njit(inner=True)
def choose_paths(data, u, period):
    """Mark the tools that are late, and shorten their paths; return the largest depth of `_hold_above_surface`."""
    tools, limits, deepest = data.tools, data.limits, 0.0
    for t in range(tools.path.shape[0]):
        reach = limits.blade if t == tools.blade else limits.tool
        late = limit_path(tools.path[t], reach * max(1.0, period / data.stepping[STEP]))
        if t == tools.blade:
            late = limit_to_cut(tools.path[t], limits.cut) or late
        if _crushes(data, t):
            stop_tool(tools, t)
            late = True
        held, depth = _hold_above_surface(data, t, u)
        tools.late[t] = 1 if held or late else 0
        deepest = max(deepest, depth)
    return deepest


@kernel_njit(inline="always")
def stop_tool(tools, t):
    """Let a tool stay where it is at the start of the period."""
    copy_values(tools.path[t, START], tools.path[t, END])
