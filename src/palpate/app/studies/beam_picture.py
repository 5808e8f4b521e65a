"""Pictures of the deformed beam, drawn off-screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.figures import RED, figure, scale_bar
from palpate.app.common.rendering import add_colour_bar, check_drawing, off_screen, place_picture, screenshot
from palpate.app.common.shading import colour_map, triangle_mesh
from palpate.app.studies.study import Study
from palpate.core.arrays import Floats
from palpate.meshfree.cloud import Cloud

if TYPE_CHECKING:
    from matplotlib.axes import Axes


ELEVATION = 25.0  # [degree] of the camera above the horizon: lengths along the beam keep their scale
WIDE_INCH = 11.0  # of the whole figure


@dataclass(frozen=True)
class _View:
    """What a picture spans [m]: along the beam, and across in the plane of the picture."""

    left: float
    right: float
    height: float

    @property
    def width(self) -> float:
        return self.right - self.left


@dataclass(frozen=True)
class _Moment:
    """A body at one time: displacements (n, 3) [m], stresses (n,) [Pa], and the stress [Pa] of the last colour."""

    cloud: Cloud
    displacement: Floats
    stress: Floats
    limit: float


def draw_beam(studies: Sequence[Study], path: Path) -> None:
    """Draw the beam at rest, at a quarter of its run and at its largest displacement, coloured by von Mises stress."""
    check_drawing()
    study = studies[0]
    cloud, run, stress = study.case.model.cloud, study.full, study.fields["von_mises"]
    peak = int(np.argmax(np.abs(run.displacements[:, :, 0]).max(axis=1)))
    frames = {"At rest": 0, "At a quarter of the run": len(run.times) // 4, "At the largest displacement": peak}
    shown = list(frames.values())
    # the corners of the held end are singular: a few nodes would take the whole range of colours
    limit = float(np.percentile(stress[peak], 98)) or 1.0
    moments = {k: _Moment(cloud, run.displacements[k], stress[k], limit) for k in shown}
    reach = cloud.points[:, 0] + run.displacements[shown][..., 0]
    thick = float(np.ptp(cloud.points[:, 1:], axis=0).max())
    whole_view = _View(reach.min() - 0.5 * thick, reach.max() + 0.2 * thick, 2.0 * thick)
    close = min(5 * thick, 0.45 * whole_view.width)
    held_view = _View(whole_view.left, whole_view.left + close, 2.0 * thick)
    pulled_view = _View(whole_view.right - close, whole_view.right, 2.0 * thick)
    row, last = WIDE_INCH * whole_view.height / whole_view.width, WIDE_INCH * held_view.height / (2 * close)
    with figure(path, (WIDE_INCH, len(frames) * (row + 0.35) + last + 1.5)) as drawn:
        grid = drawn.add_gridspec(len(frames) + 1, 2, height_ratios=[row] * len(frames) + [last])
        for place, (name, frame) in enumerate(frames.items()):
            title = f"{name}, t = {run.times[frame]:.2f} s"
            _picture(drawn.add_subplot(grid[place, :]), moments[frame], whole_view, title, nodes=False)
        for place, (name, view) in enumerate({"Held": held_view, "Pulled": pulled_view}.items()):
            title = f"{name} end at the largest displacement, with the nodes"
            _picture(drawn.add_subplot(grid[len(frames), place]), moments[peak], view, title, nodes=True)
        text = (
            f"von Mises Cauchy stress [kPa]; largest at a node {stress[shown].max() / 1e3:.4g} kPa.   "
            "Dark plate: held face.   Dashed: undeformed beam."
        )
        add_colour_bar(drawn, drawn.axes, limit / 1e3, text, shrink=0.6, aspect=45, extend="max")


def _picture(axes: Axes, moment: _Moment, view: _View, title: str, nodes: bool) -> None:
    """Draw a body at one time, with the undeformed outline and a scale bar."""
    left, right, high = 1e3 * view.left, 1e3 * view.right, 0.5e3 * view.height
    place_picture(axes, _render(moment, view, nodes), (left, right, -high, high), title)
    axes.plot(*_outline(moment.cloud), color=RED, lw=1.2, ls=(0, (5, 3)))
    scale_bar(axes, left, right, -0.9 * high)


def _outline(cloud: Cloud) -> Floats:
    """Return the silhouette of the undeformed convex body in the plane of the picture, (2, k) [mm]."""
    from scipy.spatial import ConvexHull

    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    angle, away = np.radians(ELEVATION), cloud.points - (low + high) / 2
    flat = np.column_stack([cloud.points[:, 0], np.cos(angle) * away[:, 2] + np.sin(angle) * away[:, 1]])
    corners = ConvexHull(flat).vertices
    return 1e3 * flat[[*corners, corners[0]]].T


def _edges(surface: Any) -> Any:
    return surface.extract_feature_edges(30, boundary_edges=False, non_manifold_edges=False, manifold_edges=False)


def _render(moment: _Moment, view: _View, nodes: bool) -> NDArray[np.uint8]:
    """Draw a body in a parallel projection, seen from the front and above; with its nodes if asked."""
    import pyvista

    pv: Any = pyvista
    points = moment.cloud.points
    body = triangle_mesh(points + moment.displacement, moment.cloud.triangles)
    body["stress"] = moment.stress
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.2 * (high - low)
    start, end = low - margin, high + margin
    plate = pv.Box((low[0] - margin[1], low[0], start[1], end[1], start[2], end[2]))
    angle = np.radians(ELEVATION)
    towards = np.array([0.0, -np.cos(angle), np.sin(angle)])  # the camera
    middle = np.array([(view.left + view.right) / 2, *(low[1:] + high[1:]) / 2])
    with off_screen(view.width, view.height, middle, towards) as plotter:
        # without light the colours are those of the colour bar; the edges show the shape
        colours = {"scalars": "stress", "clim": (0.0, moment.limit), "cmap": colour_map(), "show_scalar_bar": False}
        plotter.add_mesh(body, lighting=False, **colours)
        # in a parallel projection nearer lines and nodes stay in place, and clear of the faces they lie on
        nearer = 0.1 * margin[1] * towards
        plotter.add_mesh(_edges(body).translate(nearer), color="#101010", line_width=5.0)
        plotter.add_mesh(plate, color="#404040", ambient=0.4)
        if nodes:
            dots = pv.PolyData(body.points + nearer)
            plotter.add_mesh(dots, color="#101010", point_size=26, render_points_as_spheres=True)
        return screenshot(plotter)
