"""What loads and rigid tools do on the columns of a reduced model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.loads import Places, Schedule

__all__ = ["load_work", "nodal_loads", "pose_map"]

Floats = NDArray[np.float64]


def load_work(places: Places, columns: Floats, masses: Floats) -> Floats:
    """Work of unit forces and moments of the force groups, and of unit gravity, on columns (m, n, 3): (6 g + 3, m)."""
    forces, moments = [], []
    for g in range(len(places.force_start) - 1):
        own = slice(places.force_start[g], places.force_start[g + 1])
        at = columns[:, places.force_node[own]]
        forces.append(np.einsum("k,mkc->cm", places.force_share[own], at))
        moments.append(np.einsum("kcd,mkc->dm", places.moment_share[own], at))
    return np.concatenate([*forces, *moments, np.einsum("n,mnc->cm", masses, columns)])


def nodal_loads(places: Places, schedule: Schedule, masses: Floats) -> Floats:
    """Forces [N] of tractions and gravity at the nodes at a schedule's first time, shape (n, 3)."""
    result = masses[:, None] * schedule.gravity[0]
    for g in range(len(places.force_start) - 1):
        own = slice(places.force_start[g], places.force_start[g + 1])
        share = places.force_share[own, None] * schedule.force[0, g] + places.moment_share[own] @ schedule.moment[0, g]
        np.add.at(result, places.force_node[own], share)
    return result


def pose_map(points: Floats, columns: Floats) -> Floats:
    """Coordinates of a rigid tool's columns (l, k, 3) at its nodes (k, 3): (l, 12), see `ReducedModel.tool_map`."""
    arms, fields = points - points.mean(axis=0), np.zeros((12, len(points), 3))
    for c in range(3):
        fields[c, :, c] = 1.0
        for d in range(arms.shape[1]):
            fields[3 + 3 * c + d, :, c] = arms[:, d]
    return np.asarray(np.linalg.lstsq(columns.reshape(len(columns), -1).T, fields.reshape(12, -1).T, rcond=None)[0])
