"""Contact of the two faces of a cut with each other.

At a point of the cut, the displacement of each face is a fit over the nodes of its side
(`palpate.meshfree.cut.face_points`). Their difference along the normal is the opening, which must not be negative. One
impulse pushes both faces apart, as those of blades do (`palpate.dynamics.contact.blade_sites`). Where a face has slid
off the other one, as of a piece that falls, it touches nothing: its normal is zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats
from palpate.dynamics.contact.blade_sites import NO_TOOL, PAIR_SITE, BladeSites, no_sites
from palpate.meshfree.cut.points import PointWeights
from palpate.meshfree.cut.stencils import CutState

OPPOSITE_REACH = 1.5  # of a point of a face along it to one of the other face, in the largest distances of points


def face_pairs(state: CutState, u: Floats) -> BladeSites:
    """Return the sites at which the faces of a cut touch each other, for displacements (n, 3) [m]."""
    faces = state.faces
    if not len(faces.points):
        return no_sites()
    nodes = np.concatenate([faces.above.nodes, faces.below.nodes], axis=1)
    weights = np.concatenate([faces.above.values, -faces.below.values], axis=1)
    used = weights != 0.0
    selected = ~np.any(used & state.removed[nodes], axis=1)
    nodes, weights, used, normals, points = (
        nodes[selected],
        weights[selected],
        used[selected],
        faces.normals[selected],
        faces.points[selected],
    )
    above, below = (PointWeights(*(array[selected] for array in side)) for side in (faces.above, faces.below))
    count, directions = len(nodes), _turned(normals, above, below, u)
    directions[~_are_opposite(points, directions, above, below, u)] = 0.0
    vectors = np.zeros((count, 3))
    return BladeSites(
        tool=np.full(count, NO_TOOL, dtype=np.int64), kind=np.full(count, PAIR_SITE, dtype=np.int64),
        start=np.concatenate([[0], np.cumsum(used.sum(axis=1))]).astype(np.int64), nodes=nodes[used],
        weights=weights[used], points=vectors, places=vectors.copy(), directions=directions,
        limits=np.zeros(count), offsets=normals, slips=np.zeros(count), impulses=vectors.copy(), works=np.zeros(2),
    )  # fmt: skip


def _turned(normals: Floats, above: PointWeights, below: PointWeights, u: Floats) -> Floats:
    """Return the normals (p, 3) of the deformed cut, the mean of both faces."""
    total = np.zeros_like(normals)
    for side in (above, below):
        gradient = np.eye(3) + np.einsum("pkd,pkc->pcd", side.slopes, u[side.nodes])
        cofactor = np.linalg.det(gradient)[:, None, None] * np.linalg.pinv(gradient).transpose(0, 2, 1)
        turned = np.einsum("pcd,pd->pc", cofactor, normals)
        total += turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), np.finfo(float).tiny)
    return np.ascontiguousarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), np.finfo(float).tiny))


def _are_opposite(points: Floats, normals: Floats, above: PointWeights, below: PointWeights, u: Floats) -> Any:
    """Return whether the faces at points (p,) of the deformed cut have a point of the other face opposite."""
    first, second = (points + np.einsum("pk,pkc->pc", side.values, u[side.nodes]) for side in (above, below))
    opening = np.einsum("pc,pc->p", first - second, normals)
    slip = np.linalg.norm(first - second - opening[:, None] * normals, axis=1)
    reach = OPPOSITE_REACH * cKDTree(points).query(points, k=2)[0][:, 1].max() if len(points) > 1 else np.inf
    if not slip.max(initial=0.0) > reach:
        return np.ones(len(points), dtype=np.bool_)
    farthest = np.hypot(reach, opening)  # the faces may have opened, too
    near = cKDTree(second).query(first)[0], cKDTree(first).query(second)[0]
    return (slip <= reach) | ((near[0] <= farthest) & (near[1] <= farthest))


def turn_pairs(sites: BladeSites, state: CutState, u: Floats) -> BladeSites:
    """Return sites whose pairs have the normals of new displacements (n, 3)."""
    pairs = sites.kind == PAIR_SITE
    if not pairs.any():
        return sites
    directions = sites.directions.copy()
    directions[pairs] = face_pairs(state, u).directions
    return sites._replace(directions=directions)


def joined_sites(first: BladeSites, second: BladeSites) -> BladeSites:
    """Return the sites of both."""
    arrays = {name: np.concatenate([getattr(each, name) for each in (first, second)]) for name in BladeSites._fields}
    start = np.concatenate([first.start, first.start[-1] + second.start[1:]])
    return BladeSites(**arrays | {"start": start, "works": first.works})
