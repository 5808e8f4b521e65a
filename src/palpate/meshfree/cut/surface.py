"""Surfaces along which a body is cut, and the paths of its bonds round their fronts.

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
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.arrays import Floats, Ints
from palpate.code_cache import cached_njit
from palpate.describe import Described, Fact
from palpate.faults import CloudError

FRONT_LEAD = 0.2  # spacings by which a front is ahead of the edge of the cut
PIECE_LENGTH = 0.5  # longest piece of an edge that is inside or outside as a whole, in spacings
MERGE_DISTANCE = 1e-6  # of equal corners, in spacings
ON_PLANE = 1e-6  # distance from a triangle below which a node is on the side of its normal, in spacings
MIN_WIDTH = 1e-3  # least height of a triangle, in spacings
MAX_WAY = 1.6 * 2.3  # longest way round a front, in spacings
SAME_COMPONENT = 0.3  # distance of a front from the plane of its component's triangles around it, in spacings
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
    inside: Mapping[bytes, bool] = field(default_factory=dict, repr=False, compare=False)

    def _facts(self) -> list[Fact]:
        return [
            ("triangles", len(self.triangles), ""),
            ("area", float(triangle_areas(self.triangles).sum()), "m^2"),
            ("length of the fronts", float(np.linalg.norm(self.fronts[:, 1] - self.fronts[:, 0], axis=1).sum()), "m"),
        ]


NO_CUT = CutSurface(
    np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), np.zeros((0, 2, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64)
)  # fmt: skip


def swept(edges: Floats) -> Floats:
    """Return the triangles (2 (k - 1) (m - 1), 3, 3) between successive positions (k, m, 3) of an edge of m points."""
    a, b, c, d = edges[:-1, :-1], edges[1:, :-1], edges[1:, 1:], edges[:-1, 1:]
    halves = [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    return np.stack(halves, axis=1).reshape(-1, 3, 3)


def first_triangles(surface: CutSurface, count: int) -> CutSurface:
    """Return a cut surface with the first triangles only, and without the fronts of the others."""
    return replace(
        surface, triangles=surface.triangles[:count], extended=surface.extended[:count],
        components=surface.components[:count],
    )  # fmt: skip


def triangle_areas(triangles: Floats) -> Floats:
    """Return the areas (t,) [m^2] of triangles (t, 3, 3)."""
    a, b, c = (triangles[:, k] for k in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def cut_surface(
    before: CutSurface, triangles: Floats, is_inside: Callable[[Floats], NDArray[np.bool_]], spacing: float
) -> CutSurface:
    """Return the union of a cut surface and further triangles.

    Parameters
    ----------
    triangles : (t, 3, 3) array [m]
    is_inside : function
        Returns which points (p, 3) are inside the body.
    spacing : float [m]
    """
    narrow = np.flatnonzero(is_narrow(triangles, spacing))
    if narrow.size:
        raise CloudError(
            f"triangles of a cut must be at least {MIN_WIDTH * spacing:.2g} m wide, got triangle {narrow[0]} with "
            f"corners {triangles[narrow[0]].tolist()}; leave it out"
        )
    union = np.concatenate([before.triangles, triangles])
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
    components, fronts = _components(number), np.ascontiguousarray(pieces[inside])
    return CutSurface(union, moved[number], fronts, components, components[owners[owner[inside]]], known)


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
    kept = number[single]
    sides = np.concatenate([kept[:, [0, 1, 2]], kept[:, [1, 2, 0]], kept[:, [2, 0, 1]]])
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
def _difference(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@cached_njit(nogil=True)
def _length(x, y, z):  # type: ignore[no-untyped-def]
    return np.sqrt(x * x + y * y + z * z)


@cached_njit(nogil=True)
def nearest_on_cut(points, triangles, projections, distance, over):  # type: ignore[no-untyped-def]
    """Write the projections (p, 3) of points on their nearest triangles, and the distances (p,) [m].

    `over` is True for a point whose projection is inside a triangle, False for one beyond the edges of all.
    """
    for k in range(points.shape[0]):
        distance[k], over[k] = np.inf, False
        for t in range(triangles.shape[0]):
            square = _square_distance(points[k], triangles[t])
            if square >= distance[k]:
                continue
            distance[k] = square
            n = _normal(triangles[t])
            x, y, z = _difference(points[k], triangles[t, 0])
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
def nodes_near(points, triangles, reach, near):  # type: ignore[no-untyped-def]
    """Set entries of `near` (n,) to True for points (n, 3) within a distance [m] of spheres about triangles."""
    for t in range(triangles.shape[0]):
        x, y, z, radius = _sphere(triangles[t])
        limit = (reach + radius) ** 2
        for i in range(points.shape[0]):
            square = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2 + (points[i, 2] - z) ** 2
            if square < limit:
                near[i] = True


@cached_njit(nogil=True)
def _sphere(corners):  # type: ignore[no-untyped-def]
    """Return the mean of a triangle's corners, and the radius of the sphere about it that holds them."""
    x = (corners[0, 0] + corners[1, 0] + corners[2, 0]) / 3.0
    y = (corners[0, 1] + corners[1, 1] + corners[2, 1]) / 3.0
    z = (corners[0, 2] + corners[1, 2] + corners[2, 2]) / 3.0
    square = 0.0
    for k in range(3):
        square = max(square, (corners[k, 0] - x) ** 2 + (corners[k, 1] - y) ** 2 + (corners[k, 2] - z) ** 2)
    return x, y, z, np.sqrt(square)


@cached_njit(nogil=True)
def nearest_normals(points, triangles, normals):  # type: ignore[no-untyped-def]
    """Write the unit normals (p, 3) of the triangles nearest to points (p, 3)."""
    spheres = np.empty((triangles.shape[0], 4))
    for t in range(triangles.shape[0]):
        spheres[t, 0], spheres[t, 1], spheres[t, 2], spheres[t, 3] = _sphere(triangles[t])
    for k in range(points.shape[0]):
        best = np.inf
        for t in range(triangles.shape[0]):
            x, y, z = _difference(spheres[t], points[k])
            if x * x + y * y + z * z > (np.sqrt(best) + spheres[t, 3]) ** 2:
                continue
            square = _square_distance(points[k], triangles[t])
            if square < best:
                best = square
                n = _normal(triangles[t])
                normals[k, 0], normals[k, 1], normals[k, 2] = n


@cached_njit(nogil=True)
def _normal(corners):  # type: ignore[no-untyped-def]
    """Return the unit normal of a triangle, whose largest component is positive.

    It does not depend on the order of the corners: the rule for nodes on a plane is one for the whole plane.
    """
    ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    largest = x
    if abs(y) > abs(largest) * (1.0 + 1e-6):
        largest = y
    if abs(z) > abs(largest) * (1.0 + 1e-6):
        largest = z
    length = np.sqrt(x * x + y * y + z * z)
    if largest < 0.0:
        length = -length
    return x / length, y / length, z / length


@cached_njit(nogil=True)
def _square_distance(point, corners):  # type: ignore[no-untyped-def]
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


@cached_njit(nogil=True)
def _planes(triangles, planes):  # type: ignore[no-untyped-def]
    """Write the functions n . x - d, s(x) and t(x) of triangles as coefficients (t, 3, 4), and a relative slack.

    The first is the distance from the plane, the others are the coordinates of its points along two sides.
    """
    for q in range(triangles.shape[0]):
        corners, n = triangles[q], _normal(triangles[q])
        ux, uy, uz = _difference(corners[1], corners[0])
        vx, vy, vz = _difference(corners[2], corners[0])
        uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
        det = uu * vv - uv * uv
        planes[q, 0, 0], planes[q, 0, 1], planes[q, 0, 2] = n
        planes[q, 1, 0], planes[q, 1, 1] = (vv * ux - uv * vx) / det, (vv * uy - uv * vy) / det
        planes[q, 2, 0], planes[q, 2, 1] = (uu * vx - uv * ux) / det, (uu * vy - uv * uy) / det
        planes[q, 1, 2], planes[q, 2, 2] = (vv * uz - uv * vz) / det, (uu * vz - uv * uz) / det
        for k in range(3):
            planes[q, k, 3] = 0.0
            for c in range(3):
                planes[q, k, 3] -= planes[q, k, c] * corners[0, c]


@cached_njit(nogil=True)
def _value(plane, x, y, z):  # type: ignore[no-untyped-def]
    return plane[0] * x + plane[1] * y + plane[2] * z + plane[3]


@cached_njit(nogil=True, error_model="numpy")
def _find_crossed(plane, slack, tiny, ax, ay, az, x, y, z, crossed):  # type: ignore[no-untyped-def]
    """Set the entries of bonds from A that cross a triangle to 1; a node on its plane is on the side of the normal."""
    above = _value(plane[0], ax, ay, az)
    if abs(above) < tiny:
        above = tiny
    n0, n1, n2, n3 = plane[0, 0], plane[0, 1], plane[0, 2], plane[0, 3]
    s0, s1, s2, s3 = plane[1, 0], plane[1, 1], plane[1, 2], plane[1, 3]
    t0, t1, t2, t3 = plane[2, 0], plane[2, 1], plane[2, 2], plane[2, 3]
    for k in range(x.shape[0]):  # without branches, for vector registers
        value = n0 * x[k] + n1 * y[k] + n2 * z[k] + n3
        below = tiny if abs(value) < tiny else value
        share = above / (above - below)
        px, py, pz = ax + share * (x[k] - ax), ay + share * (y[k] - ay), az + share * (z[k] - az)
        s = s0 * px + s1 * py + s2 * pz + s3
        t = t0 * px + t1 * py + t2 * pz + t3
        passes = (above * value < tiny * abs(above)) & ((above > 0.0) != (below > 0.0))
        inside = (s > -slack) & (t > -slack) & (s + t < 1.0 + slack)
        crossed[k] = 1.0 if passes & inside else crossed[k]


@cached_njit(nogil=True, error_model="numpy")
def _near_fronts(fronts, ax, ay, az, most, close, table):  # type: ignore[no-untyped-def]
    """Write the numbers of fronts (e, 2, 3) near A, and what their ways depend on, (12, e); return how many they are.

    The rows are the beginning, the unit vector, the length, and of A the place along the front, the distance off its
    line, and the offset from its beginning.
    """
    count = 0
    for q in range(fronts.shape[0]):
        px, py, pz = ax - fronts[q, 0, 0], ay - fronts[q, 0, 1], az - fronts[q, 0, 2]
        if px * px + py * py + pz * pz >= most * most:
            continue
        ex, ey, ez = (
            fronts[q, 1, 0] - fronts[q, 0, 0],
            fronts[q, 1, 1] - fronts[q, 0, 1],
            fronts[q, 1, 2] - fronts[q, 0, 2],
        )
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        ex, ey, ez = ex / length, ey / length, ez / length
        along = px * ex + py * ey + pz * ez
        off = np.sqrt(max(px * px + py * py + pz * pz - along * along, 0.0))
        close[count] = q
        table[0, count], table[1, count], table[2, count] = fronts[q, 0, 0], fronts[q, 0, 1], fronts[q, 0, 2]
        table[3, count], table[4, count], table[5, count] = ex, ey, ez
        table[6, count], table[7, count], table[8, count] = length, along, off
        table[9, count], table[10, count], table[11, count] = px, py, pz
        count += 1
    return count


@cached_njit(nogil=True, error_model="numpy")
def _ways_round(dx, dy, dz, count, table, ways, feet):  # type: ignore[no-untyped-def]
    """Write the lengths of the shortest ways from A to A + d that touch each near front, and the places along them."""
    for q in range(count):  # without branches, for vector registers
        ex, ey, ez, length = table[3, q], table[4, q], table[5, q], table[6, q]
        along_a, off_a = table[7, q], table[8, q]
        qx, qy, qz = table[9, q] + dx, table[10, q] + dy, table[11, q] + dz
        along_b = qx * ex + qy * ey + qz * ez
        off_b = np.sqrt(max(qx * qx + qy * qy + qz * qz - along_b * along_b, 0.0))
        foot = (along_a * off_b + along_b * off_a) / max(off_a + off_b, 1e-12 * length)
        foot = min(max(foot, 0.0), length)
        feet[q] = foot
        da, db = along_a - foot, along_b - foot
        ways[q] = np.sqrt(off_a * off_a + da * da) + np.sqrt(off_b * off_b + db * db)


@cached_njit(nogil=True)
def _is_blocked(ax, ay, az, px, py, pz, planes, spheres, components, close, component, tiny, spacing):  # type: ignore[no-untyped-def]
    """Return whether the line from A to a place on a front crosses another component, or another part of its own."""
    for k in range(close.shape[0]):
        q = close[k]
        above, below = _value(planes[q, 0], ax, ay, az), _value(planes[q, 0], px, py, pz)
        if components[q] == component and abs(below) < SAME_COMPONENT * spacing:
            continue
        above, below = tiny if abs(above) < tiny else above, tiny if abs(below) < tiny else below
        if (above > 0.0) == (below > 0.0):
            continue
        share, slack = above / (above - below), tiny / spheres[q, 3]
        x, y, z = ax + share * (px - ax), ay + share * (py - ay), az + share * (pz - az)
        s, t = _value(planes[q, 1], x, y, z), _value(planes[q, 2], x, y, z)
        if s > -slack and t > -slack and s + t < 1.0 + slack:
            return True
    return False


@cached_njit(nogil=True)
def _shortest_free(ax, ay, az, bx, by, bz, near, front_components, most, surface, tiny, spacing):  # type: ignore[no-untyped-def]
    """Return the length of the shortest way from A to B round a near front that crosses nothing, or infinity."""
    planes, spheres, components, close = surface
    edges, table, ways, feet, count = near
    while count > 0:
        q = np.argmin(ways[:count])
        length = ways[q]
        if not length <= most:
            break
        component, foot = front_components[edges[q]], feet[q]
        px, py, pz = (
            table[0, q] + foot * table[3, q],
            table[1, q] + foot * table[4, q],
            table[2, q] + foot * table[5, q],
        )
        if not (
            _is_blocked(ax, ay, az, px, py, pz, planes, spheres, components, close, component, tiny, spacing)
            or _is_blocked(bx, by, bz, px, py, pz, planes, spheres, components, close, component, tiny, spacing)
        ):
            return length
        ways[q] = np.inf
    return np.inf


@cached_njit(nogil=True)
def bond_paths(points, nodes, start, near, triangles, components, fronts, front_components, spacing, reach, paths):  # type: ignore[no-untyped-def]
    """Write the lengths of bonds round the fronts of a cut; infinite for severed ones.

    Parameters
    ----------
    points : (n, 3) array [m]
    nodes : (m,) int array
    start : (m + 1,) int array
        First neighbour of every node.
    near : (t,) int array
        Neighbours.
    triangles : (s, 3, 3) array [m]
    components : (s,) int array
    fronts : (e, 2, 3) array [m]
    front_components : (e,) int array
    spacing, reach : float [m]
        Longest distance of neighbours.
    paths : (t,) array [m]
    """
    planes, spheres = np.empty((triangles.shape[0], 3, 4)), np.empty((triangles.shape[0], 4))
    tiny, most, longest = ON_PLANE * spacing, MAX_WAY * spacing, 0
    _planes(triangles, planes)
    for q in range(triangles.shape[0]):
        spheres[q, 0], spheres[q, 1], spheres[q, 2], spheres[q, 3] = _sphere(triangles[q])
    for m in range(nodes.shape[0]):
        longest = max(longest, start[m + 1] - start[m])
    x, y, z, crossed = np.empty(longest), np.empty(longest), np.empty(longest), np.empty(longest)
    edges, close = np.empty(fronts.shape[0], np.int64), np.empty(triangles.shape[0], np.int64)
    table, ways, feet = np.empty((12, fronts.shape[0])), np.empty(fronts.shape[0]), np.empty(fronts.shape[0])
    for m in range(nodes.shape[0]):
        ax, ay, az = points[nodes[m], 0], points[nodes[m], 1], points[nodes[m], 2]
        begin, count, triangles_near = start[m], start[m + 1] - start[m], 0
        for k in range(count):
            j = near[begin + k]
            x[k], y[k], z[k], crossed[k] = points[j, 0], points[j, 1], points[j, 2], 0.0
        for q in range(triangles.shape[0]):
            square = (spheres[q, 0] - ax) ** 2 + (spheres[q, 1] - ay) ** 2 + (spheres[q, 2] - az) ** 2
            if square < (reach + spheres[q, 3]) ** 2:
                close[triangles_near], triangles_near = q, triangles_near + 1
                if abs(_value(planes[q, 0], ax, ay, az)) <= reach + tiny:
                    slack = tiny / spheres[q, 3]
                    _find_crossed(planes[q], slack, tiny, ax, ay, az, x[:count], y[:count], z[:count], crossed[:count])
        fronts_near = -1
        for k in range(count):
            dx, dy, dz = x[k] - ax, y[k] - ay, z[k] - az
            length = _length(dx, dy, dz)
            paths[begin + k] = length
            if crossed[k] > 0.0:
                if fronts_near < 0:
                    fronts_near = _near_fronts(fronts, ax, ay, az, most + spacing, edges, table)
                _ways_round(dx, dy, dz, fronts_near, table, ways, feet)
                best = _shortest_free(
                    ax, ay, az, x[k], y[k], z[k], (edges, table, ways, feet, fronts_near), front_components, most,
                    (planes, spheres, components, close[:triangles_near]), tiny, spacing,
                )  # fmt: skip
                paths[begin + k] = max(best, length) if best <= most else np.inf


@cached_njit(nogil=True)
def first_crossings(segments, triangles, shares):  # type: ignore[no-untyped-def]
    """Write the shares of segments (s, 2, 3) at which they first cross triangles (t, 3, 3); infinite without one."""
    planes = np.empty((triangles.shape[0], 3, 4))
    _planes(triangles, planes)
    for k in range(segments.shape[0]):
        shares[k] = np.inf
        a, b = segments[k, 0], segments[k, 1]
        dx, dy, dz = _difference(b, a)
        tiny = ON_PLANE * _length(dx, dy, dz)
        for q in range(triangles.shape[0]):
            above = _value(planes[q, 0], a[0], a[1], a[2])
            below = _value(planes[q, 0], b[0], b[1], b[2])
            above = tiny if abs(above) < tiny else above
            below = tiny if abs(below) < tiny else below
            if (above > 0.0) == (below > 0.0):
                continue
            share = above / (above - below)
            x, y, z = a[0] + share * dx, a[1] + share * dy, a[2] + share * dz
            s, t = _value(planes[q, 1], x, y, z), _value(planes[q, 2], x, y, z)
            if s > -1e-6 and t > -1e-6 and s + t < 1.0 + 1e-6:
                shares[k] = min(shares[k], share)
