"""The share of a load's static response that the coordinates of a reduced model cannot represent.

Test functions that share the symmetry of the training cannot see a load across it: the forces on them
are balanced. The static response u = K^-1 f of the body at rest to the present loads can. Its part
outside the coordinates is w = u - Q (Q^T M Q)^-1 Q^T M u, and the share is |w| over the larger of |u| and
the displacement of the body, root mean squares over the body. A coarse grid replaces K.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.loads.supports import FIXED, supported_nodes
from palpate.dynamics.nodal.coarse_grid import static_estimate
from palpate.dynamics.run.model import State
from palpate.reduction.hyper.body import ReducedBody

__all__ = ["MAX_LOAD_SCALE", "MIN_LOAD_SCALE", "load_share", "static_response"]

MIN_LOAD_SCALE = 0.3  # least share at which the trust number is 1
MAX_LOAD_SCALE = 0.9  # largest: a load that the coordinates cannot feel at all has a share of 1


def static_response(body: ReducedBody) -> Callable[[Floats], Floats] | None:
    """Return the static response at rest (n, 3) [m] to nodal forces (n, 3) [N], as a function.

    It is None for membranes, and for bodies without supports and prescribed groups.
    """
    data = body.data
    if data.kinematics.sheet or not (data.supports or data.prescribed):
        return None
    supported = supported_nodes(data.cloud, data.supports)
    constrained = supported.kind == FIXED
    for group in data.prescribed:
        constrained[data.cloud.group(group)] = True
    return static_estimate(data.cloud, data.volumes, data.tissue, supported, constrained)


def load_share(
    body: ReducedBody, response: Callable[[Floats], Floats] | None, state: State, prepared: PreparedLoads
) -> float:
    """Return the share of the static response to the loads of a state that is outside the coordinates, 0 to 1."""
    forces = _nodal_forces(body, state, prepared)
    if response is None or not forces.any():
        return 0.0
    static = response(forces)
    outside = static - np.tensordot(body.project(static[None])[0], body.vectors, 1)
    moved = float(np.sqrt(state.coordinates @ body.mass @ state.coordinates / body.masses.sum()))
    return _size(body, outside) / max(_size(body, static), moved, 1e-300)


def _nodal_forces(body: ReducedBody, state: State, prepared: PreparedLoads) -> Floats:
    """Return the nodal forces (n, 3) [N] of dead loads, gravity and tools in contact."""
    sites, schedule = prepared.sites, prepared.schedule(np.array([state.time]))
    result = np.asarray(body.masses[:, None] * schedule.gravity[0])
    for g in range(len(sites.dead_start) - 1):
        own = slice(sites.dead_start[g], sites.dead_start[g + 1])
        forces = np.einsum("kac,a->kc", sites.dead_pattern[own], schedule.amplitudes[0, g])
        np.add.at(result, sites.dead_node[own], forces)
    return result if state.contact_state is None else result + state.contact_state.forces


def _size(body: ReducedBody, field: Floats) -> float:
    return float(np.sqrt(np.sum(body.masses[:, None] * field**2) / body.masses.sum()))
