"""Reaction forces of supports and tools, and the other outputs of a state.

The force on a group of constrained nodes is the virtual work of a displacement that is 1 there and
0 at the other groups,

    R_i = sum over the nodes of  m phi a_i + V P_iL dphi/dX_L - phi f_i,

with phi a partition of unity over the groups. This does not require the singular stress at the
constrained nodes themselves, and the forces of all groups balance the body's momentum exactly. With
one group phi = 1, and R follows from momentum alone. For nodal forces f that are the derivative of
an energy, the virtual work of the stresses is - V phi f, and R is the exact residual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.model import Outputs, State
from palpate.dynamics.run.partition import Partition, active_partitions
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.mirror import Mirror
from palpate.meshfree.stencils import Stencils


class NodalBody(Protocol):
    """The nodes of a body, with their stress-free volumes, stencils and mirror images."""

    volumes: Floats
    stencils: Stencils
    mirror: Mirror

    @property
    def cloud(self) -> Cloud: ...
    @property
    def masses(self) -> Floats: ...


class NodalFields(NamedTuple):
    """Fields of a state at every node, from which reactions and energies follow."""

    # displacement, velocity: (n, 3) arrays [m], [m/s]
    displacement: Floats
    velocity: Floats
    # (n, 3) array [N]: mass times acceleration, minus surface loads and gravity. Of a body with an energy, also minus
    # the internal forces.
    unbalanced: Floats
    # returns the first Piola-Kirchhoff stress (n, 3, d) [Pa] of a body without an energy
    stress: Callable[[], Floats] | None


def reactions(body: NodalBody, fields: NodalFields, state: State, prepared: PreparedLoads) -> dict[str, Floats]:
    """Return the force (3,) [N] of every support and tool on the body; zero after a tool's release."""
    zero = {name: np.zeros(3) for name in prepared.supports}
    supports, parts = active_partitions(body.cloud.points, prepared, state.time)
    if not supports:
        return zero
    several = any(np.count_nonzero(part.phi.any(axis=1)) > 1 for part in parts)
    stress = fields.stress() if fields.stress is not None and several else None
    return zero | dict(zip(supports, group_forces(body, parts, fields.unbalanced, stress), strict=True))


def group_forces(body: NodalBody, parts: Sequence[Partition], nodal: Floats, stress: Floats | None = None) -> Floats:
    """Return the forces (groups, 3) [N] of nodal forces (n, 3) [N] and a stress (n, 3, d) [Pa] on groups.

    The nodal forces are those that a group must exert on its nodes.
    """
    forces = np.zeros((len(parts[0].phi), 3))
    for directions, phi in parts:
        group_force = np.einsum("gn,nc->gc", phi, nodal)  # without BLAS, whose threads spin (`palpate.core.arrays`)
        if stress is not None:
            slopes = body.stencils.gradient(body.mirror.scalars(phi.T))  # (n, groups, 3)
            group_force = group_force + np.einsum("n,nil,ngl->gi", body.volumes, stress, slopes)
        forces += group_force @ directions
    return forces


def tool_power(body: NodalBody, fields: NodalFields, state: State, prepared: PreparedLoads) -> float:
    """Return the power [W] of the tools on the body: their forces times the mean velocities of their nodes."""
    forces = reactions(body, fields, state, prepared)
    groups = [motion.group for motion, _ in prepared.motions]
    return float(sum(forces[g] @ fields.velocity[prepared.supports[g]].mean(axis=0) for g in groups))


def contact_outputs(
    state: State, prepared: PreparedLoads
) -> tuple[dict[str, Floats], dict[str, Floats], Floats, NDArray[np.bool_]]:
    """Return the mean contact forces since the last frame of a run.

    Their sum times that interval is the momentum transferred to the body. In the energy form they include the forces of
    a `Grasp` on its nodes, without a moment.

    Returns forces (3,) [N] on the body and moments (3,) [N m] about the tool's origin, by the tool's name. Then come
    the nodes in contact and the forces on them (c, 4) [N], and which of them are nodes of a `Grasp` (c,).
    """
    if state.contact_state is None:
        return {}, {}, np.zeros((0, 4)), np.zeros(0, dtype=np.bool_)
    contact_state, names = state.contact_state, [tool.name for tool in prepared.tools]
    interval = state.time - contact_state.start_time
    rate = 1.0 / interval if interval > 0.0 else 0.0
    forces = dict(zip(names, rate * contact_state.impulses[:, :3], strict=True))
    moments = dict(zip(names, rate * contact_state.impulses[:, 3:], strict=True))
    nodal_forces = rate * contact_state.nodal_impulses
    bonded = np.zeros(len(nodal_forces), dtype=np.bool_)
    for name, where in prepared.grasp_slices().items() if len(contact_state.constraint_impulses) else ():
        nodes, node_forces = prepared.sites.prescribed[where], rate * contact_state.constraint_impulses[where]
        forces[name] = node_forces.sum(axis=0)
        nodal_forces[nodes] += node_forces
        bonded[nodes] = node_forces.any()
    nodes = np.flatnonzero(nodal_forces.any(axis=1))
    return forces, moments, np.column_stack([nodes, nodal_forces[nodes]]), bonded[nodes]


def nodal_outputs(
    body: NodalBody, fields: NodalFields, state: State, prepared: PreparedLoads, strain_energy: float
) -> Outputs:
    """Return displacements, velocities, forces and energies of a state."""
    forces, moments, contact_forces, bonded = contact_outputs(state, prepared)
    return Outputs(
        displacements=fields.displacement,
        velocities=fields.velocity,
        reactions=reactions(body, fields, state, prepared) | forces,
        kinetic=float(0.5 * np.sum(body.masses[:, None] * fields.velocity**2)),
        strain=strain_energy,
        external=state.external_work,
        dissipated=state.dissipated,
        moments=moments,
        contact_forces=contact_forces,
        bonded=bonded,
    )
