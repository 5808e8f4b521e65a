"""Snapshot of a session: the results of one period that are drawn, sent, and recorded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.dynamics.contact.shapes import TOOLS
from palpate.realtime.record import PERIOD_FIELDS, Field, PeriodRecord

if TYPE_CHECKING:
    from palpate.dynamics.nodal.model import NodalModel
    from palpate.realtime.bodies.display_surface import DisplaySurface
    from palpate.reduction.hyper.model import ReducedModel


ENGINE_STATES = ("stopped", "running", "paused", "diverged")
SNAPSHOT_FIELDS = PERIOD_FIELDS | {
    field.name: field
    for field in (
        Field("device_force", "N", (3,)),
        Field("kind", type="|u1"),
        Field("pinned", type="|b1"),
        Field("state", type="|u1"),
        Field("low"),  # ends of the range of colours, in frames
        Field("high"),
    )
}
FIELD_UNITS = {
    "displacement": ("mm", 1e3),
    "stress": ("kPa", 1e-3),
    "pressure": ("kPa", 1e-3),
}  # display unit, factor from SI
USER_KINDS = list(TOOLS)
TOOL_KINDS = ("none", *USER_KINDS[:3], "group", *USER_KINDS[3:])  # their indices are in recordings and frames
MAX_FINITE = 1e30  # replaces infinities
MODES_ONLY = "excludes the local indentation at the tool"


@dataclass(frozen=True, kw_only=True)
class ToolSnapshot:
    """One tool in one period; its position is in the body's frame."""

    force: Floats  # (3,) array [N]: of the body on the tool, and its moment (3,) [N m]
    moment: Floats
    stiffness: Floats  # (3, 3) array [N/m]: contact stiffness
    position: Floats  # (3,) array [m]
    quaternion: Floats  # (4,) array, w x y z
    sequence: int  # of the newest pose that the period used
    # (3,) array [N]: force on the haptic device, transmitted by the virtual coupling if there is one
    device_force: Floats
    kind: str  # one of `TOOL_KINDS`
    pinned: bool = False  # whether it stays where it is


@dataclass(frozen=True, kw_only=True)
class Snapshot(PeriodRecord):
    """Results of one period."""

    # contact_nodes, contact_forces, contact_tools: (e,) int array, (e, 3) array [N], (e,) int array: contact nodes of
    # the model's contact surface, the forces on them for the model's own moduli, and the indices of their tools
    contact_nodes: NDArray[np.int64]
    contact_forces: Floats
    contact_tools: NDArray[np.int64]
    modulus_ratio: float  # moduli relative to the model's own
    tools: tuple[ToolSnapshot, ...]  # at least one, by index

    @property
    def largest_force(self) -> float:
        """The largest force on a tool [N]."""
        return max(float(np.linalg.norm(tool.force)) for tool in self.tools)

    def displacements(self, surface: DisplaySurface) -> NDArray[np.float32]:
        """Return finite displacements (n, 3) [m] of a surface's vertices."""
        bonded = np.array([tool.kind == "grasp" for tool in self.tools])[self.contact_tools]
        displacements = surface.displacements(
            self.coordinates, self.contact_nodes, self.contact_forces, bonded, self.contact_tools
        )
        return np.nan_to_num(displacements, nan=0.0, posinf=MAX_FINITE, neginf=-MAX_FINITE)

    def scalar(self, surface: DisplaySurface, name: str, displacements: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return a finite scalar (n,) at every vertex, given the displacements (n, 3) [m]; see `Surface.scalar`.

        The scalar is 0 at a vertex with an undefined stress, which occurs in an inverted body.
        """
        with np.errstate(all="ignore"):
            values = surface.scalar(name, self.coordinates, displacements)
            values = values if name == "displacement" else np.float32(self.modulus_ratio) * values
        return np.nan_to_num(values, nan=0.0, posinf=MAX_FINITE, neginf=-MAX_FINITE)


class OverlayState(NamedTuple):
    """Positions (n, 3) [m] of the full model's vertices, and the force (3,) [N] on its tool."""

    positions: NDArray[np.float32]
    force: Floats


def scalar_descriptions(surface: DisplaySurface) -> list[dict[str, Any]]:
    """Return the descriptions of a surface's scalars for `hello`.

    ``"signed"`` states whether a scalar has both signs, and ``"note"`` what it excludes.
    """
    local = not surface.local_indentation
    return [
        {"name": name, "unit": FIELD_UNITS[name][0], "factor": FIELD_UNITS[name][1], "signed": name == "pressure",
         "note": MODES_ONLY if local and name != "displacement" else None}
        for name in surface.scalars
    ]  # fmt: skip


def training_errors(model: ReducedModel | NodalModel) -> dict[str, Any] | None:
    """Return a model's mean errors on held-out runs, the largest error indicator with a bound, and advice; or None.

    The advice is None if the errors are not large. Without held-out runs there is nothing to return.
    """
    from palpate.reduction.hyper.error_indicator import bound_curve
    from palpate.reduction.hyper.model import ReducedModel

    if not isinstance(model, ReducedModel):
        return None
    errors = model.report.get("held_out", {}).get("mean", {})
    if not errors:
        return None
    described = {"force_error": errors.get("reaction"), "displacement_error": errors.get("displacement")}
    curve = bound_curve(model.report)
    return described | {"largest_trust": curve[3] if curve.any() else 1.0, "advice": model.report.get("advice")}
