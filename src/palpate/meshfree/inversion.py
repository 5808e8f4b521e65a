"""Cells between nodes, and how many of them a deformation turns inside out.

The gradient at a node says little of a body whose nodes have passed each other: its determinant may be positive again.
The tetrahedra between neighbouring nodes show it.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.visibility import is_pair

LONGEST_EDGE, MIN_VOLUME = 2.2, 0.02  # of a tetrahedron, in spacings; flat ones may turn in any deformation
NODE_SHIFT, SHIFT_SEED = 1e-6, 0  # of the nodes in spacings, since those of a lattice have no unique tetrahedra
SAFE_WAY = 0.05  # spacings by which nodes may move without turning a cell
CORNER_PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def cells_between(cloud: Cloud) -> Ints:
    """Return Delaunay tetrahedra (t, 4) of positive volume between near nodes in space that see each other."""
    points, spacing = cloud.points, cloud.spacing
    shift = NODE_SHIFT * spacing * np.random.default_rng(SHIFT_SEED).standard_normal(points.shape)
    cells = Delaunay(points + shift).simplices.astype(np.int64)
    lengths = [np.linalg.norm(points[cells[:, a]] - points[cells[:, b]], axis=1) for a, b in CORNER_PAIRS]
    near = np.max(lengths, axis=0) < LONGEST_EDGE * spacing
    volumes = _volumes(points, cells)
    near &= np.abs(volumes) > MIN_VOLUME * spacing**3
    for a, b in CORNER_PAIRS:
        near &= ~is_pair(cloud.hidden, cells[:, a], cells[:, b])
    cells[volumes < 0] = cells[volumes < 0][:, [1, 0, 2, 3]]
    return np.asarray(cells[near])


def inverted_share(cloud: Cloud, cells: Ints, displacements: Floats) -> float:
    """Return the share of cells (t, 4) that displacements (n, 3) [m] turn inside out."""
    if not len(cells) or np.abs(displacements).max() < SAFE_WAY * cloud.spacing:
        return 0.0
    return float(np.mean(_volumes(cloud.points + displacements, cells) < 0))


def _volumes(points: Floats, cells: Ints) -> Floats:
    """Return the signed volumes (t,) [m^3] of tetrahedra."""
    columns = np.ascontiguousarray(points.T)
    corners = columns[:, cells.T]  # (3, 4, t)
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    normal = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
    return np.asarray((a[0] * normal[0] + a[1] * normal[1] + a[2] * normal[2]) / 6)
