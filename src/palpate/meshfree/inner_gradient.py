"""First derivatives at inner nodes by fits of order 3.

A fit of order 2 differentiates a wave of wave number k with a factor of 1 - (kh)^2 / 6, so that the
strain energy of a wave of six spacings is a third too small. Nodes that have neighbours on all sides
support a fit of order 3 with the same neighbours, which has no error of that order. Its cubic terms are
damped a little (Tikhonov regularisation): fields of order 2 are differentiated exactly all the same, and
where the neighbours determine cubic terms poorly the fit tends to one of order 2.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import factorial

from palpate.core.arrays import Floats
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import BATCH_NODES, Stencils, monomial_exponents, quartic_spline

INNER_DEPTH = 0.55  # smallest distance of inner nodes from those of the surface, in radii of their stencils
# of cubic coefficients, in coordinates relative to the support radius; times i! j! k! / 3! for x^i y^j z^k, as in
# the norm of Bombieri, which no rotation changes
CUBIC_DAMPING = 2e-3
REACH_MARGIN = 1.05  # support radius over the distance of the last neighbour, as in `moving_least_squares`


def inner_nodes(cloud: Cloud, stencils: Stencils) -> NDArray[np.bool_]:
    """Return True for nodes (n,) so far from the surface that they have neighbours on all sides; on lattices none."""
    n = len(cloud)
    if len(stencils.first) < n:
        return np.zeros(n, dtype=bool)
    reach = np.linalg.norm(cloud.points[stencils.neighbours] - cloud.points[:, None], axis=2).max(axis=1)
    surface = np.unique(cloud.face_nodes)
    depth = cKDTree(cloud.points[surface]).query(cloud.points)[0]
    return np.asarray(depth > INNER_DEPTH * reach)


def with_inner_gradient(stencils: Stencils, cloud: Cloud) -> Stencils:
    """Return stencils of a cloud in space whose first derivatives at inner nodes are those of damped cubic fits."""
    nodes = np.flatnonzero(inner_nodes(cloud, stencils))
    if not len(nodes):
        return stencils
    first = stencils.first.copy()
    for part in np.array_split(nodes, len(nodes) // BATCH_NODES + 1):
        first[part] = _cubic_fit(cloud.points, part, stencils.neighbours[part])
    return replace(stencils, first=first, own_first=-first.sum(axis=1))


def _cubic_fit(points: Floats, nodes: NDArray[np.int64], near: NDArray[np.int32]) -> Floats:
    """Return weights (m, k, 3) [1/m] of the first derivatives at nodes (m,) with neighbours (m, k)."""
    offset, present = points[near] - points[nodes, None], near != nodes[:, None]
    radius = REACH_MARGIN * np.linalg.norm(offset, axis=2).max(axis=1)
    offset /= radius[:, None, None]
    weight = np.where(present, quartic_spline(np.linalg.norm(offset, axis=2)), 0.0)
    exponents = monomial_exponents(3, 3)[1:]
    monomials = np.prod(offset[:, :, None, :] ** exponents, axis=3)
    weighted = np.swapaxes(monomials * weight[:, :, None], 1, 2)
    moments = weighted @ monomials
    cubic = np.flatnonzero(exponents.sum(axis=1) == 3)
    moments[:, cubic, cubic] += CUBIC_DAMPING * np.prod(factorial(exponents[cubic]), axis=1) / 6
    return np.swapaxes(np.linalg.solve(moments, weighted)[:, :3], 1, 2) / radius[:, None, None]
