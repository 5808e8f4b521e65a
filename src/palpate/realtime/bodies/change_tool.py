"""Change of a tool in contact with a reduced body, between two periods.

It changes arrays of the compiled period, so nothing is allocated or compiled, and the state of the body
remains. The engine must be paused during the change.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.geometry import rotation
from palpate.dynamics.contact.kinds import BONDED, CAPSULE
from palpate.dynamics.contact.tools import Forceps, Tool
from palpate.realtime.bodies.period_data import PeriodData
from palpate.reduction.contact.surface import PAIRS


def change_tool(data: PeriodData, tool: Tool | None, pose: Floats, friction: float, index: int = 0) -> None:
    """Replace a tool of a reduced body; see `palpate.realtime.bodies.model.RealtimeModel`."""
    if isinstance(tool, Blade):
        raise InputError(
            "tool of a reduced model must be another than a Blade, which cuts full bodies; use a full body"
        )
    if isinstance(tool, Forceps):
        refuse_held_nodes(_held_nodes(data, tool, index))
    kind = -1 if tool is None else tool.kind
    sizes = np.zeros(3) if tool is None else np.array(tool.sizes)
    point = np.array(tool.point, dtype=float) if isinstance(tool, Forceps) else np.zeros(3)
    replace_tool(data, index, kind, sizes, friction, point, np.array(pose, dtype=float))


def _held_nodes(data: PeriodData, forceps: Forceps, index: int) -> NDArray[np.bool_]:
    """Return which nodes of the contact surface forceps and other forceps hold, (n,)."""
    points, tools = data.contact_surface.points, data.tools
    held = np.linalg.norm(points - np.asarray(forceps.point, dtype=float), axis=1) <= forceps.radius
    others = np.zeros(len(points), dtype=bool)
    for t in np.flatnonzero(tools.kind == BONDED):
        others |= (t != index) & (np.linalg.norm(points - tools.origins[t], axis=1) <= tools.sizes[t, 0])
    return held & others


def refuse_held_nodes(held: NDArray[np.bool_]) -> None:
    """Refuse forceps if other forceps hold any of their nodes."""
    if held.any():
        raise InputError("point of forceps must be away from other forceps, got nodes that they hold; move the point")


@kernel_njit()
def replace_tool(data, t, kind, sizes, friction, point, pose):
    """Replace tool t by one of a kind at a pose (7,), or by none if the kind is negative.

    `sizes` (3,) [m] are those of its shape, and `point` (3,) [m] the origin of forceps on the body at rest.
    """
    tools, contact = data.tools, data.contact_work
    tools.kind[t] = CAPSULE if kind < 0 else kind
    for i in range(3):
        tools.sizes[t, i] = sizes[i] if kind >= 0 else -np.inf if i == 0 else 0.0  # every point is outside
        tools.origins[t, i] = point[i]
    tools.friction[t] = friction
    contact.force[t], contact.place[t], contact.depth[t] = 0.0, 0.0, 0.0
    contact.busy[t] = True
    contact.numbers[PAIRS] = 0
    rotation(pose, data.home[t])
    for frame in range(tools.path.shape[1]):
        for i in range(3):
            for j in range(3):
                tools.path[t, frame, i, j] = 1.0 if i == j else 0.0
            tools.path[t, frame, i, 3] = data.home[t, i, 3]
    for frame in range(tools.frames.shape[1]):
        rotation(pose, tools.frames[t, frame])
