"""``palpate replay``: a recording on the page, as a picture, as a film, or run again on the full model."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.app.console import Console, count_nodes, percent, print_plain, quantities_table
from palpate.app.view.address import LOOPBACK, PORT
from palpate.app.view.film import check_film, check_picture, drawn, write_film, write_picture
from palpate.app.view.fullrun import full_model, path_of, run_full
from palpate.app.view.recording import Recording, load_recording, save_recording
from palpate.app.view.replay import Replay
from palpate.dynamics.run.progress import progress_bar
from palpate.extras import require
from palpate.faults import InputError
from palpate.files import check_folder

__all__ = ["replay"]


def replay(
    file: Path,
    *,
    full: bool = False,
    scene: str | None = None,
    png: Path | None = None,
    movie: Path | None = None,
    scalar: str = "displacement",
    port: int = PORT,
    host: str = LOOPBACK,
    browser: bool = True,
) -> int:
    """Show a recording on a page, or export it.

    Parameters
    ----------
    file : path
        Of a recording.
    full : bool
        Run the tool's path on the full model first, print the errors, and keep the full model's surface in the file.
    scene : str, optional
        Scene of the full model, ``"module:function"``, where it is not one of palpate's; see
        `palpate.app.view.fullrun.full_model`.
    png, movie : path, optional
        Draw the moment of the largest force, or all, instead of serving a page.
    scalar : str
        What colours in pictures tell.
    port, host, browser
        As for `palpate.app.view.command.view`; what is raised, too, and DivergenceError where the full model left the
        range of sensible states. Returns 0.
    """
    console = Console()
    if movie is not None:
        check_film(movie)
    if png is not None and png.suffix.lower() != ".png":
        raise InputError(f"png = {str(png)!r}: allowed is a name that ends in .png")
    if png is not None:
        check_picture()
    elif movie is None and not full:
        require("websockets", "palpate replay")
    for path, name in ((png, "png"), (movie, "movie"), (file.with_suffix(".vtkhdf") if full else None, "full")):
        if path is not None:
            check_folder(path.parent, name)
            if path.exists() and file.exists() and os.path.samefile(path, file):
                raise InputError(f"{name} would replace the recording {str(file)!r} itself; choose another name")
    if scene is not None and not full:
        raise InputError("scene is for the run of the full model: add --full, or leave --scene out")
    recording = load_recording(file)
    if full:
        recording = replace(recording, full=_run_full(recording, scene, console))
        save_recording(file, recording)
    if png is not None or movie is not None:
        _draw(recording, scalar, png, movie, console)
    elif not full:
        from palpate.app.view.stand import serve_show

        serve_show(Replay(recording), console, port, host, browser)
    return 0


def _draw(recording: Recording, scalar: str, png: Path | None, movie: Path | None, console: Console) -> None:
    with drawn(recording, scalar) as draw:
        if png is not None:
            write_picture(png, recording, draw)
            console.say(f"drew {png}")
        if movie is not None:
            with progress_bar("film", float(recording.times[-1]), True) as shown:
                write_film(movie, recording, draw, shown)
            console.say(f"drew {movie}")


def _run_full(recording: Recording, scene: str | None, console: Console) -> dict[str, Any]:
    path_of(recording)  # what cannot be run is refused before a model is made
    with console.status("making the full model ready (the first run on a machine compiles it: a minute or two)"):
        model = full_model(recording, scene)
    console.say(f"running the recorded path on {count_nodes(len(model.cloud))} of the full model ...")
    full = run_full(recording, model)
    told = full["errors"]
    rows = {
        "displacement of the surface, root mean square": percent(told["displacement"]),
        "displacement, largest distance over the largest": percent(told["largest"]),
        "force on the tool, mean distance over the largest": percent(told["force"]),
        "largest force over the full model's": f"{1 + told['peak']:.3f}",
        "computing time of the full model over the recorded time": f"{told['wall_seconds'] / told['seconds']:.3g}",
    }
    table = quantities_table(f"{recording.title}: recorded against the full model", ["error"],
                             {name: [value] for name, value in rows.items()})  # fmt: skip
    print_plain([table], Path("."), ())
    return full
