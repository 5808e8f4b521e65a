"""Preparation of a run: build the model, and check its folder for results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from palpate.app.common.console import Console
from palpate.files import check_folder, check_space
from palpate.scenes.scene import Scene

FIGURES_SIZE = 5_000_000  # [bytes] of all figures of a study, about


def prepare(build: Callable[[], Scene], out: Path, doubles: int, console: Console) -> Scene:
    """Build a scene, check that its results can be written, and make their folder.

    Parameters
    ----------
    build : function
        Returns the scene.
    out : path
        Folder.
    doubles : int
        Numbers that the snapshots and the export hold for every node and time.
    """
    check_folder(out)
    with console.status("making the model ready (the first run on a machine compiles it: a minute or two)"):
        scene = build()
    frames, nodes = round(scene.duration / scene.every) + 1, len(scene.model.cloud)
    check_space(out, doubles * frames * nodes * 8 + FIGURES_SIZE)
    out.mkdir(parents=True, exist_ok=True)
    console.say(f"{scene.title}: {nodes} nodes; {scene.model.stability.step:.3g} s is stable at rest")
    return scene
