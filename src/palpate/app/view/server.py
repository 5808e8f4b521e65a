"""The server: several viewers watch a session, one of them drives it. See docs/protocol.md."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import logging
import socket
import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from palpate.app.view import frames
from palpate.app.view.connection import Counted, part, quiet, waiting_bytes
from palpate.app.view.messages import LONGEST, PROTOCOL, Message, parsed
from palpate.app.view.page import Page
from palpate.app.view.streams import Show, Streams
from palpate.app.view.viewer import LEFT_BEHIND, Viewer
from palpate.faults import InputError
from palpate.files import shortened

__all__ = ["SUBPROTOCOL", "Server", "Show"]

SUBPROTOCOL = Subprotocol("palpate.v1")
WRONG_TOKEN, TOO_MANY_MISTAKES, FULL = 4401, 4400, 4429  # closing codes; LEFT_BEHIND is another
GOING_AWAY, FAULT = 1001, 1011
PATIENCE = 5.0  # [s] for the first message
PING, PONG, CLOSING = 5.0, 10.0, 2.0  # [s] between pings, until they must be answered, for the closing handshake
SILENT = 10.0  # [s] after which another viewer may drive
TICK, TOLD = 0.1, 0.5  # [s] between looks at the clock and at the status; between statistics
MOST_VIEWERS = 16
ROOM = 2**22  # bytes that may wait for a connection, besides two geometries
TOGETHER = 32  # messages that are read before others have their turn
MOST_PINGS = 100  # between two ticks
MOST_HEARD = 2000  # messages a second of a viewer; more are left waiting
LOG = logging.getLogger(__name__)
DRIVING = ("pose", "tool", "release", "control", "speed", "material", "record", "replay")


class Server:
    """Serves the page and the socket.

    Parameters
    ----------
    show : Session or Replay
    page : Page
    token : str
        Who knows it may watch.
    """

    def __init__(self, show: Show, page: Page, token: str) -> None:
        self.show, self.page, self._token = show, page, token
        self.viewers: list[Viewer] = []
        self.driver: Viewer | None = None
        self._connections: set[Counted] = set()
        self._told = ""
        self._streams = Streams(show)
        self._troubles: set[str] = set()
        self._most_waiting = ROOM + 2 * len(frames.geometry_frame(show.surface))

    async def run(self, listening: socket.socket, ready: Callable[[], None] = lambda: None) -> None:
        """Serve on a socket that listens, until cancelled; `ready` is called when clients are answered."""
        async with serve(
            self._meet, sock=listening, process_request=self._answer, subprotocols=[SUBPROTOCOL], compression=None,
            max_size=LONGEST, max_queue=32, server_header=None, close_timeout=CLOSING,
            ping_interval=PING, ping_timeout=PONG, logger=quiet(),
            create_connection=partial(Counted, counted=self._connections),  # type: ignore[arg-type]
        ):  # fmt: skip
            ready()
            try:
                await self._watch()
            finally:
                await asyncio.gather(*(part(each, GOING_AWAY, "the session ended") for each in self._connections))

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        return self.page.answer(request)

    # the clock

    async def _watch(self) -> None:
        told = 0.0
        if not self.viewers:
            self.show.pause("nobody watches")
        while True:
            try:
                self.show.tick()
                if time.monotonic() - told > TOLD:
                    told = time.monotonic()
                    self._broadcast({"type": "statistics", **self.show.statistics()})
                while self.show.news:
                    self._broadcast(self.show.news.pop(0))
                self._tell_status()
            except Exception as error:  # of the show: it ends neither the server nor a viewer
                self._trouble("what is shown", error)
            self._cut_off()
            await asyncio.sleep(TICK)

    def _cut_off(self) -> None:
        """Cut the connections that do not read; part from viewers that nobody looks at."""
        for connection in list(self._connections):
            if waiting_bytes(connection) > self._most_waiting or connection.pings > MOST_PINGS:
                connection.transport.abort()
            connection.pings = 0
        for viewer in self._welcomed():
            if viewer.unseen and not viewer.leaving:
                viewer.leaving = True
                self._later(viewer, part(viewer.socket, LEFT_BEHIND, "frames are not acknowledged"))

    def _trouble(self, where: str, error: BaseException) -> None:
        """Tell of an unexpected error, each once."""
        text = shortened(f"{where} failed: {type(error).__name__}: {error}", 200)
        if text not in self._troubles:
            self._troubles.add(text)
            LOG.error("%s; the server goes on", text, exc_info=error if LOG.isEnabledFor(logging.DEBUG) else None)

    def _tell_status(self) -> None:
        status = self.show.status()
        still = {name: value for name, value in status["tool"].items() if name not in ("position", "quaternion")}
        told = repr(({**status, "tool": still}, len(self.viewers), id(self.driver)))
        if told == self._told:
            return
        self._told = told
        for viewer in self._welcomed():
            self._later(viewer, self._send_to(viewer, _text(self._status(viewer, status))))

    def _status(self, viewer: Viewer, status: dict[str, Any]) -> dict[str, Any]:
        about = {"driver": viewer is self.driver, "viewers": len(self.viewers), "recording": False}
        return {"type": "status", **about, **status}

    def _welcomed(self) -> list[Viewer]:
        return [viewer for viewer in self.viewers if viewer.welcomed]

    def _broadcast(self, message: dict[str, Any]) -> None:
        text = _text(message)
        for viewer in self._welcomed():
            self._later(viewer, self._send_to(viewer, text))

    def _later(self, viewer: Viewer, work: Coroutine[Any, Any, None]) -> None:
        """Do something for a viewer while others have their turn; all of it has a limit of time."""

        def done(task: asyncio.Future[None]) -> None:
            viewer.tasks.discard(task)
            if not task.cancelled() and (error := task.exception()) is not None:
                self._trouble("a viewer's connection", error)

        task = asyncio.ensure_future(work)
        viewer.tasks.add(task)
        task.add_done_callback(done)

    @staticmethod
    async def _send_to(viewer: Viewer, text: str) -> None:
        with contextlib.suppress(ConnectionClosed):
            await viewer.send(text)

    # viewers

    async def _meet(self, connection: ServerConnection) -> None:
        """Look after a connection until it ends; an unexpected error ends it alone."""
        try:
            viewer = await self._admitted(connection)
            if viewer is not None:
                await self._attend(viewer)
        except* ConnectionClosed:
            pass
        except* Exception as errors:
            self._trouble("a viewer's connection", _first(errors))
            await part(connection, FAULT, "the server failed; it said why where it was started")

    async def _attend(self, viewer: Viewer) -> None:
        try:
            self._enter(viewer)
            await viewer.say(self._hello(viewer))
            await viewer.send(frames.geometry_frame(self.show.surface))
            await viewer.say(self._status(viewer, self.show.status()))
            viewer.welcomed = True
            async with asyncio.TaskGroup() as group:
                streams = [group.create_task(stream(viewer)) for stream in (self._streams.states, self._streams.forces)]
                heeding = group.create_task(self._heed_all(viewer))
                await self._listen(viewer)
                viewer.inbox.end()
                await heeding
                for stream in streams:
                    stream.cancel()
        finally:
            self._leave(viewer)

    async def _admitted(self, connection: ServerConnection) -> Viewer | None:
        """Return a viewer that said hello with the token in time; close the connection of another one."""
        try:
            async with asyncio.timeout(PATIENCE):
                hello = parsed(await connection.recv())
        except TimeoutError:
            await part(connection, WRONG_TOKEN, "no hello in time")
            return None
        except InputError as error:
            await part(connection, WRONG_TOKEN, str(error))
            return None
        if hello["type"] != "hello" or not hmac.compare_digest(hello["token"].encode(), self._token.encode()):
            await part(connection, WRONG_TOKEN, "wrong token: open the address that palpate view prints")
            return None
        if hello["protocol"] != PROTOCOL:
            await part(connection, TOO_MANY_MISTAKES, f"this server speaks protocol {PROTOCOL}")
            return None
        if len(self.viewers) >= MOST_VIEWERS:
            await part(connection, FULL, f"{MOST_VIEWERS} viewers watch already")
            return None
        return Viewer(connection)

    def _enter(self, viewer: Viewer) -> None:
        self.viewers.append(viewer)
        if self.driver is None:
            self.driver, viewer.drove = viewer, time.monotonic()
        if len(self.viewers) == 1 and self.show.paused_because in ("nobody watches", "closed tab"):
            with contextlib.suppress(InputError):  # the state ran away: whoever comes is to see that, and reset it
                self.show.resume()

    def _leave(self, viewer: Viewer) -> None:
        self.viewers.remove(viewer)
        for task in list(viewer.tasks):
            task.cancel()
        try:
            if viewer is self.driver:
                self.driver = None
                self.show.release()
        finally:
            if not self.viewers:
                self.show.pause("closed tab")

    def _hello(self, viewer: Viewer) -> dict[str, Any]:
        surface = self.show.surface
        return {
            "type": "hello", "protocol": PROTOCOL, "title": self.show.title, "driver": viewer is self.driver,
            "viewers": len(self.viewers), "mode": self.show.mode, "vertices": len(surface.rest),
            "triangles": len(surface.triangles), "spacing": surface.model.cloud.spacing,
            "bounds": [surface.rest.min(axis=0).tolist(), surface.rest.max(axis=0).tolist()], **self.show.hello(),
        }  # fmt: skip

    # what viewers say

    async def _listen(self, viewer: Viewer) -> None:
        """Take all that a viewer says, until it has left."""
        count, turn = 0, time.monotonic()
        async for text in viewer.socket:
            count, viewer.heard = count + 1, time.monotonic()
            if count % TOGETHER == 0:  # a client that talks without pause must not keep others, or itself, waiting
                await asyncio.sleep(max(0.0, turn + TOGETHER / MOST_HEARD - time.monotonic()))
                turn = time.monotonic()
            try:
                message = parsed(text)
            except InputError as error:
                if viewer.mistaken():
                    await part(viewer.socket, TOO_MANY_MISTAKES, "too many messages that are not understood")
                    return
                await viewer.say({"type": "error", "reason": str(error)})
                continue
            viewer.mistakes = 0
            await viewer.inbox.put(message)

    async def _heed_all(self, viewer: Viewer) -> None:
        while (message := await viewer.inbox.next()) is not None:
            try:
                await self._heed(viewer, message)
            except InputError as error:
                await viewer.say({"type": "error", "reason": str(error)})
            await asyncio.sleep(0)

    async def _heed(self, viewer: Viewer, message: Message) -> None:
        kind = message["type"]
        if kind == "ack":
            if not viewer.acknowledge(message["sequence"]):
                raise InputError(f"ack: frame {message['sequence']} was never sent")
        elif kind == "latency":
            await viewer.say(message)
        elif kind == "show":
            allowed = (*self.show.surface.scalars, "none")
            if message["scalar"] not in allowed:
                raise InputError(f"show: allowed here are {', '.join(map(repr, allowed))}")
            viewer.scalar = message["scalar"]
        elif kind == "force":
            viewer.pace(message["rate"])
        elif kind == "drive":
            self._hand_over(viewer)
        elif kind in DRIVING:
            if viewer is not self.driver:
                raise InputError(f"{kind}: another viewer drives, or none; ask for it by 'drive'")
            viewer.drove = time.monotonic()
            self.show.handle(message)
        else:
            raise InputError(f"{kind}: was said already")

    def _hand_over(self, viewer: Viewer) -> None:
        now = time.monotonic()
        if self.driver is not None and self.driver is not viewer and now - self.driver.drove < SILENT:
            raise InputError("drive: another viewer drives; it may be asked for 10 s after its last message")
        if self.driver is not viewer:
            self.show.release()
        self.driver, viewer.drove = viewer, now


def _text(message: dict[str, Any]) -> str:
    return json.dumps(message, allow_nan=False)


def _first(errors: BaseExceptionGroup) -> BaseException:
    """Return the first error in a group of groups."""
    error: BaseException = errors
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
