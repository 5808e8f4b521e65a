"""Shapes of rigid tools, and the table of those that a user of a session selects.

A shape is described in the tool's own frame. The compiled step requires its kind and its sizes. Distances are in
`palpate.dynamics.contact.geometry`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described
from palpate.core.faults import number_in_range
from palpate.core.parameters import parameter
from palpate.dynamics.contact.blade import Blade, Scalpel
from palpate.dynamics.contact.kinds import BONDED, CAPSULE, PLANE, PUNCH
from palpate.dynamics.contact.tool_parameters import LIGHT_TOUGHNESS

__all__ = ["Blade", "Capsule", "Forceps", "Plane", "Punch", "Sphere"]  # the public shapes

OUTLINE_POINTS = 96  # even, so that none is on the cylinder
ROUNDING_RADII = 0.05  # default rounding of a punch's edge, in its radii


@dataclass(frozen=True)
class Sphere(Described):
    """A ball around the tool's origin.

    Parameters
    ----------
    radius : float [m]

    Raises
    ------
    InputError
        The radius is not positive.

    Examples
    --------
    >>> import palpate as pt
    >>> pt.tools.Sphere(radius=0.01)
    Sphere(radius=10 mm)
    """

    radius: float = parameter("m", help="radius of the ball", above=0.0)
    kind: ClassVar[int] = CAPSULE
    _public = ()

    @property
    def sizes(self) -> tuple[float, float, float]:
        """Radius, half length and rounding [m]."""
        return self.radius, 0.0, 0.0

    @property
    def outline(self) -> Floats:
        """Radius and height [m] of points of the surface of revolution around z, (k, 2), by which it is drawn."""
        return _rounded_outline(self.radius, 0.0)


@dataclass(frozen=True)
class Capsule(Described):
    """A cylinder along the tool's z axis with hemispherical ends, centred at the tool's origin.

    Parameters
    ----------
    radius, length : float [m]
        Of the cylinder, without the ends.

    Raises
    ------
    InputError
        A size is not positive.

    Examples
    --------
    >>> import palpate as pt
    >>> pt.tools.Capsule(radius=0.004, length=0.03)
    Capsule(radius=4 mm, length=30 mm)
    """

    radius: float = parameter("m", help="radius of the cylinder", above=0.0)
    length: float = parameter("m", help="length of the cylinder", above=0.0)
    kind: ClassVar[int] = CAPSULE
    _public = ()

    @property
    def sizes(self) -> tuple[float, float, float]:
        """Radius, half length and rounding [m]."""
        return self.radius, 0.5 * self.length, 0.0

    @property
    def outline(self) -> Floats:
        """As for `Sphere`."""
        return _rounded_outline(self.radius, 0.5 * self.length)


@dataclass(frozen=True)
class Plane(Described):
    """The half-space z < 0 of the tool's frame, with normal +z.

    Examples
    --------
    >>> import palpate as pt
    >>> lid = pt.tools.Contact(pt.tools.Plane(), ((0, 0, 0.02), (3.14159265, 0, 0)))  # normal -z
    >>> lid.tool
    Plane()
    """

    kind: ClassVar[int] = PLANE
    _public = ()

    @property
    def sizes(self) -> tuple[float, float, float]:
        """Zeros: a plane has no size."""
        return 0.0, 0.0, 0.0


@dataclass(frozen=True)
class Punch(Described):
    """A semi-infinite cylinder z > 0 with a flat end at the tool's origin that faces -z.

    Parameters
    ----------
    radius : float [m]
    rounding : float, optional [m]
        Radius of the edge's rounding; by default a twentieth of the radius.

    Raises
    ------
    InputError
        The radius is not positive, or the rounding is negative or larger than the radius.

    Examples
    --------
    >>> import palpate as pt
    >>> pt.tools.Punch(radius=0.01, rounding=0.001)
    Punch(radius=10 mm, rounding=1 mm)
    """

    radius: float = parameter("m", help="radius of the cylinder", above=0.0)
    rounding: float | None = parameter("m", None, "radius of the edge's rounding", low=0.0)
    kind: ClassVar[int] = PUNCH
    _public = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        rounding = ROUNDING_RADII * self.radius if self.rounding is None else self.rounding
        number_in_range("rounding of a Punch", rounding, 0.0, self.radius, unit="m", remedy="give at most the radius")
        object.__setattr__(self, "rounding", rounding)

    @property
    def sizes(self) -> tuple[float, float, float]:
        """Radius, half length and rounding [m]."""
        return self.radius, 0.0, float(self.rounding or 0.0)


@dataclass(frozen=True)
class Forceps(Described):
    """Forceps as a tool of the engine, or of a `Grasp` on a reduced model: bonded to the surface nodes near a point.

    Parameters
    ----------
    radius : float [m]
    point : (3,) sequence [m]
        Centre at rest.
    until : float [s]
        Time of release; in the engine forceps are released by a change of the tool.

    Examples
    --------
    >>> import palpate as pt
    >>> pt.tools.Forceps(radius=0.006, point=(0.015, 0.015, 0.015))
    Forceps(radius=6 mm, point=(15, 15, 15) mm)
    """

    radius: float = parameter("m", help="radius around the point", above=0.0)
    point: Sequence[float] = parameter("m", help="centre at rest")
    until: float = parameter("s", np.inf, "time of release", low=0.0)
    kind: ClassVar[int] = BONDED
    _public = ()

    @property
    def sizes(self) -> tuple[float, float, float]:
        """Radius [m] and zeros."""
        return self.radius, 0.0, 0.0


def _rounded_outline(radius: float, half: float) -> Floats:
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, OUTLINE_POINTS)
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles) + np.where(angles > 0, half, -half)])


Tool = Sphere | Capsule | Plane | Punch | Forceps | Blade


class ToolKind(NamedTuple):
    """A tool that a user of a session selects: its class, and usual values of the parameters that the user sets."""

    shape: type[Tool]
    usual: Mapping[str, float]


# by the name in messages and recordings; their order is kept in recordings, so that a new kind is the last one
TOOLS: dict[str, ToolKind] = {
    "sphere": ToolKind(Sphere, {"radius": 0.015}),
    "capsule": ToolKind(Capsule, {"radius": 0.015, "length": 0.04}),
    "grasp": ToolKind(Forceps, {"radius": 0.015}),
    "scalpel": ToolKind(Scalpel, {"length": 0.04, "toughness": LIGHT_TOUGHNESS}),
}


def tool_parameters() -> dict[str, tuple[Mapping[str, Any], float]]:
    """Return the declaration and the usual value of each parameter of `TOOLS`, by its name."""
    return {
        name: (kind.shape.__dataclass_fields__[name].metadata, usual)
        for kind in reversed(TOOLS.values())
        for name, usual in kind.usual.items()
    }


def make_tool(kind: str, values: Mapping[str, Any]) -> Any:
    """Return the tool of a kind of `TOOLS` from values by name; others are left out."""
    return TOOLS[kind].shape(**{name: values[name] for name in TOOLS[kind].usual})
