"""Bodies of a session: what each answers about its tools, its surface, its cut and its steps."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.app.recordings.recording import RECORDING_INTERVAL
from palpate.app.session.tool_control import NO_ROTATION, NO_TOOL, SelectedTool, forceps_of_group
from palpate.core.arrays import Floats
from palpate.dynamics.contact.geometry import least_radius
from palpate.dynamics.contact.shapes import TOOLS
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.cut.surface import NO_CUT
from palpate.realtime.bodies.cut_display import CutFullSurface
from palpate.realtime.bodies.display_surface import DisplaySurface
from palpate.realtime.bodies.full_blade import BladeCutter
from palpate.realtime.bodies.full_body import step_statistics
from palpate.realtime.bodies.full_surface import FullSurface, display_surface
from palpate.realtime.bodies.model import RealtimeModel, idle_model
from palpate.realtime.contract import MAX_TOOLS
from palpate.reduction.hyper.model import ReducedModel

FULL_INTERVAL = 0.04  # [s] between snapshots of a full body: a minute of 3,000 nodes takes 54 MB
REDRAW_INTERVAL = 0.1  # [s] from a new surface of a body that is being cut to the next one, at least
REDRAW_REST = 2.0  # least rest after a new surface, over the time that it took


class SessionBody:
    """A reduced model that tools touch; at the start and after a reset it has `idle_tool` at `home` (3,) [m]."""

    is_full = False
    least_radius = 0.0  # of a tool that touches the body [m]
    recording_interval = RECORDING_INTERVAL
    tool_kinds: tuple[str, ...] = tuple(kind for kind in TOOLS if kind != "scalpel")
    idle_tool = NO_TOOL
    max_tools = MAX_TOOLS
    cutter: BladeCutter | None = None

    def __init__(self, model: Any, realtime: RealtimeModel) -> None:
        self.model, self.realtime, self.home = model, realtime, np.zeros(3)
        self.surface = display_surface(model)

    @property
    def cuts(self) -> int:
        """Number of swaps of the body since it was whole."""
        return 0

    @property
    def strokes(self) -> int:
        """Number of strokes of a blade that can be undone."""
        return 0

    @property
    def cut_triangles(self) -> Floats:
        """Triangles (t, 3, 3) of the cut [m]."""
        return NO_CUT.triangles

    @property
    def shown_surface(self) -> DisplaySurface:
        """The surface that is drawn."""
        return self.surface

    def change_tool(self, tool: SelectedTool, pose: Floats, index: int) -> None:
        """Replace the tool of an index by another in a pose (7,); the engine must be paused."""
        assert self.realtime.change_tool is not None
        self.realtime.change_tool(tool.shape, pose, tool.friction, index)

    def statistics(self, kinds: Sequence[str]) -> dict[str, Any]:
        """Return with tools of some kinds how the body was stepped and cut, for the statistics of a session."""
        return {}


class GroupBody(SessionBody):
    """A body of which a tool holds a group at all times: a reduced model, or a solid whose group is given."""

    tool_kinds = ()
    idle_tool = SelectedTool("group", None)
    max_tools = 1

    def __init__(self, model: Any, realtime: RealtimeModel, group: str) -> None:
        super().__init__(model, realtime)
        self.group = group
        centre = model.cloud.points[model.cloud.group(group)].mean(axis=0)
        self.home[: len(centre)] = centre
        self.is_full = not isinstance(model, ReducedModel)
        self.recording_interval = FULL_INTERVAL if self.is_full else RECORDING_INTERVAL
        self._forceps = forceps_of_group(model.cloud, group) if self.is_full else None
        if self._forceps is not None:
            self.change_tool(self.idle_tool, np.concatenate([self.home, NO_ROTATION]), 0)

    def change_tool(self, tool: SelectedTool, pose: Floats, index: int) -> None:
        """Keep the group; forceps take it again."""
        if self._forceps is not None:
            assert self.realtime.change_tool is not None
            self.realtime.change_tool(self._forceps, pose, 0.0, index)


class FullBody(SessionBody):
    """A full body that is never cut."""

    is_full = True
    recording_interval = FULL_INTERVAL

    def __init__(self, model: NodalModel, realtime: RealtimeModel) -> None:
        super().__init__(model, realtime)
        self.least_radius = least_radius(model.cloud)

    def statistics(self, kinds: Sequence[str]) -> dict[str, Any]:
        """Return how the body was stepped."""
        return step_statistics(self.realtime.data)


class CuttableBody(FullBody):
    """A full solid, which a scalpel cuts. A thread draws it again as the cut grows, so that no caller waits."""

    tool_kinds = tuple(TOOLS)
    cutter: BladeCutter

    def __init__(self, model: EnergySolid, realtime: RealtimeModel) -> None:
        super().__init__(model, realtime)
        assert realtime.cutter is not None
        self.cutter = realtime.cutter
        assert isinstance(self.surface, FullSurface)
        self._uncut = self.surface
        self._drawn: tuple[int, Any, DisplaySurface] = 0, self.cutter.whole_model, self.surface
        self._is_drawing, self._lock = False, threading.Lock()

    @property
    def cuts(self) -> int:
        return self.cutter.cuts

    @property
    def strokes(self) -> int:
        return self.cutter.strokes

    @property
    def cut_triangles(self) -> Floats:
        return self.cutter.model.cut_surface.triangles

    @property
    def shown_surface(self) -> DisplaySurface:
        """The surface of the body as it was cut when it was drawn last."""
        model = self.cutter.model
        restorations = self.cutter.restorations
        if model is self.cutter.whole_model:
            return self.surface
        with self._lock:
            drawn_restorations, drawn_model, drawn = self._drawn
            if drawn_model is not model and not self._is_drawing:
                self._is_drawing = True
                name, arguments = "palpate cut surface", (restorations, model)
                threading.Thread(target=self._draw, args=arguments, name=name, daemon=True).start()
            return drawn if drawn_restorations == restorations else self.surface

    def _draw(self, restorations: int, model: EnergySolid) -> None:
        """Draw a cut body that was restored so many times before; then rest, for other threads."""
        began = time.monotonic()
        try:
            surface = CutFullSurface(model, self._uncut)
            with self._lock:
                self._drawn = restorations, model, surface
        finally:
            time.sleep(max(REDRAW_INTERVAL, REDRAW_REST * (time.monotonic() - began)))
            with self._lock:
                self._is_drawing = False

    def statistics(self, kinds: Sequence[str]) -> dict[str, Any]:
        """Return how the body was stepped, the size of its cut, and the force [N] with which a scalpel cuts."""
        cut = cut_statistics(self.shown_surface)
        force = {}
        if "scalpel" in kinds:
            force = {"cutting_force": self.cutter.cutting_force, "tears": self.cutter.tears}
        return {**super().statistics(kinds), **cut, **force}


def cut_statistics(surface: DisplaySurface) -> dict[str, float]:
    """Return the length [m], area [m^2] and depth [m] of the cut in a surface; nothing of one without a cut."""
    measures = surface.cut_measures
    return {f"cut_{name}": value for name, value in measures._asdict().items()} if measures.area > 0.0 else {}


def session_body(model: Any, foundations: Sequence[Foundation], held: str = "") -> SessionBody:
    """Return the body of a session with springs, prepared for the engine without a tool.

    A tool holds the group `held` of a solid at all times.
    """
    realtime = idle_model(model, foundations, 1 if held else MAX_TOOLS)
    if held or realtime.change_tool is None:
        return GroupBody(model, realtime, held or model.data.prescribed[0])
    if isinstance(model, ReducedModel):
        return SessionBody(model, realtime)
    return (FullBody if realtime.cutter is None else CuttableBody)(model, realtime)
