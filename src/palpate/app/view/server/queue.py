"""Queue of the messages of one client."""

from __future__ import annotations

import asyncio
from collections import deque

from palpate.app.session.messages import Message

MAX_MESSAGES = 64


class MessageQueue:
    """Messages of one client, in order. A new pose replaces a directly preceding, unprocessed one.

    A device may send poses faster than they can be processed. Coalescing them to the latest keeps the tool from lagging
    behind the device.
    """

    def __init__(self) -> None:
        self._messages: deque[Message] = deque()
        self._closed = False
        self._changed, self._has_room = asyncio.Event(), asyncio.Event()

    async def put(self, message: Message) -> None:
        """Append a message; wait while the queue is full."""
        if message["type"] == "pose" and self._messages and self._messages[-1]["type"] == "pose":
            self._messages[-1] = message
            return
        while len(self._messages) >= MAX_MESSAGES:
            self._has_room.clear()
            await self._has_room.wait()
        self._messages.append(message)
        self._changed.set()

    async def get(self) -> Message | None:
        """Wait for the oldest message and return it; return None after the last one of a closed queue."""
        while not self._messages:
            if self._closed:
                return None
            self._changed.clear()
            await self._changed.wait()
        self._has_room.set()
        return self._messages.popleft()

    def close(self) -> None:
        """Declare that no more messages will follow."""
        self._closed = True
        self._changed.set()
