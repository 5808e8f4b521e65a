"""The share of the static response to loads and prescribed motions that the coordinates cannot represent.

Test functions that share the symmetry of the training cannot see a load across it: the forces on them
are balanced. The static response u = K^-1 f of the body at rest to the present loads can. Its part
outside the coordinates is w = u - Q (Q^T M Q)^-1 Q^T M u, and the share is |w| over the larger of |u| and
the displacement of the body, root mean squares over the body. A coarse grid replaces K. Sheets, which
have no stiffness across their plane at rest, respond like a stretched membrane. A body without supports
is held by soft springs on all its mass, so that its rigid motions outweigh its deformation.

A prescribed motion is a load, too: its static response, and that to the inertia of the lifting functions.
The response is linear in the amplitudes: both squares are quadratic forms of these, computed once for
prepared loads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from palpate.core.arrays import Floats
from palpate.dynamics.loads.prepared import LoadSites
from palpate.dynamics.loads.supports import FIXED, supported_nodes
from palpate.dynamics.nodal.coarse_grid import static_estimate
from palpate.dynamics.run.model import State
from palpate.reduction.hyper.body import ReducedBody
from palpate.reduction.hyper.data import ReducedData

MIN_LOAD_SCALE = 0.3  # least share at which the error indicator is 1
MAX_LOAD_SCALE = 0.9  # largest: a load that the coordinates cannot feel at all has a share of 1
MIN_DISPLACEMENT = 1e-9  # least displacement that counts, in spacings: rounding is below
TOOL_STIFFNESS = 1e3  # of the springs that move the nodes of tools, over the stiffness of a node's cell
RIGID_STIFFNESS = 0.01  # of the springs on a body without supports, over shear modulus and size of the body

Response = Callable[[Floats], Floats]


class ResponseSquares(NamedTuple):
    """Squares of responses [m^2]: quadratic forms (k, k) in the k amplitudes of loads, dead loads first."""

    outside: Floats  # of the coordinates that are not prescribed
    whole: Floats


def static_response(data: ReducedData, springs: Floats, held: Sequence[str] | None = None) -> Response:
    """Return the static response at rest (n, 3) [m] to nodal forces (n, 3) [N], as a function.

    `springs` (n,) [N/m] are those of foundations. The groups `held` do not move; by default those of the tools.
    """
    supported = supported_nodes(data.cloud, data.supports)
    constrained = supported.kind == FIXED
    for group in data.prescribed if held is None else held:
        constrained[data.cloud.group(group)] = True
    if not (constrained.any() or len(supported.sliding) or springs.any()):
        total_volume = float(data.volumes.sum())
        stiffness = RIGID_STIFFNESS * data.tissue.material.shear_modulus * np.cbrt(total_volume)
        springs = stiffness * data.volumes / total_volume
    return static_estimate(data.cloud, data.volumes, data.tissue, supported, constrained, springs)


def load_share(body: ReducedBody, state: State, responses: ResponseSquares, amplitudes: Floats) -> float:
    """Return the share of the static response to the loads of a state that is outside the coordinates, 0 to 1.

    The amplitudes (k,) are those of the loads at the time of the state; see `response_squares`.
    """
    if not amplitudes.any():
        return 0.0
    missed, size = (float(np.sqrt(max(float(amplitudes @ form @ amplitudes), 0.0))) for form in responses)
    moved = float(np.sqrt(state.coordinates @ body.mass @ state.coordinates / body.masses.sum()))
    return missed / max(size, moved, MIN_DISPLACEMENT * body.data.cloud.spacing)


def response_squares(body: ReducedBody, sites: LoadSites, response: Callable[[], Response]) -> ResponseSquares:
    """Return the squares of the static responses to loads and motions.

    `response` returns the static response of the body without foundations. The amplitudes are those of the dead loads,
    of gravity, of the lifting coordinates, and of their accelerations, whose inertia is a load on the rest of the body.
    Lifting coordinates are prescribed, so that only the modes can follow.
    """
    data = body.data
    springs = np.bincount(sites.foundation_node, sites.foundation_spring, len(body.masses)).astype(float)
    respond = static_response(data, springs) if springs.any() else response()
    lifting = body.vectors[data.modes :]
    inertia = -body.masses[:, None] * lifting
    moved = _responses_to_motion(data, lifting, springs) if len(lifting) else []
    responses = np.array([*map(respond, _unit_forces(body, sites)), *moved, *map(respond, inertia)])
    outside = responses.copy()
    count = len(responses) - 2 * len(lifting)
    outside[count : count + len(lifting)] -= lifting
    moving = body.vectors[: data.modes]
    outside -= np.tensordot(_project(outside, moving, body.masses), moving, 1)
    weights = np.repeat(body.masses / body.masses.sum(), 3)
    flat = (each.reshape(len(responses), -1) for each in (outside, responses))
    return ResponseSquares(*((rows * weights) @ rows.T for rows in flat))


def _project(fields: Floats, vectors: Floats, masses: Floats) -> Floats:
    """Return the coordinates (k, m) of the best approximations of fields (k, n, 3) by vectors (m, n, 3)."""
    flat = vectors.reshape(len(vectors), -1)
    weighted = flat * np.repeat(masses, 3)
    return np.asarray(np.linalg.solve(weighted @ flat.T, weighted @ fields.reshape(len(fields), -1).T).T)


def _responses_to_motion(data: ReducedData, lifting: Floats, springs: Floats) -> list[Floats]:
    """Return the static responses (n, 3) to unit lifting coordinates: stiff springs move the tools' nodes."""
    nodes, stiff = np.concatenate([data.cloud.group(name) for name in data.prescribed]), np.zeros(len(data.volumes))
    law = data.tissue.material
    modulus = law.shear_modulus if data.kinematics.sheet else law.lame + 2 * law.shear_modulus
    stiff[nodes] = TOOL_STIFFNESS * modulus * data.volumes[nodes] / data.cloud.spacing**2
    respond = static_response(data, springs + stiff, held=())
    return [respond(stiff[:, None] * field) for field in lifting]


def _unit_forces(body: ReducedBody, sites: LoadSites) -> Floats:
    """Return the nodal forces (k, n, 3) [N] of unit amplitudes of dead loads and gravity."""
    units = []
    for g in range(len(sites.dead_start) - 1):
        entries = slice(sites.dead_start[g], sites.dead_start[g + 1])
        forces = np.zeros((sites.dead_pattern.shape[1], len(body.masses), 3))
        for unit, pattern in zip(forces, sites.dead_pattern[entries].transpose(1, 0, 2), strict=True):
            np.add.at(unit, sites.dead_node[entries], pattern)
        units.append(forces)
    return np.concatenate([*units, np.eye(3)[:, None, :] * body.masses[:, None]])
