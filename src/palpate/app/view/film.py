"""Pictures and movies of a recording, rendered off-screen in the light of the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.app.common.rendering import camera_axes, check_drawing, off_screen, screenshot
from palpate.app.common.shading import (
    INK,
    QUIET,
    TOOL_COLOURS,
    RefinedSurface,
    colour_map,
    round_up,
    shade,
    shade_tool,
    triangle_mesh,
)
from palpate.app.recordings.cut_surfaces import CutSurfaces
from palpate.app.recordings.recording import Recording
from palpate.app.recordings.snapshot import FIELD_UNITS
from palpate.app.session.tool_control import DRAWN_FORCEPS_SHARE
from palpate.app.view.server.frames import colour_range
from palpate.core.arrays import Floats, Singles
from palpate.core.extras import require
from palpate.core.faults import InputError
from palpate.core.files import whole_file
from palpate.dynamics.contact.blade import Scalpel
from palpate.dynamics.contact.shapes import TOOLS, Sphere, make_tool
from palpate.realtime.bodies.display_surface import CutLine, DisplaySurface

Draw = Callable[[int], Any]

MOVIE_SUFFIXES = (".gif", ".mp4", ".webp")
FRAME_RATE = 25  # [Hz]
WEBP_QUALITY = 92  # of 100
PICTURE_PIXELS, MOVIE_PIXELS = 1280, 640  # width
ASPECT_RATIO = 4 / 3
VIEW_DIRECTION = np.array([0.35, -0.85, 0.4])  # from the body to the camera
VIEW_MARGIN = 1.12  # of the picture around the body
LEGEND_SHARE = 0.16  # of the height, below the body
VIEWED_SNAPSHOTS = 50  # of a recording, from which view and range are chosen
FULL_MODEL_COLOUR = "#0b7285"
REVOLUTION_POINTS = 97  # around a tool
LINE_COLOUR, LINE_WIDTH, LINE_NEARER = "#26040a", 0.003, 0.01  # of a cut; over the picture's and the body's size
BLADE_HEIGHT, BLADE_THICKNESS, HANDLE_LENGTH = 0.25, 0.02, 0.9  # of a scalpel, over the length of its edge
SHADOW_CELLS, SHADOW_MARGIN, SHADOW_BLUR, SHADOW_STRENGTH = 128, 0.6, 0.1, 0.2  # margin and blur over the radius


def check_picture() -> None:
    """Raise `InputError` if what draws pictures and films is not installed."""
    for package in ("pyvista", "imageio"):
        require(package, "drawing a recording")


def check_movie(path: Path) -> None:
    """Check that a movie with this name can be written."""
    if path.suffix.lower() not in MOVIE_SUFFIXES:
        suffixes = f"{', '.join(MOVIE_SUFFIXES[:-1])} or {MOVIE_SUFFIXES[-1]}"
        raise InputError(f"movie must end in {suffixes}, got {str(path)!r}; choose another name")
    check_picture()
    if path.suffix.lower() != ".gif":
        require("imageio_ffmpeg", f"movie {path}")


def write_picture(path: Path, recording: Recording, draw: Draw) -> None:
    """Draw the snapshot of the largest force on a tool, with the full model as a wireframe if it was run."""
    import imageio.v3 as imageio

    forces = [snapshot.largest_force for snapshot in recording.snapshots]
    with whole_file(path) as partial:
        imageio.imwrite(partial, draw(int(np.argmax(forces))))


def write_movie(
    path: Path, recording: Recording, draw: Draw, progress: Callable[[float, float], None] | None = None
) -> None:
    """Write a movie of a whole recording, in real time."""
    count = max(1, int(recording.times[-1] * FRAME_RATE))
    with whole_file(path) as partial, movie_writer(partial) as add:
        for index in range(count):
            at = index / FRAME_RATE
            add(draw(max(0, int(np.searchsorted(recording.times, at, side="right")) - 1)))
            if progress is not None:
                progress(at, at)


@contextmanager
def movie_writer(path: Path) -> Iterator[Callable[[Any], None]]:
    """Yield a function that adds a picture (h, w, 3) to a movie of `FRAME_RATE`; GIF and WebP repeat."""
    check_movie(path)
    suffix = path.suffix.lower()
    if suffix == ".webp":
        yield from _webp_writer(path)
        return
    import imageio

    maker: Any = imageio
    options: dict[str, Any] = {"duration": 1000 / FRAME_RATE, "loop": 0}
    if suffix == ".mp4":
        options = {"fps": FRAME_RATE, "macro_block_size": 4}  # of the pictures' sides, which are not resized
    with maker.get_writer(path, **options) as writer:
        yield writer.append_data


def _webp_writer(path: Path) -> Iterator[Callable[[Any], None]]:
    """Yield the function of `movie_writer`; ffmpeg gets each picture at once, so that memory does not grow."""
    import imageio_ffmpeg  # type: ignore[import-untyped]

    writer: Any = None

    def add(picture: Any) -> None:
        nonlocal writer
        if writer is None:
            quality = ["-loop", "0", "-quality", str(WEBP_QUALITY), "-compression_level", "6"]
            writer = imageio_ffmpeg.write_frames(
                str(path), picture.shape[1::-1], fps=FRAME_RATE, codec="libwebp_anim", quality=None,
                macro_block_size=1, output_params=quality,
            )  # fmt: skip
            writer.send(None)
        writer.send(np.ascontiguousarray(picture))

    try:
        yield add
    finally:
        if writer is not None:
            writer.close()


class RecordingPlotter:
    """Context of a plotter; yields a function that draws the snapshot of an index as pixels (h, w, 3).

    `scalar` colours the body; `pixels` is the width of the pictures.
    """

    def __init__(self, recording: Recording, scalar: str, pixels: int = PICTURE_PIXELS) -> None:
        check_drawing()
        self.recording, self.scalar, self.surfaces = recording, scalar, CutSurfaces(recording)
        self.surface = self.surfaces.whole
        if scalar not in self.surface.scalars:
            allowed = ", ".join(map(repr, self.surface.scalars))
            raise InputError(f"scalar must be one of {allowed}, got {scalar!r}; choose one of these")
        self.pixels = pixels
        self.axes = camera_axes(VIEW_DIRECTION)
        self.sample = recording.snapshots[:: max(1, len(recording.snapshots) // VIEWED_SNAPSHOTS)]

    def __enter__(self) -> Callable[[int], Any]:
        import pyvista

        surface, snapshots = self.surface, self.recording.snapshots
        rest = surface.rest.astype(float)
        size = float(np.linalg.norm(np.ptp(rest, axis=0)))
        middle, width = self._view(rest)
        self._window = off_screen(width, width / ASPECT_RATIO, middle, self.axes[2], self.pixels)
        plotter: Any = self._window.__enter__()
        unit, factor = FIELD_UNITS[self.scalar]
        largest = round_up(factor * self._largest_value())
        drawn = DrawnBody(plotter, size)
        shadow = add_shadow(plotter, pyvista, rest)
        full_model = self._add_full_model(plotter)
        tools = self._add_tools(plotter, pyvista)
        signed = self.scalar == "pressure"
        caption = Caption(self.recording.title, f"{self.scalar.capitalize()} [{unit}]", largest, signed, 1e3 * width)
        caption.notes = {"Wireframe: full model": FULL_MODEL_COLOUR} if self.recording.full else {}
        if surface.fixed.any():
            caption.notes["Pale: fixed"] = QUIET

        def draw(frame: int) -> Any:
            snapshot, present = snapshots[frame], self.surfaces.at(frame)
            displacements = snapshot.displacements(present)
            values = factor / largest * snapshot.scalar(present, self.scalar, displacements)
            shadow(drawn.update(present, displacements, values, self.axes))
            full_model(frame)
            tools(frame)
            forces = [float(np.linalg.norm(tool.force)) for tool in snapshot.tools if tool.kind != "none"] or [0.0]
            return caption.over(screenshot(plotter), f"Force {', '.join(f'{force:.2f}' for force in forces)} N")

        return draw

    def __exit__(self, *error: Any) -> None:
        self._window.__exit__(*error)

    def _view(self, rest: Floats) -> tuple[Floats, float]:
        """Return the middle [m] and the width [m] of a view of the body, and of tools that touch it."""
        seen = [rest, *(rest + snapshot.displacements(self.surface) for snapshot in self.sample)]
        tools = [tool for snapshot in self.sample for tool in snapshot.tools]
        seen += [tool.position[None] for tool in tools if np.any(tool.force)]
        points = np.concatenate(seen) @ self.axes.T
        low, high = points.min(axis=0), points.max(axis=0)
        across, up, _ = VIEW_MARGIN * (high - low)
        height = max(up, across / ASPECT_RATIO) / (1 - LEGEND_SHARE)
        middle = 0.5 * (low + high) - [0.0, 0.5 * LEGEND_SHARE * height, 0.0]
        return middle @ self.axes, height * ASPECT_RATIO

    def _largest_value(self) -> float:
        moved = ((each, each.displacements(self.surface)) for each in self.sample)
        return max(*(colour_range(each.scalar(self.surface, self.scalar, u))[1] for each, u in moved), 1e-12)

    def _add_full_model(self, plotter: Any) -> Callable[[int], None]:
        """Add the full model as a wireframe; return a function that updates it to a frame."""
        full = self.recording.full
        if not full:
            return lambda frame: None
        full_model = triangle_mesh(full["positions"][0].astype(float), self.surface.triangles)
        plotter.add_mesh(
            full_model, style="wireframe", color=FULL_MODEL_COLOUR, line_width=2.0, opacity=0.5, lighting=False
        )

        def update(frame: int) -> None:
            nearest = int(np.argmin(np.abs(full["times"] - self.recording.times[frame])))
            full_model.points = full["positions"][nearest].astype(float)

        return update

    def _add_tools(self, plotter: Any, pyvista: Any) -> Callable[[int], None]:
        """Add the tools; return a function that shows those of a frame."""
        drawn = []
        for tool in self.recording.tools:
            if tool["kind"] not in TOOLS:
                continue
            if tool["kind"] == "scalpel":
                solid, normals = scalpel_solid(pyvista, tool["length"])
            else:
                grasps = tool["kind"] == "grasp"
                shape = Sphere(DRAWN_FORCEPS_SHARE * tool["radius"]) if grasps else make_tool(tool["kind"], tool)
                solid, normals = revolved_solid(pyvista, shape.outline)
            solid["colour"] = np.zeros((solid.n_points, 3), dtype=np.uint8)
            actor = plotter.add_mesh(solid, scalars="colour", rgb=True, lighting=False)
            drawn.append((tool, actor, np.array(solid.points), normals, solid))

        def update(frame: int) -> None:
            for tool, actor, points, normals, solid in drawn:
                index = tool["index"]
                shown = self.recording.snapshots[frame].tools[index]
                actor.visibility = shown.kind != "none" and self.recording.tool_at(frame, index) is tool
                if not actor.visibility:
                    continue
                rotation = Rotation.from_quat(shown.quaternion, scalar_first=True)
                solid.points = shown.position + rotation.apply(points)
                solid["colour"] = shade_tool(rotation.apply(normals), self.axes, TOOL_COLOURS[index])

        return update


class DrawnBody:
    """The body of a size [m] in a plotter, whose surface a cut can replace."""

    def __init__(self, plotter: Any, size: float) -> None:
        self._plotter, self._size = plotter, size
        self._surface: DisplaySurface | None = None
        self._actors: list[Any] = []
        self._line: Any = None  # of the cut

    def update(self, surface: DisplaySurface, displacements: Singles, values: Any, axes: Floats) -> Floats:
        """Draw a surface with displacements (n, 3) [m] and shares of the colours (n,); return its points."""
        if surface is not self._surface:
            self._replace_surface(surface)
        self._mesh.points, normals = self._refined.places(surface.rest + displacements)
        self._mesh["colour"] = shade(normals, axes, self._refined.values(values), self._fixed, self._mottling)
        if self._line is not None:
            corners = (surface.rest + displacements)[surface.cut_line.corners]
            nearer = LINE_NEARER * self._size * axes[2]  # than the surface, which is curved between the corners
            self._line.points = np.einsum("lek,lkc->lec", self._shares, corners).reshape(-1, 3) + nearer
        return np.asarray(self._mesh.points)

    def _replace_surface(self, surface: DisplaySurface) -> None:
        rest = surface.rest.astype(float)
        self._surface, self._refined = surface, RefinedSurface(rest, surface.triangles)
        self._fixed, self._mottling = self._refined.values(surface.fixed), self._refined.values(rest / self._size)
        self._mesh = triangle_mesh(self._refined.places(rest)[0], self._refined.triangles)
        self._mesh["colour"] = np.zeros((self._mesh.n_points, 3), dtype=np.uint8)
        for actor in self._actors:
            self._plotter.remove_actor(actor)
        self._actors = [self._plotter.add_mesh(self._mesh, scalars="colour", rgb=True, lighting=False)]
        self._line = None
        if len(surface.cut_line.corners):
            self._add_line(surface.cut_line)

    def _add_line(self, line: CutLine) -> None:
        """Draw the line of a cut."""
        import pyvista

        ends = line.ends.reshape(-1, 2, 2).astype(float)
        self._shares = np.concatenate([1.0 - ends.sum(axis=2, keepdims=True), ends], axis=2)
        numbers = np.arange(2 * len(ends)).reshape(-1, 2)
        self._line = pyvista.PolyData(np.zeros((numbers.size, 3)), lines=np.insert(numbers, 0, 2, axis=1).ravel())
        width = LINE_WIDTH * self._plotter.window_size[0]
        self._actors.append(self._plotter.add_mesh(self._line, color=LINE_COLOUR, line_width=width, lighting=False))


def revolved_solid(pyvista: Any, outline: Floats) -> tuple[Any, Floats]:
    """Return the surface of revolution around z of an outline (k, 2) [m], and the normals of its points."""
    angles = np.linspace(0.0, 2 * np.pi, REVOLUTION_POINTS)
    axes = np.array([np.cos(angles), np.sin(angles)])
    points = np.stack([*(outline[:, :1] * axis for axis in axes), np.repeat(outline[:, 1:], len(angles), axis=1)], -1)
    index = np.arange(points[..., 0].size).reshape(points.shape[:2])
    corners = [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]]
    faces = np.stack([np.full_like(corners[0], 4), *corners], -1)
    solid = (
        pyvista.PolyData(points.reshape(-1, 3), faces.ravel())
        .clean(tolerance=1e-6)
        .compute_normals(auto_orient_normals=True)
    )
    return solid, np.asarray(solid.point_data["Normals"])


def scalpel_solid(pyvista: Any, length: float) -> tuple[Any, Floats]:
    """Return a scalpel of an edge length [m] in its frame, and the normals of its points."""
    belly = Scalpel(length=length, toughness=0.0).edge
    top = belly[:, 2].max() + BLADE_HEIGHT * length
    outline = np.concatenate([belly, [[0.5 * length, 0.0, top], [-0.5 * length, 0.0, top]]])
    count, thick = len(outline), BLADE_THICKNESS * length
    flat = pyvista.PolyData(outline - [0.0, 0.5 * thick, 0.0], np.concatenate([[count], np.arange(count)]))
    blade = flat.triangulate().extrude((0.0, thick, 0.0), capping=True)
    handle = pyvista.Box((-0.12 * length, 0.12 * length, -2 * thick, 2 * thick, top, top + HANDLE_LENGTH * length))
    solid = blade.merge(handle.triangulate()).compute_normals(split_vertices=True)
    return solid, np.asarray(solid.point_data["Normals"])


def add_shadow(plotter: Any, pyvista: Any, rest: Floats) -> Callable[[Floats], None]:
    """Add the ground below a body; return a function that gives it the soft shadow of points (n, 3) [m]."""
    from scipy.ndimage import gaussian_filter

    low, high = rest.min(axis=0), rest.max(axis=0)
    radius = 0.5 * float(np.linalg.norm(high - low))
    start, end = low - SHADOW_MARGIN * radius, high + SHADOW_MARGIN * radius
    sides = [np.linspace(start[k], end[k], SHADOW_CELLS + 1) for k in range(2)]
    ground = pyvista.RectilinearGrid(*(0.5 * (side[1:] + side[:-1]) for side in sides), [low[2] - 0.1 * radius])
    ground["colour"] = np.zeros((ground.n_points, 4), dtype=np.uint8)
    plotter.add_mesh(ground, scalars="colour", rgb=True, lighting=False)
    blur = [SHADOW_BLUR * radius / (side[1] - side[0]) for side in sides]

    def update(points: Floats) -> None:
        counts = np.histogram2d(points[:, 0], points[:, 1], sides)[0]
        ground["colour"][:, 3] = np.rint(255 * SHADOW_STRENGTH * gaussian_filter(1.0 * (counts > 0), blur).T.ravel())

    return update


class Caption:
    """Title, a text that changes, legend and scale bar over a picture of a width in millimetres.

    The colours of `quantity` end at `largest`, in its unit; `signed` ones start at minus this value.
    """

    def __init__(self, title: str, quantity: str, largest: float, signed: bool, millimetres: float) -> None:
        self.title, self.quantity, self.largest, self.signed = title, quantity, largest, signed
        self.millimetres = millimetres
        self.notes: dict[str, str] = {}  # texts at the upper right, and their colours
        self._figure: Any = None

    def over(self, picture: Any, text: str) -> Any:
        """Return a picture (h, w, 3) with the caption and a text below the title."""
        if self._figure is None:
            self._lay_out(picture)
        self._shown.set_data(picture)
        self._text.set_text(text)
        self._figure.canvas.draw()
        return np.asarray(self._figure.canvas.buffer_rgba())[..., :3].copy()

    def _lay_out(self, picture: Any) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        height, width = picture.shape[:2]
        dpi = 100 * width / MOVIE_PIXELS  # texts keep their share of the picture
        self._figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi)
        FigureCanvasAgg(self._figure)
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        self._shown = axes.imshow(picture, interpolation="none", aspect="auto")
        tall = width / height / ASPECT_RATIO  # distances from the edges keep their share of the width

        def bottom(height: float) -> float:
            return height * tall

        def top(height: float) -> float:
            return 1 - (1 - height) * tall

        text = self._figure.text
        text(0.035, top(0.94), self.title, color=INK, size=11, weight="bold", va="center")
        self._text = text(0.035, top(0.885), "", color=QUIET, size=9, va="center")
        for row, (note, colour) in enumerate(self.notes.items()):
            text(0.965, top(0.94 - 0.055 * row), note, color=colour, size=9, va="center", ha="right")
        text(0.035, bottom(0.115), self.quantity, color=QUIET, size=9, va="center")
        bar = self._figure.add_axes((0.035, bottom(0.075), 0.28, bottom(0.016)))
        bar.imshow(np.linspace(0, 1, 256)[None], aspect="auto", cmap=colour_map(self.signed))
        bar.set_axis_off()
        start = f"\N{MINUS SIGN}{self.largest:g}" if self.signed else "0"
        text(0.035, bottom(0.045), start, color=QUIET, size=9, va="center")
        text(0.315, bottom(0.045), f"{self.largest:g}", color=QUIET, size=9, va="center", ha="right")
        length = max(n for n in (1, 2, 5, 10, 20, 50, 100, 200, 500) if n <= max(1.0, self.millimetres / 6))
        share = length / self.millimetres
        line = self._figure.add_axes((0.965 - share, bottom(0.075), share, bottom(0.016)))
        line.plot([0, 0, 1, 1], [1, 0, 0, 1], color=QUIET, lw=1.2, clip_on=False)
        line.set(xlim=(0, 1), ylim=(0, 1))
        line.set_axis_off()
        text(0.965, bottom(0.045), f"{length} mm", color=QUIET, size=9, va="center", ha="right")
