"""Generalised forces: loads and rigid tools projected on the basis vectors of a reduced model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import LoadSites, PreparedLoads
from palpate.reduction.hyper.foundation import Springs, project_springs

__all__ = ["GeneralisedForces", "generalised_forces", "load_work", "pose_map"]


class GeneralisedForces(NamedTuple):
    """Projected loads."""

    prepared: PreparedLoads
    work: Floats  # (g a + 3, c) work of unit loads, see `load_work`
    springs: Springs  # on all basis vectors
    coordinate_springs: Springs  # on the coordinates only

    def at(self, times: Floats) -> Floats:
        """Return the generalised forces (t, c) of surface forces and gravity at some times."""
        schedule, count = self.prepared.schedule(times), len(times)
        values = (schedule.amplitudes.reshape(count, -1), schedule.gravity)
        return np.asarray(np.hstack(values) @ self.work)


def generalised_forces(
    prepared: PreparedLoads, basis_vectors: Floats, masses: Floats, mass: Floats
) -> GeneralisedForces:
    """Project loads on basis vectors (c, n, 3), the first m of which have a mass matrix (m, m)."""
    springs = project_springs(prepared.sites, basis_vectors, mass)
    work = load_work(prepared.sites, basis_vectors, masses)
    return GeneralisedForces(prepared, work, springs, springs.of(np.arange(len(mass))))


def load_work(sites: LoadSites, basis_vectors: Floats, masses: Floats) -> Floats:
    """Return the work (g a + 3, m) of unit amplitudes of g dead loads and of unit gravity on (m, n, 3) vectors."""
    works = []
    for g in range(len(sites.dead_start) - 1):
        own = slice(sites.dead_start[g], sites.dead_start[g + 1])
        works.append(np.einsum("kac,mkc->am", sites.dead_pattern[own], basis_vectors[:, sites.dead_node[own]]))
    return np.concatenate([*works, np.einsum("n,mnc->cm", masses, basis_vectors)])


def pose_map(points: Floats, basis_vectors: Floats) -> Floats:
    """Return the map (l, 12) from a pose to coordinates of lifting vectors (l, k, 3); see `tool_map`."""
    arms, fields = points - points.mean(axis=0), np.zeros((12, len(points), 3))
    for c in range(3):
        fields[c, :, c] = 1.0
        for d in range(arms.shape[1]):
            fields[3 + 3 * c + d, :, c] = arms[:, d]
    return np.asarray(
        np.linalg.lstsq(basis_vectors.reshape(len(basis_vectors), -1).T, fields.reshape(12, -1).T, rcond=None)[0]
    )
