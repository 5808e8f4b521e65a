"""Remeshing of a closed surface: evenly spaced nodes, triangles, and area vectors of the nodes.

The vertices of a refined surface form clusters, one per node. Vertices move between clusters while
the sum of squared distances to the centroids decreases: a centroidal Voronoi diagram on the surface
(Valette and Chassery, Computer Graphics Forum 23, 2004). A node is the centroid of its cluster,
projected onto the surface. Its area vector is the sum over its vertices, and three adjacent
clusters form a triangle. So areas sum to that of the surface, area vectors to zero, and the
triangles are closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.core.faults import CloudError
from palpate.surface.refining import poisson_discs

MAX_SWEEPS = 60  # of moves between clusters
MAX_REPAIRS = 12  # rounds of repairing clusters that are not discs


@dataclass(frozen=True)
class SurfaceNodes:
    """Nodes of a remeshed surface."""

    points: Floats  # (s, 3) array [m]
    vectors: Floats  # (s, 3) array [m^2]: area vectors; they sum to zero
    areas: Floats  # (s,) array [m^2]: they sum to the area of the surface
    triangles: Ints  # (t, 3) array


def vertex_vectors(vertices: Floats, triangles: Ints) -> tuple[Floats, Floats]:
    """Return a third of the area vectors and of the areas of the triangles at each vertex, (v, 3) and (v,) [m^2]."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    vectors: Floats = np.cross(b - a, c - a) / 6
    sizes, n = np.linalg.norm(vectors, axis=1), len(vertices)
    corner = triangles.ravel()
    summed = _label_sums(corner, np.repeat(vectors, 3, axis=0), n)
    return summed, _label_sums(corner, np.repeat(sizes, 3)[:, None], n)[:, 0]


def remesh(vertices: Floats, triangles: Ints, spacing: Floats, seed: int) -> SurfaceNodes:
    """Return evenly spaced nodes and triangles of a closed surface, refined to about a third of the spacing.

    `spacing` (v,) [m] is the target distance between nodes at each vertex.
    """
    vectors, areas = vertex_vectors(vertices, triangles)
    weights = areas / spacing**4  # cell sizes of a centroidal diagram scale as density to the power -1/4
    start, near = _neighbours(triangles, len(vertices))
    order = np.random.default_rng(seed).permutation(len(vertices))
    chosen = poisson_discs(vertices, 0.78 * spacing, order)
    label = np.full(len(vertices), -1)
    label[chosen] = np.arange(len(chosen))
    label = _grow_clusters(vertices, label, start, near)
    edges = np.column_stack([np.repeat(np.arange(len(vertices)), np.diff(start)), near])
    edges = edges[edges[:, 0] < edges[:, 1]]
    count = int(label.max()) + 1
    for k in range(MAX_REPAIRS):
        # another minimisation may enclose a cluster in a spike: the last rounds only merge faulty clusters
        label = _minimise_energy(vertices, weights, edges, label, count, MAX_SWEEPS if k < MAX_REPAIRS // 4 else 0)
        label = _join_clusters(vertices, label, count, edges, start, near)
        label, count = _renumber(triangles, label)
        coarse = _dual(triangles, label)
        if _is_closed_manifold(coarse, count):
            break
        label, count = _remove_faults(coarse, label, count, vertices, start, near)
    else:
        raise CloudError(
            "the triangles of the surface nodes must be closed; use a smaller spacing, because parts of the surface "
            "are much thinner"
        )
    sizes = _label_sums(label, areas[:, None], count)
    centroids = _label_sums(label, areas[:, None] * vertices, count) / sizes
    points = _project_to_surface(vertices, triangles, start, label, centroids)
    return SurfaceNodes(points, _label_sums(label, vectors, count), sizes[:, 0], coarse)


def _label_sums(label: Ints, values: Floats, count: int) -> Floats:
    """Return sums (count, c) of values (k, c) by label."""
    columns = [np.bincount(label, values[:, k], count).astype(float) for k in range(values.shape[1])]
    return np.stack(columns, axis=1)


def _neighbours(triangles: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the neighbours of all vertices in compressed rows: starts and indices."""
    a, b, c = triangles.T
    graph = sparse.csr_matrix(
        (np.ones(6 * len(a), dtype=np.int8), (np.concatenate([a, b, b, c, c, a]), np.concatenate([b, a, c, b, a, c]))),
        (n, n),
    )
    graph.sort_indices()
    return graph.indptr.astype(np.int64), graph.indices.astype(np.int64)


@cached_njit()
def _grow_clusters(vertices, label, start, near):
    """Return for every vertex the label of its nearest labelled vertex along edges."""
    n = len(label)
    label = label.copy()
    distance = np.full(n, np.inf)
    queue = np.empty(n, dtype=np.int64)
    waiting = np.zeros(n, dtype=np.bool_)
    head, size = 0, 0
    for v in range(n):
        if label[v] >= 0:
            distance[v] = 0.0
            queue[size] = v
            waiting[v] = True
            size += 1
    while size > 0:  # Bellman-Ford algorithm, with a queue of the vertices whose distance has decreased
        v = queue[head]
        head = (head + 1) % n
        size -= 1
        waiting[v] = False
        for e in range(start[v], start[v + 1]):
            w = near[e]
            length = 0.0
            for a in range(3):
                length += (vertices[v, a] - vertices[w, a]) ** 2
            length = distance[v] + np.sqrt(length)
            if length < distance[w]:
                distance[w] = length
                label[w] = label[v]
                if not waiting[w]:
                    queue[(head + size) % n] = w
                    size += 1
                    waiting[w] = True
    return label


@cached_njit()
def _minimise_energy(vertices, weights, edges, label, count, sweeps):
    """Return labels after moves between adjacent clusters that reduce the sum of squared distances to centroids."""
    label = label.copy()
    mass, moment, members = np.zeros(count), np.zeros((count, 3)), np.zeros(count, dtype=np.int64)
    for v in range(len(label)):
        c = label[v]
        mass[c] += weights[v]
        members[c] += 1
        for a in range(3):
            moment[c, a] += weights[v] * vertices[v, a]
    for _ in range(sweeps):
        moves = 0
        for e in range(len(edges)):
            for side in range(2):
                v, w = edges[e, side], edges[e, 1 - side]
                cluster, neighbour = label[v], label[w]
                if cluster == neighbour or members[cluster] == 1:
                    continue
                before, after = 0.0, 0.0
                m = weights[v]
                for a in range(3):
                    x = m * vertices[v, a]
                    before += moment[cluster, a] ** 2 / mass[cluster] + moment[neighbour, a] ** 2 / mass[neighbour]
                    after += (moment[cluster, a] - x) ** 2 / (mass[cluster] - m) + (moment[neighbour, a] + x) ** 2 / (
                        mass[neighbour] + m
                    )
                if after <= before * (1.0 + 1e-12):
                    continue
                label[v] = neighbour
                moves += 1
                mass[cluster] -= m
                mass[neighbour] += m
                members[cluster] -= 1
                members[neighbour] += 1
                for a in range(3):
                    x = m * vertices[v, a]
                    moment[cluster, a] -= x
                    moment[neighbour, a] += x
        if moves * 2000 < len(label):
            break
    return label


def _join_clusters(vertices: Floats, label: Ints, count: int, edges: Ints, start: Ints, near: Ints) -> Ints:
    """Return labels of connected clusters; smaller pieces join adjacent clusters."""
    same = label[edges[:, 0]] == label[edges[:, 1]]
    n = len(label)
    graph = sparse.coo_matrix((np.ones(same.sum()), edges[same].T), (n, n))
    _, piece = connected_components(graph, directed=False)
    sizes = np.bincount(piece)
    owner = np.zeros(len(sizes), dtype=np.int64)
    owner[piece] = label
    order = np.lexsort((np.arange(len(sizes)), -sizes, owner))
    first = order[np.unique(owner[order], return_index=True)[1]]
    is_main = np.zeros(len(sizes), dtype=bool)
    is_main[first] = True
    if is_main.all():
        return label
    return _grow_clusters(vertices, np.where(is_main[piece], label, -1), start, near)


def _renumber(triangles: Ints, label: Ints) -> tuple[Ints, int]:
    """Return consecutive labels and their number."""
    used, label = np.unique(label, return_inverse=True)
    return label.ravel(), len(used)


def _dual(triangles: Ints, label: Ints) -> Ints:
    """Return a triangle for every three adjacent clusters, without pairs of opposite triangles."""
    corners = label[triangles]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    turn = np.argmin(corners, axis=1)
    return np.take_along_axis(corners, (np.arange(3) + turn[:, None]) % 3, axis=1)


def _faulty_nodes(coarse: Ints, count: int) -> Ints:
    """Return nodes whose triangles are not a closed manifold."""
    edges = np.concatenate([coarse[:, [0, 1]], coarse[:, [1, 2]], coarse[:, [2, 0]]])
    key, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    once, times = np.unique(key, return_counts=True)
    place = np.minimum(np.searchsorted(once, back), len(once) - 1)
    bad = (once[place] != back) | (times[np.searchsorted(once, key)] > 1)
    valence = np.bincount(coarse.ravel(), minlength=count)
    return np.union1d(edges[bad].ravel(), np.flatnonzero(valence < 3))


def _is_closed_manifold(coarse: Ints, count: int) -> bool:
    return len(_faulty_nodes(coarse, count)) == 0


def _remove_faults(
    coarse: Ints, label: Ints, count: int, vertices: Floats, start: Ints, near: Ints
) -> tuple[Ints, int]:
    """Return labels without the smallest cluster at every fault, which joins its neighbours, and their number."""
    faulty = _faulty_nodes(coarse, count)
    sizes = np.bincount(label, minlength=count)
    dropped = np.zeros(count, dtype=bool)
    touched = np.zeros(count, dtype=bool)
    for node in faulty[np.argsort(sizes[faulty], kind="stable")]:
        if not touched[node]:
            dropped[node] = True
            touched[coarse[(coarse == node).any(axis=1)].ravel()] = True
            touched[node] = True
    return _renumber(coarse, _grow_clusters(vertices, np.where(dropped[label], -1, label), start, near))


def _project_to_surface(vertices: Floats, triangles: Ints, start: Ints, label: Ints, centroids: Floats) -> Floats:
    """Return the nearest surface point of each centroid, near the closest vertex of its cluster."""
    order = np.argsort(label, kind="stable")
    begin = np.searchsorted(label[order], np.arange(len(centroids) + 1))
    distance = np.linalg.norm(vertices - centroids[label], axis=1)
    best = np.lexsort((distance, label))[begin[:-1]]
    corner = np.argsort(triangles.ravel(), kind="stable")
    first = np.searchsorted(triangles.ravel()[corner], np.arange(len(vertices) + 1))
    return _nearest_surface_points(vertices, triangles, corner // 3, first, best, centroids)


@cached_njit()
def _nearest_surface_points(vertices, triangles, around, first, best, wished):
    result = np.empty_like(wished)
    for k in range(len(wished)):
        least = np.inf
        for e in range(first[best[k]], first[best[k] + 1]):
            t = triangles[around[e]]
            point = nearest_in_triangle(vertices[t[0]], vertices[t[1]], vertices[t[2]], wished[k])
            distance = np.sum((point - wished[k]) ** 2)
            if distance < least:
                least = distance
                result[k] = point
    return result


@cached_njit()
def nearest_in_triangle(a, b, c, p):
    """Return the point of a triangle nearest to p (Ericson, Real-Time Collision Detection, 2005, section 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = np.sum(ab * ap), np.sum(ac * ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return a.copy()
    bp = p - b
    d3, d4 = np.sum(ab * bp), np.sum(ac * bp)
    if d3 >= 0.0 and d4 <= d3:
        return b.copy()
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return a + ab * (d1 / (d1 - d3))
    cp = p - c
    d5, d6 = np.sum(ab * cp), np.sum(ac * cp)
    if d6 >= 0.0 and d5 <= d6:
        return c.copy()
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return a + ac * (d2 / (d2 - d6))
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    return a + ab * (vb / (va + vb + vc)) + ac * (vc / (va + vb + vc))
