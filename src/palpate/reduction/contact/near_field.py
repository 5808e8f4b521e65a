"""Near-field correction of a coarse residual flexibility between nearby surface nodes.

A coarse surface represents the displacements at some distance from the forces, but not the fine
indentation around them. The difference is local. A fine and a coarse piece of the body about a
point, both fixed where they are cut out, differ as the whole bodies do, up to terms that fall with the
third power of the distance. So the correction follows from the compliances of many small pieces.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import LinearOperator, eigsh
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.dynamics.solid.model import EnergySolid
from palpate.reduction.basis.linear_modes import stiffness_blocks

# radii in coarse spacings: of a piece's core, of the near field beyond it, and of the rest of the piece
CORE_RADIUS, NEAR_RADIUS, MARGIN_SPACINGS = 1.0, 2.5, 1.0
FADE_START = 0.5  # where the correction starts to fade out, as a fraction of the near radius
EIGENVALUE_TOLERANCE, EIGENVALUE_MARGIN = 1e-3, 0.05  # of the lowest compliance


def near_field_compliance(
    fine: EnergySolid, nodes: Ints, coarse: EnergySolid, coarse_nodes: Ints, places: Ints, weights: Floats
) -> tuple[Ints, NDArray[np.float32]]:
    """Return the near-field correction between nearby surface nodes at rest.

    `fine` and `coarse` are one body, in the energy form, with free surface nodes `nodes` (k,) and `coarse_nodes` (c,).
    `places` and `weights` (k, w) are the carriers of each of `nodes` in `coarse_nodes`
    (`palpate.reduction.contact.residual_flexibility.carriers`).

    Returns the nodes near each (k, q) in `nodes`, padded with the node itself. The second result (k, q, 3, 3) [m/N] is
    the compliance from a nearby node to the node, minus that of their carriers; zero in the padding.
    """
    points = fine.cloud.points[nodes]
    core, near_radius, margin = (coarse.cloud.spacing * share for share in (CORE_RADIUS, NEAR_RADIUS, MARGIN_SPACINGS))
    tree, bodies = cKDTree(points), (_Piece(fine), _Piece(coarse))
    carried = sparse.csr_array(
        (weights.ravel(), (np.repeat(np.arange(len(nodes)), weights.shape[1]), coarse_nodes[places].ravel())),
        (len(nodes), len(coarse.cloud)),
    )
    rows, columns, blocks = [], [], []
    for middle, inside in _cores(tree, core):
        around = np.array(tree.query_ball_point(points[middle], core + near_radius))
        radius = core + near_radius + margin
        exact = bodies[0].compliance(points[middle], radius, nodes[inside], nodes[around])
        used = np.unique(carried[around].indices)
        rough = bodies[1].compliance(points[middle], radius, used, used)
        first, second = carried[inside][:, used], carried[around][:, used]
        coarse_compliance = np.einsum("acbd,jb->acjd", rough, second.toarray(), optimize=True)
        correction = exact - np.einsum("ia,acjd->icjd", first.toarray(), coarse_compliance, optimize=True)
        distance = np.linalg.norm(points[inside][:, None] - points[around], axis=2)
        i, j = np.nonzero(distance < near_radius)
        rows.append(inside[i])
        columns.append(around[j])
        blocks.append(correction[i, :, j] * _fade_factor(distance[i, j], near_radius)[:, None, None])
    return _table_of_blocks(np.concatenate(rows), np.concatenate(columns), np.concatenate(blocks), len(nodes))


class _Piece:
    """A body from which pieces are cut out."""

    def __init__(self, body: EnergySolid) -> None:
        self.tree, self.free = cKDTree(body.cloud.points), ~body.fixed_mask
        self.supported = body.supported
        self.blocks = stiffness_blocks(body, np.float32)

    def compliance(self, middle: Floats, radius: float, moved: Ints, pushed: Ints) -> Floats:
        """Return the compliance (m, 3, p, 3) [m/N] from forces on some nodes to others, fixed beyond a radius.

        Fixed nodes do not move.
        """
        ball = np.array(self.tree.query_ball_point(middle, radius))
        ball = np.sort(ball[self.free[ball]])
        size = len(ball)
        stiffness = np.empty((size, 3, size, 3), np.float32)  # the error, 5e-7, is far below that of any piece
        for (c, e), block in self.blocks.items():
            entries = block[ball][:, ball].toarray()
            stiffness[:, c, :, e] = entries
            stiffness[:, e, :, c] = entries.T
        self._constrain(stiffness, ball)
        # symmetric: its transpose is the same, and LAPACK need not copy it
        factor = cho_factor(stiffness.reshape(3 * size, -1).T, lower=True, overwrite_a=True, check_finite=False)
        result = np.zeros((len(moved), 3, len(pushed), 3))
        moved_inside, pushed_inside = np.isin(moved, ball), np.isin(pushed, ball)
        axes = np.arange(3)
        loaded = (3 * np.searchsorted(ball, moved[moved_inside])[:, None] + np.arange(3)).ravel()
        by = (3 * np.searchsorted(ball, pushed[pushed_inside])[:, None] + np.arange(3)).ravel()
        unit = np.zeros((3 * size, len(loaded)), np.float32, order="F")
        unit[loaded, np.arange(len(loaded))] = 1.0
        answer = cho_solve(factor, unit, overwrite_b=True, check_finite=False)[by].T
        result[np.ix_(np.flatnonzero(moved_inside), axes, np.flatnonzero(pushed_inside), axes)] = answer.reshape(
            moved_inside.sum(), 3, pushed_inside.sum(), 3
        )
        return result

    def _constrain(self, stiffness: NDArray[np.float32], ball: Ints) -> None:
        """Restrict a stiffness (k, 3, k, 3) to the free directions of sliding nodes, with a stiffness across them."""
        for node, free in zip(self.supported.sliding, self.supported.slide, strict=True):
            k = int(np.searchsorted(ball, node))
            if k < len(ball) and ball[k] == node:
                scale = np.trace(stiffness[k, :, k]) / 3
                stiffness[k] = np.einsum("cd,dje->cje", free, stiffness[k])
                stiffness[:, :, k] = np.einsum("jcd,de->jce", stiffness[:, :, k], free)
                stiffness[k, :, k] += scale * (np.eye(3) - free)


def _cores(tree: Any, size: float) -> list[tuple[int, Ints]]:
    """Partition points into sets within a distance of one of theirs; return that point and the set."""
    left, cores = np.ones(tree.n, dtype=bool), []
    for middle in range(tree.n):
        if left[middle]:
            members = np.array(tree.query_ball_point(tree.data[middle], size))
            members = np.sort(members[left[members]])
            left[members] = False
            cores.append((middle, members))
    return cores


def _fade_factor(distance: Floats, near_radius: float) -> Floats:
    along = np.clip((distance / near_radius - FADE_START) / (1 - FADE_START), 0.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * along))


def _table_of_blocks(rows: Ints, columns: Ints, blocks: Floats, count: int) -> tuple[Ints, NDArray[np.float32]]:
    """Return blocks of node pairs, made symmetric, as a table with one row per node."""
    order = np.lexsort((columns, rows))
    back = np.lexsort((rows, columns))
    mean = 0.5 * (blocks[order] + blocks[back].transpose(0, 2, 1))
    rows, columns = rows[order], columns[order]
    number = np.bincount(rows, minlength=count)
    place = np.arange(len(rows)) - np.repeat(np.cumsum(number) - number, number)
    nearby = np.repeat(np.arange(count)[:, None], number.max(), axis=1)
    near_field = np.zeros((*nearby.shape, 3, 3), dtype=np.float32)
    nearby[rows, place], near_field[rows, place] = columns, mean
    return nearby, near_field


def add_own_compliance(
    flexibility: Floats, carriers: Ints, weights: Floats, nearby: Ints, near_field: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return `near_field` with additional own compliance of the nodes, so that the sum is positive definite.

    The arrays are those of `palpate.reduction.contact.compliance.SurfaceCompliance`.
    """
    lowest = lowest_compliance(flexibility, carriers, weights, nearby, near_field)
    if lowest > 0:
        return near_field
    itself = (nearby == np.arange(len(nearby))[:, None]).argmax(axis=1)
    raised = near_field.copy()
    raised[np.arange(len(nearby)), itself] -= (1 + EIGENVALUE_MARGIN) * lowest * np.eye(3, dtype=np.float32)
    return raised


def lowest_compliance(
    flexibility: NDArray[np.floating[Any]],
    carriers: Ints,
    weights: Floats,
    nearby: Ints,
    near_field: NDArray[np.float32],
) -> float:
    """Return the lowest eigenvalue [m/N] of the compliance between all nodes.

    The arrays are those of `palpate.reduction.contact.compliance.SurfaceCompliance`.
    """
    count, size = len(nearby), len(flexibility) // 3
    pairs = (weights.ravel(), (np.repeat(np.arange(count), weights.shape[1]), carriers.ravel()))
    spread = sparse.csr_array(pairs, (count, size))

    def moved(forces: Floats) -> Floats:
        force = forces.reshape(count, 3)
        far = spread @ (flexibility @ (spread.T @ force).ravel()).reshape(size, 3)
        return np.asarray(far + np.einsum("kqcd,kqd->kc", near_field, force[nearby])).ravel()

    start = np.random.default_rng(0).standard_normal(3 * count)
    compliance_operator = LinearOperator((3 * count, 3 * count), matvec=moved, dtype=float)
    return float(
        eigsh(compliance_operator, k=1, which="SA", tol=EIGENVALUE_TOLERANCE, v0=start, return_eigenvectors=False)[0]
    )
