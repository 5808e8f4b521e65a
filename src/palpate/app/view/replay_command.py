"""Command ``palpate replay``: shows or draws a recording, or replays it on the full model."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.app.common.console import Console, count_nodes, percent, print_plain, quantities_table
from palpate.app.recordings.recording import Recording, load_recording, save_recording
from palpate.app.session.full_model_replay import full_model, reduced_model, replay_on_full_model, tool_path
from palpate.app.session.replay import Replay
from palpate.app.train.scene_folder import last_recording
from palpate.app.view.film import (
    MOVIE_PIXELS,
    RecordingPlotter,
    check_movie,
    check_picture,
    write_movie,
    write_picture,
)
from palpate.app.view.server.address import DEFAULT_PORT, LOOPBACK
from palpate.dynamics.run.progress import progress_bar
from palpate.extras import require
from palpate.faults import InputError
from palpate.files import check_folder
from palpate.scenes.names import SceneKind, kind_of

__all__ = ["replay"]


def replay(
    file: Path,
    *,
    full: bool = False,
    scene: str | None = None,
    png: Path | None = None,
    movie: Path | None = None,
    scalar: str = "displacement",
    port: int = DEFAULT_PORT,
    host: str = LOOPBACK,
    browser: bool = True,
) -> int:
    """Show a recording on a page, or export it.

    Parameters
    ----------
    file : path
        File of a recording, or a scene file: its newest recording.
    full : bool
        First replay the tool's path on the full model, print the errors, and store its surface in the file.
    scene : str, optional
        Scene of the full model, ``"module:function"``, if it is not one of palpate's; see
        `palpate.app.session.full_model_replay.full_model`.
    png, movie : path, optional
        Draw the snapshot of the largest force, or all snapshots, instead of serving a page.
    scalar : str
        Scalar that colours the pictures.
    port, host, browser
        As for `palpate.app.view.command.view`.

    Returns
    -------
    int
        0.
    """
    console = Console()
    if kind_of(file.name) is SceneKind.SCENE_FILE:
        file = last_recording(file)
        console.say(f"replaying {file}")
    if movie is not None:
        check_movie(movie)
    if png is not None and png.suffix.lower() != ".png":
        raise InputError(f"png must end in .png, got {str(png)!r}; choose another name")
    if png is not None:
        check_picture()
    elif movie is None and not full:
        require("websockets", "palpate replay")
    for path, name in ((png, "png"), (movie, "movie"), (file.with_suffix(".vtkhdf") if full else None, "full")):
        if path is not None:
            check_folder(path.parent, name)
            if path.exists() and file.exists() and os.path.samefile(path, file):
                raise InputError(f"{name} must not replace the recording, got {str(path)!r}; choose another name")
    if scene is not None and not full:
        raise InputError(f"scene must be left out without --full, got {scene!r}; add --full")
    recording = load_recording(file)
    if full:
        recording = replace(recording, full=_replay_full(recording, scene, console))
        save_recording(file, recording)
    if png is not None or movie is not None:
        _draw(recording, scalar, png, movie, console)
    elif not full:
        from palpate.app.view.server.host import serve_source

        serve_source(Replay(recording), console, port, host, browser)
    return 0


def _draw(recording: Recording, scalar: str, png: Path | None, movie: Path | None, console: Console) -> None:
    if png is not None:
        with RecordingPlotter(recording, scalar) as draw:
            write_picture(png, recording, draw)
        console.say(f"drew {png}")
    if movie is not None:
        with (
            RecordingPlotter(recording, scalar, MOVIE_PIXELS) as draw,
            progress_bar("movie", float(recording.times[-1]), True) as shown,
        ):
            write_movie(movie, recording, draw, shown)
        console.say(f"drew {movie}")


def _replay_full(recording: Recording, scene: str | None, console: Console) -> dict[str, Any]:
    tool_path(recording)  # refuses unsuitable recordings before the model is made
    with console.status(
        "preparing the full model (the first run on a machine compiles it, which takes a minute or two)"
    ):
        model = full_model(reduced_model(recording), scene)
    console.say(f"replaying the recorded path on {count_nodes(len(model.cloud))} of the full model ...")
    full = replay_on_full_model(recording, model)
    errors = full["errors"]
    rows = {
        "displacement of the surface, root mean square": percent(errors["displacement"]),
        "displacement, largest error over the largest": percent(errors["largest"]),
        "force on the tool, mean error over the largest": percent(errors["force"]),
        "largest force over the full model's": f"{1 + errors['peak']:.3f}",
        "computing time of the full model over the recorded time": f"{errors['wall_seconds'] / errors['seconds']:.3g}",
    }
    table = quantities_table(f"{recording.title}: recorded against the full model", ["error"],
                             {name: [value] for name, value in rows.items()})  # fmt: skip
    print_plain([table], Path("."), ())
    return full
