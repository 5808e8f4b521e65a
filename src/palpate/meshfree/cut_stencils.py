"""Stencils of the nodes near a cut.

Weights of moving least squares follow from the ways of the bonds round the fronts
(`palpate.meshfree.cut_surface`) in place of their distances. The reach of a node keeps the sum of its weights: it is
continuous in the position of the front. A quadratic fit is used if its size

    q = h^2 (sum of |g_J|^2 + |sum of g_J|^2)

is not much above that of uncut nodes, else a linear one. A node for which neither is small enough is *released*: it
leaves all stencils.

A uniform stress along the faces of a cut must move no node. So the weights change as little as possible, in the norm
of g^2 / f with f = exp(-|X_IJ|^2 / 4 h^2), for the part along the cut of the sum over I of V_I g_IJ to keep its uncut
value, and for linear fields to remain exact. This is variationally consistent integration (Chen, Hillman and Rueter,
Int. J. Numer. Methods Eng. 95, 2013) without the component that a free face changes. The smoothing changes as little
as possible for the integrals of smoothed fields to remain.

Sums that no small change keeps, as in a slice between two cuts, are kept only in part: their multipliers are
regularized.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.arrays import Floats, Ints
from palpate.code_cache import cached_njit
from palpate.meshfree.cut_surface import CutSurface, bond_paths, nearest_normals

__all__ = [
    "CutState",
    "FittedRows",
    "UncutStencils",
    "conserve_integrals",
    "fit_rows",
    "keep_uniform_stress",
    "uncut_stencils",
]

WIDEST_REACH = 3.2  # largest reach of a cut node, in spacings
REACH_MARGIN = 1.05  # radius of a stencil over the distance of its last node
SIZE_FACTOR, LARGEST_SIZE = 1.2, 6.0  # largest q over that of uncut nodes, and in itself
REACH_BISECTIONS = 30
RAMP_WIDTH = 0.045  # range of distances in which a node enters the hourglass residual, over the reach
LEAST_PIVOT = 1e-10  # of a moment matrix, relative to its diagonal
MAX_ITERATIONS, RESIDUAL_TOLERANCE = 400, 1e-11  # of the iterations for the changes; relative to V / h
WINDOW_ITERATIONS, SLOWEST_DECREASE = 40, 0.5  # iterations after which the residual must have decreased by a factor
LEAST_PROGRESS, LEAST_SCALE = 1e-13, 1e-3
MAX_CHANGE = 1.5  # size q of a change above which the sums of its nodes need not be kept; 1 where they can be kept
REGULARIZATION_SHARES = (0.01, 0.1, 1.0)  # of the multipliers of such sums, relative to their diagonal, in attempts
QUADRATIC_FIT, LINEAR_FIT, RELEASED_FIT = 0, 1, 2  # kinds of a fit


class UncutStencils(NamedTuple):
    """What the stencils of cut nodes depend on, of the uncut body.

    Parameters
    ----------
    points : (n, 3) array [m]
    volumes : (n,) array [m^3]
    spacing : float [m]
    reach, smoothing_reach : (n,) arrays [m]
        Distance of the last node of a stencil.
    limit : (n,) array
        Largest size q of a fit.
    sums : (n, 3) array [m^2]
        Sum over I of V_I g_IJ.
    tree : cKDTree
        Of the points.
    on_surface : (n,) bool array
    widest : (n,) array [m]
        Largest distance of neighbours of cut nodes.
    bond_start, bond_near : (n + 1,), (t,) int arrays
        First bond of every node, and the other nodes of all bonds: all nodes within that distance.
    """

    points: Floats
    volumes: Floats
    spacing: float
    reach: Floats
    smoothing_reach: Floats
    limit: Floats
    sums: Floats
    tree: cKDTree
    on_surface: NDArray[np.bool_]
    widest: Floats
    bond_start: Ints
    bond_near: NDArray[np.int32]


class CutState(NamedTuple):
    """The cut of a body.

    Parameters
    ----------
    surface : CutSurface
    uncut : UncutStencils
    sums : (n, 3) array [m^2]
        Sum over I of V_I g_IJ.
    checks : (n,) array
        Sums of the lengths of every node's bonds, which change with any of them; 0 where no bond is longer.
    touched, released, removed : (n,) bool arrays
        Nodes whose stencils the cut has changed, those that left all stencils, and those of the latter that left the
        body, too.
    residuals : tuple of float
        Largest errors of the uniform stress along the cut and of the kept integrals.
    """

    surface: CutSurface
    uncut: UncutStencils
    sums: Floats
    checks: Floats
    touched: NDArray[np.bool_]
    released: NDArray[np.bool_]
    removed: NDArray[np.bool_]
    residuals: tuple[float, float]


class FittedRows(NamedTuple):
    """Stencils of some nodes in compressed rows.

    Parameters
    ----------
    nodes : (m,) int array
    start : (m + 1,) int array
        First entry of every node.
    near : (t,) int array
        Neighbours.
    first : (t, 3) array [1/m]
        Weights of the first derivatives.
    residual, smoothing : (t,) arrays
        Weights of the hourglass residual and of the smoothing.
    freedom : (t,) array
        f of every bond; 0 for one that is severed.
    kind : (m,) int array
        QUADRATIC_FIT, LINEAR_FIT or RELEASED_FIT.
    checks : (m,) array
        As in `CutState`.
    """

    nodes: Ints
    start: Ints
    near: Ints
    first: Floats
    residual: Floats
    smoothing: Floats
    freedom: Floats
    kind: Ints
    checks: Floats


def uncut_stencils(
    points: Floats, volumes: Floats, spacing: float, near: Any, first: Floats, smoothing_near: Any, surface: Any
) -> UncutStencils:
    """Return what the stencils of cut nodes depend on.

    Parameters
    ----------
    points : (n, 3) array [m]
    volumes : (n,) array [m^3]
    spacing : float [m]
    near, first : (n, k) and (n, k, 3) arrays
        Neighbours and weights of the first derivatives; the node itself fills rows.
    smoothing_near : (n, l) array
    surface : (k,) int array
        Nodes of the surface.
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
        points, volumes, spacing, reach, smoothing_reach, limit, sums, tree, on_surface, widest,
        *_bonds_within(points, tree, widest),
    )  # fmt: skip


def _bonds_within(points: Floats, tree: cKDTree, widest: Floats) -> tuple[Ints, NDArray[np.int32]]:
    """Return the first bond of every node, and the other nodes of all bonds, in ascending order for each node."""
    pairs = tree.query_pairs(float(widest.max()), output_type="ndarray")
    square = np.sum((points[pairs[:, 0]] - points[pairs[:, 1]]) ** 2, axis=1)
    both = [pairs[square <= widest[pairs[:, k]] ** 2][:, [k, 1 - k]] for k in range(2)]
    node, near = np.concatenate(both).T
    order = np.lexsort((near, node))
    count = np.bincount(node, minlength=len(points))
    return np.concatenate([[0], np.cumsum(count)]).astype(np.int64), near[order].astype(np.int32)


def fit_rows(state: CutState, surface: CutSurface, nodes: Ints, released: NDArray[np.bool_]) -> FittedRows:
    """Fit the stencils of those of some nodes that a cut touches, and whose bonds differ from those of its last state.

    Parameters
    ----------
    state : CutState
    surface : CutSurface
        Of the new cut.
    nodes : (m,) int array
    released : (n,) bool array
        Nodes that leave all stencils.
    """
    uncut = state.uncut
    start, near, paths = _bonds(uncut, surface, nodes)
    paths[released[near]] = np.inf
    paths[np.repeat(released[nodes], np.diff(start))] = np.inf
    checks, touched = np.zeros(len(nodes)), np.zeros(len(nodes), dtype=np.bool_)
    radius = REACH_MARGIN * np.maximum(uncut.reach, uncut.smoothing_reach)
    _examine(uncut.points, nodes, start, near, paths, radius, uncut.widest, checks, touched)
    changed = (touched | state.touched[nodes]) & (checks != state.checks[nodes])
    entry = np.repeat(changed, np.diff(start))
    start = np.concatenate([[0], np.cumsum(np.diff(start)[changed])])
    nodes, near, paths = nodes[changed], near[entry], paths[entry]
    tables = np.zeros((len(near), 3)), np.zeros(len(near)), np.zeros(len(near)), np.zeros(len(near))
    kind = np.zeros(len(nodes), dtype=np.int64)
    _fit_all(
        uncut.points, nodes, start, near, paths, uncut.spacing, uncut.reach, uncut.smoothing_reach, uncut.limit,
        tables, kind,
    )  # fmt: skip
    return FittedRows(nodes, start, near, *tables, kind, checks[changed])


def _bonds(uncut: UncutStencils, surface: CutSurface, nodes: Ints) -> tuple[Ints, Ints, Floats]:
    """Return the first bond of some nodes, the other nodes of their bonds, and the bonds' lengths round the fronts."""
    first = uncut.bond_start[nodes]
    count = uncut.bond_start[nodes + 1] - first
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    near = uncut.bond_near[np.repeat(first - start[:-1], count) + np.arange(start[-1])].astype(np.int64)
    paths = np.empty(len(near))
    bond_paths(
        uncut.points, nodes, start, near, surface.extended, surface.components, surface.fronts,
        surface.front_components, uncut.spacing, float(uncut.widest[nodes].max(initial=0.0)), paths,
    )  # fmt: skip
    return start, near, paths


@cached_njit(nogil=True)
def _examine(points, nodes, start, near, paths, radius, widest, checks, touched):  # type: ignore[no-untyped-def]
    """Write the checks of nodes, and whether a bond within the radius of a node is longer than its distance."""
    for m in range(nodes.shape[0]):
        i, is_longer, total = nodes[m], False, 0.0
        for p in range(start[m], start[m + 1]):
            square = 0.0
            for a in range(3):
                square += (points[near[p], a] - points[i, a]) ** 2
            distance = np.sqrt(square)
            if paths[p] > distance * (1.0 + 1e-12):
                is_longer = True
                touched[m] = touched[m] or distance < radius[i]
            total += (1.0 + 0.1 * (p - start[m])) * min(paths[p], widest[i])
        checks[m] = total if is_longer else 0.0


@cached_njit(nogil=True)
def _spline(q):  # type: ignore[no-untyped-def]
    """Return the quartic spline (13)."""
    return 1.0 + q * q * (-6.0 + q * (8.0 - 3.0 * q)) if q < 1.0 else 0.0


@cached_njit(nogil=True)
def _summed_reach(distance, path, reach, most):  # type: ignore[no-untyped-def]
    """Return the reach for which the sum of the weights is that of the uncut node, at most `most`."""
    goal = 0.0
    for k in range(distance.shape[0]):
        goal += _spline(distance[k] / (REACH_MARGIN * reach))
    low, high = reach, max(most, reach)
    for _ in range(REACH_BISECTIONS):
        middle, total = 0.5 * (low + high), 0.0
        for k in range(path.shape[0]):
            total += _spline(path[k] / (REACH_MARGIN * middle))
        if total < goal:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@cached_njit(nogil=True)
def _monomials(x, y, z, out):  # type: ignore[no-untyped-def]
    """Write 1, the coordinates and their products."""
    out[0], out[1], out[2], out[3] = 1.0, x, y, z
    out[4], out[5], out[6], out[7], out[8], out[9] = x * x, y * y, z * z, x * y, x * z, y * z


@cached_njit(nogil=True)
def _factor(matrix, size):  # type: ignore[no-untyped-def]
    """Replace a symmetric matrix by its Cholesky factor; return False if a pivot is too small."""
    for j in range(size):
        diagonal = matrix[j, j]
        pivot = diagonal
        for k in range(j):
            pivot -= matrix[j, k] ** 2
        if not pivot > LEAST_PIVOT * diagonal:
            return False
        matrix[j, j] = np.sqrt(pivot)
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / matrix[j, j]
    return True


@cached_njit(nogil=True)
def _solve(factor, size, right):  # type: ignore[no-untyped-def]
    """Solve a factored system in place."""
    for i in range(size):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]


@cached_njit(nogil=True)
def _moments(offset, weight, first, size, itself, matrix, monomial):  # type: ignore[no-untyped-def]
    """Write the moment matrix of `size` monomials from number `first` on; `itself` is the weight of the node itself."""
    for i in range(size):
        for j in range(size):
            matrix[i, j] = 0.0
    for k in range(offset.shape[0]):
        if weight[k] > 0.0:
            _monomials(offset[k, 0], offset[k, 1], offset[k, 2], monomial)
            for i in range(size):
                for j in range(i + 1):
                    matrix[i, j] += weight[k] * monomial[first + i] * monomial[first + j]
    if first == 0:
        matrix[0, 0] += itself


@cached_njit(nogil=True)
def _fit_first(offset, weight, order, scale, spacing, matrix, monomial, right, out):  # type: ignore[no-untyped-def]
    """Write the weights of the first derivatives of an interpolating fit; return its size q, or infinity."""
    size = 9 if order == 2 else 3
    _moments(offset, weight, 1, size, 0.0, matrix, monomial)
    if not _factor(matrix, size):
        return np.inf
    square = 0.0
    for a in range(3):
        for i in range(size):
            right[i] = 1.0 if i == a else 0.0
        _solve(matrix, size, right)
        total = 0.0
        for k in range(offset.shape[0]):
            value = 0.0
            if weight[k] > 0.0:
                _monomials(offset[k, 0], offset[k, 1], offset[k, 2], monomial)
                for i in range(size):
                    value += right[i] * monomial[1 + i]
            out[k, a] = value * weight[k] / scale
            total += out[k, a]
            square += out[k, a] ** 2
        square += total**2
    return square * spacing**2


@cached_njit(nogil=True)
def _fit_value(offset, weight, size, matrix, monomial, right, sign, out):  # type: ignore[no-untyped-def]
    """Write the weights of the fitted value at the node, times a sign; the node itself has weight 1 in the fit."""
    _moments(offset, weight, 0, size, 1.0, matrix, monomial)
    if _factor(matrix, size):
        for i in range(size):
            right[i] = 1.0 if i == 0 else 0.0
        _solve(matrix, size, right)
    else:  # nodes in few planes: the least solution
        full = np.zeros((size, size))
        _moments(offset, weight, 0, size, 1.0, matrix, monomial)
        for i in range(size):
            for j in range(i + 1):
                full[i, j] = matrix[i, j]
                full[j, i] = matrix[i, j]
        values, vectors = np.linalg.eigh(full)
        for i in range(size):
            right[i] = 0.0
        for e in range(size):
            if values[e] > LEAST_PIVOT * values[size - 1]:
                for i in range(size):
                    right[i] += vectors[i, e] * vectors[0, e] / values[e]
    for k in range(offset.shape[0]):
        value = 0.0
        if weight[k] > 0.0:
            _monomials(offset[k, 0], offset[k, 1], offset[k, 2], monomial)
            for i in range(size):
                value += right[i] * monomial[i]
        out[k] = sign * value * weight[k]


@cached_njit(nogil=True)
def _fit_all(points, nodes, start, near, paths, spacing, reach, smoothing_reach, limit, tables, kind):  # type: ignore[no-untyped-def]
    """Fit the rows of all nodes; see `fit_rows`."""
    first, residual, smoothing, freedom = tables
    matrix, monomial, right = np.zeros((10, 10)), np.zeros(10), np.zeros(10)
    for m in range(nodes.shape[0]):
        i, begin, end = nodes[m], start[m], start[m + 1]
        count = end - begin
        offset, distance, weight = np.empty((count, 3)), np.empty(count), np.empty(count)
        path = paths[begin:end]
        for k in range(count):
            j = near[begin + k]
            for a in range(3):
                offset[k, a] = points[j, a] - points[i, a]
            distance[k] = np.sqrt(offset[k, 0] ** 2 + offset[k, 1] ** 2 + offset[k, 2] ** 2)
            if path[k] < np.inf:
                freedom[begin + k] = np.exp(-((distance[k] / spacing) ** 2) / 4.0)
        chosen = _summed_reach(distance, path, reach[i], WIDEST_REACH * spacing)
        scale = REACH_MARGIN * chosen
        for k in range(count):
            weight[k] = _spline(path[k] / scale)
            for a in range(3):
                offset[k, a] /= scale
            if weight[k] < 1e-9:
                weight[k], freedom[begin + k] = 0.0, 0.0
        out = first[begin:end]
        kind[m] = QUADRATIC_FIT
        if not _fit_first(offset, weight, 2, scale, spacing, matrix, monomial, right, out) < limit[i]:
            kind[m] = LINEAR_FIT
            if not _fit_first(offset, weight, 1, scale, spacing, matrix, monomial, right, out) < limit[i]:
                kind[m] = RELEASED_FIT
                out[:] = 0.0
                freedom[begin:end] = 0.0
                continue
        for k in range(count):
            weight[k] = min(max((REACH_MARGIN - path[k] / chosen) / RAMP_WIDTH, 0.0), 1.0)
        _fit_value(
            offset, weight, 10 if kind[m] == QUADRATIC_FIT else 4, matrix, monomial, right, -1.0, residual[begin:end]
        )
        chosen = _summed_reach(distance, path, smoothing_reach[i], WIDEST_REACH * spacing)
        for k in range(count):
            weight[k] = _spline(path[k] / (REACH_MARGIN * chosen))
        _fit_value(offset, weight, 4, matrix, monomial, right, 1.0, smoothing[begin:end])


def _local_numbers(rows: FittedRows, n: int) -> tuple[Ints, Ints, Ints]:
    """Return the nodes (l,) that rows contain, and the local numbers of the rows' nodes and of the neighbours."""
    used = np.zeros(n, dtype=np.bool_)
    used[rows.near[rows.freedom > 0.0]] = True
    used[rows.nodes] = True
    number = np.cumsum(used) - 1
    return np.flatnonzero(used), number[rows.nodes], number[rows.near]


def keep_uniform_stress(uncut: UncutStencils, surface: CutSurface, rows: FittedRows, missing: Floats) -> float:
    """Change weights of first derivatives in place, for uniform stress along a cut to move no node.

    Parameters
    ----------
    uncut : UncutStencils
    surface : CutSurface
    rows : FittedRows
    missing : (n, 3) array [m^2]
        By how much the sums of V_I g_IJ must change, at the nodes that the rows contain.

    Returns
    -------
    float
        What remains of it along the cut, over h^2.
    """
    nodes, center, other = _local_numbers(rows, len(uncut.points))
    normals = np.zeros((len(nodes), 3))
    nearest_normals(uncut.points[nodes], surface.triangles, normals)
    volume = float(np.median(uncut.volumes))
    right = missing[nodes] * (uncut.spacing / volume)
    free = rows.freedom > 0.0
    start, first = np.concatenate([[0], np.cumsum(free)])[rows.start], rows.first[free]
    left = _balance(
        uncut.points, rows.nodes, start, rows.near[free], rows.freedom[free], uncut.volumes / volume, center,
        other[free], normals, right, uncut.spacing, uncut.limit, first,
    )  # fmt: skip
    rows.first[free] = first
    return float(left)


@cached_njit(nogil=True)
def _across(normals, field):  # type: ignore[no-untyped-def]
    """Remove the components of vectors (l, 3) along unit normals."""
    for k in range(field.shape[0]):
        along = field[k, 0] * normals[k, 0] + field[k, 1] * normals[k, 1] + field[k, 2] * normals[k, 2]
        for c in range(3):
            field[k, c] -= along * normals[k, c]


@cached_njit(nogil=True)
def _change(m, start, freedom, size, center, other, offset, inverse, field, block):  # type: ignore[no-untyped-def]
    """Write the changes (k, 3) of the weights of row m for multipliers (l, 3) into `block`."""
    begin, end, i = start[m], start[m + 1], center[m]
    for c in range(3):
        x, y, z = 0.0, 0.0, 0.0
        for p in range(begin, end):
            value = freedom[p] * size * (field[other[p], c] - field[i, c])
            block[p - begin, c] = value
            x, y, z = x + value * offset[p, 0], y + value * offset[p, 1], z + value * offset[p, 2]
        fx = x * inverse[m, 0, 0] + y * inverse[m, 1, 0] + z * inverse[m, 2, 0]
        fy = x * inverse[m, 0, 1] + y * inverse[m, 1, 1] + z * inverse[m, 2, 1]
        fz = x * inverse[m, 0, 2] + y * inverse[m, 1, 2] + z * inverse[m, 2, 2]
        for p in range(begin, end):
            block[p - begin, c] -= freedom[p] * (fx * offset[p, 0] + fy * offset[p, 1] + fz * offset[p, 2])


@cached_njit(nogil=True)
def _apply(rows, field, image, block):  # type: ignore[no-untyped-def]
    """Write the changes of the sums (l, 3) that multipliers (l, 3) cause."""
    start, freedom, sizes, center, other, offset, inverse = rows
    image[:] = 0.0
    for m in range(center.shape[0]):
        size = sizes[m]
        _change(m, start, freedom, size, center, other, offset, inverse, field, block)
        for p in range(start[m], start[m + 1]):
            for c in range(3):
                value = size * block[p - start[m], c]
                image[other[p], c] += value
                image[center[m], c] -= value


@cached_njit(nogil=True)
def _apply_scaled(rows, normals, scale, regularization, field, image, block):  # type: ignore[no-untyped-def]
    """Write the changes of the scaled sums across the normals that scaled multipliers cause, regularized."""
    for k in range(field.shape[0]):
        for c in range(3):
            field[k, c] *= scale[k]
    _apply(rows, field, image, block)
    _across(normals, image)
    for k in range(field.shape[0]):
        for c in range(3):
            field[k, c] /= scale[k]
            image[k, c] = scale[k] * image[k, c] + regularization[k] * field[k, c]


@cached_njit(nogil=True)
def _inverse_moments(start, freedom, offset, inverse):  # type: ignore[no-untyped-def]
    """Write the inverse of sum of f x x' of every row; zero for a row without bonds."""
    for m in range(start.shape[0] - 1):
        moment = np.zeros((3, 3))
        for p in range(start[m], start[m + 1]):
            for a in range(3):
                for b in range(3):
                    moment[a, b] += freedom[p] * offset[p, a] * offset[p, b]
        if moment[0, 0] + moment[1, 1] + moment[2, 2] > 0.0:
            inverse[m] = np.linalg.inv(moment)


@cached_njit(nogil=True)
def _balance(points, nodes, start, near, freedom, volumes, center, other, normals, right, spacing, limit, first):  # type: ignore[no-untyped-def]
    """Solve for the least change, and add it to `first`; return the largest residual.

    The method of conjugate residuals has the least residual after every iteration. A piece that is cut off has nodal
    volumes that need not fit the uncut sums at its faces; then a residual remains.
    """
    offset, inverse = np.zeros((near.shape[0], 3)), np.zeros((nodes.shape[0], 3, 3))
    sizes, longest = np.empty(nodes.shape[0]), 0
    for m in range(nodes.shape[0]):
        sizes[m] = volumes[nodes[m]]
        longest = max(longest, start[m + 1] - start[m])
        for p in range(start[m], start[m + 1]):
            for a in range(3):
                offset[p, a] = (points[near[p], a] - points[nodes[m], a]) / spacing
    _inverse_moments(start, freedom, offset, inverse)
    rows, block = (start, freedom, sizes, center, other, offset, inverse), np.zeros((longest, 3))
    count = right.shape[0]
    scale = np.zeros(count)
    for m in range(nodes.shape[0]):
        for p in range(start[m], start[m + 1]):
            scale[other[p]] += sizes[m] ** 2 * freedom[p]
            scale[center[m]] += sizes[m] ** 2 * freedom[p]
    for k in range(count):
        scale[k] = 1.0 / np.sqrt(max(scale[k], LEAST_SCALE))
    _across(normals, right)
    solution, image, regularization = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for attempt in range(len(REGULARIZATION_SHARES) + 1):
        _solve_regularized(rows, normals, scale, regularization, right, solution, image, block)
        if attempt == len(REGULARIZATION_SHARES):
            break
        soft = False
        for m in range(nodes.shape[0]):
            _change(m, start, freedom, sizes[m], center, other, offset, inverse, solution, block)
            if _square_change(m, start, block) > MAX_CHANGE:
                soft = True
                regularization[center[m]] = REGULARIZATION_SHARES[attempt]
                for p in range(start[m], start[m + 1]):
                    regularization[other[p]] = REGULARIZATION_SHARES[attempt]
        if not soft:
            break
    image[:] = 0.0
    for m in range(nodes.shape[0]):
        _change(m, start, freedom, sizes[m], center, other, offset, inverse, solution, block)
        share = _largest_share(m, start, limit[nodes[m]], spacing, first, block)
        for p in range(start[m], start[m + 1]):
            for c in range(3):
                value = share * block[p - start[m], c]
                first[p, c] += value / spacing
                image[other[p], c] += sizes[m] * value
                image[center[m], c] -= sizes[m] * value
    _across(normals, image)
    return np.abs(right - image).max()


@cached_njit(nogil=True)
def _solve_regularized(rows, normals, scale, regularization, right, solution, image, block):  # type: ignore[no-untyped-def]
    """Write the multipliers for which the sums change by `right`; those of nodes with a regularization change less."""
    count = right.shape[0]
    residual = np.zeros((count, 3))
    for k in range(count):
        for c in range(3):
            residual[k, c] = scale[k] * right[k, c]
    _apply_scaled(rows, normals, scale, regularization, residual, image, block)
    solution[:] = 0.0
    direction, moved = residual.copy(), image.copy()
    product, first_product, best = (residual * image).sum(), (residual * image).sum(), np.inf
    for iteration in range(MAX_ITERATIONS):
        largest = 0.0
        for k in range(count):
            for c in range(3):
                largest = max(largest, abs(residual[k, c]) / scale[k])
        if largest < RESIDUAL_TOLERANCE or not product > LEAST_PROGRESS**2 * first_product:
            break
        if iteration % WINDOW_ITERATIONS == 0:
            if largest > SLOWEST_DECREASE * best:
                break
            best = largest
        step = product / (moved * moved).sum()
        for k in range(count):
            for c in range(3):
                solution[k, c] += step * direction[k, c] * scale[k]
                residual[k, c] -= step * moved[k, c]
        _apply_scaled(rows, normals, scale, regularization, residual, image, block)
        product_before = product
        product = (residual * image).sum()
        for k in range(count):
            for c in range(3):
                direction[k, c] = residual[k, c] + product / product_before * direction[k, c]
                moved[k, c] = image[k, c] + product / product_before * moved[k, c]


@cached_njit(nogil=True)
def _square_change(m, start, block):  # type: ignore[no-untyped-def]
    """Return the size q of the changes (k, 3) of row m."""
    square = 0.0
    for c in range(3):
        total = 0.0
        for p in range(start[m], start[m + 1]):
            square += block[p - start[m], c] ** 2
            total += block[p - start[m], c]
        square += total**2
    return square


@cached_njit(nogil=True)
def _largest_share(m, start, limit, spacing, first, block):  # type: ignore[no-untyped-def]
    """Return the share of the changes (k, 3) of row m, at most 1, for which its size q is below the limit.

    q is a + 2 b x + c x^2 for a share x.
    """
    a, b, c = 0.0, 0.0, 0.0
    for d in range(3):
        total, total_change = 0.0, 0.0
        for p in range(start[m], start[m + 1]):
            weight = spacing * first[p, d]
            change = block[p - start[m], d]
            total, total_change = total + weight, total_change + change
            a, b, c = a + weight**2, b + weight * change, c + change**2
        a, b, c = a + total**2, b + total * total_change, c + total_change**2
    if a + 2.0 * b + c <= limit:
        return 1.0
    return max((np.sqrt(max(b * b + c * (limit - a), 0.0)) - b) / c, 0.0)


def conserve_integrals(uncut: UncutStencils, rows: FittedRows, missing: Floats) -> float:
    """Change weights of the smoothing in place, for the integrals of smoothed fields to remain.

    Parameters
    ----------
    uncut : UncutStencils
    rows : FittedRows
    missing : (n,) array [m^3]
        By how much the sums of V_I s_IJ must change, at the nodes that the rows contain.

    Returns
    -------
    float
        What remains of it, over the median volume.
    """
    bonds = rows._replace(freedom=(rows.smoothing != 0.0).astype(float))
    nodes, center, other = _local_numbers(bonds, len(uncut.points))
    volume = float(np.median(uncut.volumes))
    return float(
        _share(rows.start, center, other, uncut.volumes[rows.nodes] / volume, missing[nodes] / volume, rows.smoothing)
    )


@cached_njit(nogil=True)
def _share_scaled(start, center, other, sizes, used, scale, field, image):  # type: ignore[no-untyped-def]
    """Write the changes of the scaled sums that scaled multipliers cause."""
    image[:] = 0.0
    for m in range(center.shape[0]):
        i = center[m]
        for p in range(start[m], start[m + 1]):
            if used[p]:
                j = other[p]
                value = sizes[m] ** 2 * (scale[j] * field[j] - scale[i] * field[i])
                image[j] += value
                image[i] -= value
    for k in range(field.shape[0]):
        image[k] *= scale[k]


@cached_njit(nogil=True)
def _share(start, center, other, sizes, right, weights):  # type: ignore[no-untyped-def]
    """Solve for the least change of the weights that are not zero, and add it; return the largest residual."""
    count = right.shape[0]
    used, scale = weights != 0.0, np.zeros(count)
    for m in range(center.shape[0]):
        for p in range(start[m], start[m + 1]):
            if used[p]:
                scale[other[p]] += sizes[m] ** 2
                scale[center[m]] += sizes[m] ** 2
    for k in range(count):
        scale[k] = 1.0 / np.sqrt(max(scale[k], LEAST_SCALE))
    residual, image, solution = scale * right, np.zeros(count), np.zeros(count)
    _share_scaled(start, center, other, sizes, used, scale, residual, image)
    direction, moved = residual.copy(), image.copy()
    product, first_product, largest = (residual * image).sum(), (residual * image).sum(), 0.0
    for _ in range(MAX_ITERATIONS):
        largest = 0.0
        for k in range(count):
            largest = max(largest, abs(residual[k]) / scale[k])
        if largest < RESIDUAL_TOLERANCE or not product > LEAST_PROGRESS**2 * first_product:
            break
        step = product / (moved * moved).sum()
        solution += step * direction
        residual -= step * moved
        _share_scaled(start, center, other, sizes, used, scale, residual, image)
        product_before = product
        product = (residual * image).sum()
        direction = residual + product / product_before * direction
        moved = image + product / product_before * moved
    for m in range(center.shape[0]):
        for p in range(start[m], start[m + 1]):
            if used[p]:
                i, j = center[m], other[p]
                weights[p] += sizes[m] * (scale[j] * solution[j] - scale[i] * solution[i])
    return largest
