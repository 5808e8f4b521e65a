"""Build the load case of a run, and check the folder of its results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from palpate.app.common.console import Console
from palpate.core.files import check_folder, check_space
from palpate.scenes.load_case import LoadCase

FIGURES_SIZE = 5_000_000  # [bytes] of all figures of a study, about


def build_load_case(build: Callable[[], LoadCase], out: Path, doubles: int, console: Console) -> LoadCase:
    """Build a load case, check that its results can be written, and make their folder.

    `doubles` are the numbers that the snapshots and the export hold for every node and time.
    """
    check_folder(out)
    with console.status("making the model ready (the first time on a machine compiles it, for about a minute)"):
        case = build()
    frames, nodes = round(case.duration / case.every) + 1, len(case.model.cloud)
    check_space(out, doubles * frames * nodes * 8 + FIGURES_SIZE)
    out.mkdir(parents=True, exist_ok=True)
    console.say(f"{case.title}: {nodes} nodes; {case.model.stability.step:.3g} s is stable at rest")
    return case
