"""Surfaces along which a body is cut, and their fronts; paths round them: `meshfree.cut.diffraction_lengths`.

A cut is a union of triangles in the stress-free body. A bond is a pair of nodes, one in the stencil of the other.
A bond that crosses no triangle does not change. The distance of one that does is the shortest path round a front,

    p = min over the fronts of |A - x| + |x - B|,      x on the front,

so the weight of the neighbour follows from p (diffraction: Organ, Fleming, Terry and Belytschko, Computational
Mechanics 18, 1996). Without a front near, the bond is severed. A front is an edge of one triangle only, inside the body
and not on other triangles. It is declared `FRONT_LEAD` spacings ahead of the edge, for which the energy release has the
least error. A path round a front must not cross another component, a set of triangles that share edges: else the front
of a cut would connect the faces of an open one next to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described, Fact
from palpate.core.faults import CloudError
from palpate.meshfree.cut.crossings import TriangleTree, difference, normal, sphere, triangle_tree

FRONT_LEAD = 0.2  # spacings by which a front is ahead of the edge of the cut
PIECE_LENGTH = 0.5  # longest piece of an edge that is inside or outside as a whole, in spacings
MERGE_DISTANCE = 1e-6  # of equal corners, in spacings
MIN_WIDTH = 1e-3  # least height of a triangle, in spacings
COVER_AHEAD, COVER_DISTANCE = 0.3, 0.1  # from an edge, and from there to the cut that covers it, in spacings
MIN_MITRE = 0.5  # least 1 + cosine of the normals of two edges for the mitre at their corner


@dataclass(frozen=True)
class CutSurface(Described):
    """Triangles along which a body is cut.

    Parameters
    ----------
    triangles : (t, 3, 3) array [m]
        Corners in the stress-free body.
    extended : (t, 3, 3) array [m]
        The same triangles with their fronts ahead.
    fronts : (e, 2, 3) array [m]
        Pieces of the fronts of `extended`.
    components, front_components : (t,), (e,) int arrays
        Number of the component of every triangle and front.
    tree : TriangleTree
        Of `extended`.
    inside : dict
        For the pieces of edges that were examined, whether they are inside the body.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.0025)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> a, b, c, d = (0.014, -0.01, 0.008), (0.014, 0.015, 0.008), (0.014, 0.015, 0.02), (0.014, -0.01, 0.02)
    >>> opened = pt.cut(block, [(a, b, c), (a, c, d)])
    >>> len(opened.cut_surface.triangles), len(opened.cut_surface.fronts) > 0
    (2, True)
    """

    triangles: Floats
    extended: Floats
    fronts: Floats
    components: Ints = field(repr=False)
    front_components: Ints = field(repr=False)
    tree: TriangleTree = field(repr=False, compare=False)
    inside: Mapping[bytes, bool] = field(default_factory=dict, repr=False, compare=False)

    def _facts(self) -> list[Fact]:
        return [
            ("triangles", len(self.triangles), ""),
            ("area", float(triangle_areas(self.triangles).sum()), "m^2"),
            ("length of the fronts", float(np.linalg.norm(self.fronts[:, 1] - self.fronts[:, 0], axis=1).sum()), "m"),
        ]


_NO_TRIANGLES, _NO_NUMBERS = np.zeros((0, 3, 3)), np.zeros(0, np.int64)
NO_CUT = CutSurface(
    _NO_TRIANGLES, _NO_TRIANGLES, np.zeros((0, 2, 3)), _NO_NUMBERS, _NO_NUMBERS,
    triangle_tree(_NO_TRIANGLES, _NO_NUMBERS, 0.0),
)  # fmt: skip


def swept(edges: Floats) -> Floats:
    """Return the triangles (2 (k - 1) (m - 1), 3, 3) between successive positions (k, m, 3) of an edge of m points."""
    a, b, c, d = edges[:-1, :-1], edges[1:, :-1], edges[1:, 1:], edges[:-1, 1:]
    halves = [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    return np.stack(halves, axis=1).reshape(-1, 3, 3)


def triangle_areas(triangles: Floats) -> Floats:
    """Return the areas (t,) [m^2] of triangles (t, 3, 3)."""
    a, b, c = (triangles[:, k] for k in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def cut_surface(
    before: CutSurface,
    triangles: Floats,
    is_inside: Callable[[Floats], NDArray[np.bool_]],
    spacing: float,
    unchanged: int | None = None,
) -> CutSurface:
    """Return the union of a cut surface and further triangles (t, 3, 3) [m].

    `is_inside` returns which points (p, 3) are inside the body. `unchanged` is the number of the first triangles of
    `before` that remain; by default all.
    """
    narrow = np.flatnonzero(is_narrow(triangles, spacing))
    if narrow.size:
        raise CloudError(
            f"triangles of a cut must be at least {MIN_WIDTH * spacing:.2g} m wide, got triangle {narrow[0]} with "
            f"corners {triangles[narrow[0]].tolist()}; leave it out"
        )
    union = np.concatenate([before.triangles[:unchanged], triangles])
    number, vertices = _merged(union, spacing)
    edges, normals, owners = _boundary(number, vertices)
    pieces, owner = _pieces(vertices[edges], spacing)
    known = dict(before.inside)
    middles = pieces.mean(axis=1)
    inside = _inside(middles, is_inside, spacing, known)
    inside[inside] = ~_is_covered(middles[inside], normals[owner[inside]], union, spacing)
    on_front = np.bincount(owner[inside], minlength=len(edges)) > 0
    lead = _leads(edges[on_front], normals[on_front], len(vertices)) * FRONT_LEAD * spacing
    moved = vertices + lead
    pieces, owner = _pieces(moved[edges], spacing, vertices[edges])
    components, fronts, extended = _components(number), np.ascontiguousarray(pieces[inside]), moved[number]
    tree = triangle_tree(extended, components, spacing)
    return CutSurface(union, extended, fronts, components, components[owners[owner[inside]]], tree, known)


def changed_spheres(before: CutSurface, after: CutSurface) -> Floats:
    """Return spheres (c, 4) [m] around the triangles and fronts that are in one of two cuts only.

    Those of another component count as others. The rows have the middles and the radii.
    """
    spheres = []
    for surface, other in ((before, after), (after, before)):
        for rows, other_rows in zip(_labelled(surface), _labelled(other), strict=True):
            in_both = {row.tobytes() for row in other_rows}
            is_alone = np.array([row.tobytes() not in in_both for row in rows], dtype=np.bool_)
            ends = rows[is_alone, 1:].reshape(-1, rows.shape[1] // 3, 3)
            middles = ends.mean(axis=1)
            radii = np.linalg.norm(ends - middles[:, None], axis=2).max(axis=1, initial=0.0)
            spheres.append(np.column_stack([middles, radii]))
    return np.concatenate(spheres)


def _labelled(surface: CutSurface) -> tuple[Floats, Floats]:
    """Return triangles (t, 10) and fronts (e, 7), each with the number of the first triangle of its component."""
    _, first = np.unique(surface.components, return_index=True)
    triangles, fronts = surface.extended.reshape(-1, 9), surface.fronts.reshape(-1, 6)
    return (
        np.column_stack([first[surface.components], triangles]),
        np.column_stack([first[surface.front_components], fronts]),
    )


def is_narrow(triangles: Floats, spacing: float) -> Any:
    """Return which triangles (t, 3, 3) are narrower than a thousandth of the spacing."""
    longest = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    return 2 * triangle_areas(triangles) < MIN_WIDTH * spacing * np.maximum(longest, spacing * MIN_WIDTH)


def _is_covered(points: Floats, normals: Floats, triangles: Floats, spacing: float) -> Any:
    """Return whether the cut goes on beyond points (p, 3) of an edge: a seam of two cuts is not a front."""
    ahead = points + COVER_AHEAD * spacing * normals
    projections, distance, over = np.empty_like(ahead), np.empty(len(ahead)), np.empty(len(ahead), dtype=np.bool_)
    nearest_on_cut(ahead, triangles, projections, distance, over)
    return distance < COVER_DISTANCE * spacing


def _merged(triangles: Floats, spacing: float) -> tuple[Any, Floats]:
    """Return the vertices (v, 3) of triangles, and their numbers (t, 3); equal corners are one vertex."""
    flat = triangles.reshape(-1, 3)
    keys = np.rint(flat / (MERGE_DISTANCE * spacing)).astype(np.int64)
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return number.reshape(-1, 3), flat[first]


def _components(number: Any) -> Ints:
    """Return the components (t,) of triangles; those with a common edge are of one component."""
    count = len(number)
    keys = np.sort(np.concatenate([number[:, [0, 1]], number[:, [1, 2]], number[:, [2, 0]]]), axis=1)
    _, edge = np.unique(keys, axis=0, return_inverse=True)
    rows, columns = np.tile(np.arange(count), 3), count + edge.ravel()
    size = count + int(edge.max(initial=-1)) + 1
    joined = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    _, label = connected_components(joined, directed=False)
    return np.asarray(label[:count], dtype=np.int64)


def _boundary(number: Any, vertices: Floats) -> tuple[Any, Floats, Ints]:
    """Return the edges (e, 2) of one triangle only, their normals (e, 3) in its plane, away from it, and its number."""
    _, single = np.unique(np.sort(number, axis=1), axis=0, return_index=True)  # a triangle counts once
    outer = number[single]
    sides = np.concatenate([outer[:, [0, 1, 2]], outer[:, [1, 2, 0]], outer[:, [2, 0, 1]]])
    keys = np.sort(sides[:, :2], axis=1)
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    edge, owners = sides[first[count == 1]], np.tile(single, 3)[first[count == 1]]
    a, b, opposite = (vertices[edge[:, k]] for k in range(3))
    along = b - a
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    away = a - opposite
    away -= np.sum(away * along, axis=1, keepdims=True) * along
    return edge[:, :2], away / np.linalg.norm(away, axis=1, keepdims=True), owners


def _pieces(ends: Floats, spacing: float, divided_as: Floats | None = None) -> tuple[Floats, Any]:
    """Divide edges (e, 2, 3) into pieces (p, 2, 3) of at most `PIECE_LENGTH`; return the edge of every piece, too."""
    lengths = np.linalg.norm(np.diff(ends if divided_as is None else divided_as, axis=1)[:, 0], axis=1)
    count = np.maximum(np.ceil(lengths / (PIECE_LENGTH * spacing) * (1 - 1e-9)).astype(int), 1)
    owner = np.repeat(np.arange(len(ends)), count)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    shares = np.stack([place, place + 1], axis=1) / count[owner, None]
    start, way = ends[owner, 0], ends[owner, 1] - ends[owner, 0]
    return start[:, None] + shares[:, :, None] * way[:, None], owner


def _inside(
    points: Floats, is_inside: Callable[[Floats], NDArray[np.bool_]], spacing: float, known: dict[bytes, bool]
) -> Any:
    """Return whether points (p, 3) are inside the body; add the answers to those that are known."""
    keys = [key.tobytes() for key in np.rint(points / (MERGE_DISTANCE * spacing)).astype(np.int64)]
    new = [k for k, key in enumerate(keys) if key not in known]
    if new:
        answers = is_inside(points[new])
        known.update((keys[k], bool(answer)) for k, answer in zip(new, answers, strict=True))
    return np.array([known[key] for key in keys], dtype=np.bool_)


@cached_njit(nogil=True)
def nearest_on_cut(points, triangles, projections, distance, over):
    """Write the projections (p, 3) of points on their nearest triangles, and the distances (p,) [m].

    `over` is True for a point whose projection is inside a triangle, False for one beyond the edges of all.
    """
    spheres = np.empty((triangles.shape[0], 4))
    for t in range(triangles.shape[0]):
        spheres[t, 0], spheres[t, 1], spheres[t, 2], spheres[t, 3] = sphere(triangles[t])
    for k in range(points.shape[0]):
        distance[k], over[k] = np.inf, False
        nearest = np.inf
        for t in range(triangles.shape[0]):
            x, y, z = difference(spheres[t], points[k])
            if x * x + y * y + z * z > (nearest + spheres[t, 3]) ** 2:
                continue
            square = _square_distance(points[k], triangles[t])
            if square >= distance[k]:
                continue
            distance[k], nearest = square, np.sqrt(square) * (1.0 + 1e-9)
            n = normal(triangles[t])
            x, y, z = difference(points[k], triangles[t, 0])
            height = x * n[0] + y * n[1] + z * n[2]
            projections[k, 0], projections[k, 1], projections[k, 2] = (
                points[k, 0] - height * n[0],
                points[k, 1] - height * n[1],
                points[k, 2] - height * n[2],
            )
            over[k] = square <= height * height * (1.0 + 1e-9) + 1e-30
        distance[k] = np.sqrt(distance[k])


def _leads(edges: Any, normals: Floats, count: int) -> Floats:
    """Return the ways (v, 3) of the vertices for which all edges of the fronts move by 1 along their normals."""
    total, used = np.zeros((count, 3)), np.zeros(count)
    for k in range(2):
        np.add.at(total, edges[:, k], normals)
        np.add.at(used, edges[:, k], 1.0)
    square = np.sum(total**2, axis=1)
    # for two edges the mitre (n1 + n2) / (1 + n1 . n2), and |n1 + n2|^2 = 2 (1 + n1 . n2)
    divisor = np.where(used > 1, np.maximum(square / np.maximum(used, 1.0), MIN_MITRE), 1.0)
    return np.asarray(total / divisor[:, None])


@cached_njit(nogil=True)
def nodes_near(points, triangles, reach, near):
    """Set entries of `near` (n,) to True for points (n, 3) within a distance [m] of spheres about triangles."""
    for t in range(triangles.shape[0]):
        x, y, z, radius = sphere(triangles[t])
        limit = (reach + radius) ** 2
        for i in range(points.shape[0]):
            square = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2 + (points[i, 2] - z) ** 2
            if square < limit:
                near[i] = True


@cached_njit(nogil=True)
def nearest_normals(points, triangles, normals):
    """Write the unit normals (p, 3) of the triangles nearest to points (p, 3)."""
    spheres = np.empty((triangles.shape[0], 4))
    for t in range(triangles.shape[0]):
        spheres[t, 0], spheres[t, 1], spheres[t, 2], spheres[t, 3] = sphere(triangles[t])
    for k in range(points.shape[0]):
        best = np.inf
        for t in range(triangles.shape[0]):
            x, y, z = difference(spheres[t], points[k])
            if x * x + y * y + z * z > (np.sqrt(best) + spheres[t, 3]) ** 2:
                continue
            square = _square_distance(points[k], triangles[t])
            if square < best:
                best = square
                n = normal(triangles[t])
                normals[k, 0], normals[k, 1], normals[k, 2] = n


@cached_njit(nogil=True)
def _square_distance(point, corners):
    """Return the squared distance of a point from a triangle (Ericson, Real-Time Collision Detection, 2005)."""
    ax, ay, az = corners[0, 0], corners[0, 1], corners[0, 2]
    ux, uy, uz = corners[1, 0] - ax, corners[1, 1] - ay, corners[1, 2] - az
    vx, vy, vz = corners[2, 0] - ax, corners[2, 1] - ay, corners[2, 2] - az
    px, py, pz = point[0] - ax, point[1] - ay, point[2] - az
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    pu, pv = px * ux + py * uy + pz * uz, px * vx + py * vy + pz * vz
    det = uu * vv - uv * uv
    s, t = (vv * pu - uv * pv) / det, (uu * pv - uv * pu) / det
    if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
        x, y, z = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
        return x * x + y * y + z * z
    best = np.inf
    for k in range(3):
        m = (k + 1) % 3
        ex, ey, ez = corners[m, 0] - corners[k, 0], corners[m, 1] - corners[k, 1], corners[m, 2] - corners[k, 2]
        qx, qy, qz = point[0] - corners[k, 0], point[1] - corners[k, 1], point[2] - corners[k, 2]
        share = min(max((qx * ex + qy * ey + qz * ez) / (ex * ex + ey * ey + ez * ez), 0.0), 1.0)
        x, y, z = qx - share * ex, qy - share * ey, qz - share * ez
        best = min(best, x * x + y * y + z * z)
    return best
