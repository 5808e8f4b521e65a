"""Queue of the messages of one client."""

from __future__ import annotations

import asyncio
from collections import deque

from palpate.app.session.messages import Message

MAX_MESSAGES = 64


class MessageQueue:
    """Messages of one client, in order. A new pose of a tool replaces its unprocessed one among the last poses.

    A device may send poses faster than they can be processed. Coalescing them to the latest keeps the tool from lagging
    behind the device. Poses of several tools may alternate.
    """

    def __init__(self) -> None:
        self._messages: deque[Message] = deque()
        self._closed = False
        self._changed, self._has_room = asyncio.Event(), asyncio.Event()

    async def put(self, message: Message) -> None:
        """Append a message; wait while the queue is full."""
        if message["type"] == "pose" and self._replace_pose(message):
            return
        while len(self._messages) >= MAX_MESSAGES:
            self._has_room.clear()
            await self._has_room.wait()
        self._messages.append(message)
        self._changed.set()

    def _replace_pose(self, message: Message) -> bool:
        """Replace the pose of the same tool among the poses at the end; return whether there is one."""
        for k in range(len(self._messages) - 1, -1, -1):
            if self._messages[k]["type"] != "pose":
                return False
            if self._messages[k]["index"] == message["index"]:
                self._messages[k] = message
                return True
        return False

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
