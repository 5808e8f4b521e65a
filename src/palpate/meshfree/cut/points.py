"""Weights of nodes in the displacement at points of a cut body, and the points that a deformed body has somewhere.

The displacement at a point is a linear fit over the nodes that it sees: bonds that cross the cut go round its fronts or
do not count (`palpate.meshfree.cut.surface`). A point on a face is seen from a little beyond it, on one side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cut.diffraction_lengths import diffraction_lengths
from palpate.meshfree.cut.surface import CutSurface
from palpate.meshfree.cut.uncut import REACH_MARGIN, UncutStencils
from palpate.surface.nesting import inside_points, inside_shares

CANDIDATE_NODES, FIT_NODES = 64, 20  # nearest nodes, and nodes inside the radius of the fit
MAX_ITERATIONS, LAST_CHANGE = 4, 1e-3  # of the reference point, and its last change in spacings
SIGHT_DISTANCE = 0.3  # from a point to where it is seen from, in spacings
MIN_VOLUME = 0.1  # ratio of volumes below which a fit is not used
MAX_DEPTH = 2.0  # of a point in the body whose nearest node is on the surface, in spacings
FAR_DISTANCE = 1.5  # distance from the nearest node beyond which a point moves with it, in spacings


class PointWeights(NamedTuple):
    """Weights of nodes at points."""

    nodes: Ints  # (p, k) array
    values: Floats  # (p, k) array: weights of the displacement
    slopes: Floats  # (p, k, 3) array [1/m]: weights of its derivatives
    # (p,) array [m]: distances from where the points are seen beyond which a change of the cut does not change them
    radii: Floats


def point_weights(uncut: UncutStencils, surface: CutSurface, points: Floats, seen_from: Floats) -> PointWeights:
    """Return the weights of nodes at points (p, 3) [m], whose bonds begin at `seen_from` (p, 3) [m]."""
    n, count = len(uncut.points), min(CANDIDATE_NODES, len(uncut.points))
    _, near = uncut.tree.query(points, k=count)
    near = np.asarray(near, dtype=np.int64)
    start, paths = np.arange(0, len(points) * count + 1, count), np.empty(near.size)
    every = np.concatenate([uncut.points, seen_from])
    diffraction_lengths(
        every, n + np.arange(len(points)), start, near.ravel(), surface.tree, surface.fronts,
        surface.front_components, paths,
    )  # fmt: skip
    lengths: Floats = paths.reshape(near.shape)
    seen = np.where(np.isfinite(lengths), lengths, 0.0)
    ordered = np.sort(np.where(seen > 0.0, lengths, np.inf), axis=1)[:, min(FIT_NODES, count - 1)]
    radius = REACH_MARGIN * np.where(np.isfinite(ordered), ordered, np.maximum(seen.max(axis=1), uncut.spacing))
    weighted, moments = np.zeros((*near.shape, 4)), np.zeros((len(points), 4, 4))
    _weigh(uncut.points, near, points, lengths, radius, weighted, moments)
    values, slopes = np.zeros(near.shape), np.zeros((*near.shape, 3))
    _fit(weighted, np.linalg.pinv(moments, rcond=1e-9, hermitian=True), radius, values, slopes)
    # a path beyond the radius has no weight, and no path leaves the sphere of its length
    return PointWeights(near, values, slopes, np.where(np.isfinite(ordered), radius, np.inf))


@cached_njit(nogil=True)
def _weigh(nodes, near, points, lengths, radius, weighted, moments):
    """Write monomials 1, x, y, z of nodes in the fits at points times weights (p, k, 4), and the moments (p, 4, 4)."""
    monomial = np.ones(4)
    for p in range(points.shape[0]):
        for k in range(near.shape[1]):
            ratio = lengths[p, k] / radius[p]
            if not ratio < 1.0:
                continue
            weight = 1.0 + ratio * ratio * (-6.0 + ratio * (8.0 - 3.0 * ratio))
            for c in range(3):
                monomial[1 + c] = (nodes[near[p, k], c] - points[p, c]) / radius[p]
            for i in range(4):
                weighted[p, k, i] = weight * monomial[i]
                for j in range(4):
                    moments[p, i, j] += weighted[p, k, i] * monomial[j]


@cached_njit(nogil=True)
def _fit(weighted, inverse, radius, values, slopes):
    """Write the weights (p, k) of the fitted values, and those of their derivatives (p, k, 3)."""
    for p in range(weighted.shape[0]):
        for k in range(weighted.shape[1]):
            if weighted[p, k, 0] == 0.0:
                continue
            for i in range(4):
                values[p, k] += weighted[p, k, i] * inverse[p, i, 0]
            for c in range(3):
                for i in range(4):
                    slopes[p, k, c] += weighted[p, k, i] * inverse[p, i, 1 + c]
                slopes[p, k, c] /= radius[p]


def inside_body(uncut: UncutStencils, corners: Floats, points: Floats) -> NDArray[np.bool_]:
    """Return which points (p, 3) are inside a body with a surface of triangles (t, 3, 3).

    Points whose nearest node is not on the surface are inside, and those far from all nodes are outside.
    """
    distance, nearest = uncut.tree.query(points)
    on_surface = uncut.on_surface[nearest]
    inside, near = ~on_surface, on_surface & (distance < MAX_DEPTH * uncut.spacing)
    inside[near] = inside_points(points[near], corners)
    return np.asarray(inside)


def shares_inside(uncut: UncutStencils, corners: Floats, segments: Floats) -> Floats:
    """Return the shares of the lengths of short segments (p, 2, 3) inside a body, as `inside_body` does for points."""
    distance, nearest = uncut.tree.query(segments.mean(axis=1))
    on_surface = uncut.on_surface[nearest]
    shares, near = np.where(on_surface, 0.0, 1.0), on_surface & (distance < MAX_DEPTH * uncut.spacing)
    result = np.zeros(int(near.sum()))
    inside_shares(np.ascontiguousarray(segments[near]), corners, result)
    shares[near] = result
    return shares


def reference_points(
    uncut: UncutStencils, surface: CutSurface, u: Floats, places: Floats, guesses: Floats, normals: Floats
) -> tuple[Floats, Floats]:
    """Return the points of the stress-free body that displacements (n, 3) [m] move to some places (p, 3) [m].

    Outside the body, a place moves with the nearest node. The iteration begins at `guesses` (p, 3) [m]. `normals`
    (p, 3) are unit vectors from the places to where they are seen from. The returned normals (p, 3) are those of the
    same surface in the stress-free body.
    """
    points, turned = guesses.copy(), normals.copy()
    active = np.arange(len(points))
    for _ in range(MAX_ITERATIONS):
        at = points[active]
        weights = point_weights(uncut, surface, at, at + SIGHT_DISTANCE * uncut.spacing * turned[active])
        near_u = u[weights.nodes]
        missing = places[active] - at - np.einsum("pk,pkc->pc", weights.values, near_u)
        gradient = np.eye(3) + np.einsum("pkd,pkc->pcd", weights.slopes, near_u)
        far = np.linalg.norm(uncut.points[weights.nodes[:, 0]] - at, axis=1) > FAR_DISTANCE * uncut.spacing
        gradient[far | ~(np.linalg.det(gradient) > MIN_VOLUME)] = np.eye(3)
        missing[far] = (places[active] - near_u[:, 0] - at)[far]
        sight = np.einsum("pcd,pc->pd", gradient, normals[active])  # area vectors turn as F^-T (Nanson)
        turned[active] = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        change = np.linalg.solve(gradient, missing[:, :, None])[:, :, 0]
        length = np.linalg.norm(change, axis=1)
        shorter = np.minimum(1.0, uncut.spacing / np.maximum(length, np.finfo(float).tiny))
        points[active] += np.where(far, 1.0, shorter)[:, None] * change
        active = active[length > LAST_CHANGE * uncut.spacing]
        if not active.size:
            break
    return points, turned
