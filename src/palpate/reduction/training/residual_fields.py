"""Witnesses: test fields that a reduced body cannot move in, at which its equations of motion need not hold.

The reduced equations balance the forces on the kept coordinates exactly. What is left of

    r = m_w a'' - f_w(a + beta a') - g_w(t)

on other fields w, the imbalance, is what the kept ones cannot hold: were the body free to move in these shapes too, it
would go by about (K^-1)_w r, K the stiffness at rest over modes and witnesses together. The witnesses are the next
modes of strain behind the kept ones, and combined such that |r| is the root mean square of that displacement [m].

The force f_w is sampled at the nodes that were chosen for the kept columns. There it is a small difference of large
terms, and the weights are not good enough for it. But f_w is no part of an energy and may have weights of its own:
each witness has a factor at every sampled node, fitted to the forces from all nodes at the training states.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.solid.model import Solid
from palpate.reduction.hyper.cubature import Cubature
from palpate.reduction.hyper.material_point import volume_measure
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.ecsw import Fields, compliance_root, deformation

__all__ = ["RESIDUAL_FIELDS", "apart", "scale_residual_fields", "typical_residual"]


RESIDUAL_FIELDS = 8
DEPENDENT = 1e-3  # share of a field that has to be left when the modes are taken from it
RIDGE = 1e-3  # of the largest singular value, for the factors
SMALLEST = 1e-3  # of the largest force: the size below which a state counts less
USUAL = 0.95


def apart(body: Solid | Membrane, shapes: Floats, fields: Floats) -> Floats:
    """Return what fields (w, n, 3) have beside shapes (m, n, 3), orthonormal in the volumes; at most w fields.

    The shapes are orthonormal in the volumes.
    """
    if not len(fields):
        return fields
    weights = np.repeat(np.sqrt(body.volumes), 3)
    kept, rows = shapes.reshape(len(shapes), -1) * weights, fields.reshape(len(fields), -1) * weights
    for _ in range(2):  # once more, for rounding
        rows = rows - (rows @ kept.T) @ kept
    _, sizes, rows = np.linalg.svd(rows, full_matrices=False)
    return np.asarray((rows[sizes > DEPENDENT] / weights).reshape(-1, *fields.shape[1:]))


def scale_residual_fields(
    body: Solid | Membrane, fields: Fields, sizes: tuple[int, int, int], states: Floats, rule: Cubature,
    places: NDArray[np.int64], moments: Floats,
) -> tuple[Fields, Floats]:  # fmt: skip
    """Combine the witnesses such that an imbalance is a displacement, and find their derivatives at the samples.

    Parameters
    ----------
    body : Solid or Membrane
        A membrane has no witnesses.
    fields : Fields
        Of all columns, the witnesses last.
    sizes : tuple
        Numbers of modes, of coordinates, and of witnesses w.
    states : (t, m + l) array
        Training states.
    rule : Cubature
    places : (s,) int array
        Of the sampled points in the fields.
    moments : (k, n) array
        Of the dilatation, see `palpate.reduction.training.ecsw.pressure_moments`.

    Returns
    -------
    fields : Fields
        The witnesses' columns in m/N.
    gradients : (s, m + l + 3 g + w, 9) array
        Derivatives of all columns at the samples, those of the witnesses times their factors.
    """
    modes, count, residual_fields = sizes
    gradients = np.asarray(fields.gradients[places], dtype=float)
    if not residual_fields or isinstance(body, Membrane):
        return fields, gradients
    multiples = _factors(body, fields, count, residual_fields, states, rule, moments)
    scale, first = _scale(body, fields, modes, residual_fields, moments), len(fields.columns) - residual_fields
    own = np.einsum("vw,swk->svk", scale, multiples[:, :, None] * gradients[:, first:])
    columns, mixed = fields.columns.copy(), np.eye(len(fields.columns))
    columns[first:] = np.tensordot(scale, fields.columns[first:], 1).astype(np.float32)
    mixed[first:, first:] = scale
    gradients[:, first:] = own
    return replace(fields, columns=columns, constant=mixed @ fields.constant @ mixed.T), gradients


def _scale(body: Solid, fields: Fields, modes: int, residual_fields: int, moments: Floats) -> Floats:
    """Return A (w, w) [m/N] with |A r| the displacement [m] that an imbalance r of the witnesses would make."""
    own = fields.of(np.r_[:modes, len(fields.columns) - residual_fields : len(fields.columns)])
    flat = own.columns.reshape(len(own.columns), -1)
    mass = (flat * np.repeat(body.masses, 3)) @ flat.T
    root = compliance_root(body, own, len(own.columns), moments, mass)
    response = root.T @ root[:, -residual_fields:]
    return np.linalg.cholesky(response.T @ mass @ response / body.masses.sum()).T


@dataclass(frozen=True)
class _Rule:
    """How stresses are weighed: at some nodes, with weights (s,) [m^3] and coefficients (k, s) of the moments."""

    nodes: NDArray[np.int64]
    gradients: Floats
    weights: Floats
    pressure: Floats

    def work(self, body: Solid, count: int, residual_fields: int, state: Floats) -> Floats:
        """Work (s, w) of the nodes' stresses on the witnesses, which are the last columns."""
        F, cofactor, J = deformation(self.gradients[:, :count], state)
        stress = body.shear_stress(F, self.nodes)
        measure, slope = volume_measure(body.material, J - 1)
        pressure = slope * (self.pressure.T @ (self.pressure @ measure))
        whole = self.weights[:, None, None] * stress + pressure[:, None, None] * cofactor
        return np.asarray(np.matmul(self.gradients[:, -residual_fields:], whole.reshape(-1, 9, 1))[:, :, 0])


def _factors(
    body: Solid, fields: Fields, count: int, residual_fields: int, states: Floats, rule: Cubature, moments: Floats
) -> Floats:
    """Return factors (s, w) of the witnesses' derivatives at the sampled nodes."""
    few = _Rule(rule.nodes, np.asarray(fields.gradients[rule.nodes], dtype=float), rule.weights, rule.pressure)
    every = _Rule(fields.nodes, fields.gradients, body.elastic_volumes, moments)
    terms = np.array([few.work(body, count, residual_fields, state) for state in states])
    whole = np.array([every.work(body, count, residual_fields, state).sum(axis=0) for state in states])
    sizes = np.linalg.norm(whole, axis=1)
    scale = 1 / np.sqrt(np.maximum(sizes, max(SMALLEST * sizes.max(), 1e-300)))
    result = np.ones((len(rule.nodes), residual_fields))
    for w in range(residual_fields):
        u, values, vt = np.linalg.svd(terms[:, :, w] * scale[:, None], full_matrices=False)
        damped = values / (values**2 + max((RIDGE * values[0]) ** 2, 1e-300))
        result[:, w] += vt.T @ (damped * (u.T @ ((whole[:, w] - terms[:, :, w].sum(axis=1)) * scale)))
    return result


def typical_residual(model: ReducedModel, body: Solid | Membrane, displacements: Iterable[Floats]) -> float:
    """Return the imbalance [m] that the model has at most training states, as far as one can tell without the loads.

    It is what the forces on the witnesses change by when displacements (n, 3) of the full body are projected on the
    coordinates: the loads are the same, and the difference of the accelerations is left out.
    """
    residual_fields, found = model.data.basis_vectors[len(model.data.basis_vectors) - model.data.residual_fields :], []
    body._restore_history(None)
    for u in displacements:
        state = model.project(u[None])[0]
        whole = np.tensordot(residual_fields, body.force(u) * body.volumes[:, None], 2)
        found.append(
            np.linalg.norm(whole - model.forces(state)[len(model.data.basis_vectors) - len(residual_fields) :])
        )
    usual = float(np.quantile(found, USUAL))
    return usual if usual > 0 else 1.0
