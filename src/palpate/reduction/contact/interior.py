"""Displacements of the interior nodes by the residual flexibility of a body.

A force of a tool on the surface moves an interior node, in addition to the modes, by R f. The rows of R
are those of interior nodes in the residual flexibility at rest, as for the surface
(`palpate.reduction.contact.residual_flexibility`). Strains are small there: unlike near the tool, R
needs neither a factor nor stiffening to agree with runs under known forces. Linear fits carry the
displacements of a coarser model over to the interior nodes of a finer one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cloud import Cloud

MAX_SOURCES = 12  # coarse nodes in the fit of a fine node
KERNEL_WIDTH = 0.6  # distance at which a source's weight falls to 1/e, in coarse spacings
SLOPE_RIDGE = 1e-3  # regularisation of the slopes of a fit, as a fraction of the weights


class Interior(NamedTuple):
    """Linear dependence of the interior nodes on forces on the surface, in addition to the modes."""

    nodes: Ints  # (i,) int array: free interior nodes
    # (3 c, 3 b) float32 array [m/N]: displacements of b of them, or of a coarser model's, columns 3 b + component, by
    # forces on the carriers of the surface (`SurfaceCompliance.carriers`)
    flexibility: NDArray[np.float32]
    sources: Ints  # (i, w) int array: sources of each node: first the b columns of the flexibility, then the carriers
    shares: Floats  # (i, w) array: weights of the sources
    factor: float = 1.0  # ratio of the surface's flexibility (`SurfaceCompliance.flexibility`) to R


def interior_flexibility(
    coarse: Cloud, coarse_nodes: Ints, carriers: Ints, rows: Floats, fine: Cloud, nodes: Ints
) -> Interior:
    """Return the dependence of the interior nodes of a body on forces on its surface.

    `coarse` and `fine` are clouds of one body, and may be the same. Their free interior nodes are `coarse_nodes` (b,)
    and `nodes` (i,); `carriers` (c,) are the free surface nodes of the coarse cloud. `rows` (3 b, 3 c) [m/N] are the
    residual flexibility of `coarse_nodes` for forces on the carriers.
    """
    if coarse is fine:
        sources, shares = np.searchsorted(coarse_nodes, nodes)[:, None], np.ones((len(nodes), 1))
    else:
        sources_at = coarse.points[np.concatenate([coarse_nodes, carriers])]
        sources, shares = _linear_fits(fine.points[nodes], sources_at, coarse.spacing)
    return Interior(nodes, np.ascontiguousarray(rows.T, dtype=np.float32), sources, shares)


def _linear_fits(points: Floats, source_points: Floats, spacing: float) -> tuple[Ints, Floats]:
    """Return sources and weights (i, w) of linear fits at points to values at known positions."""
    distances, sources = cKDTree(source_points).query(points, k=range(1, min(MAX_SOURCES, len(source_points)) + 1))
    weights = np.exp((distances[:, :1] ** 2 - distances**2) / (KERNEL_WIDTH * spacing) ** 2)
    away = (source_points[sources] - points[:, None]) / spacing
    basis = np.concatenate([np.ones((*sources.shape, 1)), away], axis=2)
    moments = np.einsum("iw,iwp,iwq->ipq", weights, basis, basis)
    moments[:, [1, 2, 3], [1, 2, 3]] += SLOPE_RIDGE * weights.sum(axis=1, keepdims=True)
    level = np.linalg.solve(moments, np.eye(4)[None, :, :1])[:, :, 0]
    return sources, weights * np.einsum("iwp,ip->iw", basis, level)


def interior_displacements(interior: Interior, forces: Floats, surface: Floats) -> Floats:
    """Return the displacements (i, 3) [m] of the interior nodes by a tool, in addition to the modes.

    The forces (c, 3) [N] of the tool act on the carriers of the surface, whose displacements by
    `SurfaceCompliance.flexibility` are `surface` (c, 3) [m].
    """
    source_displacements = np.concatenate(
        [flexible_displacements(interior.flexibility, forces), surface / interior.factor]
    )
    return np.asarray(np.einsum("iw,iwc->ic", interior.shares, source_displacements[interior.sources]))


def flexible_displacements(flexibility: NDArray[np.float32], forces: Floats) -> Floats:
    """Return the displacements (b, 3) [m] by a flexibility (3 c, 3 b) and sparse forces (c, 3) [N]."""
    loaded = np.flatnonzero(forces.any(axis=1))
    rows = (3 * loaded[:, None] + np.arange(3)).ravel()
    return np.asarray(forces[loaded].reshape(-1) @ flexibility[rows]).reshape(-1, 3)
