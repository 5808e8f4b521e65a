"""The picture of the deflected membrane, drawn off-screen (Figure 9)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.figures import BLUE, ORANGE, figure, heading, scale_bar
from palpate.app.common.rendering import (
    PIXELS,
    add_colour_bar,
    add_shaded,
    check_drawing,
    off_screen,
    place_picture,
    screenshot,
)
from palpate.app.common.shading import RefinedSurface, triangle_mesh
from palpate.app.studies.study import PROJECTED, Study
from palpate.core.arrays import Floats
from palpate.meshfree.cloud import Cloud
from palpate.scenes.membrane import RADIUS

if TYPE_CHECKING:
    from matplotlib.axes import Axes


FULL = "Full model"
HEIGHT_SCALE = 4.0  # scale of heights over lengths
ELEVATION = 25.0  # [degree] of the camera above the horizon
MIN_DRAWN_RANGE = 0.03  # range of deflections over a ring, as a share of the largest, from which it is drawn
PICTURE_WIDTH = 2.1 * RADIUS  # [m] width of a picture


def draw_deflection(studies: Sequence[Study], path: Path) -> None:
    """Draw the deflected membrane when the tool has pushed, full and reduced, and its profile over the radius."""
    check_drawing()
    study = studies[0]
    cloud, run = study.case.model.cloud, study.parts[0]
    drawn_ones = {FULL: run.displacements[-1]}
    shown = study.shown.get(PROJECTED)
    if shown is not None:
        drawn_ones = {f"Reduced model, {shown.modes} modes": shown.runs[0].displacements[-1]} | drawn_ones
    limit = max(float(np.abs(u[:, 2]).max()) for u in drawn_ones.values())
    with figure(path, (10.5, 6.6)) as drawn:
        heading(drawn, f"Membrane at {1e3 * run.times[-1]:.0f} ms (paper: Figure 9)")
        grid = drawn.add_gridspec(2, 2, height_ratios=[1, 1])
        views = []
        for place, (name, displacement) in enumerate(drawn_ones.items()):
            views.append(drawn.add_subplot(grid[0, place]))
            _picture(views[-1], cloud, displacement, limit, name)
        text = f"deflection [mm].   Heights are scaled by {HEIGHT_SCALE:g}.   Lines: every 1 mm."
        add_colour_bar(drawn, views, 1e3 * limit, text, shrink=0.5, aspect=45)
        _plot_profile(drawn.add_subplot(grid[1, :]), cloud, drawn_ones)


def _picture(axes: Axes, cloud: Cloud, displacement: Floats, limit: float, title: str) -> None:
    """Draw the deflected sheet with bars of 50 mm along it and 5 mm across."""
    angle, reach = np.radians(ELEVATION), 1e3 * PICTURE_WIDTH / 2
    low = -1.15 * RADIUS * np.sin(angle)
    high = max(1.15 * RADIUS * np.sin(angle), HEIGHT_SCALE * limit * np.cos(angle) + 0.1 * RADIUS)
    picture = _render(cloud, displacement, limit, low, high)
    place_picture(axes, picture, (-reach, reach, 1e3 * low, 1e3 * high), title)
    scale_bar(axes, -reach, reach, 0.97e3 * low)
    tall, at = 5.0 * HEIGHT_SCALE * np.cos(angle), -0.97 * reach
    axes.plot([at, at], [0.97e3 * low, 0.97e3 * low + tall], color="black", lw=2.5, solid_capstyle="butt")
    placing = {"textcoords": "offset points", "ha": "left", "va": "center", "fontsize": 9}
    axes.annotate("5 mm high", (at, 0.97e3 * low + tall / 2), (5, 0), **placing)  # type: ignore[arg-type]


def _render(cloud: Cloud, displacement: Floats, limit: float, low: float, high: float) -> NDArray[np.uint8]:
    """Draw the sheet in a parallel projection, from `low` to `high` [m] in the plane of the picture."""
    angle = np.radians(ELEVATION)
    towards = np.array([0.0, -np.cos(angle), np.sin(angle)])  # the camera
    points = np.column_stack([cloud.points, np.zeros(len(cloud))]) + displacement * (1.0, 1.0, HEIGHT_SCALE)
    sheet = triangle_mesh(points, cloud.triangles)
    sheet["deflection"] = 1e3 * displacement[:, 2]
    middle = np.array([0.0, 0.0, (low + high) / 2 / np.cos(angle)])

    def colours(refined: RefinedSurface) -> dict[str, Floats]:
        return {"values": refined.values(displacement[:, 2] / limit)}

    with off_screen(PICTURE_WIDTH, high - low, middle, towards, PIXELS // 2) as plotter:  # two stand side by side
        add_shaded(plotter, points, cloud.triangles, towards, colours)
        nearer = 0.002 * RADIUS * towards
        lines = sheet.contour(np.arange(1.0, 1e3 * limit), scalars="deflection")
        if lines.n_points:
            plotter.add_mesh(lines.translate(nearer), color="#101010", line_width=2.5)
        rim = sheet.extract_feature_edges(boundary_edges=True, feature_edges=False, manifold_edges=False)
        plotter.add_mesh(rim.translate(nearer), color="#404040", line_width=4.0)
        return screenshot(plotter)


def _plot_profile(axes: Axes, cloud: Cloud, drawn_ones: dict[str, Floats]) -> None:
    """Plot the deflection over the radius: the mean of rings as wide as the spacing, and its range."""
    distance = np.linalg.norm(cloud.points, axis=1)
    _, ring = np.unique(np.rint(distance / cloud.spacing), return_inverse=True)
    radius = 1e3 * np.bincount(ring, distance) / np.bincount(ring)
    for name, displacement in drawn_ones.items():
        full = name == FULL
        deflection = 1e3 * displacement[:, 2]
        mean = np.bincount(ring, deflection) / np.bincount(ring)
        if full:
            low, high = np.full((2, len(radius)), mean)
            np.minimum.at(low, ring, deflection)
            np.maximum.at(high, ring, deflection)
            if np.max(high - low) > MIN_DRAWN_RANGE * np.abs(deflection).max():
                axes.fill_between(radius, low, high, color=BLUE, alpha=0.25, lw=0, label=f"{FULL}, range over a ring")
        style, colour, layer = ("-", BLUE, 2) if full else ("--", ORANGE, 3)
        axes.plot(radius, mean, style, color=colour, lw=2, zorder=layer, label=name)
    axes.set(title="Profile, mean over rings as wide as the spacing", xlabel="radius [mm]", ylabel="deflection [mm]")
    axes.set_xlim(0, 1e3 * RADIUS)
    axes.legend(loc="upper right")
