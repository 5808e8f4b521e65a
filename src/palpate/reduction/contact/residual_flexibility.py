"""Residual flexibility of a body's surface with respect to its modes, from statics at rest.

A body whose modes C span slow and smooth motions responds to forces on its surface nodes by its modes,
and by

    R = A - C (C^T K C)^-1 C^T,    A = K^-1 on the surface nodes.

R is local and positive semidefinite, and it has no inertia as far as the modes span all slow vibrations
(MacNeal, Computers & Structures 1, 1971; Rubin, AIAA J. 13, 1975). A is the inverse of the Schur
complement of K on those nodes: the last block of a Cholesky factor whose last rows are theirs.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.dynamics.loads.supports import free_directions
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.cloud import Cloud
from palpate.reduction.basis.linear_modes import check_supported, rest_stiffness

MAX_NODES = 5000  # of a body whose equations are solved: 1.8 GB
INTERPOLATION_NODES = 40  # in the interpolation of a mode
MAX_CARRIERS = 6  # of a node
KERNEL_WIDTH = 0.6  # distance at which a carrier's weight falls to 1/e, in coarse spacings
MIN_ALIGNMENT = 0.05  # least factor on the weight of a carrier with another normal


def residual_flexibility(
    body: EnergySolid, nodes: Ints, points: Floats, columns: Floats, interior_nodes: Ints | None = None
) -> Floats:
    """Return the residual flexibility of surface nodes at rest, (3 k + 3 i, 3 k) [m/N], rows 3 i + c of node i.

    The body is in its energy form, and has at most 5,000 nodes. `nodes` (k,) are free surface nodes. The rows of
    `interior_nodes` (i,), other free nodes that forces on `nodes` displace, follow theirs. The modes `columns`
    (m, n, 3) are zero at the supports, and are at `points` (n, 3) [m].
    """
    count = len(body.cloud)
    if count > MAX_NODES:
        raise InputError(
            f"body must have at most {MAX_NODES} nodes for statics, got {count}; "
            "give hyper_reduce a coarser model of the same body with coarse="
        )
    check_supported(body)
    unconstrained = rest_stiffness(body)
    if points is not body.cloud.points:
        flat = columns.transpose(1, 0, 2).reshape(len(points), -1)
        flat = RBFInterpolator(points, flat, neighbors=min(INTERPOLATION_NODES, len(points)))(body.cloud.points)
        columns = flat.reshape(count, -1, 3).transpose(1, 0, 2)
    basis, numbers = free_directions(body.supported)
    surface = np.searchsorted(numbers, (3 * nodes[:, None] + np.arange(3)).ravel())
    interior = np.setdiff1d(np.arange(len(numbers)), surface)
    free = basis[:, np.concatenate([interior, surface])]
    stiffness = free.T @ unconstrained @ free
    modes = columns.reshape(len(columns), -1) @ free
    modal = modes @ (stiffness @ modes.T)
    factor = cholesky(stiffness.toarray(order="F"), lower=True, overwrite_a=True, check_finite=False)
    last = np.ascontiguousarray(factor[-3 * len(nodes) :, -3 * len(nodes) :])
    surface_modes = modes[:, -3 * len(nodes) :]
    compliance = cho_solve((last, True), np.eye(len(last)), overwrite_b=True)
    rest = compliance - surface_modes.T @ np.linalg.solve(modal, surface_modes)
    rest = (rest + rest.T) / 2
    if interior_nodes is None or not len(interior_nodes):
        return np.asarray(rest)
    # with a factor's first rows L and the last rows B below them, the interior depends on the surface by -L^-T B^T
    first = slice(len(interior))
    follow = solve_triangular(
        factor[first, first], factor[len(interior) :, first].T @ compliance, lower=True, trans="T"
    )
    rows = np.searchsorted(numbers[interior], (3 * interior_nodes[:, None] + np.arange(3)).ravel())
    return np.concatenate([rest, -follow[rows] - modes[:, rows].T @ np.linalg.solve(modal, surface_modes)])


def carriers(coarse: Cloud, coarse_nodes: Ints, fine: Cloud, nodes: Ints) -> tuple[Ints, Floats]:
    """Return the nodes of a coarse surface that represent those of a fine one, and their weights, both (k, w).

    They are places in `coarse_nodes` (c,) of one body for `nodes` (k,). The weights decay with the distance and the
    angle between the normals; their sum is 1.
    """
    if coarse is fine:
        return np.searchsorted(coarse_nodes, nodes)[:, None], np.ones((len(nodes), 1))
    most = min(MAX_CARRIERS, len(coarse_nodes))
    distances, places = cKDTree(coarse.points[coarse_nodes]).query(fine.points[nodes], k=most)
    distances, places = distances.reshape(-1, most), places.reshape(-1, most)
    alignment = np.einsum("kc,kwc->kw", _normals(fine)[nodes], _normals(coarse)[coarse_nodes][places])
    # relative to the nearest, which prevents underflow where the coarse surface is far off
    decay = np.exp((distances[:, :1] ** 2 - distances**2) / (KERNEL_WIDTH * coarse.spacing) ** 2)
    weights = decay * np.maximum(alignment, MIN_ALIGNMENT)
    return places, weights / weights.sum(axis=1, keepdims=True)


def _normals(cloud: Cloud) -> Floats:
    normals = np.zeros_like(cloud.points)
    np.add.at(normals, cloud.face_nodes, cloud.face_normals)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(lengths > 0, lengths, 1.0))
