"""Balanced realisations and Hankel-norm approximations of small dense systems.

The method is theorem 6.3 of K. Glover, All optimal Hankel-norm approximations of linear
multivariable systems and their L-infinity error bounds, Int. J. Control 39, 1984. Of all stable
systems of order k, its result is nearest in the Hankel norm, at the distance of the first discarded
Hankel singular value. The error of the transfer function is at most twice the sum of the discarded
values.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, integer_in_range

MIN_HANKEL_VALUE = 1e-10  # relative to the largest Hankel singular value: states below it are rounding errors
EQUAL_VALUES_TOLERANCE = 1e-6  # relative difference of Hankel singular values that count as equal


class Realisation(NamedTuple):
    """State-space realisation x' = A x + B f, y = C x + D f."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats


def lyapunov_factor(a: Floats, b: Floats) -> Floats:
    """Return Z (n, r) with A Z Z^T + Z Z^T A^T + B B^T = 0, by a dense solver."""
    if np.linalg.eigvals(a).real.max() >= 0:
        raise InputError("system must be stable for balancing, got a pole with a real part of at least 0")
    gramian = scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T)
    values, vectors = np.linalg.eigh((gramian + gramian.T) / 2)
    kept = values > 1e-16 * values[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


def balance(system: Realisation) -> tuple[Realisation, Floats]:
    """Return a balanced realisation of the largest order above rounding, and its Hankel singular values."""
    controlled, observed = lyapunov_factor(system.A, system.B), lyapunov_factor(system.A.T, system.C.T)
    left, values, right = np.linalg.svd(observed.T @ controlled)
    kept = values > MIN_HANKEL_VALUE * values[0]
    roots = np.sqrt(values[kept])
    into = controlled @ right[: len(values)][kept].T / roots
    back = (observed @ left[:, : len(values)][:, kept] / roots).T
    balanced = Realisation(back @ system.A @ into, back @ system.B, system.C @ into, system.D)
    return balanced, values[kept]


def hankel_norm(balanced: Realisation, values: Floats, order: int) -> Realisation:
    """Return the optimal Hankel-norm approximation of a balanced realisation.

    Parameters
    ----------
    balanced : Realisation
        Balanced.
    values : (n,) array
        Its Hankel singular values, descending.
    order : int
        Largest order. It is reduced if it would separate equal singular values, such as those of
        degenerate modes of a symmetric body.
    """
    integer_in_range("order", order, 1, len(values) - 1)
    sigma = values[order]
    same = np.abs(values - sigma) <= EQUAL_VALUES_TOLERANCE * sigma
    count = int(np.sum(values > sigma * (1 + EQUAL_VALUES_TOLERANCE)))
    if count == 0:
        raise InputError(
            f"order must be at least {int(same.sum())}, got {order}: so many Hankel singular values are equal"
        )
    one = ~same
    (outs, ins), size = balanced.D.shape, max(balanced.D.shape)
    b, c = np.pad(balanced.B, ((0, 0), (0, size - ins))), np.pad(balanced.C, ((0, size - outs), (0, 0)))
    # the orthogonal U with B2 = - C2^T U
    u, _, v = np.linalg.svd(-c[:, same] @ b[same])
    turned = u @ v
    s, a = values[one], balanced.A[np.ix_(one, one)]
    gamma = 1.0 / (s**2 - sigma**2)
    b1, c1 = b[one], c[:, one]
    hat = gamma[:, None] * (sigma**2 * a.T + s[:, None] * a * s - sigma * c1.T @ turned @ b1.T)
    b_hat = gamma[:, None] * (s[:, None] * b1 + sigma * c1.T @ turned)
    c_hat = c1 * s + sigma * turned @ b1.T
    d_hat = np.pad(balanced.D, ((0, size - outs), (0, size - ins))) - sigma * turned
    stable = _stable_part(Realisation(hat, b_hat, c_hat, d_hat), count)
    return Realisation(stable.A, stable.B[:, :ins], stable.C[:outs], stable.D[:outs, :ins])


def _stable_part(system: Realisation, count: int) -> Realisation:
    """Return the stable part of a system, which has `count` states by the theorem."""
    schur, vectors, stable = scipy.linalg.schur(system.A, sort="lhp")
    if stable != count:
        raise InputError(
            f"Hankel-norm approximation must have {count} stable poles, got {stable}: its Hankel singular values "
            "are within rounding errors; take a lower order"
        )
    one, two = slice(count), slice(count, None)
    between = scipy.linalg.solve_sylvester(schur[one, one], -schur[two, two], -schur[one, two])
    b, c = vectors.T @ system.B, system.C @ vectors
    return Realisation(schur[one, one], b[one] - between @ b[two], c[:, one], system.D)
