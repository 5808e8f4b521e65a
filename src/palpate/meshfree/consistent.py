"""Derivatives that make a nodally summed energy exact for uniform stress.

The energy of a uniformly stressed body is summed over nodes. Its derivative with respect to the
displacement of node J is P times the sum over I of V_I g_IJ, with the weight g_IJ of J in the
gradient at I. By integration by parts, that sum must be zero inside, and at the boundary the node's
share B_J of the area vector. Weights of moving least squares satisfy this on regular clouds only;
elsewhere uniform stress would displace the nodes. Here the weights are changed as little as
possible to satisfy the condition and still differentiate linear fields exactly. This is
variationally consistent integration (Chen, Hillman and Rueter, Int. J. Numer. Methods Eng. 95,
2013), with one linear system for the cloud.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sparse
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree

from palpate.arrays import Floats, Ints
from palpate.faults import CloudError
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.quadrature import integration_weights, quadratic_residuals
from palpate.meshfree.stencils import Stencils, moving_least_squares

__all__ = ["consistent_gradient", "consistent_stencils"]

RESIDUAL_TOLERANCE = 1e-11  # largest residual of the condition, relative to V / h
MAX_ITERATIONS = 1000  # of conjugate gradients
MIN_PATCH_WIDTH, MAX_PATCHES = 4.0, 800  # smallest width in spacings; approximate largest number of patches
DIAGONAL_SHIFT = 1e-6  # shift of the patches' singular system, relative to its mean diagonal
LATTICE_SHARE = 0.5  # share of the nodes with stencils of their own above which a cloud counts as irregular
MAX_WEIGHT_CHANGE = 0.8  # of one weight, over 1 / h: the energy form does not support more (0.77 ran stably)

_VOLUME_ERROR = "volumes of the cloud must be about those of the cells between its points"


def consistent_stencils(cloud: Cloud, choices: Sequence[int]) -> tuple[int, Stencils, Floats, bool]:
    """Return stencils with consistent derivatives, for the first suitable number of neighbours.

    Parameters
    ----------
    cloud : Cloud
        In space.
    choices : sequence of int
        Numbers of neighbours, in the order of the attempts.

    Returns
    -------
    neighbours : int
        The number used.
    stencils : Stencils
        Stencils of first derivatives; `value` holds the weights of `quadratic_residuals`.
    volumes : (n,) array [m^3]
        Weights that integrate quadratic fields.
    lattice : bool
        True if many nodes share one arrangement of neighbours, whose fit is consistent already.

    Raises
    ------
    CloudError
        No choice is suitable; the message is that of the first one.
    """
    fault = None
    for neighbours in choices:
        try:
            return neighbours, *_consistent_stencils(cloud, neighbours)
        except CloudError as error:
            fault = fault or error
    raise fault or ValueError("no numbers of neighbours to choose from")


def _consistent_stencils(cloud: Cloud, neighbours: int) -> tuple[Stencils, Floats, bool]:
    stencils = moving_least_squares(cloud.points, order=2, neighbours=neighbours)
    volumes, misses = integration_weights(cloud, stencils), quadratic_residuals(stencils, cloud.points)
    row, first = stencils.row, stencils.first
    lattice = len(first) <= LATTICE_SHARE * len(cloud)
    if not lattice:  # few nodes share a stencil: the fit alone would not balance
        edges = cloud.boundary_vectors() * cloud.volumes[:, None]
        row, first = np.arange(len(cloud), dtype=np.int32), consistent_gradient(stencils, cloud.points, volumes, edges)
    nothing = np.zeros((0, 0, 0))
    own_first = -first.sum(axis=1)
    return replace(stencils, row=row, first=first, own_first=own_first, second=nothing, value=misses), volumes, lattice


def consistent_gradient(stencils: Stencils, points: Floats, volumes: Floats, boundary: Floats) -> Floats:
    """Return first-derivative weights for every node, shape (n, k, d) [1/m], in the order of `stencils.neighbours`.

    Parameters
    ----------
    stencils : Stencils
        Stencils of an interpolating fit; a node's own weight is minus the sum of the others.
    points : (n, d) array [m]
    volumes : (n,) array
        Nodal volumes (areas, for d = 2).
    boundary : (n, d) array
        Nodal area vectors (normals times lengths, for d = 2), zero inside. They are changed as
        little as possible to satisfy the divergence theorem for linear fields exactly.

    Raises
    ------
    CloudError
        The condition cannot be satisfied, or only with weights far from those of the fit.
    """
    n, d = points.shape
    near = stencils.neighbours
    present = near != np.arange(n)[:, None]
    node = np.repeat(np.arange(n), present.sum(axis=1))
    other = near[present]
    spacing = float(np.median(volumes) ** (1 / d))
    offset = (points[other] - points[node]) / spacing
    freedom = np.exp(-np.sum(offset**2, axis=1) / 4)  # near neighbours' weights change more than far ones'
    weights = spacing * stencils.first[stencils.row][present]
    size = volumes / np.median(volumes)
    pair = np.arange(len(node))
    divergence = sparse.csr_matrix(
        (np.concatenate([size[node], -size[node]]), (np.concatenate([other, node]), np.tile(pair, 2))), (n, len(pair))
    )
    exactness = sparse.csr_matrix(
        (offset.T.ravel(), ((d * node + np.arange(d)[:, None]).ravel(), np.tile(pair, d))), (n * d, len(pair))
    )
    scaled = divergence @ sparse.diags(freedom)
    moments = np.zeros((n, d, d))
    np.add.at(moments, node, freedom[:, None, None] * offset[:, :, None] * offset[:, None, :])
    try:
        inverse = sparse.bsr_matrix((np.linalg.inv(moments), np.arange(n), np.arange(n + 1))).tocsr()
    except np.linalg.LinAlgError:
        raise CloudError(_VOLUME_ERROR) from None
    coupling = scaled @ exactness.T
    system = (scaled @ divergence.T - coupling @ inverse @ coupling.T).tocsr()
    links = sparse.csr_matrix((np.ones(len(node)), (node, other)), (n, n))
    body = connected_components(links, directed=False)[1]  # bodies that no stencil connects balance by themselves
    target = boundary.copy()
    for k in range(int(body.max()) + 1):
        on_body = body == k
        target[on_body] = _balance_boundary(boundary[on_body], points[on_body], volumes[on_body])
    target *= spacing / np.median(volumes)
    missing = target - divergence @ weights
    multipliers = _solve(system, missing, points, spacing, body)
    change = freedom[:, None] * (divergence.T @ multipliers - exactness.T @ (inverse @ (coupling.T @ multipliers)))
    weights += change
    left, changed = np.abs(target - divergence @ weights).max(axis=1), np.abs(change).max(axis=1)
    if left.max() > RESIDUAL_TOLERANCE or changed.max() > MAX_WEIGHT_CHANGE:
        worst = int(np.argmax(left)) if left.max() > RESIDUAL_TOLERANCE else int(node[np.argmax(changed)])
        raise CloudError(
            f"the cloud is too irregular for consistent derivatives near node {worst} at {points[worst]} m "
            f"(weights change by {changed.max():.2g} / h, {left.max():.1g} is left): spread the points there",
            [worst],
        )
    result = np.zeros((*near.shape, d))
    result[present] = weights / spacing
    return result


def _solve(system: Any, sides: Floats, points: Floats, spacing: float, body: Ints) -> Floats:
    """Solve for all right-hand sides (n, d) at once, because most of the time is for reading the matrix."""
    shape = sides.shape
    diagonal, (patches, coarse) = system.diagonal()[:, None], _patches(system, points, spacing)
    linear = np.linalg.qr(np.column_stack([np.ones(len(points)), points - points.mean(axis=0)]))[0]
    if body.max() > 0:
        fields = [np.where((body == k)[:, None], linear, 0.0) for k in range(int(body.max()) + 1)]
        linear = np.linalg.qr(np.concatenate(fields, axis=1))[0]

    def remove_linear(field: Floats) -> Floats:  # linear fields of each body are in the null space
        return field - linear @ (linear.T @ field)

    def precondition(residual: Floats) -> Floats:
        rough = remove_linear(residual.reshape(shape))
        return remove_linear(rough / diagonal + patches @ cho_solve(coarse, patches.T @ rough)).ravel()

    size = (sides.size, sides.size)
    operator = LinearOperator(size, lambda x: (system @ x.reshape(shape)).ravel(), dtype=float)
    preconditioner = LinearOperator(size, precondition, dtype=float)
    solution, _ = cg(
        operator, sides.ravel(), rtol=0.0, atol=0.1 * RESIDUAL_TOLERANCE, maxiter=MAX_ITERATIONS, M=preconditioner
    )
    return np.asarray(solution.reshape(shape))


def _patches(system: Any, points: Floats, spacing: float) -> tuple[Any, Any]:
    """Return smooth fields (n, c) over patches some spacings wide, and the factor of the system projected on them.

    The system is that of a thin plate, with no energy in linear fields and little in long waves.
    Conjugate gradients alone would require as many steps as the square of the number of nodes
    across. The fields are products of linear fields and a partition of unity, which represent all
    long waves.
    """
    n, d = points.shape
    width = spacing * max(MIN_PATCH_WIDTH, (n / MAX_PATCHES) ** (1 / d))
    _, cell = np.unique(np.floor(points / width), axis=0, return_inverse=True)
    count = np.bincount(cell.ravel())
    centres = np.column_stack([np.bincount(cell.ravel(), points[:, a]) / count for a in range(d)])
    tree, nodes = cKDTree(centres), cKDTree(points)
    reach = max(1.5 * width, 1.1 * tree.query(points)[0].max())
    near = nodes.sparse_distance_matrix(tree, reach, output_type="coo_matrix")
    share = (1 - (near.data / reach) ** 2) ** 2
    share /= np.bincount(near.row, share, minlength=n)[near.row]
    offset = (points[near.row] - centres[near.col]) / width
    columns = [share, *(share * offset[:, a] for a in range(d))]
    fields = sparse.csr_matrix(
        (
            np.concatenate(columns),
            (np.tile(near.row, d + 1), np.concatenate([near.col + a * len(centres) for a in range(d + 1)])),
        ),
        (n, (d + 1) * len(centres)),
    )
    projected = (fields.T @ (system @ fields)).toarray()
    projected[np.diag_indices_from(projected)] += DIAGONAL_SHIFT * projected.diagonal().mean()
    try:
        return fields, cho_factor(projected, lower=True)
    except (np.linalg.LinAlgError, ValueError):
        raise CloudError(_VOLUME_ERROR) from None


def _balance_boundary(boundary: Floats, points: Floats, volumes: Floats) -> Floats:
    """Return boundary vectors with sum of B = 0 and sum of B_a X_b = V delta_ab, by the least change."""
    on = np.any(boundary != 0, axis=1)
    d = points.shape[1]
    linear = np.column_stack([np.ones(on.sum()), points[on] - points.mean(axis=0)])
    if np.linalg.matrix_rank(linear) < d + 1:
        raise CloudError("face_nodes, face_normals and face_areas of the cloud must describe a closed boundary")
    length = np.linalg.norm(boundary[on], axis=1)[:, None]
    target = np.vstack([np.zeros(d), volumes.sum() * np.eye(d)])
    missing = target - linear.T @ boundary[on]
    change = length * linear @ np.linalg.solve(linear.T @ (length * linear), missing)
    result = boundary.copy()
    result[on] += change
    return result
