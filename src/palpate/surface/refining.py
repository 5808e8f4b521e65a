"""Surface refinement and Poisson-disc sampling."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints


def refine_surface(vertices: Floats, triangles: Ints, max_edge: Callable[[Floats], Floats]) -> tuple[Floats, Ints]:
    """Return a closed surface refined by bisection until no edge exceeds a length.

    `max_edge` returns the largest edge length (k,) [m] at points (k, 3).
    """
    finished = [triangles[:0]]
    for _ in range(30):
        ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
        a, b = vertices[ends[..., 0]], vertices[ends[..., 1]]
        split = np.linalg.norm(a - b, axis=2) > max_edge((0.5 * (a + b)).reshape(-1, 3)).reshape(-1, 3)
        unsplit = ~split.any(axis=1)
        # both triangles of an edge have the same criterion: an edge below the limit is never split
        finished.append(triangles[unsplit])
        if unsplit.all():
            break
        triangles, split, ends = triangles[~unsplit], split[~unsplit], ends[~unsplit]
        key = ends[..., 0] * len(vertices) + ends[..., 1]
        once, inverse = np.unique(key[split], return_inverse=True)
        number = np.full(split.shape, -1)
        number[split] = len(vertices) + inverse.ravel()
        first, second = np.divmod(once, len(vertices))
        vertices = np.concatenate([vertices, 0.5 * (vertices[first] + vertices[second])])
        triangles = _split(triangles, number, vertices)
    else:
        finished.append(triangles)
    triangles = np.concatenate(finished)
    return vertices, triangles


def _split(triangles: Ints, new: Ints, vertices: Floats) -> Ints:
    """Return triangles split at new vertices (t, 3) on their edges 01, 12, 20; -1 stands for none."""
    count = (new >= 0).sum(axis=1)
    parts = [triangles[count == 0]]
    for wanted in (1, 2):
        corners, at = triangles[count == wanted], new[count == wanted]
        # permute the corners: a single split edge becomes 01; the unsplit edge next to two split ones becomes 20
        place = np.argmax(at >= 0, axis=1) if wanted == 1 else (np.argmin(at, axis=1) + 1) % 3
        turn = (np.arange(3) + place[:, None]) % 3
        (a, b, c), (ab, bc, _) = np.take_along_axis(corners, turn, 1).T, np.take_along_axis(at, turn, 1).T
        if wanted == 1:
            parts += [np.column_stack([a, ab, c]), np.column_stack([ab, b, c])]
        else:
            # the shorter diagonal of the quadrilateral a, ab, bc, c
            first = np.linalg.norm(vertices[a] - vertices[bc], axis=1) < np.linalg.norm(
                vertices[ab] - vertices[c], axis=1
            )
            parts.append(np.column_stack([ab, b, bc]))
            parts.append(np.where(first[:, None], np.column_stack([a, ab, bc]), np.column_stack([a, ab, c])))
            parts.append(np.where(first[:, None], np.column_stack([a, bc, c]), np.column_stack([ab, bc, c])))
    (a, b, c), (ab, bc, ca) = triangles[count == 3].T, new[count == 3].T
    parts += [np.column_stack(each) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate(parts)


def poisson_discs(vertices: Floats, radius: Floats, order: Ints) -> Ints:
    """Return the indices of a maximal Poisson-disc sample of points (v, 3) [m], processed in an order (v,).

    Each point has a radius (v,) [m]; for a pair, the smaller one counts.
    """
    cell = float(radius.max())
    low = vertices.min(axis=0)
    place = np.floor((vertices - low) / cell).astype(np.int64) + 1
    span = place.max(axis=0) + 2
    key = (place[:, 0] * span[1] + place[:, 1]) * span[2] + place[:, 2]
    cells, inverse = np.unique(key, return_inverse=True)
    steps = np.array([(i * span[1] + j) * span[2] + k for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
    around = np.searchsorted(cells, cells[:, None] + steps)
    around = np.where(cells[np.minimum(around, len(cells) - 1)] == cells[:, None] + steps, around, -1)
    return np.flatnonzero(_throw_discs(vertices, radius, order, inverse.ravel(), around) >= 0)


@cached_njit()
def _throw_discs(vertices, radius, order, cell, around):
    label = np.full(len(vertices), -1, dtype=np.int64)
    head = np.full(len(around), -1, dtype=np.int64)
    following = np.full(len(vertices), -1, dtype=np.int64)
    count = 0
    for v in order:
        free = True
        for c in around[cell[v]]:
            if c < 0:
                continue
            other = head[c]
            while other >= 0 and free:
                distance = 0.0
                for a in range(3):
                    distance += (vertices[v, a] - vertices[other, a]) ** 2
                reach = min(radius[v], radius[other])
                if distance < reach * reach:
                    free = False
                other = following[other]
            if not free:
                break
        if free:
            label[v] = count
            count += 1
            following[v] = head[cell[v]]
            head[cell[v]] = v
    return label
