"""Nodal weights that integrate quadratic fields over a body.

A sum over nodal volumes is the trapezoidal rule: with five nodes across it makes a beam 12 % too
stiff in bending. Here the fit of a field is integrated over each node's cell,

    integral of f  =  sum over I of V_I (f_I + m_I . grad f_I + 1/2 M_I : grad grad f_I),

with the first and second moments m_I and M_I of the cell about its node. The sums of the
derivatives' weights give nodal weights. On a lattice the weights of the inner nodes do not change,
and those near a face become end corrections of Gregory's kind.

A node of small weight between heavy ones vibrates fast, and so limits the stable step of the body.
In poor spots of a filled cloud the corrections leave weights that are far too small, or negative.
There neighbours transfer weight to the node along the residual of a quadratic fit, which is zero
for quadratic fields. So the transfer preserves their integrals.

`conservative_smoothing` preserves the integral of a field that is smoothed at the nodes.
Derivatives at the nodes do not depend on all of a field: `quadratic_residuals` are a measure of the
rest.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import lsmr

from palpate.core.arrays import Floats
from palpate.core.faults import CloudError
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import Stencils

MIN_WEIGHT_RATIO = 0.3  # smallest weight over a node's volume: corrections of edges and corners multiply
# smallest weight of a node with at most one face, over its volume and over the median volume
MIN_SMOOTH_RATIO, MIN_MEDIAN_RATIO = 0.5, 0.25
TRANSFER_ROUNDS = 8  # rounds of transfers; what is missing then is added without them
INTEGRAL_TOLERANCE = 1e-9  # largest error of the integral of a smoothed field, relative to a node's volume
DERIVATIVE_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # the order of `Stencils.second`


def integration_weights(cloud: Cloud, stencils: Stencils) -> Floats:
    """Return positive weights [m^3], shape (n,), that sum to the volume of a body in space.

    The stencils are an interpolating fit of order 2 at its points.
    """
    volumes = cloud.volumes
    thickness = volumes[cloud.face_nodes] / cloud.face_areas
    shift = -0.5 * thickness[:, None] * cloud.face_normals  # of a cell's centre by each face
    centre = np.zeros_like(cloud.points)  # of the cell relative to the node
    np.add.at(centre, cloud.face_nodes, shift)
    # across one face the second moment about the node stays h^2/12: pairs of faces alone add to it
    single = np.zeros((len(cloud), 3, 3))
    np.add.at(single, cloud.face_nodes, shift[:, :, None] * shift[:, None, :])
    moment = cloud.spacing**2 / 12 * np.eye(3) + centre[:, :, None] * centre[:, None, :] - single
    second = np.stack([moment[:, a, b] * (0.5 if a == b else 1.0) for a, b in DERIVATIVE_PAIRS], axis=1)
    weights = volumes.copy()
    for moments, table in ((centre, stencils.first), (second, stencils.second)):
        shares = volumes[:, None] * np.einsum("nkw,nw->nk", table[stencils.row], moments)
        np.add.at(weights, stencils.neighbours, shares)
        weights -= shares.sum(axis=1)
    least = _least_weights(cloud, stencils)
    weights = np.maximum(_transfer(weights, least, cloud, stencils), np.maximum(least, MIN_WEIGHT_RATIO * volumes))
    return np.asarray(weights * (volumes.sum() / weights.sum()))


def _least_weights(cloud: Cloud, stencils: Stencils) -> Floats:
    """Return the weights (n,) [m^3] up to which nodes receive transfers.

    At edges and corners of a box the end corrections of several faces multiply to small weights,
    which are right as far as the stable step permits.
    """
    volumes, faces = cloud.volumes, np.bincount(cloud.face_nodes, minlength=len(cloud))
    distance = np.linalg.norm(cloud.points[stencils.neighbours] - cloud.points[:, None], axis=2)
    width = distance.sum(axis=1) / np.count_nonzero(distance, axis=1)  # padding has distance 0
    closer = np.minimum(width / np.median(width), 1.0)  # in refined parts
    least = np.maximum(MIN_SMOOTH_RATIO * volumes, MIN_MEDIAN_RATIO * np.median(volumes) * closer**3)
    return np.where(faces > 1, MIN_WEIGHT_RATIO * volumes, least)


def _transfer(weights: Floats, least: Floats, cloud: Cloud, stencils: Stencils) -> Floats:
    """Return weights raised to at least `least` where possible, with equal integrals of quadratic fields."""
    if not (weights < least).any():
        return weights
    weights, residuals = weights.copy(), quadratic_residuals(stencils, cloud.points)
    for _ in range(TRANSFER_ROUNDS):
        node = np.flatnonzero(weights < least)
        row = residuals[stencils.row[node]]
        missing = least[node] - weights[node]
        weights[node] += missing
        np.subtract.at(weights, stencils.neighbours[node], (missing / row.sum(axis=1))[:, None] * row)
    return weights


def conservative_smoothing(neighbours: NDArray[np.int32], values: Floats, volumes: Floats) -> tuple[Floats, Floats]:
    """Return the weights of a fit, changed as little as possible so that it preserves integrals.

    With the fitted values S f of a nodal field and the nodal weights V, V . S f = V . f for every field f, and
    constants are fitted exactly. Then the transposed fit S^T V p / V of a uniform p is p. Without the change it is 0.4
    p to 6 p near faces, edges and corners: a uniform pressure moves the nodes, and a body stretched three times over is
    unstable.

    Far from the faces of a lattice nothing changes, and linear fields remain exact. Near a face they do not: a fit that
    preserves the integral of x^2 and is exact for x everywhere would not smooth inside.

    The neighbours (n, k) of every node are padded with the node itself; `values` (n, k) are their weights in the fit,
    `volumes` (n,) [m^3]. Returns weights of every node's neighbours (n, k), in their order, and its own (n,).
    """
    n = len(volumes)
    node, place = np.nonzero(neighbours != np.arange(n)[:, None])
    other, pair = neighbours[node, place], np.arange(len(node))
    value, size = values.copy(), volumes / np.median(volumes)
    # a weight on another node adds to that node's share of the integral, and subtracts from its own node's
    entries = np.concatenate([size[node], -size[node]])
    gain = sparse.csr_matrix((entries, (np.concatenate([other, node]), np.tile(pair, 2))), (n, len(pair)))
    missing = -(gain @ value[node, place])
    change = lsmr(gain, missing, atol=1e-14, btol=1e-14, conlim=0.0, maxiter=20 * n)[0]
    left = np.abs(gain @ change - missing)
    if not left.max() < INTEGRAL_TOLERANCE:
        raise CloudError(
            f"no smoothing of the pressure keeps its integral near node {np.argmax(left)} ({left.max():.1g} of a nodal "
            f"volume is left); spread the points there"
        )
    value[node, place] += change
    return value, 1.0 - value.sum(axis=1)


def quadratic_residuals(stencils: Stencils, points: Floats) -> Floats:
    """Return the weights of the residual of a quadratic fit at its own node, which is zero for quadratic fields.

    The weights (s, k) have one row for each row of the stencils; the node's own weight is minus their sum. The points
    are (n, 3) [m].

    The fit has equal weights for all neighbours, at least 33 on a lattice: two spacings to each side. With small
    weights for far neighbours, as in moving least squares, a fit to three planes of a lattice represents a wave of two
    spacings exactly, without a residual.
    """
    rows = len(stencils.first)
    node = np.empty(rows, dtype=int)
    node[stencils.row] = np.arange(len(points))  # one of every row
    result = np.empty((rows, stencils.neighbours.shape[1]))
    for part in np.array_split(np.arange(rows), rows // 4096 + 1):  # limits the memory for monomials
        near = stencils.neighbours[node[part]]
        present = near != node[part, None]
        offset = points[near] - points[node[part], None]
        offset /= np.abs(offset).max()
        squares = [offset[..., a] * offset[..., b] for a, b in DERIVATIVE_PAIRS]
        monomials = np.stack([np.ones(near.shape), *np.moveaxis(offset, 2, 0), *squares], axis=2) * present[:, :, None]
        moments = np.einsum("nki,nkj->nij", monomials, monomials)
        moments[:, 0, 0] += 1.0  # the node itself
        result[part] = -np.einsum("nki,ni->nk", monomials, np.linalg.inv(moments)[:, :, 0])
    return result
