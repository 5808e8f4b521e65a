"""What the tests of all commands share: runs, sessions of a block that tools touch, and a server with clients."""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[2] / "benchmarks")]

from chromium import Chromium
from view_scenes import BALL, EVERY, MIDDLE, PRESS_SECONDS, block, press
from websockets.asyncio.client import connect

import palpate as pt
from palpate.app.cli import main
from palpate.app.session.session import Session
from palpate.app.view.server.address import LOOPBACK, allowed_hosts, open_listener
from palpate.app.view.server.page import Page
from palpate.app.view.server.server import Server
from palpate.dynamics.run.reactions import nodal_outputs

TOKEN = "a-token-of-tests"
ABOVE = MIDDLE + np.array([0, 0, BALL + 0.002])
SECONDS = 60.0  # to wait for what takes a fraction of one on an idle machine


@pytest.fixture
def assert_refused(capsys):
    """A function that runs a command line and asserts that it is refused in one line with some parts in it."""

    def refused(argv, *parts):
        try:
            code = main(argv)
        except SystemExit as end:
            code = end.code
        captured = capsys.readouterr()
        said = [line for line in captured.err.splitlines() if not line.endswith("...")]
        assert code == 2
        assert captured.out == ""
        assert len(said) == 1
        assert all(part in said[0] for part in parts), said[0]

    return refused


@pytest.fixture
def stop_after(monkeypatch):
    """A function that makes runs raise an error at the first snapshot after a time [s]."""

    def stop(time, error):
        def late(model, fields, state, *others):
            if state.time > time:
                raise error
            return nodal_outputs(model, fields, state, *others)

        monkeypatch.setattr("palpate.dynamics.nodal.model.nodal_outputs", late)

    return stop


@pytest.fixture(scope="session")
def run_study():
    """A function that runs a study as a person would: its folder, report, standard output and standard error."""

    def run(options, out):
        command = [sys.executable, "-W", "error", "-m", "palpate", *options, "--json", "--out", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return out, json.loads((out / "report.json").read_text()), done.stdout, done.stderr

    return run


@pytest.fixture(scope="session")
def assert_drawn():
    """A function that asserts that a file is a picture with something on it."""

    def drawn(path):
        from matplotlib.image import imread

        picture = imread(path)
        assert min(picture.shape[:2]) > 500
        assert picture[..., :3].std() > 0.02

    return drawn


@pytest.fixture(scope="session")
def model():
    body = block().model
    runs = [pt.rollout(body, press(seed)[0], duration=PRESS_SECONDS, every=EVERY) for seed in range(2)]
    made = pt.hyper_reduce(body, runs, modes=0, enrichment=pt.vibration_modes(body, 12)[0])
    report = {**made.report, "scene": {"name": "view_scenes:block", "parameters": {}}}
    return pt.ReducedModel(replace(made.data, report=report))


@pytest.fixture
def session(model):
    """A session of the block that runs; stopped after the test."""
    session = Session(model, "Block")
    session.start()
    yield session
    session.stop()


def until(condition, of=lambda: None):
    """Wait until something is so."""
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end, f"it never came: {of()}"
        time.sleep(0.005)


@pytest.fixture(name="until", scope="session")
def _until():
    return until


@pytest.fixture
def ball():
    """The message that puts a ball above the block."""
    return {"type": "tool", "kind": "sphere", "radius": BALL, "position": ABOVE.tolist(), "friction": 0.2}


@pytest.fixture(scope="session")
def browser():
    with Chromium() as made:
        yield made


class Client:
    """A viewer in a test: it keeps what it is told, and acknowledges frames if it is told to."""

    def __init__(self, socket, draws=True):
        self.socket, self.draws = socket, draws
        self.messages, self.states, self.overlays, self.forces, self.geometry = [], [], [], [], None
        self.force_indices = []
        self.surroundings, self.tools = [], []

    async def say(self, **message):
        await self.socket.send(json.dumps(message))

    async def hear(self):
        """Take one message or frame."""
        text = await asyncio.wait_for(self.socket.recv(), SECONDS)
        if isinstance(text, str):
            self.messages.append(json.loads(text))
            return
        kind, sequence, n, t = struct.unpack("<4I", text[:16])
        if kind == 1:
            points = np.frombuffer(text, "<f4", 3 * n, 16).reshape(-1, 3)
            self.geometry = points, np.frombuffer(text, "<u4", 3 * t, 16 + 12 * n).reshape(-1, 3)
            self.fixed = np.frombuffer(text, "u1", offset=16 + 12 * (n + t))
        elif kind == 2:
            head = np.frombuffer(text, "<f8", 25, 16)
            values = np.frombuffer(text, "<f4", offset=216)
            assert len(values) in (3 * n, 4 * n)
            self.states.append((sequence, head, values[: 3 * n].reshape(-1, 3), values[3 * n :]))
            if self.draws:
                await self.say(type="ack", sequence=sequence)
        elif kind == 3:
            self.overlays.append((sequence, np.frombuffer(text, "<f4", 3 * n, 16).reshape(-1, 3)))
        elif kind == 7:
            self.surroundings.append((len(self.states), text))
        elif kind == 8:
            self.tools.append((sequence, np.frombuffer(text, "<f8", 16 * n, 16).reshape(-1, 16)))
        else:
            self.force_indices.append(n)
            self.forces.append(np.frombuffer(text, "<f8", 23, 16))

    async def hear_until(self, condition):
        """Take messages until something is so."""
        end = time.monotonic() + SECONDS
        while not condition(self):
            assert time.monotonic() < end, "it never came"
            await self.hear()

    async def told(self, kind, **values):
        """Wait for a message of a type with some values, and return it."""

        def there(client):
            return any(m["type"] == kind and all(m[n] == v for n, v in values.items()) for m in client.messages)

        await self.hear_until(there)
        return next(m for m in self.messages if m["type"] == kind and all(m[n] == v for n, v in values.items()))


class Site:
    """A server in a thread of its own."""

    def __init__(self, show, folder=None, public=None):
        self.listener = open_listener(LOOPBACK, 18765)
        self.port = self.listener.getsockname()[1]
        page = Page(allowed_hosts(LOOPBACK, self.port), *([folder] if folder else []), public=public)
        self.server, self.loop, ready = Server(show, page, TOKEN), asyncio.new_event_loop(), threading.Event()
        self.thread = threading.Thread(target=self._run, args=(ready,), daemon=True)
        self.thread.start()
        assert ready.wait(SECONDS)

    @property
    def address(self):
        return f"http://{LOOPBACK}:{self.port}/#{TOKEN}"

    def _run(self, ready):
        asyncio.set_event_loop(self.loop)
        self.task = self.loop.create_task(self.server.run(self.listener, ready.set))
        with contextlib.suppress(asyncio.CancelledError):
            self.loop.run_until_complete(self.task)
        self.loop.close()

    def close(self):
        if self.thread.is_alive():
            self.loop.call_soon_threadsafe(self.task.cancel)
        self.thread.join(SECONDS)

    @contextlib.asynccontextmanager
    async def client(self, *, token=TOKEN, draws=True, greet=True, more=None, version=2, **options):
        options = {"subprotocols": [f"palpate.v{version}"], "max_size": None, "close_timeout": 1.0, **options}
        async with connect(f"ws://{LOOPBACK}:{self.port}/session", **options) as socket:
            own = Client(socket, draws)
            await own.say(type="hello", protocol=version, token=token, **(more or {}))
            if greet:
                await own.hear_until(lambda c: c.geometry is not None)
            yield own


@pytest.fixture
def site(session):
    own = Site(session)
    yield own
    own.close()


@pytest.fixture
def site_of():
    """A function that serves any show."""
    made = []

    def serve(show, folder=None, public=None):
        made.append(Site(show, folder, public))
        return made[-1]

    yield serve
    for own in made:
        own.close()
