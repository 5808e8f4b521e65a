"""A curve that a testing machine has measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.describe import Described, Fact
from palpate.faults import InputError
from palpate.tissue.homogeneous import rest

__all__ = ["Measurement"]

MOST = 20.0  # a stretch or shear, beyond any tissue's and rubber's


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement(Described):
    """A measured curve of nominal stress over stretch or shear.

    Parameters
    ----------
    kind : str
        ``"uniaxial"`` (tension, compression or both), ``"equibiaxial"``, ``"planar"`` or ``"shear"``.
    deformation : (n,) array
        Stretches; shears gamma where the kind is ``"shear"``. Never turning back, at least two values.
    stress : (n,) array [Pa]
        Force per undeformed area, negative in compression.
    deviation : float or (n,) array, optional [Pa]
        Standard deviation of each stress, or in proportion to it; 1 Pa if left out. Points count by its inverse.
    name, source : str
        What a report calls the curve, and where it comes from.

    Raises
    ------
    InputError
        An unknown kind; arrays of unequal length, not finite or too short; a stretch or deviation not positive;
        a stretch or shear beyond 20; deformations that turn back, or are all at rest; stresses against the
        deformation throughout.
    """

    kind: str
    deformation: NDArray[np.float64]
    stress: NDArray[np.float64]
    deviation: NDArray[np.float64] | float = 1.0
    name: str = ""
    source: str = ""

    def _facts(self) -> list[Fact]:
        return [
            ("name", self.name or None, ""),
            ("kind", self.kind, ""),
            ("points", len(self.stress), ""),
            ("shear" if self.kind == "shear" else "stretch", _range(self.deformation), ""),
            ("stress", (float(self.stress.min()), float(self.stress.max())), "Pa"),
            ("source", self.source or None, ""),
        ]

    def __post_init__(self) -> None:
        at_rest = rest(self.kind)
        label = "shear" if self.kind == "shear" else "stretch"
        deformation = _column(label, self.deformation)
        stress = _column("stress", self.stress, len(deformation))
        deviation = _column("deviation", np.broadcast_to(self.deviation, deformation.shape), len(deformation))
        if self.kind != "shear":
            _positive("stretch", deformation)
        if np.abs(deformation).max() > MOST:
            at = int(np.argmax(np.abs(deformation)))
            raise InputError(
                f"{label} = {deformation[at]:g} at point {at + 1} is out of range: allowed is up to {MOST:g}"
            )
        _positive("deviation", deviation)
        steps = np.diff(deformation)
        turns = np.flatnonzero(steps * (deformation[-1] - deformation[0]) < 0)
        if len(turns):
            at = turns[0] + 1
            raise InputError(
                f"{label} = {deformation[at]:g} at point {at + 1} turns back after {deformation[at - 1]:g}: "
                "a curve goes one way; give loading and unloading as two"
            )
        if np.all(deformation == at_rest):
            raise InputError(f"every {label} is {at_rest:g}, rest: nothing was deformed")
        work = (deformation - at_rest) * stress
        if np.any(work) and np.all(work <= 0):
            raise InputError(
                "the stresses act against the deformation: stress is positive in tension, where stretch > 1"
            )
        for name, values in (("deformation", deformation), ("stress", stress), ("deviation", deviation)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)


def _range(values: NDArray[np.float64]) -> str:
    return f"{values.min():.3g} to {values.max():.3g}"


def _column(name: str, values: ArrayLike, length: int | None = None) -> NDArray[np.float64]:
    try:
        column = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be an array of numbers, not {values!r}") from None
    if column.ndim != 1 or len(column) < 2:
        raise InputError(f"{name} has the shape {column.shape}: allowed is (n,) with at least two points")
    if length not in (None, len(column)):
        raise InputError(f"{name} has {len(column)} points, the deformation {length}: give as many")
    if not np.all(np.isfinite(column)):
        at = int(np.flatnonzero(~np.isfinite(column))[0])
        raise InputError(f"{name} = {column[at]} at point {at + 1} is out of range: allowed are finite numbers")
    return column


def _positive(name: str, values: NDArray[np.float64]) -> None:
    wrong = np.flatnonzero(values <= 0)
    if len(wrong):
        raise InputError(f"{name} = {values[wrong[0]]:g} at point {wrong[0] + 1} is out of range: allowed is (0, inf)")
