"""Intersections of vertical lines with a closed surface."""

from __future__ import annotations

import numpy as np

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints


@cached_njit()
def _crossings(corners, low, step, nx, ny, start, height, write):
    """Count (or write) the heights at which vertical lines intersect triangles with corners (t, 3, 3)."""
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
    """Return the entry and exit heights of vertical lines on a grid of (x, y) through a closed surface.

    The first line is at `low` (2,) [m], the others a step [m] apart. Lines should not pass through vertices: shift them
    by an irrational part of the step.

    Line k = i ny + j crosses at ``height[start[k]:start[k + 1]]``, ascending, with start (nx ny + 1,). The crossings of
    a line with an odd number of them, which grazes the surface, are left out.
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
