"""Make the films of the docs: a press on the liver, and a cut.

    python docs/films.py [liver_press] [liver_cut]

Films are animated WebP files of 640 pixels across in docs/images, each below 3 MB. The liver is a session of
``palpate view liver`` that a script drives in real time; it is cut in a run of the full body.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pyvista
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.app.common.rendering import camera_axes, check_drawing, off_screen, screenshot
from palpate.app.common.shading import QUIET, shade_tool
from palpate.app.view.film import (
    FRAME_RATE,
    MOVIE_PIXELS,
    Caption,
    DrawnBody,
    add_shadow,
    movie_writer,
    scalpel_solid,
)
from palpate.dynamics.contact.blade import Scalpel
from palpate.realtime.bodies.cut_display import CutFullSurface
from palpate.realtime.bodies.full_surface import FullSurface

IMAGES = Path(__file__).parent / "images"
MAX_FILM_BYTES = 3_000_000
CUT_SECONDS, EDGE_LENGTH, FORCEPS_RADIUS = 3.2, 0.044, 0.004  # of the film of a cut [s], and [m]
CUT_TOUGHNESS = 2.0  # [J/m^2], of tissue that is cut before it is dragged along


def press_script() -> list[dict[str, object]]:
    """Return messages that press a ball 10.5 mm into the liver, slide it by 14 mm and lift it, in 3.2 s."""
    radius, depth, clear, slide = 0.0225, 0.0105, 0.010, 0.014  # [m]
    touched = np.array([0.042, -0.0468, 0.0444])  # on the liver's surface
    inwards, along = np.array([0.05, 0.62, -0.78]), np.array([1.0, 0.1, 0.0])
    inwards /= np.linalg.norm(inwards)
    along -= (along @ inwards) * inwards
    times = np.arange(0, 3.2, 0.01)
    pressed = np.interp(times, [0.1, 1.0, 2.2, 3.0], [0, 1, 1, 0])
    moved = np.interp(times, [0.1, 0.8, 2.4, 3.0], [-0.5, -0.5, 0.5, 0.5])
    pressed, moved = (x * x * (3 - 2 * x) for x in (pressed, moved + 0.5))
    heights = depth * pressed - clear * (1 - pressed) - radius
    places = touched + np.outer(heights, inwards) + np.outer(slide * (moved - 0.5), along)
    messages = [{"type": "pose", "time": float(t), "position": x.tolist()} for t, x in zip(times, places, strict=True)]
    return [{**messages[0], "type": "tool", "kind": "sphere", "radius": radius, "friction": 0.2}, *messages[1:]]


def liver_press(path: Path) -> None:
    """Film a press on the liver."""
    with TemporaryDirectory() as folder:
        script, recording = Path(folder, "press.jsonl"), Path(folder, "press.h5")
        script.write_text("\n".join(map(json.dumps, press_script())))
        palpate = [sys.executable, "-m", "palpate"]
        session = ["run", "liver", "--script", script, "--seconds", "3.2", "--record", recording, "--out", folder]
        subprocess.run([*palpate, *session], check=True)
        subprocess.run([*palpate, "replay", recording, "--movie", path], check=True)


class Cutting(NamedTuple):
    """A scalpel and four forceps over the liver: a rotation (3, 3), and places [m] by frame, (f, 3) and (4, f, 3)."""

    times: Any
    rotation: Any
    blade: Any
    forceps: Any


def cutting() -> Cutting:
    """Return how forceps hold the liver taut, a scalpel cuts between them, and the forceps part the wound."""
    surface = pt.liver_surface().vertices
    inwards, along = np.array([0.05, 0.66, -0.75]), np.array([1.0, 0.1, -0.12])
    inwards /= np.linalg.norm(inwards)
    along -= (along @ inwards) * inwards
    along /= np.linalg.norm(along)
    across = np.cross(-inwards, along)

    def nearest(place: Any) -> Any:
        return surface[np.linalg.norm(surface - place, axis=1).argmin()]

    def way(times: list[float], values: list[float]) -> Any:
        """Return numbers (f, 1) by frame that begin and end smoothly between given ones."""
        frame = np.arange(round(CUT_SECONDS * FRAME_RATE) + 1) / FRAME_RATE
        k = np.clip(np.searchsorted(times, frame) - 1, 0, len(times) - 2)
        first, last = np.array(times)[k], np.array(times)[k + 1]
        share = np.clip((frame - first) / (last - first), 0, 1)
        start, end = np.array(values)[k], np.array(values)[k + 1]
        return (start + share**2 * (3 - 2 * share) * (end - start))[:, None]

    middle = nearest(np.array([0.03, -0.043, 0.05]))
    depth = way([0, 0.2, 0.6, 1.7, 2.3], [-0.014, -0.014, 0.013, 0.013, -0.25])
    slide = way([0, 0.4, 1.7], [-0.038, -0.038, 0.036])
    parted = way([0, 0.4, 1.8, 2.8], [0, 0.003, 0.003, 0.014])
    forceps = [
        nearest(middle + side * 0.016 * across + place * along) + parted * (side * across - 0.3 * inwards)
        for side in (1, -1) for place in (-0.012, 0.012)
    ]  # fmt: skip
    times = np.arange(len(depth)) / FRAME_RATE
    rotation = np.column_stack([along, across, -inwards])
    return Cutting(times, rotation, middle + depth * inwards + slide * along, np.array(forceps))


def liver_cut(path: Path) -> None:
    """Film a cut of the liver: forceps hold it, a scalpel passes, and the wound opens."""
    cutting_tools, liver = cutting(), pt.open_scene("liver").body
    times, rotation = cutting_tools.times, cutting_tools.rotation
    turned = tuple(Rotation.from_matrix(rotation).as_rotvec())

    def pose(time: float) -> Any:
        return tuple(np.interp(time, times, column) for column in cutting_tools.blade.T), turned

    grasps = [
        pt.tools.Grasp(places[0], 0.009, (times, places), name=f"forceps {k}")
        for k, places in enumerate(cutting_tools.forceps)
    ]
    knife = pt.tools.Contact(Scalpel(length=EDGE_LENGTH, toughness=CUT_TOUGHNESS), pose, name="scalpel")
    run = pt.rollout(liver, [*grasps, knife], duration=times[-1], every=1 / FRAME_RATE, progress=False)
    draw_cut(path, liver, run, cutting_tools)


def draw_cut(path: Path, body: Any, run: Any, tools: Cutting) -> None:
    """Draw a run in which a scalpel cuts a body."""
    uncut = surface = FullSurface(body)
    axes = camera_axes(np.array([0.2, -0.85, 0.5]))
    seen = body.cloud.points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    height = 1.42 * (high - low)[1]
    width = 4 / 3 * height
    middle = (0.5 * (low + high) - [0, 0.015 * height, 0]) @ axes
    largest, size = 20.0, float(np.linalg.norm(np.ptp(body.cloud.points, axis=0)))
    caption = Caption("Scalpel cuts a liver, forceps open the wound", "Displacement [mm]", largest, False, 1e3 * width)
    caption.notes = {f"{len(body.cloud):,} nodes, {1e6 * run.cut_area[-1]:,.0f} mm² cut": QUIET}
    with off_screen(width, height, middle, axes[2], MOVIE_PIXELS) as plotter, movie_writer(path) as add:
        drawn, shadow = DrawnBody(plotter, size), add_shadow(plotter, pyvista, uncut.rest.astype(float))
        blade = scalpel_solid(pyvista, EDGE_LENGTH)
        balls = [pyvista.Sphere(radius=FORCEPS_RADIUS, theta_resolution=48, phi_resolution=48) for _ in tools.forceps]
        solids = [(blade[0], blade[1] @ tools.rotation.T, np.array(blade[0].points) @ tools.rotation.T)]
        solids += [(ball, np.array(ball.points) / FORCEPS_RADIUS, np.array(ball.points)) for ball in balls]
        for solid, normals, _ in solids:
            solid["colour"] = shade_tool(normals, axes)
            plotter.add_mesh(solid, scalars="colour", rgb=True, lighting=False)
        count = 0
        for frame, (time, u) in enumerate(zip(run.times, run.displacements, strict=True)):
            triangles = run.cuts[run.cuts[:, 0] <= frame, 1:].reshape(-1, 3, 3)
            if len(triangles) > count:
                count, surface = len(triangles), CutFullSurface(pt.cut(body, triangles), uncut)
            moved = surface.displacements(u.ravel(), np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
            shadow(drawn.update(surface, moved, 1e3 / largest * np.linalg.norm(moved, axis=1), axes))
            for (solid, _, points), place in zip(solids, [tools.blade[frame], *tools.forceps[:, frame]], strict=True):
                solid.points = place + points
            add(caption.over(screenshot(plotter), f"{time:.1f} s"))


FILMS = {film.__name__: film for film in (liver_press, liver_cut)}


def main() -> None:
    """Make the films named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="*", choices=[*FILMS, []], help="default: all")
    check_drawing()
    for name in parser.parse_args().name or FILMS:
        path = IMAGES / f"{name}.webp"
        FILMS[name](path)
        size = path.stat().st_size
        print(f"{path}: {size / 1e6:.2f} MB")
        if size > MAX_FILM_BYTES:
            raise SystemExit(f"{path} must be below {MAX_FILM_BYTES / 1e6:g} MB; lower the quality or the duration")


if __name__ == "__main__":
    main()
