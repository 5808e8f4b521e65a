"""Depth of the surface of a reduced body in rigid tools, and tools in real time that stay above it, compiled.

The nodes in contact stay outside a tool. What lies between them need not: a small tool that stretches the surface
passes between the nodes, and the forces on them then point to the wrong side.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.dynamics.contact.kinds import BONDED, PLANE
from palpate.dynamics.contact.penetration import triangle_depth, way_above_surface
from palpate.dynamics.nodal.tool_path import END, START, limit_path
from palpate.reduction.contact.surface import PAIRS

# of triangles between nodes in contact, in spacings; nodes alone keep a tool out here, and so a triangle is deeper than
# in a full body, where edge midpoints do, too: beyond `MAX_SURFACE_DEPTH` the force is not trusted
MAX_DEPTH_BETWEEN_NODES = 0.5
FREE_WAY, PRESSING_WAY = 1.0, 0.25  # how far a tool may move in a period, in spacings; the latter along its force


@kernel_njit(fastmath={"contract"})
def store_depths(surface, contact, tools):
    """Write the largest depths of triangles whose three nodes were in contact in the last step to `contact.depth`."""
    pair_of, now = contact.pair_of, contact.now
    for t in range(tools.kind.shape[0]):
        contact.depth[t], kind, sizes, frame = 0.0, tools.kind[t], tools.sizes[t], tools.frames[t, 1]
        if kind in (PLANE, BONDED) or sizes[0] == -np.inf or contact.numbers[PAIRS] < 3:
            continue
        for e in range(contact.numbers[PAIRS]):
            if contact.tool[e] == t:
                pair_of[contact.node[e]] = e + 1
        for k in range(surface.triangles.shape[0]):
            corners = surface.triangles[k]
            i, j, m = pair_of[corners[0]], pair_of[corners[1]], pair_of[corners[2]]
            if min(i, j, m) > 0:
                a, b, c = now[i - 1], now[j - 1], now[m - 1]
                contact.depth[t] = triangle_depth(
                    kind, sizes, frame, (a[0], a[1], a[2]), (b[0], b[1], b[2]), (c[0], c[1], c[2]), contact.depth[t]
                )
        for e in range(contact.numbers[PAIRS]):
            pair_of[contact.node[e]] = 0


@kernel_njit(inner=True, fastmath={"contract"})
def hold_above_surface(surface, contact, tools, home, target):
    """Shorten the paths of tools in a period where they could pass between the nodes.

    A tool is held where it pushes on and the surface is `MAX_DEPTH_BETWEEN_NODES` deep in it. The pose that it
    reaches is then written into its part of the target (12 t,).
    """
    limit = MAX_DEPTH_BETWEEN_NODES * surface.spacing
    for t in range(tools.kind.shape[0]):
        if tools.kind[t] == BONDED or tools.sizes[t, 0] == -np.inf:  # forceps, or an absent tool
            continue
        along, path, first = 0.0, tools.path[t], 12 * t
        for i in range(contact.force.shape[1]):
            for d in range(3):
                along += contact.force[t, i, d] * (path[END, d, 3] - path[START, d, 3])
        most = (PRESSING_WAY if along > 0.0 else FREE_WAY) * surface.spacing
        if along > 0.0:
            most = min(most, way_above_surface(contact.depth[t], limit))
        if limit_path(path, most):
            for i in range(3):
                target[first + i] = path[END, i, 3] - home[t, i, 3]
                for j in range(3):
                    target[first + 3 + 3 * i + j] = path[END, i, j] - (1.0 if i == j else 0.0)
