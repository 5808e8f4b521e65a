"""Contact of the two faces of a cut with each other.

At a point of the cut, the displacement of each face is a fit over the nodes of its side. Their difference along the
normal is the opening, which must not be negative. One impulse pushes both faces apart, as those of blades do
(`palpate.dynamics.contact.blade_sites`).
"""

from __future__ import annotations

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.blade_sites import NO_TOOL, PAIR_SITE, BladeSites, no_sites
from palpate.meshfree.cut.points import SIGHT_DISTANCE, PointWeights, inside_body, point_weights
from palpate.meshfree.cut.stencils import CutState
from palpate.meshfree.cut.surface import triangle_areas

PAIR_DISTANCE = 0.8  # between the points at which faces touch, in spacings


def face_pairs(state: CutState, u: Floats, corners: Floats) -> BladeSites:
    """Return the sites at which the faces of a cut touch each other.

    Parameters
    ----------
    u : (n, 3) array [m]
    corners : (s, 3, 3) array [m]
        Of the surface of the body.
    """
    spacing = state.uncut.spacing
    triangles = _small_triangles(state.surface.triangles, PAIR_DISTANCE * spacing, corners)
    if not len(triangles):
        return no_sites()
    middles = triangles.mean(axis=1)
    cells = np.floor(middles / (PAIR_DISTANCE * spacing)).astype(np.int64)
    order = np.argsort(-triangle_areas(triangles), kind="stable")
    _, first = np.unique(cells[order], axis=0, return_index=True)
    chosen = order[first]
    chosen = chosen[inside_body(state.uncut, corners, middles[chosen])]
    points = middles[chosen]
    a, b, c = (triangles[chosen, k] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sight = SIGHT_DISTANCE * spacing * normals
    seen_from = np.concatenate([points + sight, points - sight])
    both = point_weights(state.uncut, state.surface, np.tile(points, (2, 1)), seen_from)
    above, below = (PointWeights(*parts) for parts in zip(*(np.split(array, 2) for array in both), strict=True))
    nodes = np.concatenate([above.nodes, below.nodes], axis=1)
    weights = np.concatenate([above.values, -below.values], axis=1)
    used = weights != 0.0
    kept = ~np.any(used & state.removed[nodes], axis=1)
    nodes, weights, used, normals = nodes[kept], weights[kept], used[kept], normals[kept]
    above, below = (PointWeights(*(array[kept] for array in side)) for side in (above, below))
    count = len(nodes)
    vectors = np.zeros((count, 3))
    return BladeSites(
        tool=np.full(count, NO_TOOL, dtype=np.int64), kind=np.full(count, PAIR_SITE, dtype=np.int64),
        start=np.concatenate([[0], np.cumsum(used.sum(axis=1))]).astype(np.int64), nodes=nodes[used],
        weights=weights[used], points=vectors, places=vectors.copy(), directions=_turned(normals, above, below, u),
        limits=np.zeros(count), offsets=normals, slips=np.zeros(count), impulses=vectors.copy(), works=np.zeros(2),
    )  # fmt: skip


def _small_triangles(triangles: Floats, size: float, corners: Floats) -> Floats:
    """Return triangles near the body, divided at their longest sides until none is longer than twice a size [m]."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    small = [triangles[:0]]
    while len(triangles):
        near = np.all((triangles.max(axis=1) > low) & (triangles.min(axis=1) < high), axis=1)
        triangles = triangles[near]
        lengths = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        is_small = lengths.max(axis=1, initial=0.0) <= 2 * size
        small.append(triangles[is_small])
        triangles, longest = triangles[~is_small], lengths[~is_small].argmax(axis=1)
        order = (longest[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(triangles, order[:, :, None], axis=1).transpose(1, 0, 2)
        middle = 0.5 * (a + b)
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(small)


def _turned(normals: Floats, above: PointWeights, below: PointWeights, u: Floats) -> Floats:
    """Return the normals (p, 3) of the deformed cut, the mean of both faces."""
    total = np.zeros_like(normals)
    for side in (above, below):
        gradient = np.eye(3) + np.einsum("pkd,pkc->pcd", side.slopes, u[side.nodes])
        cofactor = np.linalg.det(gradient)[:, None, None] * np.linalg.pinv(gradient).transpose(0, 2, 1)
        turned = np.einsum("pcd,pd->pc", cofactor, normals)
        total += turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), np.finfo(float).tiny)
    return np.ascontiguousarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), np.finfo(float).tiny))


def turn_pairs(sites: BladeSites, state: CutState, u: Floats, corners: Floats) -> BladeSites:
    """Return sites whose pairs have the normals of new displacements (n, 3)."""
    pairs = sites.kind == PAIR_SITE
    if not pairs.any():
        return sites
    directions = sites.directions.copy()
    directions[pairs] = face_pairs(state, u, corners).directions
    return sites._replace(directions=directions)


def joined_sites(first: BladeSites, second: BladeSites) -> BladeSites:
    """Return the sites of both."""
    arrays = {name: np.concatenate([getattr(each, name) for each in (first, second)]) for name in BladeSites._fields}
    start = np.concatenate([first.start, first.start[-1] + second.start[1:]])
    return BladeSites(**arrays | {"start": start, "works": first.works})
