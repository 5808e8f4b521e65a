"""Where a cut opens the surface of a body, and how long, large and deep it is, in the stress-free body.

The opening is the intersection of the triangles of the cut with those of the surface: the interval that two triangles
share of the line of their planes (Moeller, Journal of Graphics Tools 2, 1997).

What a blade cuts twice counts once: a triangle of the cut whose middle is `SAME_CUT` spacings from another one at most.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cut.crossings import ON_PLANE, difference, normal, sphere
from palpate.meshfree.cut.surface import triangle_areas

SAME_CUT = 0.3  # distance of a triangle of a cut from an earlier one, below which it counts with that, in spacings
NEAREST_PIECES = 8  # of an opening, among which is the one nearest to a point


class Opening(NamedTuple):
    """Pieces of the line along which a cut opens a surface."""

    pieces: Floats  # (l, 2, 3) array [m]: their ends
    triangles: Ints  # (l,) array: the triangles of the surface on which they are
    is_new: NDArray[np.bool_]  # (l,) array: whether no piece before is at the same place


class CutMeasures(NamedTuple):
    """Size of a cut in the stress-free body."""

    length: float  # [m] of the line on the surface
    area: float  # [m^2] of the cut inside the body
    depth: float  # [m], the largest below the surface at the nearest place of the line


NO_MEASURES = CutMeasures(0.0, 0.0, 0.0)


def cut_opening(cut: Floats, surface: Floats, spacing: float) -> Opening:
    """Return the line along which triangles (t, 3, 3) of a cut open a surface of triangles (s, 3, 3)."""
    middles, radii = _spheres(surface)
    near = cKDTree(middles)
    centres, reach = _spheres(cut)
    near_triangles = near.query_ball_point(centres, reach + radii.max(initial=0.0))
    first = np.repeat(np.arange(len(cut)), [len(each) for each in near_triangles])
    second = np.concatenate([np.zeros(0), *near_triangles]).astype(np.int64)
    close = np.linalg.norm(centres[first] - middles[second], axis=1) < reach[first] + radii[second]
    first, second = first[close], second[close]
    pieces, meet = _intersections(cut[first], surface[second], ON_PLANE * spacing)
    pieces = pieces[meet]
    return Opening(pieces, second[meet], ~_repeated(pieces.mean(axis=1), first[meet], cut, spacing))


def cut_measures(opening: Opening, surface: Floats, inside: Floats, spacing: float) -> CutMeasures:
    """Return the size of a cut with an opening in a surface (s, 3, 3), and triangles (t, 3, 3) inside the body."""
    if not len(opening.pieces) or not len(inside):
        return NO_MEASURES
    lengths = np.linalg.norm(opening.pieces[:, 1] - opening.pieces[:, 0], axis=1)
    areas = triangle_areas(inside)[~_repeated(inside.mean(axis=1), np.arange(len(inside)), inside, spacing)]
    return CutMeasures(float(lengths[opening.is_new].sum()), float(areas.sum()), _depth(opening, surface, inside))


def _depth(opening: Opening, surface: Floats, inside: Floats) -> float:
    """Return the largest depth [m] of triangles below the planes of the surface at the nearest places of an opening."""
    points = inside.reshape(-1, 3)
    count = min(NEAREST_PIECES, len(opening.pieces))
    near = cKDTree(opening.pieces.mean(axis=1)).query(points, k=count)[1].reshape(len(points), count)
    start, way = opening.pieces[near, 0], opening.pieces[near, 1] - opening.pieces[near, 0]
    square = np.maximum(np.sum(way**2, axis=2), np.finfo(float).tiny)
    share = np.clip(np.sum((points[:, None] - start) * way, axis=2) / square, 0.0, 1.0)
    from_line = start + share[:, :, None] * way - points[:, None]
    nearest = np.argmin(np.linalg.norm(from_line, axis=2), axis=1)
    row = np.arange(len(points))
    corners = surface[opening.triangles[near[row, nearest]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return max(float(np.sum(from_line[row, nearest] * normals, axis=1).max()), 0.0)


def _repeated(points: Floats, numbers: Ints, triangles: Floats, spacing: float) -> NDArray[np.bool_]:
    """Return which points (p, 3) of triangles of some numbers (p,) are at an earlier triangle of a cut, too."""
    repeated = np.zeros(len(points), dtype=np.bool_)
    _mark_repeated(points, numbers, np.ascontiguousarray(triangles), SAME_CUT * spacing, repeated)
    return repeated


@cached_njit(nogil=True)
def _mark_repeated(points, numbers, triangles, reach, repeated):
    """Set entries of `repeated` (p,) to True for points within a reach [m] over a triangle before theirs."""
    spheres = np.empty((triangles.shape[0], 4))
    for t in range(triangles.shape[0]):
        spheres[t, 0], spheres[t, 1], spheres[t, 2], spheres[t, 3] = sphere(triangles[t])
    for k in range(points.shape[0]):
        for t in range(numbers[k]):
            x, y, z = difference(points[k], spheres[t])
            if x * x + y * y + z * z < (spheres[t, 3] + reach) ** 2 and _is_over(points[k], triangles[t], reach):
                repeated[k] = True
                break


@cached_njit(nogil=True)
def _is_over(point, corners, reach):
    """Return whether the projection of a point on a triangle's plane is in it, and within a reach."""
    n = normal(corners)
    x, y, z = difference(point, corners[0])
    if abs(x * n[0] + y * n[1] + z * n[2]) > reach:
        return False
    turn = 0.0
    for k in range(3):
        ex, ey, ez = difference(corners[(k + 1) % 3], corners[k])
        x, y, z = difference(point, corners[k])
        side = (ey * z - ez * y) * n[0] + (ez * x - ex * z) * n[1] + (ex * y - ey * x) * n[2]
        if side * turn < 0.0:
            return False
        turn = side
    return True


def _spheres(triangles: Floats) -> tuple[Floats, Floats]:
    """Return the middles (t, 3) and radii (t,) of spheres around triangles."""
    middles = triangles.mean(axis=1)
    return middles, np.linalg.norm(triangles - middles[:, None], axis=2).max(axis=1, initial=0.0)


def _intersections(first: Floats, second: Floats, tiny: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the ends (p, 2, 3) of the intersections of pairs of triangles (p, 3, 3), and which pairs have one."""
    on_line, meet, places = [], np.ones(len(first), dtype=np.bool_), []
    along = np.cross(_normals(first), _normals(second))
    for triangle, other in ((first, second), (second, first)):
        heights = np.einsum("pkc,pc->pk", triangle - other[:, :1], _normals(other))
        heights[np.abs(heights) < tiny] = tiny  # a corner on the plane is above it
        ahead = np.roll(heights, -1, axis=1)
        crossed = (heights > 0) != (ahead > 0)
        meet &= crossed.any(axis=1)
        shares = heights / np.where(crossed, heights - ahead, 1.0)
        points = triangle + shares[:, :, None] * (np.roll(triangle, -1, axis=1) - triangle)
        row, sides = np.arange(len(first)), (np.argmax(crossed, axis=1), 2 - np.argmax(crossed[:, ::-1], axis=1))
        ends = np.stack([points[row, side] for side in sides], axis=1)
        on_line.append(ends)
        places.append(np.einsum("pkc,pc->pk", ends, along))
    low = np.maximum(places[0].min(axis=1), places[1].min(axis=1))
    high = np.minimum(places[0].max(axis=1), places[1].max(axis=1))
    length = places[0][:, 1] - places[0][:, 0]
    meet &= (high > low) & (length != 0.0)
    shares = (np.stack([low, high], axis=1) - places[0][:, :1]) / np.where(length == 0.0, 1.0, length)[:, None]
    ends = on_line[0]
    return ends[:, :1] + shares[:, :, None] * (ends[:, 1:] - ends[:, :1]), meet


def _normals(triangles: Floats) -> Floats:
    """Return the unit normals (t, 3) of triangles."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny))
