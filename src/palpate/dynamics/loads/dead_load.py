"""Dead loads: fixed patterns of nodal forces with time-dependent amplitudes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cloud import Cloud


class ForcePattern(NamedTuple):
    """Nodal forces of unit amplitudes."""

    nodes: Ints  # (g,) int array: loaded nodes
    forces: Floats  # (g, a, 3) array [N per unit of each amplitude]


class DeadLoad(ABC):
    """A sum of fixed patterns of nodal forces times functions of time.

    Every model supports every dead load. Solids and membranes add its forces, reduced models project
    its patterns, and linear systems use its amplitudes as inputs. A new dead load is a frozen
    dataclass derived from this class.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> isinstance(pull, pt.typing.DeadLoad)
    True
    >>> pull.amplitudes(np.array([0.0, 0.5])).tolist()
    [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]
    """

    group: str

    @property
    @abstractmethod
    def labels(self) -> tuple[str, ...]:
        """Names of the amplitudes, such as ``"force x"``: (a,)."""

    @abstractmethod
    def pattern(self, cloud: Cloud, areas: Floats) -> ForcePattern:
        """Return the nodal forces of unit amplitudes.

        Parameters
        ----------
        cloud : Cloud
        areas : (g, 3) array [m^2]
            Area vectors of the group's nodes.
        """

    @abstractmethod
    def amplitudes(self, times: Floats) -> Floats:
        """Return the amplitudes (t, a) at some times [s]."""
