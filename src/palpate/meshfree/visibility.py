"""Pairs of near nodes that do not see each other: the outside of their body is between them.

Stencils that reached across a narrow cleft would weld its walls. So a stencil omits a node if the
straight line to it leaves the body (the visibility criterion: Belytschko, Lu and Gu, Int. J. Numer.
Methods Eng. 37, 1994). In the valley of a smooth surface, and round the end
of a cleft, there is a path through the tissue that is hardly longer than the straight one. Such
pairs remain neighbours.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints

MAX_DISTANCE = 4.0  # largest distance of pairs, in spacings: more than the radius of one-sided stencils
FACING_COSINE = 0.5  # least cosine between a normal and the vector to a node that the surface faces
SURFACE_MARGIN = 0.15  # of the outside next to the surface that paths may touch, in spacings
MAX_DETOUR = 1.2  # longest path through the tissue over the straight one


def hidden_pairs(points: Floats, area_vectors: Floats, triangles: Ints, spacing: float) -> sparse.csr_array:
    """Return pairs of nodes within `MAX_DISTANCE` spacings with the outside between them: True in an array (n, n).

    `points` are (n, 3) [m]. `area_vectors` (n, 3) [m^2] of the surface nodes point outward, and are zero inside.
    `triangles` (t, 3) of the surface are counter-clockwise from outside.
    """
    n = len(points)
    surface, reach = np.unique(triangles), MAX_DISTANCE * spacing
    normals = area_vectors / np.maximum(np.linalg.norm(area_vectors, axis=1), np.finfo(float).tiny)[:, None]
    facing = _facing(points, normals, surface, reach)
    if not len(facing):
        return sparse.csr_array((n, n), dtype=bool)
    near = np.flatnonzero(cKDTree(points[facing]).query(points, distance_upper_bound=reach)[0] < reach)
    pairs = near[cKDTree(points[near]).query_pairs(reach, output_type="ndarray")]
    corners = (points + SURFACE_MARGIN * spacing * normals)[triangles]
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    pairs = pairs[order].astype(np.int64)
    near_triangles = cKDTree(centres).query_ball_point(points[near], reach + radii.max())
    start = np.zeros(n + 1, dtype=np.int64)
    start[near + 1] = [len(each) for each in near_triangles]
    of_node = np.concatenate([np.asarray(each, dtype=np.int64) for each in near_triangles])
    is_hidden = np.zeros(len(pairs), dtype=np.bool_)
    _find_crossing(points, pairs, corners, centres, radii, np.cumsum(start), of_node, is_hidden)
    if is_hidden.any():
        is_hidden[is_hidden] = _has_no_detour(points, pairs[is_hidden], pairs[~is_hidden])
    first, second = pairs[is_hidden].T
    entries = np.ones(2 * len(first), dtype=bool), (np.r_[first, second], np.r_[second, first])
    return sparse.csr_array(sparse.coo_array(entries, (n, n)))


def is_pair(pairs: sparse.csr_array, first: Ints, second: Ints) -> NDArray[np.bool_]:
    """Return which pairs of nodes (k,) and (k,) a sparse array (n, n) holds."""
    n = np.int64(pairs.shape[1])
    held = np.repeat(np.arange(pairs.shape[0]), np.diff(pairs.indptr)) * n + pairs.indices
    return np.isin(first * n + second, held)


def _facing(points: Floats, normals: Floats, surface: Ints, reach: float) -> Ints:
    """Return the surface nodes that face others across the outside."""
    pairs = surface[cKDTree(points[surface]).query_pairs(reach, output_type="ndarray")]
    way = points[pairs[:, 1]] - points[pairs[:, 0]]
    least = FACING_COSINE * np.linalg.norm(way, axis=1)
    out = np.sum(normals[pairs[:, 0]] * way, axis=1) > least
    into = np.sum(normals[pairs[:, 1]] * way, axis=1) < -least
    return np.unique(pairs[out & into])


@cached_njit(nogil=True)
def _find_crossing(points, pairs, corners, centres, radii, start, of_node, crosses):
    """Mark the pairs whose connection crosses a triangle; those near node i are `of_node[start[i] : start[i + 1]]`."""
    for p in range(pairs.shape[0]):
        i, j = pairs[p]
        x, y, z = points[i]
        wx, wy, wz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
        square = wx * wx + wy * wy + wz * wz
        for q in range(start[i], start[i + 1]):
            t = of_node[q]
            dx, dy, dz = centres[t, 0] - x, centres[t, 1] - y, centres[t, 2] - z
            share = min(max((dx * wx + dy * wy + dz * wz) / square, 0.0), 1.0)
            dx, dy, dz = dx - share * wx, dy - share * wy, dz - share * wz
            if dx * dx + dy * dy + dz * dz < radii[t] ** 2 and _crosses(x, y, z, wx, wy, wz, corners[t]):
                crosses[p] = True
                break


@cached_njit(nogil=True)
def _crosses(x, y, z, wx, wy, wz, corners):
    """Return whether a segment crosses a triangle (Moeller and Trumbore, J. Graphics Tools 2, 1997)."""
    ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    cx, cy, cz = wy * bz - wz * by, wz * bx - wx * bz, wx * by - wy * bx
    determinant = ax * cx + ay * cy + az * cz
    if determinant == 0.0:
        return False
    dx, dy, dz = x - corners[0, 0], y - corners[0, 1], z - corners[0, 2]
    u = (dx * cx + dy * cy + dz * cz) / determinant
    if u < 0.0 or u > 1.0:
        return False
    cx, cy, cz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    v = (wx * cx + wy * cy + wz * cz) / determinant
    share = (bx * cx + by * cy + bz * cz) / determinant
    return v >= 0.0 and u + v <= 1.0 and 0.0 <= share <= 1.0


def _has_no_detour(points: Floats, hidden: Ints, seen: Ints) -> Any:
    """Return True for the hidden pairs (h, 2) that no third node which both see connects by a short path."""
    length = np.linalg.norm(points[seen[:, 0]] - points[seen[:, 1]], axis=1)
    both = np.concatenate([seen, seen[:, ::-1]])
    table = sparse.csr_array(sparse.coo_array((np.tile(length, 2), both.T), (len(points),) * 2))
    table.sort_indices()
    straight = np.linalg.norm(points[hidden[:, 0]] - points[hidden[:, 1]], axis=1)
    shortest = np.full(len(hidden), np.inf)
    _shortest_detour(hidden, table.indptr, table.indices, table.data, shortest)
    return shortest > MAX_DETOUR * straight


@cached_njit(nogil=True)
def _shortest_detour(pairs, start, near, length, shortest):
    """Write the shortest path by a common neighbour; neighbours are in ascending order."""
    for p in range(pairs.shape[0]):
        a, b = start[pairs[p, 0]], start[pairs[p, 1]]
        while a < start[pairs[p, 0] + 1] and b < start[pairs[p, 1] + 1]:
            if near[a] == near[b]:
                shortest[p] = min(shortest[p], length[a] + length[b])
                a += 1
                b += 1
            elif near[a] < near[b]:
                a += 1
            else:
                b += 1
