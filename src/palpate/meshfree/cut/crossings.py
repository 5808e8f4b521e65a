"""Crossings of lines with the triangles of a cut.

The triangles are in a tree of bounding boxes (Ericson, Real-Time Collision Detection, 2005): a line meets few of them.
A node within `ON_PLANE` spacings of a triangle's plane is on the side of its normal, everywhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints

ON_PLANE = 1e-6  # distance from a triangle below which a node is on the side of its normal, in spacings
SAME_COMPONENT = 0.3  # distance of a front from the plane of its component's triangles around it, in spacings
BOX_MARGIN = 1e-3  # around triangles, in spacings: more than `ON_PLANE` and rounding extend them
LEAF_TRIANGLES = 4  # largest number of triangles in a box without others
ANY_COMPONENT = -1  # for a line that no triangle lets pass


class TriangleTree(NamedTuple):
    """Triangles in bounding boxes. A box is followed by those in it, the first half of its triangles before the other.

    The arrays of triangles are in an order of their own.
    """

    boxes: Floats  # (b, 6) array [m]: middles, and half of the sides
    skip: Ints  # (b,) array: number of the box that follows those in this one
    triangles: Ints  # (b, 2) array: first triangle of a box without others, and the one after its last; 0 else
    planes: Floats  # (t, 3, 4) array: functions of `_planes`
    radii: Floats  # (t,) array [m]: of the spheres around the triangles
    components: Ints  # (t,) array
    spacing: float  # [m]


def triangle_tree(triangles: Floats, components: Ints, spacing: float) -> TriangleTree:
    """Return the tree of triangles (t, 3, 3) with the numbers (t,) of their components."""
    if not len(triangles):  # without compiling: every body is made with the tree of no cut
        no_numbers = np.zeros(0, np.int64)
        return TriangleTree(
            np.zeros((0, 6)), no_numbers, np.zeros((0, 2), np.int64), np.zeros((0, 3, 4)), np.zeros(0),
            components[no_numbers], float(spacing),
        )  # fmt: skip
    order, count = np.arange(len(triangles)), 2 * len(triangles)
    boxes, skip, within = np.empty((count, 6)), np.empty(count, np.int64), np.zeros((count, 2), np.int64)
    used = _divide(triangles, BOX_MARGIN * spacing, order, boxes, skip, within)
    planes, radii = np.empty((len(triangles), 3, 4)), np.empty(len(triangles))
    _planes(triangles[order], planes, radii)
    return TriangleTree(boxes[:used], skip[:used], within[:used], planes, radii, components[order], float(spacing))


@cached_njit(nogil=True)
def _divide(triangles, margin, order, boxes, skip, within):
    """Divide triangles into boxes at the medians of their longest sides; return how many boxes they are."""
    middles = np.empty((triangles.shape[0], 3))
    for t in range(triangles.shape[0]):
        for c in range(3):
            middles[t, c] = (triangles[t, 0, c] + triangles[t, 1, c] + triangles[t, 2, c]) / 3.0
    waiting, depth, count = np.empty((triangles.shape[0] + 1, 2), np.int64), 0, 0
    if triangles.shape[0]:
        waiting[0, 0], waiting[0, 1], depth = 0, triangles.shape[0], 1
    while depth:
        depth -= 1
        begin, end, longest = waiting[depth, 0], waiting[depth, 1], 0
        for c in range(3):
            low, high = np.inf, -np.inf
            for q in range(begin, end):
                for k in range(3):
                    value = triangles[order[q], k, c]
                    low, high = min(low, value), max(high, value)
            boxes[count, c], boxes[count, 3 + c] = 0.5 * (low + high), 0.5 * (high - low) + margin
            if boxes[count, 3 + c] > boxes[count, 3 + longest]:
                longest = c
        if end - begin <= LEAF_TRIANGLES:
            within[count, 0], within[count, 1] = begin, end
        else:
            order[begin:end] = order[begin:end][np.argsort(middles[order[begin:end], longest])]
            half = (begin + end) // 2
            waiting[depth, 0], waiting[depth, 1] = half, end
            waiting[depth + 1, 0], waiting[depth + 1, 1] = begin, half
            depth += 2
        count += 1
    for b in range(count - 1, -1, -1):
        skip[b] = b + 1 if within[b, 1] else skip[skip[b + 1]]
    return count


@cached_njit(nogil=True, error_model="numpy")
def _meets_box(boxes, b, ax, ay, az, bx, by, bz):
    """Return whether the line from A to B meets box b, by the axes that separate them."""
    dx, dy, dz = 0.5 * (bx - ax), 0.5 * (by - ay), 0.5 * (bz - az)
    cx, cy, cz = ax + dx - boxes[b, 0], ay + dy - boxes[b, 1], az + dz - boxes[b, 2]
    hx, hy, hz = boxes[b, 3], boxes[b, 4], boxes[b, 5]
    lx, ly, lz = abs(dx), abs(dy), abs(dz)
    if abs(cx) > hx + lx or abs(cy) > hy + ly or abs(cz) > hz + lz:
        return False
    return (
        abs(dy * cz - dz * cy) <= hy * lz + hz * ly
        and abs(dz * cx - dx * cz) <= hz * lx + hx * lz
        and abs(dx * cy - dy * cx) <= hx * ly + hy * lx
    )


@cached_njit(nogil=True, error_model="numpy")
def crosses(tree, ax, ay, az, bx, by, bz, component):
    """Return whether the line from A to B crosses a triangle.

    For a line to a place B on a front, triangles of the front's component do not count where B is near their planes.
    """
    boxes, skip, within, planes, radii, components, spacing = tree
    tiny, b = ON_PLANE * spacing, 0
    while b < boxes.shape[0]:
        if not _meets_box(boxes, b, ax, ay, az, bx, by, bz):
            b = skip[b]
            continue
        for q in range(within[b, 0], within[b, 1]):
            above, below = _value(planes, q, 0, ax, ay, az), _value(planes, q, 0, bx, by, bz)
            if components[q] == component and abs(below) < SAME_COMPONENT * spacing:
                continue
            above, below = tiny if abs(above) < tiny else above, tiny if abs(below) < tiny else below
            if (above > 0.0) == (below > 0.0):
                continue
            share, slack = above / (above - below), tiny / radii[q]
            x, y, z = ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az)
            s, t = _value(planes, q, 1, x, y, z), _value(planes, q, 2, x, y, z)
            if s > -slack and t > -slack and s + t < 1.0 + slack:
                return True
        b += 1
    return False


@cached_njit(nogil=True)
def _planes(triangles, planes, radii):
    """Write the functions n . x - d, s(x) and t(x) of triangles as coefficients (t, 3, 4), and the radii (t,).

    The first is the distance from the plane, the others are the coordinates of its points along two sides.
    """
    for q in range(triangles.shape[0]):
        corners, n = triangles[q], normal(triangles[q])
        radii[q] = sphere(triangles[q])[3]
        ux, uy, uz = difference(corners[1], corners[0])
        vx, vy, vz = difference(corners[2], corners[0])
        uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
        det = uu * vv - uv * uv
        planes[q, 0, 0], planes[q, 0, 1], planes[q, 0, 2] = n
        planes[q, 1, 0], planes[q, 1, 1] = (vv * ux - uv * vx) / det, (vv * uy - uv * vy) / det
        planes[q, 2, 0], planes[q, 2, 1] = (uu * vx - uv * ux) / det, (uu * vy - uv * uy) / det
        planes[q, 1, 2], planes[q, 2, 2] = (vv * uz - uv * vz) / det, (uu * vz - uv * uz) / det
        for k in range(3):
            planes[q, k, 3] = 0.0
            for c in range(3):
                planes[q, k, 3] -= planes[q, k, c] * corners[0, c]


@cached_njit(nogil=True, error_model="numpy")
def _value(planes, q, k, x, y, z):
    return planes[q, k, 0] * x + planes[q, k, 1] * y + planes[q, k, 2] * z + planes[q, k, 3]


@cached_njit(nogil=True)
def difference(a, b):
    """Return the components of a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@cached_njit(nogil=True)
def norm(x, y, z):
    """Return the length of a vector."""
    return np.sqrt(x * x + y * y + z * z)


@cached_njit(nogil=True)
def sphere(corners):
    """Return the mean of a triangle's corners, and the radius of the sphere about it that holds them."""
    x = (corners[0, 0] + corners[1, 0] + corners[2, 0]) / 3.0
    y = (corners[0, 1] + corners[1, 1] + corners[2, 1]) / 3.0
    z = (corners[0, 2] + corners[1, 2] + corners[2, 2]) / 3.0
    square = 0.0
    for k in range(3):
        square = max(square, (corners[k, 0] - x) ** 2 + (corners[k, 1] - y) ** 2 + (corners[k, 2] - z) ** 2)
    return x, y, z, np.sqrt(square)


@cached_njit(nogil=True)
def normal(corners):
    """Return the unit normal of a triangle, whose largest component is positive.

    It does not depend on the order of the corners: the rule for nodes on a plane is one for the whole plane.
    """
    ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    largest = x
    if abs(y) > abs(largest) * (1.0 + 1e-6):
        largest = y
    if abs(z) > abs(largest) * (1.0 + 1e-6):
        largest = z
    length = np.sqrt(x * x + y * y + z * z)
    if largest < 0.0:
        length = -length
    return x / length, y / length, z / length


@cached_njit(nogil=True)
def first_crossings(segments, triangles, shares):
    """Write the shares of segments (s, 2, 3) at which they first cross triangles (t, 3, 3); infinite without one."""
    planes = np.empty((triangles.shape[0], 3, 4))
    _planes(triangles, planes, np.empty(triangles.shape[0]))
    for k in range(segments.shape[0]):
        shares[k] = np.inf
        a, b = segments[k, 0], segments[k, 1]
        dx, dy, dz = difference(b, a)
        tiny = ON_PLANE * norm(dx, dy, dz)
        for q in range(triangles.shape[0]):
            above = _value(planes, q, 0, a[0], a[1], a[2])
            below = _value(planes, q, 0, b[0], b[1], b[2])
            above = tiny if abs(above) < tiny else above
            below = tiny if abs(below) < tiny else below
            if (above > 0.0) == (below > 0.0):
                continue
            share = above / (above - below)
            x, y, z = a[0] + share * dx, a[1] + share * dy, a[2] + share * dz
            s, t = _value(planes, q, 1, x, y, z), _value(planes, q, 2, x, y, z)
            if s > -1e-6 and t > -1e-6 and s + t < 1.0 + 1e-6:
                shares[k] = min(shares[k], share)
