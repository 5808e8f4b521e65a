"""Pictures and movies of a recording, rendered off-screen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.app.common.rendering import COLOURS, check_drawing, off_screen
from palpate.app.recordings.recording import Recording
from palpate.app.recordings.snapshot import FIELD_UNITS, Snapshot
from palpate.app.view.server.frames import colour_range
from palpate.extras import require
from palpate.faults import InputError
from palpate.files import whole_file
from palpate.reduction.realtime.full_surface import display_surface

__all__ = ["MOVIE_SUFFIXES", "Draw", "RecordingPlotter", "check_movie", "check_picture", "write_movie", "write_picture"]

Draw = Callable[[int], Any]

MOVIE_SUFFIXES = (".gif", ".mp4")
FRAME_RATE = 25  # [Hz]
PIXELS = 720  # height of a picture
VIEW_DIRECTION = np.array([0.35, -0.85, 0.4])  # from the body to the camera
VIEW_MARGIN = 1.25  # width of the picture relative to the body
FULL_MODEL_COLOUR, TOOL_COLOUR = "#d95f02", "#555555"


def check_picture() -> None:
    """Raise `InputError` if what draws pictures and films is not installed."""
    for package in ("pyvista", "imageio"):
        require(package, "drawing a recording")


def check_movie(path: Path) -> None:
    """Check that a movie with this name can be written.

    Raises
    ------
    InputError
        The suffix is not supported, or its encoder is not installed.
    """
    if path.suffix.lower() not in MOVIE_SUFFIXES:
        raise InputError(f"movie must end in {' or '.join(MOVIE_SUFFIXES)}, got {str(path)!r}; choose another name")
    check_picture()
    if path.suffix.lower() == ".mp4":
        require("imageio_ffmpeg", f"movie {path}")


def write_picture(path: Path, recording: Recording, draw: Draw) -> None:
    """Draw the snapshot of the largest force on the tool, with the full model as a wireframe if it was run."""
    import imageio.v3 as imageio

    forces = [float(np.linalg.norm(snapshot.force)) for snapshot in recording.snapshots]
    with whole_file(path) as partial:
        imageio.imwrite(partial, draw(int(np.argmax(forces))))


def write_movie(
    path: Path, recording: Recording, draw: Draw, progress: Callable[[float, float], None] | None = None
) -> None:
    """Write a movie of a whole recording, in real time."""
    import imageio

    maker: Any = imageio
    check_movie(path)
    count = max(1, int(recording.times[-1] * FRAME_RATE))
    options: dict[str, Any] = {"duration": 1000 / FRAME_RATE, "loop": 0}
    if path.suffix.lower() == ".mp4":
        options = {"fps": FRAME_RATE, "macro_block_size": 4}  # of the pictures' sides, which are not resized
    with whole_file(path) as partial, maker.get_writer(partial, **options) as writer:
        for index in range(count):
            at = index / FRAME_RATE
            writer.append_data(draw(int(np.searchsorted(recording.times, at, side="right")) - 1))
            if progress is not None:
                progress(at, at)


class RecordingPlotter:
    """Context of a plotter; yields a function that draws the snapshot of an index as pixels (h, w, 3).

    Parameters
    ----------
    recording : Recording
    scalar : str
        Scalar that colours the body.

    Raises
    ------
    InputError
        The body has no such scalar.
    DrawingError
        This machine cannot render.
    """

    def __init__(self, recording: Recording, scalar: str) -> None:
        check_drawing()
        self.recording, self.scalar, self.surface = recording, scalar, display_surface(recording.model)
        if scalar not in self.surface.scalars:
            allowed = ", ".join(map(repr, self.surface.scalars))
            raise InputError(f"scalar must be one of {allowed}, got {scalar!r}; choose one of these")

    def __enter__(self) -> Callable[[int], Any]:
        import pyvista

        surface, direction = self.surface, VIEW_DIRECTION / np.linalg.norm(VIEW_DIRECTION)
        low, high = surface.rest.min(axis=0).astype(float), surface.rest.max(axis=0).astype(float)
        width = VIEW_MARGIN * float(np.linalg.norm(high - low))
        self._window = off_screen(width, 0.75 * width, 0.5 * (low + high), direction, PIXELS)
        plotter: Any = self._window.__enter__()
        faces = np.column_stack([np.full(len(surface.triangles), 3), surface.triangles]).ravel()
        body: Any = pyvista.PolyData(surface.rest.astype(float), faces)
        unit, factor = FIELD_UNITS[self.scalar]
        snapshots = self.recording.snapshots
        largest = factor * self._largest_value(snapshots)
        body["scalar"] = np.zeros(len(surface.rest))
        low_end = -largest if self.scalar == "pressure" else 0.0
        plotter.add_mesh(
            body, scalars="scalar", clim=(low_end, largest), cmap=COLOURS, smooth_shading=True, ambient=0.35,
            scalar_bar_args={"title": f"{self.scalar} [{unit}]", "color": "black"},
        )  # fmt: skip
        full_model = self._add_full_model(plotter, pyvista, faces)
        tools = self._add_tools(plotter, pyvista)

        def draw(frame: int) -> Any:
            snapshot = snapshots[frame]
            displacements = snapshot.displacements(surface)
            body.points = (surface.rest + displacements).astype(float)
            body["scalar"] = factor * snapshot.scalar(surface, self.scalar, displacements)
            full_model(frame)
            tools(frame)
            plotter.render()
            return np.asarray(plotter.screenshot(return_img=True))[..., :3]

        return draw

    def __exit__(self, *error: Any) -> None:
        self._window.__exit__(*error)

    def _largest_value(self, snapshots: list[Snapshot]) -> float:
        sample = snapshots[:: max(1, len(snapshots) // 50)]
        ends = [colour_range(m.scalar(self.surface, self.scalar, m.displacements(self.surface)))[1] for m in sample]
        return max(*ends, 1e-12)

    def _add_full_model(self, plotter: Any, pyvista: Any, faces: Any) -> Callable[[int], None]:
        """Add the full model as a wireframe; return a function that updates it to a frame."""
        full = self.recording.full
        if not full:
            return lambda frame: None
        full_model = pyvista.PolyData(full["positions"][0].astype(float), faces)
        plotter.add_mesh(full_model, style="wireframe", color=FULL_MODEL_COLOUR, line_width=1.0, opacity=0.6)
        plotter.add_text("wireframe: full model", position="upper_left", font_size=10, color=FULL_MODEL_COLOUR)

        def update(frame: int) -> None:
            nearest = int(np.argmin(np.abs(full["times"] - self.recording.times[frame])))
            full_model.points = full["positions"][nearest].astype(float)

        return update

    def _add_tools(self, plotter: Any, pyvista: Any) -> Callable[[int], None]:
        """Add the tools; return a function that shows the tool of a frame."""
        starts = [tool["start"] for tool in self.recording.tools]
        meshes: list[tuple[Any, Any, Any] | None] = []
        for tool in self.recording.tools:
            radius, half = tool["radius"], 0.5 * tool["length"]
            if tool["kind"] in ("none", "group"):
                meshes.append(None)
                continue
            solid = pyvista.Sphere(radius=radius if tool["kind"] != "grasp" else 0.3 * radius)
            if tool["kind"] == "capsule":
                solid.points[:, 2] += np.where(solid.points[:, 2] > 0, half, -half)
            meshes.append(
                (plotter.add_mesh(solid, color=TOOL_COLOUR, smooth_shading=True), np.array(solid.points), solid)
            )

        def update(frame: int) -> None:
            snapshot, present = self.recording.snapshots[frame], int(np.searchsorted(starts, frame, side="right")) - 1
            for index, parts in enumerate(meshes):
                if parts is None:
                    continue
                actor, points, solid = parts
                actor.visibility = index == present and snapshot.tool != "none"
                rotation = Rotation.from_quat(snapshot.quaternion, scalar_first=True)
                solid.points = snapshot.position + rotation.apply(points)

        return update
