"""Self-intersections of a surface by a bounding-volume hierarchy."""

from __future__ import annotations

import numpy as np

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError

MAX_PAIRS = 10_000  # the search stops there
MAX_BOX_TESTS = (5_000_000, 300)  # largest number of box tests: in total at least, and per triangle
LEAF_TRIANGLES = 4
GAP_TOLERANCE = 1e-14  # over the extent of two triangles; smaller gaps are rounding errors
FLAT_TOLERANCE = 1e-9  # sine of an angle, or height over length, taken as zero
MAX_SPLITS = 100  # rounds of splitting neighbours of degenerate triangles


def self_intersections(vertices: Floats, triangles: Ints) -> Ints:
    """Return pairs (k, 2) of triangles with a common point that is not a common vertex or edge, ascending.

    If k is `MAX_PAIRS`, there may be more. The surface is welded: equal vertices have equal numbers.

    Two triangles are disjoint if an axis separates them (Gottschalk, Lin and Manocha, 1996). Gaps below the rounding
    error do not count, so that exact contacts of edges and vertices are found. Candidates come from a tree of boxes;
    memory is proportional to the number of triangles. A triangle without area, which only joins a vertex to an edge of
    its neighbour, is left out, and the neighbour is split there.
    """
    triangles, owner = _remove_flat(np.asarray(vertices, dtype=float), np.asarray(triangles, dtype=np.int64))
    if len(triangles) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    corners = np.ascontiguousarray(vertices[triangles], dtype=float)
    order, box = _tree(0.5 * (corners.min(axis=1) + corners.max(axis=1)), corners)
    most = max(MAX_BOX_TESTS[0], MAX_BOX_TESTS[1] * len(triangles))
    pairs = np.empty((MAX_PAIRS, 2), dtype=np.int64)
    count, visits = _search(corners[order], triangles[order], box, pairs, most)
    if visits > most:
        raise InputError(
            f"the bounding boxes of the triangles must overlap in fewer than {most} places; "
            f"remesh the surface with triangles of similar size and shape"
        )
    return np.unique(np.sort(owner[order][pairs[:count]], axis=1), axis=0)


def _remove_flat(vertices: Floats, triangles: Ints) -> tuple[Ints, Ints]:
    """Return triangles without degenerate ones, split at their vertices, and the original indices."""
    t, n = len(triangles), len(vertices)
    solid = _have_area(np.ascontiguousarray(vertices[triangles]))
    if solid.all():
        return triangles, np.arange(t)
    flat = triangles[~solid]
    triangles, owner = triangles[solid], np.flatnonzero(solid)
    length = np.linalg.norm(vertices[np.roll(flat, -1, axis=1)] - vertices[flat], axis=2)
    flat = np.take_along_axis(
        flat, (np.argmax(length, axis=1)[:, None] + np.arange(3)) % 3, axis=1
    )  # edge, vertex on it
    for _ in range(MAX_SPLITS):
        if not len(flat) or not len(triangles):
            break
        edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        key, wanted = edges @ [n, 1], np.sort(flat[:, :2], axis=1) @ [n, 1]
        order = np.argsort(key)
        at = order[np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)]
        places = np.flatnonzero(key[at] == wanted)
        whose, first = np.unique(at[places] // 3, return_index=True)  # a neighbour is split once a round
        places = places[first]
        if not len(places):
            break
        a, b, c = (triangles[whose, (at[places] + k) % 3] for k in range(3))
        triangles[whose] = np.column_stack([a, flat[places, 2], c])
        triangles = np.concatenate([triangles, np.column_stack([flat[places, 2], b, c])])
        owner = np.concatenate([owner, owner[whose]])
        flat = np.delete(flat, places, axis=0)
    return triangles, owner


@cached_njit()
def _have_area(corners):
    have = np.empty(len(corners), dtype=np.bool_)
    for t in range(len(corners)):
        p = corners[t]
        a, b, c = _edge(p, 0), _edge(p, 1), _edge(p, 2)
        have[t] = _square(_cross(a, b)) > (FLAT_TOLERANCE * max(_square(a), _square(b), _square(c))) ** 2
    return have


# ---- tree: node i has the children 2 i + 1 and 2 i + 2; leaf j of 2^depth holds [n j >> depth, n (j + 1) >> depth)


@cached_njit()
def _tree(middle, corners):
    """Return triangles ordered by median splits along the longest direction, and the boxes of the tree."""
    n, depth = len(middle), 0
    while n >> depth > LEAF_TRIANGLES:
        depth += 1
    order = np.arange(n)
    for level in range(depth):
        for j in range(1 << level):
            begin, end = (n * j) >> level, (n * (j + 1)) >> level
            axis, widest = 0, -1.0
            for a in range(3):
                low, high = np.inf, -np.inf
                for k in range(begin, end):
                    x = middle[order[k], a]
                    low, high = min(low, x), max(high, x)
                if high - low > widest:
                    axis, widest = a, high - low
            _select(order, middle[:, axis], begin, end - 1, (n * (2 * j + 1)) >> (level + 1))
    box = np.empty(((2 << depth) - 1, 2, 3))
    first = (1 << depth) - 1
    for i in range(len(box) - 1, -1, -1):
        for a in range(3):
            low, high = np.inf, -np.inf
            if i >= first:
                for k in range((n * (i - first)) >> depth, (n * (i - first + 1)) >> depth):
                    for c in range(3):
                        x = corners[order[k], c, a]
                        low, high = min(low, x), max(high, x)
            else:
                low = min(box[2 * i + 1, 0, a], box[2 * i + 2, 0, a])
                high = max(box[2 * i + 1, 1, a], box[2 * i + 2, 1, a])
            box[i, 0, a], box[i, 1, a] = low, high
    return order, box


@cached_njit()
def _select(order, key, low, high, middle):
    """Partially sort so that entry `middle` has its rank (quickselect, Hoare, 1961)."""
    turn = 12345
    while low < high:
        turn = (turn * 1103515245 + 12345) & 0x7FFFFFFF
        pivot = key[order[low + turn % (high - low + 1)]]
        i, j = low, high
        while i <= j:
            while key[order[i]] < pivot:
                i += 1
            while key[order[j]] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@cached_njit()
def _search(corners, triangles, box, pairs, most):
    """Write intersecting pairs of each leaf and later ones; return their number and that of box tests."""
    n, leaves = len(corners), (len(box) + 1) // 2
    depth = 0
    while 1 << depth < leaves:
        depth += 1
    count, visits = 0, 0
    stack = np.empty(2 * depth + 2, dtype=np.int64)
    for leaf in range(leaves):
        leaf_node = leaves - 1 + leaf
        top = 0
        stack[0] = 0
        while top >= 0:
            node = stack[top]
            top -= 1
            visits += 1
            if visits > most:
                return count, visits
            if not _overlap(box[leaf_node], box[node]):
                continue
            if node < leaves - 1:
                # the pairs of nodes whose last leaf comes before this one are complete
                level = 0
                while (2 << level) - 1 <= node:
                    level += 1
                for child in (2 * node + 2, 2 * node + 1):
                    if (child - (2 << level) + 2) << (depth - level - 1) > leaf:
                        top += 1
                        stack[top] = child
                continue
            other = node - leaves + 1
            for s in range((n * leaf) >> depth, (n * (leaf + 1)) >> depth):
                if not _touches_box(corners[s], box[node]):
                    continue
                for t in range(max(s + 1, (n * other) >> depth), (n * (other + 1)) >> depth):
                    visits += 1
                    if _meet(corners[s], corners[t], triangles[s], triangles[t]):
                        pairs[count, 0], pairs[count, 1] = s, t
                        count += 1
                        if count == len(pairs):
                            return count, visits
    return count, visits


@cached_njit(inline="always")
def _overlap(a, b):
    x = a[0, 0] <= b[1, 0] and b[0, 0] <= a[1, 0]
    y = a[0, 1] <= b[1, 1] and b[0, 1] <= a[1, 1]
    return x and y and a[0, 2] <= b[1, 2] and b[0, 2] <= a[1, 2]


@cached_njit(inline="always")
def _touches_box(p, box):
    for a in range(3):
        if min(p[0, a], p[1, a], p[2, a]) > box[1, a] or max(p[0, a], p[1, a], p[2, a]) < box[0, a]:
            return False
    return True


# ---- two triangles


@cached_njit()
def _meet(p, q, i, j):
    """Return whether triangles p and q (3, 3) of vertices i and j intersect beyond common vertices."""
    for a in range(3):
        low, high = min(p[0, a], p[1, a], p[2, a]), max(p[0, a], p[1, a], p[2, a])
        if low > max(q[0, a], q[1, a], q[2, a]) or min(q[0, a], q[1, a], q[2, a]) > high:
            return False
    shared, sum_i, sum_j = 0, 0, 0
    for a in range(3):
        for b in range(3):
            if i[a] == j[b]:
                shared += 1
                sum_i += a
                sum_j += b
    first, two, three = np.int64(0), np.int64(2), np.int64(3)  # literals would compile functions for each value
    if shared == 0:
        return not _are_separated(p, q, (first, three, first, three))
    if shared == 1:  # an intersection reaches an edge opposite to the vertex
        edge_p, edge_q = (sum_i + 1, two, first, three), (first, three, sum_j + 1, two)
        near = GAP_TOLERANCE * _extent(p, q)
        if _separates(_normal(q), p, q, edge_p, near) or _separates(_normal(p), p, q, edge_q, near):
            return False
        return not _are_separated(p, q, edge_p) or not _are_separated(p, q, edge_q)
    return shared == 3 or _are_folded(p, q, 3 - sum_i, 3 - sum_j)


@cached_njit()
def _are_separated(p, q, part):
    """Return whether an axis separates parts of p and q: (first, count) corners, a triangle or an edge."""
    near = GAP_TOLERANCE * _extent(p, q)
    if _separates(_normal(p), p, q, part, near) or _separates(_normal(q), p, q, part, near):
        return True
    edges_p, edges_q = 3 if part[1] == 3 else 1, 3 if part[3] == 3 else 1
    for a in range(edges_p):
        for b in range(edges_q):
            axis = _cross(_edge(p, part[0] + a), _edge(q, part[2] + b))
            if _separates(axis, p, q, part, near):
                return True
    for a in range(edges_p):  # in a common plane, of triangles and of edges
        for b in range(edges_q):
            e, f = _edge(p, part[0] + a), _edge(q, part[2] + b)
            n = _cross(e, f)
            if _separates(_cross(n, e), p, q, part, near) or _separates(_cross(n, f), p, q, part, near):
                return True
    return False


@cached_njit(inline="always")
def _extent(p, q):
    extent = 0.0
    for a in range(3):
        low = min(p[0, a], p[1, a], p[2, a], q[0, a], q[1, a], q[2, a])
        extent = max(extent, max(p[0, a], p[1, a], p[2, a], q[0, a], q[1, a], q[2, a]) - low)
    return extent


@cached_njit(inline="always")
def _normal(p):
    return _cross(_edge(p, 0), _edge(p, 1))


@cached_njit()
def _separates(axis, p, q, part, near):
    low_p, high_p, low_q, high_q = np.inf, -np.inf, np.inf, -np.inf
    for k in range(part[1]):
        c = (part[0] + k) % 3
        h = axis[0] * (p[c, 0] - p[0, 0]) + axis[1] * (p[c, 1] - p[0, 1]) + axis[2] * (p[c, 2] - p[0, 2])
        low_p, high_p = min(low_p, h), max(high_p, h)
    for k in range(part[3]):
        c = (part[2] + k) % 3
        h = axis[0] * (q[c, 0] - p[0, 0]) + axis[1] * (q[c, 1] - p[0, 1]) + axis[2] * (q[c, 2] - p[0, 2])
        low_q, high_q = min(low_q, h), max(high_q, h)
    slack = near * (abs(axis[0]) + abs(axis[1]) + abs(axis[2]))
    return low_q - high_p > slack or low_p - high_q > slack


@cached_njit()
def _are_folded(p, q, apex_p, apex_q):
    """Return whether two triangles with a common edge overlap."""
    e = _edge(p, apex_p + 1)
    u, v = _cross(e, _edge(p, apex_p)), _cross(e, _edge(q, apex_q))
    across = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    return across > 0 and _square(_cross(u, v)) <= FLAT_TOLERANCE**2 * _square(u) * _square(v)


@cached_njit(inline="always")
def _edge(p, k):
    a, b = k % 3, (k + 1) % 3
    return p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[b, 2] - p[a, 2]


@cached_njit(inline="always")
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@cached_njit(inline="always")
def _square(a):
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
