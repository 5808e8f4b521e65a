"""Nested components of a closed surface: which of them enclose others, so that cavities face into the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats, Ints
from palpate.meshfree.surfaces import Surface, components, part_volumes

__all__ = ["MAX_COMPONENTS", "body_numbers", "cavities", "enclosures", "orient_components", "winding_number"]

MAX_COMPONENTS = 100  # of a surface, whose pairs are compared


def enclosures(surface: Surface, label: Ints) -> NDArray[np.bool_]:
    """Return which components (k, k) lie inside which others: row inside column.

    Parameters
    ----------
    surface : Surface
        Closed components that do not intersect, at most `MAX_COMPONENTS`.
    label : (t,) array
        Component of each triangle.
    """
    corners = [surface.vertices[surface.triangles[label == k]] for k in range(int(label.max()) + 1)]
    low = np.array([each.min(axis=(0, 1)) for each in corners])
    high = np.array([each.max(axis=(0, 1)) for each in corners])
    enclosed = np.zeros((len(corners), len(corners)), dtype=np.bool_)
    for inner, inner_corners in enumerate(corners):
        for outer in np.flatnonzero(np.all((low < low[inner]) & (high > high[inner]), axis=1)):
            enclosed[inner, outer] = abs(winding_number(corners[outer], inner_corners[0, 0])) > 0.5
    return enclosed


def cavities(enclosed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which components (k,) are walls of cavities: those inside an odd number of others."""
    return np.asarray(enclosed.sum(axis=1) % 2 == 1)


def body_numbers(enclosed: NDArray[np.bool_]) -> Ints:
    """Return the number of the body (k,) that each component bounds: a cavity is in the body right around it."""
    depth = enclosed.sum(axis=1)
    outer = np.arange(len(depth))
    for k in np.flatnonzero(depth % 2 == 1):
        outer[k] = np.flatnonzero(enclosed[k] & (depth == depth[k] - 1))[0]
    return np.unique(outer, return_inverse=True)[1]


def winding_number(corners: Floats, point: Floats) -> float:
    """Return the winding number of triangles (t, 3, 3) of a closed surface about a point: 1 inside, 0 outside.

    The solid angle of a triangle is that of van Oosterom and Strackee (IEEE Transactions on Biomedical
    Engineering 30, 1983).
    """
    a, b, c = (corners[:, k] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
    above = np.einsum("ta,ta->t", a, np.cross(b, c))
    dots = [np.einsum("ta,ta->t", x, y) for x, y in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return float(2 * np.arctan2(above, below).sum() / (4 * np.pi))


def orient_components(surface: Surface) -> Surface:
    """Return a closed surface whose bodies face outwards and whose cavities face into the cavity."""
    label = components(surface)
    if label.max() >= MAX_COMPONENTS:
        return surface
    expected = np.where(cavities(enclosures(surface, label)), -1, 1)
    turned = (expected * part_volumes(surface, label) < 0)[label]
    if not turned.any():
        return surface
    triangles = np.where(turned[:, None], surface.triangles[:, ::-1], surface.triangles)
    return replace(surface, triangles=triangles)
