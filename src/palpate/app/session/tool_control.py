"""Tool control of a session: the selected tool, and the permitted places of tools."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.app.session.messages import Message
from palpate.arrays import Floats
from palpate.dynamics.contact.blade import Blade, scalpel
from palpate.dynamics.contact.geometry import compute_gaps
from palpate.dynamics.contact.tools import Capsule, Contact, Forceps, Sphere, Tool
from palpate.faults import InputError
from palpate.realtime.bodies.display_surface import DisplaySurface, fixed_nodes

__all__ = [
    "NO_ROTATION",
    "NO_TOOL",
    "WORKSPACE_MARGIN",
    "SelectedTool",
    "ToolWorkspace",
    "compose_rotations",
    "make_forceps",
    "selected_tool",
    "tool_shape",
]


WORKSPACE_MARGIN = 0.3  # [m] around the body
POINT_RADIUS = 1e-6  # [m] of the point of a blade
MAX_PENETRATION = 0.25  # of a vertex into a tool that is put down, as a fraction of the spacing
NO_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class SelectedTool:
    """A tool with the parameters of its message.

    Parameters
    ----------
    kind : str
        One of `palpate.app.recordings.snapshot.TOOL_KINDS`.
    shape : Tool or None
        None for no tool, or for a group of nodes that the model prescribes.
    radius, length : float [m]
    friction : float
        Coefficient of friction.
    stiffness : float or None [N/m]
        Stiffness of the virtual coupling; None for a rigid coupling.
    toughness : float or None [J/m^2]
        Of the tissue that a scalpel cuts; None for other tools.
    """

    kind: str
    shape: Tool | None
    radius: float = 0.0
    length: float = 0.0
    friction: float = 0.0
    stiffness: float | None = None
    toughness: float | None = None

    def describe(self, position: Floats, quaternion: Floats, active: bool) -> dict[str, Any]:
        """Return the description of the tool for the protocol; an inactive one is selected but put away."""
        return {
            "kind": self.kind, "active": active, "radius": self.radius, "length": self.length,
            "friction": self.friction, "stiffness": self.stiffness, "toughness": self.toughness,
            "position": [float(x) for x in position],
            "quaternion": [float(x) for x in quaternion],
        }  # fmt: skip


NO_TOOL = SelectedTool("none", None)


def compose_rotations(first: Floats, second: Floats, invert_first: bool = False) -> Floats:
    """Return the quaternion (4,), w x y z, of the second rotation after the first one or its inverse."""
    a, b, c, d = (-first if invert_first else first).tolist()
    a = -a if invert_first else a
    w, x, y, z = second.tolist()
    return np.array(
        [w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
         w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a]
    )  # fmt: skip


def tool_shape(message: Message) -> Tool:
    """Return the sphere, capsule or scalpel of a message of type ``"tool"``."""
    if message["kind"] == "scalpel":
        return scalpel(message["length"], message["toughness"])
    if message["kind"] == "sphere":
        return Sphere(message["radius"])
    return Capsule(message["radius"], message["length"])


def selected_tool(contact: Contact) -> SelectedTool:
    """Return the sphere, capsule or scalpel of a contact."""
    tool = contact.tool
    if isinstance(tool, Blade):
        length = float(np.ptp(np.asarray(tool.edge), axis=0).max())
        return SelectedTool("scalpel", tool, length=length, friction=contact.friction, toughness=tool.toughness)
    if isinstance(tool, Sphere):
        return SelectedTool("sphere", tool, tool.radius, friction=contact.friction)
    assert isinstance(tool, Capsule)
    return SelectedTool("capsule", tool, tool.radius, tool.length, contact.friction)


def make_forceps(
    surface: DisplaySurface, displacements: Floats, position: Floats, radius: float
) -> tuple[Forceps, Floats]:
    """Return forceps that grasp the deformed body, and their position (3,) [m].

    Parameters
    ----------
    displacements : (n, 3) array [m]
        Displacements of the surface.
    position : (3,) array [m]
        The forceps grasp the vertex nearest to this position.
    radius : float [m]
        Radius around the vertex within which nodes are grasped, at rest.
    """
    model = surface.model
    vertices = surface.rest + displacements
    vertex = int(np.argmin(np.linalg.norm(vertices - position, axis=1)))
    distance = float(np.linalg.norm(vertices[vertex] - position))
    limit = max(radius, 2 * model.cloud.spacing)
    if distance > limit:
        raise InputError(
            f"position of a grasp must be within {1e3 * limit:.3g} mm of the surface, got {1e3 * distance:.3g} mm; "
            "choose a point on the surface"
        )
    point = surface.rest[vertex].astype(float)
    near = np.flatnonzero(np.linalg.norm(model.cloud.points - point, axis=1) <= radius * (1 + 1e-9))
    if fixed_nodes(model)[near].any():
        raise InputError("position of a grasp must be away from the support, got fixed nodes; choose another place")
    return Forceps(radius, tuple(point), np.inf), vertices[vertex].astype(float)


class ToolWorkspace:
    """The region around a body in which a tool may be."""

    def __init__(self, surface: DisplaySurface) -> None:
        self.surface = surface
        self.low, self.high = surface.rest.min(axis=0) - WORKSPACE_MARGIN, surface.rest.max(axis=0) + WORKSPACE_MARGIN
        self._max_depth = MAX_PENETRATION * surface.model.cloud.spacing

    def nearest_position(self, position: Floats) -> Floats:
        """Return the nearest position [m] inside the workspace."""
        return np.clip(position, self.low, self.high)

    def is_outside(self, displacements: Floats, tool: Tool, pose: Floats) -> bool:
        """Return whether a tool is outside a body whose vertices have displacements (n, 3) [m]."""
        vertices = np.ascontiguousarray(self.surface.rest + displacements, dtype=float)
        if isinstance(tool, Blade):  # the point of its edge that is deepest
            tool = Sphere(POINT_RADIUS)
        distance = np.zeros(len(vertices))
        compute_gaps(tool.kind, np.array(tool.sizes), pose, vertices, distance)
        if distance.min() < -self._max_depth:
            return False
        nearest = int(np.argmin(distance))
        return bool((pose[:3] - vertices[nearest]) @ self._normal(vertices, nearest) > 0)

    def _normal(self, vertices: Floats, vertex: int) -> Floats:
        """Return an outward normal at a vertex, not normalised."""
        around = self.surface.triangles[(self.surface.triangles == vertex).any(axis=1)]
        a, b, c = (vertices[around[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a).sum(axis=0))
