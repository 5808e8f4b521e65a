"""Host of a view source: its socket, the page, and the printed address."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import threading
from collections.abc import Callable, Iterator, Mapping

from palpate.app.common.console import Console
from palpate.app.view.server.address import (
    DEFAULT_PORT,
    LOOPBACK,
    allowed_hosts,
    is_loopback,
    open_browser,
    open_listener,
    public_address,
)
from palpate.app.view.server.connection import CLOSE_TIMEOUT
from palpate.app.view.server.label_choice import LabelChoice
from palpate.app.view.server.page import Page
from palpate.app.view.server.preparation import Preparation
from palpate.app.view.server.server import Server
from palpate.app.view.server.view_source import NO_MAKERS, Maker, ViewSource
from palpate.surface.labels.surroundings import Surroundings

JOIN_INTERVAL = 1.0  # [s]


class Host:
    """A view source with a listening socket, ready to be served.

    The next free port is used if the requested one is busy, but not with a public address. `public_url` is the address
    of a forwarded port or a proxy, by which browsers reach the page. `address` is the URL of the page, with a new
    token; by `local_address` this machine reaches it. `framed` allows notebooks to show the page in a cell.
    """

    def __init__(
        self,
        source: ViewSource | Preparation | LabelChoice,
        host: str = LOOPBACK,
        port: int = DEFAULT_PORT,
        public_url: str | None = None,
        framed: bool = False,
    ) -> None:
        self.public = None if public_url is None else public_address(public_url)
        self._listener = open_listener(host, port) if self.public is None else open_listener(host, port, 1)
        self.port, token = self._listener.getsockname()[1], secrets.token_urlsafe(24)
        names = allowed_hosts(host, self.port)
        self.page, self.local_address = Page(names, public=self.public, framed=framed), f"http://{names[0]}/#{token}"
        self.address = self.local_address if self.public is None else f"{self.public.url}#{token}"
        self._server = Server(source, self.page, token)

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; calls `ready` once clients are answered."""
        with self._listener:
            await self._server.run(self._listener, ready)

    @contextlib.contextmanager
    def serving(self) -> Iterator[None]:
        """Serve in a separate thread within a context, which begins once clients are answered."""
        ready = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._task = self._loop.create_task(self.run(ready.set))

        def serve() -> None:
            try:
                with contextlib.suppress(asyncio.CancelledError):
                    self._loop.run_until_complete(self._task)
                self._loop.run_until_complete(self._loop.shutdown_default_executor())
            finally:
                self._loop.close()
                ready.set()

        self._thread = threading.Thread(target=serve, name="palpate server", daemon=True)
        self._thread.start()
        try:
            ready.wait()
            yield
        finally:
            self.stop()

    def prepare(self, preparation: Preparation) -> None:
        """Show the preparation of a body whose labels were chosen."""
        self._call(self._server.prepare, preparation)

    def refuse(self, reason: str) -> None:
        """Report to the viewers that the labels that were chosen make no body."""
        self._call(self._server.refuse, reason)

    def show(self, source: ViewSource, makers: Mapping[str, Maker] = NO_MAKERS) -> None:
        """Show a prepared session to all viewers, and what may replace it later, by the messages that it takes."""
        self._call(self._server.show, source, makers)

    def surround(self, surroundings: Surroundings) -> None:
        """Show what is around the body to all viewers, now or when the body is shown."""
        with contextlib.suppress(RuntimeError):  # the server has ended
            self._call(self._server.surround, surroundings)

    def fail(self, reason: str) -> None:
        """Report to the viewers that the preparation has failed."""
        with contextlib.suppress(RuntimeError, TimeoutError):  # the server has ended
            asyncio.run_coroutine_threadsafe(self._server.fail(reason), self._loop).result(CLOSE_TIMEOUT)

    def wait(self) -> None:
        """Wait until the server ends."""
        while self._thread.is_alive():  # with a timeout, because a wait without one cannot be interrupted everywhere
            self._thread.join(JOIN_INTERVAL)
        if not self._task.cancelled():
            self._task.result()

    def stop(self) -> None:
        """End the server and its connections."""
        with contextlib.suppress(RuntimeError):  # it has ended
            self._call(self._task.cancel)
        self._thread.join()

    def _call(self, function: Callable[..., object], *arguments: object) -> None:
        self._loop.call_soon_threadsafe(function, *arguments)


def serve_source(
    source: ViewSource, console: Console, port: int, host: str, browser: bool, public_url: str | None = None
) -> None:
    """Serve a session or a replay until interrupted, print its address, and open it in a browser."""
    with serve(source, console, port, host, browser, public_url) as server, contextlib.suppress(KeyboardInterrupt):
        server.wait()


@contextlib.contextmanager
def serve(
    source: ViewSource | Preparation | LabelChoice,
    console: Console,
    port: int,
    host: str,
    browser: bool,
    public_url: str | None = None,
) -> Iterator[Host]:
    """Serve within a context: print the address, and open it in a browser."""
    server = Host(source, host, port, public_url)
    if server.port != port:
        console.say(f"port {port} is busy; using {server.port}")
    if not is_loopback(host):
        console.say(
            f"WARNING: other machines can reach {host}. Anyone with the address below can watch and control the "
            "session, and nothing is encrypted: use it only in networks that you trust"
        )
    elif server.public is not None and not server.public.is_loopback:
        risk = "" if server.public.scheme == "https" else ", and nothing is encrypted up to the proxy"
        console.say(
            f"WARNING: whoever reaches {server.public.origin} with the address below can watch and control the "
            f"session{risk}"
        )
    if not server.page.exists:
        console.say("the page was not built: programs can connect, browsers show no page (see docs/howto/view.md)")

    def visit() -> None:
        if not open_browser(server.address):
            console.say("no browser was found: open the address yourself")

    visitor = threading.Thread(target=visit, name="palpate browser", daemon=True)  # some take seconds to start
    with server.serving():
        console.say(f"open {server.address}  (stop with Ctrl-C)")
        if server.public is not None:
            console.say(f"on this machine also {server.local_address}")
        if browser and server.page.exists:
            visitor.start()
        yield server
