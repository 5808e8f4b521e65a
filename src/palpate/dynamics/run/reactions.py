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

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.model import Nodes, Outputs, State
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import Stencils

__all__ = ["NodalFields", "contact_outputs", "evaluate", "partition", "reactions", "tool_power"]


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


def partition(points: Floats, supports: dict[str, NDArray[np.int64]]) -> Floats:
    """Return Shepard's partition of unity (groups, n): 1 on the own group and 0 on the others."""
    if len(supports) == 1:
        return np.ones((1, len(points)))
    distance = np.stack([cKDTree(points[nodes]).query(points)[0] for nodes in supports.values()])
    inverse = np.stack([np.prod(np.delete(distance, g, axis=0) ** 2, axis=0) for g in range(len(distance))])
    return np.asarray(inverse / inverse.sum(axis=0))


def reactions(model: NodalFields, state: State, prepared: PreparedLoads, work: Any = None) -> dict[str, Floats]:
    """Return the force (3,) [N] of every support and tool on the body; zero after a tool's release."""
    zero = {name: np.zeros(3) for name in prepared.supports}
    supports = prepared.active_supports(state.time)
    if not supports:
        return zero
    names = tuple(supports)
    if names not in prepared.partitions:
        prepared.partitions[names] = partition(model.cloud.points, supports)
    phi = prepared.partitions[names]
    inertia = model.masses[:, None] * model.acceleration(state, prepared, work)
    forces = phi @ (inertia - model.external_force(state, prepared, work))
    if model.conservative:
        moved = model.displacement(state, prepared) + model.stiffness_damping * model.velocity(state, prepared)
        forces = forces - (phi * model.volumes) @ model.nodal_force(moved, state.history, work)
    elif len(phi) > 1:
        moved = model.displacement(state, prepared) + model.stiffness_damping * model.velocity(state, prepared)
        slopes = model.stencils.gradient(phi.T)  # (n, groups, 3)
        forces = forces + np.einsum("n,nil,ngl->gi", model.volumes, model.stress(moved, state.history, work), slopes)
    return zero | dict(zip(supports, forces, strict=True))


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
