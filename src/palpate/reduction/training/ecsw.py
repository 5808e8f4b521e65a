"""Choice of the cubature points among those of a body's energy, by forces and moments at training states."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.nodal.energy_model import EnergyModel, Fields
from palpate.reduction.hyper.cubature import Cubature, fit_moments, sketch, sparse_nnls
from palpate.reduction.hyper.material_point import MIN_VOLUME_RATIO
from palpate.tissue.materials import Material
from palpate.tissue.volumetric import QUADRATIC, volumetric_form

BALANCED_SHARE = 1e-9  # relative size of a sum of forces that counts as zero, as in a taut sheet at rest
REACTION_WEIGHT = 0.1  # of the forces on tools and supports, relative to those on all coordinates
MAX_ROWS, MAX_ENTRIES = 12_000, 150_000_000  # of the least-squares problem for the weights; more rows are sketched
SLOPE_STATES = 60  # training states for the fit of the moments' slopes
BLOCK_NODES = 4096  # nodes per block
RIGID_BODY_SHIFT = 1e-12  # least squared frequency, relative to the highest, for bodies without supports


def choose_cubature_points(
    body: EnergyModel, fields: Fields, modes: int, states: Floats, mass: Floats, share: float,
    moments: Floats, seed: int,
) -> tuple[NDArray[np.int64], Cubature]:  # fmt: skip
    """Return places of the chosen points in the fields, and the cubature with their weights and moments.

    The fields are those of modes, lifting functions and the supports' test fields. The training states (t, m) are
    coordinates of modes and lifting functions, the mass matrix is (m, m), and the moments are (k, n). `share` is the
    largest relative error of the sampled forces; 0 selects every point.
    """
    count = len(mass)
    root = compliance_root(body, fields, count, moments, mass)
    if share == 0.0:
        if not len(moments):  # a membrane has several points per node
            moments = np.zeros((0, len(fields.nodes)))
        return np.arange(len(fields.nodes)), Cubature(fields.nodes, fields.volumes, moments, 0.0)
    rows = _rows(body, fields, modes, states, root, np.random.default_rng(seed))
    multiples, residual = sparse_nnls(rows, rows.sum(axis=1), share)
    chosen = np.flatnonzero(multiples > 0)
    gradients = fields.gradients[:, :count]
    pressure = np.zeros((0, len(chosen)))
    if len(moments):
        pressure = _pressure(body.material, gradients, states, moments, chosen, root)
    return chosen, Cubature(fields.nodes[chosen], multiples[chosen] * fields.volumes[chosen], pressure, residual)


def _rows(
    body: EnergyModel,
    fields: Fields,
    modes: int,
    states: Floats,
    root: Floats,
    generator: np.random.Generator,
) -> Floats:
    """Return the contributions (r, p) of every point to the forces at all states.

    The rows are forces in the compliance norm, and forces on tools and supports. The latter have rows of
    their own, because the compliance norm gives little weight to the force on a stiff basis vector.
    """
    count = len(root)
    most = max(1, min(count, min(MAX_ROWS, MAX_ENTRIES // len(fields.nodes)) // len(states)))
    weighted_forces: list[Floats] = []
    reactions: list[Floats] = []
    for state in states:
        work = _shear_work(body, fields, state)
        weighted = sketch(most, count, generator) @ root @ work[:count]
        for rows, into in ((weighted, weighted_forces), (work[modes:], reactions)):
            size = float(np.linalg.norm(rows.sum(axis=1)))
            if size > BALANCED_SHARE * float(np.linalg.norm(rows, axis=0).sum()):
                into.append(rows / np.sqrt(size))
    blocks = [np.concatenate(rows) for rows in (weighted_forces, reactions) if rows]
    if not blocks:
        raise InputError("trajectories must deform the body, got rest or rigid motions only; train on other runs")
    sizes = [float(np.linalg.norm(rows.sum(axis=1))) for rows in blocks]
    if len(blocks) == 2:
        blocks[1] *= REACTION_WEIGHT * sizes[0] / sizes[1]
    return np.concatenate(blocks)


def deformation(gradients: Floats, state: Floats) -> tuple[Floats, Floats, Floats]:
    """Return F, cof(F) and J at points with derivatives (p, m, 9) of the basis vectors."""
    F = np.eye(3) + np.einsum("nmk,m->nk", gradients, state.astype(gradients.dtype)).astype(float).reshape(-1, 3, 3)
    cofactor = np.stack([np.cross(F[:, 1], F[:, 2]), np.cross(F[:, 2], F[:, 0]), np.cross(F[:, 0], F[:, 1])], axis=1)
    return F, cofactor, np.sum(F[:, 0] * cofactor[:, 0], axis=1)


def shear_stress(body: EnergyModel, fields: Fields, state: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the shear stress (p, 3, 3) at every point, times its volume [N m], cof(F) and J."""
    F, cofactor, J = deformation(fields.gradients[:, : len(state)], state)
    return body.shear_stress(F, fields.nodes) * fields.volumes[:, None, None], cofactor, J


def volume_measure(material: Material, x: Floats) -> tuple[Floats, Floats]:
    """Return g and g' of many points' x = J - 1, as `MaterialPoint.measure`."""
    if material.volumetric == QUADRATIC:
        return x, np.ones_like(x)
    value, slope = volumetric_form(material.volumetric).measure(np.maximum(x, MIN_VOLUME_RATIO - 1.0))
    return value + slope * np.minimum(x - (MIN_VOLUME_RATIO - 1.0), 0.0), slope


def _shear_work(body: EnergyModel, fields: Fields, state: Floats) -> Floats:
    """Return the work (m, p) of every point's shear stress, times its volume, on the trial and test basis."""
    gradients = fields.gradients
    weighted = shear_stress(body, fields, state)[0].reshape(-1, 9).astype(gradients.dtype)
    return np.asarray(np.matmul(gradients, weighted[:, :, None])[:, :, 0].T, dtype=float)


def compliance_root(body: EnergyModel, fields: Fields, count: int, moments: Floats, mass: Floats) -> Floats:
    """Return R for which R^T R is the compliance of the body at rest in the coordinates.

    For a membrane it is that of the taut state.
    """
    stiffness, gradients = fields.constant[:count, :count].copy(), fields.gradients[:, :count]
    shear, second = body.rest_moduli
    for start in range(0, len(gradients), BLOCK_NODES):
        block = gradients[start : start + BLOCK_NODES].astype(float).reshape(-1, count, 3, 3)
        roots, nodes = np.sqrt(fields.volumes[start : start + BLOCK_NODES]), fields.nodes[start : start + BLOCK_NODES]
        strain = body.kinematics.rest_strain(block)
        rows = (strain.reshape(-1, count, 9) * roots[:, None, None]).transpose(0, 2, 1).reshape(-1, count)
        slopes = np.trace(block, axis1=2, axis2=3) * roots[:, None]
        stiffness += 0.5 * rows.T @ (np.repeat(shear[nodes], 9)[:, None] * rows)
        stiffness += slopes.T @ (second[nodes, None] * slopes)
    if len(moments):
        slopes = moments @ (gradients[:, :, 0] + gradients[:, :, 4] + gradients[:, :, 8])
        stiffness += slopes.T @ slopes
    values, vectors = scipy.linalg.eigh(0.5 * (stiffness + stiffness.T), mass)
    return np.asarray((vectors / np.sqrt(np.maximum(values, RIGID_BODY_SHIFT * np.abs(values).max()))).T)


def _pressure(
    material: Material, gradients: Floats, states: Floats, moments: Floats, nodes: NDArray[np.int64], root: Floats
) -> Floats:
    """Fit the coefficients (k, s) of the sampled dilatations to the moments and their slopes."""
    sampled, summed, stiff = [], [], np.linalg.inv(root).T
    for state in (np.zeros(states.shape[1]), *states[:: max(1, len(states) // SLOPE_STATES)]):
        _, cofactor, J = deformation(gradients, state)
        volume, rise = volume_measure(material, J - 1)
        cofactor *= rise[:, None, None]
        slope = np.matmul(gradients, cofactor.reshape(-1, 9, 1).astype(gradients.dtype))[:, :, 0] @ root.T
        value = volume[:, None] / max(float(np.linalg.norm(stiff @ state)), 1e-300)
        both = np.hstack([slope, value if state.any() else 0 * value])
        sampled.append(both[nodes])
        summed.append(moments @ both)
    return fit_moments(np.hstack(sampled), np.hstack(summed))
