"""Clients that harm a server of `palpate view`, each kind again and again; or honest ones.

    python validation/hostile.py 'http://127.0.0.1:8765/#TOKEN' SECONDS [KIND ...]

Without kinds the honest ones come: a device that presses at 1 kHz and feels as often, and two viewers that draw. What
these felt is printed as JSON: the longest time without a word from the server, states and forces a second.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import socket
import struct
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException
from websockets.frames import Frame, Opcode

FROM = np.array([0.024, 0.024, 0.024 + 0.015 + 0.002])  # [m] above the middle of the block of the tests
DEEP, RADIUS = 0.005, 0.015  # [m]
AGAIN = 0.05  # [s] before a client that was turned away comes again
FAULTS = (OSError, WebSocketException, TimeoutError, asyncio.IncompleteReadError)


class Address:
    """Where the server is, and its token."""

    def __init__(self, address: str) -> None:
        base, self.token = address.split("/#")
        self.host, port = base.removeprefix("http://").rsplit(":", 1)
        self.port, self.url = int(port), base.replace("http", "ws", 1) + "/session"

    def hello(self, **other: Any) -> str:
        """Return the first message of a client that is let in."""
        return json.dumps({"type": "hello", "protocol": 3, "token": self.token, **other})

    def connect(self) -> Any:
        """Return a connection that opens."""
        return connect(self.url, subprotocols=["palpate.v3"], max_size=None, compression=None, ping_interval=None)

    async def raw(self, small: bool = True) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Return a bare connection, which reads little at a time."""
        own = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if small:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        own.setblocking(False)
        await asyncio.get_running_loop().sock_connect(own, (self.host, self.port))
        return await asyncio.open_connection(sock=own, limit=4096)

    async def let_in(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Return a bare connection that said hello and has read nothing but the answer to its request."""
        reader, writer = await self.raw()
        writer.write(
            f"GET /session HTTP/1.1\r\nHost: {self.host}:{self.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
            "Sec-WebSocket-Protocol: palpate.v3\r\n\r\n".encode()
        )
        await reader.readuntil(b"\r\n\r\n")
        writer.write(text(self.hello()))
        return reader, writer


def text(message: str) -> bytes:
    """Return a frame as a client sends it."""
    return bytes(Frame(Opcode.TEXT, message.encode()).serialize(mask=True))


def ask(**message: Any) -> str:
    return json.dumps(message)


# the hostile ones: each does its harm once, for some seconds or until it is turned away


async def reads_nothing(at: Address) -> None:
    """Ask for everything and read nothing."""
    _, writer = await at.let_in()
    writer.write(text(ask(type="force", rate=1000)) + text(ask(type="show", scalar="stress")))
    for sequence in range(1, 10_000):  # and acknowledge what it never saw, so that more comes
        writer.write(text(ask(type="ack", sequence=sequence)))
        await writer.drain()
        await asyncio.sleep(0.01)
        if writer.is_closing():
            break
    writer.transport.abort()


async def reads_slowly(at: Address) -> None:
    """Read one byte a second."""
    reader, writer = await at.let_in()
    writer.write(text(ask(type="force", rate=1000)))
    for _ in range(30):
        if not await reader.read(1):
            break
        await asyncio.sleep(1.0)
    writer.transport.abort()


async def acknowledges_nothing(at: Address) -> None:
    """Read all and say nothing."""
    async with at.connect() as client:
        await client.send(at.hello())
        async for _ in client:
            pass


async def floods(at: Address) -> None:
    """Ask for answers as fast as they go out, and read them."""
    async with at.connect() as client:
        await client.send(at.hello())
        reading = asyncio.ensure_future(read_all(client))
        for k in range(30_000):
            await client.send(ask(type="latency", stamp=k))
        reading.cancel()


async def floods_unread(at: Address) -> None:
    """Ask for answers as fast as they go out, and read none."""
    _, writer = await at.let_in()
    message = text(ask(type="latency", stamp="x" * 200)) * 20
    for _ in range(5000):
        writer.write(message)
        await writer.drain()


async def pings_unread(at: Address) -> None:
    """Ping without end, and read no answer."""
    _, writer = await at.let_in()
    message = bytes(Frame(Opcode.PING, b"x" * 125).serialize(mask=True)) * 50
    for _ in range(5000):
        writer.write(message)
        await writer.drain()


async def half_a_handshake(at: Address) -> None:
    """Begin a request and never end it."""
    reader, writer = await at.raw()
    writer.write(b"GET /session HTTP/1.1\r\nHost: ")
    await reader.read()
    writer.transport.abort()


async def no_hello(at: Address) -> None:
    """Connect and say nothing."""
    async with at.connect() as client:
        await read_all(client)


async def garbage(at: Address) -> None:
    """Send bytes that mean nothing, as a request and after one."""
    reader, writer = await at.raw()
    writer.write(os.urandom(4096))
    await reader.read(4096)
    writer.transport.abort()
    reader, writer = await at.let_in()
    writer.write(os.urandom(4096))
    await reader.read(4096)
    writer.transport.abort()


async def wrong_frames(at: Address) -> None:
    """Send invalid frames: unmasked, fragments of nothing, text that is not UTF-8, an unknown kind."""
    for frame in (
        b"\x81\x02hi", Frame(Opcode.CONT, b"rest").serialize(mask=True), Frame(Opcode.TEXT, b"\xff\xfe").serialize(
            mask=True), b"\x83\x80\x00\x00\x00\x00", Frame(Opcode.BINARY, b"").serialize(mask=True) * 20,
        Frame(Opcode.TEXT, b"{", fin=False).serialize(mask=True) * 200, b"\x88\x81\x00\x00\x00\x00\x00",
    ):  # fmt: skip
        reader, writer = await at.let_in()
        writer.write(bytes(frame))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.5):
                while await reader.read(65536):
                    pass
        writer.transport.abort()


async def huge_frames(at: Address) -> None:
    """Claim frames of exabytes, and send messages of megabytes."""
    reader, writer = await at.let_in()
    writer.write(b"\x81\xff" + struct.pack(">Q", 2**62) + b"\x00" * 4 + b"x" * 4096)
    await reader.read(4096)
    writer.transport.abort()
    async with at.connect() as client:
        await client.send(at.hello())
        await client.send(" " * 2**22)
        await read_all(client)


async def leaves_in_the_middle(at: Address) -> None:
    """Break off in the middle of a message, of the geometry, of a request."""
    for part in (text(at.hello())[:20], text(ask(type="pose", position=[0, 0, 0]))[:-3], b""):
        _, writer = await at.let_in()
        writer.write(part)
        await asyncio.sleep(random.uniform(0, 0.01))
        writer.transport.abort()


async def many_connections(at: Address) -> None:
    """Open more connections than there is room for, and hold them."""
    opened = await asyncio.gather(*(at.raw() for _ in range(200)), return_exceptions=True)
    await asyncio.sleep(1.0)
    for each in opened:
        if not isinstance(each, BaseException):
            each[1].transport.abort()


async def lies(at: Address) -> None:
    """Say hello as nobody does."""
    for hello in (
        at.hello(token="guess"), at.hello(protocol=2), at.hello(protocol=-1), at.hello(name="x" * 201), "[" * 30_000,
        '{"type": "hello", "protocol": 2, "token": "\\ud800"}', ask(type="\U0001f9e0" * 60), ask(type="drive"), "",
        at.hello()[:-1] + ', "protocol": 3}', '{"type": "hello", "protocol": ' + "9" * 5000 + "}",
    ):  # fmt: skip
        with contextlib.suppress(*FAULTS):
            async with at.connect() as client:
                await client.send(hello)
                await read_all(client)


async def mistakes(at: Address) -> None:
    """Say what is not understood, what cannot be, and what is not to be answered."""
    async with at.connect() as client:
        await client.send(at.hello())
        reading = asyncio.ensure_future(read_all(client))
        for k in range(200):
            await client.send('{"type": "latency", "stamp": 1e999}')
            await client.send(ask(type="force", rate=(1, 1000)[k % 2]))
            await client.send(ask(type="ack", sequence=2**53))
            await client.send(ask(type="tool", kind="sphere", position=[0, 0, 0], index=k % 6))
            await client.send(ask(type="pin", index=k % 4, pinned=k % 3 == 0))
            await client.send(ask(type="force", rate=1000, tools=list(range(k % 17))))
            await client.send(b"\x00" * 100 if k % 10 == 0 else ask(type="drive"))
        reading.cancel()


KINDS: dict[str, Callable[[Address], Awaitable[None]]] = {
    each.__name__: each
    for each in (
        reads_nothing, reads_slowly, acknowledges_nothing, floods, floods_unread, pings_unread, half_a_handshake,
        no_hello, garbage, wrong_frames, huge_frames, leaves_in_the_middle, many_connections, lies, mistakes,
    )
}  # fmt: skip


async def read_all(client: ClientConnection) -> None:
    async for _ in client:
        pass


async def again(kind: Callable[[Address], Awaitable[None]], at: Address) -> None:
    """Do harm for ever."""
    while True:
        with contextlib.suppress(*FAULTS):
            await kind(at)
        await asyncio.sleep(AGAIN)


# the honest ones


class Honest:
    """A client that draws, and feels what it asks for.

    Attributes
    ----------
    silence : float [s]
        The longest time without statistics from the server, which come twice a second.
    states, forces, came : int
        Frames, and how often it had to connect.
    """

    def __init__(self, at: Address, drives: bool) -> None:
        self.at, self.drives = at, drives
        self.silence, self.heard, self.states, self.forces, self.came = 0.0, 0.0, 0, 0, 0

    async def run(self) -> None:
        """Watch, or press; come back whenever the connection is lost."""
        while True:
            with contextlib.suppress(*FAULTS):
                async with self.at.connect() as client:
                    await client.send(self.at.hello())
                    self.came, self.heard = self.came + 1, time.monotonic()
                    pressing = asyncio.ensure_future(self._press(client)) if self.drives else None
                    try:
                        await self._watch(client)
                    finally:
                        if pressing is not None:
                            pressing.cancel()
            await asyncio.sleep(AGAIN)

    async def _watch(self, client: ClientConnection) -> None:
        async for data in client:
            if isinstance(data, bytes):
                kind, sequence = struct.unpack_from("<2I", data)
                if kind == 2:
                    self.states += 1
                    await client.send(ask(type="ack", sequence=sequence))
                self.forces += kind == 4
            elif json.loads(data)["type"] == "statistics":
                now = time.monotonic()
                self.silence, self.heard = max(self.silence, now - self.heard), now

    async def _press(self, client: ClientConnection) -> None:
        began, number = time.monotonic(), 0
        await client.send(ask(type="drive"))
        await client.send(ask(type="tool", kind="sphere", radius=RADIUS, position=FROM.tolist()))
        await client.send(ask(type="force", rate=1000, tools=[0, 3]))
        while True:
            number += 1
            place = FROM - [0.0, 0.0, DEEP * np.sin(np.pi * (time.monotonic() - began)) ** 2]
            await client.send(ask(type="pose", position=place.tolist(), sequence=number))
            await asyncio.sleep(max(0.0, began + number / 1000 - time.monotonic()))


async def harm(address: str, seconds: float, kinds: list[str]) -> dict[str, Any]:
    """Let hostile clients of some kinds come for some seconds."""
    at = Address(address)
    tasks = [asyncio.ensure_future(again(KINDS[kind], at)) for kind in kinds]
    await asyncio.sleep(seconds)
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)
    return {}


async def visit(address: str, seconds: float) -> dict[str, Any]:
    """Let honest clients come for some seconds, and return what they felt."""
    at = Address(address)
    honest = [Honest(at, drives) for drives in (True, False, False)]
    began, tasks = time.monotonic(), [asyncio.ensure_future(each.run()) for each in honest]
    await asyncio.sleep(seconds)
    lasted = time.monotonic() - began
    silence = max(max(each.silence, time.monotonic() - each.heard) for each in honest)
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)
    return {
        "silence": silence, "came": sum(each.came for each in honest),
        "states": sum(each.states for each in honest[1:]) / lasted / 2, "forces": honest[0].forces / lasted,
    }  # fmt: skip


if __name__ == "__main__":
    where, lasting, chosen = sys.argv[1], float(sys.argv[2]), sys.argv[3:]
    print(json.dumps(asyncio.run(harm(where, lasting, chosen) if chosen else visit(where, lasting))))
