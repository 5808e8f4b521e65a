"""What a client has said and what is still to be done of it."""

from __future__ import annotations

import asyncio
from collections import deque

from palpate.app.view.messages import Message

__all__ = ["Inbox"]

MOST = 64  # messages that wait


class Inbox:
    """Messages of one client, in its order. A pose that waits gives way to one that follows it at once.

    A device may say where it is more often than poses can be heeded; were each of them heeded in turn, the tool would
    be where the device was long ago.
    """

    def __init__(self) -> None:
        self._waiting: deque[Message] = deque()
        self._ended = False
        self._some, self._room = asyncio.Event(), asyncio.Event()

    async def put(self, message: Message) -> None:
        """Add a message; wait while too many are still to be done."""
        if message["type"] == "pose" and self._waiting and self._waiting[-1]["type"] == "pose":
            self._waiting[-1] = message
            return
        while len(self._waiting) >= MOST:
            self._room.clear()
            await self._room.wait()
        self._waiting.append(message)
        self._some.set()

    async def next(self) -> Message | None:
        """Return the oldest message once there is one; None after the last."""
        while not self._waiting:
            if self._ended:
                return None
            self._some.clear()
            await self._some.wait()
        self._room.set()
        return self._waiting.popleft()

    def end(self) -> None:
        """Say that nothing will follow."""
        self._ended = True
        self._some.set()
