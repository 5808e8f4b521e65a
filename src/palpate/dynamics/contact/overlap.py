"""Whether two rigid tools are in each other, before either touches a body."""

from __future__ import annotations

import numpy as np

from palpate.core.arrays import Floats
from palpate.dynamics.contact.geometry import compute_gaps, rotation
from palpate.dynamics.contact.kinds import BLADE, BONDED, CAPSULE, PUNCH
from palpate.dynamics.contact.shapes import Tool

AXIS_POINTS, RIM_POINTS = 65, 48  # of the middle of a capsule, and of a section of a punch
PUNCH_SECTIONS = 0.3 * np.linspace(0.0, 1.0, 61)  # [m] above the end of a punch


def tools_overlap(tool: Tool, pose: Floats, other: Tool, other_pose: Floats) -> bool:
    """Return whether two tools in poses (7,) have points in common; False for blades and forceps.

    A ball or capsule is all points within a radius of its axis, and a punch those within its rounding of a smaller
    cylinder. So they are in another tool if points of axis or cylinder are less than that away from it.
    """
    return _reaches(tool, pose, other, other_pose) or _reaches(other, other_pose, tool, pose)


def _reaches(tool: Tool, pose: Floats, other: Tool, other_pose: Floats) -> bool:
    """Return whether the inner points of a tool are nearer to another than its rounding."""
    points, reach = _inner_points(tool)
    if not len(points) or other.kind in (BLADE, BONDED):
        return False
    frame, distances = np.zeros((3, 4)), np.zeros(len(points))
    rotation(pose, frame)
    compute_gaps(other.kind, np.array(other.sizes), other_pose, points @ frame[:, :3].T + frame[:, 3], distances)
    return bool(distances.min() < reach)


def _inner_points(tool: Tool) -> tuple[Floats, float]:
    """Return points (k, 3) [m] in the frame of a tool, and the radius [m] about them that it fills."""
    first, second, third = tool.sizes
    if tool.kind == CAPSULE:
        heights = np.linspace(-second, second, AXIS_POINTS if second > 0.0 else 1)
        return np.column_stack([np.zeros((len(heights), 2)), heights]), first
    if tool.kind == PUNCH:
        angles = np.linspace(0.0, 2.0 * np.pi, RIM_POINTS, endpoint=False)
        rim = (first - third) * np.column_stack([np.cos(angles), np.sin(angles)])
        sections = [np.column_stack([[*rim, (0.0, 0.0)], np.full(len(rim) + 1, z)]) for z in third + PUNCH_SECTIONS]
        return np.concatenate(sections), third
    return np.zeros((0, 3)), 0.0
