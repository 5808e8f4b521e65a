"""Forces of supports and tools on the body, and what else a state tells.

The force on a group of held nodes is the virtual work of a displacement that is 1 there and 0 at the other groups,

    R_i = sum over the nodes of  m phi a_i + V P_iL dphi/dX_L - phi f_i,

phi a partition of unity over the groups. It needs no stress at the held nodes themselves, where it is singular, and
the forces of all groups balance the body's momentum exactly. With one group phi = 1: momentum alone decides. Where the
nodal forces f are the derivative of an energy, the stresses' virtual work is - V phi f, and R the exact residual.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.model import Model, Outputs, State

__all__ = ["evaluate", "partition", "reactions", "tool_power", "touching"]


def partition(points: Floats, supports: dict[str, NDArray[np.int64]]) -> Floats:
    """Return functions (groups, n), 1 on their own group and 0 on the others, that sum to 1 (Shepard's)."""
    if len(supports) == 1:
        return np.ones((1, len(points)))
    distance = np.stack([cKDTree(points[nodes]).query(points)[0] for nodes in supports.values()])
    inverse = np.stack([np.prod(np.delete(distance, g, axis=0) ** 2, axis=0) for g in range(len(distance))])
    return np.asarray(inverse / inverse.sum(axis=0))


def reactions(model: Model, state: State, prepared: PreparedLoads) -> dict[str, Floats]:
    """Return the force [N] of every support and tool on the body, shape (3,) each; zero once a tool has let go."""
    none = {name: np.zeros(3) for name in prepared.supports}
    supports = prepared.holding(state.time)
    if not supports:
        return none
    names = tuple(supports)
    if names not in prepared.partitions:
        prepared.partitions[names] = partition(model.cloud.points, supports)
    phi = prepared.partitions[names]
    inertia = model.masses[:, None] * model.acceleration(state, prepared) - model.external_force(state, prepared)
    forces = phi @ inertia
    if model.conservative:
        moved = model.displacement(state, prepared) + model.stiffness_damping * model.velocity(state, prepared)
        forces = forces - (phi * model.volumes) @ model.nodal_force(moved)
    elif len(phi) > 1:
        moved = model.displacement(state, prepared) + model.stiffness_damping * model.velocity(state, prepared)
        slopes = model.stencils.gradient(phi.T)  # (n, groups, 3)
        forces = forces + np.einsum("n,nil,ngl->gi", model.volumes, model.stress(moved), slopes)
    return none | dict(zip(supports, forces, strict=True))


def tool_power(model: Model, state: State, prepared: PreparedLoads) -> float:
    """Return the power [W] of the tools on the body: their forces times the mean velocities of their nodes."""
    if not prepared.motions:
        return 0.0
    forces = reactions(model, state, prepared)
    groups = [motion.group for motion, _ in prepared.motions]
    return float(sum(forces[g] @ model.velocity(state, prepared, prepared.supports[g]).mean(axis=0) for g in groups))


def touching(
    state: State, prepared: PreparedLoads
) -> tuple[dict[str, Floats], dict[str, Floats], Floats, NDArray[np.bool_]]:
    """Return the force [N] on the body and the moment [N m] about its origin of every tool that may touch it.

    And (c, 4) the nodes touched with the forces [N] on them. All are means over the time since the last frame of a run,
    so that their sum times that time is the momentum given. Forces of a `Grasp` on the nodes that it holds in the
    energy form are among them, without a moment; (c,) tells which nodes these are.
    """
    if state.contact_state is None:
        return {}, {}, np.zeros((0, 4)), np.zeros(0, dtype=np.bool_)
    contact_state, names = state.contact_state, [tool.name for tool in prepared.tools]
    rate = 1.0 / (state.time - contact_state.since) if state.time > contact_state.since else 0.0
    forces = dict(zip(names, rate * contact_state.impulses[:, :3], strict=True))
    moments = dict(zip(names, rate * contact_state.impulses[:, 3:], strict=True))
    given, holding = rate * contact_state.given, np.zeros(len(contact_state.given), dtype=np.bool_)
    for name, where in prepared.grasped().items() if len(contact_state.constraint_impulses) else ():
        nodes, own = prepared.places.prescribed[where], rate * contact_state.constraint_impulses[where]
        forces[name] = own.sum(axis=0)
        given[nodes] += own
        holding[nodes] = own.any()
    nodes = np.flatnonzero(given.any(axis=1))
    return forces, moments, np.column_stack([nodes, given[nodes]]), holding[nodes]


def evaluate(model: Model, state: State, prepared: PreparedLoads) -> Outputs:
    """Return displacements, velocities, forces and energies at a state."""
    u, v = model.displacement(state, prepared), model.velocity(state, prepared)
    forces, moments, contact_forces, held = touching(state, prepared)
    return Outputs(
        u,
        v,
        reactions(model, state, prepared) | forces,
        float(0.5 * np.sum(model.masses[:, None] * v**2)),
        model.strain_energy(u),
        state.external_work,
        state.dissipated,
        moments,
        contact_forces,
        held,
    )
