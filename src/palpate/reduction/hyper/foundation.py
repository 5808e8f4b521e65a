"""Foundations of a reduced body: springs and dashpots between its surface and the ground, in its coordinates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh

from palpate.arrays import Floats
from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.loads.prepared import LoadSites

__all__ = ["Springs", "draw_back", "springs_of"]


class Springs(NamedTuple):
    """What `palpate.Foundation` does: forces -(stiffness a + damping v) on the columns of a reduced model.

    The springs are linear, so that their forces are known whatever the body's number of nodes.
    """

    stiffness: Floats  # (c, m) [N/m^2 times the units of column and coordinate]; none where nothing is tied
    damping: Floats  # (c, m)
    square: float  # [1/s^2] of the highest frequency that the springs alone give the body
    rate: float  # [1/s] highest rate at which the dashpots alone slow it

    def of(self, which: NDArray[np.int64]) -> Springs:
        """Return this for some of the columns."""
        if not self.stiffness.size:
            return self
        stiffness, damping = (np.ascontiguousarray(part[which]) for part in (self.stiffness, self.damping))
        return Springs(stiffness, damping, self.square, self.rate)


def springs_of(sites: LoadSites, columns: Floats, mass: Floats) -> Springs:
    """Project the foundations of some loads.

    Parameters
    ----------
    sites : LoadSites
    columns : (c, n, 3) array
        The first m belong to the coordinates.
    mass : (m, m) array
        Of these.
    """
    nodes = sites.foundation_node
    if not len(nodes):
        return Springs(np.zeros((0, 0)), np.zeros((0, 0)), 0.0, 0.0)
    at = columns[:, nodes].reshape(len(columns), -1)
    found = [
        np.ascontiguousarray((at * np.repeat(strength, 3)) @ at[: len(mass)].T)
        for strength in (sites.foundation_spring, sites.foundation_dashpot)
    ]
    largest = [max(float(eigvalsh(part[: len(mass)], mass)[-1]), 0.0) for part in found]
    return Springs(found[0], found[1], *largest)


@kernel_njit(fastmath={"contract"})
def draw_back(springs, a, v, forces):  # type: ignore[no-untyped-def]
    """Add the forces of the springs on the first columns to `forces`, those of coordinates a and velocities v."""
    if springs.stiffness.shape[0] == 0:
        return
    for j in range(forces.shape[0]):
        for m in range(springs.stiffness.shape[1]):
            forces[j] -= springs.stiffness[j, m] * a[m] + springs.damping[j, m] * v[m]
