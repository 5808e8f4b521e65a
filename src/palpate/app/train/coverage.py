"""Coverage of the free surface of a body by the tools of runs: its shares, and a picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.figures import BLUE, GREY, ORANGE, YELLOW, figure, heading
from palpate.app.common.rendering import add_shaded, check_drawing, show
from palpate.app.common.shading import RefinedSurface
from palpate.core.arrays import Floats
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.solid.model import Solid
from palpate.scenes.free_surface import FreeSurface
from palpate.scenes.load_case import TrainingScene
from palpate.scenes.tool_paths import ToolPaths

Run = tuple[Sequence[Load], float]  # loads of a run and its duration [s]
COVERED, UNCOVERED, UNREACHABLE, HELD = range(4)
LEGEND_BY_KIND = {
    COVERED: ("covered by a training path", BLUE),
    UNCOVERED: ("not covered", YELLOW),
    UNREACHABLE: ("free, but not reached", ORANGE),
    HELD: ("held by supports", GREY),
}
VIEW_DIRECTIONS = {
    "Seen along +y": (0.0, -1.0, 0.25),
    "Seen along -y": (0.0, 1.0, 0.25),
    "Seen along -x": (1.0, 0.0, 0.25),
    "Seen along +z": (0.0, -0.5, -1.0),
}


class Coverage:
    """Share of a solid's free surface that tools cover, run by run; see `palpate.scenes.free_surface`."""

    def __init__(self, scene: TrainingScene, runs: Iterable[Run]) -> None:
        paths = scene.path
        self.surface = paths.surface if isinstance(paths, ToolPaths) else FreeSurface(cast(Solid, scene.model))
        self.reachable = paths.reachable if isinstance(paths, ToolPaths) else None
        self.runs = 0
        self.mask = np.zeros(len(self.surface.nodes), dtype=np.bool_)
        for run in runs:
            self.add(run)

    def added(self, run: Run) -> float:
        """Return the newly covered share of the surface that a run covers, from 0 to 1."""
        run_mask = self.surface.covered(*run)
        run_share = self.surface.share(run_mask)
        return self.surface.share(run_mask & ~self.mask) / run_share if run_share else 0.0

    def add(self, run: Run) -> None:
        """Count a run as trained."""
        self.runs += 1
        self.mask |= self.surface.covered(*run)

    def shares(self) -> dict[str, float]:
        """Return the covered share of the free surface, the reachable share of it, and the held share of all."""
        shares = {"covered": self.surface.share(self.mask)}
        if self.reachable is not None:
            shares["reachable"] = self.surface.share(self.reachable)
            shares["covered_of_reachable"] = self.surface.share(self.mask & self.reachable) / shares["reachable"]
        areas = self.surface.areas
        return shares | {"held": float(areas[self.surface.held].sum() / areas.sum())}

    @cached_property
    def kinds(self) -> NDArray[np.int64]:
        """Kind (s,) of each surface node."""
        kinds = np.full(len(self.mask), UNCOVERED)
        if self.reachable is not None:
            kinds[~self.reachable] = UNREACHABLE
        kinds[self.mask] = COVERED
        kinds[self.surface.held] = HELD
        return kinds


def coverage(scene: TrainingScene, runs: Iterable[Run]) -> Coverage | None:
    """Return the coverage of a scene by runs; None without a solid or without contact."""
    runs = list(runs)
    touched = any(isinstance(load, Contact | Grasp) for loads, _ in runs for load in loads)
    return Coverage(scene, runs) if touched and not scene.model.kinematics.sheet else None


def draw_coverage(covered: Coverage, path: Path) -> None:
    """Draw the surface from four sides into a PNG file: covered, reachable and supported parts.

    Without runs it shows what the tool reaches.
    """
    check_drawing()
    from matplotlib.patches import Patch

    cloud, shares = covered.surface.cloud, covered.shares()
    colours = np.array([_rgb(colour) for _, colour in LEGEND_BY_KIND.values()])

    def kind_colours(refined: RefinedSurface) -> dict[str, Floats]:
        nearest = covered.surface.tree.query(refined.values(cloud.points))[1]
        return {"colours": colours[covered.kinds[nearest]]}

    with figure(path, (10.0, 7.4)) as drawn:
        what, share = ("training paths cover", "covered") if covered.runs else ("the tool reaches", "reachable")
        heading(drawn, f"Surface that {what}: {shares[share]:.0%} of what supports leave free")
        for axes, (title, side) in zip(drawn.subplots(2, 2).flat, VIEW_DIRECTIONS.items(), strict=True):
            towards = np.array(side)

            def draw(plotter: Any, _width: float, towards: Floats = towards) -> None:
                add_shaded(plotter, cloud.points, cloud.triangles, towards, kind_colours)

            show(axes, cloud.points, towards, title, draw)
        present = np.unique(covered.kinds)
        kinds = (
            LEGEND_BY_KIND if covered.runs else LEGEND_BY_KIND | {UNCOVERED: ("reached", LEGEND_BY_KIND[UNCOVERED][1])}
        )
        handles = [Patch(color=colour, label=label) for kind, (label, colour) in kinds.items() if kind in present]
        drawn.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def _rgb(colour: str) -> Floats:
    """Return the colour ``#rrggbb`` as three numbers from 0 to 1."""
    return np.frombuffer(bytes.fromhex(colour[1:]), dtype=np.uint8) / 255
