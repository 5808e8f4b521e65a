"""WebSocket connections: a limited number, closed within a time limit, without log output."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame, Opcode
from websockets.protocol import Event

HELLO_TIME = 0.25  # [s] in which a client surely sends hello
MAX_CONNECTIONS = 128  # including those that have not sent hello
CLOSE_TIMEOUT = 2.0  # [s] for the closing handshake
MAX_REASON_BYTES = 120  # of a closing frame, which has room for 123


class CountedConnection(ServerConnection):
    """A connection that is counted from its first byte.

    Beyond `MAX_CONNECTIONS` the oldest one is aborted that has not sent hello for `HELLO_TIME`, or else
    the new one. So connections that send nothing keep new clients out for that time only.
    """

    def __init__(self, *arguments: Any, counted: dict[CountedConnection, None], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._counted, self.pings, self.admitted, self.made = counted, 0, False, 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.made = time.monotonic()
        self._counted[self] = None
        if len(self._counted) > MAX_CONNECTIONS:
            late = time.monotonic() - HELLO_TIME
            oldest = next((each for each in self._counted if not each.admitted and each.made < late), self)
            self._counted.pop(oldest)
            oldest.transport.abort()

    def process_event(self, event: Event) -> None:
        self.pings += isinstance(event, Frame) and event.opcode is Opcode.PING
        super().process_event(event)

    def send_data(self) -> None:
        """Write all pending data immediately; a client that left may have sent thousands of pings."""
        pending = self.protocol.data_to_send()
        data, ends = b"".join(pending), [b""] * pending.count(b"")
        self.protocol.writes = [data, *ends] if data else ends
        super().send_data()

    def connection_lost(self, exc: Exception | None) -> None:
        self._counted.pop(self, None)
        super().connection_lost(exc)


def client_logger() -> logging.Logger:
    """Return a silent logger for errors of clients, any of which could otherwise flood the terminal."""
    log = logging.getLogger("palpate.clients")
    if not log.handlers:
        log.addHandler(logging.NullHandler())
    log.propagate = False
    return log


def unsent_bytes(socket: ServerConnection) -> int:
    """Return the number of bytes in the send buffer of a connection."""
    return int(socket.transport.get_write_buffer_size())


async def close_connection(socket: ServerConnection, code: int, reason: str = "") -> None:
    """Close a connection with a code and a shortened reason; abort it after `CLOSE_TIMEOUT`."""
    short = reason.encode("utf-8", "backslashreplace")[:MAX_REASON_BYTES].decode("utf-8", "ignore")
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(CLOSE_TIMEOUT):
            await socket.close(code, short)
    socket.transport.abort()
