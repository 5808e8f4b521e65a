"""Pictures of a surface with its faults, and of the cloud inside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.common.figures import BLUE, ORANGE, figure, heading
from palpate.app.common.rendering import add_shaded, camera_axes, show
from palpate.app.common.shading import RefinedSurface, shade, triangle_mesh
from palpate.core.arrays import Floats, Ints
from palpate.core.files import shortened
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.gate import nearest_spacing
from palpate.surface.checks import SurfaceReport
from palpate.surface.surface import Surface

MESH_EDGE_COLOUR = "#5A2F28"  # colour of the triangles' edges
MARKS = {
    "error": ("#0072B2", "blue: faults"),
    "repair": ("#E69F00", "orange: repairs"),
    "note": ("#FFFFFF", "white: notes"),
}
MAX_NAME_LENGTH = 48  # characters of a surface in a heading
SIDES = {"Seen along +y": (0.0, -1.0, 0.25), "Seen along -y": (0.0, 1.0, 0.25), "Seen along +z": (0.0, -0.5, -1.0)}


def draw_surface(body: Surface, surface_report: SurfaceReport, path: Path) -> None:
    """Draw a surface from three sides into a PNG file, with the places of its problems and repairs as dots."""
    places = {
        kind: np.concatenate([each.points for each in surface_report.problems if each.kind == kind])
        for kind in MARKS
        if any(each.kind == kind and len(each.points) for each in surface_report.problems)
    }
    with figure(path, (11.0, 3.6)) as drawn:
        for axes, (title, towards) in zip(drawn.subplots(1, 3), SIDES.items(), strict=True):
            _show(axes, body.vertices, body.triangles, np.array(towards), title, places)
        names = ", ".join(problem.name for problem in surface_report.problems)
        marks = ", ".join(MARKS[kind][1] for kind in places)
        title = shortened(body.name, MAX_NAME_LENGTH)
        heading(drawn, f"{title}: {names or 'nothing wrong'}" + (f" ({marks})" if marks else ""))


def draw_cloud(cloud: Cloud, path: Path) -> None:
    """Draw a cloud's surface, a cut through it and the distances between its nodes into a PNG file."""
    with figure(path, (11.0, 7.6)) as drawn:
        axes = drawn.subplots(2, 2)
        sides = list(SIDES.items())
        _show_edges(axes[0, 0], cloud, np.array(sides[0][1]), f"Surface, {sides[0][0].lower()}")
        _show_edges(axes[0, 1], cloud, np.array(sides[2][1]), f"Surface, {sides[2][0].lower()}")
        _cut(axes[1, 0], cloud)
        _histogram(axes[1, 1], cloud)


def _show(
    axes: Any, points: Floats, triangles: Ints, towards: Floats, title: str, places: Mapping[str, Floats]
) -> None:
    """Draw a surface seen from a side, with dots."""
    import pyvista

    towards = towards / np.linalg.norm(towards)
    size = float(np.linalg.norm(np.ptp(points, axis=0)))

    def mottled(refined: RefinedSurface) -> dict[str, Floats]:
        return {"places": refined.values(points / size)}

    def draw(plotter: Any, width: float) -> None:
        add_shaded(plotter, points, triangles, towards, mottled)
        for kind, where in places.items():
            dots = pyvista.PolyData(where + 0.5 * width * towards)
            plotter.add_mesh(dots, color=MARKS[kind][0], point_size=24, render_points_as_spheres=True)

    show(axes, points, towards, title, draw)


def _show_edges(axes: Any, cloud: Cloud, towards: Floats, title: str) -> None:
    """Draw the triangles of a cloud's surface seen from a side."""

    def draw(plotter: Any, _width: float) -> None:
        shape = triangle_mesh(cloud.points, cloud.triangles)
        normals = shape.compute_normals(cell_normals=False, split_vertices=False).point_data["Normals"]
        shape["colour"] = shade(np.asarray(normals, dtype=float), camera_axes(towards))
        plotter.add_mesh(
            shape,
            scalars="colour",
            rgb=True,
            lighting=False,
            show_edges=True,
            edge_color=MESH_EDGE_COLOUR,
            line_width=2,
        )

    show(axes, cloud.points, towards, title, draw)


def _cut(axes: Any, cloud: Cloud) -> None:
    """Nodes within half a spacing of a plane through the middle, across the shortest side of the body."""
    across = int(np.argmin(np.ptp(cloud.points, axis=0)))
    middle = (cloud.volumes @ cloud.points) / cloud.volumes.sum()
    a, b = (k for k in range(3) if k != across)
    near = np.abs(cloud.points[:, across] - middle[across]) < 0.5 * cloud.spacing
    on = np.isin(np.arange(len(cloud)), cloud.group("surface"))
    for mask, colour, name in ((near & ~on, BLUE, "inside"), (near & on, ORANGE, "surface")):
        axes.plot(*(1e3 * cloud.points[mask][:, (a, b)].T), ".", color=colour, label=name)
    axes.set_aspect("equal")
    axes.set(xlabel=f"{'xyz'[a]} [mm]", ylabel=f"{'xyz'[b]} [mm]", title="Nodes in a slice one spacing thick")
    axes.legend(loc="best")


def _histogram(axes: Any, cloud: Cloud) -> None:
    distance = nearest_spacing(cloud.points) / cloud.spacing
    bins = np.linspace(0.3, 1.4, 56)
    for name, colour in (("inside", BLUE), ("surface", ORANGE)):
        axes.hist(distance[cloud.group(name)], bins, color=colour, alpha=0.8, label=name)
    axes.set(xlabel="distance to the nearest node [spacings]", ylabel="nodes", title="How evenly the nodes lie")
    axes.legend()
