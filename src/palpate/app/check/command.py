"""``palpate check``: find the faults of a surface, and fill it with a cloud."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from palpate.app.check.picture import draw_cloud, draw_surface
from palpate.app.common.arguments import option_names
from palpate.app.common.console import Console, Table
from palpate.app.common.rendering import DrawingError, check_drawing
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.app.common.rows import Rows, fill_template, named_rows, quantities
from palpate.app.train.coverage import Coverage, draw_coverage
from palpate.core.faults import InputError
from palpate.core.files import check_folder, plain
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.filling import fill
from palpate.meshfree.gate import nearest_spacing
from palpate.scenes.names import SceneKind, kind_of
from palpate.scenes.open_scene import open_scene
from palpate.scenes.scene import Scene
from palpate.scenes.training import training_of
from palpate.surface.checks import SurfaceReport, check_surface
from palpate.surface.repair import repair_surface
from palpate.surface.surface import Surface

FILES = (*REPORTS, "surface.png", "cloud.png", "tool.png")
NEAREST_ROW = "{KEYS/0:.2f} to {KEYS/4:.2f} spacings, median {KEYS/2:.2f}"
CHECK_ROWS: Rows = {
    "vertices, triangles": "{surface/vertices}, {surface/triangles}",
    "parts, Euler number": "{surface/parts}, {surface/euler_number}",
    "size": "{surface/extents:.1f mm}",
    "area": "{surface/area:.4g cm^2}",
    "volume": lambda report: (
        "none, the surface is open"
        if report["surface"]["volume"] is None
        else fill_template("{surface/volume:.4g litres}", report)
    ),
    "spacing": "{cloud/spacing:.3g mm}",
    "nodes": "{cloud/nodes}, {cloud/surface_nodes} of them on the surface",
    **{
        f"nearest neighbour, {where}": NEAREST_ROW.replace("KEYS", f"cloud/nearest_neighbour_over_spacing/{where}")
        for where in ("surface", "inside")
    },
    "filled in": "{cloud/seconds:.2f s}",
}
TOOL_ROWS: Rows = {
    "tool": "a ball of {scene/radius:.3g mm}, up to {scene/depth:.3g mm} deep",
    "surface that it reaches; that supports hold": "{scene/reached:.0%}; {scene/held:.0%}",
}
DEFAULT_NODES = 4000  # approximate number without a given spacing


def check(
    *,
    file: Path,
    spacing: float | None = None,
    part: Sequence[str] | None = None,
    labels: Path | None = None,
    without: Sequence[str] = (),
    units: str | None = None,
    scale: float = 1.0,
    repair: bool = False,
    seed: int = 0,
    out: Path,
    as_json: bool = False,
) -> int:
    """Examine a surface, fill it if it can be, and leave a report with pictures in a folder.

    `file` may be a scene file, whose supports, regions and tool are also reported. By default `spacing` [m] gives some
    4,000 nodes. Returns 0 if the surface was filled, 1 if it cannot be.
    """
    check_folder(out)
    console = Console()
    settings = {"units": units, "scale": None if scale == 1.0 else scale, "spacing": spacing, "repair": repair or None}
    scene = _open(file, part, labels, without, settings, seed)
    surface = _surface_of(scene)
    with console.status("examining the surface"):
        surface_report = check_surface(surface)
    spacing = scene.description.body.spacing
    if spacing is None:
        spacing = float(f"{1.2 * np.cbrt(abs(surface.volume) / DEFAULT_NODES):.2g}")
        scene = scene.with_body(spacing=spacing)
    report: dict[str, Any] = {
        "title": f"Check of {surface.name}",
        "file": str(file),
        "repaired": scene.description.surface.repair,
        "surface": _surface_entry(surface, surface_report),
        "machine": machine(),
    }
    is_alone = scene.kind is SceneKind.SURFACE_FILE  # its supports are not given yet
    make = partial(fill, surface, spacing, seed=seed) if is_alone else lambda: scene.cloud
    cloud = _fill(surface, surface_report, make, report, console)
    if not is_alone and cloud is not None:
        report["scene"] = _scene_entry(scene, console)
    out.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        (out / name).unlink(missing_ok=True)
    _draw(scene, surface, surface_report, cloud, report, out, console)
    report = plain(report)
    deliver(report, [_table(report), *_remarks(report)], out, FILES, as_json)
    return 0 if cloud is not None else 1


def _open(
    file: Path, part: Sequence[str] | None, labels: Path | None, without: Sequence[str],
    settings: Mapping[str, Any], seed: int,
) -> Scene:  # fmt: skip
    """Open a scene file, of which nothing is changed, or a surface, which is not repaired unless asked."""
    settings = {name: value for name, value in settings.items() if value is not None}
    if kind_of(file.name) is SceneKind.SCENE_FILE:
        for name, value in {"part": part, "labels": labels, "without": without, **settings, "seed": seed}.items():
            if value:
                raise InputError(f"{name} must be left out with a scene file, got {value!r}; change the file")
        return open_scene(file)
    return open_scene(file, {"repair": False} | settings, part=part or (), labels=labels, without=without)


def _surface_of(scene: Scene) -> Surface:
    """Return the surface of a scene as it is filled, or that of a file alone with its faults and what was noted."""
    shape = scene.description.surface
    if scene.kind is SceneKind.SURFACE_FILE:
        surface = scene.read_surface(shape.repair)
        return replace(surface, warnings=(*scene.notes, *surface.warnings))
    if scene.surface is None:
        raise InputError(f"{scene.name} must have a surface to check, got a {shape.generated}")
    return repair_surface(scene.surface) if shape.repair else scene.surface


def _draw(
    scene: Scene, surface: Surface, surface_report: SurfaceReport, cloud: Cloud | None, report: dict[str, Any],
    out: Path, console: Console,
) -> None:  # fmt: skip
    """Draw the pictures of a report, where this machine can."""
    try:
        check_drawing()
        draw_surface(surface, surface_report, out / "surface.png")
        if cloud is not None:
            draw_cloud(cloud, out / "cloud.png")
        if "reached" in report.get("scene", {}):
            draw_coverage(Coverage(training_of(scene, {}), ()), out / "tool.png")
    except DrawingError as error:
        console.say(f"no pictures: {error}")


def _scene_entry(scene: Scene, console: Console) -> dict[str, Any]:
    """Return the supported nodes and the reachable surface of a scene."""
    with console.status("preparing the body, and finding where a tool reaches"):
        body = scene.body
        entry: dict[str, Any] = {
            "material": str(scene.material),
            "supports": {each.group: len(body.cloud.group(each.group)) for each in body.supports},
            "springs": {each.group: len(body.cloud.group(each.group)) for each in scene.foundations},
            "regions": {name: len(nodes) for name, nodes in body.cloud.groups.items() if name in scene.region_groups},
        }
        if not scene.held_group:
            paths = scene.tool_paths()
            area = paths.surface.areas
            entry |= {
                "radius": paths.radius, "depth": paths.depth, "reached": area[paths.reachable].sum() / area.sum(),
                "held": area[paths.surface.held].sum() / area.sum(),
            }  # fmt: skip
    return entry


def _fill(
    surface: Surface, surface_report: SurfaceReport, make: Callable[[], Cloud], report: dict[str, Any], console: Console
) -> Cloud | None:
    """Return the cloud and add it to the report; return None, with the reason there, if filling is refused."""
    if surface_report.errors:
        return None
    with (
        console.status("filling it (the first time on a machine compiles: half a minute)"),
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        begin = perf_counter()
        try:
            cloud = make()
        except InputError as error:
            report["refused"] = " ".join(str(error).split())
            return None
    report["surface"]["warnings"] += [str(each.message) for each in caught if str(each.message) not in surface.warnings]
    report["cloud"] = _cloud_entry(cloud) | {"seconds": perf_counter() - begin}
    return cloud


def _surface_entry(surface: Surface, surface_report: SurfaceReport) -> dict[str, Any]:
    return {
        "vertices": surface_report.vertices,
        "triangles": surface_report.triangles,
        "parts": surface_report.components,
        "euler_number": surface_report.euler,
        "area": surface_report.area,
        "volume": surface_report.volume if surface.closed else None,
        "extents": surface_report.extents,
        "warnings": list(surface.warnings),
        "problems": [
            {"kind": problem.kind, "name": problem.name, "what": problem.what, "places": len(problem.points)}
            for problem in surface_report.problems
        ],
    }


def _cloud_entry(cloud: Cloud) -> dict[str, Any]:
    distance = nearest_spacing(cloud.points) / cloud.spacing
    on, inside = cloud.group("surface"), cloud.group("inside")
    return {
        "spacing": cloud.spacing,
        "nodes": len(cloud),
        "surface_nodes": len(on),
        "triangles": len(cloud.triangles),
        "volume": float(cloud.volumes.sum()),
        "nearest_neighbour_over_spacing": {
            "surface": np.percentile(distance[on], [0, 5, 50, 95, 100]).tolist(),
            "inside": np.percentile(distance[inside], [0, 5, 50, 95, 100]).tolist(),
        },
    }


def _table(report: dict[str, Any]) -> Table:
    rows = dict(CHECK_ROWS)
    for kind in ("supports", "springs", "regions"):
        rows |= named_rows(f"{kind}, {{}}", f"scene/{kind}", "{value} nodes", report.get("scene", {}).get(kind, {}))
    return quantities(report["title"], rows | TOOL_ROWS, {"value": report})


def _remarks(report: dict[str, Any]) -> list[str]:
    problems = report["surface"]["problems"]
    repaired = [f"repaired, {each['name']}: {each['what']}" for each in problems if each["kind"] == "repair"]
    remarks = [f"{each['name']}: {option_names(each['what'])}" for each in problems if each["kind"] != "repair"]
    remarks += repaired + [f"note: {option_names(each)}" for each in report["surface"]["warnings"]]
    if "refused" in report:
        remarks.append(f"refused: {report['refused']}")
    return remarks or ["nothing is wrong with the surface"]
