"""What the samples are chosen from, and how: derivatives at all nodes, forces at the training states, moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from palpate.dynamics.full import FullModel
from palpate.reduction.cubature import Cubature, non_negative, sketch, slopes_fit

__all__ = ["Fields", "choose_samples", "compliance_root", "deformation", "differentiated", "pressure_moments"]

Floats = NDArray[np.float64]

STATES = 240  # training states that pressures are taken from
ROWS, ENTRIES = 12_000, 150_000_000  # of the least-squares problem for the weights; more rows are sketched
SLOPES = 60  # training states at which the moments' slopes are fitted
BLOCK = 4096  # nodes at a time
SMALLEST = 1e-3  # of the largest pressure: the size below which one counts less
LIGHT = 1e-12  # of the highest squared frequency: what keeps a body without supports regular


@dataclass(frozen=True)
class Fields:
    """The columns, and what they do at the nodes of the energy form.

    Parameters
    ----------
    columns : (m, n, 3) array
    gradients : (n, m, 9) array
        Their derivatives; of single precision where there are many.
    constant : (m, m) array
        Stiffness of what the stencils miss of them.
    """

    columns: Floats
    gradients: Floats
    constant: Floats


def differentiated(body: FullModel, columns: Floats) -> Fields:
    """Differentiate columns (m, n, 3) at all nodes."""
    blocks, lanes = body.body.lanes.nodes.shape
    n, count = len(body.cloud), len(columns)
    type_ = np.float64 if n * count < 2_000_000 else np.float32
    gradients, misses = np.empty((n, count, 9), dtype=type_), np.empty((count, 3 * n), dtype=type_)
    table = np.zeros((blocks, 1, 12, lanes))
    for m in range(count):
        body.formulation.differentiate(np.ascontiguousarray(columns[m : m + 1]), body.body, body.work, table)
        by_node = table[:, 0].transpose(0, 2, 1).reshape(-1, 12)[body.slot]
        gradients[:, m] = by_node[:, :9]
        misses[m] = by_node[:, 9:].reshape(-1) * np.repeat(np.sqrt(body.volumes), 3)
    constant = np.asarray(misses @ misses.T, dtype=float) * body.body.hourglass
    return Fields(columns, gradients, constant)


def choose_samples(
    body: FullModel, fields: Fields, count: int, states: Floats, mass: Floats, share: float, moments: Floats, seed: int
) -> Cubature:
    """Choose nodes, weights, and the coefficients of the moments."""
    own = fields.gradients[:, :count]
    root = compliance_root(body, own, fields.constant[:count, :count], moments, mass)
    if share == 0.0:  # every node, with its volume
        return Cubature(np.arange(len(body.cloud)), body.volumes, moments, 0.0)
    generator = np.random.default_rng(seed)
    total = min(ROWS, ENTRIES // len(body.cloud))
    rows, columns, target = max(1, min(count, total // len(states))), [], []
    for state in states:
        weighted = sketch(rows, count, generator) @ root @ _shear_work(body, own, state)
        size = np.linalg.norm(weighted.sum(axis=1))
        if size > 0:
            columns.append(weighted / np.sqrt(size))
            target.append(columns[-1].sum(axis=1))
    multiples, residual = non_negative(np.concatenate(columns), np.concatenate(target), share)
    nodes = np.flatnonzero(multiples > 0)
    pressure = _pressure(own, states, moments, nodes, root)
    return Cubature(nodes, multiples[nodes] * body.volumes[nodes], pressure, residual)


def deformation(gradients: Floats, state: Floats) -> tuple[Floats, Floats, Floats]:
    """F, cof(F) and J at nodes with the derivatives (n, m, 9) of the columns."""
    F = np.eye(3) + np.einsum("nmk,m->nk", gradients, state.astype(gradients.dtype)).astype(float).reshape(-1, 3, 3)
    cofactor = np.stack([np.cross(F[:, 1], F[:, 2]), np.cross(F[:, 2], F[:, 0]), np.cross(F[:, 0], F[:, 1])], axis=1)
    return F, cofactor, np.sum(F[:, 0] * cofactor[:, 0], axis=1)


def _shear_work(body: FullModel, gradients: Floats, state: Floats) -> Floats:
    """Work of every node's shear stress, times its volume, on the columns, shape (m, n)."""
    F, cofactor, J = deformation(gradients, state)
    stress = body.material.stress(F) - (body.material.lame * (J - 1))[:, None, None] * cofactor
    weighted = (stress * body.volumes[:, None, None]).reshape(-1, 9).astype(gradients.dtype)
    return np.asarray(np.matmul(gradients, weighted[:, :, None])[:, :, 0].T, dtype=float)


def pressure_moments(body: FullModel, snapshots: Floats, pressures: int) -> Floats:
    """Coefficients (k, n) of J - 1 at all nodes in the moments: those of the main shapes of the runs' pressures."""
    roots, chosen = np.sqrt(body.volumes), snapshots[:: max(1, len(snapshots) // STATES)]
    smooth = np.empty((len(chosen), len(roots)))
    for u, row in zip(chosen, smooth, strict=True):
        body.force(u)
        row[:] = body.work.smooth * roots
    sizes = np.linalg.norm(smooth, axis=1)
    smooth /= np.sqrt(np.maximum(sizes, SMALLEST * sizes.max()))[:, None]
    _, values, shapes = np.linalg.svd(smooth, full_matrices=False)
    kept = min(pressures, int(np.sum(values > 1e-10 * values[0])))
    return np.asarray(np.sqrt(body.material.lame) * body.smoothed_back(shapes[:kept] * roots))


def compliance_root(body: FullModel, gradients: Floats, constant: Floats, moments: Floats, mass: Floats) -> Floats:
    """Return R with R^T R the compliance of the body at rest in the coordinates."""
    shear, count = body.material.shear_modulus, len(mass)
    second = body.material.shear_bulk_modulus - 2 / 3 * shear
    stiffness = constant.copy()
    for start in range(0, len(gradients), BLOCK):
        own = gradients[start : start + BLOCK].astype(float).reshape(-1, count, 3, 3)
        roots = np.sqrt(body.volumes[start : start + BLOCK])
        strain = (own + np.swapaxes(own, 2, 3)).reshape(-1, count, 9) * roots[:, None, None]
        rows = strain.transpose(0, 2, 1).reshape(-1, count)
        traces = np.trace(own, axis1=2, axis2=3)
        slopes = traces * roots[:, None]
        stiffness += 0.5 * shear * rows.T @ rows + second * slopes.T @ slopes
    divergence = gradients[:, :, 0] + gradients[:, :, 4] + gradients[:, :, 8]
    slopes = moments @ divergence
    stiffness += slopes.T @ slopes
    values, vectors = scipy.linalg.eigh(0.5 * (stiffness + stiffness.T), mass)
    return np.asarray((vectors / np.sqrt(np.maximum(values, LIGHT * np.abs(values).max()))).T)


def _pressure(gradients: Floats, states: Floats, moments: Floats, nodes: NDArray[np.int64], root: Floats) -> Floats:
    """Fit the coefficients (k, s) of the sampled dilatations to the moments and their slopes."""
    sampled, whole, stiff = [], [], np.linalg.inv(root).T
    for state in (np.zeros(states.shape[1]), *states[:: max(1, len(states) // SLOPES)]):
        _, cofactor, J = deformation(gradients, state)
        slope = np.matmul(gradients, cofactor.reshape(-1, 9, 1).astype(gradients.dtype))[:, :, 0] @ root.T
        value = (J - 1)[:, None] / max(float(np.linalg.norm(stiff @ state)), 1e-300)
        both = np.hstack([slope, value if state.any() else 0 * value])
        sampled.append(both[nodes])
        whole.append(moments @ both)
    return slopes_fit(np.hstack(sampled), np.hstack(whole))
