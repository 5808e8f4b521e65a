"""Drawings of arrays: figures with matplotlib, and small SVG pictures for notebooks.

Objects of all layers draw themselves by these functions, which take arrays alone. matplotlib is imported when a figure
is requested; SVG pictures require no package.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.extras import require

BLUE, GREY = "#0072B2", "#888888"
SVG_WIDTH, SVG_HEIGHT, SVG_MARGIN = 320, 200, 34  # [px] of an SVG picture
VIEW_ZOOM, MAX_INTERVALS = 0.92, 4  # of a body in a figure, so that labels have space; between ticks of an axis
MAX_SHAPES = 2500  # of an SVG picture, which stays below some 200 kB
MAX_POINTS = 300  # of a curve in an SVG picture
# rows: right and up, from 30 degrees above the xy plane
VIEW_MATRIX = np.array([[0.866, 0.5, 0.0], [-0.25, 0.433, 0.866]])
LIGHT_DIRECTION = np.array([0.3, -0.5, 0.81])  # direction to the light of a figure
TOWARDS_VIEWER = np.cross(VIEW_MATRIX[0], VIEW_MATRIX[1])  # the viewer


def plot_curves(times: Floats, series: Mapping[str, Floats], label: str, axes: Any = None) -> Any:
    """Plot values (f,) over times (f,) [s], and return the axes; `label` of the vertical one has its unit."""
    axes = _axes(axes)
    for name, values in series.items():
        axes.plot(times, values, label=name)
    axes.set(xlabel="time [s]", ylabel=label)
    if len(series) > 1:
        axes.legend()
    return axes


def plot_fit(
    measured: tuple[Floats, Floats], fitted: tuple[Floats, Floats], labels: tuple[str, str], name: str, axes: Any = None
) -> Any:
    """Plot measured points and a fitted curve, pairs of abscissae and ordinates, and return the axes.

    `labels` are those of the axes, with units; `name` is that of the points.
    """
    axes = _axes(axes)
    axes.plot(*measured, "o", color=GREY, mfc="none", label=name)
    axes.plot(*fitted, color=BLUE, label="fit")
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.legend()
    return axes


def plot_singular_values(values: Floats, modes: int, axes: Any = None) -> Any:
    """Plot singular values over the first one; those of the modes that are kept are filled. Returns the axes."""
    axes = _axes(axes)
    numbers, relative = np.arange(1, len(values) + 1), values / values[0]
    axes.semilogy(numbers[:modes], relative[:modes], "o", color=BLUE, label=f"{modes} modes kept")
    if len(values) > modes:
        axes.semilogy(numbers[modes:], relative[modes:], "o", color=GREY, mfc="none", label="others")
    axes.set(xlabel="mode", ylabel="singular value over the first")
    axes.legend()
    return axes


def plot_body(points: Floats, triangles: Ints, axes: Any = None, values: Floats | None = None, label: str = "") -> Any:
    """Draw the surface of a body in space, or the nodes (n, 3) [m] of one without triangles, and return the axes.

    Values (n,) at the points give colours; `label` is what they are, with the unit. If some are negative, white is 0.
    """
    axes = _axes(axes, projection="3d")
    colours: dict[str, Any] = {}
    if values is not None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        high, low = float(values.max()), float(values.min())
        most = max(high, -low) or 1.0
        limits, name = (Normalize(-most, most), "RdBu_r") if low < 0 else (Normalize(0.0, most), "viridis")
        scale = ScalarMappable(limits, name)
        axes.figure.colorbar(scale, ax=axes, label=label, shrink=0.6, pad=0.12)
        colours = {"rgb": scale.to_rgba(values[triangles].mean(axis=1) if len(triangles) else values)}
    x, y, z = points.T
    if not len(triangles):
        axes.scatter(x, y, z, s=4, color=colours.get("rgb", BLUE))
    elif values is None:
        axes.plot_trisurf(x, y, z, triangles=triangles, color="#9ecae1", edgecolor=GREY, linewidth=0.2)
    else:
        surface = axes.plot_trisurf(x, y, z, triangles=triangles, linewidth=0.2)
        surface.set_facecolor(_shaded(colours["rgb"], points[triangles]))
        surface.set_edgecolor((0.0, 0.0, 0.0, 0.15))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    lengths = {name: float(np.ptp(getattr(axes, f"get_{name}lim3d")())) for name in "xyz"}
    axes.set_box_aspect(tuple(lengths.values()), zoom=VIEW_ZOOM)  # one scale for all axes
    for name, length in lengths.items():
        axes.locator_params(axis=name, nbins=max(1, round(MAX_INTERVALS * length / max(lengths.values()))))
    return axes


def _shaded(colours: Floats, corners: Floats) -> Floats:
    """Return colours (t, 4) of triangles with corners (t, 3, 3), darker where they face away from the light."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    light = 0.82 + 0.18 * (normals @ LIGHT_DIRECTION)
    return np.column_stack([colours[:, :3] * light[:, None], colours[:, 3]])


def _axes(axes: Any, **options: Any) -> Any:
    """Return the axes that are given, or new ones."""
    if axes is not None:
        return axes
    require("matplotlib", "plot")
    import matplotlib.pyplot

    return matplotlib.pyplot.subplots(subplot_kw=options, layout="constrained")[1]


def curve_svg(x: Floats, y: Floats, across: str, up: str, *, logarithmic: bool = False) -> str:
    """Return a small picture of a curve with the ranges of both axes; nothing of fewer than two points.

    `across` and `up` are what `x` and `y` are, with units. If `logarithmic`, positive `y` are drawn by their logarithm.
    """
    few = np.unique(np.linspace(0, len(x) - 1, MAX_POINTS).astype(int)) if len(x) else np.zeros(0, dtype=int)
    x, y = np.asarray(x, dtype=float)[few], np.asarray(y, dtype=float)[few]
    heights = np.log10(np.maximum(y, 1e-300)) if logarithmic else y
    if len(x) < 2 or not (np.isfinite(x).all() and np.isfinite(heights).all()):
        return ""
    right, top = (float(np.ptp(values)) or 1.0 for values in (x, heights))
    places = np.column_stack(
        [
            SVG_MARGIN + (x - x.min()) / right * (SVG_WIDTH - 2 * SVG_MARGIN),
            SVG_HEIGHT - SVG_MARGIN - (heights - heights.min()) / top * (SVG_HEIGHT - 2 * SVG_MARGIN),
        ]
    )
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in places)
    low, high = SVG_HEIGHT - SVG_MARGIN, SVG_MARGIN
    return _svg(
        f'<path d="M{SVG_MARGIN} {high}V{low}H{SVG_WIDTH - SVG_MARGIN}" fill="none" stroke="{GREY}"/>'
        f'<polyline points="{line}" fill="none" stroke="{BLUE}" stroke-width="1.5"/>'
        + _text(SVG_MARGIN, high - 8, "start", f"{up}: {y.min():.3g} to {y.max():.3g}")
        + _text(SVG_MARGIN, low + 18, "start", f"{across}: {x.min():.3g} to {x.max():.3g}")
    )


def body_svg(points: Floats, triangles: Ints) -> str:
    """Return a small picture of a body from its front corner: its surface, or where that is fine, its nodes.

    The points are (n, d) [m], d = 2 or 3. The triangles (t, 3) of these nodes are counter-clockwise from outside.
    """
    plane = points.shape[1] == 2
    space = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    seen = np.column_stack([space[:, 0], space[:, 1]]) if plane else space @ VIEW_MATRIX.T
    low, size = seen.min(axis=0), np.ptp(seen, axis=0)
    scale = min(
        (SVG_WIDTH - 2 * SVG_MARGIN) / max(size[0], 1e-300), (SVG_HEIGHT - 2 * SVG_MARGIN) / max(size[1], 1e-300)
    )
    left, bottom = (SVG_WIDTH - scale * size[0]) / 2, (SVG_HEIGHT + scale * size[1]) / 2
    places = np.column_stack([left + scale * (seen[:, 0] - low[0]), bottom - scale * (seen[:, 1] - low[1])])
    depth = np.zeros(len(space)) if plane else space @ TOWARDS_VIEWER
    corners = space[triangles]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    front = np.arange(len(triangles)) if plane else np.flatnonzero(vectors @ TOWARDS_VIEWER > 0)
    if 0 < len(front) <= MAX_SHAPES:
        shades = np.clip(0.75 + 0.25 * vectors[front] @ np.array([0.3, -0.2, 0.93]), 0.4, 1.0)
        shapes = list(zip(places[triangles[front]], shades.tolist(), strict=True))
        order = np.argsort(depth[triangles[front]].mean(axis=1))
        drawn = "".join(_triangle(*shapes[k]) for k in order)
    else:
        few = np.linspace(0, len(space) - 1, min(len(space), MAX_SHAPES)).astype(int)
        near = (depth - depth.min()) / (float(np.ptp(depth)) or 1.0)
        drawn = "".join(
            f'<circle cx="{places[k, 0]:.1f}" cy="{places[k, 1]:.1f}" r="1.6" fill="{_shade(0.5 + 0.5 * near[k])}"/>'
            for k in few[np.argsort(depth[few])]
        )
    return _svg(drawn)


def _triangle(places: Floats, shade: float) -> str:
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in places)
    return f'<polygon points="{line}" fill="{_shade(shade)}" stroke="{GREY}" stroke-width="0.3"/>'


def _shade(share: float) -> str:
    return "#" + "".join(f"{round(share * part):02x}" for part in (178, 210, 235))


def _text(x: float, y: float, anchor: str, said: str) -> str:
    at = f'x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}"'
    return f'<text {at} font-size="11" font-family="sans-serif" fill="{GREY}">{escape(said)}</text>'


def _svg(content: str) -> str:
    size = f'width="{SVG_WIDTH}" height="{SVG_HEIGHT}" viewBox="0 0 {SVG_WIDTH} {SVG_HEIGHT}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">{content}</svg>'
