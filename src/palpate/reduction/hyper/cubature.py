"""Sparse positive quadrature by non-negative least squares, and moments of the dilatation.

The energy of the reduced model is a sum over nodes, and so is its force: sum over I of V_I g_I,
g_I = -B_I^T P_I. A few nodes are chosen, with positive multiples of their volumes, so that the sum
over them equals the whole sum at many states: energy-conserving sampling and weighting (Farhat et
al., Int. J. Numer. Methods Eng. 98, 2014). Forces are compared in the compliance norm, f . K^-1 f,
which weighs an error of force by the displacement that it causes. In the Euclidean norm the stiffest
coordinates would decide alone. The pressure is left out of this fit: it follows from few moments of
the dilatation, whose coefficients at the chosen nodes are fitted to the slopes of the moments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described

BATCH_FRACTION = 0.05  # of the active columns that are added at once


@dataclass(frozen=True)
class Cubature(Described):
    """Cubature points with weights."""

    nodes: Ints  # (s,) int array
    weights: Floats  # (s,) array [m^3]: positive
    # (k, s) array: coefficients of the dilatations J - 1 in the moments, times the root of the bulk modulus [sqrt(J)]
    pressure: Floats
    residual: float  # relative error of the sampled forces in training, in the compliance norm


def sparse_nnls(
    matrix: Floats, target: Floats, tolerance: float, max_columns: int | None = None
) -> tuple[Floats, float]:
    """Solve matrix @ x = target approximately for a sparse x >= 0.

    The matrix is (r, n). The active-set method of Lawson and Hanson starts from x = 0 and stops as soon as the residual
    is within the tolerance. Several columns are added at once where many are needed; at most `max_columns` entries of x
    are not zero.

    Returns x (n,) and the norm of the residual. It and the tolerance are fractions of the norm of `target`.
    """
    n = matrix.shape[1]
    target_norm = float(np.linalg.norm(target))
    if len(matrix) > 1.5 * n:  # fewer rows of the same normal equations
        both = np.asarray(np.linalg.qr(np.column_stack([matrix, target]), mode="r"))
        matrix, target = both[:, :-1], both[:, -1]
    size = np.linalg.norm(matrix, axis=0)
    size = np.where(size > 0, size, 1.0)
    limit = n if max_columns is None else min(max_columns, n)
    x, active = np.zeros(n), np.zeros(n, dtype=bool)
    gram = _GramMatrix(matrix, size, target)
    remainder, best = target, np.inf
    while np.linalg.norm(remainder) > tolerance * target_norm and active.sum() < limit:
        gain = (remainder @ matrix) / size
        gain[active] = -np.inf
        batch = min(max(1, int(BATCH_FRACTION * active.sum())), limit - int(active.sum()))
        new = np.argpartition(gain, -batch)[-batch:]
        new = new[gain[new] > 1e-14 * target_norm]
        if new.size == 0:
            break
        active[new] = True
        gram.add(new)
        _solve_feasible(gram, x, active)
        remainder = target - matrix[:, active] @ (x[active] / size[active])
        now = float(np.linalg.norm(remainder))
        if now >= best * (1 - 1e-9):  # stagnation by rounding
            break
        best = now
    x[~active] = 0.0
    return x / size, float(np.linalg.norm(remainder)) / target_norm


class _GramMatrix:
    """Gram matrix of the columns that were ever active, computed once per pair of columns."""

    def __init__(self, matrix: Floats, size: Floats, target: Floats) -> None:
        self._columns, self._size = matrix, size
        self._place = np.full(matrix.shape[1], -1)
        self._taken = np.zeros((len(matrix), 0), order="F")
        self._gram, self._target = np.zeros((0, 0)), target

    def add(self, new: Ints) -> None:
        """Add the columns that are not in the Gram matrix yet."""
        new = new[self._place[new] < 0]
        old = self._taken.shape[1]
        self._place[new] = old + np.arange(len(new))
        more = self._columns[:, new] / self._size[new]
        across, block = self._taken.T @ more, more.T @ more
        self._gram = np.block([[self._gram, across], [across.T, block]])
        self._taken = np.hstack([self._taken, more])

    def solve(self, where: Ints) -> Floats:
        """Return the least-squares solution over some columns."""
        place = self._place[where]
        gram, part = self._gram[np.ix_(place, place)], self._taken[:, place]
        try:
            factor = scipy.linalg.cho_factor(gram, check_finite=False)
        except scipy.linalg.LinAlgError:  # linearly dependent columns
            return np.asarray(scipy.linalg.lstsq(part, self._target, lapack_driver="gelsy", check_finite=False)[0])
        solution = scipy.linalg.cho_solve(factor, part.T @ self._target, check_finite=False)
        remainder = self._target - part @ solution  # refine: the normal equations lose half the digits
        return np.asarray(solution + scipy.linalg.cho_solve(factor, part.T @ remainder, check_finite=False))


def _solve_feasible(gram: _GramMatrix, x: Floats, active: NDArray[np.bool_]) -> None:
    """Set x to the least-squares solution over the active columns; deactivate columns that would turn negative."""
    while True:
        where = np.flatnonzero(active)
        solution = gram.solve(where)
        if np.all(solution > 0):
            x[where] = solution
            return
        non_positive = solution <= 0
        now = x[where]
        step = np.min(now[non_positive] / np.maximum(now[non_positive] - solution[non_positive], 1e-300))
        now = now + step * (solution - now)
        dropped = non_positive & (now <= 1e-12 * max(float(np.abs(now).max()), 1e-300))
        if not dropped.any():
            dropped = non_positive & (now == now[non_positive].min())
        x[where] = np.where(dropped, 0.0, now)
        active[where[dropped]] = False
        if not active.any():
            return


def sketch(rows: int, entries: int, generator: np.random.Generator) -> Floats:
    """Return a random matrix (rows, entries) that preserves norms in expectation.

    The result is the identity where a sketch would not reduce the number of rows.
    """
    if rows >= entries:
        return np.eye(entries)
    return generator.standard_normal((rows, entries)) / np.sqrt(rows)


def fit_moments(sampled: Floats, moments: Floats, ridge: float = 1e-6) -> Floats:
    """Return coefficients Z (k, s) with Z @ sampled = whole in the least-squares sense.

    `sampled` (s, r) are dilatations at the cubature points, and their slopes along the coordinates, at many states.
    `moments` (k, r) are the moments and their slopes. The regularisation `ridge` is a fraction of the largest singular
    value.
    """
    u, values, vt = np.linalg.svd(sampled, full_matrices=False)
    damped = values / (values**2 + (ridge * values[0]) ** 2)
    return np.asarray((moments @ vt.T * damped) @ u.T)
