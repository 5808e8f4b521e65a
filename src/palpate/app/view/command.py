"""``palpate view``: a body in real time behind a page."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from pathlib import Path

from palpate.app.console import Console
from palpate.app.view.address import LOOPBACK, hosts, is_loopback, listening, opened_in_browser
from palpate.app.view.opening import opened
from palpate.app.view.page import Page
from palpate.app.view.server import Server, Show
from palpate.app.view.session import Session
from palpate.faults import integer_in_range

__all__ = ["PORT", "serve_show", "view"]

PORT = 8765


def view(
    what: str,
    *,
    port: int = PORT,
    host: str = LOOPBACK,
    browser: bool = True,
) -> int:
    """Show a body in real time on a page, until interrupted.

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

    Returns
    -------
    int
        0.

    Raises
    ------
    InputError, FileFormatError, FileNotFoundError
        An option out of range; nothing to show.
    """
    console = Console()
    port = integer_in_range("port", port, 1, 65535)
    with contextlib.closing(listening(host, port)):
        pass  # an address that cannot be is refused before a model is trained
    model, title = opened(what, console)
    with console.status("making the engine ready (the first run on a machine compiles it: some minutes)"):
        session = Session(model, title)
    session.start()
    try:
        serve_show(session, console, port, host, browser)
    finally:
        session.stop()
    return 0


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
