"""A blade that cuts tissue.

The edge of a blade holds the tissue ahead of it, up to the force that cuts it,

    F <= (Gamma - G) l,

with the toughness Gamma [J/m^2], the energy G that the front releases per area, and the length l of the edge in the
tissue. At that force the tissue gives way, and the cut advances (`palpate.dynamics.solid.cutting.cut_front`). So a
blade that is pressed first deforms the tissue, and a cut costs Gamma per area: work of the blade, or energy that the
front releases (Atkins, The Science and Engineering of Cutting, 2009). The faces of the cut stay on their sides of the
blade, whose thickness wedges them apart. They slide along it against a shear stress.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field
from typing import ClassVar

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, brief, number_in_range
from palpate.core.parameters import parameter
from palpate.dynamics.contact.kinds import BLADE
from palpate.dynamics.contact.tool_parameters import side_stress, thickness, toughness

BELLY_POINTS, BELLY_SHARE = 13, 0.97  # of a scalpel's edge, and the sine of the angle at its ends


@dataclass(frozen=True)
class Blade(Described):
    """A blade with a cutting edge, for a `Contact`.

    Parameters
    ----------
    edge : (k, 3) sequence [m]
        Points of the cutting edge in the tool's frame, in the plane y = 0. The edge cuts towards -z. The flat of
        the blade is above it, on the side of +z.
    toughness : float [J/m^2]
        Energy that a cut takes per area. Bovine liver: 164 +/- 6 J/m^2 (Gokgol, Basdogan and Canadinc, Medical
        Engineering and Physics 34, 2012).
    friction : float [Pa]
        Shear stress on each side of the blade that slides in the tissue.
    wedge : float [m]
        Thickness of the blade, which wedges the cut apart.
    height : float [m]
        Height of the flat of the blade above the edge.

    Raises
    ------
    InputError
        The edge is not in the plane or has no length, or another number is out of range.

    Examples
    --------
    >>> import palpate as pt
    >>> pt.tools.Blade(edge=[(-0.01, 0, 0), (0.01, 0, 0)], toughness=164.0)
    Blade(edge=2 points, length=20 mm, toughness=164 J/m^2, friction=0 Pa, wedge=0 m, height=20 mm)
    """

    edge: Sequence[Sequence[float]] | Floats = field(repr=False)
    toughness: float = toughness(MISSING)
    friction: float = side_stress()
    wedge: float = thickness()
    height: float = parameter("m", 0.02, "height of the flat of the blade above the edge", above=0.0)
    kind: ClassVar[int] = BLADE
    _public = ()

    def __post_init__(self) -> None:
        try:
            points = np.array(self.edge, dtype=float)
        except (TypeError, ValueError, OverflowError):
            points = np.zeros(0)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.isfinite(points).all():
            raise InputError(f"edge of a Blade must be at least two points (k, 3) [m], got {brief(self.edge)}")
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if not lengths.min() > 0:
            raise InputError(f"edge of a Blade must have a length, got two equal points {points[lengths.argmin()]}")
        if np.abs(points[:, 1]).max() > 1e-6 * lengths.sum():
            raise InputError(f"edge of a Blade must be in the plane y = 0 of its frame, got {brief(self.edge)}")
        if not np.all(np.diff(points[:, 0]) > 0):
            raise InputError(f"edge of a Blade must have ascending x, got {brief(points[:, 0].tolist())}")
        super().__post_init__()

    def _facts(self) -> list[Fact]:
        points = np.asarray(self.edge, dtype=float)
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        return [("edge", f"{len(points)} points", ""), ("length", length, "m"), *super()._facts()]

    @property
    def sizes(self) -> tuple[float, float, float]:
        """Zeros: a blade touches the tissue at its sites only."""
        return 0.0, 0.0, 0.0


@dataclass(frozen=True, kw_only=True)
class Scalpel(Blade):
    """A blade with a round belly, which cuts ahead to both sides."""

    edge: Floats = field(init=False, repr=False)
    height: float = field(init=False, repr=False)
    length: float = parameter("m", help="length of the edge", above=0.0)

    def __post_init__(self) -> None:
        length = number_in_range("length of a Scalpel", self.length, 0.0, open_low=True, unit="m")
        shares = np.linspace(-1.0, 1.0, BELLY_POINTS)
        belly = 1.0 - np.sqrt(1.0 - (BELLY_SHARE * shares) ** 2)
        edge = np.column_stack([0.5 * length * shares, np.zeros(BELLY_POINTS), 0.5 * length * belly])
        object.__setattr__(self, "edge", edge)
        object.__setattr__(self, "height", 0.5 * length)
        super().__post_init__()

    def _facts(self) -> list[Fact]:
        return list(Described._facts(self))
