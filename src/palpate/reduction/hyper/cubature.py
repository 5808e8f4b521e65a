"""Few nodes that stand for all: positive weights by non-negative least squares, and moments of the dilatation.

The energy of the reduced model is a sum over nodes, and so is its force: sum over I of V_I g_I, g_I = -B_I^T P_I. A few
nodes with positive multiples of their volumes are chosen such that the sum over them is the whole sum at many states
(energy-conserving sampling and weighting, Farhat et al., Int. J. Numer. Methods Eng. 98, 2014). Forces are compared
in the compliance norm, f . K^-1 f, in which an error of force is what it does to the displacement: otherwise the
stiffest coordinates decide alone. The pressure is left out of it: it is found from few moments of the dilatation, whose
coefficients at the chosen nodes are fitted to the moments' slopes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from palpate.arrays import Floats, Ints
from palpate.describe import Described

__all__ = ["Cubature", "non_negative", "sketch", "slopes_fit"]


BATCH = 0.05  # of the chosen nodes: how many are added at once


@dataclass(frozen=True)
class Cubature(Described):
    """Sampled nodes.

    Parameters
    ----------
    nodes : (s,) int array
    weights : (s,) array [m^3]
        Positive.
    pressure : (k, s) array
        Coefficients of the dilatations J - 1 in the moments, with the root of the bulk modulus [sqrt(J)].
    residual : float
        What the sampled forces miss of the whole ones in training, relative, in the compliance norm.
    """

    nodes: Ints
    weights: Floats
    pressure: Floats
    residual: float


def non_negative(columns: Floats, target: Floats, tolerance: float, most: int | None = None) -> tuple[Floats, float]:
    """Solve columns @ x = target for few x >= 0, until what is left is at most `tolerance` of the target.

    The active-set method of Lawson and Hanson, started from nothing and stopped as soon as it is good enough; some
    columns are added at once where many are needed.

    Parameters
    ----------
    columns : (r, n) array
    target : (r,) array
    tolerance : float
        Share of the target's norm.
    most : int, optional
        Number of columns to stop at.

    Returns
    -------
    x : (n,) array
    residual : float
        Share of the target's norm that is left.
    """
    n = columns.shape[1]
    whole = float(np.linalg.norm(target))
    if len(columns) > 1.5 * n:  # fewer rows of the same normal equations
        both = np.asarray(np.linalg.qr(np.column_stack([columns, target]), mode="r"))
        columns, target = both[:, :-1], both[:, -1]
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0, size, 1.0)
    limit = n if most is None else min(most, n)
    x, active = np.zeros(n), np.zeros(n, dtype=bool)
    products = _Products(columns, size, target)
    left, best = target, np.inf
    while np.linalg.norm(left) > tolerance * whole and active.sum() < limit:
        gain = (left @ columns) / size
        gain[active] = -np.inf
        wished = min(max(1, int(BATCH * active.sum())), limit - int(active.sum()))
        new = np.argpartition(gain, -wished)[-wished:]
        new = new[gain[new] > 1e-14 * whole]
        if new.size == 0:
            break
        active[new] = True
        products.add(new)
        _feasible(products, x, active)
        left = target - columns[:, active] @ (x[active] / size[active])
        now = float(np.linalg.norm(left))
        if now >= best * (1 - 1e-9):  # rounding: no progress any more
            break
        best = now
    x[~active] = 0.0
    return x / size, float(np.linalg.norm(left)) / whole


class _Products:
    """Products of the columns that were ever active with each other and with the target, each computed once."""

    def __init__(self, columns: Floats, size: Floats, target: Floats) -> None:
        self._columns, self._size = columns, size
        self._place = np.full(columns.shape[1], -1)
        self._taken = np.zeros((len(columns), 0), order="F")
        self._gram, self._target = np.zeros((0, 0)), target

    def add(self, new: Ints) -> None:
        """Take columns in, those that are not yet."""
        new = new[self._place[new] < 0]
        old = self._taken.shape[1]
        self._place[new] = old + np.arange(len(new))
        more = self._columns[:, new] / self._size[new]
        across, own = self._taken.T @ more, more.T @ more
        self._gram = np.block([[self._gram, across], [across.T, own]])
        self._taken = np.hstack([self._taken, more])

    def solve(self, where: Ints) -> Floats:
        """Return the least-squares solution over some columns."""
        place = self._place[where]
        gram, part = self._gram[np.ix_(place, place)], self._taken[:, place]
        try:
            factor = scipy.linalg.cho_factor(gram, check_finite=False)
        except scipy.linalg.LinAlgError:  # columns that depend on each other
            return np.asarray(scipy.linalg.lstsq(part, self._target, lapack_driver="gelsy", check_finite=False)[0])
        solution = scipy.linalg.cho_solve(factor, part.T @ self._target, check_finite=False)
        left = self._target - part @ solution  # once more: the normal equations lose half the digits
        return np.asarray(solution + scipy.linalg.cho_solve(factor, part.T @ left, check_finite=False))


def _feasible(products: _Products, x: Floats, active: NDArray[np.bool_]) -> None:
    """Move x to the least-squares solution over the active columns, dropping those that would become negative."""
    while True:
        where = np.flatnonzero(active)
        solution = products.solve(where)
        if np.all(solution > 0):
            x[where] = solution
            return
        falling = solution <= 0
        now = x[where]
        step = np.min(now[falling] / np.maximum(now[falling] - solution[falling], 1e-300))
        now = now + step * (solution - now)
        gone = falling & (now <= 1e-12 * max(float(np.abs(now).max()), 1e-300))
        if not gone.any():
            gone = falling & (now == now[falling].min())
        x[where] = np.where(gone, 0.0, now)
        active[where[gone]] = False
        if not active.any():
            return


def sketch(rows: int, entries: int, generator: np.random.Generator) -> Floats:
    """Return random combinations (rows, entries) that keep norms on average; the identity where they would not save."""
    if rows >= entries:
        return np.eye(entries)
    return generator.standard_normal((rows, entries)) / np.sqrt(rows)


def slopes_fit(sampled: Floats, whole: Floats, ridge: float = 1e-6) -> Floats:
    """Return coefficients Z (k, s) with Z @ sampled = whole in the least-squares sense.

    Parameters
    ----------
    sampled : (s, r) array
        Dilatations of the samples, and their slopes along the coordinates, at many states.
    whole : (k, r) array
        The moments and their slopes.
    ridge : float
        Regularisation, as a share of the largest singular value.
    """
    u, values, vt = np.linalg.svd(sampled, full_matrices=False)
    damped = values / (values**2 + (ridge * values[0]) ** 2)
    return np.asarray((whole @ vt.T * damped) @ u.T)
