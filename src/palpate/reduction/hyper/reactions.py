"""Accelerations of a reduced model, and the constraint forces of its supports and tools.

Test fields that the coordinates do not contain measure the constraint forces: they are the inertial
forces minus internal forces and loads.
"""

from __future__ import annotations

import numpy as np

from palpate.core.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.model import State
from palpate.reduction.hyper.body import ReducedBody, ReducedWork
from palpate.reduction.hyper.foundation import add_spring_forces
from palpate.reduction.hyper.loads import lifting_coordinates, reduced_loads


def accelerations(
    body: ReducedBody, state: State, prepared: PreparedLoads, work: ReducedWork | None = None
) -> tuple[Floats, Floats]:
    """Return the accelerations of the coordinates plus alpha times their velocities, and forces.

    The forces are internal forces plus loads, on the trial and test basis.
    """
    data, loads, times = body.data, reduced_loads(body, prepared), np.array([state.time])
    forces = body.all_forces(state.coordinates + data.stiffness_damping * state.velocities, state.history, work)
    forces += loads.forces(times)[0]
    add_spring_forces(loads.springs, state.coordinates, state.velocities, forces)
    if state.contact_state is not None:
        forces += np.tensordot(data.trial_and_test_basis, state.contact_state.forces, 2)
    modes = slice(data.modes)
    if prepared.is_prescribed(times)[0]:
        lifting_rates = prepared.rates(lambda at: lifting_coordinates(data, prepared, at), state.time)[1]
        lifting_rates = lifting_rates + data.mass_damping * state.velocities[data.modes :]
        free = forces[modes] - body.mass[modes, data.modes :] @ lifting_rates
        return np.concatenate([body.constrained_inverse_mass @ free, lifting_rates]), forces
    return body.inverse_mass @ forces[: body.count], forces


def constraint_forces(
    body: ReducedBody, state: State, prepared: PreparedLoads, work: ReducedWork | None = None
) -> Floats:
    """Return the constraint forces on the trial and test basis, shape (m + l + 3 g + w,)."""
    rates, forces = accelerations(body, state, prepared, work)
    return np.asarray(body.all_mass[:, : body.count] @ rates - forces)


def reactions(body: ReducedBody, state: State, prepared: PreparedLoads, forces: Floats) -> dict[str, Floats]:
    """Return the force (3,) [N] of every support and tool on the body; zero after a tool's release.

    The forces (m + l + 3 g + w,) are those of `constraint_forces`.
    """
    data, first = body.data, body.count
    result = {support.group: forces[first + 3 * g : first + 3 * g + 3] for g, support in enumerate(data.supports)}
    prescribed, tools = prepared.is_prescribed(np.array([state.time]))[0], forces[data.modes : first]
    for name in data.prescribed:
        result[name] = tool_map(body, name)[:, :3].T @ tools if prescribed else np.zeros(3)
    return result


def tool_map(body: ReducedBody, group: str) -> Floats:
    """Return the map (l, 12) from the pose of a rigid tool to the lifting coordinates.

    The coordinates are the map times the translation (3) and the entries of R - I (9, row by row). R is
    the rotation about the mean position of the group's nodes.
    """
    nodes = body.data.cloud.group(group)
    return pose_map(body.data.cloud.points[nodes], body.vectors[body.data.modes :, nodes])


def pose_map(points: Floats, basis_vectors: Floats) -> Floats:
    """Return the map (l, 12) from a pose to coordinates of lifting functions (l, k, 3); see `tool_map`."""
    arms, fields = points - points.mean(axis=0), np.zeros((12, len(points), 3))
    for c in range(3):
        fields[c, :, c] = 1.0
        for d in range(arms.shape[1]):
            fields[3 + 3 * c + d, :, c] = arms[:, d]
    return np.asarray(
        np.linalg.lstsq(basis_vectors.reshape(len(basis_vectors), -1).T, fields.reshape(12, -1).T, rcond=None)[0]
    )
