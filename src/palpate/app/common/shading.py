"""Light, colours and smoothing of the page (page/src/shaders.js, colours.js), for pictures drawn off-screen.

Colours are computed at the vertices of a refined surface, and drawn without further light. So every picture has the
light of the page, which is fixed to the camera, whatever the graphics driver does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix

from palpate.core.arrays import Floats, Ints

if TYPE_CHECKING:
    from matplotlib.colors import ListedColormap

INK, QUIET = "#1b1f23", "#646b73"  # text, and quieter text
TISSUE = np.array([0.43, 0.15, 0.12])  # reflectance of tissue, sRGB
STEEL = np.array([0.914, 0.925, 0.933])  # of a tool
TOOL_COLOURS = np.array([STEEL, [0.35, 0.78, 0.76], [0.95, 0.75, 0.35], [0.72, 0.62, 0.92]])  # by index, as on the page
SUPPORT = np.array([0.30, 0.23, 0.20])  # reflectance of a support, linear
FRONT = np.array([1.76, 1.61, 1.58])  # light on tissue that faces the eye
FLAT_LIGHT, FLAT_FROM = 1.02, 0.35  # light where values are shown, and the share of the range from which it is flat
ABOVE = np.array([[0.76, 0.32, 0.11], [0.91, 0.53, 0.16], [0.97, 0.76, 0.38], [1, 0.96, 0.82]])  # 1/4 to 4/4 of range
BELOW = np.array([[0.4, 0.35, 0.55], [0.36, 0.52, 0.8], [0.56, 0.76, 0.95], [0.86, 0.96, 1]])
KEY, FILL = (np.array(v) / np.linalg.norm(v) for v in ([-0.42, 0.68, 0.60], [0.75, 0.12, 0.52]))
EYE = np.array([0.0, 0.0, 1.0])

CREASE_ANGLE = 75.0  # [degree] between triangles, from which an edge is sharp
MAX_TRIANGLES = 60_000  # after refinement
MAX_REFINEMENTS = 3
ROUND_STEPS = (1, 1.5, 2, 3, 4, 5, 6, 8, 10)  # ends of a colour scale, over a power of ten


def _linear(part: Floats) -> Floats:
    return np.maximum(part, 0.0) ** 2.2


def _encoded(part: Floats) -> Floats:
    return np.where(part <= 0.0031308, 12.92 * part, 1.055 * np.maximum(part, 1e-12) ** (1 / 2.4) - 0.055)


def _smoothstep(low: float, high: float, x: Floats) -> Floats:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


STOPS = np.vstack([BELOW[::-1], _encoded(FRONT * _linear(TISSUE)), ABOVE])  # colours from -1 to 1


def colour_at(t: Floats) -> Floats:
    """Return sRGB colours (..., 3) from 0 to 1 for shares of the range from -1 to 1; 0 is tissue at rest."""
    places = np.linspace(-1, 1, len(STOPS))
    return np.stack([np.interp(t, places, STOPS[:, k]) for k in range(3)], axis=-1)


def colour_map(signed: bool = False) -> ListedColormap:
    """Return the colours as a map of matplotlib, from zero or from minus the range."""
    from matplotlib.colors import ListedColormap

    return ListedColormap(np.clip(colour_at(np.linspace(-1.0 if signed else 0.0, 1.0, 256)), 0, 1), "tissue")


def round_up(value: float) -> float:
    """Return the smallest of `ROUND_STEPS` times a power of ten that is not below a positive number."""
    decade = 10.0 ** np.floor(np.log10(value) + 1e-9)
    return float(f"{decade * next(step for step in ROUND_STEPS if value <= step * decade * (1 + 1e-9)):.1e}")


def _lambert(normals: Floats, light: Floats, wrap: Floats | float) -> Floats:
    """Return the light (n, 1 or 3) from a direction, which also reaches around the edge of the shadow."""
    return np.maximum(((normals @ light)[:, None] + wrap) / (1 + wrap), 0.0)


def _shine(normals: Floats, light: Floats, power: float) -> Floats:
    half = (light + EYE) / np.linalg.norm(light + EYE)
    return np.maximum(normals @ half, 0.0)[:, None] ** power


def shade(
    normals: Floats,
    camera: Floats,
    values: Floats | None = None,
    fixed: Floats | None = None,
    places: Floats | None = None,
    colours: Floats | None = None,
) -> NDArray[np.uint8]:
    """Return the colours (n, 3) of lit tissue, by the unit normals (n, 3) of its surface.

    The rows of `camera` (3, 3) are unit vectors to the right, up, and towards the camera; z points up in space.
    `values` (n,) from -1 to 1 are shown as colours, tissue by default; `colours` (n, 3) from 0 to 1 replace them.
    `fixed` (n,) is 1 at a support and 0 elsewhere. `places` (n, 3), at rest over the size of the body, mottle the
    tissue.
    """
    n = normals @ camera.T
    n = np.where(n[:, 2:] < 0, -n, n)  # towards the eye
    t = np.zeros(len(n)) if values is None else np.clip(values, -1.0, 1.0)
    covered = _smoothstep(0.0, FLAT_FROM, np.abs(t))[:, None]
    shown = colour_at(t)
    if colours is not None:
        covered, shown = np.ones((len(n), 1)), colours
    albedo = _linear(shown) / (FRONT + covered * (FLAT_LIGHT - FRONT))
    matte = np.zeros((len(n), 1)) if fixed is None else _smoothstep(0.4, 0.6, fixed)[:, None]
    wet = np.ones((len(n), 1))
    if places is not None:
        mottled = 0.84 + 0.32 * (0.6 * _noise(9 * places) + 0.4 * _noise(31 * places))
        albedo *= mottled[:, None] + covered * (1 - mottled[:, None])
        wet = (0.6 + 0.7 * _noise(14 * places + 7))[:, None]
    albedo += 0.6 * matte * (1 - covered) * (SUPPORT - albedo)
    # light scatters below the surface, most of all red light
    wrap = np.array([0.52, 0.24, 0.20]) + covered * (0.35 - np.array([0.52, 0.24, 0.20]))
    sky = (0.5 + 0.5 * n @ camera[:, 2])[:, None]
    ground = np.array([0.20, 0.17, 0.16])
    light = 1.75 * _lambert(n, KEY, wrap) ** 1.3 * [1.0, 0.97, 0.93]
    light = light + 0.38 * _lambert(n, FILL, wrap) * [0.88, 0.94, 1.0]
    light += ground + sky * (np.array([0.40, 0.42, 0.46]) - ground)
    light += covered * (0.42 + 0.36 * light - light)  # keeps colours readable on the legend
    edge = (1 - np.clip(n[:, 2:], 0.0, 1.0)) ** 4
    shine = 0.24 * _shine(n, KEY, 90) + 0.035 * _shine(n, KEY, 16) + 0.03 * _shine(n, FILL, 26)
    gloss = wet * (1 - 0.7 * covered) * (1 - matte) * shine
    rim = edge * (1 - 0.6 * covered) * (0.07 * np.array([1.0, 0.84, 0.80]) + 0.6 * albedo) * (0.3 + 0.7 * sky)
    return _bytes(albedo * light + gloss + rim)


def shade_tool(normals: Floats, camera: Floats, colour: Floats = STEEL) -> NDArray[np.uint8]:
    """Return the colours (n, 3) of a rigid tool with unit normals (n, 3), in a camera as of `shade`."""
    n = normals @ camera.T
    light = 0.85 * _lambert(n, KEY, 0.35) + 0.22 * _lambert(n, FILL, 0.3) + 0.20
    rim = 0.16 * (1 - np.clip(n[:, 2:], 0.0, 1.0)) ** 3
    return _bytes(_linear(colour) * light + 0.5 * _shine(n, KEY, 120) + rim)


def triangle_mesh(points: ArrayLike, triangles: ArrayLike) -> Any:
    """Return PyVista's mesh of points (n, 3) [m] and triangles (t, 3)."""
    import pyvista

    make: Any = pyvista.PolyData.from_regular_faces
    return make(points, triangles)


def _bytes(light: Floats) -> NDArray[np.uint8]:
    return np.rint(255 * _encoded(np.clip(light, 0.0, 1.0))).astype(np.uint8)


def _noise(x: Floats) -> Floats:
    """Return smooth noise (n,) from 0 to 1 at points (n, 3), interpolated from random values at integers."""
    low = np.floor(x)
    f = x - low
    f = f * f * (3 - 2 * f)
    total = np.zeros(len(x))
    for corner in np.ndindex(2, 2, 2):
        p = (low + corner) * 0.3183099 + 0.1
        p = 17 * (p - np.floor(p))
        mixed = p.prod(axis=1) * p.sum(axis=1)
        total += np.where(np.array(corner) == 1, f, 1 - f).prod(axis=1) * (mixed - np.floor(mixed))
    return total


class RefinedSurface:
    """A triangulated surface in smaller triangles, on the curved patches of Vlachos et al. (I3D, 2001).

    Its vertices `rest` are (n, 3) [m]. Sharp edges of the surface at rest stay sharp. The attribute `triangles` (s, 3)
    holds the smaller ones.
    """

    def __init__(self, rest: ArrayLike, triangles: ArrayLike) -> None:
        self._origin, corners = _split_creases(np.asarray(rest, dtype=float), np.asarray(triangles, dtype=np.int64))
        self._levels: list[tuple[Ints, Ints, Any]] = []  # edges, whether each is inside (e, 1), and sums at vertices
        count = len(self._origin)
        while len(self._levels) < MAX_REFINEMENTS and 4 * len(corners) <= MAX_TRIANGLES:
            sides = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
            edges, place, uses = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
            self._levels.append((edges, (uses == 2)[:, None], (corners, _sums(corners, count))))
            ab, bc, ca = (count + place.reshape(-1, 3)).T
            a, b, c = corners.T
            parts = ([a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca])
            corners = np.concatenate([np.column_stack(part) for part in parts])
            count += len(edges)
        self.triangles = corners
        self._last = (corners, _sums(corners, count))

    def values(self, values: ArrayLike) -> Floats:
        """Return values (m, ...) at the refined vertices, interpolated linearly from those at the vertices."""
        result = np.asarray(values, dtype=float)[self._origin]
        for edges, _, _ in self._levels:
            result = np.concatenate([result, 0.5 * (result[edges[:, 0]] + result[edges[:, 1]])])
        return result

    def places(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """Return positions [m] and unit normals (m, 3) of the refined vertices for positions (n, 3) [m]."""
        p = np.asarray(points, dtype=float)[self._origin]
        for edges, inside, around in self._levels:
            n = _normals(p, *around)
            a, b = edges.T
            along = p[b] - p[a]
            bend = _rise(along, n[a]) - _rise(along, n[b])
            p = np.concatenate([p, 0.5 * (p[a] + p[b]) - np.where(inside, bend / 8, 0.0)])
        return p, _normals(p, *self._last)


def _rise(along: Floats, normals: Floats) -> Floats:
    """Return the part of edges along normals (e, 3), none at a crease."""
    rise = np.einsum("ek,ek->e", along, normals)
    smooth = 1 - _smoothstep(0.4, 0.65, np.abs(rise) / np.maximum(np.linalg.norm(along, axis=1), 1e-30))
    return (smooth * rise)[:, None] * normals


def _sums(corners: Ints, count: int) -> Any:
    """Return the matrix that adds values of the corners of triangles, first corners first, at vertices."""
    size = corners.size
    return csr_matrix((np.ones(size), (corners.T.ravel(), np.arange(size))), shape=(count, size))


def _normals(p: Floats, corners: Ints, sums: Any) -> Floats:
    """Return unit normals at vertices, exact on a sphere (Max, J. Graph. Tools 4, 1999)."""
    parts = []
    for first in range(3):
        corner, *others = (p[corners[:, (first + k) % 3]] for k in range(3))
        a, b = (other - corner for other in others)
        parts.append(np.cross(a, b) / np.maximum((a * a).sum(axis=1) * (b * b).sum(axis=1), 1e-30)[:, None])
    total = sums @ np.concatenate(parts)
    return total / np.maximum(np.linalg.norm(total, axis=1), 1e-30)[:, None]


def _split_creases(rest: Floats, triangles: Ints) -> tuple[Ints, Ints]:
    """Return the vertex of which each vertex is a copy, and triangles whose sharp edges share no vertices."""
    body = triangle_mesh(rest, triangles)
    body.point_data["origin"] = np.arange(len(rest))
    split = body.compute_normals(
        cell_normals=False,
        split_vertices=True,
        feature_angle=CREASE_ANGLE,
        consistent_normals=False,
        auto_orient_normals=False,
    )
    return np.asarray(split.point_data["origin"], dtype=np.int64), split.regular_faces.astype(np.int64)
