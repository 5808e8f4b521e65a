"""Surface checks: holes, folds, several parts, hollow shells and scale."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components

from palpate.arrays import Floats, Ints
from palpate.faults import InputError
from palpate.meshfree.intersections import MAX_PAIRS, self_intersections
from palpate.meshfree.surfaces import Surface, boundary_loops, components, directed_edges, part_volumes

__all__ = ["SurfaceProblem", "SurfaceReport", "check_surface", "has_closed_topology"]

Kind = Literal["error", "note"]

PLAUSIBLE_VOLUMES = (2e-6, 2e-2)  # [m^3] of an organ
# smallest mean thickness 2 V / A over the cube root of V: 0.33 for a cube, 0.12 for a plate 20 times as wide as thick
MIN_THICKNESS_RATIO = 0.05


@dataclass(frozen=True)
class SurfaceProblem:
    """Problem of a surface.

    Parameters
    ----------
    kind : str
        ``"error"`` if the surface cannot be filled, else ``"note"``.
    what : str
        Description and remedy.
    points : (k, 3) array [m]
        Positions.
    name : str
        Short name.
    """

    kind: Kind
    name: str
    what: str
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True)
class SurfaceReport:
    """Result of `check_surface`.

    Parameters
    ----------
    vertices, triangles, components : int
    euler : int
        Euler number: 2 for a ball, 0 with a handle.
    area, volume : float [m^2], [m^3]
    extents : tuple of float [m]
    problems : tuple of SurfaceProblem
    """

    vertices: int
    triangles: int
    components: int
    euler: int
    area: float
    volume: float
    extents: tuple[float, float, float]
    problems: tuple[SurfaceProblem, ...]

    @property
    def errors(self) -> tuple[SurfaceProblem, ...]:
        """Problems that prevent filling."""
        return tuple(problem for problem in self.problems if problem.kind == "error")


def check_surface(surface: Surface) -> SurfaceReport:
    """Return the problems of a welded surface: holes, folds, several parts, hollow shells and scale."""
    undirected, label, problems = _topology(surface)
    parts = int(label.max()) + 1
    problems += [*_crossing_problems(surface), *_scale_problems(surface)]
    return SurfaceReport(
        len(surface.vertices), len(surface.triangles), parts,
        len(surface.vertices) - len(undirected) + len(surface.triangles),
        surface.area, surface.volume,
        tuple(np.ptp(surface.vertices, axis=0).tolist()), tuple(problems),
    )  # fmt: skip


def has_closed_topology(surface: Surface) -> bool:
    """Return whether a welded surface is one closed and oriented part; it may intersect itself."""
    return not _topology(surface)[2]


def _topology(surface: Surface) -> tuple[Ints, Ints, list[SurfaceProblem]]:
    """Return the edges (e, 2), the part of every triangle, and the problems of a surface without intersections."""
    edges, _ = directed_edges(surface.triangles)
    undirected, inverse, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    turns = np.zeros(len(undirected), dtype=int)
    np.add.at(turns, inverse.ravel(), np.where(edges[:, 0] < edges[:, 1], 1, -1))
    middles = surface.vertices[undirected].mean(axis=1)
    label = components(surface)
    problems = [
        *_open_problems(surface, undirected, count, turns, middles),
        *_pinch_problems(surface),
    ]
    if not problems:
        problems += _volume_problems(surface, label)
    return undirected, label, problems


def _place_text(point: Floats) -> str:
    return f"({', '.join(f'{x:.4g}' for x in point)}) m"


def _open_problems(surface: Surface, edges: Ints, count: Ints, turns: Ints, middles: Floats) -> list[SurfaceProblem]:
    """Return problems of edges: open, branching and inconsistently oriented."""
    found = []
    single, many = count == 1, count > 2
    if single.any():
        loops = boundary_loops(surface.triangles)
        sizes = ", ".join(str(len(loop)) for loop in sorted(loops, key=len, reverse=True)[:6]) or "tangled"
        found.append(
            SurfaceProblem(
                "error", "open",
                f"the surface is open: {int(single.sum())} edges bound a hole (holes of {sizes} edges; the first near "
                f"{_place_text(middles[single][0])}); repair closes small holes",
                middles[single],
            )
        )  # fmt: skip
    if many.any():
        found.append(
            SurfaceProblem(
                "error", "branching",
                f"{int(many.sum())} edges belong to more than two triangles (first near "
                f"{_place_text(middles[many][0])}): inner walls or doubled faces must be removed first",
                middles[many],
            )
        )  # fmt: skip
    wrong = (count == 2) & (turns != 0)
    if wrong.any():
        found.append(
            SurfaceProblem(
                "error", "mixed orientation",
                f"{int(wrong.sum())} edges lie between triangles that disagree about the outside (first near "
                f"{_place_text(middles[wrong][0])}); repair turns them",
                middles[wrong],
            )
        )  # fmt: skip
    return found


def _pinch_problems(surface: Surface) -> list[SurfaceProblem]:
    """Return the problem of vertices where two sheets touch in a point."""
    corners = surface.triangles.ravel()
    t = len(surface.triangles)
    # corners at one vertex are connected if their triangles share an edge there
    number = np.arange(3 * t).reshape(t, 3)
    pairs = []
    for k in range(3):
        ahead, behind = (k + 1) % 3, (k + 2) % 3
        pairs.append((surface.triangles[:, k], surface.triangles[:, ahead], number[:, k]))
        pairs.append((surface.triangles[:, k], surface.triangles[:, behind], number[:, k]))
    centre, other, corner = (np.concatenate(each) for each in zip(*pairs, strict=True))
    order = np.lexsort((other, centre))
    centre, other, corner = centre[order], other[order], corner[order]
    same = (centre[1:] == centre[:-1]) & (other[1:] == other[:-1])
    graph = sparse.coo_matrix((np.ones(same.sum()), (corner[:-1][same], corner[1:][same])), (3 * t, 3 * t))
    _, fan = connected_components(graph, directed=False)
    owner = np.zeros(fan.max() + 1, dtype=np.int64)
    owner[fan] = corners
    fans = np.bincount(owner, minlength=len(surface.vertices))
    bad = np.flatnonzero(fans > 1)
    if not bad.size:
        return []
    return [
        SurfaceProblem(
            "error", "pinched",
            f"at {len(bad)} vertices the surface touches itself in a point (first: vertex {bad[0]} at "
            f"{_place_text(surface.vertices[bad[0]])}): separate the sheets there",
            surface.vertices[bad],
        )
    ]  # fmt: skip


def _volume_problems(surface: Surface, label: Ints) -> list[SurfaceProblem]:
    """Return problems of a closed surface: parts, orientation, hollow shells."""
    found = []
    volumes = part_volumes(surface, label)
    if len(volumes) > 1:
        litres = ", ".join(f"{1e3 * v:.3g}" for v in sorted(volumes, key=abs, reverse=True)[:6])
        kind = "with cavities inside" if min(volumes) < 0 < max(volumes) else "side by side or inside each other"
        found.append(
            SurfaceProblem(
                "error", "several parts",
                f"the surface has {len(volumes)} parts of {litres} litres, {kind}: one solid body is needed; keep the "
                f"outer one, or fill each by itself (repair drops parts below a thousandth of the whole)",
                _part_centroids(surface, label),
            )
        )  # fmt: skip
    elif surface.volume < 0:
        found.append(
            SurfaceProblem(
                "error", "inside out", "the surface is inside out: its triangles face inwards; repair turns them"
            )
        )
    volume = abs(surface.volume)
    thickness = 2 * volume / max(surface.area, 1e-300)
    if thickness < MIN_THICKNESS_RATIO * np.cbrt(volume) or volume == 0:
        found.append(
            SurfaceProblem(
                "error", "hollow",
                f"the surface is a hollow shell, watertight as it is: it encloses {1e3 * volume:.3g} litres with "
                f"{1e4 * surface.area:.3g} cm^2, a wall {1e3 * thickness:.2g} mm thick on average; a solid organ has "
                f"one outer surface: remove the inner one",
            )
        )  # fmt: skip
    return found


def _part_centroids(surface: Surface, label: Ints) -> Floats:
    """Return the mean corner of each part."""
    corners = surface.vertices[surface.triangles].mean(axis=1)
    return np.column_stack([np.bincount(label, corners[:, a]) for a in range(3)]) / np.bincount(label)[:, None]


def _crossing_problems(surface: Surface) -> list[SurfaceProblem]:
    """Return the problem of self-intersections."""
    try:
        pairs = self_intersections(surface.vertices, surface.triangles)
    except InputError as error:
        return [SurfaceProblem("error", "tangled", str(error))]
    if not len(pairs):
        return []
    where = surface.vertices[surface.triangles[pairs]].mean(axis=(1, 2))
    many = "at least " if len(pairs) >= MAX_PAIRS else ""
    return [
        SurfaceProblem(
            "error", "self-intersecting",
            f"{many}{len(pairs)} pairs of triangles pass through each other or touch (first: triangles {pairs[0, 0]} "
            f"and {pairs[0, 1]} near {_place_text(where[0])}): repair smooths small folds",
            where,
        )
    ]  # fmt: skip


def _scale_problems(surface: Surface) -> list[SurfaceProblem]:
    volume = abs(surface.volume)
    if PLAUSIBLE_VOLUMES[0] <= volume <= PLAUSIBLE_VOLUMES[1]:
        return []
    what = f"its volume of {1e3 * volume:.3g} litres is not that of an organ; check the units"
    return [SurfaceProblem("note", "scale", what)]
