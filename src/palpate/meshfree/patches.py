"""Patches of surface: by which nodes the piece of surface moves that a surface node stands for.

A node that is loaded alone sinks deeper than the piece of surface it stands for: in the energy form its own compliance
is about eight times that of an even pressure on this piece. What a tool meets is the piece, so that its displacement is
taken from the nodes around,

    u_patch = sum over nodes of w_j u_j,

with the mean under a kernel over the surface nodes that face the same way, changed as little as possible (in the
kernel's own norm, with the nodes below the surface) such that linear fields are exact: then patches turn with a body,
and forces on them have the same moment as their shares w_j on the nodes.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.meshfree.cloud import Cloud

__all__ = ["surface_patches"]

Floats = NDArray[np.float64]

REACH = (
    1.8  # of the kernel, in spacings of the surface: of those tried it keeps lattices and filled surfaces near Hertz
)
MOST = 64  # nodes within it


def surface_patches(cloud: Cloud) -> sparse.csr_array:
    """Return the weights (n, n) of the nodes in the displacements of the patches; inside the body a node is its own.

    Parameters
    ----------
    cloud : Cloud
        In space.

    Returns
    -------
    csr_array
        Rows sum to one, and keep linear fields.
    """
    count, points = len(cloud), cloud.points
    area = np.zeros((count, 3))
    np.add.at(area, cloud.face_nodes, cloud.face_areas[:, None] * cloud.face_normals)
    surface = np.unique(cloud.face_nodes)
    normal = area / np.maximum(np.linalg.norm(area, axis=1), np.finfo(float).tiny)[:, None]
    reach = REACH * np.sqrt(cloud.face_areas.sum() / len(surface))
    distance, near = cKDTree(points).query(points[surface], k=min(MOST, count), distance_upper_bound=reach)
    near = np.where(np.isfinite(distance), near, surface[:, None])
    kernel = np.where(np.isfinite(distance), 0.5 + 0.5 * np.cos(np.pi * np.minimum(distance / reach, 1.0)), 0.0)
    facing = np.maximum(np.einsum("skc,sc->sk", normal[near], normal[surface]), 0.0)
    weights = kernel * np.where(near == surface[:, None], 1.0, facing)
    weights /= weights.sum(axis=1, keepdims=True)
    linear = np.concatenate([np.ones((*near.shape, 1)), (points[near] - points[surface, None]) / reach], axis=2)
    missing = np.eye(4)[0] - np.einsum("sk,ski->si", weights, linear)
    moments = np.einsum("sk,ski,skj->sij", kernel, linear, linear)
    # nodes that lie in one plane miss nothing across it
    change = np.einsum("sij,sj->si", np.linalg.pinv(moments, rcond=1e-9, hermitian=True), missing)
    weights += kernel * np.einsum("ski,si->sk", linear, change)
    rest = np.setdiff1d(np.arange(count), surface)
    rows, columns = np.concatenate([np.repeat(surface, near.shape[1]), rest]), np.concatenate([near.ravel(), rest])
    table = sparse.coo_array((np.concatenate([weights.ravel(), np.ones(len(rest))]), (rows, columns)), (count, count))
    result = sparse.csr_array(table)
    result.data[np.abs(result.data) < 1e-12] = 0.0
    result.eliminate_zeros()
    return result
