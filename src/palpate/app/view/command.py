"""``palpate view`` and ``palpate replay``: a body in real time behind a page, and what was recorded of it."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.app.console import Console, count_nodes, percent, print_json, print_plain, quantities_table
from palpate.app.files import check_folder
from palpate.app.view.address import LOOPBACK, hosts, is_loopback, listening, opened_in_browser
from palpate.app.view.film import check_film, write_film, write_picture
from palpate.app.view.fullrun import full_model, path_of, run_full
from palpate.app.view.opening import opened
from palpate.app.view.page import Page
from palpate.app.view.recording import Recording, load_recording, save_recording
from palpate.app.view.replay import Replay
from palpate.app.view.script import read_script, run_script
from palpate.app.view.server import Server, Show
from palpate.app.view.session import Session
from palpate.dynamics.progress import progress_bar
from palpate.faults import InputError, integer_in_range, number_in_range

__all__ = ["PORT", "replay", "serve_show", "view"]

PORT = 8765
LONGEST = 3600.0  # [s] of a headless session


def view(
    what: str,
    *,
    port: int = PORT,
    host: str = LOOPBACK,
    browser: bool = True,
    record: Path | None = None,
    headless: bool = False,
    seconds: float | None = None,
    script: Path | None = None,
    as_json: bool = False,
) -> int:
    """Show a body in real time on a page, until interrupted; or drive it by a script, without one.

    Parameters
    ----------
    what : str
        As of `palpate.app.view.opening.opened`.
    port : int
        The next free one is taken where it is busy.
    host : str
        Address of this machine; others than 127.0.0.1 let other machines in.
    browser : bool
        Whether to open a browser.
    record : path, optional
        Record all, and write it here in the end.
    headless : bool
        Serve nothing: let a script drive the session for some seconds, and print how the rate was kept.
    seconds : float, optional [s]
        Of a headless session, 10 by default.
    script : path, optional
        Of a headless session, see `palpate.app.view.script.read_script`.
    as_json : bool
        Print what a headless session tells as JSON.

    Returns
    -------
    int
        0.

    Raises
    ------
    InputError, FileFormatError, FileNotFoundError
        An option out of range; nothing to show.
    OSError
        The recording cannot be written.
    """
    console = Console()
    if not headless and (seconds is not None or script is not None):
        raise InputError("seconds and script are for sessions without a page: add --headless, or leave them out")
    seconds = number_in_range("seconds", 10.0 if seconds is None else seconds, 0.0, LONGEST, open_low=True, unit="s")
    messages = read_script(script) if script is not None else []
    port = integer_in_range("port", port, 1, 65535)
    if not headless:
        listening(host, port).close()  # an address that cannot be is refused before a model is trained
    if record is not None:
        check_folder(record.parent, "record")
    model, title = opened(what, console)
    with console.status("making the engine ready (the first run on a machine compiles it: some minutes)"):
        session = Session(model, title)
    session.start()
    if record is not None:
        session.record()
    told = None
    try:
        if headless:
            told = run_script(session, messages, seconds)
        else:
            serve_show(session, console, port, host, browser)
    finally:
        session.stop()
        if record is not None:
            session.finish_recording(record, wait=True)
            _say_news(session, console)
    if told is not None:
        print_json(told) if as_json else print_plain([_table(title, told)], Path("."), ())
    return 0


def _say_news(session: Session, console: Console) -> None:
    for news in session.news:
        lost = news["type"] == "error"
        console.say(news["reason"] if lost else f"recorded {news['frames']} moments into {news['file']}")


def _table(title: str, told: dict[str, Any]) -> Any:
    rows = {
        "periods": f"{told['periods']}",
        "computing time of a period, median; 99 %": f"{told['median_ms']:.3g} ms; {told['p99_ms']:.3g} ms",
        "deadlines missed": f"{told['misses']}",
        "largest force; last": f"{told['largest_force']:.3g} N; {told['last_force']:.3g} N",
        "largest trust number (above 1: not trained on)": f"{told['largest_trust']:.2f}",
        "messages; refused": f"{told['messages']}; {len(told['refused'])}",
        "verdict": told["verdict"],
    }
    return quantities_table(f"{title}, {told['seconds']:g} s", ["value"], {name: [v] for name, v in rows.items()})


def replay(
    file: Path,
    *,
    full: bool = False,
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
    png, movie : path, optional
        Draw the moment of the largest force, or all, instead of serving a page.
    scalar : str
        What colours in pictures tell.
    port, host, browser
        As for `view`.

    Returns
    -------
    int
        0.

    Raises
    ------
    InputError, FileFormatError, FileNotFoundError
        No recording, one that cannot be run, or an option out of range.
    DivergenceError
        The full model left the range of sensible states.
    OSError
        A file could not be written.
    """
    console = Console()
    if movie is not None:
        check_film(movie)
    if png is not None and png.suffix.lower() != ".png":
        raise InputError(f"png = {str(png)!r}: allowed is a name that ends in .png")
    for path, name in ((png, "png"), (movie, "movie")):
        if path is not None:
            check_folder(path.parent, name)
    recording = load_recording(file)
    if full:
        recording = replace(recording, full=_run_full(recording, console))
        save_recording(file, recording)
    if png is not None:
        write_picture(png, recording, scalar)
        console.say(f"drew {png}")
    if movie is not None:
        with progress_bar("film", float(recording.times[-1]), True) as shown:
            write_film(movie, recording, scalar, shown)
        console.say(f"drew {movie}")
    if not (full or png or movie):
        serve_show(Replay(recording), console, port, host, browser)
    return 0


def _run_full(recording: Recording, console: Console) -> dict[str, Any]:
    path_of(recording)  # what cannot be run is refused before a model is made
    with console.status("making the full model ready (the first run on a machine compiles it: a minute or two)"):
        model = full_model(recording)
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


def serve_show(show: Show, console: Console, port: int, host: str, browser: bool) -> None:
    """Serve a session or a replay until interrupted."""
    listener = listening(host, port)
    taken, token = listener.getsockname()[1], secrets.token_urlsafe(24)
    names = hosts(host, taken)
    page = Page(names)
    address = f"http://{names[0]}/#{token}"
    if taken != port:
        console.say(f"port {port} is busy; taking {taken}")
    if not is_loopback(host):
        console.say(
            f"WARNING: other machines reach {host}. Whoever knows the address below sees all and may drive, and "
            "nothing is encrypted: use it in networks that you trust only"
        )
    if not page.built:
        console.say("the page was not built: programs can connect, browsers see nothing yet (docs/view.md)")

    def ready() -> None:
        console.say(f"open {address}  (stop with Ctrl-C)")
        if browser and page.built and not opened_in_browser(address):
            console.say("no browser was found: open that address yourself")

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(Server(show, page, token).run(listener, ready))
