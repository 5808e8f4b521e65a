"""Incremental proper orthogonal decomposition: of more snapshots than fit into memory, a block at a time.

What was found so far is carried as a few fields, the modes times their singular values. A new block joins them, both
are decomposed together, and the smallest directions are dropped: hierarchical approximate POD (Himpe, Leibner and Rave,
SIAM J. Sci. Comput. 40 (2018) A3267) along the tree of its incremental variant.

What a step drops is orthogonal to all that it keeps. So with S_j the dropped parts the snapshots' covariance is exactly

    C = C' + sum_j S_j S_j^T,

C' that of what is left at the end. With d = sum_j |S_j|^2, which is known, Weyl's inequality holds every eigenvalue of
C' (a squared singular value) within d below that of C, never above it; and what the first M modes of C' miss of the
snapshots, squared and summed, is at most d plus the sum of the eigenvalues of C' behind them.

The decompositions are by products of snapshots, in double precision: singular values are good to some 1e-8 of the
largest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from palpate.arrays import Floats

__all__ = ["Decomposition", "allowance", "block_size", "decompose"]


DROPPED = 1e-4  # of the snapshots' root mean square, that all steps together may drop
CARRIED = 256  # directions from one step to the next, at most, unless blocks are larger
BUDGET = 500e6  # bytes of a block, with its images in the inner product
MOST, FEWEST = 800, 32  # snapshots in a block


@dataclass(frozen=True)
class Decomposition:
    """What the last step found.

    Parameters
    ----------
    left : (k, k) array
        Left singular vectors: coefficients of the modes in the fields.
    values : (k,) array
        Singular values, in descending order.
    fields : (k, n, 3) array
        What the last step decomposed.
    dropped : float
        Sum of the squares of all singular values that were dropped before.
    """

    left: Floats
    values: Floats
    fields: Floats
    dropped: float

    def shapes(self, count: int) -> Floats:
        """Return the first modes times their singular values, (count, n, 3)."""
        return np.asarray(np.tensordot(self.left[:, :count].T, self.fields, 1))


def block_size(nodes: int) -> int:
    """Return how many snapshots of so many nodes are decomposed at a time."""
    return int(np.clip(BUDGET // (48 * nodes), FEWEST, MOST))


def allowance(squares: float, snapshots: int, block: int) -> float:
    """Return the sum of squares that every step may drop, of snapshots whose squares sum to so much."""
    return DROPPED**2 * squares / -(-snapshots // block)


def decompose(
    blocks: Iterable[Floats], image: Callable[[Floats], Floats], allowed: float, least: int = 0
) -> Decomposition:
    """Decompose blocks of snapshots one after the other.

    Parameters
    ----------
    blocks : iterable of (b, n, 3) arrays
        At least one.
    image : function
        Of fields u (b, n, 3), returns A u of the same shape: the inner product is (u, v) = u . A v.
    allowed : float
        Sum of squares that each step may drop; it drops more only where more than `CARRIED` directions were left, and
        more than the first block holds.
    least : int
        Directions that are carried in any case.

    Returns
    -------
    Decomposition
    """
    dropped, cap = 0.0, max(CARRIED, least)
    left, values, fields = np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0, 3))
    for block in blocks:
        cap = max(cap, len(block))
        tail = np.append(np.cumsum(values[::-1] ** 2)[::-1], 0.0)  # squares that so many directions leave
        kept = min(max(int(np.sum(tail > allowed)), least), cap, len(values))
        dropped += float(tail[kept])
        carried = np.tensordot(left[:, :kept].T, fields, 1) if kept else block[:0]
        del fields  # there need not be room for both
        values, left = _eigen(values[:kept] ** 2, carried, block, image(block))
        fields = np.concatenate([carried, block])
        del carried, block
    return Decomposition(left, values, fields, dropped)


def _eigen(squares: Floats, carried: Floats, block: Floats, images: Floats) -> tuple[Floats, Floats]:
    """Singular values and left singular vectors of carried fields, orthogonal, of given squares, and of a block."""
    k = len(squares)
    flat = images.reshape(len(images), -1)
    gram = np.zeros((k + len(block), k + len(block)))
    gram[:k, :k] = np.diag(squares)
    gram[:k, k:] = carried.reshape(k, flat.shape[1]) @ flat.T
    gram[k:, :k] = gram[:k, k:].T
    gram[k:, k:] = block.reshape(len(block), -1) @ flat.T
    eigenvalues, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    return np.sqrt(np.maximum(eigenvalues[::-1], 0.0)), vectors[:, ::-1]
