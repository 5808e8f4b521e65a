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

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.model import Nodes, Outputs, State
from palpate.dynamics.run.partition import Partition, active_partitions
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import Stencils

__all__ = [
    "NodalFields",
    "contact_outputs",
    "evaluate",
    "group_forces",
    "reactions",
    "tool_power",
]


class NodalFields(Protocol):
    """The interface of a model with accelerations, forces and stresses at every node."""

    conservative: bool
    stiffness_damping: float
    volumes: Floats
    stencils: Stencils

    @property
    def cloud(self) -> Cloud: ...
    @property
    def masses(self) -> Floats: ...
    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats: ...
    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats: ...
    def acceleration(self, state: State, prepared: PreparedLoads, work: Any = None) -> Floats: ...
    def external_force(self, state: State, prepared: PreparedLoads, work: Any = None) -> Floats: ...
    def nodal_force(self, displacements: Floats, history: tuple[Floats, ...] = (), work: Any = None) -> Floats: ...
    def stress(self, displacements: Floats, history: tuple[Floats, ...] = (), work: Any = None) -> Floats: ...
    def strain_energy(self, displacements: Floats, history: tuple[Floats, ...] = (), work: Any = None) -> float: ...


def reactions(model: NodalFields, state: State, prepared: PreparedLoads, work: Any = None) -> dict[str, Floats]:
    """Return the force (3,) [N] of every support and tool on the body; zero after a tool's release."""
    zero = {name: np.zeros(3) for name in prepared.supports}
    supports, parts = active_partitions(model.cloud.points, prepared, state.time)
    if not supports:
        return zero
    nodal = model.masses[:, None] * model.acceleration(state, prepared, work)
    nodal = nodal - model.external_force(state, prepared, work)
    stress = None
    if model.conservative or any(np.count_nonzero(part.phi.any(axis=1)) > 1 for part in parts):
        moved = model.displacement(state, prepared) + model.stiffness_damping * model.velocity(state, prepared)
        if model.conservative:
            nodal -= model.volumes[:, None] * model.nodal_force(moved, state.history, work)
        else:
            stress = model.stress(moved, state.history, work)
    return zero | dict(zip(supports, group_forces(model, parts, nodal, stress), strict=True))


def group_forces(model: NodalFields, parts: Sequence[Partition], nodal: Floats, stress: Floats | None = None) -> Floats:
    """Return the forces (groups, 3) [N] of nodal forces and a stress on groups.

    Parameters
    ----------
    model : NodalFields
    parts : sequence of Partition
    nodal : (n, 3) array [N]
        Forces that a group must exert on its nodes.
    stress : (n, 3, d) array, optional [Pa]
    """
    forces = np.zeros((len(parts[0].phi), 3))
    for directions, phi in parts:
        own = phi @ nodal
        if stress is not None:
            slopes = model.stencils.gradient(phi.T)  # (n, groups, 3)
            own = own + np.einsum("n,nil,ngl->gi", model.volumes, stress, slopes)
        forces += own @ directions
    return forces


def tool_power(model: NodalFields, state: State, prepared: PreparedLoads, work: Any = None) -> float:
    """Return the power [W] of the tools on the body: their forces times the mean velocities of their nodes."""
    if not prepared.motions:
        return 0.0
    forces = reactions(model, state, prepared, work)
    groups = [motion.group for motion, _ in prepared.motions]
    return float(sum(forces[g] @ model.velocity(state, prepared, prepared.supports[g]).mean(axis=0) for g in groups))


def contact_outputs(
    state: State, prepared: PreparedLoads
) -> tuple[dict[str, Floats], dict[str, Floats], Floats, NDArray[np.bool_]]:
    """Return the mean contact forces since the last frame of a run.

    Their sum times that interval is the momentum transferred to the body. In the energy form they
    include the forces of a `Grasp` on its nodes, without a moment.

    Returns
    -------
    forces, moments : mappings of tool name to (3,) array [N], [N m]
        Force on the body, and moment about the tool's origin.
    contact_forces : (c, 4) array
        Nodes in contact and the forces [N] on them.
    bonded : (c,) bool array
        True for the nodes of a `Grasp`.
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
        nodes, own = prepared.sites.prescribed[where], rate * contact_state.constraint_impulses[where]
        forces[name] = own.sum(axis=0)
        nodal_forces[nodes] += own
        bonded[nodes] = own.any()
    nodes = np.flatnonzero(nodal_forces.any(axis=1))
    return forces, moments, np.column_stack([nodes, nodal_forces[nodes]]), bonded[nodes]


def evaluate(model: NodalFields, state: State, prepared: PreparedLoads, work: Any = None) -> Outputs:
    """Return displacements, velocities, forces and energies of a state."""
    u, v = model.displacement(state, prepared), model.velocity(state, prepared)
    forces, moments, contact_forces, bonded = contact_outputs(state, prepared)
    return Outputs(
        displacements=u,
        velocities=v,
        reactions=reactions(model, state, prepared, work) | forces,
        kinetic=float(0.5 * np.sum(model.masses[:, None] * v**2)),
        strain=model.strain_energy(u, state.history, work),
        external=state.external_work,
        dissipated=state.dissipated,
        moments=moments,
        contact_forces=contact_forces,
        bonded=bonded,
    )
