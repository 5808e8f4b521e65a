"""The adapter of the Haply Inverse Service: a process that speaks with the service, and with the session by `Child`.

It is a process of its own, so that nothing that the session computes delays a force. It sends zero when readings are
old. When it ends in any way, its socket closes; the service then has no command, and the device returns to idle.
"""

from __future__ import annotations

import asyncio
import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Mapping
from typing import Any

from palpate.app.device.hand_loop import HandLoop
from palpate.app.device.options import DeviceOptions
from palpate.app.device.service import MAX_STATE_BYTES, ServiceState, force_message, parse_state
from palpate.core.faults import InputError
from palpate.core.files import shortened
from palpate.core.processes import Answer, Receive

SERVICE_HOST = "localhost"
MESSAGE_INTERVAL = 1e-3  # [s] between two messages to the service
IDLE_INTERVAL = 0.05  # [s], without devices
CONNECT_SECONDS, RETRY_SECONDS = 2.0, 0.5
SILENCE_SECONDS = 1.0  # [s] without an answer after which the connection is made again
CLOSE_SECONDS = 0.1
MAX_NOTES = 20  # faults of messages that are reported, each once
MAX_FAULTS = 200  # messages in a row that are not valid, after which the connection is made again


class Adapter:
    """Serves the devices of an Inverse Service until the session stops it."""

    def __init__(self, options: DeviceOptions, tools: int, answer: Answer) -> None:
        self.address = f"ws://{SERVICE_HOST}:{options.port}"
        self.loop, self._port, self._answer = HandLoop(options, tools, answer), options.port, answer
        self.stopped = False
        self._said: set[str] = set()
        self._readings: list[tuple[Mapping[str, Any], float]] = []

    def receive(self, message: Mapping[str, Any]) -> None:
        """Take a message of the session, in a thread of its own."""
        if "stop" in message:
            self.stopped = True
        else:
            self._readings.append((message, time.monotonic()))

    def _say_once(self, text: str) -> None:
        if text not in self._said and len(self._said) < MAX_NOTES:
            self._said.add(text)
            last = "" if len(self._said) < MAX_NOTES else " (further faults are not shown)"
            self._answer({"say": text + last})

    async def run(self) -> None:
        """Connect, and again after every end of a connection."""
        why = ""
        while not self.stopped:
            try:
                await self._connect()
                why = ""
            except (OSError, EOFError, TimeoutError) as error:
                reason = shortened(str(error) or type(error).__name__, 120)
                if reason != why:
                    self._answer({"say": f"no service at {self.address} ({reason}): start the Haply Inverse Service"})
                why = reason
            except ConnectionEnd as end:
                why = ""
                if str(end):
                    self._say_once(str(end))
            self.loop.close()
            if not self.stopped:
                await asyncio.sleep(RETRY_SECONDS)

    async def _connect(self) -> None:
        from websockets.asyncio.client import connect
        from websockets.exceptions import ConnectionClosed, InvalidHandshake

        # a socket of its own passes by proxies of the environment
        opened = await asyncio.to_thread(socket.create_connection, (SERVICE_HOST, self._port), CONNECT_SECONDS)
        opened.setblocking(False)
        connection = connect(
            self.address, sock=opened, open_timeout=CONNECT_SECONDS, close_timeout=CLOSE_SECONDS, compression=None,
            max_size=MAX_STATE_BYTES, ping_interval=None, user_agent_header=None,
        )  # fmt: skip
        try:
            async with connection as service:
                mailbox = Mailbox()
                reader = asyncio.create_task(mailbox.read(service))
                try:
                    await self._serve(service, mailbox, reader)
                finally:
                    reader.cancel()
        except InvalidHandshake as error:
            raise OSError(f"not a WebSocket: {error}") from None
        except ConnectionClosed as closed:
            sent = closed.rcvd or closed.sent
            reason = f"{sent.code} {sent.reason}".strip() if sent else "no close frame"
            raise ConnectionEnd(f"{self.address} closed the connection ({shortened(reason, 80)})") from None

    async def _serve(self, service: Any, mailbox: Mailbox, reader: asyncio.Task[None]) -> None:
        """Answer each state with forces, at a fixed rate."""
        faults, heard, due, has_snapshot = 0, time.monotonic(), time.monotonic(), False
        while not self.stopped:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self.loop.options.max_age):
                    await mailbox.filled.wait()
            if reader.done():
                reader.result()
                raise ConnectionEnd(f"{self.address} ended the connection")
            text, now = mailbox.take(), time.monotonic()
            if text is None:
                if now - heard > SILENCE_SECONDS:
                    raise ConnectionEnd(f"{self.address} does not answer: connecting again")
                self.loop.silence()
                await service.send(self._message())
                continue
            heard = now
            self._take_readings()
            state = self._parse(text)
            if state is None:
                faults += 1
                if faults > MAX_FAULTS:
                    raise ConnectionEnd(f"{self.address} sends nothing valid: connecting again")
                self.loop.silence()
            else:
                faults = 0
                if has_snapshot and self.loop.is_new(state):
                    raise ConnectionEnd("")
                has_snapshot = True
                self.loop.forces(state, now)
            await service.send(self._message())
            due = max(due + (MESSAGE_INTERVAL if self.loop.channels else IDLE_INTERVAL), now)
            await asyncio.sleep(due - time.monotonic())
        self.loop.silence()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_SECONDS):
                await service.send(self._message())
                mailbox.take()
                await mailbox.filled.wait()  # the service has read it

    def _message(self) -> str:
        return force_message({name: channel.force.sent.tolist() for name, channel in self.loop.channels.items()})

    def _take_readings(self) -> None:
        while self._readings:
            message, arrived = self._readings.pop(0)
            self.loop.receive(message, arrived)

    def _parse(self, text: str | bytes) -> ServiceState | None:
        try:
            state = parse_state(text)
        except InputError as error:
            self._say_once(str(error))
            return None
        for note in state.notes:
            self._say_once(note)
        return state


class Mailbox:
    """The newest message of the service: older ones, which nobody waits for, are dropped."""

    def __init__(self) -> None:
        self.filled = asyncio.Event()
        self._text: str | bytes | None = None

    async def read(self, service: Any) -> None:
        """Keep the newest message, until the connection ends."""
        async for text in service:
            self._text = text
            self.filled.set()

    def take(self) -> str | bytes | None:
        """Return the newest message, once; None if there is none."""
        text, self._text = self._text, None
        self.filled.clear()
        return text


class ConnectionEnd(Exception):
    """A connection is over; the text is for the person, or empty."""


def serve_devices(receive: Receive, answer: Answer) -> None:
    """Serve devices in a process of its own."""
    request = receive()
    adapter = Adapter(DeviceOptions(**request["options"]), request["tools"], answer)

    def listen() -> None:
        while True:
            adapter.receive(receive())

    threading.Thread(target=listen, daemon=True).start()
    # `select` waits for microseconds; the waits of `epoll` are of whole milliseconds
    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner:
        runner.run(adapter.run())
