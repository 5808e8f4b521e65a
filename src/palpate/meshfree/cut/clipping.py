"""Triangles of a cut, clipped to the surroundings of a body and moved off its surface."""

from __future__ import annotations

import numpy as np

from palpate.core.arrays import Floats
from palpate.meshfree.cut.surface import is_narrow, nearest_on_cut

CLIP_MARGIN = 8.0  # distance of the box from the body, in spacings: more than any path round a front
MERGE_WIDTH = 2e-3  # of corners of a clipped triangle, in spacings
ON_SURFACE = 1e-5  # distance of nodes in the plane of a triangle, in spacings
OUTWARD_SHIFT = 1e-3  # in spacings
ALONG_COSINE = 0.9  # least cosine of a triangle's normal and that of the surface along which it lies


def clipped(triangles: Floats, points: Floats, spacing: float) -> Floats:
    """Return triangles (t, 3, 3) without what is far from the nodes (n, 3) of a body.

    Triangles near the body stay as they are. Others are clipped to a box (Sutherland and Hodgman, Commun. ACM 17,
    1974).
    """
    low, high = points.min(axis=0) - CLIP_MARGIN * spacing, points.max(axis=0) + CLIP_MARGIN * spacing
    is_near = np.all((triangles >= low) & (triangles <= high), axis=(1, 2))
    is_near |= is_narrow(triangles, spacing)  # `cut_surface` refuses them
    result = []
    for triangle, stays in zip(triangles, is_near, strict=True):
        if stays:
            result.append(triangle[None])
            continue
        polygon = triangle
        for axis in range(3):
            for sign, limit in ((1.0, low[axis]), (-1.0, -high[axis])):
                polygon = _clip(polygon, axis, sign, limit)
        if len(polygon):
            polygon = polygon[np.linalg.norm(polygon - np.roll(polygon, 1, axis=0), axis=1) > MERGE_WIDTH * spacing]
        if len(polygon) >= 3:
            fan = np.stack([np.broadcast_to(polygon[0], polygon[2:].shape), polygon[1:-1], polygon[2:]], axis=1)
            result.append(fan[~is_narrow(fan, spacing)])
    return np.concatenate([*result, np.zeros((0, 3, 3))])


def _clip(polygon: Floats, axis: int, sign: float, limit: float) -> Floats:
    """Return the part of a polygon (k, 3) with sign times a coordinate of at least a limit."""
    height = sign * polygon[:, axis] - limit
    clipped = []
    for k in range(len(polygon)):
        start, end = height[k - 1], height[k]
        if (start < 0.0) != (end < 0.0):
            share = start / (start - end)
            clipped.append(polygon[k - 1] + share * (polygon[k] - polygon[k - 1]))
        if end >= 0.0:
            clipped.append(polygon[k])
    return np.array(clipped).reshape(-1, 3)


def off_surface(triangles: Floats, points: Floats, area_vectors: Floats, spacing: float) -> Floats:
    """Return triangles (t, 3, 3), moved out of the body by `OUTWARD_SHIFT` where they lie along its surface.

    Else nodes of the face along which a cut lies would leave the body, as a sliver without thickness.
    """
    result = triangles.copy()
    nodes = np.flatnonzero(np.any(area_vectors != 0.0, axis=1))
    place, normals = np.ascontiguousarray(points[nodes]), area_vectors[nodes]
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    for k in np.flatnonzero(~is_narrow(triangles, spacing)):
        a, b, c = triangles[k]
        across = np.cross(b - a, c - a)
        across /= np.linalg.norm(across)
        in_plane = np.flatnonzero(np.abs((place - a) @ across) < ON_SURFACE * spacing)
        if not len(in_plane):
            continue
        near, count = place[in_plane], len(in_plane)
        foot, distance, over = np.empty((count, 3)), np.empty(count), np.empty(count, dtype=np.bool_)
        nearest_on_cut(near, triangles[k : k + 1], foot, distance, over)
        outward = normals[in_plane[distance < ON_SURFACE * spacing]] @ across
        if len(outward) and np.median(np.abs(outward)) > ALONG_COSINE:
            result[k] += np.sign(np.median(outward)) * OUTWARD_SHIFT * spacing * across
    return result
