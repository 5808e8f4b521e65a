"""The front ahead of a blunt blade, which advances where its energy release reaches the toughness.

The energy that a front releases per area follows from the stresses around it (Shih, Moran and Nakamura, International
Journal of Fracture 30, 1986): with a weight q that is 1 at the front and 0 at a distance of four spacings, its length
l, and the direction n in which it advances,

    G l = integral of (P^T du/dn - W n) . dq/dX dV.

It varies by 1 % with the place of the front between the nodes. The change of the energy in a short advance varies by
20 %. Where G reaches the toughness, trial cuts advance the front in short steps at fixed displacements. It goes on
while the energy that was released since then is at least the toughness times the area. Cuts that make energy are undone
if a shorter or a longer one makes none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.run.model import State
from palpate.dynamics.solid.cutting.cut import cut_from
from palpate.dynamics.solid.cutting.incision import (
    LARGEST_ADVANCE,
    NEAR_BODY,
    Incision,
    after_cut,
    area_inside,
    cutting_directions,
    edge_points,
    length_inside,
    next_strip,
    points_in_space,
    project_on_cut,
)
from palpate.faults import DivergenceError, InputError
from palpate.meshfree.cut.points import SIGHT_DISTANCE, point_weights

__all__ = ["energy_release", "run_front", "start_front"]

RELEASE_REACH = 4.0  # of the weight from the front, in spacings
FRONT_ADVANCE = 1 / 32  # of the front in one cut, in spacings
SEARCH_STEP = 0.05  # between points where a front is searched, in spacings
MOUTH_DISTANCE = 3.0  # distance of an edge outside the body from the cut that it enters, in spacings


def _point_directions(blade: Blade, frame: Floats, spacing: float) -> Floats:
    """Return the unit vectors (p, 3) in which the points of an edge in a frame (3, 4) move on."""
    pieces = cutting_directions(edge_points(blade, spacing))
    ahead = np.concatenate([pieces[:1], pieces]) + np.concatenate([pieces, pieces[-1:]])
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.asarray(ahead @ frame[:, :3].T)


def start_front(body: Any, incision: Incision, blade: Blade, frame: Floats, name: str) -> Incision:
    """Return an incision whose edge is the front of the present cut ahead of a blade outside the body."""
    state, cloud = body.cut_state, body.cloud
    ahead = _point_directions(blade, frame, cloud.spacing)
    longest = np.linalg.norm(incision.edge[:, None] - cloud.points[None], axis=2).max() + MOUTH_DISTANCE * cloud.spacing
    ways = np.arange(0.0, longest, SEARCH_STEP * cloud.spacing)
    samples = incision.edge[:, None] + ways[:, None] * ahead[:, None]
    places, distance, over = project_on_cut(state, samples.reshape(-1, 3))
    in_cut = (over & (distance < MOUTH_DISTANCE * cloud.spacing)).reshape(len(ahead), -1)
    has_front = in_cut.any(axis=1)
    if not has_front.any():
        raise InputError(
            f"model of a blunt Blade must have a cut ahead of the edge of Contact {name!r}, got none; "
            "make one with palpate.cut"
        )
    last = in_cut.shape[1] - 1 - in_cut[:, ::-1].argmax(axis=1)
    front = places.reshape(samples.shape)[np.arange(len(ahead)), last]
    with_front = np.flatnonzero(has_front)
    for k in np.flatnonzero(~has_front):  # beyond the sides of the cut: next to the nearest point of the front
        near = with_front[np.abs(with_front - k).argmin()]
        front[k] = front[near] + (incision.edge[k] - incision.edge[near])
    return replace(incision, edge=front)


def energy_release(body: Any, state: State, front: Floats, ahead: Floats) -> float:
    """Return the energy [J/m^2] that a front releases per area; 0 for one outside the body.

    Parameters
    ----------
    front : (p, 3) array [m]
        Points of the front in the stress-free body.
    ahead : (p, 3) array
        Unit vectors in which they advance.
    """
    cloud, u = body.cloud, state.coordinates
    length = length_inside(body.cut_state, front, cloud.points[cloud.triangles])
    if not length > 0:
        return 0.0
    reach = RELEASE_REACH * cloud.spacing
    way, square = np.diff(front, axis=0), np.sum(np.diff(front, axis=0) ** 2, axis=1)
    offsets = cloud.points[:, None] - front[None, :-1]
    shares = np.clip(np.einsum("nkc,kc->nk", offsets, way) / np.maximum(square, 1e-30), 0.0, 1.0)
    offsets -= shares[:, :, None] * way
    distance = np.linalg.norm(offsets, axis=2)
    piece, rows = distance.argmin(axis=1), np.arange(len(cloud.points))
    distance, offsets, shares = distance[rows, piece], offsets[rows, piece], shares[rows, piece, None]
    ratio = np.minimum(distance / reach, 1.0)
    slope = -6.0 * ratio * (1.0 - ratio) / (reach * np.maximum(distance, 1e-30))
    direction = (1.0 - shares) * ahead[piece] + shares * ahead[piece + 1]
    result = body.evaluate(u, state.history)
    gradient = body.deformation_gradient(u) - np.eye(3)
    flow = np.einsum("nij,nik,nk->nj", result.stress, gradient, direction)
    flow -= result.energy_density[:, None] * direction
    return float(np.sum(body.volumes * slope * np.sum(flow * offsets, axis=1)) / length)


def run_front(
    body: Any, state: State, blade: Blade, frame: Floats, check: Any, name: str
) -> tuple[Any, Incision, float]:
    """Return the body in which the front ahead of a blunt blade has advanced, the incision, and the release [J].

    `check` is called with the triangles (t, 3, 3) [m] of every cut.
    """
    assert state.incision is not None
    incision: Incision = state.incision
    cloud, u = body.cloud, state.coordinates
    spacing, corners = cloud.spacing, cloud.points[cloud.triangles]
    ahead = _point_directions(blade, frame, spacing)
    rate = energy_release(body, state, incision.edge, ahead)
    incision = replace(incision, release_rate=rate)
    if not (rate >= blade.toughness and rate > 0.0):
        _check_edge(body, u, incision, blade, frame, name)
        return body, incision, 0.0
    energy, trial, after = body.strain_energy(u, state.history), body, incision
    total, area, released = 0.0, 0.0, -np.inf
    for _ in range(round(LARGEST_ADVANCE / FRONT_ADVANCE)):
        edge = after.edge + FRONT_ADVANCE * spacing * ahead
        pieces = _near_pieces(trial, after.edge, edge)
        new_area = area_inside(body.cut_state, np.stack([after.edge, edge]), pieces, corners)
        if not new_area > 0:
            break
        strip, triangles, replaced = next_strip(after.strip, after.edge, edge, pieces, spacing)
        lost = 0.0
        if len(triangles):
            check(triangles)
            trial = cut_from(trial, len(trial.cut_surface.triangles) - replaced, triangles)
            before, energy = energy, trial.strain_energy(u, state.history)
            lost = before - energy
        after = replace(after_cut(after, edge, strip, new_area, lost, spacing), release_rate=rate)
        total, area = total + lost, area + new_area
        if total >= min(released, 0.0):  # else it makes energy, or more than a shorter advance
            body, incision, released = trial, after, total
        if 0.0 <= total < blade.toughness * area:
            break
    return body, incision, float(released) if np.isfinite(released) else 0.0


def _check_edge(body: Any, u: Floats, incision: Incision, blade: Blade, frame: Floats, name: str) -> None:
    """Raise `DivergenceError` for an edge that reaches the front."""
    state, spacing = body.cut_state, body.cloud.spacing
    ahead = _point_directions(blade, frame, spacing)
    front, edge = incision.edge, points_in_space(frame, edge_points(blade, spacing))
    weights = point_weights(state.uncut, state.surface, front, front + SIGHT_DISTANCE * spacing * ahead)
    way = edge - front - np.einsum("pk,pkc->pc", weights.values, u[weights.nodes])
    inside = np.asarray(state.uncut.tree.query(front)[0]) < spacing
    near = inside & (np.linalg.norm(way, axis=1) < NEAR_BODY * spacing)
    if np.any(near & (np.sum(way * ahead, axis=1) > 0)):
        raise DivergenceError(
            f"edge of Contact {name!r} must stay behind the front of the cut, got an edge at it, as its energy "
            f"release is {incision.release_rate:.3g} of {blade.toughness:g} J/m^2; use a thicker wedge, or sharp=True"
        )


def _near_pieces(body: Any, before: Floats, after: Floats) -> NDArray[np.bool_]:
    """Return the pieces (p - 1,) of a front that are near the body."""
    distance = np.asarray(body.cut_state.uncut.tree.query(np.concatenate([before, after]))[0]).reshape(2, -1)
    near = distance.min(axis=0) < NEAR_BODY * body.cloud.spacing
    return np.asarray(near[:-1] | near[1:])
