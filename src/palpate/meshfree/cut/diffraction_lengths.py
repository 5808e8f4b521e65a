"""Diffraction lengths: lengths of bonds round the fronts of a cut (diffraction criterion).

A bond that crosses no triangle has its own length. The length of one that does is that of the shortest path round a
front that crosses nothing else (`palpate.meshfree.cut.surface`).
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.code_cache import cached_njit
from palpate.meshfree.cut.crossings import ANY_COMPONENT, crosses, norm

MAX_WAY = 1.6 * 2.3  # longest way round a front, in spacings


@cached_njit(nogil=True, error_model="numpy")
def _near_fronts(fronts, ax, ay, az, most, close, table):
    """Write the numbers of fronts (e, 2, 3) near A, and what their ways depend on, (12, e); return how many they are.

    The rows are the beginning, the unit vector, the length, and of A the place along the front, the distance off its
    line, and the offset from its beginning.
    """
    count = 0
    for q in range(fronts.shape[0]):
        px, py, pz = ax - fronts[q, 0, 0], ay - fronts[q, 0, 1], az - fronts[q, 0, 2]
        if px * px + py * py + pz * pz >= most * most:
            continue
        ex, ey, ez = (
            fronts[q, 1, 0] - fronts[q, 0, 0],
            fronts[q, 1, 1] - fronts[q, 0, 1],
            fronts[q, 1, 2] - fronts[q, 0, 2],
        )
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        ex, ey, ez = ex / length, ey / length, ez / length
        along = px * ex + py * ey + pz * ez
        off = np.sqrt(max(px * px + py * py + pz * pz - along * along, 0.0))
        close[count] = q
        table[0, count], table[1, count], table[2, count] = fronts[q, 0, 0], fronts[q, 0, 1], fronts[q, 0, 2]
        table[3, count], table[4, count], table[5, count] = ex, ey, ez
        table[6, count], table[7, count], table[8, count] = length, along, off
        table[9, count], table[10, count], table[11, count] = px, py, pz
        count += 1
    return count


@cached_njit(nogil=True, error_model="numpy")
def _ways_round(dx, dy, dz, count, table, ways, feet):
    """Write the lengths of the shortest ways from A to A + d that touch each near front, and the places along them."""
    for q in range(count):  # without branches, for vector registers
        ex, ey, ez, length = table[3, q], table[4, q], table[5, q], table[6, q]
        along_a, off_a = table[7, q], table[8, q]
        qx, qy, qz = table[9, q] + dx, table[10, q] + dy, table[11, q] + dz
        along_b = qx * ex + qy * ey + qz * ez
        off_b = np.sqrt(max(qx * qx + qy * qy + qz * qz - along_b * along_b, 0.0))
        foot = (along_a * off_b + along_b * off_a) / max(off_a + off_b, 1e-12 * length)
        foot = min(max(foot, 0.0), length)
        feet[q] = foot
        da, db = along_a - foot, along_b - foot
        ways[q] = np.sqrt(off_a * off_a + da * da) + np.sqrt(off_b * off_b + db * db)


@cached_njit(nogil=True, error_model="numpy")
def _shortest_free(ax, ay, az, bx, by, bz, near, front_components, most, tree):
    """Return the length of the shortest way from A to B round a near front that crosses nothing, or infinity."""
    edges, table, ways, feet, count = near
    while count > 0:
        q = np.argmin(ways[:count])
        length = ways[q]
        if not length <= most:
            break
        component, foot = front_components[edges[q]], feet[q]
        px, py, pz = (
            table[0, q] + foot * table[3, q],
            table[1, q] + foot * table[4, q],
            table[2, q] + foot * table[5, q],
        )
        if not (crosses(tree, ax, ay, az, px, py, pz, component) or crosses(tree, bx, by, bz, px, py, pz, component)):
            return length
        ways[q] = np.inf
    return np.inf


@cached_njit(nogil=True, error_model="numpy")
def diffraction_lengths(points, nodes, start, near, tree, fronts, front_components, paths):
    """Write the lengths of bonds round the fronts of a cut to `paths` (t,) [m]; infinite for severed ones.

    `near` (t,) are the neighbours of `nodes` (m,), each of which begin at `start` (m + 1,). The points are (n, 3) [m];
    fronts (e, 2, 3) [m] have their components (e,).
    """
    most, reach = MAX_WAY * tree.spacing, (MAX_WAY + 1.0) * tree.spacing
    edges, table = np.empty(fronts.shape[0], np.int64), np.empty((12, fronts.shape[0]))
    ways, feet = np.empty(fronts.shape[0]), np.empty(fronts.shape[0])
    for m in range(nodes.shape[0]):
        ax, ay, az = points[nodes[m], 0], points[nodes[m], 1], points[nodes[m], 2]
        fronts_near = -1
        for p in range(start[m], start[m + 1]):
            bx, by, bz = points[near[p], 0], points[near[p], 1], points[near[p], 2]
            dx, dy, dz = bx - ax, by - ay, bz - az
            length = norm(dx, dy, dz)
            paths[p] = length
            if crosses(tree, ax, ay, az, bx, by, bz, ANY_COMPONENT):
                if fronts_near < 0:
                    fronts_near = _near_fronts(fronts, ax, ay, az, reach, edges, table)
                _ways_round(dx, dy, dz, fronts_near, table, ways, feet)
                best = _shortest_free(
                    ax, ay, az, bx, by, bz, (edges, table, ways, feet, fronts_near), front_components, most, tree
                )
                paths[p] = max(best, length) if best <= most else np.inf
