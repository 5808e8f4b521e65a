"""Body forces."""

from __future__ import annotations

from dataclasses import dataclass

from palpate.core.describe import Described
from palpate.core.parameters import parameter
from palpate.dynamics.loads.values import Vector, check_vector


@dataclass(frozen=True)
class Gravity(Described):
    """A body force rho g (equation 3).

    Parameters
    ----------
    acceleration : (3,) sequence, or function of time [s] that returns one [m/s^2]

    Raises
    ------
    InputError
        A constant acceleration is not three finite numbers.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> rest = pt.equilibrium(bar, [pt.Gravity()])
    >>> weight = 1000 * cloud.volumes.sum() * 9.81
    >>> bool(abs(rest.reactions["x-"][2] - weight) < 1e-3 * weight)
    True
    """

    acceleration: Vector = parameter("m/s^2", (0.0, 0.0, -9.81), "acceleration of gravity")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_vector(self.acceleration, "acceleration of Gravity")
