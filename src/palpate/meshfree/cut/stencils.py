"""Stencils of the nodes near a cut.

Weights of moving least squares follow from the paths of the bonds round the fronts
(`palpate.meshfree.cut.surface`) in place of their distances. The reach of a node keeps the sum of its weights: it is
continuous in the position of the front. A quadratic fit is used if its size

    q = h^2 (sum of |g_J|^2 + |sum of g_J|^2)

is not much above that of uncut nodes, else a linear one. Inner nodes keep their cubic terms
(`palpate.meshfree.inner_gradient`), whose damping increases with the weight that the cut takes from their
neighbours. Nodes of a curved surface keep their fits in the depth (`palpate.meshfree.surface_gradient`). A node
for which neither a quadratic nor a linear fit is small enough is *released*: it leaves all stencils.
`palpate.meshfree.cut.consistency_correction` then changes the weights for some sums to remain.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cut.diffraction_lengths import diffraction_lengths
from palpate.meshfree.cut.face_points import FacePoints
from palpate.meshfree.cut.surface import CutSurface
from palpate.meshfree.cut.uncut import REACH_MARGIN, WIDEST_REACH, UncutStencils
from palpate.meshfree.inner_gradient import CUBIC_DAMPING

REACH_BISECTIONS = 30
RAMP_WIDTH = 0.045  # range of distances in which a node enters the hourglass residual, over the reach
LOST_WEIGHT_DAMPING = 100.0  # exponent of the damping of cubic terms, times the share of the weight that is lost
MIN_PIVOT = 1e-10  # of a moment matrix, relative to its diagonal
QUADRATIC_FIT, LINEAR_FIT, RELEASED_FIT = 0, 1, 2  # kinds of a fit


class CutState(NamedTuple):
    """The cut of a body."""

    surface: CutSurface
    faces: FacePoints  # of the surface
    uncut: UncutStencils
    sums: Floats  # (n, 3) array [m^2]: sum over I of V_I g_IJ
    # (n,) array: sums of the lengths of every node's bonds, which change with any of them; 0 where no bond is longer
    checks: Floats
    # touched, released, removed: (n,) bool arrays: nodes whose stencils the cut has changed, those that left all
    # stencils, and those of the latter that left the body, too
    touched: NDArray[np.bool_]
    released: NDArray[np.bool_]
    removed: NDArray[np.bool_]
    residuals: tuple[float, float]  # largest errors of the uniform stress along the cut and of the kept integrals


class FittedRows(NamedTuple):
    """Stencils of some nodes in compressed rows."""

    nodes: Ints  # (m,) int array
    start: Ints  # (m + 1,) int array: first entry of every node
    near: Ints  # (t,) int array: neighbours
    first: Floats  # (t, 3) array [1/m]: weights of the first derivatives
    # residual, smoothing: (t,) arrays: weights of the hourglass residual and of the smoothing
    residual: Floats
    smoothing: Floats
    freedom: Floats  # (t,) array: f of every bond; 0 for one that is severed
    kind: Ints  # (m,) int array: QUADRATIC_FIT, LINEAR_FIT or RELEASED_FIT
    checks: Floats  # (m,) array: as in `CutState`


def fit_rows(state: CutState, surface: CutSurface, nodes: Ints, released: NDArray[np.bool_]) -> FittedRows:
    """Fit the stencils of those of some nodes that a cut touches, and whose bonds differ from those of its last state.

    `surface` is that of the new cut. Nodes `released` (n,) leave all stencils.
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
        uncut.cubic, uncut.surface, tables, kind,
    )  # fmt: skip
    return FittedRows(nodes, start, near, *tables, kind, checks[changed])


def _bonds(uncut: UncutStencils, surface: CutSurface, nodes: Ints) -> tuple[Ints, Ints, Floats]:
    """Return the first bond of some nodes, the other nodes of their bonds, and the bonds' lengths round the fronts."""
    first = uncut.bond_start[nodes]
    count = uncut.bond_start[nodes + 1] - first
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    near = uncut.bond_near[np.repeat(first - start[:-1], count) + np.arange(start[-1])].astype(np.int64)
    paths = np.empty(len(near))
    diffraction_lengths(uncut.points, nodes, start, near, surface.tree, surface.fronts, surface.front_components, paths)
    return start, near, paths


@cached_njit(nogil=True)
def _examine(points, nodes, start, near, paths, radius, widest, checks, touched):
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
def _spline(q):
    """Return the quartic spline (13)."""
    return 1.0 + q * q * (-6.0 + q * (8.0 - 3.0 * q)) if q < 1.0 else 0.0


@cached_njit(nogil=True)
def _summed_reach(distance, path, reach, most):
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
def _cubic_damping(distance, path, radius):
    """Return the damping of cubic terms: that of the uncut node, increased with the weight that a cut takes away."""
    before, now = 0.0, 0.0
    for k in range(path.shape[0]):
        before += _spline(distance[k] / radius)
        now += _spline(path[k] / radius)
    return CUBIC_DAMPING * np.exp(LOST_WEIGHT_DAMPING * (1.0 - now / before))


@cached_njit(nogil=True)
def _monomials(offset, flat, out, last):
    """Write 1, the coordinates, products of two of the flat ones and, up to monomial `last`, those of three."""
    out[0], out[1], out[2], out[3] = 1.0, offset[0], offset[1], offset[2]
    x, y, z = flat[0], flat[1], flat[2]
    out[4], out[5], out[6], out[7], out[8], out[9] = x * x, y * y, z * z, x * y, x * z, y * z
    if last > 9:
        out[10], out[11], out[12], out[13], out[14] = x * x * x, y * y * y, z * z * z, x * x * y, x * x * z
        out[15], out[16], out[17], out[18], out[19] = y * y * x, y * y * z, z * z * x, z * z * y, x * y * z


@cached_njit(nogil=True)
def _factor(matrix, size):
    """Replace a symmetric matrix by its Cholesky factor; return False if a pivot is too small."""
    for j in range(size):
        diagonal = matrix[j, j]
        pivot = diagonal
        for k in range(j):
            pivot -= matrix[j, k] ** 2
        if not pivot > MIN_PIVOT * diagonal:
            return False
        matrix[j, j] = np.sqrt(pivot)
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / matrix[j, j]
    return True


@cached_njit(nogil=True)
def _solve(factor, size, right):
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
def _moments(offset, flat, weight, first, size, itself, matrix, monomial):
    """Write the moment matrix of `size` monomials from number `first` on; `itself` is the weight of the node itself."""
    for i in range(size):
        for j in range(size):
            matrix[i, j] = 0.0
    for k in range(offset.shape[0]):
        if weight[k] > 0.0:
            _monomials(offset[k], flat[k], monomial, first + size - 1)
            for i in range(size):
                for j in range(i + 1):
                    matrix[i, j] += weight[k] * monomial[first + i] * monomial[first + j]
    if first == 0:
        matrix[0, 0] += itself


@cached_njit(nogil=True)
def _fit_first(offset, flat, weight, size, damping, scale, spacing, matrix, monomial, right, out):
    """Write the weights of the first derivatives of an interpolating fit; return its size q, or infinity.

    The fit has `size` monomials, 3, 9 or 19; the coefficients of the cubic ones are damped. Products are those of the
    offsets in coordinates in which the surface is flat.
    """
    _moments(offset, flat, weight, 1, size, 0.0, matrix, monomial)
    for i in range(9, size):  # cubes, x^2 y and the like, x y z: see `CUBIC_DAMPING`
        matrix[i, i] += damping / (1.0 if i < 12 else 3.0 if i < 18 else 6.0)
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
                _monomials(offset[k], flat[k], monomial, size)
                for i in range(size):
                    value += right[i] * monomial[1 + i]
            out[k, a] = value * weight[k] / scale
            total += out[k, a]
            square += out[k, a] ** 2
        square += total**2
    return square * spacing**2


@cached_njit(nogil=True)
def _fit_value(offset, weight, size, matrix, monomial, right, sign, out):
    """Write the weights of the fitted value at the node, times a sign; the node itself has weight 1 in the fit."""
    _moments(offset, offset, weight, 0, size, 1.0, matrix, monomial)
    if _factor(matrix, size):
        for i in range(size):
            right[i] = 1.0 if i == 0 else 0.0
        _solve(matrix, size, right)
    else:  # nodes in few planes: the least solution
        full = np.zeros((size, size))
        _moments(offset, offset, weight, 0, size, 1.0, matrix, monomial)
        for i in range(size):
            for j in range(i + 1):
                full[i, j] = matrix[i, j]
                full[j, i] = matrix[i, j]
        values, vectors = np.linalg.eigh(full)
        for i in range(size):
            right[i] = 0.0
        for e in range(size):
            if values[e] > MIN_PIVOT * values[size - 1]:
                for i in range(size):
                    right[i] += vectors[i, e] * vectors[0, e] / values[e]
    for k in range(offset.shape[0]):
        value = 0.0
        if weight[k] > 0.0:
            _monomials(offset[k], offset[k], monomial, size - 1)
            for i in range(size):
                value += right[i] * monomial[i]
        out[k] = sign * value * weight[k]


@cached_njit(nogil=True)
def _height(form, x):
    """Return the height [m] of a quadric over its tangent plane at an offset (3,) from its node."""
    total = 0.0
    for a in range(3):
        for b in range(3):
            total += x[a] * form[a, b] * x[b]
    return total


@cached_njit(nogil=True)
def _fit_all(points, nodes, start, near, paths, spacing, reach, smoothing_reach, limit, cubic, surface, tables, kind):
    """Fit the rows of all nodes; see `fit_rows`."""
    first, residual, smoothing, freedom = tables
    matrix, monomial, right = np.zeros((20, 20)), np.zeros(20), np.zeros(20)
    for m in range(nodes.shape[0]):
        i, begin, end = nodes[m], start[m], start[m + 1]
        count = end - begin
        offset, flat, distance, weight = np.empty((count, 3)), np.empty((count, 3)), np.empty(count), np.empty(count)
        path = paths[begin:end]
        for k in range(count):
            j = near[begin + k]
            for a in range(3):
                offset[k, a] = points[j, a] - points[i, a]
            height = _height(surface.form[i], offset[k])
            for a in range(3):
                flat[k, a] = offset[k, a] - height * surface.normal[i, a]
            distance[k] = np.sqrt(offset[k, 0] ** 2 + offset[k, 1] ** 2 + offset[k, 2] ** 2)
            if path[k] < np.inf:
                freedom[begin + k] = np.exp(-((distance[k] / spacing) ** 2) / 4.0)
        chosen = _summed_reach(distance, path, reach[i], WIDEST_REACH * spacing)
        scale = REACH_MARGIN * chosen
        for k in range(count):
            weight[k] = _spline(path[k] / scale)
            for a in range(3):
                offset[k, a] /= scale
                flat[k, a] /= scale
            if weight[k] < 1e-9:
                weight[k], freedom[begin + k] = 0.0, 0.0
        out = first[begin:end]
        kind[m] = QUADRATIC_FIT
        size, damping = 9, 0.0
        if cubic[i]:
            size, damping = 19, _cubic_damping(distance, path, REACH_MARGIN * reach[i])
        q = _fit_first(offset, flat, weight, size, damping, scale, spacing, matrix, monomial, right, out)
        if not q < limit[i] and size == 19:
            q = _fit_first(offset, flat, weight, 9, 0.0, scale, spacing, matrix, monomial, right, out)
        if not q < limit[i]:
            kind[m] = LINEAR_FIT
            if not _fit_first(offset, flat, weight, 3, 0.0, scale, spacing, matrix, monomial, right, out) < limit[i]:
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
