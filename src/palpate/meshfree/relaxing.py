"""Interior nodes of a closed surface: lattice or Poisson-disc samples, relaxed by short-range repulsion.

Interior nodes closer than 0.6 spacings to the surface, gaps and pairs of nodes cause unstable
modes. Short-range repulsion removes them: in about sixty sweeps, every node moves away from
neighbours within 1.15 spacings. A node too close to the surface is moved back to `MIN_DEPTH`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.surface.crossings import column_crossings
from palpate.surface.refining import poisson_discs

MIN_DEPTH = 0.65  # of interior nodes, in spacings
MAX_SWEEPS, SWEEPS_PER_LIST = 60, 6  # number of repulsion sweeps; sweeps between new lists of neighbours
REPULSION_RADIUS, MAX_MOVE = 1.15, 0.25  # radius and largest move per neighbour and sweep, in spacings
LIST_NEIGHBOURS = 20  # in the list of a node
SAMPLE_DISTANCE = 0.16  # of the volume samples, in spacings
LINE_SHIFT = np.array([0.5 * (np.sqrt(5) - 1), np.sqrt(2) - 1, np.sqrt(3) - 1])  # keeps lines off vertices


@dataclass(frozen=True)
class DepthQuery:
    """Closed refined surface with a search tree for depths."""

    # vertices, triangles: (v, 3), (t, 3) arrays
    vertices: Floats
    triangles: Ints
    tree: cKDTree  # search tree of the vertices

    @classmethod
    def of(cls, vertices: Floats, triangles: Ints) -> DepthQuery:
        """Return the search structure of a surface."""
        return cls(vertices, triangles, cKDTree(vertices))

    def depth(self, points: Floats, most: float) -> tuple[Floats, Floats]:
        """Return the distance of points inside to the nearest vertex [m] and the direction from there: (k,), (k, 3).

        Beyond `most` [m] the distance is infinite and the direction zero.
        """
        distance, nearest = self.tree.query(points, distance_upper_bound=most, workers=-1)
        near = np.isfinite(distance)
        away = np.zeros_like(points)
        away[near] = (points[near] - self.vertices[nearest[near]]) / np.maximum(distance[near], 1e-300)[:, None]
        return distance, away


def _columns(inside: DepthQuery, step: float, offset: Floats) -> tuple[Floats, Ints, Floats]:
    """Return vertical lines through the body: their (x, y), and their entry and exit heights."""
    low, high = inside.vertices.min(axis=0)[:2], inside.vertices.max(axis=0)[:2]
    first = low + step * (offset[:2] - 1)
    shape = np.ceil((high - first) / step).astype(int) + 1
    start, height = column_crossings(inside.vertices, inside.triangles, first, step, (int(shape[0]), int(shape[1])))
    i, j = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    return first + step * np.column_stack([i, j]), start, height


def lattice_inside(inside: DepthQuery, step: float, offset: Floats) -> Floats:
    """Return the interior points of a cubic lattice, shape (k, 3) [m]."""
    places, start, height = _columns(inside, step, offset)
    pairs = height.reshape(-1, 2)
    column = np.repeat(np.arange(len(places)), np.diff(start) // 2)
    bottom = inside.vertices[:, 2].min() + step * (offset[2] - 1)
    first, last = np.ceil((pairs[:, 0] - bottom) / step), np.floor((pairs[:, 1] - bottom) / step)
    count = np.maximum(last - first + 1, 0).astype(int)
    before = np.concatenate([[0], np.cumsum(count)[:-1]])
    rank = np.arange(count.sum()) - np.repeat(before, count)
    z = bottom + step * (np.repeat(first, count) + rank)
    return np.column_stack([np.repeat(places[column], count, axis=0), z])


def body_centred_lattice(inside: DepthQuery, spacing: float) -> Floats:
    """Return the interior points of a body-centred cubic lattice with one point per spacing cubed."""
    step = 2 ** (1 / 3) * spacing
    return np.concatenate(
        [lattice_inside(inside, step, LINE_SHIFT), lattice_inside(inside, step, (LINE_SHIFT + 0.5) % 1.0)]
    )


def cubic_lattice(inside: DepthQuery, spacing: float) -> Floats:
    """Return the interior points of a cubic lattice."""
    return lattice_inside(inside, spacing, LINE_SHIFT)


def scattered_inside(inside: DepthQuery, min_spacing: float, spacing: Callable[[Floats], Floats], seed: int) -> Floats:
    """Return Poisson-disc samples inside, with radius 0.85 of a spacing function of points (k, 3)."""
    random = np.random.default_rng(seed)
    points = lattice_inside(inside, 0.3 * min_spacing, LINE_SHIFT)
    points = points + 0.15 * min_spacing * random.uniform(-1, 1, points.shape)
    return points[poisson_discs(points, 0.85 * spacing(points), random.permutation(len(points)))]


def relax(
    inner: Floats,
    outer: Floats,
    inner_spacing: Floats,
    outer_spacing: Floats,
    inside: DepthQuery,
    sweeps: int = MAX_SWEEPS,
) -> Floats:
    """Return interior nodes after repulsion from each other and from the fixed surface nodes.

    `inner` (n, 3) and `outer` (s, 3) [m] are nodes inside and on the surface, with target spacings (n,) and (s,) [m].
    """
    points = np.concatenate([inner, outer])
    spacing = np.concatenate([inner_spacing, outer_spacing])
    n = len(inner)
    if n == 0:
        return inner
    for _ in range(max(1, sweeps // SWEEPS_PER_LIST)):
        _, near = cKDTree(points).query(points[:n], k=min(LIST_NEIGHBOURS, len(points)), workers=-1)
        depth, away = inside.depth(points[:n], 1.5 * float(inner_spacing.max()))
        _repel(points, spacing, near[:, 1:], depth, away, SWEEPS_PER_LIST)
    return points[:n]


@cached_njit()
def _repel(points, spacing, near, depth, away, sweeps):
    n = len(near)
    origin = points[:n].copy()
    move = np.zeros((n, 3))
    for _ in range(sweeps):
        for i in range(n):
            for a in range(3):
                move[i, a] = 0.0
            for j in near[i]:
                x, y, z = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
                r = np.sqrt(x * x + y * y + z * z)
                reach = REPULSION_RADIUS * 0.5 * (spacing[i] + spacing[j])
                if r >= reach or r == 0.0:
                    continue
                push = MAX_MOVE * spacing[i] * (1.0 - r / reach) / r
                move[i, 0] += push * x
                move[i, 1] += push * y
                move[i, 2] += push * z
        for i in range(n):
            below = depth[i]
            for a in range(3):
                points[i, a] += move[i, a]
                below += (points[i, a] - origin[i, a]) * away[i, a]
            lift = MIN_DEPTH * spacing[i] - below
            if lift > 0.0:
                for a in range(3):
                    points[i, a] += lift * away[i, a]


def voronoi_volumes(points: Floats, inside: DepthQuery, spacing: float) -> Floats:
    """Return the Voronoi volume [m^3] of each point in the body, by samples along vertical lines.

    Each line's part inside the body is cut into equal pieces. So the samples' volumes sum to the
    body's, except for the error by the distance of the lines.
    """
    step = SAMPLE_DISTANCE * spacing
    places, start, height = _columns(inside, step, LINE_SHIFT)
    low = points.min(axis=0)
    cell = spacing
    span = np.floor((points.max(axis=0) - low) / cell).astype(np.int64) + 1
    place = np.floor((points - low) / cell).astype(np.int64)
    key = (place[:, 0] * span[1] + place[:, 1]) * span[2] + place[:, 2]
    order = np.argsort(key, kind="stable")
    first = np.searchsorted(key[order], np.arange(np.prod(span) + 1))
    return _sample_volumes(points[order], order, first, span, low, cell, places, start, height, step)


@cached_njit()
def _sample_volumes(points, order, first, span, low, cell, places, start, height, step):
    result = np.zeros(len(points))
    for line in range(len(places)):
        x, y = places[line]
        for c in range(start[line], start[line + 1], 2):
            length = height[c + 1] - height[c]
            pieces = int(np.ceil(length / step))
            if pieces == 0:
                continue
            for p in range(pieces):
                z = height[c] + (p + 0.5) * length / pieces
                i = _nearest_point(points, first, span, low, cell, x, y, z)
                result[order[i]] += step * step * length / pieces
    return result


@cached_njit()
def _nearest_point(points, first, span, low, cell, x, y, z):
    """Return the index of the point nearest to (x, y, z), by a search over rings of cells."""
    i, j, k = int(np.floor((x - low[0]) / cell)), int(np.floor((y - low[1]) / cell)), int(np.floor((z - low[2]) / cell))
    best, min_spacing = -1, np.inf
    ring = 1
    most = max(span[0], span[1], span[2]) + 1
    while ring <= most:
        for a in range(max(i - ring, 0), min(i + ring, span[0] - 1) + 1):
            for b in range(max(j - ring, 0), min(j + ring, span[1] - 1) + 1):
                low_c, high_c = max(k - ring, 0), min(k + ring, span[2] - 1)
                if low_c > high_c:
                    continue
                row = (a * span[1] + b) * span[2]
                for p in range(first[row + low_c], first[row + high_c + 1]):
                    d = (points[p, 0] - x) ** 2 + (points[p, 1] - y) ** 2 + (points[p, 2] - z) ** 2
                    if d < min_spacing:
                        best, min_spacing = p, d
        if best >= 0 and min_spacing <= (ring * cell) ** 2:
            break
        ring += 1
    return best
