"""The hand in a session: which tool it holds, and where that may be put."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.view.messages import Message
from palpate.dynamics.contact.geometry import gaps
from palpate.dynamics.contact.tools import Capsule, Forceps, Sphere, Tool
from palpate.faults import InputError
from palpate.reduction.realtime.display_surface import Surface

__all__ = ["UNTURNED", "Held", "Outside", "forceps", "shape", "turned"]

Floats = NDArray[np.float64]

ROOM = 0.3  # [m] around the body in which a tool may be
SUNK = 0.25  # of the spacing: how far inside a tool a vertex may be when the tool is put down
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Held:
    """A tool and what was said of it.

    Parameters
    ----------
    kind : str
        One of `palpate.app.view.snapshot.TOOLS`.
    shape : Tool or None
        None for a group that the model holds itself.
    radius, length : float [m]
    friction : float
    stiffness : float or None [N/m]
        Of the virtual coupling; None where the tool is held firmly.
    """

    kind: str
    shape: Tool | None
    radius: float = 0.0
    length: float = 0.0
    friction: float = 0.0
    stiffness: float | None = None

    def described(self, position: Floats, quaternion: Floats, held: bool) -> dict[str, Any]:
        """Return what the protocol tells of a tool that is held or not."""
        return {
            "kind": self.kind, "held": held, "radius": self.radius, "length": self.length, "friction": self.friction,
            "stiffness": self.stiffness, "position": [float(x) for x in position],
            "quaternion": [float(x) for x in quaternion],
        }  # fmt: skip


def turned(first: Floats, then: Floats, back: bool = False) -> Floats:
    """Return the quaternion (4,), w x y z, of one turn after another, the first one undone if `back`."""
    a, b, c, d = (-first if back else first).tolist()
    a = -a if back else a
    w, x, y, z = then.tolist()
    return np.array(
        [w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
         w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a]
    )  # fmt: skip


def shape(message: Message) -> Tool:
    """Return the shape that a message of type ``"tool"`` asks for, unless it is a grasp."""
    if message["kind"] == "sphere":
        return Sphere(message["radius"])
    return Capsule(message["radius"], message["length"])


def forceps(surface: Surface, moved: Floats, position: Floats, radius: float) -> tuple[Forceps, Floats]:
    """Return forceps that hold the body at a place of its surface as it is now, and where they are then.

    Parameters
    ----------
    surface : Surface
    moved : (n, 3) array [m]
        Its displacements.
    position : (3,) array [m]
        The vertex nearest to it is grasped.
    radius : float [m]
        Of the nodes that are held, at rest.

    Raises
    ------
    InputError
        The place is not near the surface, or what is near it is fixed.
    """
    model = surface.model
    here = surface.rest + moved
    vertex = int(np.argmin(np.linalg.norm(here - position, axis=1)))
    off = float(np.linalg.norm(here[vertex] - position))
    if off > max(radius, 2 * model.cloud.spacing):
        raise InputError(f"grasp: the surface is {1e3 * off:.3g} mm from there; take hold of it where it is")
    point = surface.rest[vertex].astype(float)
    near = np.flatnonzero(np.linalg.norm(model.cloud.points - point, axis=1) <= radius * (1 + 1e-9))
    fixed = [model.cloud.group(name) for name in model.fixed]
    if fixed and np.isin(near, np.concatenate(fixed)).any():
        raise InputError("grasp: the tissue there is held by its support; take hold of another place")
    return Forceps(radius, tuple(point), np.inf), here[vertex].astype(float)


class Outside:
    """Tells whether a tool is outside of a body, and where a tool may be at all.

    Parameters
    ----------
    surface : Surface
    """

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.low, self.high = surface.rest.min(axis=0) - ROOM, surface.rest.max(axis=0) + ROOM
        self._slack = SUNK * surface.model.cloud.spacing

    def limited(self, position: Floats) -> Floats:
        """Return the nearest place [m] at which a tool may be."""
        return np.clip(position, self.low, self.high)

    def tells(self, moved: Floats, tool: Tool, pose: Floats) -> bool:
        """Return whether a tool is outside of the body, whose vertices are displaced by (n, 3) [m]."""
        here = np.ascontiguousarray(self.surface.rest + moved, dtype=float)
        depth = np.zeros(len(here))
        gaps(tool.kind, np.array(tool.sizes), pose, here, depth)
        if depth.min() < -self._slack:
            return False
        nearest = int(np.argmin(depth))
        return bool((pose[:3] - here[nearest]) @ self._normal(here, nearest) > 0)

    def _normal(self, here: Floats, vertex: int) -> Floats:
        """Return the outward normal at a vertex, of any length."""
        around = self.surface.triangles[(self.surface.triangles == vertex).any(axis=1)]
        a, b, c = (here[around[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a).sum(axis=0))
