"""A show with a socket of its own, the page, and the address that lets people in."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Callable

from palpate.app.console import Console
from palpate.app.view.address import LOOPBACK, PORT, hosts, is_loopback, listening, opened_in_browser
from palpate.app.view.page import Page
from palpate.app.view.server import Server, Show

__all__ = ["Stand", "serve_show"]


class Stand:
    """A show that is ready to be served.

    Parameters
    ----------
    show : Session or Replay
    host : str
        Address of this machine.
    port : int
        The next free one is taken where it is busy.

    Attributes
    ----------
    port : int
        The one that was taken.
    address : str
        For people, with a token that is new.
    page : Page

    Raises
    ------
    InputError
        The address is none of this machine, or no port is free.
    """

    def __init__(self, show: Show, host: str = LOOPBACK, port: int = PORT) -> None:
        self._listener = listening(host, port)
        self.port, token = self._listener.getsockname()[1], secrets.token_urlsafe(24)
        names = hosts(host, self.port)
        self.page, self.address = Page(names), f"http://{names[0]}/#{token}"
        self._server = Server(show, self.page, token)

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; `ready` is called when clients are answered."""
        with self._listener:
            await self._server.run(self._listener, ready)


def serve_show(show: Show, console: Console, port: int, host: str, browser: bool) -> None:
    """Serve a session or a replay until interrupted, and say where; open it in a browser if there is one."""
    stand = Stand(show, host, port)
    if stand.port != port:
        console.say(f"port {port} is busy; taking {stand.port}")
    if not is_loopback(host):
        console.say(
            f"WARNING: other machines reach {host}. Whoever knows the address below sees all and may drive, and "
            "nothing is encrypted: use it in networks that you trust only"
        )
    if not stand.page.built:
        console.say("the page was not built: programs can connect, browsers see nothing yet (docs/view.md)")

    def ready() -> None:
        console.say(f"open {stand.address}  (stop with Ctrl-C)")
        if browser and stand.page.built and not opened_in_browser(stand.address):
            console.say("no browser was found: open that address yourself")

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(stand.run(ready))
