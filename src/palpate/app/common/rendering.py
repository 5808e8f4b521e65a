"""Rendering of surfaces off-screen."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.figures import scale_bar
from palpate.app.common.shading import RefinedSurface, colour_map, shade, triangle_mesh
from palpate.core.arrays import Floats, Ints
from palpate.core.extras import require
from palpate.core.faults import InputError

PIXELS = 2000  # across a picture
VIEW_PIXELS = 900  # across one of several views
SAMPLES = 2  # rendered for each pixel of a picture, along its width and height

# VTK opens its graphics libraries only when it draws, and crashes where one is missing: let another process try.
PROBE = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.AddRenderer(vtkRenderer())
window.Render()
raise SystemExit(0 if window.SupportsOpenGL() else 3)
"""


class DrawingError(RuntimeError):
    """VTK cannot draw on this machine; the message names what to install."""


def check_drawing() -> None:
    """Check that PyVista is installed and VTK can draw without a display, by default through EGL."""
    try:
        for package in ("pyvista", "matplotlib"):
            require(package, "drawing surfaces")
    except InputError as error:
        raise DrawingError(str(error)) from error
    os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    try:
        probe = subprocess.run([sys.executable, "-P", "-c", PROBE], capture_output=True, timeout=120, check=False)
        works = probe.returncode == 0
    except subprocess.TimeoutExpired:
        works = False
    if not works:
        raise DrawingError(
            "VTK cannot draw off-screen on this machine; on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri"
        )


def camera_axes(towards: Floats) -> Floats:
    """Return the unit vectors to the right, up and towards a camera (3, 3) as rows; z points up in space."""
    towards = towards / np.linalg.norm(towards)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


def screenshot(plotter: Any) -> NDArray[np.uint8]:
    """Return what a plotter of `off_screen` shows as pixels (h, w, 3), each the mean of `SAMPLES` by `SAMPLES`."""
    plotter.reset_camera_clipping_range()
    plotter.render()
    image = np.asarray(plotter.screenshot(return_img=True))[..., :3].astype(np.uint16)
    height, width = (size - size % SAMPLES for size in image.shape[:2])
    corners = np.ndindex(SAMPLES, SAMPLES)
    total = sum(image[row:height:SAMPLES, column:width:SAMPLES] for row, column in corners)
    return np.asarray(total // SAMPLES**2, dtype=np.uint8)


@contextmanager
def off_screen(width: float, height: float, middle: Floats, towards: Floats, pixels: int = PIXELS) -> Iterator[Any]:
    """Yield a PyVista plotter on white that looks at `middle` (3,) [m] in a parallel projection.

    The picture spans `width` and `height` [m] in its plane, and is `pixels` wide. `towards` (3,) is the direction from
    `middle` to the camera; z points up.
    """
    import pyvista

    pv: Any = pyvista
    size = [SAMPLES * pixels, SAMPLES * round(pixels * height / width)]
    plotter = pv.Plotter(off_screen=True, window_size=size)
    try:
        plotter.set_background("white")
        plotter.camera_position = [tuple(middle + 3 * width * towards), tuple(middle), (0.0, 0.0, 1.0)]
        plotter.enable_parallel_projection()
        plotter.camera.parallel_scale = height / 2
        plotter.disable_anti_aliasing()
        yield plotter
    finally:
        plotter.close()


def add_shaded(
    plotter: Any,
    points: Floats,
    triangles: Ints,
    towards: Floats,
    colours: Callable[[RefinedSurface], dict[str, Floats]],
) -> None:
    """Add a smooth surface, of points (n, 3) [m], in the light of the page.

    `towards` (3,) is the direction from the body to the camera, not along z. `colours` returns further arguments of
    `palpate.app.common.shading.shade` at the vertices of the refined surface.
    """
    refined = RefinedSurface(points, triangles)
    places, normals = refined.places(points)
    body = triangle_mesh(places, refined.triangles)
    body["colour"] = shade(normals, camera_axes(towards), **colours(refined))
    plotter.add_mesh(body, scalars="colour", rgb=True, lighting=False)


def place_picture(axes: Any, picture: NDArray[np.uint8], spans: tuple[float, float, float, float], title: str) -> None:
    """Show a picture in matplotlib axes, which span left, right, low and high [mm]."""
    axes.imshow(picture, extent=spans, interpolation="antialiased")
    axes.set(xlim=spans[:2], ylim=spans[2:])
    axes.set_axis_off()
    axes.set_title(title)


def add_colour_bar(drawn: Any, axes: Any, limit: float, label: str, **style: Any) -> None:
    """Add a horizontal bar of the colours from 0 to a limit."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = drawn.colorbar(ScalarMappable(Normalize(0, limit), colour_map()), ax=axes, orientation="horizontal", **style)
    bar.set_label(label)


def show(axes: Any, points: Floats, towards: Floats, title: str, draw: Callable[[Any, float], None]) -> None:
    """Show a body of points (n, 3) [m], seen from a side, in matplotlib axes, with a scale bar.

    `towards` (3,) is the direction from the body to the camera, not along z. `draw` adds meshes to a PyVista plotter;
    it also gets the width of the view [m].
    """
    right, up, towards = camera_axes(towards)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    low, high = (limit((points - middle) @ np.column_stack([right, up]), axis=0) for limit in (np.min, np.max))
    middle = middle + 0.5 * (low + high) @ [right, up]
    width, height = 1.05 * (high - low)
    with off_screen(width, height, middle, towards, VIEW_PIXELS) as plotter:
        draw(plotter, width)
        image = screenshot(plotter)
    half = 0.5e3 * width, 0.5e3 * height
    place_picture(axes, image, (-half[0], half[0], -half[1], half[1]), title)
    below = 0.06 * max(half)  # the scale bar covers no part of the body
    axes.set_ylim(-half[1] - 2 * below, half[1])
    scale_bar(axes, -half[0], half[0], -half[1] - below)
