"""A session of the page's protocol without an engine: a surface that a tool indents, by a formula.

It answers as the real server does as far as the page can tell, on a port of its own, in a thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from http import HTTPStatus
from pathlib import Path

import numpy as np

from palpate.app.session.messages import describe_tools

TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
TOKEN = "synthetic"
STIFFNESS = 400.0  # [N/m] of the indentation
RATE = 60.0  # [Hz] of states


def sphere(rows=48, columns=96, radius=0.05):
    """Vertices and triangles of a ball."""
    polar = np.linspace(0, np.pi, rows + 1)[1:-1]
    angle = 2 * np.pi * np.arange(columns) / columns
    ring = np.stack(np.broadcast_arrays(np.sin(polar)[:, None] * np.cos(angle), np.sin(polar)[:, None] * np.sin(angle),
                                        np.cos(polar)[:, None]), axis=-1).reshape(-1, 3)  # fmt: skip
    vertices = radius * np.vstack([ring, [[0, 0, 1], [0, 0, -1]]])
    k = np.arange(len(ring)).reshape(rows - 1, columns)
    a, b, c, d = k[:-1], k[1:], np.roll(k[1:], -1, 1), np.roll(k[:-1], -1, 1)
    top, bottom = np.full(columns, len(ring)), np.full(columns, len(ring) + 1)
    faces = [(a, b, c), (a, c, d), (top, k[0], np.roll(k[0], -1)), (bottom, np.roll(k[-1], -1), k[-1])]
    return vertices, np.vstack([np.stack([np.ravel(part) for part in face], axis=-1) for face in faces])


class SyntheticSession:
    """Serves the page and a body that yields to the tool; a context manager."""

    subprotocols = ("palpate.v2",)

    def __init__(self, folder: Path, surface=None, **hello):
        self.folder, self.more = folder, hello
        self.rest, self.triangles = surface or sphere()
        self.fixed = (self.rest[:, 2] < self.rest[:, 2].min() + 0.1 * np.ptp(self.rest[:, 2])).astype("u1")
        self.bounds = np.array([self.rest.min(axis=0), self.rest.max(axis=0)])
        self.size = float(np.linalg.norm(self.bounds[1] - self.bounds[0]))
        self.viewers, self.driver, self.received = [], None, []
        self.tool = {"kind": "sphere", "radius": 0.07 * self.size, "length": 0.2 * self.size}
        self.tool |= {"friction": 0.2, "stiffness": None}
        self.pose = self.grasped = None
        self.state, self.sequence, self.posed, self.recording, self.speed = "running", 0, 0, False, 1.0
        self.started = time.monotonic()

    def __enter__(self):
        self.loop = asyncio.new_event_loop()
        ready = threading.Event()
        self.thread = threading.Thread(target=self._run, args=(ready,), daemon=True)
        self.thread.start()
        assert ready.wait(300)
        return self

    def __exit__(self, *_):
        self.loop.call_soon_threadsafe(self.stop.set)
        self.thread.join(300)

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}/#{TOKEN}"

    def tell(self, **message):
        """Send a message to all viewers."""

        async def send():
            for viewer in list(self.viewers):
                await viewer.send(json.dumps(message))

        asyncio.run_coroutine_threadsafe(send(), self.loop).result(10)

    def replace(self, surface, **hello):
        """Show another surface of the body to all viewers."""

        async def send():
            self.rest, self.triangles = surface
            self.fixed = np.zeros(len(self.rest), dtype="u1")
            self.more |= hello
            for viewer in list(self.viewers):
                viewer.in_flight = 0
                await viewer.send(json.dumps(self._hello(viewer)))
                await viewer.send(self._geometry())
            self._tell()

        asyncio.run_coroutine_threadsafe(send(), self.loop).result(10)

    def drop(self):
        """Close all connections, as a network does that fails."""

        async def close():
            for viewer in list(self.viewers):
                viewer.transport.abort()

        asyncio.run_coroutine_threadsafe(close(), self.loop).result(10)

    def _run(self, ready):
        from websockets.asyncio.server import serve

        async def run():
            self.stop = asyncio.Event()
            async with serve(self._session, "127.0.0.1", 0, process_request=self._file, subprotocols=self.subprotocols,
                             compression=None, max_size=2**16) as server:  # fmt: skip
                self.port = server.sockets[0].getsockname()[1]
                ready.set()
                await self.stop.wait()

        self.loop.run_until_complete(run())
        self.loop.close()

    def _file(self, connection, request):
        path = request.path.split("?")[0]
        if path == "/session":
            return None
        file = self.folder / ("index.html" if path == "/" else path.lstrip("/"))
        if not file.is_file():
            return connection.respond(HTTPStatus.NOT_FOUND, "")
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        body = file.read_bytes()
        policy = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self'"
        policy += f" ws://127.0.0.1:{self.port}"
        headers = {"Content-Type": TYPES[file.suffix], "Content-Length": str(len(body)), "Cache-Control": "no-store"}
        return Response(200, "OK", Headers(headers | {"Content-Security-Policy": policy, "Connection": "close"}), body)

    async def _session(self, viewer):
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            await self._met(viewer)

    async def _met(self, viewer):
        hello = json.loads(await viewer.recv())
        if hello.get("token") != TOKEN:
            return await viewer.close(4401)
        viewer.in_flight, viewer.scalar = 0, "none"
        self.viewers.append(viewer)
        self.driver = self.driver or viewer
        await viewer.send(json.dumps(self._hello(viewer)))
        await viewer.send(self._geometry())
        sender = asyncio.create_task(self._send_states(viewer))
        try:
            self._tell()
            async for text in viewer:
                await self._take(viewer, json.loads(text))
        finally:
            sender.cancel()
            self.viewers.remove(viewer)
            if self.driver is viewer:
                self.driver = None
            self._tell()

    def _hello(self, viewer):
        units = {"displacement": ("mm", 1e3), "stress": ("kPa", 1e-3), "pressure": ("kPa", 1e-3)}
        modulus = {"name": "shear modulus", "unit": "kPa", "value": 2.2, "low": 0.5, "high": 8.0, "live": True}
        return {
            "type": "hello", "protocol": 2, "title": "Synthetic", "driver": viewer is self.driver,
            "viewers": len(self.viewers), "mode": "live", "vertices": len(self.rest),
            "triangles": len(self.triangles), "spacing": 0.004,
            "bounds": self.bounds.tolist(), "tools": ["sphere", "capsule", "grasp"], "tool": self.tool,
            **describe_tools(["sphere", "capsule", "grasp"]),
            "scalars": [{"name": name, "unit": unit, "factor": factor, "signed": name == "pressure"}
                        for name, (unit, factor) in units.items()],
            "materials": [modulus],
            "rate": 1000, "training_errors": {"force_error": 0.05}, "overlay": False, **self.more,
        }  # fmt: skip

    def _status(self, viewer):
        return {
            "type": "status", "driver": viewer is self.driver, "viewers": len(self.viewers), "state": self.state,
            "recording": self.recording, "tool": self.tool, "speed": self.speed, "pause_reason": None,
        }  # fmt: skip

    def _tell(self):
        for viewer in self.viewers:
            asyncio.get_running_loop().create_task(self._send(viewer, json.dumps(self._status(viewer))))

    async def _send(self, viewer, message):
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            await viewer.send(message)

    async def _take(self, viewer, message):
        kind = message["type"]
        if kind == "ack":
            viewer.in_flight -= 1
            return
        self.received.append(message)
        if kind == "show":
            viewer.scalar = message["scalar"]
        elif kind == "drive" and self.driver is None:
            self.driver = viewer
        elif kind == "latency":
            await viewer.send(json.dumps(message))
        elif viewer is self.driver:
            await self._prescribed(viewer, kind, message)
        if kind not in ("pose", "show"):
            self._tell()

    async def _prescribed(self, viewer, kind, message):
        if kind == "pose":
            self.pose, self.posed = message, message.get("sequence", 0)
        elif kind == "tool":
            self.tool = {name: message.get(name) for name in self.tool}
            self.pose, self.grasped = message, np.array(message["position"])
        elif kind == "release":
            self.pose = None
        elif kind == "control":
            self.pose = None if message["action"] == "reset" else self.pose
            self.state = {"pause": "paused", "resume": "running"}.get(message["action"], self.state)
        elif kind == "speed":
            self.speed = message["factor"]
        elif kind == "record":
            self.recording = message["action"] == "start"
            if not self.recording:
                await viewer.send(json.dumps({"type": "recorded", "file": "run.h5", "frames": 120}))

    def _geometry(self):
        head = np.array([1, 0, len(self.rest), len(self.triangles)], dtype="<u4")
        return (
            head.tobytes()
            + self.rest.astype("<f4").tobytes()
            + self.triangles.astype("<u4").tobytes()
            + self.fixed.tobytes()
        )

    async def _send_states(self, viewer):
        last = 0.0
        while True:
            await asyncio.sleep(1 / RATE)
            if time.monotonic() > last + 0.5:
                last = time.monotonic()
                numbers = {"median_ms": 0.31, "p99_ms": 0.48, "misses": 0, "periods": 1000, "force_bound": 0.12}
                await self._send(viewer, json.dumps({"type": "statistics", **numbers}))
            if viewer.in_flight < 2:
                viewer.in_flight += 1
                await self._send(viewer, self._state(viewer.scalar))

    def _contact_displacement(self):
        """Positions, and the force on the tool: the surface goes where the tool is not."""
        if self.pose is None:
            return self.rest, np.zeros(3)
        return self._deform(self.tool, self.pose, self.grasped)

    def _deform(self, tool, pose, grasped):
        """Positions under a tool of a pose, and the force on it."""
        at = np.array(pose["position"])
        if tool["kind"] == "grasp":
            pull = at - grasped
            share = np.exp(-np.sum((self.rest - grasped) ** 2, axis=1) / (0.12 * self.size) ** 2)
            return self.rest + share[:, None] * pull, -STIFFNESS * pull
        inward = self.rest[np.argmin(np.linalg.norm(self.rest - at, axis=1))] - at
        distance = np.linalg.norm(inward)
        outside = np.dot(at - self.bounds.mean(axis=0), -inward) > 0
        depth = max(tool["radius"] - (distance if outside else -distance), 0.0)
        direction = (inward if outside else -inward) / distance
        centre = at + direction * (tool["radius"] - depth)
        share = np.exp(-np.sum((self.rest - centre) ** 2, axis=1) / (1.6 * tool["radius"] + depth) ** 2)
        return self.rest + (depth * share)[:, None] * direction, -STIFFNESS * depth * direction

    def _state(self, scalar):
        positions, force = self._contact_displacement()
        self.sequence += 1
        moved = np.linalg.norm(positions - self.rest, axis=1)
        pressure = 4e5 * (moved - 0.2 * moved.max())
        shown = {"displacement": moved, "stress": 2e5 * moved, "pressure": pressure}.get(scalar)
        newtons = np.linalg.norm(force)
        clock = time.monotonic() - self.started
        at = self.pose["position"] if self.pose else [0, 0, 0]
        turn = self.pose["quaternion"] if self.pose else [1, 0, 0, 0]
        kinds = ["none", "sphere", "capsule", "grasp", "group", "scalpel"]
        tool = 0 if self.pose is None else kinds.index(self.tool["kind"])
        strain, computing = 0.5 * newtons**2 / STIFFNESS, 3.1e-4 + 2e-5 * np.sin(3 * clock)
        numbers = [clock, 0.3 + newtons / 8, *force, 0, 0, 0, *at, *turn, 0.0, strain, computing, 1e-5, 1000 * clock]
        numbers += [1 if self.state == "running" else 2, tool]
        low, high = (0, 0) if shown is None else (shown.min(), shown.max())
        head = np.array([2, self.sequence, len(self.rest), 0], dtype="<u4").tobytes()
        head += np.array([*numbers, low, high, self.posed], dtype="<f8").tobytes()
        return head + positions.astype("<f4").tobytes() + (b"" if shown is None else shown.astype("<f4").tobytes())
