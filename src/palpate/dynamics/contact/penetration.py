"""Depth of the surface's triangles in rigid tools, compiled.

Contact impulses keep the patches of nodes and of the edge midpoints out of a tool. This is a check
of what lies between them. Tools are convex, so the depth of a point in one is a concave function, and
a few points of a triangle give its largest depth within some per cent of the spacing.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.compiled.reference import reference
from palpate.dynamics.contact.geometry import gap, patch
from palpate.dynamics.contact.kinds import BLADE, BONDED, PLANE

MAX_SURFACE_DEPTH = 0.3  # of the surface in a tool, in spacings; deeper, a tool passes between the nodes
# depth of the surface in a tool from which on it is slowed, and how far it may then move in a period, over the largest
SLOW_DEPTH, SLOW_WAY = 0.8, 0.15
EDGE_PARTS = 4  # of the edges of a triangle, between the points whose depths are compared


@kernel_njit(inner=True)
def way_above_surface(depth, limit):
    """Return how far [m] a pushing tool may move in a period: less from `SLOW_DEPTH` on, zero at the largest depth."""
    least = SLOW_DEPTH * limit
    return np.inf if depth <= least else max(0.0, limit - depth) / (limit - least) * SLOW_WAY * limit


@kernel_njit(inner=True)
def triangle_depth(kind, sizes, frame, a, b, c, least):
    """Return the largest depth [m] in a tool of a triangle with corners a, b, c (x, y, z); at least `least`."""
    ax, ay, az = a
    bx, by, bz = b
    cx, cy, cz = c
    x, y, z = (ax + bx + cx) / 3, (ay + by + cy) / 3, (az + bz + cz) / 3
    reach = max((ax - x) ** 2 + (ay - y) ** 2 + (az - z) ** 2, (bx - x) ** 2 + (by - y) ** 2 + (bz - z) ** 2)
    reach = np.sqrt(max(reach, (cx - x) ** 2 + (cy - y) ** 2 + (cz - z) ** 2))
    if gap(kind, sizes, frame, x, y, z)[0] > reach - least:  # a distance changes by at most the way
        return least
    worst = least
    for m in range(EDGE_PARTS + 1):
        for n in range(EDGE_PARTS + 1 - m):
            p, q = m / EDGE_PARTS, n / EDGE_PARTS
            r = 1.0 - p - q
            depth = -gap(
                kind, sizes, frame, p * ax + q * bx + r * cx, p * ay + q * by + r * cy, p * az + q * bz + r * cz
            )[0]
            worst = max(worst, depth)
    return worst


@kernel_njit()
def deepest_triangle(contacts, t, frame, triangles, u, least):
    """Return the largest depth [m] of surface triangles (k, 3) in tool t, and the triangle.

    They are `least` [m] and -1 where none is deeper. The `frame` of the tool is (3, 4), the displacements `u` (n, 3)
    [m].
    """
    kind, sizes, worst, where = contacts.tools.kind[t], contacts.tools.sizes[t], least, -1
    if kind in (PLANE, BONDED, BLADE):  # the corners of a triangle are its deepest points in a plane
        return worst, where
    patches, points = reference(contacts.patches), contacts.patches.points
    until, around = contacts.patches.prescribed_until, contacts.tools.radius[t] + contacts.patches.radius
    for k in range(triangles.shape[0]):
        i = triangles[k, 0]
        if max(until[i], until[triangles[k, 1]], until[triangles[k, 2]]) == np.inf:  # a tool presses over a support
            continue
        square = 0.0
        for c in range(3):
            square += (points[i, c] + u[i, c] - frame[c, 3]) ** 2
        if not square < around * around:
            continue
        ax, ay, az, _, _, _ = patch(patches, i, 0.0, u, u)
        bx, by, bz, _, _, _ = patch(patches, triangles[k, 1], 0.0, u, u)
        cx, cy, cz, _, _, _ = patch(patches, triangles[k, 2], 0.0, u, u)
        depth = triangle_depth(kind, sizes, frame, (ax, ay, az), (bx, by, bz), (cx, cy, cz), worst)
        if depth > worst:
            worst, where = depth, k
    return worst, where
