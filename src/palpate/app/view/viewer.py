"""One client of the server: what it was sent and has not yet drawn, what it wants to see, how often it was wrong."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from websockets.asyncio.server import ServerConnection

from palpate.app.view.inbox import Inbox

__all__ = ["IN_FLIGHT", "Viewer"]

IN_FLIGHT = 2  # state frames that are sent and not acknowledged, at most
MISTAKES = 10  # in a row


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
        self.heard = 0.0  # [s] when it last drove
        self.rate = 0.0  # [Hz] of force frames
        self.tasks: set[asyncio.Future[None]] = set()
        self.room = asyncio.Event()
        self.room.set()

    def next_frame(self) -> int:
        """Return the number of the next state frame; it is in flight from now on."""
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

    async def say(self, message: dict[str, Any]) -> None:
        """Send a message."""
        await self.socket.send(json.dumps(message, allow_nan=False))

    def mistaken(self) -> bool:
        """Count a mistake; return whether there were too many in a row."""
        self.mistakes += 1
        return self.mistakes >= MISTAKES
