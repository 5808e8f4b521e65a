"""Command ``palpate replay``: shows, draws or exports a recording, or replays it on the full model."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.app.common.console import Console, count_nodes, print_plain
from palpate.app.common.rows import Rows, quantities
from palpate.app.recordings.deformed_labels import write_deformed_labels
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
from palpate.app.view.server.address import DEFAULT_PORT, LOOPBACK, public_address
from palpate.core.extras import require
from palpate.core.faults import InputError
from palpate.core.files import check_folder
from palpate.dynamics.run.progress import progress_bar
from palpate.scenes.names import SceneKind, kind_of

ERROR_ROWS: Rows = {
    "displacement of the surface, root mean square": "{displacement:.2%}",
    "displacement, largest error over the largest": "{largest:.2%}",
    "force on the tool, mean error over the largest": "{force:.2%}",
    "largest force over the full model's": lambda errors: f"{1 + errors['peak']:.3f}",
    "computing time of the full model over the recorded time": (
        lambda errors: f"{errors['wall_seconds'] / errors['seconds']:.3g}"
    ),
}


def replay(
    file: Path,
    *,
    full: bool = False,
    scene: str | None = None,
    png: Path | None = None,
    movie: Path | None = None,
    scalar: str = "displacement",
    labels: Path | None = None,
    out: Path | None = None,
    field: Path | None = None,
    frame: float | None = None,
    part: Sequence[str] | None = None,
    port: int = DEFAULT_PORT,
    host: str = LOOPBACK,
    public_url: str | None = None,
    browser: bool = True,
) -> int:
    """Show a recording, or the newest one of a scene file, on a page, or export it.

    `full` first replays the tool's path on the full model, prints the errors, and stores its surface in the file.
    `scene` is that of the full model, ``"module:function"``, if it is not one of palpate's; see
    `palpate.app.session.full_model_replay.full_model`. `png` draws the snapshot of the largest force, `movie` all
    snapshots, instead of serving a page. `labels`, `out`, `field`, `frame` and `part` write a deformed label map or a
    field instead; see `write_deformed_labels`.
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
    if public_url is not None:
        public_address(public_url)
    exports = png is not None or movie is not None or labels is not None
    if not exports and not full:
        require("websockets", "palpate replay")
    if (labels is None) is not (out is None and field is None):
        raise InputError("labels must be given with --out or --field, and these with labels; add the other one")
    if labels is None and (frame is not None or part):
        raise InputError("frame and part must be given with labels, got them alone; add --labels MAP --out FILE")
    surface_file = file.with_suffix(".vtkhdf") if full else None
    written = ((png, "png"), (movie, "movie"), (surface_file, "full"), (out, "out"), (field, "field"))
    for path, name in written:
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
    if labels is not None:
        for line in write_deformed_labels(recording, labels, out=out, field_out=field, time=frame, part=part):
            console.say(line)
    if png is not None or movie is not None:
        _draw(recording, scalar, png, movie, console)
    if not exports and not full:
        from palpate.app.view.server.host import serve_source

        serve_source(Replay(recording), console, port, host, browser, public_url)
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
    with console.status("preparing the full model (the first time on a machine compiles it, for about a minute)"):
        model = full_model(reduced_model(recording), scene)
    console.say(f"replaying the recorded path on {count_nodes(len(model.cloud))} of the full model ...")
    full = replay_on_full_model(recording, model)
    title = f"{recording.title}: recorded against the full model"
    print_plain([quantities(title, ERROR_ROWS, {"error": full["errors"]})], Path("."), ())
    return full
