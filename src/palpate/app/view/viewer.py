"""One client of the server: what it was sent and has not yet drawn, what it wants to see, how often it was wrong.

All that is sent to a client goes through `Viewer.send` and all endings through `part`, which both have limits of time:
a client that does not read delays nobody but itself.
"""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from palpate.app.view.connection import part, waiting_bytes
from palpate.app.view.inbox import Inbox

__all__ = ["IN_FLIGHT", "LEFT_BEHIND", "Viewer"]

IN_FLIGHT = 2  # state frames that are sent and not acknowledged, at most
MISTAKES = 10  # in a row
LEFT_BEHIND = 4408  # closing code of a viewer that does not read, or neither draws nor says anything
LATE = 5.0  # [s] that a message may wait, besides
SLOWEST = 1e6  # [bytes/s] at which those before it, and itself, are read
UNSEEN = 20.0  # [s] without a word, while state frames wait to be acknowledged


class Viewer:
    """A connected client that knows the token.

    Parameters
    ----------
    socket : ServerConnection
    """

    def __init__(self, socket: ServerConnection) -> None:
        self.socket, self.scalar, self.inbox = socket, "displacement", Inbox()
        self.sent, self.acknowledged, self.mistakes = 0, 0, 0
        self.welcomed = False  # whether it was told all that it needs to understand more
        self.leaving = False  # whether its connection is being closed
        self.drove = 0.0  # [s] when it last drove
        self.heard = time.monotonic()  # [s] when it last said anything
        self.rate, self.paced = 0.0, asyncio.Event()  # [Hz] of force frames; whether the rate has just been changed
        self.tasks: set[asyncio.Future[None]] = set()
        self.room = asyncio.Event()
        self.room.set()

    def next_frame(self) -> int:
        """Return the number of the next state frame; it is in flight from now on."""
        if self.sent == self.acknowledged:
            self.heard = time.monotonic()  # until now there was nothing to acknowledge
        self.sent += 1
        self._make_room()
        return self.sent

    def acknowledge(self, sequence: int) -> bool:
        """Count a state frame, and those before it, as drawn; return whether it was ever sent."""
        if sequence > self.sent:
            return False
        self.acknowledged = max(self.acknowledged, sequence)
        self._make_room()
        return True

    def _make_room(self) -> None:
        if self.sent - self.acknowledged < IN_FLIGHT:
            self.room.set()
        else:
            self.room.clear()

    def pace(self, rate: float) -> None:
        """Set the rate of force frames [Hz], from now on."""
        self.rate = rate
        self.paced.set()

    @property
    def unseen(self) -> bool:
        """Whether the viewer has drawn nothing, and said nothing, for so long that nobody can be looking."""
        due = self.sent > self.acknowledged and self.rate == 0.0
        return due and time.monotonic() - self.heard > UNSEEN

    async def say(self, message: dict[str, Any]) -> None:
        """Send a message; raises what `send` raises."""
        await self.send(json.dumps(message, allow_nan=False))

    async def send(self, data: str | bytes) -> None:
        """Send a message or a frame; cut the connection where it is not read in time.

        Raises
        ------
        ConnectionClosed
            The viewer has left, or was cut off.
        """
        limit = LATE + (waiting_bytes(self.socket) + len(data)) / SLOWEST
        try:
            async with asyncio.timeout(limit):
                await self.socket.send(data)
        except TimeoutError:
            await part(self.socket, LEFT_BEHIND, "what was sent is not read")
            raise ConnectionClosed(None, None) from None

    def mistaken(self) -> bool:
        """Count a mistake; return whether there were too many in a row."""
        self.mistakes += 1
        return self.mistakes >= MISTAKES
