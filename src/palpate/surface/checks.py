"""Surface checks: holes, folds, several parts, hollow shells and scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError
from palpate.surface.intersections import MAX_PAIRS, self_intersections
from palpate.surface.nesting import MAX_COMPONENTS, REGION_REMEDY, cavities, enclosures
from palpate.surface.surface import (
    Surface,
    SurfaceProblem,
    boundary_loops,
    components,
    directed_edges,
    part_centroids,
    part_volumes,
    pinched_vertices,
)

PLAUSIBLE_VOLUMES = (2e-6, 2e-2)  # [m^3] of an organ
TYPICAL_VOLUME = 5e-4  # [m^3] of an organ: geometric mean of an adrenal gland and a liver
OPEN_SHARE = 0.05  # volume of an organ over the cube of its diagonal, for a surface that is open
METRES_BY_UNIT = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
UNIT_FACTORS = (1e-1, 10.0, 1e-2, 100.0, 1e-3, 1000.0)  # between metres, centimetres and millimetres
# smallest mean thickness 2 V / A over the cube root of V: 0.33 for a cube, 0.12 for a plate 20 times as wide as thick
MIN_THICKNESS_RATIO = 0.05


@dataclass(frozen=True)
class SurfaceReport(Described):
    """Result of `check_surface`.

    Parameters
    ----------
    vertices, triangles, components : int
    euler : int
        Euler number: 2 for a ball, 0 with a handle.
    area, volume : float [m^2], [m^3]
    extents : tuple of float [m]
    problems : tuple of SurfaceProblem

    Examples
    --------
    >>> import palpate as pt
    >>> vertices = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    >>> triangles = [(0, 1, 2), (1, 3, 2), (4, 6, 5), (5, 6, 7), (0, 4, 1), (1, 4, 5),
    ...              (2, 3, 6), (3, 7, 6), (0, 2, 4), (2, 6, 4), (1, 5, 3), (3, 5, 7)]
    >>> surface = pt.Surface(vertices, triangles)
    >>> report = pt.io.check_surface(surface)
    >>> report.triangles, report.components, round(report.volume, 9)
    (12, 1, 0.001)
    """

    vertices: int
    triangles: int
    components: int
    euler: int
    area: float
    volume: float
    extents: tuple[float, float, float]
    problems: tuple[SurfaceProblem, ...]

    def _facts(self) -> list[Fact]:
        return [
            ("vertices", self.vertices, ""),
            ("triangles", self.triangles, ""),
            ("components", self.components, ""),
            ("volume", self.volume, "m^3"),
            ("size", self.extents, "m"),
            ("problems", [problem.name for problem in self.problems], ""),
            ("area", self.area, "m^2"),
            ("Euler number", str(self.euler), ""),
        ]

    @property
    def errors(self) -> tuple[SurfaceProblem, ...]:
        """Problems that prevent filling."""
        return tuple(problem for problem in self.problems if problem.kind == "error")


def check_surface(surface: Surface) -> SurfaceReport:
    """Return the problems of a welded surface: holes, folds, several parts, hollow shells, scale; and its repairs.

    Parameters
    ----------
    surface : Surface

    Returns
    -------
    SurfaceReport

    Examples
    --------
    >>> import palpate as pt
    >>> vertices = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    >>> triangles = [(0, 1, 2), (1, 3, 2), (4, 6, 5), (5, 6, 7), (0, 4, 1), (1, 4, 5),
    ...              (2, 3, 6), (3, 7, 6), (0, 2, 4), (2, 6, 4), (1, 5, 3), (3, 5, 7)]
    >>> surface = pt.Surface(vertices, triangles)
    >>> report = pt.io.check_surface(surface)
    >>> report.euler, report.errors
    (2, ())
    """
    edges, _ = directed_edges(surface.triangles)
    undirected = len(np.unique(np.sort(edges, axis=1), axis=0))
    problems = [*shape_problems(surface), *_crossing_problems(surface), *scale_problems(surface), *surface.repairs]
    return SurfaceReport(
        len(surface.vertices), len(surface.triangles), int(components(surface).max()) + 1,
        len(surface.vertices) - undirected + len(surface.triangles),
        surface.area, surface.volume,
        tuple(np.ptp(surface.vertices, axis=0).tolist()), tuple(problems),
    )  # fmt: skip


def shape_problems(surface: Surface) -> list[SurfaceProblem]:
    """Return the problems of edges, vertices and volumes of a welded surface: all but crossings and scale."""
    edges, _ = directed_edges(surface.triangles)
    undirected, inverse, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    turns = np.zeros(len(undirected), dtype=int)
    np.add.at(turns, inverse.ravel(), np.where(edges[:, 0] < edges[:, 1], 1, -1))
    middles = surface.vertices[undirected].mean(axis=1)
    problems = [*_open_problems(surface, undirected, count, turns, middles), *_pinch_problems(surface)]
    return problems or _volume_problems(surface, components(surface))


def _place_text(point: Floats) -> str:
    return f"({', '.join(f'{x:.4g}' for x in point)}) m"


def _open_problems(surface: Surface, edges: Ints, count: Ints, turns: Ints, middles: Floats) -> list[SurfaceProblem]:
    """Return problems of edges: open, branching and inconsistently oriented."""
    problems = []
    single, many = count == 1, count > 2
    if single.any():
        loops = boundary_loops(surface.triangles)
        sizes = ", ".join(str(len(loop)) for loop in sorted(loops, key=len, reverse=True)[:6]) or "tangled"
        problems.append(
            SurfaceProblem(
                "error", "open",
                f"the surface is open: {int(single.sum())} edges bound a hole (holes of {sizes} edges; the first near "
                f"{_place_text(middles[single][0])}); repair closes holes with a rim below 60 % of pi times the "
                "body's diagonal, edit larger ones in a mesh program",
                middles[single],
            )
        )  # fmt: skip
    if many.any():
        problems.append(
            SurfaceProblem(
                "error", "branching",
                f"{int(many.sum())} edges belong to more than two triangles (first near "
                f"{_place_text(middles[many][0])}): inner walls or doubled faces must be removed first",
                middles[many],
            )
        )  # fmt: skip
    wrong = (count == 2) & (turns != 0)
    if wrong.any():
        problems.append(
            SurfaceProblem(
                "error", "mixed orientation",
                f"{int(wrong.sum())} edges lie between triangles that disagree about the outside (first near "
                f"{_place_text(middles[wrong][0])}); repair turns them",
                middles[wrong],
            )
        )  # fmt: skip
    return problems


def _pinch_problems(surface: Surface) -> list[SurfaceProblem]:
    """Return the problem of vertices where two sheets touch in a point."""
    bad, _ = pinched_vertices(surface.triangles, len(surface.vertices))
    if not bad.size:
        return []
    return [
        SurfaceProblem(
            "error", "pinched",
            f"at {len(bad)} vertices the surface touches itself in a point (first: vertex {bad[0]} at "
            f"{_place_text(surface.vertices[bad[0]])}): repair separates the sheets there",
            surface.vertices[bad],
        )
    ]  # fmt: skip


def _volume_problems(surface: Surface, label: Ints) -> list[SurfaceProblem]:
    """Return problems of a closed surface: parts, orientation, cavities, hollow shells."""
    problems = []
    volumes = part_volumes(surface, label)
    places = part_centroids(surface, label)
    if len(volumes) > MAX_COMPONENTS:
        return [
            SurfaceProblem(
                "error", "several parts",
                f"the surface has {len(volumes)} parts of {_litres(volumes)} litres; keep at most {MAX_COMPONENTS} "
                f"(repair drops parts below a thousandth of the whole)",
                places,
            )
        ]  # fmt: skip
    cavity = cavities(enclosures(surface, label))
    wrong = (volumes > 0) == cavity
    inverted, nested = wrong & ~cavity, wrong & cavity
    if inverted.any():
        problems.append(
            SurfaceProblem(
                "error", "inside out",
                f"the surface is inside out: triangles of {int(inverted.sum())} of {len(volumes)} parts face inwards; "
                "repair turns them",
                places[inverted],
            )
        )  # fmt: skip
    if nested.any():
        problems.append(
            SurfaceProblem(
                "error", "body in a body",
                f"parts inside another face outwards, as bodies do: {int(nested.sum())}, of "
                f"{_litres(volumes[nested])} litres; repair makes them empty cavities; {REGION_REMEDY}",
                places[nested],
            )
        )  # fmt: skip
    if cavity.any():
        what = (
            f"cavities inside the tissue, which stay empty: {int(cavity.sum())}, of {_litres(volumes[cavity])} litres"
        )
        problems.append(SurfaceProblem("note", "cavities", what, places[cavity]))
    if (~cavity).sum() > 1:
        what = (
            f"{int((~cavity).sum())} separate bodies of {_litres(volumes[~cavity])} litres: each needs its own support"
        )
        problems.append(SurfaceProblem("note", "several bodies", what, places[~cavity]))
    volume = abs(surface.volume)
    thickness = 2 * volume / max(surface.area, 1e-300)
    if thickness < MIN_THICKNESS_RATIO * np.cbrt(volume) or volume == 0:
        problems.append(
            SurfaceProblem(
                "error", "hollow",
                f"the surface is a hollow shell, watertight as it is: it encloses {1e3 * volume:.3g} litres with "
                f"{1e4 * surface.area:.3g} cm^2, a wall {1e3 * thickness:.2g} mm thick on average; a solid organ has "
                f"one outer surface: remove the inner one, or choose other parts",
            )
        )  # fmt: skip
    return problems


def guessed_units(surface: Surface) -> str:
    """Return the metric unit in which the volume of a surface is nearest to that of an organ."""
    volume = max(abs(surface.volume) if surface.closed else (OPEN_SHARE * surface.size**3), 1e-300)
    away = {
        name: abs(np.log(volume * metres**3 / TYPICAL_VOLUME))
        for name, metres in METRES_BY_UNIT.items()
        if name != "in"
    }
    return min(away, key=away.__getitem__)


def _litres(volumes: Floats) -> str:
    """Return the largest volumes for a message."""
    listed = sorted(np.abs(volumes).tolist(), reverse=True)
    return ", ".join(f"{1e3 * v:.3g}" for v in listed[:6]) + ", ..." * (len(listed) > 6)


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


def scale_problems(surface: Surface) -> list[SurfaceProblem]:
    """Return the problem of a volume that is not that of an organ, unless a warning of the surface says it."""
    volume = abs(surface.volume)
    low, high = PLAUSIBLE_VOLUMES
    if low <= volume <= high:
        return []
    what = f"its volume of {1e3 * volume:.3g} litres is not that of an organ ({1e3 * low:g} to {1e3 * high:g} litres)"
    remedy = "; check the units"
    if volume > 0:
        factor = next((f for f in UNIT_FACTORS if low <= volume * f**3 <= high), None)
        remedy = (
            f"; scale={factor:g} would make it {1e3 * volume * factor**3:.3g} litres"
            if factor
            else (f"; scale={np.cbrt(TYPICAL_VOLUME / volume):.2g} would make it {1e3 * TYPICAL_VOLUME:g} litres")
        )
    if any(warning.endswith(what + remedy) for warning in surface.warnings):
        return []
    return [SurfaceProblem("note", "scale", what + remedy)]
