"""A connection to the server: counted from the first byte on, ended within limits of time, silent on the terminal."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame, Opcode
from websockets.protocol import Event

__all__ = ["MOST_CONNECTIONS", "Counted", "part", "quiet", "waiting_bytes"]

MOST_CONNECTIONS = 128  # those that have not said hello among them
PARTING = 2.0  # [s] for the closing handshake
LONGEST_REASON = 120  # bytes of a closing frame, which has 123 of them


class Counted(ServerConnection):
    """A connection that is counted from the first byte on; there is room for so many of them."""

    def __init__(self, *arguments: Any, counted: set[Counted], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._counted, self.pings = counted, 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._counted.add(self)
        if len(self._counted) > MOST_CONNECTIONS:
            self.transport.abort()

    def process_event(self, event: Event) -> None:
        self.pings += isinstance(event, Frame) and event.opcode is Opcode.PING
        super().process_event(event)

    def send_data(self) -> None:
        """Write at once what waits: thousands of pings in a row may be answered, by then to nobody."""
        waiting = self.protocol.data_to_send()
        whole, ends = b"".join(waiting), [b""] * waiting.count(b"")
        self.protocol.writes = [whole, *ends] if whole else ends
        super().send_data()

    def connection_lost(self, exc: Exception | None) -> None:
        self._counted.discard(self)
        super().connection_lost(exc)


def quiet() -> logging.Logger:
    """Return a log that keeps to itself what clients do wrong: each of them could fill the terminal."""
    log = logging.getLogger("palpate.clients")
    if not log.handlers:
        log.addHandler(logging.NullHandler())
    log.propagate = False
    return log


def waiting_bytes(socket: ServerConnection) -> int:
    """Return how much was sent on a connection and is still in this program."""
    return int(socket.transport.get_write_buffer_size())


async def part(socket: ServerConnection, code: int, reason: str = "") -> None:
    """Close a connection with a code and as much of a reason as fits; cut it where that is not answered in time."""
    short = reason.encode("utf-8", "backslashreplace")[:LONGEST_REASON].decode("utf-8", "ignore")
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(PARTING):
            await socket.close(code, short)
    socket.transport.abort()
