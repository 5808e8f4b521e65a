"""First derivatives at the nodes of a convex surface by fits in the depth below it.

The stencil of a surface node has nodes on one side only. Where the surface is flat, its nodes have depth 0, and
those below determine the derivative along the normal. Where it is curved, the surface nodes around lie
below the tangent plane, and a quadratic fit takes what a short wave along the surface leaves for a
change along the normal. A ball of five spacings in radius then answers a small tool with 1.1 to 1.6 times
its force (validation/patches.py). So the quadratic terms here are products of coordinates in which the surface is flat,

    y_J = x_J - n (x_J . B . x_J),

with the offsets x of the neighbours, the normal n, and half of the second fundamental form B (do Carmo,
Differential Geometry of Curves and Surfaces, 1976, section 3.3). The linear terms stay those of x, so that
linear fields are exact. Where the surface is flat nothing changes. Directions in which it is concave count
as flat: there are nodes on more than one side, and with their curvature an inflated cavity of four spacings
in radius is 15 % too stiff, instead of 4 % too soft.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.inner_gradient import REACH_MARGIN
from palpate.meshfree.quadrature import DERIVATIVE_PAIRS
from palpate.meshfree.stencils import BATCH_NODES, Stencils, quartic_spline

SMOOTH_COSINE = 0.85  # cosine between the normals of nodes at which they count as on two parts of a surface
FORM_WIDTH = 1.5  # width [spacings] of the Gaussian weights of the surface nodes around
MAX_CURVATURE = 0.5  # [1/spacing] largest principal curvature of a convex surface
MAX_SIZE_RATIO = 2.0  # largest sum of squares of the weights of a fit in the depth, over that of the plain fit
# of the moments of surface nodes, relative to their trace: nodes in one line leave the form undetermined; in the
# norm of Frobenius, which no rotation changes
FORM_RIDGE = 1e-4 * np.diag([1.0, 2.0, 1.0])


class SurfaceForms(NamedTuple):
    """The surface near its nodes, as a quadric at each."""

    normal: Floats  # (n, 3) array: outward unit normal; zero for nodes inside
    form: Floats  # (n, 3, 3) array [1/m]: half of the second fundamental form; zero for nodes inside


def surface_forms(cloud: Cloud, stencils: Stencils) -> SurfaceForms:
    """Return the quadrics that fit the surface nodes in the stencils of surface nodes.

    They are zero on lattices, and where the neighbours, as in thin tissue, do not support a fit in the depth.
    """
    points, n = cloud.points, len(cloud)
    vectors = cloud.boundary_vectors() * cloud.volumes[:, None]
    size = np.linalg.norm(vectors, axis=1)
    normal, form = vectors / np.maximum(size, np.finfo(float).tiny)[:, None], np.zeros((n, 3, 3))
    nodes = np.flatnonzero(size) if len(stencils.first) == n else np.zeros(0, dtype=np.int64)
    for part in np.array_split(nodes, len(nodes) // BATCH_NODES + 1):
        near = stencils.neighbours[part]
        cosine = np.einsum("mki,mi->mk", normal[near], normal[part])
        share = np.clip((cosine - SMOOTH_COSINE) / (1 - SMOOTH_COSINE), 0.0, 1.0) ** 2 * (near != part[:, None])
        form[part] = _fitted_forms(points[near] - points[part, None], normal[part], share, cloud.spacing)
        plain = _depth_fit(points, SurfaceForms(normal, np.zeros_like(form)), part, near)
        fitted = _depth_fit(points, SurfaceForms(normal, form), part, near)
        form[part[np.sum(fitted**2, axis=(1, 2)) > MAX_SIZE_RATIO * np.sum(plain**2, axis=(1, 2))]] = 0.0
    return SurfaceForms(normal, form)


def _fitted_forms(offset: Floats, normal: Floats, share: Floats, spacing: float) -> Floats:
    """Return forms (m, 3, 3) [1/m] fitted to the heights of nodes at offsets (m, k, 3) [m], by their shares (m, k)."""
    if not len(offset):
        return np.zeros((0, 3, 3))
    tangents = np.linalg.svd(normal[:, None, :])[2][:, 1:]
    height = np.einsum("mki,mi->mk", offset, normal)
    x, y = np.moveaxis(np.einsum("mki,mai->mka", offset, tangents), 2, 0)
    weight = share * np.exp(-(x**2 + y**2) / (2 * (FORM_WIDTH * spacing) ** 2))
    terms = np.stack([x**2, 2 * x * y, y**2], axis=2)
    moments = np.einsum("mk,mki,mkj->mij", weight, terms, terms)
    scale = moments[:, 0, 0] + 0.5 * moments[:, 1, 1] + moments[:, 2, 2] + np.finfo(float).tiny
    right = np.einsum("mk,mki,mk->mi", weight, terms, height)
    fitted = np.linalg.solve(moments / scale[:, None, None] + FORM_RIDGE, (right / scale[:, None])[..., None])
    curvatures, axes = np.linalg.eigh(fitted[:, [0, 1, 1, 2], 0].reshape(-1, 2, 2))
    most = 0.5 * MAX_CURVATURE / spacing
    plane = np.einsum("mab,mb,mcb->mac", axes, np.clip(curvatures, -most, 0.0), axes)
    return np.asarray(np.einsum("mai,mac,mcj->mij", tangents, plane, tangents))


def with_surface_gradient(stencils: Stencils, cloud: Cloud) -> Stencils:
    """Return stencils in space whose first derivatives at nodes of a curved surface are fits in the depth."""
    forms = surface_forms(cloud, stencils)
    nodes = np.flatnonzero(forms.form.any(axis=(1, 2)))
    if not len(nodes):
        return stencils
    first = stencils.first.copy()
    for part in np.array_split(nodes, len(nodes) // BATCH_NODES + 1):
        first[part] = _depth_fit(cloud.points, forms, part, stencils.neighbours[part])
    return replace(stencils, first=first, own_first=-first.sum(axis=1))


def _depth_fit(points: Floats, forms: SurfaceForms, nodes: Ints, near: NDArray[np.int32]) -> Floats:
    """Return weights (m, k, 3) [1/m] of the first derivatives at nodes (m,) with neighbours (m, k)."""
    offset, present = points[near] - points[nodes, None], near != nodes[:, None]
    height = np.einsum("mki,mij,mkj->mk", offset, forms.form[nodes], offset)
    flat = offset - height[:, :, None] * forms.normal[nodes, None]
    radius = REACH_MARGIN * np.linalg.norm(offset, axis=2).max(axis=1)[:, None, None]
    offset, flat = offset / radius, flat / radius
    weight = np.where(present, quartic_spline(np.linalg.norm(offset, axis=2)), 0.0)
    products = np.stack([flat[..., a] * flat[..., b] for a, b in DERIVATIVE_PAIRS], axis=2)
    monomials = np.concatenate([offset, products], axis=2)
    weighted = np.swapaxes(monomials * weight[:, :, None], 1, 2)
    return np.asarray(np.swapaxes(np.linalg.solve(weighted @ monomials, weighted)[:, :3], 1, 2) / radius)
