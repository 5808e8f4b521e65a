"""Where rays enter and leave a closed surface, and where a surface passes through itself."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["column_crossings", "self_intersections"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True)
def _crossings(corners, low, step, nx, ny, start, height, write):  # type: ignore[no-untyped-def]
    """Count (or write) the heights at which vertical lines meet triangles with corners (t, 3, 3)."""
    for t in range(corners.shape[0]):
        x0, y0, z0 = corners[t, 0]
        x1, y1, z1 = corners[t, 1]
        x2, y2, z2 = corners[t, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        first = max(int(np.ceil((min(x0, x1, x2) - low[0]) / step)), 0)
        last = min(int(np.floor((max(x0, x1, x2) - low[0]) / step)), nx - 1)
        bottom = max(int(np.ceil((min(y0, y1, y2) - low[1]) / step)), 0)
        top = min(int(np.floor((max(y0, y1, y2) - low[1]) / step)), ny - 1)
        for i in range(first, last + 1):
            x = low[0] + i * step
            for j in range(bottom, top + 1):
                y = low[1] + j * step
                a = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
                b = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
                c = 1.0 - a - b
                if a >= 0.0 and b >= 0.0 and c >= 0.0:
                    column = i * ny + j
                    if write:
                        height[start[column]] = a * z0 + b * z1 + c * z2
                    start[column] += 1


def column_crossings(
    vertices: Floats, triangles: Ints, low: Floats, step: float, shape: tuple[int, int]
) -> tuple[Ints, Floats]:
    """Return where vertical lines on a grid of (x, y) enter and leave a closed surface.

    Parameters
    ----------
    vertices, triangles : (v, 3), (t, 3) arrays
        Closed.
    low : (2,) array [m]
        First line. Lines should not run through vertices: shift them by an irrational part of the step.
    step : float [m]
        Between lines.
    shape : (nx, ny)

    Returns
    -------
    start, height : (nx ny + 1,), (c,) arrays
        Line i ny + j crosses at ``height[start[k]:start[k + 1]]``, ascending; an odd number of crossings, of a line
        that grazes the surface, is left out.
    """
    corners = vertices[triangles]
    nx, ny = shape
    count = np.zeros(nx * ny, dtype=np.int64)
    _crossings(corners, low, step, nx, ny, count, np.zeros(0), False)
    start = np.concatenate([[0], np.cumsum(count)])
    height = np.empty(start[-1])
    _crossings(corners, low, step, nx, ny, start[:-1].copy(), height, True)
    line = np.repeat(np.arange(nx * ny), count)
    height = height[np.lexsort((height, line))]
    odd = count % 2 == 1
    height = height[~odd[line]]
    return np.concatenate([[0], np.cumsum(np.where(odd, 0, count))]), height


def self_intersections(vertices: Floats, triangles: Ints) -> Ints:
    """Return pairs (k, 2) of triangles without a common vertex of which one's edge passes through the other."""
    corners = np.ascontiguousarray(vertices[triangles])
    low, high = corners.min(axis=1), corners.max(axis=1)
    cell = 1.5 * float(np.mean(np.max(high - low, axis=1)))
    origin = low.min(axis=0)
    first = np.floor((low - origin) / cell).astype(np.int64)
    last = np.floor((high - origin) / cell).astype(np.int64)
    span = last.max(axis=0) + 1
    count = np.prod(last - first + 1, axis=1)
    key, owner = np.empty(count.sum(), dtype=np.int64), np.empty(count.sum(), dtype=np.int64)
    _cells(first, last, span, key, owner)
    order = np.argsort(key, kind="stable")
    found = _pairs(corners, np.ascontiguousarray(triangles), low, high, key[order], owner[order])
    return np.unique(np.array(found, dtype=np.int64).reshape(-1, 2), axis=0)


@njit(cache=True)
def _cells(first, last, span, key, owner):  # type: ignore[no-untyped-def]
    at = 0
    for t in range(len(first)):
        for i in range(first[t, 0], last[t, 0] + 1):
            for j in range(first[t, 1], last[t, 1] + 1):
                for k in range(first[t, 2], last[t, 2] + 1):
                    key[at] = (i * span[1] + j) * span[2] + k
                    owner[at] = t
                    at += 1


@njit(cache=True)
def _pairs(corners, triangles, low, high, key, owner):  # type: ignore[no-untyped-def]
    found = [-1]
    found.pop()
    begin = 0
    while begin < len(key):
        end = begin + 1
        while end < len(key) and key[end] == key[begin]:
            end += 1
        for p in range(begin, end):
            for q in range(p + 1, end):
                s, t = owner[p], owner[q]
                apart = False
                for a in range(3):
                    if low[s, a] > high[t, a] or low[t, a] > high[s, a]:
                        apart = True
                    for b in range(3):
                        if triangles[s, a] == triangles[t, b]:
                            apart = True
                if not apart and (_pierced(corners[s], corners[t]) or _pierced(corners[t], corners[s])):
                    found.append(min(s, t))
                    found.append(max(s, t))
        begin = end
    return found


@njit(cache=True)
def _side(a, b, c, d):  # type: ignore[no-untyped-def]
    """Six times the signed volume of a tetrahedron."""
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    z0, z1, z2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return x0 * (y1 * z2 - y2 * z1) - x1 * (y0 * z2 - y2 * z0) + x2 * (y0 * z1 - y1 * z0)


@njit(cache=True)
def _pierced(triangle, other):  # type: ignore[no-untyped-def]
    """Whether an edge of the other triangle passes through this one."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    above = np.empty(3)
    for k in range(3):
        above[k] = _side(a, b, c, other[k])
    for k in range(3):
        m = (k + 1) % 3
        if above[k] * above[m] >= 0.0:
            continue
        p, q = other[k], other[m]
        u, v, w = _side(p, q, a, b), _side(p, q, b, c), _side(p, q, c, a)
        if (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0):
            return True
    return False
