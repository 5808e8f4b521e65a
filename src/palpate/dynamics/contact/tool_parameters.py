"""Parameters that tools share with scene files, declared once."""

from __future__ import annotations

from typing import Any

from palpate.core.parameters import parameter

LIGHT_TOUGHNESS = 20.0  # [J/m^2], which lets soft tissue be cut before it is dragged far


def friction(default: float, high: float = float("inf")) -> Any:
    """Return the field of Coulomb's coefficient mu of sticking and sliding."""
    return parameter("", default, "Coulomb's coefficient", low=0.0, high=high)


def toughness(default: Any = LIGHT_TOUGHNESS) -> Any:
    """Return the field of the energy that a cut takes per area [J/m^2]; MISSING for one that must be given.

    Bovine liver: 164 +/- 6 J/m^2 (Gokgol, Basdogan and Canadinc, Medical Engineering and Physics 34, 2012).
    """
    return parameter("J/m^2", default, "energy of a cut per area: 164 of bovine liver", low=0.0, high=1e4)


def thickness() -> Any:
    """Return the field of the thickness of a blade [m], which wedges the cut apart."""
    return parameter("m", 0.0, "thickness of the blade", low=0.0, high=0.1)


def side_stress() -> Any:
    """Return the field of the shear stress [Pa] on each side of a blade that slides in the tissue."""
    return parameter("Pa", 0.0, "friction on each side of the blade", low=0.0, high=1e6)
