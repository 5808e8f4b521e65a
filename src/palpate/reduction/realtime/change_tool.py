"""Another tool in the hand that touches a reduced body, between two periods.

It changes arrays that the compiled period reads, so that nothing is made or compiled anew and the body stays in the
state in which it is. The engine must be paused meanwhile.
"""

from __future__ import annotations

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.geometry import rotation
from palpate.dynamics.contact.tools import CAPSULE, Forceps, Tool
from palpate.reduction.realtime.model import RealtimeModel
from palpate.reduction.realtime.period import PeriodData

__all__ = ["change_tool"]


def change_tool(model: RealtimeModel, tool: Tool | None, pose: Floats, friction: float = 0.0) -> None:
    """Give a body in real time another tool; what the last one did to it ends.

    Parameters
    ----------
    model : RealtimeModel
        Made with a tool that touches the body.
    tool : Sphere, Capsule, Plane, Punch, Forceps or None
        None for one that touches nothing.
    pose : (7,) array
        Where the tool is: a position [m] and a unit quaternion. From now on displacements are from there.
    friction : float
        Coulomb's coefficient.
    """
    data: PeriodData = model.data
    tools, contact_state = data.tools, data.contact_state
    tools.kind[0] = CAPSULE if tool is None else tool.kind
    tools.sizes[0] = (-np.inf, 0.0, 0.0) if tool is None else tool.sizes  # all the world is outside of it
    tools.friction[0] = friction
    if isinstance(tool, Forceps):
        tools.origins[0] = tool.point
    contact_state.force[:], contact_state.place[:], contact_state.busy[:], contact_state.numbers[0] = 0.0, 0.0, True, 0
    data.home[:] = pose[:3]
    for frame in tools.frames[0]:
        rotation(pose, frame)
