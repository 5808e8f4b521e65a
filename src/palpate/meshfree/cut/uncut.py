"""What the stencils near a cut depend on, of the body without it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.meshfree.surface_gradient import SurfaceForms
from palpate.meshfree.visibility import is_pair

WIDEST_REACH = 3.2  # largest reach of a cut node, in spacings
REACH_MARGIN = 1.05  # radius of a stencil over the distance of its last node
SIZE_FACTOR, LARGEST_SIZE = 1.2, 6.0  # largest q over that of uncut nodes, and in itself


class UncutStencils(NamedTuple):
    """What the stencils of cut nodes depend on, of the uncut body."""

    points: Floats  # (n, 3) array [m]
    volumes: Floats  # (n,) array [m^3]
    spacing: float  # [m]
    # reach, smoothing_reach: (n,) arrays [m]: distance of the last node of a stencil
    reach: Floats
    smoothing_reach: Floats
    limit: Floats  # (n,) array: largest size q of a fit
    sums: Floats  # (n, 3) array [m^2]: sum over I of V_I g_IJ
    tree: cKDTree  # of the points
    on_surface: NDArray[np.bool_]  # (n,) bool array
    cubic: NDArray[np.bool_]  # (n,) bool array: nodes whose first derivatives are those of cubic fits
    surface: SurfaceForms  # by which the first derivatives of surface nodes are fits in the depth
    widest: Floats  # (n,) array [m]: largest distance of neighbours of cut nodes
    # bond_start, bond_near: (n + 1,), (t,) int arrays: first bond of every node, and the other nodes of all bonds: all
    # nodes within that distance
    bond_start: Ints
    bond_near: NDArray[np.int32]


def uncut_stencils(
    points: Floats, volumes: Floats, spacing: float, near: Any, first: Floats, smoothing_near: Any, surface: Any,
    cubic: NDArray[np.bool_], forms: SurfaceForms, hidden: csr_array,
) -> UncutStencils:  # fmt: skip
    """Return what the stencils of cut nodes depend on.

    `points` are (n, 3) [m], `volumes` (n,) [m^3]. The node itself fills rows of the neighbours `near` (n, k), whose
    weights of first derivatives `first` are (n, k, 3), and of `smoothing_near` (n, l). First derivatives of `cubic`
    (n,) nodes are those of cubic fits. `surface` (k,) are the nodes of the surface. `hidden` (n, n) are pairs without
    bonds: `Cloud.hidden`.
    """
    size = spacing**2 * (np.sum(first**2, axis=(1, 2)) + np.sum(first.sum(axis=1) ** 2, axis=1))
    common = min(SIZE_FACTOR * float(size.max()), LARGEST_SIZE)
    shares = volumes[:, None, None] * first
    sums = -shares.sum(axis=1)
    np.add.at(sums, near, shares)
    reach, smoothing_reach = (
        np.linalg.norm(points[each] - points[:, None], axis=2).max(axis=1) for each in (near, smoothing_near)
    )
    limit = np.maximum(common, SIZE_FACTOR * size)
    on_surface = np.zeros(len(points), dtype=np.bool_)
    on_surface[surface] = True
    tree = cKDTree(points)
    widest = REACH_MARGIN * np.maximum(WIDEST_REACH * spacing, np.maximum(reach, smoothing_reach))
    return UncutStencils(
        points, volumes, spacing, reach, smoothing_reach, limit, sums, tree, on_surface, cubic, forms, widest,
        *_bonds_within(points, tree, widest, hidden),
    )  # fmt: skip


def _bonds_within(points: Floats, tree: cKDTree, widest: Floats, hidden: csr_array) -> tuple[Ints, NDArray[np.int32]]:
    """Return the first bond of every node, and the other nodes of all bonds, in ascending order for each node."""
    pairs = tree.query_pairs(float(widest.max()), output_type="ndarray")
    pairs = pairs[~is_pair(hidden, *pairs.T)]
    square = np.sum((points[pairs[:, 0]] - points[pairs[:, 1]]) ** 2, axis=1)
    both = [pairs[square <= widest[pairs[:, k]] ** 2][:, [k, 1 - k]] for k in range(2)]
    node, near = np.concatenate(both).T
    order = np.lexsort((near, node))
    count = np.bincount(node, minlength=len(points))
    return np.concatenate([[0], np.cumsum(count)]).astype(np.int64), near[order].astype(np.int32)
