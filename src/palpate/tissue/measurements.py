"""Measured stress-deformation curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, brief
from palpate.tissue.homogeneous import rest

MAX_DEFORMATION = 20.0  # stretch or shear, beyond that of tissue and rubber


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement(Described):
    """Measured curve of nominal stress over stretch or shear.

    Parameters
    ----------
    kind : str
        ``"uniaxial"`` (tension, compression or both), ``"equibiaxial"``, ``"planar"`` or
        ``"shear"``.
    deformation : (n,) array
        Stretches, or shears gamma where the kind is ``"shear"``; monotonic, at least two values.
    stress : (n,) array [Pa]
        Force per undeformed area, negative in compression.
    deviation : float or (n,) array, optional [Pa]
        Standard deviation of each stress, or a value proportional to it; 1 Pa by default. Its
        inverse weights the point.
    name, source : str
        Name of the curve in reports, and its origin.

    Raises
    ------
    InputError
        The kind is unknown; arrays differ in length, are not finite or too short; a stretch or
        deviation is not positive; a stretch or shear exceeds 20; deformations are not monotonic or
        all at rest; or all stresses oppose the deformation.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> stretch = np.linspace(1.0, 1.4, 9)
    >>> stress = 2 * 1.1e3 * (stretch - stretch**-2)
    >>> curve = pt.materials.Measurement(kind="uniaxial", deformation=stretch, stress=stress)
    >>> curve.kind, len(curve.stress)
    ('uniaxial', 9)
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
        deformation = _check_column(label, self.deformation)
        stress = _check_column("stress", self.stress, len(deformation))
        deviation = _check_column("deviation", np.broadcast_to(self.deviation, deformation.shape), len(deformation))
        if self.kind != "shear":
            _check_positive("stretch", deformation)
        if np.abs(deformation).max() > MAX_DEFORMATION:
            at = int(np.argmax(np.abs(deformation)))
            allowed = f"[-{MAX_DEFORMATION:g}, {MAX_DEFORMATION:g}]"
            raise InputError(f"{label} must be in {allowed}, got {deformation[at]:g} at point {at + 1}")
        _check_positive("deviation", deviation)
        steps = np.diff(deformation)
        turns = np.flatnonzero(steps * (deformation[-1] - deformation[0]) < 0)
        if len(turns):
            at = turns[0] + 1
            raise InputError(
                f"{label} must be monotonic, got {deformation[at]:g} at point {at + 1} after {deformation[at - 1]:g}; "
                "give loading and unloading as two curves"
            )
        if np.all(deformation == at_rest):
            raise InputError(f"{label} must differ from {at_rest:g}, the value at rest, got only {at_rest:g}")
        work = (deformation - at_rest) * stress
        if np.any(work) and np.all(work <= 0):
            raise InputError(
                "stress must be positive in tension (stretch > 1), got only stresses against the deformation; "
                "change their sign"
            )
        for name, values in (("deformation", deformation), ("stress", stress), ("deviation", deviation)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)


def _range(values: NDArray[np.float64]) -> str:
    return f"{values.min():.3g} to {values.max():.3g}"


def _check_column(name: str, values: ArrayLike, length: int | None = None) -> NDArray[np.float64]:
    try:
        column = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be an array of numbers, got {brief(values)}") from None
    if column.ndim != 1 or len(column) < 2:
        raise InputError(f"{name} must have shape (n,) with at least two points, got {column.shape}")
    if length not in (None, len(column)):
        raise InputError(f"{name} must have {length} points, as the deformation, got {len(column)}")
    if not np.all(np.isfinite(column)):
        at = int(np.flatnonzero(~np.isfinite(column))[0])
        raise InputError(f"{name} must be finite, got {column[at]} at point {at + 1}")
    return column


def _check_positive(name: str, values: NDArray[np.float64]) -> None:
    wrong = np.flatnonzero(values <= 0)
    if len(wrong):
        raise InputError(f"{name} must be in (0, inf), got {values[wrong[0]]:g} at point {wrong[0] + 1}")
