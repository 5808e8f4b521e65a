"""A connected viewer: frames in flight, requested data, and errors of one client.

All data for a client is sent by `Viewer.send`, and all connections are closed by `close_connection`. Both have time
limits, so that a client that does not read delays only itself.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Sequence
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from palpate.app.view.server.connection import close_connection, unsent_bytes
from palpate.app.view.server.queue import MessageQueue

MAX_FRAMES_IN_FLIGHT = 2  # state frames without acknowledgement
MAX_INVALID_MESSAGES = 10  # in a row
VIEWER_TOO_SLOW = 4408  # closing code of a viewer that does not read or does not respond
INVALID_MESSAGES = 4400  # closing code of a viewer of another protocol
SEND_TIMEOUT = 5.0  # [s] in addition to the time at the slowest rate
MIN_READ_RATE = 1e6  # [bytes/s] of a client
RESPONSE_TIMEOUT = 20.0  # [s] without a message while state frames are in flight


class Viewer:
    """A connected client that has sent the token.

    Viewers of version 2 of the protocol see and move the first tool only. One that `follows_preparation` receives the
    progress before the session exists; one that `shows_surroundings`, the shapes around the body.
    """

    def __init__(
        self,
        socket: ServerConnection,
        version: int,
        follows_preparation: bool = False,
        shows_surroundings: bool = False,
    ) -> None:
        self.socket, self.version, self.scalar, self.queue = socket, version, "displacement", MessageQueue()
        self.follows_preparation, self.shows_surroundings = follows_preparation, shows_surroundings
        self.has_body = asyncio.Event()  # set once it has received a preview or a state frame
        self.sent, self.acknowledged, self.invalid_messages = 0, 0, 0
        self.ready = False  # whether it has received hello, geometry and status
        self.closing = False
        self.last_drive = 0.0  # [s]
        self.last_message = time.monotonic()  # [s]
        self.force_rate, self.force_rate_changed = 0.0, asyncio.Event()  # [Hz]
        self.force_tools = [0]  # whose force frames are sent
        self.tasks: set[asyncio.Future[None]] = set()
        self.may_send_frame = asyncio.Event()
        self.may_send_frame.set()

    def next_frame(self) -> int:
        """Return the sequence number of the next state frame, which is in flight from now on."""
        if self.sent == self.acknowledged:
            self.last_message = time.monotonic()  # there was nothing to acknowledge
        self.sent += 1
        self.has_body.set()
        self._update_flow()
        return self.sent

    def acknowledge(self, sequence: int) -> bool:
        """Acknowledge a state frame and all earlier ones; return whether it was ever sent."""
        if sequence > self.sent:
            return False
        self.acknowledged = max(self.acknowledged, sequence)
        self._update_flow()
        return True

    def _update_flow(self) -> None:
        if self.sent - self.acknowledged < MAX_FRAMES_IN_FLIGHT:
            self.may_send_frame.set()
        else:
            self.may_send_frame.clear()

    def set_force_rate(self, rate: float, tools: Sequence[int]) -> None:
        """Set the rate of force frames [Hz], and the indices of their tools."""
        self.force_rate, self.force_tools = rate, list(tools)
        self.force_rate_changed.set()

    @property
    def is_unresponsive(self) -> bool:
        """Whether the viewer has neither acknowledged frames nor sent messages for `RESPONSE_TIMEOUT`."""
        due = self.sent > self.acknowledged and self.force_rate == 0.0
        return due and time.monotonic() - self.last_message > RESPONSE_TIMEOUT

    async def send_message(self, message: dict[str, Any]) -> None:
        """Send a message as JSON; raises as `send` does."""
        await self.send(json.dumps(message, allow_nan=False))

    async def send(self, data: str | bytes) -> None:
        """Send a message or a frame; close the connection if it is not read in time."""
        limit = SEND_TIMEOUT + (unsent_bytes(self.socket) + len(data)) / MIN_READ_RATE
        try:
            async with asyncio.timeout(limit):
                await self.socket.send(data)
        except TimeoutError:
            await close_connection(self.socket, VIEWER_TOO_SLOW, "the client does not read")
            raise ConnectionClosed(None, None) from None

    def count_invalid_message(self) -> bool:
        """Count an invalid message; return whether there were too many in a row."""
        self.invalid_messages += 1
        return self.invalid_messages >= MAX_INVALID_MESSAGES
