"""Host of a view source: its socket, the page, and the printed address."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Callable

from palpate.app.common.console import Console
from palpate.app.view.server.address import (
    DEFAULT_PORT,
    LOOPBACK,
    allowed_hosts,
    is_loopback,
    open_browser,
    open_listener,
)
from palpate.app.view.server.page import Page
from palpate.app.view.server.server import Server
from palpate.app.view.server.view_source import ViewSource

__all__ = ["Host", "serve_source"]


class Host:
    """A view source with a listening socket, ready to be served.

    Parameters
    ----------
    source : Session or Replay
    host : str
        Address of this machine.
    port : int
        Requested port; the next free one is used if it is busy.

    Attributes
    ----------
    port : int
        Port of the socket.
    address : str
        URL of the page, with a new token.
    page : Page

    Raises
    ------
    InputError
        The address does not belong to this machine, or no port is free.
    """

    def __init__(self, source: ViewSource, host: str = LOOPBACK, port: int = DEFAULT_PORT) -> None:
        self._listener = open_listener(host, port)
        self.port, token = self._listener.getsockname()[1], secrets.token_urlsafe(24)
        names = allowed_hosts(host, self.port)
        self.page, self.address = Page(names), f"http://{names[0]}/#{token}"
        self._server = Server(source, self.page, token)

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; calls `ready` once clients are answered."""
        with self._listener:
            await self._server.run(self._listener, ready)


def serve_source(source: ViewSource, console: Console, port: int, host: str, browser: bool) -> None:
    """Serve a session or a replay until interrupted, print its address, and open it in a browser."""
    own = Host(source, host, port)
    if own.port != port:
        console.say(f"port {port} is busy; using {own.port}")
    if not is_loopback(host):
        console.say(
            f"WARNING: other machines can reach {host}. Anyone with the address below can watch and control the "
            "session, and nothing is encrypted: use it only in networks that you trust"
        )
    if not own.page.exists:
        console.say("the page was not built: programs can connect, browsers show no page (see docs/view.md)")

    def announce() -> None:
        console.say(f"open {own.address}  (stop with Ctrl-C)")
        if browser and own.page.exists and not open_browser(own.address):
            console.say("no browser was found: open the address yourself")

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(own.run(announce))
