"""Points inside a closed surface, and nested components: which enclose others, so that cavities face into the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.surface.surface import Surface, components, part_volumes

MAX_COMPONENTS = 100  # of a surface, whose pairs are compared
# what to do with a body in another
REGION_REMEDY = (
    "a tumour or a vessel of other tissue is a region: leave it out of the body (parts of [surface]), and name it, "
    "place = { part = 'tumour' } of [[region]], in a file with named parts such as OBJ"
)


def enclosures(surface: Surface, label: Ints) -> NDArray[np.bool_]:
    """Return which components (k, k) lie inside which others: row inside column.

    They are closed and do not intersect, at most `MAX_COMPONENTS`; `label` (t,) has that of each triangle.
    """
    corners = [surface.vertices[surface.triangles[label == k]] for k in range(int(label.max()) + 1)]
    low = np.array([each.min(axis=(0, 1)) for each in corners])
    high = np.array([each.max(axis=(0, 1)) for each in corners])
    enclosed = np.zeros((len(corners), len(corners)), dtype=np.bool_)
    for inner, inner_corners in enumerate(corners):
        for outer in np.flatnonzero(np.all((low < low[inner]) & (high > high[inner]), axis=1)):
            enclosed[inner, outer] = inside_points(inner_corners[0, :1], corners[outer])[0]
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


@cached_njit(nogil=True)
def _difference(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@cached_njit(nogil=True)
def winding_number(corners, point):
    """Return the winding number of triangles (t, 3, 3) of a closed surface about a point (3,): 1 inside, 0 outside.

    The solid angle of a triangle is that of van Oosterom and Strackee (IEEE Transactions on Biomedical
    Engineering 30, 1983).
    """
    total = 0.0
    for t in range(corners.shape[0]):
        ax, ay, az = _difference(corners[t, 0], point)
        bx, by, bz = _difference(corners[t, 1], point)
        cx, cy, cz = _difference(corners[t, 2], point)
        a, b = np.sqrt(ax * ax + ay * ay + az * az), np.sqrt(bx * bx + by * by + bz * bz)
        c = np.sqrt(cx * cx + cy * cy + cz * cz)
        above = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        below = a * b * c + (ax * bx + ay * by + az * bz) * c + (bx * cx + by * cy + bz * cz) * a
        total += np.arctan2(above, below + (cx * ax + cy * ay + cz * az) * b)
    return total / (2.0 * np.pi)


@cached_njit(nogil=True)
def _winding_numbers(corners, points, result):
    for k in range(points.shape[0]):
        result[k] = winding_number(corners, points[k])


def inside_points(points: Floats, corners: Floats) -> NDArray[np.bool_]:
    """Return which points (p, 3) are inside a closed surface of triangles (t, 3, 3)."""
    numbers = np.zeros(len(points))
    _winding_numbers(np.ascontiguousarray(corners), np.ascontiguousarray(points), numbers)
    return np.asarray(np.abs(numbers) > 0.5)


@cached_njit(nogil=True)
def inside_shares(segments, corners, shares):
    """Write the shares of the lengths of segments (s, 2, 3) that are inside a closed surface (t, 3, 3)."""
    for k in range(segments.shape[0]):
        start = segments[k, 0]
        dx, dy, dz = _difference(segments[k, 1], start)
        total = 1.0 if abs(winding_number(corners, start)) > 0.5 else 0.0
        for t in range(corners.shape[0]):
            ux, uy, uz = _difference(corners[t, 1], corners[t, 0])
            vx, vy, vz = _difference(corners[t, 2], corners[t, 0])
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            slope = nx * dx + ny * dy + nz * dz
            if slope == 0.0:
                continue
            px, py, pz = _difference(corners[t, 0], start)
            share = (nx * px + ny * py + nz * pz) / slope
            if not 0.0 < share < 1.0:
                continue
            qx, qy, qz = share * dx - px, share * dy - py, share * dz - pz
            square = nx * nx + ny * ny + nz * nz
            a = ((qy * vz - qz * vy) * nx + (qz * vx - qx * vz) * ny + (qx * vy - qy * vx) * nz) / square
            b = ((uy * qz - uz * qy) * nx + (uz * qx - ux * qz) * ny + (ux * qy - uy * qx) * nz) / square
            if a >= 0.0 and b >= 0.0 and a + b < 1.0:
                total += (1.0 - share) * (1.0 if slope < 0.0 else -1.0)
        shares[k] = min(max(total, 0.0), 1.0)


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
