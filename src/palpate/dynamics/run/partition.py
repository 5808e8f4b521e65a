"""Partitions of unity over the groups of supports and tools, for their reaction forces.

Supports that leave their groups free in some directions share the body only with those that constrain the
same directions. So the space of directions is split into orthogonal parts, as small as the supports allow,
and each part has its own partition. Without such supports there is one part, the whole space.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads

MAX_COSINE = 1e-6  # cosine below which two directions are orthogonal
Groups = Mapping[str, NDArray[np.int64]]


class Partition(NamedTuple):
    """A partition of unity for forces along some directions."""

    directions: Floats  # (3, 3) array: projection on the directions
    # (groups, n) array: 1 on the own group and 0 on the others; 0 for groups that are free in these directions
    phi: Floats


def active_partitions(
    points: Floats, prepared: PreparedLoads, time: float
) -> tuple[dict[str, NDArray[np.int64]], list[Partition]]:
    """Return the supports and prescribed groups that are active at a time [s], and their partitions."""
    supports = prepared.active_supports(time)
    names = tuple(supports)
    if names not in prepared.partitions:
        parts = prepared.partitions[names] = partitions(points, supports, prepared.directions)
        for part in parts:
            part.phi[:, prepared.removed] = 0.0
    return supports, prepared.partitions[names]


def partitions(points: Floats, groups: Groups, directions: Mapping[str, Floats]) -> list[Partition]:
    """Return Shepard's partitions of unity over groups.

    A node of several groups belongs to the one that constrains most directions, or else to the first. `directions`
    (k, 3) are those that a group constrains, if it is free in others; the points are (n, d) [m].
    """
    axes = [directions.get(name, np.eye(3)) for name in groups]
    return [
        Partition(part, _shepard(points, list(groups.values()), [_meet(part, axis) * len(axis) for axis in axes]))
        for part in _parts([axis for axis in axes if len(axis) < 3])
    ]


def _parts(axes: list[Floats]) -> list[Floats]:
    """Return projections (3, 3) on orthogonal subspaces, each with all or none of every support's directions."""
    spans: list[Floats] = []
    for axis in axes:
        joined: list[Floats] = [axis]
        apart: list[Floats] = []
        for span in spans:
            (joined if np.abs(span @ axis.T).max() > MAX_COSINE else apart).append(span)
        _, sizes, rows = np.linalg.svd(np.concatenate(joined))
        spans = [*apart, rows[: np.count_nonzero(sizes > MAX_COSINE)]]
    rest = np.eye(3) - sum((span.T @ span for span in spans), np.zeros((3, 3)))
    parts = [span.T @ span for span in spans]
    return [*parts, rest] if np.abs(rest).max() > MAX_COSINE else parts


def _meet(part: Floats, directions: Floats) -> bool:
    return bool(np.abs(directions @ part).max() > MAX_COSINE)


def _shepard(points: Floats, nodes: list[NDArray[np.int64]], ranks: list[int]) -> Floats:
    """Return a partition of unity (groups, n) over the groups of a rank above 0; higher ranks come first."""
    phi, taken = np.zeros((len(nodes), len(points))), np.zeros(len(points), dtype=bool)
    owned = {}
    for g in sorted(range(len(nodes)), key=lambda g: -ranks[g]):
        members_left = nodes[g][~taken[nodes[g]]]
        if ranks[g] and len(members_left):
            owned[g] = members_left
            taken[members_left] = True
    members = sorted(owned)
    if len(members) == 1:
        phi[members] = 1.0
    elif members:
        distance = np.stack([cKDTree(points[owned[g]]).query(points)[0] for g in members])
        inverse = np.stack([np.prod(np.delete(distance, k, axis=0) ** 2, axis=0) for k in range(len(members))])
        phi[members] = inverse / inverse.sum(axis=0)
    return phi


def spread(parts: list[Partition], group: int, vector: Floats) -> Floats:
    """Return the field (n, 3) that is a vector (3,) on a group, and decays towards the others."""
    return np.asarray(sum(part.phi[group][:, None] * (part.directions @ vector) for part in parts))
