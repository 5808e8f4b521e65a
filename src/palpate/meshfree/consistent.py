"""Derivatives that make a nodally summed energy exact for uniform stress.

The energy of a uniformly stressed body is summed over nodes. Its derivative with respect to the
displacement of node J is P times the sum over I of V_I g_IJ, with the weight g_IJ of J in the
gradient at I. By integration by parts, that sum must be zero inside, and at the boundary the node's
share B_J of the area vector. Weights of moving least squares satisfy this far inside of a lattice
only; elsewhere uniform stress would displace the nodes. Here the weights are changed as little as
possible to satisfy the condition and still differentiate linear fields exactly. This is
variationally consistent integration (Chen, Hillman and Rueter, Int. J. Numer. Methods Eng. 95,
2013), with one linear system for the cloud.

Nodes of a lattice share weights: those with equal stencils, volumes and boundary vectors, as far as
the end corrections of the volumes reach. The condition then is the same at many nodes, and a small
system remains, whatever the size of the lattice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import CloudError
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.inner_gradient import with_inner_gradient
from palpate.meshfree.quadrature import integration_weights, quadratic_residuals
from palpate.meshfree.stencils import Stencils, moving_least_squares
from palpate.meshfree.surface_gradient import with_surface_gradient

RESIDUAL_TOLERANCE = 1e-11  # largest residual of the condition, relative to V / h
SHARED_TOLERANCE = 1e-9  # the same with shared rows: the volumes integrate linear fields as exactly
MAX_ITERATIONS = 1000  # of conjugate gradients
MIN_PATCH_WIDTH, MAX_PATCHES = 4.0, 800  # smallest width in spacings; approximate largest number of patches
DIAGONAL_SHIFT = 1e-6  # shift of the patches' singular system, relative to its mean diagonal
EQUAL_NUMBERS = 1e-9  # difference of volumes and boundary vectors, in units of the spacing, that counts as none
MAX_CONDITIONS = 4000  # of a system that is solved directly; a lattice has some 2,400 at most
DIRECT_SHIFT, NULL_DIAGONAL = 1e-10, 1e-12  # shift of its diagonal, and smallest one, relative to the largest
REFINEMENT_STEPS = 4  # of its solution: each decreases the error some 1e6 times
MAX_WEIGHT_CHANGE = 0.8  # of one weight, over 1 / h: the energy form does not support more (0.77 ran stably)

_VOLUME_ERROR = "volumes of the cloud must be about those of the cells between its points"


def consistent_stencils(cloud: Cloud, choices: Sequence[int]) -> tuple[int, Stencils, Floats]:
    """Return stencils with consistent derivatives of a cloud in space, for the first suitable number of neighbours.

    The numbers of `choices` are tried in their order. Returns the number used; the stencils of first derivatives, whose
    `value` holds the weights of `quadratic_residuals`; and volumes (n,) [m^3] that integrate quadratic fields.
    """
    fault = None
    for neighbours in choices:
        try:
            return neighbours, *_consistent_stencils(cloud, neighbours)
        except CloudError as error:
            fault = fault or error
    raise fault or ValueError("no numbers of neighbours to choose from")


def _consistent_stencils(cloud: Cloud, neighbours: int) -> tuple[Stencils, Floats]:
    stencils = moving_least_squares(cloud.points, order=2, neighbours=neighbours, hidden=cloud.hidden)
    volumes, misses = integration_weights(cloud, stencils), quadratic_residuals(stencils, cloud.points)
    edges = cloud.boundary_vectors() * cloud.volumes[:, None]
    stencils = with_surface_gradient(with_inner_gradient(stencils, cloud), cloud)
    every = np.arange(len(cloud))
    row = _alike(stencils, volumes, edges)
    if row.max() < every[-1]:
        same = (np.bincount(row, volumes) / np.bincount(row))[row]  # to the last bit
        try:
            first = consistent_gradient(stencils, cloud.points, same, edges, row)
            return _with_gradient(stencils, row, first, misses), same
        except CloudError:
            pass  # the nodes are alike, but no common change balances what is around them
    first = consistent_gradient(stencils, cloud.points, volumes, edges)
    return _with_gradient(stencils, every, first, misses), volumes


def _with_gradient(stencils: Stencils, row: Ints, first: Floats, misses: Floats) -> Stencils:
    fit = stencils.row[np.unique(row, return_index=True)[1]]
    return replace(
        stencils, row=row.astype(np.int32), first=first, own_first=-first.sum(axis=1), second=np.zeros((0, 0, 0)),
        value=misses[fit], own=stencils.own[fit], own_second=stencils.own_second[fit],
        condition=stencils.condition[fit],
    )  # fmt: skip


def _alike(stencils: Stencils, volumes: Floats, boundary: Floats) -> Ints:
    """Return a number (n,) for every node. Nodes of a body with equal stencils, volumes and boundary share it."""
    n, volume = len(volumes), float(np.median(volumes))
    if len(stencils.first) == n:
        return np.arange(n)
    numbers = np.column_stack([volumes / volume, boundary / volume ** (2 / 3)])
    rounded = np.rint(numbers / EQUAL_NUMBERS).astype(np.int64)
    keys = np.column_stack([stencils.row, _bodies(stencils.neighbours), rounded])
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


def _bodies(near: NDArray[np.int32]) -> Ints:
    """Return the number (n,) of every node's body: bodies that no stencil connects balance by themselves."""
    n = len(near)
    links = sparse.csr_matrix((np.ones(near.size), near.ravel(), np.arange(n + 1) * near.shape[1]), (n, n))
    return np.asarray(connected_components(links, directed=False)[1])


class _Pairs(NamedTuple):
    """Weights that the gradient has: one for every row and each of its neighbours."""

    sample: Ints  # (s,) int array: one node of every row
    present: NDArray[np.bool_]  # (s, k) bool array: the neighbours of a row, without padding
    # row, offset, freedom: (p,), (p, d), (p,) arrays: row of every weight, the offset of its neighbour in spacings, and
    # how easily the weight changes
    row: Ints
    offset: Floats
    freedom: Floats
    # node, other, pair: (e,) int arrays: every node, its neighbours, and the weight of each
    node: Ints
    other: Ints
    pair: Ints

    @classmethod
    def of(cls, near: NDArray[np.int32], row: Ints, points: Floats, spacing: float) -> _Pairs:
        sample = np.unique(row, return_index=True)[1]
        present = near[sample] != sample[:, None]
        number = (np.cumsum(present) - 1).reshape(present.shape)
        node, place = np.nonzero(near != np.arange(len(near))[:, None])
        each, of_row = np.nonzero(present)
        offset = (points[near[sample[each], of_row]] - points[sample[each]]) / spacing
        freedom = np.exp(-np.sum(offset**2, axis=1) / 4)  # near neighbours' weights change more than far ones'
        other = near[node, place].astype(np.int64)
        return cls(sample, present, each, offset, freedom, node, other, number[row[node], place])

    def divergence(self, sizes: Floats) -> Any:
        """Return the matrix (n, p) of the weights in the nodes' sums, for nodal volumes (n,)."""
        size = sizes[self.node]
        entries = np.concatenate([size, -size]), (np.concatenate([self.other, self.node]), np.tile(self.pair, 2))
        return sparse.csr_matrix(entries, (len(sizes), len(self.row)))

    def conditions(self, row: Ints) -> Ints:
        """Return a number (n,) for every node, which nodes share whose sums have the same weights."""
        if len(self.sample) == len(row):
            return row
        code = np.random.default_rng(0).integers(1, 1 << 62, len(self.row))
        received = np.zeros(len(row), dtype=np.int64)
        np.add.at(received, self.other, code[self.pair])  # wraps around, as hashes do
        return np.unique(np.column_stack([row, received]), axis=0, return_inverse=True)[1].ravel()


def consistent_gradient(
    stencils: Stencils, points: Floats, volumes: Floats, boundary: Floats, row: NDArray[np.integer[Any]] | None = None
) -> Floats:
    """Return first-derivative weights for every row, shape (s, k, d) [1/m], in the order of `stencils.neighbours`.

    The stencils are those of an interpolating fit; a node's own weight is minus the sum of the others. The points are
    (n, d) [m], the volumes (n,), areas for d = 2.

    `boundary` (n, d) are nodal area vectors (normals times lengths, for d = 2), zero inside. They are changed as little
    as possible to satisfy the divergence theorem for linear fields exactly.

    Nodes that share a `row` (n,) have equal stencils, volumes and boundary vectors. By default every node has its own.
    """
    (n, d), near = points.shape, stencils.neighbours
    number: Ints = (np.arange(n) if row is None else row).astype(np.int64)
    volume = float(np.median(volumes))
    spacing = float(volume ** (1 / d))
    pairs, body = _Pairs.of(near, number, points, spacing), _bodies(near)
    target = boundary.copy()
    for k in range(int(body.max()) + 1):
        on_body = body == k
        target[on_body] = _balance_boundary(boundary[on_body], points[on_body], volumes[on_body])
    target *= spacing / volume
    divergence = pairs.divergence(volumes / volume)
    weights = spacing * stencils.first[stencils.row[pairs.sample]][pairs.present]
    change = _least_change(pairs, divergence, target - divergence @ weights, number, points, spacing, body)
    weights += change
    left, changed = np.abs(target - divergence @ weights).max(axis=1), np.abs(change).max(axis=1)
    unbalanced = left.max() > (RESIDUAL_TOLERANCE if len(pairs.sample) == n else SHARED_TOLERANCE)
    if unbalanced or changed.max() > MAX_WEIGHT_CHANGE:
        worst = int(np.argmax(left) if unbalanced else pairs.sample[pairs.row[np.argmax(changed)]])
        raise CloudError(
            f"the cloud is too irregular for consistent derivatives near node {worst} at {points[worst]} m "
            f"(weights change by {changed.max():.2g} / h, {left.max():.1g} is left): spread the points there",
            [worst],
        )
    result = np.zeros((*pairs.present.shape, d))
    result[pairs.present] = weights / spacing
    return result


def _least_change(
    pairs: _Pairs, divergence: Any, missing: Floats, row: Ints, points: Floats, spacing: float, body: Ints
) -> Floats:
    """Return the least change (p, d) of the weights by which the sums of the nodes change by `missing` (n, d).

    The square of a change counts once for every node of its row. One condition stands for all
    nodes whose sums have the same weights.
    """
    (count, d), rows, condition = pairs.offset.shape, len(pairs.sample), pairs.conditions(row)
    times = 1 / np.sqrt(np.bincount(row))[pairs.row]
    offset = pairs.offset * times[:, None]
    moments = np.zeros((rows, d, d))
    np.add.at(moments, pairs.row, pairs.freedom[:, None, None] * offset[:, :, None] * offset[:, None, :])
    try:
        inverse = sparse.bsr_matrix((np.linalg.inv(moments), np.arange(rows), np.arange(rows + 1))).tocsr()
    except np.linalg.LinAlgError:
        raise CloudError(_VOLUME_ERROR) from None
    exactness = sparse.csr_matrix(
        (offset.T.ravel(), ((d * pairs.row + np.arange(d)[:, None]).ravel(), np.tile(np.arange(count), d))),
        (d * rows, count),
    )
    sums, shared = divergence @ sparse.diags(times), rows < len(row)
    if shared:
        entries = 1 / np.sqrt(np.bincount(condition))[condition], (condition, np.arange(len(row)))
        unit = sparse.csr_matrix(entries)
        sums, missing = unit @ sums, unit @ missing
    scaled = sums @ sparse.diags(pairs.freedom)
    coupling = scaled @ exactness.T
    system = (scaled @ sums.T - coupling @ inverse @ coupling.T).tocsr()
    multipliers = _solve_directly(system, missing) if shared else _solve(system, missing, points, spacing, body)
    change = sums.T @ multipliers - exactness.T @ (inverse @ (coupling.T @ multipliers))
    return np.asarray((pairs.freedom * times)[:, None] * change)


def _solve_directly(system: Any, sides: Floats) -> Floats:
    """Solve a small system, whose right-hand sides (q, d) have no part in its null space.

    Linear fields are in it, and other ones where many nodes share a row: its size is not known.
    """
    if len(sides) > MAX_CONDITIONS:
        raise CloudError(f"nodes must have at most {MAX_CONDITIONS} different surroundings, got {len(sides)}")
    diagonal = system.diagonal()
    scale = 1 / np.sqrt(np.maximum(diagonal, NULL_DIAGONAL * diagonal.max()))
    full = scale[:, None] * system.toarray() * scale
    full[np.diag_indices_from(full)] += DIRECT_SHIFT
    try:
        factor, solution = cho_factor(full, lower=True, overwrite_a=True), np.zeros_like(sides)
    except (np.linalg.LinAlgError, ValueError):
        raise CloudError(_VOLUME_ERROR) from None
    for _ in range(REFINEMENT_STEPS):
        solution += scale[:, None] * cho_solve(factor, scale[:, None] * (sides - system @ solution))
    return solution


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
