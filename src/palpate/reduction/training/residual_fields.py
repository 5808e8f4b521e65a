"""Residual fields: test fields outside the reduced basis, for the residual of the equations of motion.

The reduced equations balance the forces on the coordinates exactly. The residual on other fields w,

    r = m_w a'' - f_w(a + beta a') - g_w(t),

is not balanced. If the body could also move in these fields, it would move by about (K^-1)_w r, with K
the stiffness at rest over modes and residual fields together. The residual fields are the next strain
modes after those of the basis, combined so that |r| is the root mean square of that displacement [m].

The force f_w is sampled at the cubature points of the reduced model. It is a small difference of
large terms there, for which the weights of the cubature are not accurate enough. But f_w does not
belong to an energy and may have weights of its own. Each residual field has a factor at every
cubature point, fitted to the forces from all nodes at the training states.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.nodal.energy_model import EnergyModel, Fields
from palpate.reduction.hyper.cubature import Cubature
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.ecsw import compliance_root, shear_stress, volume_measure

RESIDUAL_FIELDS = 8
MIN_INDEPENDENT = 1e-3  # least norm of a field without its modal part, relative
RIDGE_SHARE = 1e-3  # of the largest singular value of the changes from rest, for the factors
MIN_SIZE = 1e-3  # of the largest force, below which a state has reduced weight
TYPICAL_SHARE = 0.95  # of the training states
MIN_SCALE = 0.05  # least residual norm at which the error indicator is 1, over the largest displacement in training


def orthogonal_complement(body: EnergyModel, shapes: Floats, fields: Floats) -> Floats:
    """Return the parts of fields (w, n, 3) orthogonal to shapes (m, n, 3); at most w orthonormal fields.

    The shapes are orthonormal. The inner product has the nodal volumes as weights.
    """
    if not len(fields):
        return fields
    weights = np.repeat(np.sqrt(body.volumes), 3)
    base, rows = shapes.reshape(len(shapes), -1) * weights, fields.reshape(len(fields), -1) * weights
    for _ in range(2):  # twice, because of rounding
        rows = rows - (rows @ base.T) @ base
    _, sizes, rows = np.linalg.svd(rows, full_matrices=False)
    return np.asarray((rows[sizes > MIN_INDEPENDENT] / weights).reshape(-1, *fields.shape[1:]))


def scale_residual_fields(
    body: EnergyModel, fields: Fields, sizes: tuple[int, int], states: Floats, rule: Cubature,
    places: NDArray[np.int64], moments: Floats,
) -> tuple[Fields, Floats]:  # fmt: skip
    """Combine the residual fields so that the residual is a displacement, and return their derivatives.

    The residual fields are the last of `fields`, which are the trial and test basis; `sizes` are the numbers of modes
    and of residual fields w. The training states are (t, m + l). `places` (s,) are those of the cubature points in the
    fields. The moments (k, n) are of the dilatation; see
    `palpate.dynamics.nodal.energy_model.EnergyModel.pressure_moments`.

    Returns the fields, with the residual fields in m/N, and derivatives (s, m + l + 3 g + w, 9) of the trial and test
    basis at the cubature points. Those of the residual fields are multiplied by their factors.
    """
    modes, residual_fields = sizes
    gradients = np.asarray(fields.gradients[places], dtype=float)
    if not residual_fields:
        return fields, gradients
    multiples = _factors(body, fields, residual_fields, states, rule, places, moments)
    scale, first = _scale(body, fields, modes, residual_fields, moments), len(fields.columns) - residual_fields
    scaled = np.einsum("vw,swk->svk", scale, multiples[:, :, None] * gradients[:, first:])
    columns, mixed = fields.columns.copy(), np.eye(len(fields.columns))
    columns[first:] = np.tensordot(scale, fields.columns[first:], 1).astype(np.float32)
    mixed[first:, first:] = scale
    gradients[:, first:] = scaled
    return replace(fields, columns=columns, constant=mixed @ fields.constant @ mixed.T), gradients


def _scale(body: EnergyModel, fields: Fields, modes: int, residual_fields: int, moments: Floats) -> Floats:
    """Return A (w, w) [m/N] for which |A r| is the displacement [m] caused by a residual r."""
    residual_part = fields.of(np.r_[:modes, len(fields.columns) - residual_fields : len(fields.columns)])
    flat = residual_part.columns.reshape(len(residual_part.columns), -1)
    mass = (flat * np.repeat(body.masses, 3)) @ flat.T
    root = compliance_root(body, residual_part, len(residual_part.columns), moments, mass)
    response = root.T @ root[:, -residual_fields:]
    return _triangular_root(response.T @ mass @ response / body.masses.sum())


def _triangular_root(square: Floats) -> Floats:
    """Return the upper triangular A with A^T A equal to a positive semidefinite matrix.

    It is the transposed Cholesky factor. Fields of very different stiffness make the matrix singular
    to rounding, for which the Cholesky factorisation fails.
    """
    values, vectors = np.linalg.eigh(square)
    root = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T, mode="r")
    return np.asarray(root * np.where(np.diagonal(root) < 0, -1.0, 1.0)[:, None])


def _work(body: EnergyModel, fields: Fields, pressure: Floats, residual_fields: int, state: Floats) -> Floats:
    """Return the work (p, w) of the stresses at points on the residual fields, the last basis vectors.

    `pressure` are the coefficients (k, p) of the points in the moments of the dilatation.
    """
    stress, cofactor, J = shear_stress(body, fields, state)
    if len(pressure):
        measure, slope = volume_measure(body.material, J - 1)
        stress += (slope * (pressure.T @ (pressure @ measure)))[:, None, None] * cofactor
    return np.asarray(np.matmul(fields.gradients[:, -residual_fields:], stress.reshape(-1, 9, 1))[:, :, 0])


def _factors(
    body: EnergyModel, fields: Fields, residual_fields: int, states: Floats, rule: Cubature,
    places: NDArray[np.int64], moments: Floats,
) -> Floats:  # fmt: skip
    """Return factors (s, w) on the residual fields' derivatives at the cubature points."""
    sampled = replace(fields, gradients=fields.gradients[places].astype(float), nodes=rule.nodes, volumes=rule.weights)
    terms = np.array([_work(body, sampled, rule.pressure, residual_fields, state) for state in states])
    at_rest = _work(body, sampled, rule.pressure, residual_fields, np.zeros_like(states[0]))
    full_work = np.array([_work(body, fields, moments, residual_fields, state).sum(axis=0) for state in states])
    defined = np.isfinite(terms).all(axis=(1, 2)) & np.isfinite(full_work).all(axis=1)  # states without inverted nodes
    if not defined.any():
        raise InputError("trajectories must keep all volumes positive, got none that does; train on smaller loads")
    terms, full_work = terms[defined], full_work[defined]
    sizes = np.linalg.norm(full_work, axis=1)
    scale = 1 / np.sqrt(np.maximum(sizes, max(MIN_SIZE * sizes.max(), 1e-300)))
    result = np.ones((len(rule.nodes), residual_fields))
    for w in range(residual_fields):
        u, values, vt = np.linalg.svd(terms[:, :, w] * scale[:, None], full_matrices=False)
        largest = np.linalg.norm((terms[:, :, w] - at_rest[:, w]) * scale[:, None], 2)
        damped = values / (values**2 + max((RIDGE_SHARE * largest) ** 2, 1e-300))
        result[:, w] += vt.T @ (damped * (u.T @ ((full_work[:, w] - terms[:, :, w].sum(axis=1)) * scale)))
    return result


def typical_residual(model: ReducedModel, body: EnergyModel, displacements: Iterable[Floats]) -> float:
    """Return the residual norm [m] that most training states do not exceed, without regard to loads.

    It is the change of the forces on the residual fields when displacements (n, 3) of the full body are
    projected on the coordinates. The loads are the same, and the difference of the accelerations is
    neglected. As the norm is about the displacement that the coordinates miss, the result is at least 5 %
    of the largest displacement in training, root mean squares over the body.
    """
    basis, norms, largest = model.data.basis, [], 0.0
    first = len(basis.vectors) - basis.residual_fields
    residual_fields = basis.vectors[first:]
    for u in displacements:
        state = model.body.project(u[None])[0]
        full_work = np.tensordot(residual_fields, body.force(u) * body.volumes[:, None], 2)
        norms.append(np.linalg.norm(full_work - model.body.all_forces(state)[first:]))
        largest = max(largest, float(np.sqrt(np.average(np.sum(u**2, axis=1), weights=body.volumes))))
    typical = max(float(np.quantile(norms, TYPICAL_SHARE)), MIN_SCALE * largest)
    return typical if typical > 0 else 1.0
