"""The server: viewers watch a session, and one of them drives it. See docs/reference/protocol.md."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import logging
import socket
import time
from collections.abc import Callable, Coroutine, Mapping
from functools import partial
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from palpate.app.session.messages import (
    MAX_MESSAGE_BYTES,
    NO_VIEWERS,
    PROTOCOL_VERSIONS,
    VIEWERS_LEFT,
    Message,
    parse_message,
)
from palpate.app.view.server import frames
from palpate.app.view.server.connection import (
    CLOSE_TIMEOUT,
    CountedConnection,
    client_logger,
    close_connection,
    unsent_bytes,
)
from palpate.app.view.server.label_choice import LabelChoice, let_choose
from palpate.app.view.server.page import Page
from palpate.app.view.server.preparation import Preparation
from palpate.app.view.server.streams import Streams
from palpate.app.view.server.view_source import NO_MAKERS, Maker, ViewSource
from palpate.app.view.server.viewer import INVALID_MESSAGES, VIEWER_TOO_SLOW, Viewer
from palpate.core.faults import InputError
from palpate.core.files import shortened
from palpate.surface.labels.surroundings import Surroundings

VERSIONS_BY_SUBPROTOCOL = {Subprotocol(f"palpate.v{version}"): version for version in reversed(PROTOCOL_VERSIONS)}
DATA_OF_VERSION_3 = ("max_tools", "all_tools")  # of `hello` and `status`
WRONG_TOKEN, TOO_MANY_VIEWERS = 4401, 4429  # closing codes; also those of a viewer
GOING_AWAY, SERVER_ERROR = 1001, 1011
HELLO_TIMEOUT = 5.0  # [s]
PING_INTERVAL, PING_TIMEOUT = 5.0, 10.0  # [s]
DRIVER_TIMEOUT = 10.0  # [s] without a message of the driver after which another viewer may drive
TICK_INTERVAL, STATISTICS_INTERVAL = 0.1, 0.5  # [s]
MAX_VIEWERS = 16
MAX_UNSENT_BYTES = 2**22  # of a connection, in addition to two geometry frames
BATCH_SIZE = 32  # messages read before other tasks run
MAX_PINGS = 100  # of a connection between two ticks
MAX_MESSAGE_RATE = 2000  # [1/s] of a viewer; further messages wait
SERVER_LOG = logging.getLogger(__name__)
DRIVER_MESSAGES = (
    "pose", "tool", "pin", "release", "control", "speed", "follow", "material", "record", "replay", "refine", "body",
)  # fmt: skip

MAKER_MESSAGES = ("refine", "body")


class Server:
    """Serves the page and the socket to viewers that send the secret `token`.

    After a choice, `prepare` gives the preparation; after a preparation, `show` gives the session.
    """

    source: ViewSource  # from `show` on

    def __init__(self, source: ViewSource | Preparation | LabelChoice, page: Page, token: str) -> None:
        self.page, self._token = page, token
        self.viewers: list[Viewer] = []
        self.driver: Viewer | None = None
        self._connections: dict[CountedConnection, None] = {}  # the oldest first
        self._last_status = ""
        self._logged: set[str] = set()
        self._choice: LabelChoice | None = None
        self._preparation: Preparation | None = None
        self._prepared = asyncio.Event()
        self._preview = b""
        self._makers: Mapping[str, Maker] = NO_MAKERS
        self._replaced = asyncio.Event()  # another source is shown
        self._last_made: dict[str, Any] = {}  # messages of the makers
        self._max_unsent = MAX_UNSENT_BYTES
        self._surroundings, self._surrounded = b"", asyncio.Event()
        self._space = ""
        if isinstance(source, LabelChoice):
            self._choice = source
        elif isinstance(source, Preparation):
            self.prepare(source)
        else:
            self.show(source)

    def prepare(self, preparation: Preparation) -> None:
        """Show a preparation to all viewers; called in the server's thread."""
        if self._choice is not None:
            self._choice.made.set()
        self._preparation, self._choice, self._space = preparation, None, preparation.space
        self._preview = b"" if preparation.surface is None else frames.preview_frame(preparation.surface)
        self._max_unsent += 2 * len(self._preview)

    def refuse(self, reason: str) -> None:
        """Report to the viewers that their choice of labels makes no body; called in the server's thread."""
        self._broadcast({"type": "error", "reason": reason})

    def show(self, source: ViewSource, makers: Mapping[str, Maker] = NO_MAKERS) -> None:
        """Replace the source of all viewers by a session or a replay; called in the server's thread.

        The session of one of the `makers` replaces it later; their keys are the types of the messages that they take.
        """
        self.source, self._streams, self._makers = source, Streams(source), makers
        self._replaced.set()
        self._replaced, self._last_status = asyncio.Event(), ""
        self._max_unsent = MAX_UNSENT_BYTES + 2 * max(len(self._preview), len(frames.geometry_frame(source.surface)))
        self._preparation, self._preview = None, b""
        for viewer in self.viewers:  # each is ready again after its hello
            viewer.ready = False
            viewer.acknowledge(viewer.sent)  # frames in flight show another body
            if viewer.scalar not in source.surface.scalars:
                viewer.scalar = "none"
        if self.driver is None and self.viewers:  # the driver has left
            self.driver, self.viewers[0].last_drive = self.viewers[0], time.monotonic()
        if not self.viewers and not source.devices:
            source.pause(NO_VIEWERS)
        self._prepared.set()

    def surround(self, surroundings: Surroundings) -> None:
        """Show what is around the body to the viewers that ask for it; called in the server's thread, once."""
        if surroundings.shapes or len(surroundings.edges):
            self._surroundings = frames.surroundings_frame(surroundings)
            self._surrounded.set()

    async def fail(self, reason: str) -> None:
        """Report to the viewers that the preparation has failed."""
        message = _to_json({"type": "failed", "reason": reason})
        await asyncio.gather(*(self._send_to(viewer, message) for viewer in self._ready_viewers()))

    async def run(self, listening: socket.socket, ready: Callable[[], None] = lambda: None) -> None:
        """Serve on a listening socket until cancelled; calls `ready` once clients are answered."""
        async with serve(
            self._serve_connection, sock=listening, process_request=self._answer_request,
            subprotocols=list(VERSIONS_BY_SUBPROTOCOL), compression=None, max_size=MAX_MESSAGE_BYTES, max_queue=32,
            server_header=None, close_timeout=CLOSE_TIMEOUT,
            ping_interval=PING_INTERVAL, ping_timeout=PING_TIMEOUT, logger=client_logger(),
            create_connection=partial(CountedConnection, counted=self._connections),  # type: ignore[arg-type]
        ):  # fmt: skip
            ready()
            try:
                await self._run_clock()
            finally:
                closing = [close_connection(each, GOING_AWAY, "the session ended") for each in self._connections]
                await asyncio.gather(*closing)

    async def _answer_request(self, connection: ServerConnection, request: Request) -> Response | None:
        return self.page.answer(request)

    # periodic work

    async def _run_clock(self) -> None:
        last_statistics = 0.0
        while True:
            if self._choice is not None or self._preparation is not None:
                if self._preparation is not None:
                    self._broadcast(self._preparation.message())
                self._close_stalled()
                await asyncio.sleep(TICK_INTERVAL)
                continue
            try:
                self.source.tick()
                if time.monotonic() - last_statistics > STATISTICS_INTERVAL:
                    last_statistics = time.monotonic()
                    self._broadcast({"type": "statistics", **self.source.statistics()})
                while self.source.notifications:
                    self._broadcast(self.source.notifications.pop(0))
                self._broadcast_status()
                self._take_made()
            except Exception as error:  # of the source; it must not end the server or a viewer
                self._log_error("the session", error)
            self._close_stalled()
            await asyncio.sleep(TICK_INTERVAL)

    def _close_stalled(self) -> None:
        """Abort connections that do not read; close those of unresponsive viewers."""
        for connection in list(self._connections):
            if unsent_bytes(connection) > self._max_unsent + len(self._surroundings) or connection.pings > MAX_PINGS:
                connection.transport.abort()
            connection.pings = 0
        for viewer in self._ready_viewers():
            if viewer.is_unresponsive and not viewer.closing:
                viewer.closing = True
                self._schedule(viewer, close_connection(viewer.socket, VIEWER_TOO_SLOW, "frames are not acknowledged"))

    def _log_error(self, where: str, error: BaseException) -> None:
        """Log an unexpected error; the same error only once."""
        text = shortened(f"{where} failed: {type(error).__name__}: {error}", 200)
        if text not in self._logged:
            self._logged.add(text)
            SERVER_LOG.error(
                "%s; the server continues", text, exc_info=error if SERVER_LOG.isEnabledFor(logging.DEBUG) else None
            )

    def _broadcast_status(self) -> None:
        status = self.source.status()
        tools = [
            {name: value for name, value in tool.items() if name not in ("position", "quaternion")}
            for tool in status["all_tools"]
        ]
        text = repr(({**status, "tool": tools[0], "all_tools": tools}, len(self.viewers), id(self.driver)))
        if text == self._last_status:
            return
        self._last_status = text
        for viewer in self._ready_viewers():
            self._schedule(viewer, self._send_to(viewer, _to_json(self._status_message(viewer, status))))

    def _take_made(self) -> None:
        """Report the progress of the makers, and show the session that one has made."""
        for kind, maker in self._makers.items():
            message = maker.message()
            if message != self._last_made.get(kind):
                self._last_made[kind] = message
                if message is not None:
                    self._broadcast(message)
            source = maker.next_source()
            if source is not None:
                self.show(source, self._makers)

    def _status_message(self, viewer: Viewer, status: dict[str, Any]) -> dict[str, Any]:
        properties = {"driver": viewer is self.driver, "viewers": len(self.viewers), "recording": False}
        return {"type": "status", **properties, **_of_version(viewer, status)}

    def _ready_viewers(self) -> list[Viewer]:
        return [viewer for viewer in self.viewers if viewer.ready]

    def _broadcast(self, message: dict[str, Any]) -> None:
        text = _to_json(message)
        for viewer in self._ready_viewers():
            self._schedule(viewer, self._send_to(viewer, text))

    def _schedule(self, viewer: Viewer, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine for a viewer in the background, until it leaves; a send must have a time limit."""

        def done(task: asyncio.Future[None]) -> None:
            viewer.tasks.discard(task)
            if not task.cancelled() and (error := task.exception()) is not None:
                self._log_error("a viewer's connection", error)

        task = asyncio.ensure_future(work)
        viewer.tasks.add(task)
        task.add_done_callback(done)

    @staticmethod
    async def _send_to(viewer: Viewer, data: str | bytes) -> None:
        with contextlib.suppress(ConnectionClosed):
            await viewer.send(data)

    # viewers

    async def _serve_connection(self, connection: ServerConnection) -> None:
        """Serve a connection until it ends; an unexpected error ends only this connection."""
        try:
            viewer = await self._admit(connection)
            if viewer is not None:
                await self._serve_viewer(viewer)
        except* ConnectionClosed:
            pass
        except* Exception as errors:
            self._log_error("a viewer's connection", _first_error(errors))
            await close_connection(connection, SERVER_ERROR, "internal error; see the log of the server")

    async def _serve_viewer(self, viewer: Viewer) -> None:
        try:
            self._add_viewer(viewer)
            if viewer.shows_surroundings:
                self._schedule(viewer, self._send_surroundings(viewer))
            if self._choice is not None:
                await let_choose(viewer, self._choice)
            if not self._prepared.is_set() and not await self._wait_for_session(viewer):
                return
            replaced = await self._introduce(viewer)
            async with asyncio.TaskGroup() as group:
                streaming = group.create_task(self._stream(viewer, replaced))
                processing = group.create_task(self._process_queue(viewer))
                await self._receive(viewer)
                viewer.queue.close()
                await processing
                streaming.cancel()
        finally:
            self._remove_viewer(viewer)

    async def _send_surroundings(self, viewer: Viewer) -> None:
        """Send the shapes around the body once they exist and the viewer shows a body; cancelled when it leaves."""
        await self._surrounded.wait()
        await viewer.has_body.wait()
        await self._send_to(viewer, self._surroundings)

    async def _introduce(self, viewer: Viewer) -> asyncio.Event:
        """Send hello, geometry and status of the current source; return the event of its replacement."""
        while True:
            replaced = self._replaced
            await viewer.send_message(self._hello_message(viewer))
            await viewer.send(frames.geometry_frame(self.source.surface))
            await viewer.send_message(self._status_message(viewer, self.source.status()))
            for maker in self._makers.values():
                if (made := maker.message()) is not None:
                    await viewer.send_message(made)
            if not replaced.is_set():
                viewer.ready = True
                return replaced

    async def _stream(self, viewer: Viewer, replaced: asyncio.Event) -> None:
        """Send frames of the source that is shown, and introduce each that replaces it."""
        while True:
            if not replaced.is_set():
                await self._send_frames(viewer, replaced)
            replaced = await self._introduce(viewer)

    async def _send_frames(self, viewer: Viewer, replaced: asyncio.Event) -> None:
        """Send frames of the source that is shown until an event is set."""
        senders = self._streams.send_states(viewer), self._streams.send_forces(viewer), replaced.wait()
        tasks = [asyncio.ensure_future(each) for each in senders]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for each in done:
                each.result()
        finally:
            for each in tasks:
                each.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _wait_for_session(self, viewer: Viewer) -> bool:
        """Send the preview, and the progress from now on; return whether the viewer stays until the session exists."""
        preparation = self._preparation
        if viewer.follows_preparation and preparation is not None:
            await viewer.send_message(preparation.message())
            if self._preview:
                await viewer.send(self._preview)
                viewer.has_body.set()
            viewer.ready = self._preparation is not None
        waits = [asyncio.ensure_future(each) for each in (self._prepared.wait(), viewer.socket.wait_closed())]
        try:
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
            return not waits[1].done()
        finally:
            for each in waits:
                each.cancel()

    async def _admit(self, connection: ServerConnection) -> Viewer | None:
        """Wait for hello with the token and return the viewer; otherwise close the connection and return None."""
        try:
            async with asyncio.timeout(HELLO_TIMEOUT):
                hello = parse_message(await connection.recv())
        except TimeoutError:
            await close_connection(connection, WRONG_TOKEN, f"hello must arrive within {HELLO_TIMEOUT:g} s")
            return None
        except InputError as error:
            await close_connection(connection, WRONG_TOKEN, str(error))
            return None
        if hello["type"] != "hello" or not hmac.compare_digest(hello["token"].encode(), self._token.encode()):
            await close_connection(connection, WRONG_TOKEN, "wrong token; open the address that palpate view prints")
            return None
        version = VERSIONS_BY_SUBPROTOCOL.get(connection.subprotocol or Subprotocol(""))
        if version is None or hello["protocol"] != version:
            reason = f"protocol must be {version} of {connection.subprotocol}, got {hello['protocol']}; reload the page"
            await close_connection(connection, INVALID_MESSAGES, reason)
            return None
        if len(self.viewers) >= MAX_VIEWERS:
            await close_connection(connection, TOO_MANY_VIEWERS, f"at most {MAX_VIEWERS} viewers; close another page")
            return None
        if isinstance(connection, CountedConnection):
            connection.admitted = True
        return Viewer(connection, version, hello["preparation"], hello["surroundings"])

    def _add_viewer(self, viewer: Viewer) -> None:
        self.viewers.append(viewer)
        if self.driver is None:
            self.driver, viewer.last_drive = viewer, time.monotonic()
        alone = self._prepared.is_set() and len(self.viewers) == 1
        if alone and self.source.pause_reason in (NO_VIEWERS, VIEWERS_LEFT):
            with contextlib.suppress(InputError):  # a diverged state waits for a reset
                self.source.resume()

    def _remove_viewer(self, viewer: Viewer) -> None:
        self.viewers.remove(viewer)
        for task in list(viewer.tasks):
            task.cancel()
        if not self._prepared.is_set():
            if viewer is self.driver:
                self.driver = None
            return
        try:
            if viewer is self.driver:
                self.driver = None
                self.source.release()
        finally:
            if not self.viewers and not self.source.devices:
                self.source.pause(VIEWERS_LEFT)

    def _hello_message(self, viewer: Viewer) -> dict[str, Any]:
        surface = self.source.surface
        return {
            "type": "hello", "protocol": viewer.version, "title": self.source.title, "driver": viewer is self.driver,
            "viewers": len(self.viewers), "mode": self.source.mode, "vertices": len(surface.rest),
            "triangles": len(surface.triangles), "spacing": surface.model.cloud.spacing, "space": self._space,
            "bounds": [surface.rest.min(axis=0).tolist(), surface.rest.max(axis=0).tolist()],
            **_of_version(viewer, self.source.hello()),
        }  # fmt: skip

    # messages of viewers

    async def _receive(self, viewer: Viewer) -> None:
        """Receive messages of a viewer until it leaves."""
        count, batch_start = 0, time.monotonic()
        async for text in viewer.socket:
            count, viewer.last_message = count + 1, time.monotonic()
            if count % BATCH_SIZE == 0:  # lets other tasks run during a flood of messages
                await asyncio.sleep(max(0.0, batch_start + BATCH_SIZE / MAX_MESSAGE_RATE - time.monotonic()))
                batch_start = time.monotonic()
            try:
                message = parse_message(text, viewer.version)
            except InputError as error:
                if viewer.count_invalid_message():
                    await close_connection(viewer.socket, INVALID_MESSAGES, "too many invalid messages")
                    return
                await viewer.send_message({"type": "error", "reason": str(error)})
                continue
            viewer.invalid_messages = 0
            await viewer.queue.put(message)

    async def _process_queue(self, viewer: Viewer) -> None:
        while (message := await viewer.queue.get()) is not None:
            try:
                await self._process(viewer, message)
            except InputError as error:
                await viewer.send_message({"type": "error", "reason": str(error)})
            await asyncio.sleep(0)

    async def _process(self, viewer: Viewer, message: Message) -> None:
        kind = message["type"]
        if kind == "ack":
            if not viewer.acknowledge(message["sequence"]):
                raise InputError(
                    f"ack: sequence must be at most {viewer.sent}, got {message['sequence']}; acknowledge sent frames"
                )
        elif kind == "latency":
            await viewer.send_message(message)
        elif kind == "show":
            allowed = (*self.source.surface.scalars, "none")
            if message["scalar"] not in allowed:
                names = ", ".join(map(repr, allowed))
                raise InputError(f"show: scalar must be one of {names}, got {message['scalar']!r}; choose one of these")
            viewer.scalar = message["scalar"]
        elif kind == "force":
            if max(message["tools"]) >= self.source.max_tools:
                raise InputError(
                    f"force: tools must be below {self.source.max_tools} here, got {message['tools']}; "
                    "see max_tools of hello"
                )
            viewer.set_force_rate(message["rate"], message["tools"])
        elif kind == "drive":
            self._grant_control(viewer)
        elif kind in DRIVER_MESSAGES:
            if viewer is not self.driver:
                raise InputError(f"{kind}: sender must be the driver, got another viewer; send 'drive' first")
            viewer.last_drive = time.monotonic()
            if kind in MAKER_MESSAGES:
                if kind not in self._makers:
                    raise InputError(f"{kind} must be left out here, got it; only full bodies of a scene take it")
                self._makers[kind].handle(message)
            else:
                self.source.handle(message)
        else:
            raise InputError(f"type must not be {kind!r} after the first message; see docs/reference/protocol.md")

    def _grant_control(self, viewer: Viewer) -> None:
        now = time.monotonic()
        if self.driver is not None and self.driver is not viewer and now - self.driver.last_drive < DRIVER_TIMEOUT:
            raise InputError(
                f"drive: the driver must be silent for {DRIVER_TIMEOUT:g} s, got "
                f"{now - self.driver.last_drive:.1f} s; try again later"
            )
        if self.driver is not viewer:
            self.source.release()
        self.driver, viewer.last_drive = viewer, now


def _of_version(viewer: Viewer, message: dict[str, Any]) -> dict[str, Any]:
    """Return a message without what the protocol of a viewer does not have."""
    return {name: value for name, value in message.items() if viewer.version > 2 or name not in DATA_OF_VERSION_3}


def _to_json(message: dict[str, Any]) -> str:
    return json.dumps(message, allow_nan=False)


def _first_error(errors: BaseExceptionGroup) -> BaseException:
    """Return the first error in a group of groups."""
    error: BaseException = errors
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
