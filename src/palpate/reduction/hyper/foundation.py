"""Elastic foundations of a reduced body: springs and dashpots to the ground, in generalised coordinates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats
from palpate.dynamics.loads.prepared import LoadSites


class Springs(NamedTuple):
    """Projected springs and dashpots of `palpate.Foundation`.

    Their forces on the basis vectors are -(stiffness a + damping v). The springs are linear, so the
    cost does not depend on the number of nodes.
    """

    stiffness: Floats  # (c, m) [N/m^2 times the units of basis vector and coordinate]; empty without foundations
    damping: Floats  # (c, m)
    highest_squared: float  # [1/s^2] square of the highest frequency of the springs alone
    decay_rate: float  # [1/s] highest decay rate of the dashpots alone

    def of(self, which: NDArray[np.int64]) -> Springs:
        """Return the springs on a subset of the basis vectors."""
        if not self.stiffness.size:
            return self
        stiffness, damping = (np.ascontiguousarray(part[which]) for part in (self.stiffness, self.damping))
        return Springs(stiffness, damping, self.highest_squared, self.decay_rate)


def project_springs(sites: LoadSites, basis_vectors: Floats, mass: Floats) -> Springs:
    """Project the foundations of some loads on basis vectors (c, n, 3).

    The first m of them belong to the coordinates, whose mass matrix is (m, m).
    """
    nodes = sites.foundation_node
    if not len(nodes):
        return Springs(np.zeros((0, 0)), np.zeros((0, 0)), 0.0, 0.0)
    at = basis_vectors[:, nodes].reshape(len(basis_vectors), -1)
    projected = [
        np.ascontiguousarray((at * np.repeat(strength, 3)) @ at[: len(mass)].T)
        for strength in (sites.foundation_spring, sites.foundation_dashpot)
    ]
    largest = [max(float(eigvalsh(part[: len(mass)], mass)[-1]), 0.0) for part in projected]
    return Springs(projected[0], projected[1], *largest)


@kernel_njit(fastmath={"contract"})
def add_spring_forces(springs, a, v, forces):
    """Add the forces of the springs at coordinates a and velocities v to `forces`."""
    if springs.stiffness.shape[0] == 0:
        return
    for j in range(forces.shape[0]):
        for m in range(springs.stiffness.shape[1]):
            forces[j] -= springs.stiffness[j, m] * a[m] + springs.damping[j, m] * v[m]
