"""The compliance of a body's surface that its modes leave: residual flexibility, from statics at rest.

A body whose modes C span slow and smooth motions answers forces on its surface nodes with what the modes do, and with

    R = A - C (C^T K C)^-1 C^T,    A = K^-1 on the surface nodes,

which is local, positive semidefinite, and without inertia as far as the modes hold all slow vibrations (MacNeal,
Computers & Structures 1, 1971; Rubin, AIAA J. 13, 1975). A is the inverse of the Schur complement of K on those nodes:
the last block of a Cholesky factor whose last rows are theirs.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.spatial import cKDTree

from palpate.arrays import Floats, Ints
from palpate.dynamics.solid.model import Solid
from palpate.faults import InputError
from palpate.meshfree.cloud import Cloud
from palpate.reduction.basis.linear_modes import rest_stiffness

__all__ = ["SOLVED", "carriers", "residual_flexibility"]


SOLVED = 5000  # nodes up to which the body's equations are solved: 1.8 GB
NEAR = 40  # nodes that a column is carried over from
MOST = 6  # carriers of a node
WIDTH = 0.6  # of the coarse spacing: where a carrier's weight has fallen to 1/e
ASIDE = 0.05  # least weight of a carrier whose normal points elsewhere


def residual_flexibility(body: Solid, nodes: Ints, points: Floats, columns: Floats, also: Ints | None = None) -> Floats:
    """Return what modes leave of the compliance of surface nodes at rest, rows 3 i + c of node i.

    Parameters
    ----------
    body : Solid
        In its energy form, of at most 5,000 nodes.
    nodes : (k,) int array
        None of them held.
    points : (n, 3) array [m]
        Where the modes are known.
    columns : (m, n, 3) array
        Modes, zero at the supports.
    also : (i,) int array, optional
        Other nodes, not held, whose displacements by forces on `nodes` are wanted.

    Returns
    -------
    (3 k + 3 i, 3 k) array [m/N]
        Rows of `nodes`, then those of `also`.

    Raises
    ------
    InputError
        A strong form, a body without supports, or too many nodes.
    """
    count = len(body.cloud)
    if count > SOLVED:
        raise InputError(
            f"statics of {count} nodes: at most {SOLVED} are solved; give reduce a coarser model of the same body "
            "(coarse=)"
        )
    if not body.fixed_mask.any():
        raise InputError("a body without supports has no static response: give it fixed=")
    if points is not body.cloud.points:
        flat = columns.transpose(1, 0, 2).reshape(len(points), -1)
        flat = RBFInterpolator(points, flat, neighbors=min(NEAR, len(points)))(body.cloud.points)
        columns = flat.reshape(count, -1, 3).transpose(1, 0, 2)
    interior = np.setdiff1d(np.flatnonzero(~body.fixed_mask), nodes)
    free = (3 * np.concatenate([interior, nodes])[:, None] + np.arange(3)).ravel()
    stiffness = rest_stiffness(body)[free][:, free]
    modes = columns.reshape(len(columns), -1)[:, free]
    modal = modes @ (stiffness @ modes.T)
    factor = cholesky(stiffness.toarray(order="F"), lower=True, overwrite_a=True, check_finite=False)
    last = np.ascontiguousarray(factor[-3 * len(nodes) :, -3 * len(nodes) :])
    own = modes[:, -3 * len(nodes) :]
    whole = cho_solve((last, True), np.eye(len(last)), overwrite_b=True)
    rest = whole - own.T @ np.linalg.solve(modal, own)
    rest = (rest + rest.T) / 2
    if also is None or not len(also):
        return np.asarray(rest)
    # of a factor's first rows L and the last ones B below them, the inner nodes follow the others by -L^-T B^T
    first = slice(3 * len(interior))
    follow = solve_triangular(factor[first, first], factor[3 * len(interior) :, first].T @ whole, lower=True, trans="T")
    rows = (3 * np.searchsorted(interior, also)[:, None] + np.arange(3)).ravel()
    return np.concatenate([rest, -follow[rows] - modes[:, rows].T @ np.linalg.solve(modal, own)])


def carriers(coarse: Cloud, those: Ints, fine: Cloud, nodes: Ints) -> tuple[Ints, Floats]:
    """Say which nodes of a coarse surface stand for those of a fine one.

    Parameters
    ----------
    coarse, fine : Cloud
        Of one body.
    those : (c,) int array
        Nodes of the coarse surface.
    nodes : (k,) int array
        Nodes of the fine one.

    Returns
    -------
    places : (k, w) int array
        In `those`.
    weights : (k, w) array
        Falling with the distance and where normals part; their sum is 1.
    """
    if coarse is fine:
        return np.searchsorted(those, nodes)[:, None], np.ones((len(nodes), 1))
    most = min(MOST, len(those))
    distances, places = cKDTree(coarse.points[those]).query(fine.points[nodes], k=most)
    distances, places = distances.reshape(-1, most), places.reshape(-1, most)
    along = np.einsum("kc,kwc->kw", _normals(fine)[nodes], _normals(coarse)[those][places])
    # relative to the nearest, so that none is lost where the coarse surface lies far off
    falling = np.exp((distances[:, :1] ** 2 - distances**2) / (WIDTH * coarse.spacing) ** 2)
    weights = falling * np.maximum(along, ASIDE)
    return places, weights / weights.sum(axis=1, keepdims=True)


def _normals(cloud: Cloud) -> Floats:
    normals = np.zeros_like(cloud.points)
    np.add.at(normals, cloud.face_nodes, cloud.face_normals)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(lengths > 0, lengths, 1.0))
