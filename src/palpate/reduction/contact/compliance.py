"""Surface compliance in addition to the modes: its data, and its blocks between patches in contact, compiled.

Forces f of tools on surface nodes move node i, in addition to the modes, by

    h(|f|) sum over j of (D_ij + sum over carriers a of i, b of j of w_ia w_jb R_ab) f_j.

R is the residual flexibility of the body's surface at rest, at its own nodes or at those of a coarser
model (`palpate.reduction.contact.residual_flexibility`). D is the near-field correction of a coarser
model (`palpate.reduction.contact.near_field`). The secant factor h = (1 + |f| / F)^-gamma describes how
tissue stiffens under the total force of a tool. Pulls do not stiffen it: for nodes that forceps hold,
h is constant. R with D is positive, so any set of nodes has a positive definite compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats, Ints
from palpate.reduction.contact.interior import Interior, flexible_displacements, interior_displacements

MAX_NEWTON_STEPS = 50  # for the force of a stiffened compliance
MAX_ACTIVE = 256  # patches in contact up to which their mutual compliance is stored


class SurfaceCompliance(NamedTuple):
    """The surface compliance of a body in addition to its modes."""

    nodes: Ints  # (k,) int array: nodes of the contact surface
    carriers: Ints  # (k, w) int array: rows of the flexibility that represent each node
    weights: Floats  # (k, w) array: their weights
    # (3 c, 3 c) float32 array [m/N]: residual flexibility of the c carriers, rows 3 a + component
    flexibility: NDArray[np.float32]
    nearby: Ints  # (k, q) int array: of `nodes`, those near each; padded with the node itself
    # (k, q, 3, 3) float32 array [m/N]: near-field correction of a coarser model between them; q = 0 without one
    near_field: NDArray[np.float32]
    # (k, p) int array: of `nodes`, the patch of surface about each that tools push (`palpate.meshfree.patches`)
    patches: Ints
    shares: Floats  # (k, p) array: their weights in the patch
    stiffening: Floats  # (2,) array: exponent gamma and force F [N] of the secant factor
    bonded_scale: float  # h of nodes that forceps hold
    interior: Interior | None = None  # displacements of the interior nodes

    def scaled(self, factor: float) -> SurfaceCompliance:
        """Return this with all compliances multiplied by a factor."""
        return self._replace(
            flexibility=(factor * self.flexibility).astype(np.float32),
            near_field=(factor * self.near_field).astype(np.float32),
            interior=self.interior and self.interior._replace(factor=factor * self.interior.factor),
        )  # fmt: skip


NO_COMPLIANCE = SurfaceCompliance(
    nodes=np.zeros(0, dtype=np.int64),
    carriers=np.zeros((0, 0), dtype=np.int64),
    weights=np.zeros((0, 0)),
    flexibility=np.zeros((0, 0), dtype=np.float32),
    nearby=np.zeros((0, 0), dtype=np.int64),
    near_field=np.zeros((0, 0, 3, 3), dtype=np.float32),
    patches=np.zeros((0, 1), dtype=np.int64),
    shares=np.zeros((0, 1)),
    stiffening=np.array([0.0, 1.0]),
    bonded_scale=1.0,
)


class ComplianceTable(NamedTuple):
    """`SurfaceCompliance` for the compiled step: rows of k patches for tools, then of k nodes for forceps."""

    carriers: Ints  # (2 k, w)
    weights: Floats  # (2 k, w)
    flexibility: NDArray[np.float32]  # (3 c, 3 c) [m/N]
    members: Ints  # (2 k, p) nodes of each row, in the order of `SurfaceCompliance.nodes`
    shares: Floats  # (2 k, p)
    nearby: Ints  # (k, q) of nodes, in that order
    near_field: NDArray[np.float32]  # (k, q, 3, 3) [m/N]
    stiffening: Floats  # (2,)
    bonded_scale: float


class ActiveCompliance(NamedTuple):
    """Compliance between the rows in contact, stored from step to step."""

    matrix: Floats  # (MAX_ACTIVE, MAX_ACTIVE, 3, 3) [m/N], by slots
    node: Ints  # (MAX_ACTIVE,) row in each slot
    slot: Ints  # (2 k,) slot of each row; -1 without
    used: Ints  # (1,) number of slots in use
    factor: Floats  # (t,) secant factor of the compliance under each tool
    block: Floats  # (3, 3) scratch
    row: Floats  # (3, 3 c) scratch
    near_row: Floats  # (3, 3 k) scratch


def compliance_table(compliance: SurfaceCompliance, order: Ints) -> ComplianceTable:
    """Return the compliance as arrays of the compiled step, its nodes in a given order."""
    carriers, weights = _patch_carriers(compliance)
    carrier_padding = ((0, 0), (0, carriers.shape[1] - compliance.carriers.shape[1]))
    carriers = np.concatenate([carriers[order], np.pad(compliance.carriers, carrier_padding)[order]])
    weights = np.concatenate([weights[order], np.pad(compliance.weights, carrier_padding)[order]])
    single_padding = ((0, 0), (0, compliance.patches.shape[1] - 1))
    members = np.concatenate([compliance.patches[order], np.pad(order[:, None], single_padding, mode="edge")])
    shares = np.concatenate([compliance.shares[order], np.pad(np.ones((len(order), 1)), single_padding)])
    return ComplianceTable(
        carriers=np.ascontiguousarray(carriers, dtype=np.int64),
        weights=np.ascontiguousarray(weights),
        flexibility=np.ascontiguousarray(compliance.flexibility),
        members=np.ascontiguousarray(members, dtype=np.int64),
        shares=np.ascontiguousarray(shares),
        nearby=np.ascontiguousarray(compliance.nearby, dtype=np.int64),
        near_field=np.ascontiguousarray(compliance.near_field),
        stiffening=np.ascontiguousarray(compliance.stiffening, dtype=float),
        bonded_scale=float(compliance.bonded_scale),
    )


def _patch_carriers(compliance: SurfaceCompliance) -> tuple[Ints, Floats]:
    """Return carriers and weights of the patches, from those of their nodes."""
    count, width = len(compliance.nodes), compliance.shares.shape[1] * compliance.weights.shape[1]
    return (
        compliance.carriers[compliance.patches].reshape(count, width),
        (compliance.shares[:, :, None] * compliance.weights[compliance.patches]).reshape(count, width),
    )


def active_compliance(table: ComplianceTable, tools: int) -> ActiveCompliance:
    """Return empty storage for the rows in contact with some tools."""
    nodes = len(table.members) // 2
    most = min(nodes, MAX_ACTIVE) if tools else 0
    return ActiveCompliance(
        matrix=np.zeros((most, most, 3, 3)),
        node=np.zeros(most, np.int64),
        slot=np.full(2 * nodes, -1),
        used=np.zeros(1, dtype=np.int64),
        factor=np.ones(tools),
        block=np.zeros((3, 3)),
        row=np.zeros((3, len(table.flexibility) if tools else 0)),
        near_row=np.zeros((3, 3 * nodes if tools and table.nearby.size else 0)),
    )


@kernel_njit(fastmath={"contract"})
def pair(compliance, i, j, block):
    """Write the compliance block (3, 3) [m/N] from a force on row j to row i."""
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


@kernel_njit(fastmath={"contract"})
def refresh(compliance, active, points, count):
    """Store the compliance between the rows in contact, points[:count]; return False if there are too many.

    Rows that have left contact stay until their slots are needed. If there are too many rows, nothing
    is stored.
    """
    if count > active.node.shape[0]:
        _clear(active)
        return False
    added = 0
    for e in range(count):
        added += active.slot[points[e]] < 0
    if active.used[0] + added > active.node.shape[0]:
        _clear(active)
    for e in range(count):
        i = points[e]
        if active.slot[i] >= 0:
            continue
        s = active.used[0]
        active.slot[i], active.node[s] = s, i
        active.used[0] = s + 1
        _row(compliance, i, active.row, active.near_row)
        for t in range(s + 1):
            _block(compliance, i, active.node[t], active, active.matrix[s, t])
            for c in range(3):
                for d in range(3):
                    active.matrix[t, s, d, c] = active.matrix[s, t, c, d]
    return True


@kernel_njit(inner=True, fastmath={"contract"})
def _clear(active):
    for s in range(active.used[0]):
        active.slot[active.node[s]] = -1
    active.used[0] = 0


@kernel_njit(inner=True, fastmath={"contract"})
def _row(compliance, i, row, near_row):
    """Write the compliances (3, 3 c) from all carriers to row i, and its near-field corrections (3, 3 k) [m/N]."""
    row[:] = 0.0
    near_row[:] = 0.0
    for a in range(compliance.carriers.shape[1]):
        p, w = 3 * compliance.carriers[i, a], compliance.weights[i, a]
        if w != 0.0:
            for c in range(3):
                for q in range(row.shape[1]):
                    row[c, q] += w * compliance.flexibility[p + c, q]
    for a in range(compliance.members.shape[1] if near_row.shape[1] else 0):
        n, w = compliance.members[i, a], compliance.shares[i, a]
        for k in range(compliance.nearby.shape[1] if w != 0.0 else 0):
            q = 3 * compliance.nearby[n, k]
            for c in range(3):
                for d in range(3):
                    near_row[c, q + d] += w * compliance.near_field[n, k, c, d]


@kernel_njit(inner=True, fastmath={"contract"})
def _block(compliance, i, j, active, block):
    """Write the compliance block (3, 3) [m/N] from a force on row j to row i, after `_row` of i."""
    row, near_row = active.row, active.near_row
    for c in range(3):
        for d in range(3):
            value = 0.0
            for b in range(compliance.carriers.shape[1]):
                value += compliance.weights[j, b] * row[c, 3 * compliance.carriers[j, b] + d]
            for b in range(compliance.members.shape[1] if near_row.shape[1] else 0):
                value += compliance.shares[j, b] * near_row[c, 3 * compliance.members[j, b] + d]
            block[c, d] = value


@register_jitable
def secant_factor(stiffening, force):
    """Return the secant factor h under a tool's force [N], or under those of an array."""
    return (1.0 + force / stiffening[1]) ** -stiffening[0]


@kernel_njit(fastmath={"contract"})
def stiffened_force(stiffening, product, inertia):
    """Return the secant factor h of a tool's force f, and its share of the force that h f = product asks for.

    `stiffening` has the exponent and the force [N] of the secant factor; `product` [N] is the force at the factor 1.
    `inertia` is the displacement of the modes by a force within the step, over that of the compliance at h = 1.
    """
    gamma, wanted = stiffening[0], product / stiffening[1]
    force = wanted  # at most the root, and h f is concave in f: so Newton's method rises to the root
    for _ in range(MAX_NEWTON_STEPS):
        factor = (1.0 + force) ** -gamma
        slope = factor * (1.0 - gamma * force / (1.0 + force))
        change = (wanted - force * factor) / slope
        force += change
        if not change > 1e-13 * force:
            break
    factor = (1.0 + force) ** -gamma
    slope = factor * (1.0 - gamma * force / (1.0 + force))
    return factor, min(1.0, slope / inertia) if inertia > 0.0 else 1.0


@kernel_njit()
def energy_factor(stiffening, force):
    """Return the energy of a stiffening compliance over half the product of its forces and displacements."""
    gamma, s = stiffening[0], 1.0 + force / stiffening[1]
    if gamma == 0.0 or s - 1.0 < 1e-6:
        return 1.0
    done = ((s ** (2.0 - gamma) - 1.0) / (2.0 - gamma) - (s ** (1.0 - gamma) - 1.0) / (1.0 - gamma)) / (s - 1.0) ** 2
    return 2.0 * (1.0 - done * s**gamma)


def contact_displacements(
    compliance: SurfaceCompliance, points: Floats, pushes: Floats, bonded: Sequence[bool]
) -> tuple[Floats, Floats]:
    """Return the displacements (n, 3) [m] of a body by its surface compliance, and the energy [J] under each tool.

    They are those at the surface and in the interior, for reference positions (n, 3) [m] of all nodes. `pushes`
    (tools, k, 3) [N] act on the patches of surface, or on its nodes if the tool holds them, `bonded`. Half of the
    energy that two tools share counts to either.
    """
    result, at_surface = np.zeros_like(points), np.zeros((len(compliance.nodes), 3))
    spread, shares = np.zeros_like(pushes), np.ones(len(pushes))
    for t, (push, nodal) in enumerate(zip(pushes, bonded, strict=True)):
        forces = push
        if not nodal:
            forces = np.zeros_like(push)
            np.add.at(forces, compliance.patches, compliance.shares[:, :, None] * push[:, None])
        on = np.flatnonzero(forces.any(axis=1))
        if not len(on):
            continue
        displacement = static_displacements(compliance, forces[on], on, np.arange(len(forces)))
        total = float(np.linalg.norm(forces.sum(axis=0)))
        displacement *= compliance.bonded_scale if nodal else secant_factor(compliance.stiffening, total)
        at_surface += displacement
        if compliance.interior is not None:
            on_carriers = carrier_forces(compliance, forces[on], on)
            result[compliance.interior.nodes] += interior_displacements(
                compliance.interior, on_carriers, flexible_displacements(compliance.flexibility, on_carriers)
            )
        spread[t], shares[t] = forces, 1.0 if nodal else energy_factor(compliance.stiffening, total)
    result[compliance.nodes] += at_surface
    return result, 0.5 * shares * np.einsum("tkc,kc->t", spread, at_surface)


def static_displacements(compliance: SurfaceCompliance, forces: Floats, on: Ints, targets: Ints) -> Floats:
    """Return the static displacements (t, 3) [m] of nodes `targets` for forces (j, 3) [N] on nodes `on`."""
    if not compliance.flexibility.size:
        return np.zeros((len(targets), 3))
    carried = carrier_forces(compliance, forces, on)
    spreading = flexible_displacements(compliance.flexibility, carried)
    displacement = np.einsum("tw,twc->tc", compliance.weights[targets], spreading[compliance.carriers[targets]])
    if compliance.nearby.size:  # the near-field correction is symmetric, so a row serves as a column
        nearby = np.zeros((len(compliance.nodes), 3))
        np.add.at(nearby, compliance.nearby[on], np.einsum("jqdc,jd->jqc", compliance.near_field[on], forces))
        displacement += nearby[targets]
    return np.asarray(displacement)


def carrier_forces(compliance: SurfaceCompliance, forces: Floats, on: Ints) -> Floats:
    """Return the forces (c, 3) [N] on the carriers for forces (j, 3) [N] on some nodes."""
    result = np.zeros((len(compliance.flexibility) // 3, 3))
    np.add.at(result, compliance.carriers[on], compliance.weights[on][:, :, None] * forces[:, None])
    return result
