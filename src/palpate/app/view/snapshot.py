"""A moment of a body: all that is drawn, told or recorded of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.reduction.surface import Surface

__all__ = ["STATES", "TOOLS", "UNITS", "Snapshot"]

Floats = NDArray[np.float64]

STATES = ("stopped", "running", "paused", "ran away")
UNITS = {"displacement": ("mm", 1e3), "stress": ("kPa", 1e-3), "pressure": ("kPa", 1e-3)}  # of scalars, and factors
TOOLS = ("none", "sphere", "capsule", "grasp", "group")


@dataclass(frozen=True)
class Snapshot:
    """What is known of one period.

    Parameters
    ----------
    time : float [s]
        Of the body.
    steps : int
        Periods.
    trust : float
        Above 1 the model was not trained on such states.
    force, moment : (3,) arrays [N], [N m]
        Of the body on the tool.
    hand : (3,) array [N]
        Force on the hand: through the virtual coupling, if there is one.
    stiffness : (3, 3) array [N/m]
        Of the contact.
    position, quaternion : (3,) array [m], (4,) array
        Where the tool is in the body's frame, and how it is turned.
    kinetic, strain : float [J]
    computing, lateness : float [s]
    coordinates : (m,) array
    nodes, forces : (e,) int array, (e, 3) array [N]
        Touched places in the model's skin, and forces on them, for the model's own moduli.
    firmness : float
        Moduli over the model's own.
    tool, state : str
        One of `TOOLS` and of `STATES`.
    sequence : int
        Number that the client gave to the pose that was last applied.
    """

    time: float
    steps: int
    trust: float
    force: Floats
    moment: Floats
    hand: Floats
    stiffness: Floats
    position: Floats
    quaternion: Floats
    kinetic: float
    strain: float
    computing: float
    lateness: float
    coordinates: Floats
    nodes: NDArray[np.int64]
    forces: Floats
    firmness: float
    tool: str
    state: str
    sequence: int

    def displacements(self, surface: Surface) -> NDArray[np.float32]:
        """Return the displacements (n, 3) [m] of a surface's vertices."""
        return surface.displacements(self.coordinates, self.nodes, self.forces, self.tool == "grasp")

    def scalar(self, surface: Surface, name: str, moved: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return a number (n,) for every vertex, displaced by `moved` (n, 3) [m]; see `Surface.scalar`."""
        values = surface.scalar(name, self.coordinates, moved)
        return values if name == "displacement" else np.float32(self.firmness) * values
