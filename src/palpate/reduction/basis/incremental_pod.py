"""Incremental proper orthogonal decomposition of snapshots that do not fit into memory, block by block.

The current decomposition is stored as a few fields: the modes times their singular values. A new block
is appended, both are decomposed together, and the smallest directions are dropped: hierarchical
approximate POD (Himpe, Leibner and Rave, SIAM J. Sci. Comput. 40 (2018) A3267) along the tree of its
incremental variant.

The dropped part of a step is orthogonal to the part that it keeps. So with the dropped parts S_j the
snapshots' covariance is exactly

    C = C' + sum_j S_j S_j^T,

with C' that of the final fields. Let d = sum_j |S_j|^2, which is known. By Weyl's inequality every
eigenvalue of C' (a squared singular value) is at most that of C, and at least that of C minus d. The
squared projection error of the snapshots with the first M modes of C' is at most d plus the sum of the
other eigenvalues of C'.

The decompositions use products of snapshots in double precision, so singular values are accurate to
about 1e-8 of the largest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from palpate.core.arrays import Floats

DROP_TOLERANCE = 1e-4  # of all steps together, relative to the snapshots' root mean square
MAX_RANK = 256  # between steps, unless blocks are larger
BLOCK_BYTES = 500e6  # with the images in the inner product
MIN_BLOCK, MAX_BLOCK = 32, 800  # snapshots in a block


@dataclass(frozen=True)
class Decomposition:
    """Result of the last step."""

    left: Floats  # (k, k) array: left singular vectors: coefficients of the modes in the fields
    values: Floats  # (k,) array: singular values, in descending order
    fields: Floats  # (k, n, 3) array: input of the last step
    dropped: float  # sum of the squares of all dropped singular values

    def shapes(self, count: int) -> Floats:
        """Return the first modes times their singular values, (count, n, 3)."""
        return np.asarray(np.tensordot(self.left[:, :count].T, self.fields, 1))


def block_size(nodes: int) -> int:
    """Return the number of snapshots per block for a number of nodes."""
    return int(np.clip(BLOCK_BYTES // (48 * nodes), MIN_BLOCK, MAX_BLOCK))


def allowance(squares: float, snapshots: int, block: int) -> float:
    """Return the sum of squares that every step may drop, for snapshots with a given sum of squares."""
    return DROP_TOLERANCE**2 * squares / -(-snapshots // block)


def decompose(
    blocks: Iterable[Floats], image: Callable[[Floats], Floats], allowed: float, least: int = 0
) -> Decomposition:
    """Decompose blocks of snapshots (b, n, 3), at least one, one after the other.

    `image` returns A u (b, n, 3) of fields u: the inner product is (u, v) = u . A v. Each step may drop a sum of
    squares `allowed`. It drops more only if the rank exceeds `MAX_RANK` and the size of the first block. `least` is the
    least rank between steps.
    """
    dropped, cap = 0.0, max(MAX_RANK, least)
    left, values, fields = np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0, 3))
    for block in blocks:
        cap = max(cap, len(block))
        tail = np.append(np.cumsum(values[::-1] ** 2)[::-1], 0.0)  # squared error with each number of directions
        rank = min(max(int(np.sum(tail > allowed)), least), cap, len(values))
        dropped += float(tail[rank])
        leading = np.tensordot(left[:, :rank].T, fields, 1) if rank else block[:0]
        del fields  # frees memory
        values, left = _eigen(values[:rank] ** 2, leading, block, image(block))
        fields = np.concatenate([leading, block])
        del leading, block
    return Decomposition(left, values, fields, dropped)


def _eigen(squares: Floats, leading: Floats, block: Floats, images: Floats) -> tuple[Floats, Floats]:
    """Return singular values and left singular vectors of orthogonal fields with given squares and of a block."""
    k = len(squares)
    flat = images.reshape(len(images), -1)
    gram = np.zeros((k + len(block), k + len(block)))
    gram[:k, :k] = np.diag(squares)
    gram[:k, k:] = leading.reshape(k, flat.shape[1]) @ flat.T
    gram[k:, :k] = gram[:k, k:].T
    gram[k:, k:] = block.reshape(len(block), -1) @ flat.T
    eigenvalues, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    return np.sqrt(np.maximum(eigenvalues[::-1], 0.0)), vectors[:, ::-1]
