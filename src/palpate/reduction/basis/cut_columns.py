"""Columns of a cut: the static responses by which a cut body differs from the uncut one.

Loads that deform the uncut body by q deform the cut one by q + d at rest,

    d = K1^-1 (K0 - K1) q,

with the stiffness K0 of the body and K1 of the cut one. The states q are combined first to a few, the main ones for the
work of the forces (K0 - K1) q on the uncut body's response to them.

The halves of an open cut turn, and their displacements are quadratic in the loads. So the main shapes w of q + d have
second-order responses, as `palpate.modal_derivatives`:

    K1 w_ij = second derivative of the internal forces along w_i and w_j.

Conjugate gradients solve the equations, preconditioned by a factor of K0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import CloudError
from palpate.reduction.basis.linear_modes import RestStatics

__all__ = ["StaticChanges", "static_changes"]


DIFFERENCE_STEP = 1e-4  # displacements for differences of forces, in spacings
RESIDUAL_TOLERANCE = 1e-3  # of the forces that are left, relative
MAX_ITERATIONS = 200
SECOND_STEP = 0.02  # displacements for second differences, in spacings
MAIN_SHAPES, MIN_SHAPE = 4, 0.01  # most shapes with second-order responses, and their least size over the first


class StaticChanges(NamedTuple):
    """Static changes that a cut causes in states.

    Parameters
    ----------
    linear : (t, n, 3) array
        d of all states.
    quadratic : (t, n, 3) array
        Second-order responses of all states.
    columns : (p, n, 3) array
        The second-order responses of pairs of shapes.
    """

    linear: Floats
    quadratic: Floats
    columns: Floats


def static_changes(
    bodies: tuple[EnergySolid, EnergySolid], statics: RestStatics, fields: Floats, states: Floats, count: int
) -> StaticChanges:
    """Return the static changes of states, of rank `count` at rest.

    Parameters
    ----------
    bodies : tuple of EnergySolid
        The uncut body and the cut one.
    statics : RestStatics
        Of the uncut body.
    fields : (m, n, 3) array
        Displacement fields of the coordinates.
    states : (t, m) array
        Coordinates of states.
    """
    body, cut_body = bodies
    free, shape = statics.free, fields.shape[1:]
    right = (_stiffness_times(body, fields) - _stiffness_times(cut_body, fields)).reshape(len(fields), -1) @ free
    energies = right @ statics.solve(np.ascontiguousarray(right.T))
    values, vectors = np.linalg.eigh(0.5 * (energies + energies.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    combined = np.linalg.svd(states @ root, full_matrices=False)[0][:, :count]
    main = _solve(cut_body, statics, (combined.T @ states) @ right)
    linear = np.tensordot(combined, (main @ free.T).reshape(-1, *shape), 1)
    responses = np.tensordot(states, fields, 1) + linear
    amplitudes, columns = _second_order(cut_body, statics, responses)
    quadratic = np.tensordot(amplitudes, columns, 1)
    return StaticChanges(linear, quadratic, columns)


def _second_order(cut_body: EnergySolid, statics: RestStatics, responses: Floats) -> tuple[Floats, Floats]:
    """Return amplitudes (t, p) and second-order responses (p, n, 3) of pairs of the main shapes of (t, n, 3)."""
    weights = np.sqrt(cut_body.volumes)[:, None]
    left, sizes, rows = np.linalg.svd((responses * weights).reshape(len(responses), -1), full_matrices=False)
    kept = min(MAIN_SHAPES, int(np.sum(sizes > MIN_SHAPE * sizes[0])))
    shapes = rows[:kept].reshape(kept, *responses.shape[1:]) / weights
    scale = np.abs(shapes).max(axis=(1, 2))
    shapes, coordinates = shapes / scale[:, None, None], left[:, :kept] * sizes[:kept] * scale
    step, work = SECOND_STEP * cut_body.cloud.spacing, cut_body.workspace()
    forces, amplitudes = [], []
    for i in range(kept):
        for j in range(i + 1):
            plus, minus = step * (shapes[i] + shapes[j]), step * (shapes[i] - shapes[j])
            even = [_forces(cut_body, u, work) + _forces(cut_body, -u, work) for u in (plus, minus)]
            forces.append((even[0] - even[1]) / (4 * step**2))
            amplitudes.append(coordinates[:, i] * coordinates[:, j] * (0.5 if i == j else 1.0))
    right = np.array(forces).reshape(len(forces), -1) @ statics.free
    solution = _solve(cut_body, statics, right) @ statics.free.T
    return np.array(amplitudes).T, solution.reshape(len(forces), *responses.shape[1:])


def _solve(cut_body: EnergySolid, statics: RestStatics, right: Floats) -> Floats:
    """Return the free displacements (k, f) of a cut body at rest under forces (k, f)."""
    free, shape = statics.free, (len(right), len(cut_body.cloud), 3)
    solution, residual, sizes = np.zeros_like(right), right.copy(), np.linalg.norm(right, axis=1)
    direction, product = np.zeros_like(right), np.ones(len(right))
    for iteration in range(MAX_ITERATIONS):
        if not np.any(np.linalg.norm(residual, axis=1) > RESIDUAL_TOLERANCE * sizes):
            return solution
        preconditioned, before = statics.solve(np.ascontiguousarray(residual.T)).T, product
        product = np.sum(residual * preconditioned, axis=1)
        direction = preconditioned + (product / np.maximum(before, 1e-300) * bool(iteration))[:, None] * direction
        fields = (direction @ free.T).reshape(shape)
        moved = _stiffness_times(cut_body, fields).reshape(len(right), -1) @ free
        step = (product / np.maximum(np.sum(direction * moved, axis=1), 1e-300))[:, None]
        solution, residual = solution + step * direction, residual - step * moved
    raise CloudError(
        "triangles of the cut must leave the body in one supported piece, got one without a static response; "
        "end the cut inside the body"
    )


def _forces(body: EnergySolid, displacements: Floats, work: Any) -> Floats:
    """Return the internal nodal forces (n, 3) [N]."""
    return np.asarray(body.force(displacements, work=work) * body.volumes[:, None])


def _stiffness_times(body: EnergySolid, fields: Floats) -> Floats:
    """Return the stiffness at rest [N/m] times fields (k, n, 3), by differences of forces."""
    work, result = body.workspace(), np.empty_like(fields)
    for field, row in zip(fields, result, strict=True):
        step = DIFFERENCE_STEP * body.cloud.spacing / max(float(np.abs(field).max()), 1e-300)
        row[:] = (_forces(body, -step * field, work) - _forces(body, step * field, work)) / (2 * step)
    return result
