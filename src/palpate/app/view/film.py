"""Pictures and films of a recording, drawn off-screen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palpate.app.pictures import COLOURS, check_drawing, off_screen
from palpate.app.view.frames import colour_range
from palpate.app.view.recording import Recording
from palpate.app.view.snapshot import UNITS, Snapshot
from palpate.extras import require
from palpate.faults import InputError
from palpate.files import whole_file
from palpate.reduction.realtime.display_surface import Surface

__all__ = ["FILMS", "Draw", "check_film", "check_picture", "drawn", "write_film", "write_picture"]

Floats = NDArray[np.float64]
Draw = Callable[[int], Any]

FILMS = (".gif", ".mp4")
RATE = 25  # frames a second
PIXELS = 720
TOWARDS = np.array([0.35, -0.85, 0.4])  # from the body to the camera
ROOM = 1.25  # of the picture over the body
FULL, TOOL = "#d95f02", "#555555"


def check_picture() -> None:
    """Raise `InputError` if what draws pictures and films is not installed."""
    for package in ("pyvista", "imageio"):
        require(package, "drawing a recording")


def check_film(path: Path) -> None:
    """Check that a film of that name can be made, before anything is drawn.

    Raises
    ------
    InputError
        Its ending is no film's, or what makes such films is not installed.
    """
    if path.suffix.lower() not in FILMS:
        raise InputError(f"movie = {str(path)!r}: allowed are names that end in {' or '.join(FILMS)}")
    check_picture()
    if path.suffix.lower() == ".mp4":
        require("imageio_ffmpeg", f"movie = {str(path)!r}")


def write_picture(path: Path, recording: Recording, draw: Draw) -> None:
    """Draw the moment of the largest force on the tool, with the full model's surface as a net where it was run."""
    import imageio.v3 as imageio

    forces = [float(np.linalg.norm(moment.force)) for moment in recording.moments]
    with whole_file(path) as partial:
        imageio.imwrite(partial, draw(int(np.argmax(forces))))


def write_film(
    path: Path, recording: Recording, draw: Draw, progress: Callable[[float, float], None] | None = None
) -> None:
    """Draw a whole recording, as fast as it was."""
    import imageio

    maker: Any = imageio
    check_film(path)
    count = max(1, int(recording.times[-1] * RATE))
    options: dict[str, Any] = {"duration": 1000 / RATE, "loop": 0}
    if path.suffix.lower() == ".mp4":
        options = {"fps": RATE, "macro_block_size": 4}  # pictures whose sides are multiples of it stay as they are
    with whole_file(path) as partial, maker.get_writer(partial, **options) as writer:
        for k in range(count):
            at = k / RATE
            writer.append_data(draw(int(np.searchsorted(recording.times, at, side="right")) - 1))
            if progress is not None:
                progress(at, at)


class drawn:
    """A plotter with the body in it; yields a function that draws a moment as pixels (h, w, 3).

    Parameters
    ----------
    recording : Recording
    scalar : str
        What colours tell.

    Raises
    ------
    InputError
        The body has no such scalar.
    DrawingError
        This machine cannot draw.
    """

    def __init__(self, recording: Recording, scalar: str) -> None:
        check_drawing()
        self.recording, self.scalar, self.surface = recording, scalar, Surface(recording.model)
        if scalar not in self.surface.scalars:
            allowed = ", ".join(map(repr, self.surface.scalars))
            raise InputError(f"scalar = {scalar!r}: allowed are {allowed}")

    def __enter__(self) -> Callable[[int], Any]:
        import pyvista

        surface, towards = self.surface, TOWARDS / np.linalg.norm(TOWARDS)
        low, high = surface.rest.min(axis=0).astype(float), surface.rest.max(axis=0).astype(float)
        width = ROOM * float(np.linalg.norm(high - low))
        self._window = off_screen(width, 0.75 * width, 0.5 * (low + high), towards, PIXELS)
        plotter: Any = self._window.__enter__()
        faces = np.column_stack([np.full(len(surface.triangles), 3), surface.triangles]).ravel()
        body: Any = pyvista.PolyData(surface.rest.astype(float), faces)
        unit, factor = UNITS[self.scalar]
        moments = self.recording.moments
        most = factor * self._most(moments)
        body["shown"] = np.zeros(len(surface.rest))
        low_end = -most if self.scalar == "pressure" else 0.0
        plotter.add_mesh(
            body, scalars="shown", clim=(low_end, most), cmap=COLOURS, smooth_shading=True, ambient=0.35,
            scalar_bar_args={"title": f"{self.scalar} [{unit}]", "color": "black"},
        )  # fmt: skip
        net = self._net(plotter, pyvista, faces)
        tools = self._tools(plotter, pyvista)

        def draw(frame: int) -> Any:
            moment = moments[frame]
            moved = moment.displacements(surface)
            body.points = (surface.rest + moved).astype(float)
            body["shown"] = factor * moment.scalar(surface, self.scalar, moved)
            net(frame)
            tools(frame)
            plotter.render()
            return np.asarray(plotter.screenshot(return_img=True))[..., :3]

        return draw

    def __exit__(self, *error: Any) -> None:
        self._window.__exit__(*error)

    def _most(self, moments: list[Snapshot]) -> float:
        few = moments[:: max(1, len(moments) // 50)]
        ends = [colour_range(m.scalar(self.surface, self.scalar, m.displacements(self.surface)))[1] for m in few]
        return max(*ends, 1e-12)

    def _net(self, plotter: Any, pyvista: Any, faces: Any) -> Callable[[int], None]:
        """Return a function that puts the full model's surface, drawn as a net, to a frame."""
        full = self.recording.full
        if not full:
            return lambda frame: None
        net = pyvista.PolyData(full["positions"][0].astype(float), faces)
        plotter.add_mesh(net, style="wireframe", color=FULL, line_width=1.0, opacity=0.6)
        plotter.add_text("net: full model", position="upper_left", font_size=10, color=FULL)

        def put(frame: int) -> None:
            nearest = int(np.argmin(np.abs(full["times"] - self.recording.times[frame])))
            net.points = full["positions"][nearest].astype(float)

        return put

    def _tools(self, plotter: Any, pyvista: Any) -> Callable[[int], None]:
        """Return a function that shows the tool of a frame where it is, if it has a shape."""
        starts = [tool["frame"] for tool in self.recording.tools]
        shown: list[tuple[Any, Any, Any] | None] = []
        for tool in self.recording.tools:
            radius, half = tool["radius"], 0.5 * tool["length"]
            if tool["kind"] in ("none", "group"):
                shown.append(None)
                continue
            solid = pyvista.Sphere(radius=radius if tool["kind"] != "grasp" else 0.3 * radius)
            if tool["kind"] == "capsule":
                solid.points[:, 2] += np.where(solid.points[:, 2] > 0, half, -half)
            shown.append((plotter.add_mesh(solid, color=TOOL, smooth_shading=True), np.array(solid.points), solid))

        def put(frame: int) -> None:
            moment, own = self.recording.moments[frame], int(np.searchsorted(starts, frame, side="right")) - 1
            for k, parts in enumerate(shown):
                if parts is None:
                    continue
                actor, points, solid = parts
                actor.visibility = k == own and moment.tool != "none"
                turn = Rotation.from_quat(moment.quaternion, scalar_first=True)
                solid.points = moment.position + turn.apply(points)

        return put
