"""Dead loads: nodal forces of fixed patterns whose amplitudes depend on time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from palpate.arrays import Floats, Ints
from palpate.meshfree.cloud import Cloud

__all__ = ["DeadLoad", "ForcePattern"]


class ForcePattern(NamedTuple):
    """The nodal forces of unit amplitudes.

    Parameters
    ----------
    nodes : (g,) int array
        Nodes on which the load acts.
    forces : (g, a, 3) array [N per unit of each amplitude]
    """

    nodes: Ints
    forces: Floats


class DeadLoad(ABC):
    """A load whose nodal forces are sums of fixed patterns times functions of time.

    Every model takes every dead load: solids and membranes add its forces, reduced models project its patterns, and
    linear systems have its amplitudes as inputs. A new dead load is a frozen dataclass that derives from this one.
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
