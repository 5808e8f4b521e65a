"""Tool control of a session: the selected tool, and the permitted places of tools."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.app.common.rotations import compose_rotations
from palpate.app.recordings.snapshot import ToolSnapshot
from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.geometry import compute_gaps
from palpate.dynamics.contact.grip import grasped_nodes
from palpate.dynamics.contact.overlap import tools_overlap
from palpate.dynamics.contact.shapes import TOOLS, Forceps, Sphere, Tool, make_tool, tool_parameters
from palpate.dynamics.contact.tools import Contact
from palpate.meshfree.cloud import Cloud
from palpate.realtime.bodies.display_surface import DisplaySurface, fixed_nodes, places_at_rest
from palpate.realtime.record import ToolReading

PAGE_SHAPES = ("sphere", "capsule", "grasp", "scalpel")  # which page/src/toolGlyphs.js draws
WORKSPACE_MARGIN = 0.3  # [m] around the body
POINT_RADIUS = 1e-6  # [m] of the point of a blade
DRAWN_FORCEPS_SHARE = 0.3  # of the radius within which forceps hold nodes: of the ball as which they are drawn
END_DISTANCES = (0.0, *np.geomspace(1.0, 4096.0, 13))  # spacings from an end to the centre of the ball that holds it
TINY_LENGTH = 1e-12  # [m]
MAX_PENETRATION = 0.25  # of a vertex into a tool that is put down, as a fraction of the spacing
NO_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class SelectedTool:
    """A tool with the parameters of its message."""

    kind: str  # one of `palpate.app.recordings.snapshot.TOOL_KINDS`
    shape: Tool | None  # None for no tool, or for a group of nodes that the model prescribes
    friction: float = 0.0  # coefficient of friction
    stiffness: float | None = None  # float or None [N/m]: stiffness of the virtual coupling; None for a rigid coupling
    # values of the parameters of all kinds, `palpate.dynamics.contact.shapes.tool_parameters`
    parameters: Mapping[str, float] = field(default_factory=lambda: dict.fromkeys(tool_parameters(), 0.0))

    def describe(self, position: Floats, quaternion: Floats, active: bool) -> dict[str, Any]:
        """Return the description of the tool for the protocol; an inactive one is selected but put away."""
        return {
            "kind": self.kind, "active": active, **self.parameters,
            "outline": drawn_outline({"kind": self.kind, **self.parameters}), "friction": self.friction,
            "stiffness": self.stiffness, "position": [float(x) for x in position],
            "quaternion": [float(x) for x in quaternion],
        }  # fmt: skip


NO_TOOL = SelectedTool("none", None)


@dataclass
class ToolState:
    """The tool of one index: the selected one, the one in the engine, and where that was put down."""

    selected: SelectedTool
    active: SelectedTool  # `NO_TOOL` while it is put away
    origin: Floats  # (3,) array [m], to which the engine's displacements are relative
    rotation: Floats  # (4,) array, to which its rotations are relative
    since: int = 0  # periods of the engine when it was put down or put away
    pinned: bool = False  # whether it stays where it is
    last_pose: float = -math.inf  # [s]: time of the last pose of its user
    epoch: int = 0  # how often it was put down or away: poses of a device are for one of these times

    def describe(self, position: Floats, quaternion: Floats) -> dict[str, Any]:
        """Return the description for the protocol; see `SelectedTool.describe`."""
        active = self.active is self.selected and self.active is not NO_TOOL
        return {**self.selected.describe(position, quaternion, active), "pinned": self.pinned}

    def snapshot(self, acts: bool, reading: ToolReading, displacement: Floats, device_force: Floats) -> ToolSnapshot:
        """Return the snapshot of a tool of the engine, without a force where it does not act on the body yet."""
        force, moment, stiffness = (float(acts) * each for each in (reading.force, reading.moment, reading.stiffness))
        return ToolSnapshot(
            force=force, moment=moment, stiffness=stiffness, position=self.origin + displacement,
            quaternion=compose_rotations(self.rotation, reading.quaternion), sequence=reading.sequence,
            device_force=float(acts) * device_force, kind=self.active.kind, pinned=self.pinned,
        )  # fmt: skip


def drawn_outline(tool: Mapping[str, Any]) -> list[list[float]] | None:
    """Return the outline of the tool of a message, or none where the page has the shape of its kind."""
    if tool["kind"] not in TOOLS or tool["kind"] in PAGE_SHAPES:
        return None
    outline: list[list[float]] = make_tool(tool["kind"], tool).outline.tolist()
    return outline


def selected_tool(contact: Contact) -> SelectedTool:
    """Return the tool of a contact; its shape is one of `TOOLS`."""
    kind = next(name for name, each in TOOLS.items() if type(contact.tool) is each.shape)
    parameters = {name: float(getattr(contact.tool, name, 0.0)) for name in tool_parameters()}
    return SelectedTool(kind, contact.tool, contact.friction, parameters=parameters)


def forceps_of_group(cloud: Cloud, group: str) -> Forceps:
    """Return forceps that hold the nodes of a group, and no others: an end of the body.

    They hold what is in a ball; its centre is the farther outside of the body, the flatter the end.
    """
    nodes, points = cloud.group(group), places_at_rest(cloud)
    centre, everywhere = points[nodes].mean(axis=0), np.ones(len(cloud), dtype=bool)
    outward = centre - points.mean(axis=0)
    outward /= max(float(np.linalg.norm(outward)), TINY_LENGTH)
    for distance in END_DISTANCES:
        point = centre + distance * cloud.spacing * outward
        radius = float(np.linalg.norm(points[nodes] - point, axis=1).max())
        forceps = Forceps(radius, tuple(map(float, point)), np.inf)
        if radius and np.array_equal(grasped_nodes(cloud, forceps, everywhere), np.sort(nodes)):
            return forceps
    raise InputError(f"group must be an end of the body for forceps to hold it alone, got {group!r}; choose another")


def make_forceps(
    surface: DisplaySurface, displacements: Floats, position: Floats, radius: float, end: Forceps | None = None
) -> tuple[Forceps, Floats]:
    """Return forceps that grasp the deformed body, and their position (3,) [m].

    They grasp the vertex nearest to `position` (3,) [m] of the surface with displacements (n, 3) [m], and the nodes
    within `radius` [m] around it, at rest. Near an `end` they are the forceps of that, which hold all of it.
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
    near = np.flatnonzero(np.linalg.norm(places_at_rest(model.cloud) - point, axis=1) <= radius * (1 + 1e-9))
    if fixed_nodes(model)[near].any():
        raise InputError("position of a grasp must be away from the support, got fixed nodes; choose another place")
    if end is not None and (np.linalg.norm(places_at_rest(model.cloud)[near] - end.point, axis=1) <= end.radius).any():
        return end, position
    return Forceps(radius, tuple(point), np.inf), vertices[vertex].astype(float)


def check_clear(points: Floats, tool: Tool, pose: Floats, index: int, other: Tool, shown: ToolSnapshot) -> None:
    """Raise InputError if a tool in a pose (7,) would be in another one of an index, or a second blade."""
    if isinstance(tool, Blade) and isinstance(other, Blade):
        raise InputError(f"tool must be the only scalpel, got a second one; release tool {index} first")
    if _clash(points, tool, pose, other, np.concatenate([shown.position, shown.quaternion])):
        raise InputError(f"tool must be clear of tool {index}, got a position inside it; put it down elsewhere")


def _clash(points: Floats, tool: Tool, pose: Floats, other: Tool, other_pose: Floats) -> bool:
    """Return whether two tools in poses (7,) overlap, or are forceps that hold the same of a body's nodes (n, 3) [m].

    Forceps count as the ball as which they are drawn, and a blade as the points of its edge.
    """
    if isinstance(tool, Forceps) and isinstance(other, Forceps):
        held = [np.linalg.norm(points - each.point, axis=1) <= each.radius for each in (tool, other)]
        if np.any(held[0] & held[1]):
            return True
    if isinstance(other, Blade):
        tool, pose, other, other_pose = other, other_pose, tool, pose
    first, second = (
        Sphere(DRAWN_FORCEPS_SHARE * each.radius) if isinstance(each, Forceps) else each for each in (tool, other)
    )
    if isinstance(first, Blade):
        edge = pose[:3] + Rotation.from_quat(pose[3:], scalar_first=True).apply(np.asarray(first.edge, dtype=float))
        gaps = np.zeros(len(edge))
        compute_gaps(second.kind, np.array(second.sizes), other_pose, edge, gaps)
        return bool(gaps.min() < 0)
    return tools_overlap(first, pose, second, other_pose)


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
