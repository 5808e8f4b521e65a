"""The compliance of a surface beside its modes: what it is made of, and its parts between touched nodes, compiled.

Tools' forces f on surface nodes move node i, beside what the modes do, by

    h(|f|) sum over j of (D_ij + sum over carriers a of i, b of j of w_ia w_jb R_ab) f_j.

R is the residual flexibility of the body's surface at rest, of its own nodes or of a coarser model's
(`palpate.reduction.contact.residual_flexibility`); D is what a coarser one misses between close nodes (`palpate.reduction.contact.near_field`);
h = (1 + |f| / F)^-gamma tells how tissue stiffens under a tool's whole force. Pulls do not stiffen it: for nodes that
forceps hold h is one number. R with D is positive, so that any set of nodes has a positive definite compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats, Ints
from palpate.dynamics.compiled.cache import kernel_njit
from palpate.reduction.contact.interior import Interior, interior_displacements, spread

__all__ = [
    "NO_COMPLIANCE",
    "ActiveCompliance",
    "ComplianceTable",
    "SurfaceCompliance",
    "active_compliance",
    "carrier_forces",
    "compliance_table",
    "contact_displacements",
    "pair",
    "refresh",
    "secant_factor",
    "static_displacements",
]
__all__ += ["energy_factor"]


DENSE = 256  # touched nodes up to which what is between them is kept


class SurfaceCompliance(NamedTuple):
    """The compliance of a body's surface beside its modes.

    Parameters
    ----------
    nodes : (k,) int array
        Nodes that tools may touch.
    carriers : (k, w) int array
        Rows of the flexibility that stand for each node.
    weights : (k, w) array
        Their shares.
    flexibility : (3 c, 3 c) float32 array [m/N]
        Of the carriers, rows 3 a + component.
    close : (k, q) int array
        Of `nodes`, those close to each; the node itself again where there are fewer.
    between : (k, q, 3, 3) float32 array [m/N]
        What a coarser surface misses of the compliance between them; q = 0 where it is no coarser one.
    patches : (k, p) int array
        Of `nodes`, by which the piece of surface about each moves that tools meet (`palpate.meshfree.patches`).
    shares : (k, p) array
        Their weights in it.
    hardening : (2,) array
        Exponent gamma, and force F [N], of the stiffening under load.
    grip : float
        h of nodes that forceps hold.
    inside : Inside, optional
        How the nodes inside follow.
    """

    nodes: Ints
    carriers: Ints
    weights: Floats
    flexibility: NDArray[np.float32]
    nearby: Ints
    near_field: NDArray[np.float32]
    patches: Ints
    shares: Floats
    stiffening: Floats
    bonded_scale: float
    interior: Interior | None = None

    def scaled(self, factor: float) -> SurfaceCompliance:
        """Return this with all compliances of the surface times a factor."""
        return self._replace(
            flexibility=(factor * self.flexibility).astype(np.float32),
            near_field=(factor * self.near_field).astype(np.float32),
            interior=self.interior and self.interior._replace(factor=factor * self.interior.factor),
        )  # fmt: skip


NO_COMPLIANCE = SurfaceCompliance(
    np.zeros(0, dtype=np.int64), np.zeros((0, 0), dtype=np.int64), np.zeros((0, 0)),
    np.zeros((0, 0), dtype=np.float32), np.zeros((0, 0), dtype=np.int64), np.zeros((0, 0, 3, 3), dtype=np.float32),
    np.zeros((0, 1), dtype=np.int64), np.zeros((0, 1)), np.array([0.0, 1.0]), 1.0,
)  # fmt: skip


class ComplianceTable(NamedTuple):
    """`Dents` for the compiled step: of k patches of surface that tools meet, then of the k nodes that forceps hold."""

    carriers: Ints  # (2 k, w)
    weights: Floats  # (2 k, w)
    flexibility: NDArray[np.float32]  # (3 c, 3 c) [m/N]
    members: Ints  # (2 k, p) nodes of each, as `Dents.nodes` has them
    shares: Floats  # (2 k, p)
    nearby: Ints  # (k, q) of nodes, in that order
    near_field: NDArray[np.float32]  # (k, q, 3, 3) [m/N]
    stiffening: Floats  # (2,)
    bonded_scale: float


class ActiveCompliance(NamedTuple):
    """The compliance between the nodes that are touched, kept from step to step."""

    matrix: Floats  # (DENSE, DENSE, 3, 3) [m/N], by slots
    node: Ints  # (DENSE,) in each slot
    slot: Ints  # (2 k,) of each patch and node; -1 without
    used: Ints  # (1,) how many slots
    block: Floats  # (3, 3) scratch
    row: Floats  # (3, 3 c) scratch
    around: Floats  # (3, 3 k) scratch


def compliance_table(compliance: SurfaceCompliance, order: Ints) -> ComplianceTable:
    """Lay a compliance out for the step, its nodes in some order."""
    carriers, weights = _of_patches(compliance)
    more = ((0, 0), (0, carriers.shape[1] - compliance.carriers.shape[1]))
    carriers = np.concatenate([carriers[order], np.pad(compliance.carriers, more)[order]])
    weights = np.concatenate([weights[order], np.pad(compliance.weights, more)[order]])
    alone = ((0, 0), (0, compliance.patches.shape[1] - 1))
    members = np.concatenate([compliance.patches[order], np.pad(order[:, None], alone, mode="edge")])
    shares = np.concatenate([compliance.shares[order], np.pad(np.ones((len(order), 1)), alone)])
    return ComplianceTable(
        np.ascontiguousarray(carriers, dtype=np.int64), np.ascontiguousarray(weights),
        np.ascontiguousarray(compliance.flexibility), np.ascontiguousarray(members, dtype=np.int64),
        np.ascontiguousarray(shares), np.ascontiguousarray(compliance.nearby, dtype=np.int64),
        np.ascontiguousarray(compliance.near_field), np.ascontiguousarray(compliance.stiffening, dtype=float), float(compliance.bonded_scale),
    )  # fmt: skip


def _of_patches(compliance: SurfaceCompliance) -> tuple[Ints, Floats]:
    """Return carriers and weights of the patches: those of their nodes, by their shares."""
    count, width = len(compliance.nodes), compliance.shares.shape[1] * compliance.weights.shape[1]
    return (
        compliance.carriers[compliance.patches].reshape(count, width),
        (compliance.shares[:, :, None] * compliance.weights[compliance.patches]).reshape(count, width),
    )


def active_compliance(of: ComplianceTable, tools: int) -> ActiveCompliance:
    """Allocate for some tools; nothing is touched."""
    nodes, carried = len(of.members) // 2, len(of.flexibility)
    most = min(nodes, DENSE) if tools else 0
    return ActiveCompliance(
        np.zeros((most, most, 3, 3)), np.zeros(most, np.int64), np.full(2 * nodes, -1),
        np.zeros(1, dtype=np.int64), np.zeros((3, 3)), np.zeros((3, carried if tools else 0)),
        np.zeros((3, 3 * nodes if tools and of.nearby.size else 0)),
    )  # fmt: skip


@kernel_njit(fastmath={"contract"})
def pair(compliance, i, j, block):  # type: ignore[no-untyped-def]
    """Write how a force on j moves i (3, 3) [m/N]."""
    block[:] = 0.0
    for a in range(compliance.carriers.shape[1]):
        p = 3 * compliance.carriers[i, a]
        for b in range(compliance.carriers.shape[1]):
            q, w = 3 * compliance.carriers[j, b], compliance.weights[i, a] * compliance.weights[j, b]
            for c in range(3):
                for d in range(3):
                    block[c, d] += w * compliance.flexibility[p + c, q + d]
    for a in range(compliance.members.shape[1] if compliance.nearby.shape[1] else 0):
        for b in range(compliance.members.shape[1]):
            n, w = compliance.members[i, a], compliance.shares[i, a] * compliance.shares[j, b]
            for k in range(compliance.nearby.shape[1] if w != 0.0 else 0):
                if compliance.nearby[n, k] == compliance.members[j, b]:
                    for c in range(3):
                        for d in range(3):
                            block[c, d] += w * compliance.near_field[n, k, c, d]


@kernel_njit()
def refresh(compliance, active, points, count):  # type: ignore[no-untyped-def]
    """Keep what is between the patches or nodes touched now, points[:count]; keep nothing and return False if too many.

    Those that have left stay, as they may soon be back, until there is no room for others.
    """
    if count > active.node.shape[0]:
        _forget(active)
        return False
    fresh = 0
    for e in range(count):
        fresh += active.slot[points[e]] < 0
    if active.used[0] + fresh > active.node.shape[0]:
        _forget(active)
    for e in range(count):
        i = points[e]
        if active.slot[i] >= 0:
            continue
        s = active.used[0]
        active.slot[i], active.node[s] = s, i
        active.used[0] = s + 1
        _row(compliance, i, active.row, active.around)
        for t in range(s + 1):
            _between(compliance, i, active.node[t], active, active.matrix[s, t])
            for c in range(3):
                for d in range(3):
                    active.matrix[t, s, d, c] = active.matrix[s, t, c, d]
    return True


@kernel_njit()
def _forget(active):  # type: ignore[no-untyped-def]
    for s in range(active.used[0]):
        active.slot[active.node[s]] = -1
    active.used[0] = 0


@kernel_njit(fastmath={"contract"})
def _row(compliance, i, row, around):  # type: ignore[no-untyped-def]
    """Write how forces on all carriers move those of i together (3, 3 c), and on close nodes its own (3, 3 k) [m/N]."""
    row[:] = 0.0
    around[:] = 0.0
    for a in range(compliance.carriers.shape[1]):
        p, w = 3 * compliance.carriers[i, a], compliance.weights[i, a]
        if w != 0.0:
            for c in range(3):
                for q in range(row.shape[1]):
                    row[c, q] += w * compliance.flexibility[p + c, q]
    for a in range(compliance.members.shape[1] if around.shape[1] else 0):
        n, w = compliance.members[i, a], compliance.shares[i, a]
        for k in range(compliance.nearby.shape[1] if w != 0.0 else 0):
            q = 3 * compliance.nearby[n, k]
            for c in range(3):
                for d in range(3):
                    around[c, q + d] += w * compliance.near_field[n, k, c, d]


@kernel_njit(fastmath={"contract"})
def _between(compliance, i, j, active, block):  # type: ignore[no-untyped-def]
    """Write how a force on j moves i (3, 3) [m/N], the rows of i known."""
    row, around = active.row, active.around
    for c in range(3):
        for d in range(3):
            value = 0.0
            for b in range(compliance.carriers.shape[1]):
                value += compliance.weights[j, b] * row[c, 3 * compliance.carriers[j, b] + d]
            for b in range(compliance.members.shape[1] if around.shape[1] else 0):
                value += compliance.shares[j, b] * around[c, 3 * compliance.members[j, b] + d]
            block[c, d] = value


@kernel_njit()
def secant_factor(stiffening, force):  # type: ignore[no-untyped-def]
    """Return h under a tool's force [N]."""
    return (1.0 + force / stiffening[1]) ** -stiffening[0]


@kernel_njit()
def energy_factor(stiffening, force):  # type: ignore[no-untyped-def]
    """Return the energy of dents over half the product of their forces and depths: 1 where nothing hardens."""
    gamma, s = stiffening[0], 1.0 + force / stiffening[1]
    if gamma == 0.0 or s - 1.0 < 1e-6:
        return 1.0
    done = ((s ** (2.0 - gamma) - 1.0) / (2.0 - gamma) - (s ** (1.0 - gamma) - 1.0) / (1.0 - gamma)) / (s - 1.0) ** 2
    return 2.0 * (1.0 - done * s**gamma)


def contact_displacements(
    compliance: SurfaceCompliance, points: Floats, pushes: Floats, constrained_inverse_mass: Sequence[bool]
) -> tuple[Floats, float]:
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
    for push, nodal in zip(pushes, constrained_inverse_mass, strict=True):
        forces = push
        if not nodal:
            forces = np.zeros_like(push)
            np.add.at(forces, compliance.patches, compliance.shares[:, :, None] * push[:, None])
        on = np.flatnonzero(forces.any(axis=1))
        if not len(on):
            continue
        moved = static_displacements(compliance, forces[on], on, np.arange(len(forces)))
        total = float(np.linalg.norm(forces.sum(axis=0)))
        moved *= compliance.bonded_scale if nodal else secant_factor(compliance.stiffening, total)
        result[compliance.nodes] += moved
        if compliance.interior is not None:
            own = carrier_forces(compliance, forces[on], on)
            result[compliance.interior.nodes] += interior_displacements(
                compliance.interior, own, spread(compliance.flexibility, own)
            )
        share = 1.0 if nodal else energy_factor(compliance.stiffening, total)
        energy += 0.5 * share * float(np.sum(forces[on] * moved[on]))
    return result, energy


def static_displacements(compliance: SurfaceCompliance, forces: Floats, on: Ints, there: Ints) -> Floats:
    """Return the displacements (t, 3) [m] of some nodes by statics, for forces (j, 3) [N] on others."""
    if not compliance.flexibility.size:
        return np.zeros((len(there), 3))
    spreading = spread(compliance.flexibility, carrier_forces(compliance, forces, on))
    moved = np.einsum("tw,twc->tc", compliance.weights[there], spreading[compliance.carriers[there]])
    if compliance.nearby.size:  # as it is symmetric, a node's row also tells how its force moves the others
        nearby = np.zeros((len(compliance.nodes), 3))
        np.add.at(nearby, compliance.nearby[on], np.einsum("jqdc,jd->jqc", compliance.near_field[on], forces))
        moved += nearby[there]
    return np.asarray(moved)


def carrier_forces(compliance: SurfaceCompliance, forces: Floats, on: Ints) -> Floats:
    """Return the forces (c, 3) [N] on the carriers for forces (j, 3) [N] on some nodes."""
    result = np.zeros((len(compliance.flexibility) // 3, 3))
    np.add.at(result, compliance.carriers[on], compliance.weights[on][:, :, None] * forces[:, None])
    return result
