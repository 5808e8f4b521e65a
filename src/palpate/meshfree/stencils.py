"""Moving least squares (section 2.3 of the paper, equations 9 to 13) as tables of neighbours and weights.

The derivative of a field at node I is a weighted sum of the field over the neighbours of I. The
weights follow from a polynomial that is fitted to the neighbours with the quartic spline (13) as
weight, and differentiated with fixed coefficients at I (diffuse derivatives). In the
*interpolating* fit the polynomial passes through node I: its constant is eliminated. So the nodal
unknowns are the displacements themselves, and the sums are over differences u_J - u_I.

Nodes whose neighbours lie in the same arrangement (most nodes of a lattice) share one row of
weights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from palpate.compiled.code_cache import cached_njit
from palpate.compiled.threads import check_process
from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described, Fact
from palpate.core.faults import CloudError, InputError, first_few, integer_in_range, number_in_range
from palpate.meshfree.cloud import MAX_COORDINATE
from palpate.meshfree.visibility import is_pair

MAX_CONDITION = 1e10  # of scaled moment matrices; above it, second derivatives lose half their digits
BATCH_NODES = 1024  # nodes fitted at once
MIN_DISTANCE_RATIO = 0.2  # smallest distance of nodes over the median distance of nearest neighbours


@dataclass(frozen=True)
class Stencils(Described):
    """Neighbours and weights of the moving-least-squares fit at every node of a cloud.

    Parameters
    ----------
    neighbours : (n, k) int array
        Neighbours of every node without itself, padded with the node itself. Numbers from n on are those
        of mirror images (`palpate.meshfree.mirror`); fields then have values for images, too.
    row : (n,) int array
        The node's row in the tables of weights; nodes with the same arrangement of neighbours share
        one.
    value : (s, k) array
        Weights of the fitted value; zero in the interpolating fit, whose value is the node's own.
    first : (s, k, d) array [1/m]
        Weights of the first derivatives.
    second : (s, k, d (d + 1) / 2) array [1/m^2]
        Weights of the second derivatives in the order 00, 11, 22, 01, 02, 12 (in the plane 00, 11,
        01); zero for a fit of order 1.
    own : (s,) array
        Weight of the node itself in the fitted value; 1 in the interpolating fit.
    own_first, own_second : (s, d), (s, d (d + 1) / 2) arrays
        The node's own weights in the derivatives.
    condition : (s,) array
        Condition number of the scaled moment matrix.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> points = pt.box((0.4, 0.4, 0.4), spacing=0.1).points
    >>> stencils = pt.moving_least_squares(points, neighbours=42)
    >>> stencils.neighbours.shape == (len(points), stencils.first.shape[1])
    True
    >>> second = stencils.hessian(points[:, 0] * points[:, 1])
    >>> bool(np.allclose(second[..., 3], 1.0))
    True
    """

    neighbours: NDArray[np.int32]
    row: NDArray[np.int32]
    value: Floats
    first: Floats
    second: Floats
    own: Floats
    own_first: Floats
    own_second: Floats
    condition: Floats

    def _facts(self) -> list[Fact]:
        return [
            ("nodes", len(self.row), ""),
            ("neighbours", self.neighbours.shape[1], ""),
            ("different rows of weights", len(self.first), ""),
            ("largest condition number", float(self.condition.max(initial=0.0)), ""),
        ]

    def fit(self, field: Floats) -> Floats:
        """Return the fitted value of a nodal field of shape (n,) or (n, c), in the same shape."""
        return self._apply(self.value[:, :, None], self.own[:, None], field)[..., 0]

    def gradient(self, field: Floats) -> Floats:
        """Return the first derivatives of a nodal field of shape (n,) or (n, c), shape (n, d) or (n, c, d)."""
        return self._apply(self.first, self.own_first, field)

    def products(self, volumes: Floats) -> Any:
        """Return the sparse matrix A for which u . A v is the sum over the nodes of V_I grad u . grad v.

        It is (n, n), or (n + g, n + g) with g images.
        """
        n, size = len(self.row), max(len(self.row), int(self.neighbours.max(initial=0)) + 1)
        nodes = np.concatenate([np.arange(n)[:, None], self.neighbours], axis=1)
        weights = np.concatenate([self.own_first[self.row][:, None], self.first[self.row]], axis=1)
        places = nodes.ravel(), np.arange(n + 1) * nodes.shape[1]
        total = 0
        for k in range(weights.shape[2]):
            rooted = (weights[:, :, k] * np.sqrt(volumes)[:, None]).ravel()
            derivative = csr_array((rooted, *places), shape=(n, size))
            total = total + derivative.T @ derivative
        return total

    def hessian(self, field: Floats) -> Floats:
        """Return the second derivatives of a nodal field, shape (n, d (d + 1) / 2) or (n, c, d (d + 1) / 2)."""
        return self._apply(self.second, self.own_second, field)

    def transformed(self, slopes: Floats) -> Stencils:
        """Return stencils with a row a node, of the first derivatives along new coordinates X, by the chain rule.

        Parameters
        ----------
        slopes : (n, d, d) array
            Derivatives of the present coordinates x along the new ones, dx_a / dX_i at [a, i].
        """
        row, none = self.row, np.zeros((0, 0, 0))
        first = np.einsum("nka,nai->nki", self.first[row], slopes)
        return replace(
            self, row=np.arange(len(row), dtype=np.int32), value=self.value[row], first=first, second=none,
            own=self.own[row], own_first=-first.sum(axis=1), own_second=self.own_second[row],
            condition=self.condition[row],
        )  # fmt: skip

    def _apply(self, weights: Floats, diagonal: Floats, field: Floats) -> Floats:
        columns = np.ascontiguousarray(field, dtype=float).reshape(len(field), -1)
        result = _apply(self.neighbours, self.row, weights, diagonal, columns)
        return result.reshape(len(self.row), *field.shape[1:], weights.shape[2])


@cached_njit(parallel=True)
def _apply(neighbours, row, weights, diagonal, field):
    """Return weighted sums (n, c, w) of fields (n, c) over the neighbours."""
    n, k = neighbours.shape
    columns, width = field.shape[1], weights.shape[2]
    result = np.zeros((n, columns, width))
    for i in prange(n):
        r = row[i]
        for c in range(columns):
            for w in range(width):
                total = diagonal[r, w] * field[i, c]
                for j in range(k):
                    total += weights[r, j, w] * field[neighbours[i, j], c]
                result[i, c, w] = total
    return result


def moving_least_squares(
    points: Floats,
    *,
    order: int = 2,
    neighbours: int | None = None,
    radius: float | None = None,
    interpolating: bool = True,
    hidden: csr_array | None = None,
) -> Stencils:
    """Fit polynomials around every point.

    Parameters
    ----------
    points : (n, d) array [m]
        In the plane or in space.
    order : int
        Order of the polynomials, 1 to 3. A fit of order 1 has no second derivatives.
    neighbours : int, optional
        Target number of points in a stencil, the node included. The stencil ends at the widest gap
        between successive distances near that number, so that on a lattice it holds whole shells.
    radius : float, optional [m]
        Support radius instead of a number.
    interpolating : bool
        Whether the fit passes through the node itself.
    hidden : (n, n) sparse array, optional
        True for pairs that stencils omit: `Cloud.hidden`.

    Returns
    -------
    Stencils

    Raises
    ------
    CloudError
        Duplicate points, too few or coplanar neighbours, or an ill-conditioned moment matrix; the
        message names the nodes.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> points = pt.box((0.4, 0.4, 0.4), spacing=0.1, jitter=0.2).points
    >>> stencils = pt.moving_least_squares(points, order=2, neighbours=42)
    >>> slope = stencils.gradient(points[:, 0] ** 2)
    >>> bool(np.allclose(slope[:, 0], 2 * points[:, 0]))
    True
    """
    check_process()
    points = _checked_points(points, hidden)
    n, d = points.shape
    order = integer_in_range("order", order, 1, 3)
    exponents = monomial_exponents(d, order)
    if (neighbours is None) == (radius is None):
        raise InputError("neighbours or radius must be given, got both or neither; give either neighbours or radius")
    tree = cKDTree(points)
    _check_duplicates(points, tree)
    if neighbours is not None:
        neighbours = integer_in_range("neighbours", neighbours, len(exponents))
        near, reach = _nearest(points, tree, neighbours, hidden)
    else:
        radius = number_in_range("radius", radius or 0.0, 0.0, open_low=True, unit="m")
        near, reach = _within(points, tree, radius, hidden)
    _check_counts(np.sum(near != np.arange(n)[:, None], axis=1), len(exponents) - 1, f"order {order} in {d}D")
    near, row, sample = _arrangements(points, near)
    offsets = points[near[sample]] - points[sample][:, None, :]
    present = near[sample] != sample[:, None]
    value, first, second, diagonal, condition = _fit(offsets, present, reach[sample], exponents, interpolating)
    _check_condition(points, condition[row])
    return Stencils(
        near.astype(np.int32), row.astype(np.int32),
        value, first, second,
        diagonal[:, 0].copy(), diagonal[:, 1 : d + 1].copy(), diagonal[:, d + 1 :].copy(), condition,
    )  # fmt: skip


def _checked_points(points: Floats, hidden: csr_array | None) -> Floats:
    """Return points (n, d) as a contiguous array; raises for points that are not finite or far from the origin."""
    points = np.ascontiguousarray(points, dtype=float)
    n = len(points)
    if hidden is not None and hidden.shape != (n, n):
        raise InputError(f"hidden must have shape ({n}, {n}), got {hidden.shape}; use Cloud.hidden of these points")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise CloudError(f"points must be finite, got other values at nodes {first_few(bad)}", bad)
    far = np.flatnonzero(np.abs(points).max(axis=1) > MAX_COORDINATE)
    if far.size:
        raise CloudError(
            f"points must lie within {MAX_COORDINATE:g} m of the origin, got others at nodes {first_few(far)}", far
        )
    return points


def _check_counts(counts: Ints, needed: int, fit: str) -> None:
    """Raise CloudError for nodes with fewer neighbours than a fit requires; the node itself is a point of any fit."""
    few = np.flatnonzero(counts < needed)
    if few.size:
        raise CloudError(
            f"nodes {first_few(few)} must have at least {needed} neighbours for a fit of {fit}, got "
            f"{counts[few].min()}; use more points, more neighbours or a larger radius",
            few,
        )


def _check_condition(points: Floats, condition: Floats) -> None:
    """Raise CloudError for nodes whose moment matrix is ill-conditioned."""
    bad = np.flatnonzero(~(condition < MAX_CONDITION))
    if bad.size:
        raise CloudError(
            f"moment matrices of nodes {first_few(bad)} are ill-conditioned (node {bad[0]} at "
            f"{points[bad[0]]}: condition {condition[bad[0]]:.1e}, limit {MAX_CONDITION:.0e}): their neighbours lie in "
            f"(nearly) one plane or line; use more neighbours or spread the points",
            bad,
        )


def monomial_exponents(d: int, order: int) -> Ints:
    """Return monomial exponents (m, d): constant, linear, quadratic as 00, 11, 22, 01, 02, 12, then cubic."""
    rows = [[0] * d, *np.eye(d, dtype=int).tolist()]
    if order >= 2:
        rows += (2 * np.eye(d, dtype=int)).tolist()
        rows += [[int(a in (i, j)) for a in range(d)] for i in range(d) for j in range(i + 1, d)]
    if order >= 3:
        cubes = np.stack(np.meshgrid(*[np.arange(4)] * d, indexing="ij"), axis=-1).reshape(-1, d)
        rows += cubes[cubes.sum(axis=1) == 3].tolist()
    return np.array(rows)


def quartic_spline(distance: Floats) -> Floats:
    """Return the quartic spline (13) at distances relative to the support radius, up to 1."""
    return np.asarray(1.0 + distance**2 * (-6.0 + distance * (8.0 - 3.0 * distance)))


def _check_duplicates(points: Floats, tree: cKDTree) -> None:
    if len(points) < 2:
        raise CloudError("points must have at least 2 rows, got fewer")
    distance, other = tree.query(points, k=2)
    typical = np.median(distance[:, 1])
    close = np.flatnonzero(distance[:, 1] < MIN_DISTANCE_RATIO * typical)
    if close.size or typical == 0:
        i = int(close[0]) if close.size else 0
        raise CloudError(
            f"nodes {first_few(close)} are duplicates or nearly so: node {i} at {points[i]} is {distance[i, 1]:.3g} m "
            f"from node {other[i].max() if other[i].min() == i else other[i].min()}, others keep {typical:.3g} m; "
            f"remove one of each pair",
            close,
        )


def _nearest(points: Floats, tree: cKDTree, count: int, hidden: csr_array | None) -> tuple[Ints, Floats]:
    """Return neighbours up to the largest gap in distance between 0.8 and 1.3 times the count."""
    n = len(points)
    low, high = max(int(0.8 * count), 1), int(np.ceil(1.3 * count))
    if n <= high:
        high = n - 1
        low = min(low, high - 1)
    if low < 1:
        raise CloudError(f"cloud must have more points for stencils of {count}, got {n}")
    distance, near = _nearest_visible(points, tree, high + 1, hidden)
    # equal distances in the last shell may change the order; the node itself is always at distance 0
    gaps = np.round(np.diff(distance[:, low - 1 :], axis=1) / distance[:, 1:2], 6)
    last = low + np.argmax(gaps, axis=1)  # points kept, the node itself included
    near = np.where(np.arange(high + 1)[None, :] < last[:, None], near, np.arange(n)[:, None])
    reach = 1.05 * distance[np.arange(n), last - 1]
    return near[:, 1 : last.max()], reach


def _nearest_visible(
    points: Floats, tree: cKDTree, count: int, hidden: csr_array | None
) -> tuple[Floats, NDArray[np.int64]]:
    """Return distances and numbers (n, count) of the nearest nodes that are not hidden, in ascending order."""
    most = 0 if hidden is None else int(np.diff(hidden.indptr).max(initial=0))
    distance, near = tree.query(points, k=min(count + most, len(points)), workers=-1)
    if hidden is None or not most:
        return distance, near
    row = np.repeat(np.arange(len(points)), near.shape[1])
    distance = np.where(is_pair(hidden, row, near.ravel()).reshape(near.shape), np.inf, distance)
    order = np.argsort(distance, axis=1, kind="stable")[:, :count]
    distance, near = np.take_along_axis(distance, order, axis=1), np.take_along_axis(near, order, axis=1)
    few = np.flatnonzero(~np.isfinite(distance).all(axis=1))
    if few.size:
        raise CloudError(f"nodes {first_few(few)} must see at least {count - 1} others; use more points", few)
    return distance, near


def _within(points: Floats, tree: cKDTree, radius: float, hidden: csr_array | None) -> tuple[Ints, Floats]:
    count = tree.query_ball_point(points, radius, return_length=True, workers=-1)
    distance, near = tree.query(points, k=max(2, int(count.max())), workers=-1)
    itself = np.arange(len(points))[:, None]
    near = np.where(distance < radius, near, itself)
    if hidden is not None and hidden.nnz:
        row = np.repeat(itself, near.shape[1])
        near = np.where(is_pair(hidden, row, near.ravel()).reshape(near.shape), itself, near)
    return near[:, 1:], np.full(len(points), radius)


def _arrangements(points: Floats, near: Ints) -> tuple[Ints, Ints, Ints]:
    """Return neighbours sorted by offset, each node's arrangement, and one node of every arrangement.

    Nodes whose neighbours have equal offsets share one arrangement.
    """
    n = len(near)
    scale = np.median(np.linalg.norm(points[near[:, 0]] - points, axis=1))
    keys = np.rint((points[near] - points[:, None, :]) / scale * 1e6).astype(np.int64)
    rank = keys @ (np.int64(4_000_000_007) ** np.arange(points.shape[1], dtype=np.int64)[::-1] % (1 << 62))
    rank[near == np.arange(n)[:, None]] = np.iinfo(np.int64).max  # padding last
    order = np.argsort(rank, axis=1, kind="stable")
    near = np.take_along_axis(near, order, axis=1)
    keys = np.take_along_axis(keys, order[:, :, None], axis=1).reshape(n, -1)
    mixer = np.random.default_rng(0).integers(1, 1 << 62, keys.shape[1]) | 1
    hashed = (keys * mixer).sum(axis=1)  # wraps around, as hashes do
    _, sample, row = np.unique(hashed, return_index=True, return_inverse=True)
    if len(sample) > n // 2 or not np.array_equal(keys[sample[row]], keys):
        return near, np.arange(n), np.arange(n)
    return near, row, sample


def _fit(
    offsets: Floats, present: NDArray[np.bool_], reach: Floats, exponents: NDArray[np.int64], interpolating: bool
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return the weights of value, first and second derivatives, own weights and condition numbers."""
    parts = [slice(begin, begin + BATCH_NODES) for begin in range(0, len(offsets), BATCH_NODES)]
    fits = [_fit_some(offsets[part], present[part], reach[part], exponents, interpolating) for part in parts]
    value, first, second, diagonal, condition = (np.concatenate(arrays) for arrays in zip(*fits, strict=True))
    return value, first, second, diagonal, condition


def _fit_some(
    offsets: Floats, present: NDArray[np.bool_], reach: Floats, exponents: NDArray[np.int64], interpolating: bool
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    s, k, d = offsets.shape
    exponents = exponents[1:] if interpolating else exponents
    scaled = offsets / reach[:, None, None]
    distance = np.sqrt(np.sum(scaled**2, axis=2))
    inside = present & (distance < 1.0)
    spline = np.where(inside, quartic_spline(distance), 0.0)
    powers = scaled[:, :, :, None] ** np.arange(exponents.max() + 1)
    monomials = powers[:, :, 0, exponents[:, 0]]
    for a in range(1, d):
        monomials *= powers[:, :, a, exponents[:, a]]
    weighted = (monomials * spline[:, :, None]).transpose(0, 2, 1)
    moment = weighted @ monomials
    if not interpolating:  # a node counts itself, where all monomials but the constant vanish
        moment[:, 0, 0] += 1.0
        weighted = np.concatenate([weighted, np.eye(len(exponents), 1)[None].repeat(s, axis=0)], axis=2)
    spectrum = np.linalg.eigvalsh(moment)
    unfit = spectrum[:, 0] <= 1e-14 * spectrum[:, -1]
    condition = np.full(s, np.inf)
    condition[~unfit] = spectrum[~unfit, -1] / spectrum[~unfit, 0]
    moment[unfit], weighted[unfit] = np.eye(len(exponents)), 0.0
    # the c-th derivative at the node is the coefficient of the c-th monomial, times a factor
    factors = np.prod(np.where(exponents == 2, 2.0, 1.0) / reach[:, None, None] ** exponents, axis=2)
    size = 1 + d + d * (d + 1) // 2
    solution = np.zeros((s, size, weighted.shape[2]))
    solved = (factors[:, :, None] * np.linalg.solve(moment, weighted))[:, : size - interpolating]
    solution[:, interpolating : interpolating + solved.shape[1]] = solved
    if interpolating:
        diagonal = -solution.sum(axis=2)
        diagonal[:, 0] = ~unfit
    else:
        diagonal = solution[:, :, k].copy()
    weights = np.ascontiguousarray(solution[:, :, :k].transpose(0, 2, 1))
    return weights[:, :, 0].copy(), weights[:, :, 1 : 1 + d].copy(), weights[:, :, 1 + d :].copy(), diagonal, condition
