"""Closed triangulated surfaces of bodies."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, first_few
from palpate.core.plotting import body_svg

MAX_TRIANGLES = 2_000_000  # checked before expensive steps
WELD_TOLERANCE = 1e-6  # distance of coinciding vertices, over the size
MAX_COORDINATE = 1e9  # in any unit; beyond it volumes overflow or lose all digits
MIN_SIZE = 1e-9  # of the bounding box, in any unit
MAX_OFFSET_RATIO = 1e7  # largest coordinate over the size; beyond it WELD_TOLERANCE is not resolved


Kind = Literal["error", "note", "repair"]


@dataclass(frozen=True)
class SurfaceProblem(Described):
    """Problem of a surface, or a repair that was made.

    Parameters
    ----------
    kind : str
        ``"error"`` if the surface cannot be filled, ``"repair"`` for what was repaired, else ``"note"``.
    what : str
        Description and remedy.
    points : (k, 3) array [m]
        Positions.
    name : str
        Short name.

    Examples
    --------
    >>> import palpate as pt
    >>> vertices = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    >>> triangles = [(0, 1, 2), (1, 3, 2), (4, 6, 5), (5, 6, 7), (0, 4, 1), (1, 4, 5),
    ...              (2, 3, 6), (3, 7, 6), (0, 2, 4), (2, 6, 4), (1, 5, 3)]
    >>> surface = pt.Surface(vertices, triangles)
    >>> problem, *_ = pt.io.check_surface(surface).errors
    >>> problem.kind, problem.points.shape[1]
    ('error', 3)
    """

    kind: Kind
    name: str
    what: str
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    def _facts(self) -> list[Fact]:
        return [
            ("kind", self.kind, ""),
            ("name", self.name, ""),
            ("places", len(self.points), ""),
            ("what", self.what, ""),
        ]


@dataclass(frozen=True)
class Surface(Described):
    """Triangulated surface.

    Parameters
    ----------
    vertices : (v, 3) array [m]
    triangles : (t, 3) int array
        Counter-clockwise seen from outside.
    name : str
        Name in messages.
    warnings : tuple of str
        Assumptions in reading the surface.
    repairs : tuple of SurfaceProblem
        What was repaired, with the places.
    unit : float [m]
        Length of a unit of the file that it was read from.
    space : str
        Frame that the header of the file states, as 3D Slicer writes it: ``"LPS"``, ``"RAS"`` or none.

    Raises
    ------
    InputError
        Arrays of another shape, triangles of vertices that do not exist, too many triangles, or
        none; coordinates that are not finite, or beyond 1e9.

    Examples
    --------
    >>> import palpate as pt
    >>> vertices = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    >>> triangles = [(0, 1, 2), (1, 3, 2), (4, 6, 5), (5, 6, 7), (0, 4, 1), (1, 4, 5),
    ...              (2, 3, 6), (3, 7, 6), (0, 2, 4), (2, 6, 4), (1, 5, 3), (3, 5, 7)]
    >>> surface = pt.Surface(vertices, triangles)
    >>> surface.closed, round(surface.volume, 9), round(surface.area, 9)
    (True, 0.001, 0.06)
    """

    vertices: Floats
    triangles: Ints
    name: str = "surface"
    warnings: tuple[str, ...] = ()
    repairs: tuple[SurfaceProblem, ...] = ()
    unit: float = 1.0
    space: str = ""

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=float)
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int64)
        if triangles.size == 0 or vertices.size == 0:
            raise InputError(f"{self.name} must have triangles, got none")
        if vertices.ndim != 2 or triangles.ndim != 2 or vertices.shape[1] != 3 or triangles.shape[1] != 3:
            raise InputError(f"{self.name}: vertices and triangles must have shapes (v, 3) and (t, 3)")
        if len(triangles) > MAX_TRIANGLES:
            raise InputError(
                f"{self.name} must have at most {MAX_TRIANGLES} triangles, got {len(triangles)}; decimate it first "
                f"(30,000 are enough for an organ)"
            )
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise InputError(f"{self.name}: triangles must hold vertices in [0, {len(vertices) - 1}], got others")
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if bad.size:
            raise InputError(f"{self.name}: vertices must be finite, got other values at vertices {first_few(bad)}")
        far = np.flatnonzero((np.abs(vertices) > MAX_COORDINATE).any(axis=1))
        if far.size:
            raise InputError(
                f"{self.name}: coordinates must be at most {MAX_COORDINATE:g}, got {np.abs(vertices).max():g} at "
                f"vertices {first_few(far)}; correct or remove them"
            )
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)

    def _facts(self) -> list[Fact]:
        return [
            ("name", self.name, ""),
            ("vertices", len(self.vertices), ""),
            ("triangles", len(self.triangles), ""),
            ("size", tuple(np.ptp(self.vertices, axis=0).tolist()), "m"),
            ("volume", self.volume if self.closed else None, "m^3"),
            ("open", not self.closed or None, ""),
            ("area", self.area, "m^2"),
            ("warnings", "; ".join(self.warnings) or None, ""),
            ("repairs", "; ".join(each.what for each in self.repairs) or None, ""),
        ]

    def _picture(self) -> str:
        return body_svg(self.vertices, self.triangles)

    @property
    def area_vectors(self) -> Floats:
        """Area times outward normal of every triangle [m^2], shape (t, 3)."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return 0.5 * np.cross(b - a, c - a)

    @property
    def area(self) -> float:
        """Area [m^2]."""
        return float(np.linalg.norm(self.area_vectors, axis=1).sum())

    @cached_property
    def closed(self) -> bool:
        """Whether every edge has as many triangles in one direction as in the other."""
        edges, _ = directed_edges(self.triangles)
        low, high = edges.min(axis=1), edges.max(axis=1)
        _, edge = np.unique(low * len(self.vertices) + high, return_inverse=True)
        return not np.bincount(edge, np.where(edges[:, 0] == low, 1.0, -1.0)).any()

    @property
    def volume(self) -> float:
        """Volume inside a closed surface [m^3], by the divergence theorem; negative if it is inside out."""
        middle = self.vertices.mean(axis=0)
        heights = self.vertices[self.triangles[:, 0]] - middle
        return float(np.einsum("ta,ta->", heights, self.area_vectors) / 3)

    @property
    def size(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))


def scaled(surface: Surface, factor: float) -> Surface:
    """Return a surface with all lengths, also of its unit and repairs, multiplied by a factor."""
    repairs = tuple(replace(each, points=factor * each.points) for each in surface.repairs)
    return replace(surface, vertices=factor * surface.vertices, repairs=repairs, unit=factor * surface.unit)


def weld(surface: Surface) -> Surface:
    """Return a surface with merged vertices, without degenerate, duplicate or unused elements."""
    size = surface.size
    if size < MIN_SIZE:
        raise InputError(f"{surface.name} must be at least {MIN_SIZE:g} long, got {size:g}; correct its units")
    if np.abs(surface.vertices).max() > MAX_OFFSET_RATIO * size:
        raise InputError(
            f"{surface.name} must lie within {MAX_OFFSET_RATIO:g} times its size of the origin; move it there"
        )
    first, label = coincident_vertices(surface.vertices, size)
    triangles = label[surface.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    if len(triangles) == 0:
        raise InputError(f"{surface.name} must have triangles of positive area, got none")
    _, once = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    triangles = triangles[np.sort(once)]
    used, triangles = np.unique(triangles, return_inverse=True)
    return replace(surface, vertices=surface.vertices[first][used], triangles=triangles.reshape(-1, 3))


def coincident_vertices(vertices: Floats, size: float) -> tuple[Ints, Ints]:
    """Return the first vertex at each place, within a millionth of the size, and the place of each vertex."""
    tolerance = WELD_TOLERANCE * size
    cells = np.rint(vertices / tolerance).astype(np.int64)
    x, y, z = (cells - cells.min(axis=0)).T  # below 2^20 each
    _, first, label = np.unique((x << 42) | (y << 21) | z, return_index=True, return_inverse=True)
    pairs = cKDTree(vertices[first]).query_pairs(tolerance, output_type="ndarray")
    if len(pairs):  # of a place on the border of two cells
        graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), (len(first), len(first)))
        count, place = connected_components(graph, directed=False)
        joined = np.full(count, len(vertices))
        np.minimum.at(joined, place, first)
        first, label = joined, place[label.ravel()]
    return first, np.asarray(label.ravel(), dtype=np.int64)


def directed_edges(triangles: Ints) -> tuple[Ints, Ints]:
    """Return the directed edges (3 t, 2) of triangles and the triangle of each edge."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return edges, np.tile(np.arange(len(triangles)), 3)


def components(surface: Surface) -> Ints:
    """Return the connected component of each triangle."""
    label = vertex_components(surface.triangles, len(surface.vertices))
    return np.unique(label[surface.triangles[:, 0]], return_inverse=True)[1]


def vertex_components(triangles: Ints, n: int) -> Ints:
    """Return the connected component of each of n vertices."""
    edges, _ = directed_edges(triangles)
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def part_volumes(surface: Surface, label: Ints) -> Floats:
    """Return the volume of each part [m^3], with the numbers of `components`."""
    corners = surface.vertices[surface.triangles]
    count = np.bincount(label)
    middle = np.column_stack([np.bincount(label, corners[:, 0, a]) for a in range(3)]) / count[:, None]
    heights = corners[:, 0] - middle[label]  # from the middle of the part, against cancellation
    return np.asarray(np.bincount(label, np.einsum("ta,ta->t", heights, surface.area_vectors) / 3), dtype=float)


def part_centroids(surface: Surface, label: Ints) -> Floats:
    """Return the mean corner of each part [m], with the numbers of `components`."""
    corners = surface.vertices[surface.triangles].mean(axis=1)
    return np.column_stack([np.bincount(label, corners[:, a]) for a in range(3)]) / np.bincount(label)[:, None]


def select_triangles(surface: Surface, keep: NDArray[np.bool_]) -> Surface:
    """Return the triangles that a mask (t,) keeps, with their vertices."""
    used, triangles = np.unique(surface.triangles[keep], return_inverse=True)
    return replace(surface, vertices=surface.vertices[used], triangles=triangles.reshape(-1, 3))


def corner_fans(triangles: Ints) -> Ints:
    """Return the fan of each corner, shape (3 t,): triangles at a vertex that are connected by edges there."""
    corners, t = triangles.ravel(), len(triangles)
    number = np.arange(3 * t).reshape(t, 3)
    pairs = []
    for k in range(3):
        ahead, behind = (k + 1) % 3, (k + 2) % 3
        pairs.append((triangles[:, k], triangles[:, ahead], number[:, k]))
        pairs.append((triangles[:, k], triangles[:, behind], number[:, k]))
    centre, other, corner = (np.concatenate(each) for each in zip(*pairs, strict=True))
    order = np.lexsort((other, centre))
    centre, other, corner = centre[order], other[order], corner[order]
    same = (centre[1:] == centre[:-1]) & (other[1:] == other[:-1])
    graph = sparse.coo_matrix((np.ones(same.sum()), (corner[:-1][same], corner[1:][same])), (len(corners),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def pinched_vertices(triangles: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the vertices of n at which several sheets touch in a point, and the fan of each corner (3 t,)."""
    fan = corner_fans(triangles)
    owner = np.zeros(fan.max() + 1, dtype=np.int64)
    owner[fan] = triangles.ravel()
    return np.flatnonzero(np.bincount(owner, minlength=n) > 1), fan


def boundary_loops(triangles: Ints) -> list[list[int]]:
    """Return the boundary loops of holes; empty where boundary edges branch."""
    edges, _ = directed_edges(triangles)
    _, inverse, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    rim = edges[count[inverse.ravel()] == 1]
    following = dict(rim.tolist())
    if len(following) < len(rim):
        return []
    loops = []
    while following:
        start, vertex = following.popitem()
        loop = [start]
        while vertex != start:
            loop.append(vertex)
            if vertex not in following:
                return []
            vertex = following.pop(vertex)
        loops.append(loop)
    return loops
