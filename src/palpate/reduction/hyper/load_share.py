"""The share of a load's static response that the coordinates of a reduced model cannot represent.

Test functions that share the symmetry of the training cannot see a load across it: the forces on them
are balanced. The static response u = K^-1 f of the body at rest to the present loads can. Its part
outside the coordinates is w = u - Q (Q^T M Q)^-1 Q^T M u, and the share is |w| over the larger of |u| and
the displacement of the body, root mean squares over the body. A coarse grid replaces K. Sheets, which
have no stiffness across their plane at rest, respond like a stretched membrane. A body without supports
is held by soft springs on all its mass, so that its rigid motions outweigh its deformation.

The response is linear in the amplitudes of the loads: both squares are quadratic forms of these,
computed once for prepared loads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.loads.supports import FIXED, supported_nodes
from palpate.dynamics.nodal.coarse_grid import static_estimate
from palpate.dynamics.run.model import State
from palpate.reduction.hyper.body import ReducedBody
from palpate.reduction.hyper.data import ReducedData

__all__ = ["MAX_LOAD_SCALE", "MIN_LOAD_SCALE", "load_share", "static_response"]

MIN_LOAD_SCALE = 0.3  # least share at which the trust number is 1
MAX_LOAD_SCALE = 0.9  # largest: a load that the coordinates cannot feel at all has a share of 1
RIGID_STIFFNESS = 0.01  # of the springs on a body without supports, over shear modulus and size of the body

Response = Callable[[Floats], Floats]


class _Squares(NamedTuple):
    """Squares of responses [m^2]: quadratic forms (k, k) in the k amplitudes of loads, dead loads first."""

    outside: Floats
    whole: Floats


def static_response(data: ReducedData, springs: Floats) -> Response:
    """Return the static response at rest (n, 3) [m] to nodal forces (n, 3) [N], as a function.

    Parameters
    ----------
    data : ReducedData
    springs : (n,) array [N/m]
        Springs of foundations at the nodes.
    """
    supported = supported_nodes(data.cloud, data.supports)
    constrained = supported.kind == FIXED
    for group in data.prescribed:
        constrained[data.cloud.group(group)] = True
    if not (constrained.any() or len(supported.sliding) or springs.any()):
        whole = float(data.volumes.sum())
        stiffness = RIGID_STIFFNESS * data.tissue.material.shear_modulus * np.cbrt(whole)
        springs = stiffness * data.volumes / whole
    return static_estimate(data.cloud, data.volumes, data.tissue, supported, constrained, springs)


def load_share(body: ReducedBody, state: State, prepared: PreparedLoads, response: Callable[[], Response]) -> float:
    """Return the share of the static response to the loads of a state that is outside the coordinates, 0 to 1.

    Parameters
    ----------
    body : ReducedBody
    state : State
    prepared : PreparedLoads
        Of its loads, dead loads and gravity count.
    response : function
        Returns the static response of the body without foundations; it is called at the first use.
    """
    schedule = prepared.schedule(np.array([state.time]))
    amplitudes = np.concatenate([schedule.amplitudes[0].ravel(), schedule.gravity[0]])
    if not amplitudes.any():
        return 0.0
    squares = _squares(body, prepared, response)
    missed, whole = (float(np.sqrt(max(amplitudes @ form @ amplitudes, 0.0))) for form in squares)
    moved = float(np.sqrt(state.coordinates @ body.mass @ state.coordinates / body.masses.sum()))
    return missed / max(whole, moved, 1e-300)


def _squares(body: ReducedBody, prepared: PreparedLoads, response: Callable[[], Response]) -> _Squares:
    """Return the quadratic forms of prepared loads, computed at the first use."""
    key = id(body.data)  # the pair keeps the data, whose id no other object has then
    known = prepared.derived.get(key)
    if known is None:
        sites = prepared.sites
        springs = np.bincount(sites.foundation_node, sites.foundation_spring, len(body.masses)).astype(float)
        respond = static_response(body.data, springs) if springs.any() else response()
        fields = np.array([respond(forces) for forces in _unit_forces(body, prepared)])
        outside = fields - np.tensordot(body.project(fields), body.vectors, 1)
        weights = np.repeat(body.masses / body.masses.sum(), 3)
        flat = (each.reshape(len(fields), -1) for each in (outside, fields))
        known = prepared.derived[key] = (body.data, _Squares(*((rows * weights) @ rows.T for rows in flat)))
    return cast(_Squares, known[1])


def _unit_forces(body: ReducedBody, prepared: PreparedLoads) -> Floats:
    """Return the nodal forces (k, n, 3) [N] of unit amplitudes of dead loads and gravity."""
    sites, found = prepared.sites, []
    for g in range(len(sites.dead_start) - 1):
        own = slice(sites.dead_start[g], sites.dead_start[g + 1])
        forces = np.zeros((sites.dead_pattern.shape[1], len(body.masses), 3))
        for unit, pattern in zip(forces, sites.dead_pattern[own].transpose(1, 0, 2), strict=True):
            np.add.at(unit, sites.dead_node[own], pattern)
        found.append(forces)
    return np.concatenate([*found, np.eye(3)[:, None, :] * body.masses[:, None]])
