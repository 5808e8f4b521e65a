"""``palpate view``: a body in real time behind a page, or driven by a script."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from palpate.app.console import Console, print_json, print_plain, quantities_table
from palpate.app.view.address import LOOPBACK, PORT, listening
from palpate.app.view.messages import Message
from palpate.app.view.opening import opened
from palpate.app.view.recording import FORMAT
from palpate.app.view.script import read_script, run_script
from palpate.app.view.session import Session
from palpate.extras import require
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.files import check_folder

__all__ = ["view"]

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
        Record all, and write it here in the end: when the session is stopped, or told to end by SIGTERM or SIGHUP.
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
    SystemExit
        The program was told to end by SIGTERM or SIGHUP; its status is 128 and the signal's number.
    """
    console, script_of = Console(), _checked(headless, seconds, script)
    port = integer_in_range("port", port, 1, 65535)
    if script_of is None:
        require("websockets", "a page in the browser")
        listening(host, port).close()  # an address that cannot be is refused before a model is trained
    if record is not None:
        _check_record(record, what)
    with _ended_in_order(), _session(what, record, console) as session:
        if script_of is None:
            from palpate.app.view.stand import serve_show

            serve_show(session, console, port, host, browser)
            return 0
        told = run_script(session, *script_of)
    print_json(told) if as_json else print_plain([_table(session.title, told)], Path("."), ())
    return 0


@contextlib.contextmanager
def _session(what: str, record: Path | None, console: Console) -> Iterator[Session]:
    """Yield a session that runs; stop it in the end, and write what was recorded."""
    model, title = opened(what, console)
    with console.status("making the engine ready (the first run on a machine compiles it: some minutes)"):
        session = Session(model, title)
    session.start()
    if record is not None:
        session.record(record)
    try:
        yield session
    finally:
        session.close()
        with contextlib.suppress(OSError):  # of a terminal that was closed
            _say_news(session, console)


@contextlib.contextmanager
def _ended_in_order() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the program in order, so that recordings are written; further ones are ignored."""
    own = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    own = [each for each in own if signal.getsignal(each) is signal.SIG_DFL]  # nohup ignores one of them
    if threading.current_thread() is not threading.main_thread():
        own = []

    def end(number: int, frame: object) -> None:
        for each in own:
            signal.signal(each, signal.SIG_IGN)
        raise SystemExit(128 + number)

    for each in own:
        signal.signal(each, end)
    try:
        yield
    finally:
        for each in own:
            signal.signal(each, signal.SIG_DFL)


def _check_record(path: Path, what: str) -> None:
    """Refuse a name for a recording, or for the file for ParaView beside it, that would cost another file."""
    check_folder(path.parent, "record")
    if path.suffix != ".h5":
        raise InputError(f"record must end in .h5, got {str(path)!r}; the file for ParaView beside it ends in .vtkhdf")
    recorded = path.is_file() and _is_recording(path)
    for each in (path, path.with_suffix(".vtkhdf")):
        if each.exists() and Path(what).exists() and os.path.samefile(each, what):
            raise InputError(f"record must be another file than the one that is shown, got {str(path)!r}")
        if each.exists() and not recorded:
            raise InputError(
                f"record must be a new file or an earlier recording, got {str(path)!r}: {each.name} exists and is none"
                "; choose another name"
            )


def _is_recording(path: Path) -> bool:
    beginning = f"{FORMAT}\n".encode()
    with path.open("rb") as file:
        return file.read(len(beginning)) == beginning


def _checked(
    headless: bool, seconds: float | None, script: Path | None
) -> tuple[list[tuple[float, Message]], float] | None:
    """Return the script of a headless session, and how long it lasts [s]; None for a session with a page."""
    if not headless:
        if seconds is not None or script is not None:
            raise InputError("seconds and script are for sessions without a page: add --headless, or leave them out")
        return None
    seconds = number_in_range("seconds", 10.0 if seconds is None else seconds, 0.0, LONGEST, open_low=True, unit="s")
    return read_script(script) if script is not None else [], seconds


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
