"""Closed surfaces: what a body is before it is filled with nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from palpate.arrays import Floats, Ints
from palpate.describe import Described, Fact
from palpate.faults import InputError, first_few
from palpate.plotting import body_svg

__all__ = ["MOST_TRIANGLES", "Surface", "components", "halves", "part_of", "part_volumes", "rims", "welded"]


MOST_TRIANGLES = 2_000_000  # more are refused before anything slow
SAME = 1e-6  # of the size: vertices nearer than that are one
FARTHEST = 1e9  # largest coordinate, in any unit: beyond, volumes overflow or lose all digits
SMALLEST = 1e-9  # size
AWAY = 1e7  # largest coordinate over the size: beyond, SAME is not resolved


@dataclass(frozen=True)
class Surface(Described):
    """Triangles in space.

    Parameters
    ----------
    vertices : (v, 3) array [m]
    triangles : (t, 3) int array
        Seen from outside counter-clockwise.
    name : str
        For messages.
    warnings : tuple of str
        What was assumed when it was read.

    Raises
    ------
    InputError
        Arrays of another shape, triangles of vertices that do not exist, too many triangles, or none; coordinates
        that are not finite, or beyond 1e9.
    """

    vertices: Floats
    triangles: Ints
    name: str = "surface"
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=float)
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int64)
        if triangles.size == 0 or vertices.size == 0:
            raise InputError(f"{self.name} is empty: it has no triangles")
        if vertices.ndim != 2 or triangles.ndim != 2 or vertices.shape[1] != 3 or triangles.shape[1] != 3:
            raise InputError(f"{self.name}: vertices and triangles must have shapes (v, 3) and (t, 3)")
        if len(triangles) > MOST_TRIANGLES:
            raise InputError(
                f"{self.name} has {len(triangles)} triangles; at most {MOST_TRIANGLES} are taken: decimate it first "
                f"(30,000 are enough for an organ)"
            )
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise InputError(f"{self.name}: triangles name vertices outside 0..{len(vertices) - 1}")
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if bad.size:
            raise InputError(f"{self.name}: vertices {first_few(bad)} are not finite")
        far = np.flatnonzero((np.abs(vertices) > FARTHEST).any(axis=1))
        if far.size:
            raise InputError(
                f"{self.name}: coordinates must be at most {FARTHEST:g}, got {np.abs(vertices).max():g} at vertices "
                f"{first_few(far)}; correct or remove them"
            )
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)

    def _facts(self) -> list[Fact]:
        return [
            ("name", self.name, ""),
            ("vertices", len(self.vertices), ""),
            ("triangles", len(self.triangles), ""),
            ("size", tuple(np.ptp(self.vertices, axis=0).tolist()), "m"),
            ("volume", self.volume, "m^3"),
            ("area", self.area, "m^2"),
            ("warnings", "; ".join(self.warnings) or None, ""),
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

    @property
    def volume(self) -> float:
        """Volume inside [m^3], by the divergence theorem; negative if the surface is inside out."""
        middle = self.vertices.mean(axis=0)
        heights = self.vertices[self.triangles[:, 0]] - middle
        return float(np.einsum("ta,ta->", heights, self.area_vectors) / 3)

    @property
    def size(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))


def welded(surface: Surface) -> Surface:
    """Return a surface whose coinciding vertices are one, without degenerate, double or unused parts.

    Raises
    ------
    InputError
        Nothing is left, or it is too small or too far from the origin.
    """
    size = surface.size
    if size < SMALLEST:
        raise InputError(f"{surface.name} must be at least {SMALLEST:g} long, got {size:g}; correct its units")
    if np.abs(surface.vertices).max() > AWAY * size:
        raise InputError(f"{surface.name} must lie within {AWAY:g} times its size of the origin; move it there")
    cells = np.rint(surface.vertices / (SAME * size)).astype(np.int64)
    x, y, z = (cells - cells.min(axis=0)).T  # below 2^20 each
    _, first, inverse = np.unique((x << 42) | (y << 21) | z, return_index=True, return_inverse=True)
    triangles = inverse.ravel()[surface.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    if len(triangles) == 0:
        raise InputError(f"{surface.name} has no triangle with an area")
    _, once = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    triangles = triangles[np.sort(once)]
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices = surface.vertices[first][used]
    return Surface(vertices, triangles.reshape(-1, 3), surface.name, surface.warnings)


def halves(triangles: Ints) -> tuple[Ints, Ints]:
    """Return the directed edges (3 t, 2) of triangles, and for each the triangle it belongs to."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return edges, np.tile(np.arange(len(triangles)), 3)


def components(surface: Surface) -> Ints:
    """Number of the connected part that each triangle belongs to."""
    edges, _ = halves(surface.triangles)
    n = len(surface.vertices)
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (n, n))
    _, label = connected_components(graph, directed=False)
    return np.unique(label[surface.triangles[:, 0]], return_inverse=True)[1]


def part_volumes(surface: Surface, label: Ints) -> Floats:
    """Return the volume of each part [m^3]; parts are numbered as `components` does."""
    corners = surface.vertices[surface.triangles]
    count = np.bincount(label)
    middle = np.column_stack([np.bincount(label, corners[:, 0, a]) for a in range(3)]) / count[:, None]
    heights = corners[:, 0] - middle[label]  # from within the part, against cancellation
    return np.asarray(np.bincount(label, np.einsum("ta,ta->t", heights, surface.area_vectors) / 3), dtype=float)


def part_of(surface: Surface, keep: NDArray[np.bool_]) -> Surface:
    """Return the triangles that a mask (t,) keeps, with their vertices."""
    used, triangles = np.unique(surface.triangles[keep], return_inverse=True)
    return Surface(surface.vertices[used], triangles.reshape(-1, 3), surface.name, surface.warnings)


def rims(triangles: Ints) -> list[list[int]]:
    """Holes as closed walks along edges of one triangle; empty where such edges branch."""
    edges, _ = halves(triangles)
    _, inverse, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    rim = edges[count[inverse.ravel()] == 1]
    following = dict(rim.tolist())
    if len(following) < len(rim):
        return []
    loops = []
    while following:
        start, here = following.popitem()
        loop = [start]
        while here != start:
            loop.append(here)
            if here not in following:
                return []
            here = following.pop(here)
        loops.append(loop)
    return loops
