"""Points of a cut at which its two faces touch each other, and the weights of nodes on both sides.

They follow from the surface of the cut alone. An advance of a blade changes the few points near its front, so those
that no changed triangle or front can reach are taken from the cut before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.meshfree.cut.points import SIGHT_DISTANCE, PointWeights, inside_body, point_weights
from palpate.meshfree.cut.surface import CutSurface, triangle_areas
from palpate.meshfree.cut.uncut import UncutStencils

PAIR_DISTANCE = 0.8  # between the points at which faces touch, in spacings


class FacePoints(NamedTuple):
    """Points at which the faces of a cut touch."""

    points: Floats  # (p, 3) array [m]
    normals: Floats  # (p, 3) array: unit vectors to the side of the first face
    # above, below: weights at the points, seen from both sides
    above: PointWeights
    below: PointWeights


def no_face_points() -> FacePoints:
    """Return the points of no cut."""
    vectors, table = np.zeros((0, 3)), np.zeros((0, 0))
    weights = PointWeights(np.zeros((0, 0), dtype=np.int64), table, np.zeros((0, 0, 3)), np.zeros(0))
    return FacePoints(vectors, vectors, weights, weights)


def face_points(
    uncut: UncutStencils, surface: CutSurface, corners: Floats, before: FacePoints, changed: Floats
) -> FacePoints:
    """Return the points at which the faces of a cut touch.

    `corners` (s, 3, 3) [m] are those of the surface of the body. `before` are the points of another cut of this body.
    `changed` (c, 4) [m] are middles and radii of spheres around the triangles and fronts in which it differs:
    `changed_spheres`.
    """
    points, normals = _points_on(surface.triangles, PAIR_DISTANCE * uncut.spacing, corners)
    number = {row.tobytes(): k for k, row in enumerate(np.hstack([before.points, before.normals]))}
    rows = np.hstack([points, normals])
    former = np.array([number.get(row.tobytes(), -1) for row in rows], dtype=np.int64)
    reused = former >= 0
    radii = np.maximum(before.above.radii, before.below.radii) + SIGHT_DISTANCE * uncut.spacing
    reused[reused] = ~_is_reached(points[reused], radii[former[reused]], changed)
    inside = reused.copy()
    inside[~reused] = inside_body(uncut, corners, points[~reused])
    points, normals, former, reused = points[inside], normals[inside], former[inside], reused[inside]
    sight = SIGHT_DISTANCE * uncut.spacing * normals[~reused]
    at = points[~reused]
    sides = (point_weights(uncut, surface, at, at + way) for way in (sight, -sight))
    above, below = (
        PointWeights(*(_merged(reused, old[former[reused]], new) for old, new in zip(weights, fitted, strict=True)))
        for weights, fitted in zip((before.above, before.below), sides, strict=True)
    )
    return FacePoints(points, normals, above, below)


def _merged(reused: NDArray[np.bool_], old: Any, new: Any) -> Any:
    """Return an array with rows of `old` where they are kept, and those of `new` elsewhere."""
    result = np.empty((len(reused), *new.shape[1:]), dtype=new.dtype)
    result[~reused] = new
    if len(old):
        result[reused] = old
    return result


def _is_reached(points: Floats, radii: Floats, changed: Floats) -> NDArray[np.bool_]:
    """Return which points (p, 3) are within their radii (p,) of spheres (c, 4)."""
    distance = np.linalg.norm(points[:, None] - changed[:, :3], axis=2) - changed[:, 3]
    return np.asarray(np.any(distance <= radii[:, None], axis=1))


def _points_on(triangles: Floats, size: float, corners: Floats) -> tuple[Floats, Floats]:
    """Return points (p, 3) of triangles, some a size [m] apart, and their normals (p, 3)."""
    triangles = _small_triangles(triangles, size, corners)
    middles = triangles.mean(axis=1)
    cells = np.floor(middles / size).astype(np.int64)
    order = np.argsort(-triangle_areas(triangles), kind="stable")
    _, first = np.unique(cells[order], axis=0, return_index=True)
    chosen = order[first]
    a, b, c = (triangles[chosen, k] for k in range(3))
    normals = np.cross(b - a, c - a)
    return middles[chosen], normals / np.linalg.norm(normals, axis=1, keepdims=True)


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
