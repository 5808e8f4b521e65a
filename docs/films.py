"""Make the films of the docs: a press on the liver, the beam to four times its length, the membrane's wave.

    python docs/films.py [liver_press] [beam_pull] [membrane_wave] [readme_displacement]

Films are animated WebP files of 640 pixels across in docs/images, each below 3 MB. The liver is a session of
``palpate view liver`` that a script drives in real time; the beam and the membrane are the paper's, stepped in full.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

import palpate as pt
from palpate.app.common.figures import figure
from palpate.app.common.rendering import add_shaded, camera_axes, check_drawing, off_screen, screenshot
from palpate.app.common.shading import QUIET, round_up
from palpate.app.view.film import FRAME_RATE, MOVIE_PIXELS, Caption, movie_writer
from palpate.scenes.beam import beam
from palpate.scenes.membrane import membrane

IMAGES, README = Path(__file__).parent / "images", Path(__file__).parents[1] / "README.md"
MAX_FILM_BYTES = 3_000_000
FILM_SECONDS = 3.0
FRAMES = round(FILM_SECONDS * FRAME_RATE)


class View(NamedTuple):
    """How a run is shown: title, a note, direction to the camera, scale of displacements, and width over height."""

    title: str
    note: str
    towards: tuple[float, float, float]
    scale: Any
    aspect_ratio: float


def press_script() -> list[dict[str, object]]:
    """Return messages of docs/protocol.md: a ball presses the liver by 10.5 mm, slides by 14 mm and lifts, in 3.2 s."""
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
        session = ["view", "liver", "--headless", "--seconds", "3.2", "--script", script, "--record", recording]
        subprocess.run([*palpate, *session], check=True)
        subprocess.run([*palpate, "replay", recording, "--movie", path], check=True)


def run_film(path: Path, scene: Any, view: View, duration: float) -> None:
    """Film the run of a full model, coloured by its displacements, over `FILM_SECONDS`."""
    run = pt.rollout(scene.model, scene.loads, duration=duration, every=duration / FRAMES, progress=False)
    cloud, axes = scene.model.cloud, camera_axes(np.array(view.towards))
    rest = np.zeros((len(cloud), 3))
    rest[:, : cloud.points.shape[1]] = cloud.points
    seen = np.concatenate([rest + view.scale * u for u in run.displacements]) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    width = 1.08 * (high - low)[0]
    height = width / view.aspect_ratio
    middle = 0.5 * (low + high) @ axes
    largest = round_up(1e3 * np.linalg.norm(run.displacements, axis=-1).max())
    caption = Caption(view.title, "Displacement [mm]", largest, False, 1e3 * width)
    caption.notes = {view.note: QUIET, f"Slowed {FILM_SECONDS / duration:.0f} times": QUIET}
    with off_screen(width, height, middle, axes[2], MOVIE_PIXELS) as plotter, movie_writer(path) as add:
        for time, u in zip(run.times, run.displacements, strict=True):
            plotter.clear_actors()
            values = 1e3 / largest * np.linalg.norm(u, axis=1)
            moved = rest + view.scale * u
            add_shaded(plotter, moved, cloud.triangles, axes[2], lambda body, t=values: {"values": body.values(t)})
            add(caption.over(screenshot(plotter), f"{1e3 * time:.0f} ms"))


def beam_pull(path: Path) -> None:
    """Film the paper's beam, pulled to four times its length."""
    view = View("Beam pulled by 100 N", "1,025 nodes", (0.25, -0.9, 0.35), 1.0, 2.6)
    run_film(path, beam(), view, 1.0)


def membrane_wave(path: Path) -> None:
    """Film the paper's membrane, pushed at its centre for 0.1 s and let go."""
    view = View("Membrane pushed for 100 ms, let go", "Heights times 4", (0.0, -0.9, 0.42), np.array([1, 1, 4.0]), 1.45)
    run_film(path, membrane(after="release"), view, 0.2)


def readme_displacement(path: Path) -> None:
    """Draw the picture that the example of the README makes."""
    example = re.search(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    statements, _, plot = example[1].rstrip().rpartition("\n")
    names: dict[str, Any] = {}
    exec(compile(statements, README.name, "exec"), names)
    with figure(path, (7.0, 3.2)) as drawn:
        eval(plot.replace(")", ", axes=axes)"), names | {"axes": drawn.subplots()})


FILMS = {film.__name__: film for film in (liver_press, beam_pull, membrane_wave)}
PICTURES = {readme_displacement.__name__: readme_displacement}


def main() -> None:
    """Make the films named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="*", choices=[*FILMS, *PICTURES, []], help="default: all")
    check_drawing()
    for name in parser.parse_args().name or [*FILMS, *PICTURES]:
        path = IMAGES / f"{name}{'.webp' if name in FILMS else '.png'}"
        (FILMS | PICTURES)[name](path)
        size = path.stat().st_size
        print(f"{path}: {size / 1e6:.2f} MB")
        if size > MAX_FILM_BYTES:
            raise SystemExit(f"{path} must be below {MAX_FILM_BYTES / 1e6:g} MB; lower the quality or the duration")


if __name__ == "__main__":
    main()
