"""What loads and rigid tools do on the columns of a reduced model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import LoadSites, PreparedLoads
from palpate.dynamics.run.model import State
from palpate.reduction.hyper.foundation import Springs, springs_of

__all__ = ["GeneralisedForces", "generalised_forces", "load_forces", "load_work", "pose_map"]


class GeneralisedForces(NamedTuple):
    """What the loads of a drive do on the columns."""

    prepared: PreparedLoads
    work: Floats  # (g a + 3, c), see `load_work`
    springs: Springs  # on all columns
    own: Springs  # on the coordinates

    def at(self, times: Floats) -> Floats:
        """Return the generalised forces (t, c) of tractions and gravity at some times."""
        schedule, count = self.prepared.schedule(times), len(times)
        values = (schedule.amplitudes.reshape(count, -1), schedule.gravity)
        return np.asarray(np.hstack(values) @ self.work)


def generalised_forces(prepared: PreparedLoads, columns: Floats, masses: Floats, mass: Floats) -> GeneralisedForces:
    """Work out what the loads of a drive do on columns (c, n, 3), the first of which have a mass matrix (m, m)."""
    springs = springs_of(prepared.sites, columns, mass)
    work = load_work(prepared.sites, columns, masses)
    return GeneralisedForces(prepared, work, springs, springs.of(np.arange(len(mass))))


def load_work(sites: LoadSites, columns: Floats, masses: Floats) -> Floats:
    """Return the work of unit amplitudes of the g dead loads, and of unit gravity, on columns (m, n, 3): (g a + 3, m)."""
    works = []
    for g in range(len(sites.dead_start) - 1):
        own = slice(sites.dead_start[g], sites.dead_start[g + 1])
        works.append(np.einsum("kac,mkc->am", sites.dead_pattern[own], columns[:, sites.dead_node[own]]))
    return np.concatenate([*works, np.einsum("n,mnc->cm", masses, columns)])


def load_forces(prepared: PreparedLoads, masses: Floats, columns: Floats, state: State) -> Floats:
    """Forces [N] of tractions, gravity and springs on the nodes in a state of a reduced model, shape (n, 3)."""
    sites, schedule = prepared.sites, prepared.schedule(np.array([state.time]))
    result = np.asarray(masses[:, None] * schedule.gravity[0])
    for g in range(len(sites.dead_start) - 1):
        own = slice(sites.dead_start[g], sites.dead_start[g + 1])
        forces = np.einsum("kac,a->kc", sites.dead_pattern[own], schedule.amplitudes[0, g])
        np.add.at(result, sites.dead_node[own], forces)
    at = columns[: len(state.coordinates), sites.foundation_node]
    moved, speed = np.tensordot(state.coordinates, at, 1), np.tensordot(state.velocities, at, 1)
    drawn = sites.foundation_spring[:, None] * moved + sites.foundation_dashpot[:, None] * speed
    np.subtract.at(result, sites.foundation_node, drawn)
    return result


def pose_map(points: Floats, columns: Floats) -> Floats:
    """Coordinates of a rigid tool's columns (l, k, 3) at its nodes (k, 3): (l, 12), see `ReducedModel.tool_map`."""
    arms, fields = points - points.mean(axis=0), np.zeros((12, len(points), 3))
    for c in range(3):
        fields[c, :, c] = 1.0
        for d in range(arms.shape[1]):
            fields[3 + 3 * c + d, :, c] = arms[:, d]
    return np.asarray(np.linalg.lstsq(columns.reshape(len(columns), -1).T, fields.reshape(12, -1).T, rcond=None)[0])
