"""Surface repair: small holes, orientation of triangles, small parts and folds."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components

from palpate.arrays import Ints
from palpate.faults import InputError
from palpate.meshfree.intersections import MAX_PAIRS, self_intersections
from palpate.meshfree.surfaces import (
    Surface,
    boundary_loops,
    components,
    directed_edges,
    part_volumes,
    select_triangles,
    weld,
)

__all__ = ["repair_surface"]

MAX_HOLE_RATIO = 0.6  # rim length of a closed hole, over pi times the diagonal of the body
MAX_SMOOTHINGS = 30  # of folds


def repair_surface(surface: Surface) -> Surface:
    """Return a welded surface with small holes closed, triangles oriented, small parts removed and folds smoothed.

    A hole is closed by a fan of triangles about the mean of its rim, if the rim is shorter than 0.6
    pi times the diagonal of the body. Parts of less than a thousandth of the volume are removed.
    The corners of intersecting triangles are moved towards the mean of their neighbours until no
    intersection remains, or for 30 rounds. `check_surface` reports the remaining problems.
    """
    surface = weld(surface)
    label = components(surface)
    if label.max() > 0:
        volumes = np.abs(part_volumes(surface, label))
        keep = np.flatnonzero(volumes > 1e-3 * volumes.sum())
        surface = select_triangles(surface, np.isin(label, keep)) if len(keep) else surface
    surface = Surface(surface.vertices, _orient_triangles(surface.triangles), surface.name, surface.warnings)
    surface = _close_holes(surface)
    if surface.volume < 0:
        surface = Surface(surface.vertices, surface.triangles[:, ::-1], surface.name, surface.warnings)
    return _smooth_folds(surface)


def _smooth_folds(surface: Surface) -> Surface:
    """Return the surface smoothed at self-intersections."""
    vertices, n = surface.vertices.copy(), len(surface.vertices)
    edges, _ = directed_edges(surface.triangles)
    both = np.concatenate([edges, edges[:, ::-1]])
    near = sparse.csr_matrix((np.ones(len(both)), both.T), (n, n))
    near.data[:] = 1.0
    near = sparse.diags(1.0 / near.sum(axis=1).A1) @ near
    for _ in range(MAX_SMOOTHINGS):
        try:
            crossing = self_intersections(vertices, surface.triangles)
        except InputError:
            break
        if not 0 < len(crossing) < MAX_PAIRS:  # so many crossings are not small folds
            break
        corners = np.unique(surface.triangles[crossing])
        vertices[corners] = 0.5 * vertices[corners] + 0.5 * (near[corners] @ vertices)
    return Surface(vertices, surface.triangles, surface.name, surface.warnings)


def _orient_triangles(triangles: Ints) -> Ints:
    """Return triangles with a consistent orientation in each part, by breadth-first search."""
    edges, owner = directed_edges(triangles)
    _, inverse, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    order = np.argsort(inverse, kind="stable")
    order = order[count[inverse[order]] == 2].reshape(-1, 2)
    left, right = owner[order].T
    disagree = (edges[order[:, 0]] == edges[order[:, 1]]).all(axis=1)
    t = len(triangles)
    # a graph of triangles and their reversed copies: consistent neighbours connect in equal orientation
    a = np.where(disagree, right + t, right)
    b = np.where(disagree, right, right + t)
    rows, columns = np.concatenate([left, left + t]), np.concatenate([a, b])
    _, side = connected_components(sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), (2 * t, 2 * t)), False)
    turned = side[:t] > side[t:]  # labels ascend: the first triangle of a part keeps its orientation
    result = triangles.copy()
    result[turned] = result[turned][:, ::-1]
    return result


def _close_holes(surface: Surface) -> Surface:
    vertices, triangles = [surface.vertices], [surface.triangles]
    n, longest = len(surface.vertices), np.pi * MAX_HOLE_RATIO * surface.size
    for loop in boundary_loops(surface.triangles):
        rim = surface.vertices[loop]
        length = np.linalg.norm(rim - np.roll(rim, -1, axis=0), axis=1).sum()
        if length > longest:
            continue
        vertices.append(rim.mean(axis=0, keepdims=True))
        ahead = np.roll(loop, -1)
        triangles.append(np.column_stack([ahead, loop, np.full(len(loop), n)]))
        n += 1
    return Surface(np.concatenate(vertices), np.concatenate(triangles), surface.name, surface.warnings)
