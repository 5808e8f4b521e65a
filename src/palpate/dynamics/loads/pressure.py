"""Pressures on the deformed face of a body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from palpate.core.arrays import Floats
from palpate.core.describe import Described
from palpate.core.parameters import parameter
from palpate.dynamics.loads.values import scalars_at


@dataclass(frozen=True)
class Pressure(Described):
    """A pressure that follows the deformed face of a group of nodes.

    The nodal forces are -p da, with the area vectors da of the deformed face.

    Parameters
    ----------
    group : str
        Nodes of one face of a solid. On a membrane the face is that of the group's nodes, and its
        normal is +z.
    pressure : float, or function of time [s] [Pa]
        Positive against the outward normal.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> press = pt.Pressure("z+", pressure=200.0)
    >>> rest = pt.equilibrium(block, [press])
    >>> bool(rest.displacements[cloud.group("z+"), 2].max() < 0)
    True
    """

    _public = ()
    group: str
    pressure: float | Callable[[float], float] = parameter("Pa", help="pressure, positive towards the body")

    def values(self, times: Floats) -> Floats:
        """Return the pressure (t,) [Pa] at some times [s]."""
        return scalars_at(self.pressure, times, f"pressure of {type(self).__name__} on {self.group!r}")
