"""Where the fit of a law starts.

A parameter that the stress is linear in, a modulus, needs no guess: given the others it follows from linear least
squares within its bounds. So every start is improved first in its nonlinear parameters alone, the moduli following
them (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 413, 1973), as if the volume were kept.
"""

from __future__ import annotations

import numpy as np

from palpate.arrays import Floats
from palpate.tissue.fit_problem import FitProblem

__all__ = ["starts"]


WIDE, NARROW = 1000.0, 8.0  # factor from the first start at most, of a positive parameter and of one of either sign
DRAWS = 100  # of a start, until the law takes it
INSIDE = 1e-3  # how far from its bound a start lies at least, relative
EVALUATIONS = 50  # of the projected residuals


def starts(problem: FitProblem, count: int, seed: int) -> list[tuple[Floats, Floats]]:
    """Return where each start begins, and the same improved; a single one if the law is linear."""
    random = np.random.default_rng(seed)
    begun = [_inside(problem, problem.first)]
    if not np.all(problem.moduli):
        begun += [_draw(problem, shares, random) for shares in _strata(count - 1, problem, random)]
    return [(first, _improved(problem, first)) for first in (_with_moduli(problem, x) for x in begun)]


def _strata(count: int, problem: FitProblem, random: np.random.Generator) -> Floats:
    """Return numbers from 0 to 1 for every nonlinear parameter, one in each of `count` equal parts, (count, m)."""
    parts = [random.permutation(count) + random.random(count) for _ in np.flatnonzero(~problem.moduli)]
    return np.stack(parts, axis=1) / max(count, 1)


def _draw(problem: FitProblem, shares: Floats, random: np.random.Generator) -> Floats:
    """Return a vector whose nonlinear parameters lie at some shares of their ranges; elsewhere if the law refuses."""
    for _ in range(DRAWS):
        x = problem.first.copy()
        for k, share in zip(np.flatnonzero(~problem.moduli), shares, strict=True):
            x[k] = _at(share, problem.drawn[k], x[k], problem.low[k] < 0)
        x = _inside(problem, x)
        if np.all(np.isfinite(problem.residuals(x))):
            return x
        shares = random.random(len(shares))
    return problem.first.copy()


def _at(share: float, between: Floats, about: float, signed: bool) -> float:
    low, high = between
    if np.isfinite(high - low):
        return low + share * (high - low) if low <= 0 else low * (high / low) ** share
    size = abs(about) or 1.0
    if not signed:
        return size * WIDE ** (2 * share - 1)
    sign, share = (1, 2 * share) if share < 0.5 else (-1, 2 * share - 1)
    return sign * size * NARROW ** (2 * share - 1)


def _inside(problem: FitProblem, x: Floats) -> Floats:
    """Move a start off its bounds, into the range between them."""
    room = INSIDE * np.minimum(np.where(x == 0, 1.0, np.abs(x)), problem.high - problem.low)
    return np.clip(x, problem.low + room, problem.high - room)


def _with_moduli(problem: FitProblem, x: Floats) -> Floats:
    """Set the moduli to those of linear least squares, a little off their bounds; or scale them, if the law refuses."""
    solved, _ = _projected(problem, x)
    places = np.flatnonzero(problem.moduli)
    least = INSIDE * np.minimum(np.abs(solved[places]).max(initial=0.0), problem.high[places] - problem.low[places])
    solved[places] = np.clip(solved[places], problem.low[places] + least, problem.high[places] - least)
    if np.all(np.isfinite(problem.residuals(solved))):
        return solved
    here = problem.isochoric(x)
    scaled = np.where(problem.moduli, abs(here @ problem.target) / (here @ here) * x, x)
    return scaled if np.all(np.isfinite(problem.residuals(scaled))) else x


def _projected(problem: FitProblem, x: Floats) -> tuple[Floats, Floats]:
    """Return `x` with the best moduli within their bounds, and the residuals of these, were the volume kept."""
    from scipy.optimize import lsq_linear

    places, here = np.flatnonzero(problem.moduli), problem.isochoric(x)
    if not len(places) or not np.all(np.isfinite(here)):
        return x.copy(), here - problem.target
    steps = np.where(x[places] == 0, 1.0, x[places])
    rises = [problem.isochoric(x + step * np.eye(len(x))[k]) - here for k, step in zip(places, steps, strict=True)]
    columns = np.stack(rises, axis=1) / steps
    norms = np.linalg.norm(columns, axis=0)
    if not np.all(np.isfinite(norms) & (norms > 0)):
        return x.copy(), here - problem.target
    target = problem.target - here + columns @ x[places]
    limits = problem.low[places] * norms, problem.high[places] * norms
    best = lsq_linear(columns / norms, target, limits, method="bvls").x / norms
    solved = x.copy()
    solved[places] = best
    return solved, columns @ best - target


def _improved(problem: FitProblem, x: Floats) -> Floats:
    """Return a start whose nonlinear parameters went downhill, those of one sign in logarithms."""
    from scipy.optimize import least_squares

    places = np.flatnonzero(~problem.moduli)
    if not len(places) or not np.any(problem.moduli):
        return x
    positive = problem.low[places] >= 0

    def logarithm(values: Floats) -> Floats:
        return np.where(positive, np.log(np.where(positive, values, 1.0)), values)

    def residuals(y: Floats) -> Floats:
        return _projected(problem, back(y))[1]

    def back(y: Floats) -> Floats:
        vector = x.copy()
        vector[places] = np.where(positive, np.exp(np.where(positive, y, 0.0)), y)
        return vector

    first = logarithm(x[places])
    if not np.all(np.isfinite(residuals(first))):
        return x
    bounds = logarithm(problem.low[places]), logarithm(problem.high[places])
    solved = least_squares(residuals, first, bounds=bounds, max_nfev=EVALUATIONS)
    better = _with_moduli(problem, back(solved.x))
    before, after = (float(np.sum(problem.residuals(each) ** 2)) for each in (x, better))
    return better if after < before else x
