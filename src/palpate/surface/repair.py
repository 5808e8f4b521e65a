"""Surface repair: small holes, orientation of triangles, small parts and folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.surface.intersections import MAX_PAIRS, self_intersections
from palpate.surface.nesting import REGION_REMEDY, orient_components
from palpate.surface.surface import (
    Surface,
    SurfaceProblem,
    boundary_loops,
    components,
    directed_edges,
    part_centroids,
    part_volumes,
    pinched_vertices,
    select_triangles,
    weld,
)

MAX_HOLE_RATIO = 0.6  # rim length of a closed hole, over pi times the diagonal of the body
SPECK_SHARE = 1e-3  # of the volume; smaller components are removed
MAX_SMOOTHINGS = 30  # of folds


HOLLOWED_BODY = "hollowed"  # name of the repair that makes a body in another one a cavity


def repair_surface(surface: Surface) -> Surface:
    """Return a welded surface with small holes closed, triangles oriented, small parts removed and folds smoothed.

    A hole is closed by a fan of triangles about the mean of its rim, if the rim is shorter than 0.6
    pi times the diagonal of the body. Parts of less than a thousandth of the volume are removed.
    Components inside others face into their cavities. The corners of intersecting triangles are
    moved towards the mean of their neighbours until no intersection remains, or for 30 rounds.
    `Surface.repairs` lists what was done; `check_surface` reports the remaining problems.
    """
    surface = _remove_specks(weld(surface))
    surface, before = _separate_sheets(surface, _orient_triangles(surface.triangles))
    surface = _close_holes(surface)
    hollowed = np.zeros(0, dtype=np.int64)
    if surface.closed:
        surface, hollowed = _orient(surface)
    elif surface.volume < 0:
        surface = replace(surface, triangles=surface.triangles[:, ::-1])
    turned = np.flatnonzero(np.any(surface.triangles[: len(before)] != before, axis=1))
    turned = np.setdiff1d(turned, hollowed)
    if len(turned):
        places = surface.vertices[before[turned]].mean(axis=1)
        surface = _listed(
            surface, "turned", f"triangles that faced inwards were turned: {len(turned)} of {len(before)}", places
        )
    return _smooth_folds(surface)


def _orient(surface: Surface) -> tuple[Surface, Ints]:
    """Return a closed surface with all components oriented, and triangles of bodies that became cavities of others."""
    result, label = orient_components(surface), components(surface)
    volumes = part_volumes(surface, label)
    became = (volumes > 0) & (part_volumes(result, label) < 0)
    if not became.any() or surface.volume < 0:
        return result, np.zeros(0, dtype=np.int64)
    share = 100 * volumes[became].sum() / surface.volume
    what = (
        f"bodies inside another became empty cavities: {int(became.sum())}, of {share:.3g} % of the volume; "
        f"{REGION_REMEDY}"
    )
    return _listed(result, HOLLOWED_BODY, what, part_centroids(surface, label)[became]), np.flatnonzero(became[label])


def _listed(surface: Surface, name: str, what: str, points: Floats) -> Surface:
    """Return a surface with one more repair in its list."""
    return replace(surface, repairs=(*surface.repairs, SurfaceProblem("repair", name, what, points)))


def _remove_specks(surface: Surface) -> Surface:
    """Return a surface without components of less than a thousandth of the volume."""
    label = components(surface)
    if label.max() == 0:
        return surface
    volumes = np.abs(part_volumes(surface, label))
    small = volumes <= SPECK_SHARE * volumes.sum()
    if small.all() or not small.any():
        return surface
    places = part_centroids(surface, label)[small]
    surface = select_triangles(surface, ~small[label])
    what = f"components below a thousandth of the volume were removed: {int(small.sum())}"
    return _listed(surface, "specks", what, places)


def _separate_sheets(surface: Surface, triangles: Ints) -> tuple[Surface, Ints]:
    """Return a surface of oriented triangles in which each sheet at a pinched vertex has its own copy of it.

    Also its triangles before they were oriented. The smoothing of folds moves the copies apart.
    """
    bad, fan = pinched_vertices(triangles, len(surface.vertices))
    if not len(bad):
        return replace(surface, triangles=triangles), surface.triangles
    corner = triangles.ravel().copy()
    vertices, n = [surface.vertices], len(surface.vertices)
    for vertex in bad:
        for sheet in np.unique(fan[corner == vertex])[1:]:
            corner[fan == sheet] = n
            vertices.append(surface.vertices[[vertex]])
            n += 1
    separated = replace(surface, vertices=np.concatenate(vertices), triangles=corner.reshape(-1, 3))
    turned = np.any(triangles != surface.triangles, axis=1)
    before = np.where(turned[:, None], separated.triangles[:, ::-1], separated.triangles)
    what = f"sheets that touched in a point were separated, at vertices: {len(bad)}"
    return _listed(separated, "separated sheets", what, surface.vertices[bad]), before


def _smooth_folds(surface: Surface) -> Surface:
    """Return the surface smoothed at self-intersections."""
    vertices, n = surface.vertices.copy(), len(surface.vertices)
    edges, _ = directed_edges(surface.triangles)
    both = np.concatenate([edges, edges[:, ::-1]])
    near = sparse.csr_matrix((np.ones(len(both)), both.T), (n, n))
    near.data[:] = 1.0
    near = sparse.diags(1.0 / near.sum(axis=1).A1) @ near
    moved = np.zeros(n, dtype=bool)
    for _ in range(MAX_SMOOTHINGS):
        try:
            crossing = self_intersections(vertices, surface.triangles)
        except InputError:
            break
        if not 0 < len(crossing) < MAX_PAIRS:  # so many crossings are not small folds
            break
        corners = np.unique(surface.triangles[crossing])
        moved[corners] = True
        vertices[corners] = 0.5 * vertices[corners] + 0.5 * (near[corners] @ vertices)
    if not moved.any():
        return surface
    farthest = 1e3 * np.linalg.norm(vertices - surface.vertices, axis=1).max() / surface.size
    what = f"folds were smoothed, at {int(moved.sum())} vertices, by up to {farthest:.2g} thousandths of the size"
    return _listed(replace(surface, vertices=vertices), "folds", what, vertices[moved])


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
    rims, n, longest = list[int](), len(surface.vertices), np.pi * MAX_HOLE_RATIO * surface.size
    for loop in boundary_loops(surface.triangles):
        rim = surface.vertices[loop]
        length = np.linalg.norm(rim - np.roll(rim, -1, axis=0), axis=1).sum()
        if length > longest:
            continue
        vertices.append(rim.mean(axis=0, keepdims=True))
        ahead = np.roll(loop, -1)
        triangles.append(np.column_stack([ahead, loop, np.full(len(loop), n)]))
        rims += loop
        n += 1
    if not rims:
        return surface
    surface = replace(surface, vertices=np.concatenate(vertices), triangles=np.concatenate(triangles))
    holes = n - len(vertices[0])
    what = f"holes were closed by fans of triangles: {holes}, with {len(rims)} edges"
    return _listed(surface, "closed holes", what, surface.vertices[rims])
