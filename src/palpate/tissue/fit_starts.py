"""Starting points of the fit of a law.

The stress is linear in the moduli, so given the other parameters they follow from bounded linear
least squares. Every start is first improved in its nonlinear parameters only, at constant volume
(variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 413, 1973).
"""

from __future__ import annotations

import numpy as np

from palpate.core.arrays import Floats
from palpate.tissue.fit_problem import FitProblem

POSITIVE_FACTOR, SIGNED_FACTOR = 1000.0, 8.0  # largest factor from the first start: positive parameters, either sign
MAX_DRAWS = 100  # of a start, until the law accepts it
BOUND_MARGIN = 1e-3  # smallest relative distance of a start from its bounds
MAX_EVALUATIONS = 50  # of the projected residuals


def starting_points(problem: FitProblem, count: int, seed: int) -> list[tuple[Floats, Floats]]:
    """Return pairs of starting points and improved starting points; a single pair for a linear law."""
    random = np.random.default_rng(seed)
    points = [_move_inside(problem, problem.first)]
    if not np.all(problem.moduli):
        points += [_draw(problem, shares, random) for shares in _stratify(count - 1, problem, random)]
    return [(first, _improve(problem, first)) for first in (_set_moduli(problem, x) for x in points)]


def _stratify(count: int, problem: FitProblem, random: np.random.Generator) -> Floats:
    """Return stratified random numbers in [0, 1) for the nonlinear parameters, (count, m)."""
    parts = [random.permutation(count) + random.random(count) for _ in np.flatnonzero(~problem.moduli)]
    return np.stack(parts, axis=1) / max(count, 1)


def _draw(problem: FitProblem, shares: Floats, random: np.random.Generator) -> Floats:
    """Return a vector with nonlinear parameters at quantiles of their ranges; redraw if the law rejects it."""
    for _ in range(MAX_DRAWS):
        x = problem.first.copy()
        for k, share in zip(np.flatnonzero(~problem.moduli), shares, strict=True):
            x[k] = _quantile(share, problem.draw_bounds[k], x[k], problem.low[k] < 0)
        x = _move_inside(problem, x)
        if np.all(np.isfinite(problem.residuals(x))):
            return x
        shares = random.random(len(shares))
    return problem.first.copy()


def _quantile(share: float, between: Floats, about: float, signed: bool) -> float:
    low, high = between
    if np.isfinite(high - low):
        return low + share * (high - low) if low <= 0 else low * (high / low) ** share
    size = abs(about) or 1.0
    if not signed:
        return size * POSITIVE_FACTOR ** (2 * share - 1)
    sign, share = (1, 2 * share) if share < 0.5 else (-1, 2 * share - 1)
    return sign * size * SIGNED_FACTOR ** (2 * share - 1)


def _move_inside(problem: FitProblem, x: Floats) -> Floats:
    """Return a start moved away from its bounds."""
    room = BOUND_MARGIN * np.minimum(np.where(x == 0, 1.0, np.abs(x)), problem.high - problem.low)
    return np.clip(x, problem.low + room, problem.high - room)


def _set_moduli(problem: FitProblem, x: Floats) -> Floats:
    """Return `x` with moduli from linear least squares, away from their bounds; scaled moduli if the law rejects it."""
    solved, _ = _project_moduli(problem, x)
    places = np.flatnonzero(problem.moduli)
    least = BOUND_MARGIN * np.minimum(
        np.abs(solved[places]).max(initial=0.0), problem.high[places] - problem.low[places]
    )
    solved[places] = np.clip(solved[places], problem.low[places] + least, problem.high[places] - least)
    if np.all(np.isfinite(problem.residuals(solved))):
        return solved
    start = problem.isochoric(x)
    scaled = np.where(problem.moduli, abs(start @ problem.target) / (start @ start) * x, x)
    return scaled if np.all(np.isfinite(problem.residuals(scaled))) else x


def _project_moduli(problem: FitProblem, x: Floats) -> tuple[Floats, Floats]:
    """Return `x` with the optimal moduli within their bounds, and its residuals at constant volume."""
    from scipy.optimize import lsq_linear

    places, start = np.flatnonzero(problem.moduli), problem.isochoric(x)
    if not len(places) or not np.all(np.isfinite(start)):
        return x.copy(), start - problem.target
    steps = np.where(x[places] == 0, 1.0, x[places])
    rises = [problem.isochoric(x + step * np.eye(len(x))[k]) - start for k, step in zip(places, steps, strict=True)]
    columns = np.stack(rises, axis=1) / steps
    norms = np.linalg.norm(columns, axis=0)
    if not np.all(np.isfinite(norms) & (norms > 0)):
        return x.copy(), start - problem.target
    target = problem.target - start + columns @ x[places]
    limits = problem.low[places] * norms, problem.high[places] * norms
    best = lsq_linear(columns / norms, target, limits, method="bvls").x / norms
    solved = x.copy()
    solved[places] = best
    return solved, columns @ best - target


def _improve(problem: FitProblem, x: Floats) -> Floats:
    """Return a start improved in its nonlinear parameters, in logarithms for positive ones."""
    from scipy.optimize import least_squares

    places = np.flatnonzero(~problem.moduli)
    if not len(places) or not np.any(problem.moduli):
        return x
    positive = problem.low[places] >= 0

    def logarithm(values: Floats) -> Floats:
        return np.where(positive, np.log(np.where(positive, values, 1.0)), values)

    def residuals(y: Floats) -> Floats:
        return _project_moduli(problem, back(y))[1]

    def back(y: Floats) -> Floats:
        vector = x.copy()
        vector[places] = np.where(positive, np.exp(np.where(positive, y, 0.0)), y)
        return vector

    first = logarithm(x[places])
    if not np.all(np.isfinite(residuals(first))):
        return x
    bounds = logarithm(problem.low[places]), logarithm(problem.high[places])
    solved = least_squares(residuals, first, bounds=bounds, max_nfev=MAX_EVALUATIONS)
    better = _set_moduli(problem, back(solved.x))
    before, after = (float(np.sum(problem.residuals(each) ** 2)) for each in (x, better))
    return better if after < before else x
