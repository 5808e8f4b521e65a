"""Choice of the integration points: derivatives at all points, forces at training states, pressure moments.

The points of a solid are its nodes. Those of a membrane are six about every node, as in its energy form.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.membrane.passes import POINT_COSINES, POINT_SINES
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import InputError
from palpate.reduction.basis.snapshots import Snapshots
from palpate.reduction.hyper.cubature import Cubature, fit_moments, sketch, sparse_nnls
from palpate.reduction.hyper.material_point import volume_measure
from palpate.tissue.materials import Material

__all__ = [
    "Fields",
    "choose_integration_points",
    "compliance_root",
    "deformation",
    "differentiate",
    "pressure_moments",
    "shear_stress",
]


PRESSURE_STATES = 240  # training states for the pressure modes
BALANCED_SHARE = 1e-9  # relative size of a sum of forces that counts as zero, as in a taut sheet at rest
REACTION_WEIGHT = 0.1  # of the forces on tools and supports, relative to those on all coordinates
MAX_ROWS, MAX_ENTRIES = 12_000, 150_000_000  # of the least-squares problem for the weights; more rows are sketched
SLOPE_STATES = 60  # training states for the fit of the moments' slopes
BLOCK_NODES = 4096  # nodes per block
NO_VECTORS = slice(0, 0)
MIN_SIZE = 1e-3  # of the largest pressure, below which a state has reduced weight
RIGID_BODY_SHIFT = 1e-12  # least squared frequency, relative to the highest, for bodies without supports


@dataclass(frozen=True)
class Fields:
    """Basis vectors and their derivatives at the points of the energy form.

    Parameters
    ----------
    columns : (m, n, 3) array
        The basis vectors.
    gradients : (p, m, 9) array
        Their derivatives, row by row of du/dX; in single precision where there are many.
    constant : (m, m) array
        Stiffness of their hourglass residual.
    nodes : (p,) int array
        Node of each point.
    volumes : (p,) array [m^3]
        Of the points, times the stiffness factor of the node.
    """

    columns: Floats
    gradients: Floats
    constant: Floats
    nodes: NDArray[np.int64]
    volumes: Floats

    def of(self, which: slice | NDArray[np.int64]) -> Fields:
        """Return the fields of a subset of the basis vectors."""
        constant = self.constant[which][:, which]
        return Fields(self.columns[which], self.gradients[:, which], constant, self.nodes, self.volumes)


def differentiate(body: EnergySolid | Membrane, columns: Floats, even: slice = NO_VECTORS) -> Fields:
    """Return basis vectors (m, n, 3) with their derivatives at all points.

    At planes of symmetry images continue the vectors as reflections. `even` are the test fields of
    supports, which images continue as they are, so that they do not jump there.
    """
    if isinstance(body, Membrane):
        return _differentiate_sheet(body, columns)
    n, count = len(body.cloud), len(columns)
    type_ = _precision(n, count)
    gradients, residuals = np.empty((n, count, 9), dtype=type_), np.empty((count, 3 * n), dtype=type_)
    for m, by_node in enumerate(_by_node(body, columns, 12, even)):
        gradients[:, m] = by_node[:, :9]
        residuals[m] = by_node[:, 9:].reshape(-1) * np.repeat(np.sqrt(body.shear_volumes), 3)
    constant = np.asarray(residuals @ residuals.T, dtype=float) * body.body.hourglass
    return Fields(columns, gradients, constant, np.arange(n), body.elastic_volumes)


def _differentiate_sheet(body: Membrane, columns: Floats) -> Fields:
    """Return basis vectors with their derivatives at six points per node; the third entry of every row is 0."""
    n, count = len(body.cloud), len(columns)
    points = len(POINT_COSINES)
    gradients = np.zeros((points, n, count, 3, 3), dtype=_precision(points * n, count))
    for m, by_node in enumerate(_by_node(body, columns, 15)):
        first, second = by_node[:, :6].reshape(n, 3, 2), by_node[:, 6:].reshape(n, 3, 3)
        for q in range(points):
            x, y = (body.body.radius[:, None] * turn for turn in (POINT_COSINES[q], POINT_SINES[q]))
            gradients[q, :, m, :, 0] = first[:, :, 0] + second[:, :, 0] * x + second[:, :, 2] * y
            gradients[q, :, m, :, 1] = first[:, :, 1] + second[:, :, 2] * x + second[:, :, 1] * y
    nodes = np.tile(np.arange(n), points)
    flat = gradients.reshape(points * n, count, 9)
    return Fields(columns, flat, np.zeros((count, count)), nodes, body.volumes[nodes] / points)


def _precision(points: int, count: int) -> Any:
    return np.float64 if points * count < 2_000_000 else np.float32


def _by_node(body: EnergySolid | Membrane, columns: Floats, numbers: int, even: slice = NO_VECTORS) -> Iterator[Floats]:
    """Yield the nodal derivatives (n, numbers) of every basis vector by the formulation."""
    blocks, lanes = body.body.lanes.nodes.shape
    table, passes = np.zeros((blocks, 1, numbers, lanes)), body.workspace().passes
    unchanged = range(len(columns))[even]
    for m, column in enumerate(columns):
        extended = body.mirror.scalars(column) if m in unchanged else body.mirror.vectors(column)
        body.formulation.differentiate(np.ascontiguousarray(extended[None]), body.body, passes, table)
        yield table[:, 0].transpose(0, 2, 1).reshape(-1, numbers)[body.slot]


def choose_integration_points(
    body: EnergySolid | Membrane, fields: Fields, modes: int, states: Floats, mass: Floats, share: float,
    moments: Floats, seed: int,
) -> tuple[NDArray[np.int64], Cubature]:  # fmt: skip
    """Return places of the chosen points in the fields, and the cubature with their weights and moments.

    Parameters
    ----------
    fields : Fields
        Of modes, lifting vectors and the supports' test fields.
    modes : int
        Number of modes.
    states : (t, m) array
        Training states: coordinates of modes and lifting vectors.
    mass : (m, m) array
    share : float
        Largest relative error of the sampled forces; 0 selects every point.
    moments : (k, n) array
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
    body: EnergySolid | Membrane,
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


def shear_stress(body: EnergySolid | Membrane, fields: Fields, state: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the shear stress (p, 3, 3) at every point, times its volume [N m], cof(F) and J."""
    F, cofactor, J = deformation(fields.gradients[:, : len(state)], state)
    if isinstance(body, Membrane):
        stress = np.zeros_like(F)
        stress[:, :, :2] = body.stress_at(F[:, :, :2] + (body.prestretch - 1) * np.eye(3, 2))
    else:
        stress = body.tissue.shear_stress(F, fields.nodes)
    return stress * fields.volumes[:, None, None], cofactor, J


def _shear_work(body: EnergySolid | Membrane, fields: Fields, state: Floats) -> Floats:
    """Return the work (m, p) of every point's shear stress, times its volume, on all basis vectors."""
    gradients = fields.gradients
    weighted = shear_stress(body, fields, state)[0].reshape(-1, 9).astype(gradients.dtype)
    return np.asarray(np.matmul(gradients, weighted[:, :, None])[:, :, 0].T, dtype=float)


def pressure_moments(body: EnergySolid | Membrane, snapshots: Snapshots, pressures: int) -> Floats:
    """Return the coefficients (k, n) of the nodes' J - 1, or g(J), in the moments.

    The moments belong to the main modes of the pressures in the snapshots.
    """
    if isinstance(body, Membrane):  # it has no pressure, because its thickness follows
        return np.zeros((0, len(body.cloud)))
    roots, chosen = np.sqrt(body.bulk_volumes), np.arange(0, len(snapshots), max(1, len(snapshots) // PRESSURE_STATES))
    smooth, work = np.empty((len(chosen), len(roots))), body.workspace()
    for u, row in zip(snapshots.each(chosen), smooth, strict=True):
        row[:] = body.smoothed_measure(u, work) * roots
    smooth = smooth[np.isfinite(smooth).all(axis=1)]
    if not len(smooth):
        raise InputError("trajectories must keep all volumes positive, got none that does; train on smaller loads")
    sizes = np.linalg.norm(smooth, axis=1)
    if not sizes.any():  # the volume is the same in all snapshots
        return np.zeros((0, len(body.cloud)))
    smooth /= np.sqrt(np.maximum(sizes, MIN_SIZE * sizes.max()))[:, None]
    _, values, shapes = np.linalg.svd(smooth, full_matrices=False)
    kept = min(pressures, int(np.sum(values > 1e-10 * values[0])))
    return np.asarray(np.sqrt(body.tissue.lame) * body.smooth_transposed(shapes[:kept] * roots))


def compliance_root(body: EnergySolid | Membrane, fields: Fields, count: int, moments: Floats, mass: Floats) -> Floats:
    """Return R for which R^T R is the compliance of the body at rest in the coordinates.

    For a membrane it is that of the taut state.
    """
    stiffness, gradients = fields.constant[:count, :count].copy(), fields.gradients[:, :count]
    shear, second = np.full(len(body.cloud), body.material.shear_modulus), np.zeros(len(body.cloud))
    if isinstance(body, EnergySolid):
        shear = body.tissue.moduli("shear_modulus")
        second = body.tissue.moduli("shear_share") - 2 / 3 * shear
    for start in range(0, len(gradients), BLOCK_NODES):
        block = gradients[start : start + BLOCK_NODES].astype(float).reshape(-1, count, 3, 3)
        roots, nodes = np.sqrt(fields.volumes[start : start + BLOCK_NODES]), fields.nodes[start : start + BLOCK_NODES]
        # tension resists every slope of a sheet, not only strain
        strain = 2 * block if isinstance(body, Membrane) else block + np.swapaxes(block, 2, 3)
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
