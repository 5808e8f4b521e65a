"""A moment of a body: all that is drawn, told or recorded of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.realtime.row import Period
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.realtime.display_surface import Surface

__all__ = ["STATES", "TOOLS", "UNITS", "Snapshot", "told_scalars", "told_training"]

Floats = NDArray[np.float64]

STATES = ("stopped", "running", "paused", "ran away")
UNITS = {"displacement": ("mm", 1e3), "stress": ("kPa", 1e-3), "pressure": ("kPa", 1e-3)}  # of scalars, and factors
TOOLS = ("none", "sphere", "capsule", "grasp", "group")
MOST = 1e30  # what is shown in place of an infinity
WITHOUT_DENTS = "without the tool's dent"


@dataclass(frozen=True, kw_only=True)
class Snapshot(Period):
    """A period as it is drawn, told or recorded; the tool's place is that in the body's frame.

    Parameters
    ----------
    hand : (3,) array [N]
        Force on the hand: through the virtual coupling, if there is one.
    nodes, forces : (e,) int array, (e, 3) array [N]
        Touched places in the model's skin, and forces on them, for the model's own moduli.
    modulus_ratio : float
        Moduli over the model's own.
    tool : str
        One of `TOOLS`.
    """

    hand: Floats
    nodes: NDArray[np.int64]
    forces: Floats
    modulus_ratio: float
    tool: str

    def displacements(self, surface: Surface) -> NDArray[np.float32]:
        """Return the displacements (n, 3) [m] of a surface's vertices, which are finite."""
        moved = surface.displacements(self.coordinates, self.nodes, self.forces, self.tool == "grasp")
        return np.nan_to_num(moved, nan=0.0, posinf=MOST, neginf=-MOST)

    def scalar(self, surface: Surface, name: str, moved: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return a finite number (n,) for every vertex, displaced by `moved` (n, 3) [m]; see `Surface.scalar`.

        A vertex whose stress is not a number, in a body that is turned inside out, has 0.
        """
        with np.errstate(all="ignore"):
            values = surface.scalar(name, self.coordinates, moved)
            values = values if name == "displacement" else np.float32(self.modulus_ratio) * values
        return np.nan_to_num(values, nan=0.0, posinf=MOST, neginf=-MOST)


def told_scalars(surface: Surface) -> list[dict[str, Any]]:
    """Return what the protocol tells of the scalars of a surface; ``"note"`` says what they leave out."""
    tool_displacements = surface.model.data.compliance is not None
    return [
        {"name": name, "unit": UNITS[name][0], "factor": UNITS[name][1],
         "note": WITHOUT_DENTS if tool_displacements and name != "displacement" else None}
        for name in surface.scalars
    ]  # fmt: skip


def told_training(model: ReducedModel) -> dict[str, Any] | None:
    """Return what the protocol tells of a model's errors on held-out runs; None where there were none."""
    errors = model.report.get("held_out", {}).get("mean", {})
    told = {"force_error": errors.get("reaction"), "displacement_error": errors.get("displacement")}
    return told if errors else None
