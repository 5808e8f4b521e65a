"""Energy release rate of a front from the stress around it, by a domain integral.

A virtual motion q of the front through the stress-free body, which is uniform near it and zero beyond some spacings,
changes the strain energy U at fixed displacements. For the stress P, the energy density W and the area dA/da that the
front sweeps for a unit of q,

    G dA/da = -dU/da = integral of [P : (grad u grad q) - W div q] dV + surface integral of W q . N dA
              - sum over nodes of dU/du . (grad u q)

(Shih, Moran and Nakamura, International Journal of Fracture 30, 1986). The first two terms move the nodes with q, and
the last returns the displacements to their places. In equilibrium dU/du is the force of a blade, or of a support.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.dynamics.run.model import Evaluation

UNIFORM_DISTANCE, DOMAIN_DISTANCE = 1.5, 3.5  # from the front: where q is uniform, and beyond which it is zero, in h
MIN_SWEEP = 0.1  # of the area that the front sweeps, relative to its length, below which the rate is not known


def release_rate(
    body: Any, u: Floats, evaluation: Evaluation, segments: Floats, directions: Floats, lengths: Floats
) -> float:
    """Return the energy [J/m^2] that a front releases per area; 0 for one outside the body.

    Its pieces are `segments` (m, 2, 3) [m] in the stress-free body, of `lengths` (m,) [m] inside it. They advance in
    unit directions (m, 3). `u` are the displacements (n, 3) [m] of the evaluation.
    """
    spacing, points = body.cloud.spacing, body.cloud.points
    swept = np.einsum("m,mi,mi->", lengths, _motion(segments.mean(axis=1), segments, directions, spacing), directions)
    if not swept > MIN_SWEEP * lengths.sum():
        return 0.0
    q = np.zeros_like(points)
    low, high = segments.min(axis=(0, 1)), segments.max(axis=(0, 1))
    reach = DOMAIN_DISTANCE * spacing
    near = np.flatnonzero(np.all((points > low - reach) & (points < high + reach), axis=1))
    q[near] = _motion(points[near], segments, directions, spacing)
    density, volumes = evaluation.energy_density, body.volumes
    gradients = body.deformation_gradient(u) - np.eye(3)
    carried = np.einsum("nik,nk->ni", gradients[near], q[near])
    moved = -np.sum(volumes[near, None] * evaluation.force[near] * carried)
    slopes = body.deformation_gradient(q) - np.eye(3)
    used = np.flatnonzero(np.any(slopes != 0.0, axis=(1, 2)))
    work = np.einsum("nij,nik,nkj->n", evaluation.stress[used], gradients[used], slopes[used])
    inside = volumes[used] @ (work - density[used] * np.trace(slopes[used], axis1=1, axis2=2))
    areas = body.cloud.boundary_vectors() * body.cloud.volumes[:, None]
    outside = density[near] @ np.sum(q[near] * areas[near], axis=1)
    return float((inside + outside - moved) / swept)


def _motion(points: Floats, segments: Floats, directions: Floats, spacing: float) -> Floats:
    """Return the virtual motion (p, 3) of points, with a unit length near the front."""
    begin, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    square = np.maximum(np.sum(way**2, axis=1), np.finfo(float).tiny)
    along = np.clip(np.einsum("pmi,mi->pm", points[:, None] - begin, way) / square, 0.0, 1.0)
    distance = np.linalg.norm(points[:, None] - begin - along[:, :, None] * way, axis=2) / spacing
    share = np.clip((DOMAIN_DISTANCE - distance) / (DOMAIN_DISTANCE - UNIFORM_DISTANCE), 0.0, 1.0)
    share *= share * (3.0 - 2.0 * share)
    mean = share @ directions
    size = np.maximum(np.linalg.norm(mean, axis=1), np.finfo(float).tiny)
    return np.asarray((share.max(axis=1) / size)[:, None] * mean)
