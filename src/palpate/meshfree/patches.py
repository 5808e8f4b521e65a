"""Surface patches: weights of the nodes in the motion of the surface area of a surface node.

The compliance of a single loaded node is too large: in the energy form it is more than four times
that of a uniform pressure on the node's surface area. A tool acts on this area, the patch. So the
displacement of a patch is computed from the nodes around,

    u_patch = sum over nodes of w_j u_j.

The weights are a kernel mean over the surface nodes that face the same way. They are changed as
little as possible (in the kernel's own norm, with the nodes below the surface) so that linear
fields are exact. Then patches rotate with a body, and forces on them have the same moment as their
shares w_j on the nodes.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.cut.diffraction_lengths import diffraction_lengths
from palpate.meshfree.cut.surface import NO_CUT, CutSurface
from palpate.meshfree.visibility import is_pair

# kernel radius in surface spacings, closest to Hertz: on a lattice (validation/contact.py), and on filled layers and
# balls (validation/patches.py)
LATTICE_KERNEL, KERNEL_RADIUS = 1.55, 1.42
MAX_PATCH_DEPTH = 2.0  # largest distance of interior nodes in a patch, in spacings
SAME_FACE_COSINE = 0.85  # of normals of nodes on one face; 0.82 at the corner of a box
MAX_PATCH_NODES = 96  # candidates within that distance


def surface_patches(cloud: Cloud, *, kernel: float | None = None, cut: CutSurface = NO_CUT) -> sparse.csr_array:
    """Return the weights (n, n) of nodes in patch displacements; the rows of interior nodes are identity.

    Rows sum to one, and reproduce linear fields. `kernel` is the radius of the kernel in surface spacings, by default
    `LATTICE_KERNEL` of a lattice, else `KERNEL_RADIUS`. A patch does not reach across `cut`.
    """
    count, points = len(cloud), cloud.points
    area = np.zeros((count, 3))
    np.add.at(area, cloud.face_nodes, cloud.face_areas[:, None] * cloud.face_normals)
    surface = np.unique(cloud.face_nodes)
    normal = area / np.maximum(np.linalg.norm(area, axis=1), np.finfo(float).tiny)[:, None]
    kernel = kernel or (LATTICE_KERNEL if cloud.is_lattice else KERNEL_RADIUS)
    reach = kernel * np.sqrt(cloud.face_areas.sum() / len(surface))
    farthest = max(reach, MAX_PATCH_DEPTH * cloud.spacing)
    distance, near = cKDTree(points).query(
        points[surface], k=min(MAX_PATCH_NODES, count), distance_upper_bound=farthest
    )
    near = np.where(np.isfinite(distance), near, surface[:, None])
    if cloud.hidden.nnz:
        row = np.repeat(surface, near.shape[1])
        distance[is_pair(cloud.hidden, row, near.ravel()).reshape(near.shape)] = np.inf
        near = np.where(np.isfinite(distance), near, surface[:, None])
    if len(cut.triangles):
        distance = _distances_round(cut, points, surface, near, distance)
        near = np.where(np.isfinite(distance), near, surface[:, None])
    across = _kernel(distance, reach)
    below = np.where(np.isin(near, surface), across, _kernel(distance, MAX_PATCH_DEPTH * cloud.spacing))
    facing = np.maximum(np.einsum("skc,sc->sk", normal[near], normal[surface]), 0.0)
    weights = across * np.where(near == surface[:, None], 1.0, facing)
    weights /= weights.sum(axis=1, keepdims=True)
    linear = np.concatenate([np.ones((*near.shape, 1)), (points[near] - points[surface, None]) / farthest], axis=2)
    missing = np.eye(4)[0] - np.einsum("sk,ski->si", weights, linear)
    moments = np.einsum("sk,ski,skj->sij", below, linear, linear)
    # for nodes in one plane, linear fields across it are zero: use the pseudoinverse
    change = np.einsum("sij,sj->si", np.linalg.pinv(moments, rcond=1e-9, hermitian=True), missing)
    weights += below * np.einsum("ski,si->sk", linear, change)
    rest = np.setdiff1d(np.arange(count), surface)
    rows, columns = np.concatenate([np.repeat(surface, near.shape[1]), rest]), np.concatenate([near.ravel(), rest])
    table = sparse.coo_array((np.concatenate([weights.ravel(), np.ones(len(rest))]), (rows, columns)), (count, count))
    result = sparse.csr_array(table)
    result.data[np.abs(result.data) < 1e-12] = 0.0
    result.eliminate_zeros()
    return result


def spread_load(cloud: Cloud, nodes: Ints, values: Floats) -> tuple[Ints, Floats]:
    """Return nodes and shares of a load on a part of a smooth surface, distributed over the patches of its nodes.

    A load that ends at a border inside of a face acts on the surface, not on single nodes. Loads on complete faces stay
    as they are: they balance uniform stress exactly. The shares of surface nodes (g,) are `values` (g, ...); the
    returned ones have the same sum and the same moments about any point.
    """
    if cloud.points.shape[1] != 3 or not _ends_inside(cloud, nodes):
        return nodes, values
    flat = values.reshape(len(nodes), -1)
    spread = surface_patches(cloud)[nodes].T @ flat
    taken = np.flatnonzero(np.any(spread != 0.0, axis=1))
    return taken, np.asarray(spread[taken]).reshape(len(taken), *values.shape[1:])


def _ends_inside(cloud: Cloud, nodes: Ints) -> bool:
    """Return True if nodes of the surface are next to others that face the same way."""
    corners = cloud.triangles
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    inside = np.zeros(len(cloud), dtype=bool)
    inside[nodes] = True
    pairs = pairs[inside[pairs[:, 0]] != inside[pairs[:, 1]]]
    area = np.zeros((len(cloud), 3))
    np.add.at(area, cloud.face_nodes, cloud.face_areas[:, None] * cloud.face_normals)
    first, second = area[pairs[:, 0]], area[pairs[:, 1]]
    along = np.sum(first * second, axis=1)
    return bool(np.any(along > SAME_FACE_COSINE * np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)))


def _distances_round(cut: CutSurface, points: Floats, nodes: Ints, near: Ints, distance: Floats) -> Floats:
    """Return distances (s, k) [m] of nodes from others along the paths round the fronts of a cut."""
    count, paths = near.shape[1], np.empty(near.size)
    start = np.arange(0, near.size + 1, count)
    every = np.ascontiguousarray(near.ravel(), dtype=np.int64)
    diffraction_lengths(points, nodes, start, every, cut.tree, cut.fronts, cut.front_components, paths)
    return np.where(np.isfinite(distance), np.maximum(distance, paths.reshape(near.shape)), distance)


def _kernel(distance: Floats, reach: float) -> Floats:
    """Return a kernel that decreases from 1 to 0 over a radius."""
    return np.where(distance < reach, 0.5 + 0.5 * np.cos(np.pi * np.minimum(distance, reach) / reach), 0.0)
