"""Make the films of the docs: a press on the liver, the beam to four times its length, the membrane's wave.

    python docs/films.py [liver_press] [beam_pull] [membrane_wave]

Films are animated WebP files of 640 pixels across in docs/images, each below 3 MB. The liver is a session of
``palpate view liver`` that a script drives in real time; the beam and the membrane are the paper's, stepped in full.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

IMAGES = Path(__file__).parent / "images"
MAX_FILM_BYTES = 3_000_000


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


FILMS = {film.__name__: film for film in (liver_press,)}


def main() -> None:
    """Make the films named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("film", nargs="*", choices=[*FILMS, []], help="default: all")
    for name in parser.parse_args().film or FILMS:
        path = IMAGES / f"{name}.webp"
        FILMS[name](path)
        size = path.stat().st_size
        print(f"{path}: {size / 1e6:.2f} MB")
        if size > MAX_FILM_BYTES:
            raise SystemExit(f"{path} must be below {MAX_FILM_BYTES / 1e6:g} MB; lower the quality or the duration")


if __name__ == "__main__":
    main()
