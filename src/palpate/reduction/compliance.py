"""The compliance of a surface beside its modes: what it is made of, and its parts between touched nodes, compiled.

Tools' forces f on surface nodes move node i, beside what the modes do, by

    h(|f|) sum over j of (g(|X_i - X_j|) 1 + sum over carriers a of i, b of j of w_ia w_jb R_ab) f_j.

R is the residual flexibility of the body's surface at rest, of its own nodes or of a coarser model's
(`palpate.reduction.flexibility`); g, a sum of falling exponentials and a share of a node's own force, is what a coarser
surface leaves; h = (1 + |f| / F)^-gamma tells how tissue stiffens under a tool's whole force. All are positive, so that
any set of nodes has a positive definite compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from palpate.reduction.inside import Inside, moved_inside, spread

__all__ = [
    "NO_DENTS",
    "Compliance",
    "Dents",
    "Near",
    "carried",
    "compliance",
    "dents_of",
    "gathered",
    "near",
    "pair",
    "refresh",
    "softness",
]
__all__ += ["stored"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DENSE = 256  # touched nodes up to which what is between them is kept
TABLE = 1024  # distances at which the kernel is kept


class Dents(NamedTuple):
    """The compliance of a body's surface beside its modes.

    Parameters
    ----------
    nodes : (k,) int array
        Nodes that tools may touch.
    lengths, compliances : (e,) arrays [m], [m/N]
        Of the exponentials.
    own : float [m/N]
        More compliance of a node under its own force.
    carriers : (k, w) int array
        Rows of the flexibility that stand for each node.
    weights : (k, w) array
        Their shares.
    flexibility : (3 c, 3 c) float32 array [m/N]
        Of the carriers, rows 3 a + component; none where the exponentials are all.
    patches : (k, p) int array
        Of `nodes`, by which the piece of surface about each moves that tools meet (`palpate.meshfree.patches`).
    shares : (k, p) array
        Their weights in it.
    hardening : (2,) array
        Exponent gamma, and force F [N], of the stiffening under load.
    inside : Inside, optional
        How the nodes inside follow.
    """

    nodes: Ints
    lengths: Floats
    compliances: Floats
    own: float
    carriers: Ints
    weights: Floats
    flexibility: NDArray[np.float32]
    patches: Ints
    shares: Floats
    hardening: Floats
    inside: Inside | None = None

    def kernel(self, distances: Floats) -> Floats:
        """Return g [m/N] at some distances [m]; at 0 with the node's own."""
        falling = np.exp(-distances[..., None] / self.lengths) @ self.compliances
        return np.asarray(falling + np.where(distances == 0, self.own, 0.0))

    def scaled(self, factor: float) -> Dents:
        """Return this with all compliances of the surface times a factor."""
        return self._replace(
            compliances=factor * self.compliances, own=factor * self.own,
            flexibility=(factor * self.flexibility).astype(np.float32),
            inside=self.inside and self.inside._replace(factor=factor * self.inside.factor),
        )  # fmt: skip


NO_DENTS = Dents(
    np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0), 0.0, np.zeros((0, 0), dtype=np.int64), np.zeros((0, 0)),
    np.zeros((0, 0), dtype=np.float32), np.zeros((0, 0), dtype=np.int64), np.zeros((0, 0)), np.array([0.0, 1.0]),
)  # fmt: skip


class Compliance(NamedTuple):
    """`Dents` for the compiled step: of k patches of surface that tools meet, then of the k nodes that forceps hold."""

    points: Floats  # (2 k, 3) reference places [m]
    kernel: Floats  # (t,) g at even distances [m/N]
    interval: float  # between them [m]
    own: float  # g of a node's own force [m/N]
    carriers: Ints  # (2 k, w)
    weights: Floats  # (2 k, w)
    flexibility: NDArray[np.float32]  # (3 c, 3 c) [m/N]
    hardening: Floats  # (2,)


class Near(NamedTuple):
    """The compliance between the nodes that are touched, kept from step to step."""

    matrix: Floats  # (DENSE, DENSE, 3, 3) [m/N], by slots
    node: Ints  # (DENSE,) in each slot
    slot: Ints  # (2 k,) of each patch and node; -1 without
    used: Ints  # (1,) how many slots
    block: Floats  # (3, 3) scratch
    row: Floats  # (3, 3 c) scratch


def compliance(dents: Dents, points: Floats, order: Ints) -> Compliance:
    """Lay a compliance out for the step, its nodes at points (n, 3) in some order."""
    own = points[dents.nodes][order]
    distances = np.linspace(0.0, float(np.linalg.norm(np.ptp(own, axis=0))) if len(own) else 1.0, TABLE)
    table = np.exp(-distances[:, None] / dents.lengths) @ dents.compliances
    carriers, weights = _of_patches(dents)
    more = ((0, 0), (0, carriers.shape[1] - dents.carriers.shape[1]))
    carriers = np.concatenate([carriers[order], np.pad(dents.carriers, more)[order]])
    weights = np.concatenate([weights[order], np.pad(dents.weights, more)[order]])
    return Compliance(
        np.concatenate([own, own]), np.ascontiguousarray(table), float(distances[1]), float(table[0] + dents.own),
        np.ascontiguousarray(carriers, dtype=np.int64), np.ascontiguousarray(weights),
        np.ascontiguousarray(dents.flexibility), np.ascontiguousarray(dents.hardening, dtype=float),
    )  # fmt: skip


def _of_patches(dents: Dents) -> tuple[Ints, Floats]:
    """Return carriers and weights of the patches: those of their nodes, by their shares."""
    count, width = len(dents.nodes), dents.shares.shape[1] * dents.weights.shape[1]
    return (
        dents.carriers[dents.patches].reshape(count, width),
        (dents.shares[:, :, None] * dents.weights[dents.patches]).reshape(count, width),
    )


def near(nodes: int, tools: int, carried: int) -> Near:
    """Allocate for a surface of some nodes, some tools, and 3 c rows of a flexibility; nothing is touched."""
    most = min(nodes, DENSE) if tools else 0
    return Near(
        np.zeros((most, most, 3, 3)), np.zeros(most, np.int64), np.full(2 * nodes, -1),
        np.zeros(1, dtype=np.int64), np.zeros((3, 3)), np.zeros((3, carried if tools else 0)),
    )  # fmt: skip


@njit(cache=True, fastmath={"contract"})
def _falling(compliance, i, j):  # type: ignore[no-untyped-def]
    """Return g [m/N] between two patches or nodes."""
    if i == j:
        return compliance.own
    x = compliance.points[i, 0] - compliance.points[j, 0]
    y = compliance.points[i, 1] - compliance.points[j, 1]
    z = compliance.points[i, 2] - compliance.points[j, 2]
    at = np.sqrt(x * x + y * y + z * z) / compliance.interval
    k = int(at)
    if k + 1 >= compliance.kernel.shape[0]:
        return 0.0
    return compliance.kernel[k] + (at - k) * (compliance.kernel[k + 1] - compliance.kernel[k])


@njit(cache=True, fastmath={"contract"})
def pair(compliance, i, j, block):  # type: ignore[no-untyped-def]
    """Write how a force on j moves i (3, 3) [m/N]."""
    g = _falling(compliance, i, j)
    for c in range(3):
        for d in range(3):
            block[c, d] = g if c == d else 0.0
    for a in range(compliance.carriers.shape[1]):
        p = 3 * compliance.carriers[i, a]
        for b in range(compliance.carriers.shape[1]):
            q, w = 3 * compliance.carriers[j, b], compliance.weights[i, a] * compliance.weights[j, b]
            for c in range(3):
                for d in range(3):
                    block[c, d] += w * compliance.flexibility[p + c, q + d]


@njit(cache=True)
def refresh(compliance, near, points, count):  # type: ignore[no-untyped-def]
    """Keep what is between the patches or nodes touched now, points[:count]; keep nothing and return False if too many.

    Those that have left stay, as they may soon be back, until there is no room for others.
    """
    if count > near.node.shape[0]:
        _forget(near)
        return False
    fresh = 0
    for e in range(count):
        fresh += near.slot[points[e]] < 0
    if near.used[0] + fresh > near.node.shape[0]:
        _forget(near)
    for e in range(count):
        i = points[e]
        if near.slot[i] >= 0:
            continue
        s = near.used[0]
        near.slot[i], near.node[s] = s, i
        near.used[0] = s + 1
        _row(compliance, i, near.row)
        for t in range(s + 1):
            _between(compliance, i, near.node[t], near.row, near.matrix[s, t])
            for c in range(3):
                for d in range(3):
                    near.matrix[t, s, d, c] = near.matrix[s, t, c, d]
    return True


@njit(cache=True)
def _forget(near):  # type: ignore[no-untyped-def]
    for s in range(near.used[0]):
        near.slot[near.node[s]] = -1
    near.used[0] = 0


@njit(cache=True, fastmath={"contract"})
def _row(compliance, i, row):  # type: ignore[no-untyped-def]
    """Write how forces on all carriers move the carriers of i together (3, 3 c) [m/N]."""
    row[:] = 0.0
    for a in range(compliance.carriers.shape[1]):
        p, w = 3 * compliance.carriers[i, a], compliance.weights[i, a]
        if w != 0.0:
            for c in range(3):
                for q in range(row.shape[1]):
                    row[c, q] += w * compliance.flexibility[p + c, q]


@njit(cache=True, fastmath={"contract"})
def _between(compliance, i, j, row, block):  # type: ignore[no-untyped-def]
    """Write how a force on j moves i (3, 3) [m/N], the row of i known."""
    g = _falling(compliance, i, j)
    for c in range(3):
        for d in range(3):
            value = g if c == d else 0.0
            for b in range(compliance.carriers.shape[1]):
                value += compliance.weights[j, b] * row[c, 3 * compliance.carriers[j, b] + d]
            block[c, d] = value


@njit(cache=True)
def softness(hardening, force):  # type: ignore[no-untyped-def]
    """Return h under a tool's force [N]."""
    return (1.0 + force / hardening[1]) ** -hardening[0]


@njit(cache=True)
def stored(hardening, force):  # type: ignore[no-untyped-def]
    """Return the energy of dents over half the product of their forces and depths: 1 where nothing hardens."""
    gamma, s = hardening[0], 1.0 + force / hardening[1]
    if gamma == 0.0 or s - 1.0 < 1e-6:
        return 1.0
    done = ((s ** (2.0 - gamma) - 1.0) / (2.0 - gamma) - (s ** (1.0 - gamma) - 1.0) / (1.0 - gamma)) / (s - 1.0) ** 2
    return 2.0 * (1.0 - done * s**gamma)


def dents_of(dents: Dents, points: Floats, pushes: Floats, held: Sequence[bool]) -> tuple[Floats, float]:
    """Return what tools do to a body beside the modes: to its surface, and inside where that is known.

    Parameters
    ----------
    dents : Dents
    points : (n, 3) array [m]
        Reference places of all nodes.
    pushes : (tools, k, 3) array [N]
        On the patches of surface, or on its nodes.
    held : sequence of bool
        Of every tool: whether it holds nodes.

    Returns
    -------
    displacements : (n, 3) array [m]
    energy : float [J]
    """
    result, energy = np.zeros_like(points), 0.0
    for push, nodal in zip(pushes, held, strict=True):
        forces = push
        if not nodal:
            forces = np.zeros_like(push)
            np.add.at(forces, dents.patches, dents.shares[:, :, None] * push[:, None])
        on = np.flatnonzero(forces.any(axis=1))
        if not len(on):
            continue
        moved = dents.kernel(cdist(points[dents.nodes], points[dents.nodes[on]])) @ forces[on] + carried(
            dents, forces[on], on, np.arange(len(forces)))  # fmt: skip
        total = float(np.linalg.norm(forces.sum(axis=0)))
        moved *= softness(dents.hardening, total)
        result[dents.nodes] += moved
        if dents.inside is not None:
            own = gathered(dents, forces[on], on)
            result[dents.inside.nodes] += moved_inside(dents.inside, own, spread(dents.flexibility, own))
        energy += 0.5 * stored(dents.hardening, total) * float(np.sum(forces[on] * moved[on]))
    return result, energy


def carried(dents: Dents, forces: Floats, on: Ints, there: Ints) -> Floats:
    """Return the displacements (t, 3) [m] of some nodes by the flexibility, for forces (j, 3) [N] on others."""
    if not dents.flexibility.size:
        return np.zeros((len(there), 3))
    moved = spread(dents.flexibility, gathered(dents, forces, on))
    return np.asarray(np.einsum("tw,twc->tc", dents.weights[there], moved[dents.carriers[there]]))


def gathered(dents: Dents, forces: Floats, on: Ints) -> Floats:
    """Return the forces (c, 3) [N] on the carriers for forces (j, 3) [N] on some nodes."""
    result = np.zeros((len(dents.flexibility) // 3, 3))
    np.add.at(result, dents.carriers[on], dents.weights[on][:, :, None] * forces[:, None])
    return result
