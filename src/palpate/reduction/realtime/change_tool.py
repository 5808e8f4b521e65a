"""Change of the tool in contact with a reduced body, between two periods.

It changes arrays of the compiled period, so nothing is allocated or compiled, and the state of the body
remains. The engine must be paused during the change.
"""

from __future__ import annotations

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.geometry import rotation
from palpate.dynamics.contact.kinds import CAPSULE
from palpate.dynamics.contact.tools import Forceps, Tool
from palpate.faults import InputError
from palpate.reduction.contact.surface import PAIRS
from palpate.reduction.realtime.period import PeriodData

__all__ = ["change_tool"]


def change_tool(data: PeriodData, tool: Tool | None, pose: Floats, friction: float) -> None:
    """Replace the tool of a reduced body; see `palpate.reduction.realtime.model.RealtimeModel`.

    Raises
    ------
    InputError
        The tool is a blade.
    """
    if isinstance(tool, Blade):
        raise InputError(
            "tool of a reduced model must be another than a Blade, which cuts full bodies; use a full body"
        )
    tools, contact = data.tools, data.contact_work
    tools.kind[0] = CAPSULE if tool is None else tool.kind
    tools.sizes[0] = (-np.inf, 0.0, 0.0) if tool is None else tool.sizes  # every point is outside
    tools.friction[0] = friction
    if isinstance(tool, Forceps):
        tools.origins[0] = tool.point
    contact.force[:], contact.place[:], contact.busy[:] = 0.0, 0.0, True
    contact.numbers[PAIRS] = 0
    rotation(pose, data.home)
    tools.path[:] = np.eye(3, 4)
    tools.path[:, :, 3] = data.home[:, 3]
    for frame in tools.frames[0]:
        rotation(pose, frame)
