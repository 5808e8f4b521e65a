"""Viewers before the session exists: the surface at once, the progress, then the session or the failure."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from websockets.asyncio.client import connect

import palpate as pt
from palpate.app.cli import main
from palpate.app.common.console import Console
from palpate.app.view.server.host import Host
from palpate.app.view.server.preparation import Preparation, coarsen
from palpate.scenes.organ import liver_surface

SURFACE = liver_surface(0.008)
SECONDS = 20.0


@pytest.fixture
def preparation(tmp_path):
    made = Preparation("Organ", "organ", SURFACE, tmp_path / "durations.json")
    yield made
    made.close()


@pytest.fixture
def write_organ(tmp_path):
    """A function that writes an OFF file of a surface in millimetres, and returns its path."""

    def write(surface):
        path = tmp_path / "organ.off"
        path.write_text(
            f"OFF\n{len(surface.vertices)} {len(surface.triangles)} 0\n"
            + "".join(f"{x} {y} {z}\n" for x, y, z in 1e3 * surface.vertices)
            + "".join(f"3 {a} {b} {c}\n" for a, b, c in surface.triangles)
        )
        return path

    return write


async def greeted(socket, address, **more):
    hello = {"type": "hello", "protocol": 2, "token": address.partition("#")[2], **more}
    await socket.send(json.dumps(hello))


def visit(address):
    return connect(
        address.partition("#")[0].replace("http", "ws") + "session", subprotocols=["palpate.v2"], max_size=None
    )


async def received(socket, seconds=SECONDS):
    data = await asyncio.wait_for(socket.recv(), seconds)
    return json.loads(data) if isinstance(data, str) else data


def test_the_surface_comes_before_the_session_and_the_progress_ends_with_it(preparation, session):
    host = Host(preparation, port=18600)
    preparation.begin("filling")

    async def watch():
        async with visit(host.address) as page, visit(host.address) as program:
            await greeted(page, host.address, preparation=True)
            first, frame = await received(page), await received(page)
            await greeted(program, host.address)
            with pytest.raises(TimeoutError):  # a program that does not follow the preparation waits for hello
                await received(program, 0.5)
            host.show(session)
            kinds = []
            while len(kinds) < 2 or not isinstance(kinds[-1], bytes):
                kinds.append(await received(page))
            late = [await received(page) for _ in range(4)]
            return first, frame, kinds, late, await received(program), await received(program)

    with host.serving():
        first, frame, until_body, late, hello, geometry = asyncio.run(watch())
    assert first["type"] == "preparing"
    assert (first["title"], first["phase"]) == ("Organ", "filling")
    kind, _, vertices, triangles = np.frombuffer(frame, "<u4", 4)
    assert (kind, vertices, triangles) == (5, len(SURFACE.vertices), len(SURFACE.triangles))
    points = np.frombuffer(frame, "<f4", 3 * vertices, 16).reshape(-1, 3)
    np.testing.assert_allclose(points, SURFACE.vertices, atol=1e-7)
    *progress, last_message, body = until_body
    assert all(message["type"] == "preparing" for message in progress)
    assert last_message["type"] == "hello"
    assert np.frombuffer(body, "<u4", 1) == 1
    assert not any(isinstance(each, dict) and each["type"] == "preparing" for each in late)
    assert hello["type"] == "hello"
    assert hello["vertices"] == np.frombuffer(geometry, "<u4", 3)[2]


def test_a_page_that_is_closed_and_opened_again_follows_the_same_preparation(preparation):
    host = Host(preparation, port=18600)

    async def visit_once():
        async with visit(host.address) as page:
            await greeted(page, host.address, preparation=True)
            return [await received(page) for _ in range(3)]

    with host.serving():
        preparation.begin("filling")
        asyncio.run(visit_once())
        preparation.begin("compiling")
        message, frame, _ = asyncio.run(visit_once())
        end = time.monotonic() + SECONDS
        while host._server.viewers and time.monotonic() < end:
            time.sleep(0.01)
        assert not host._server.viewers
    assert message["phase"] == "compiling"
    assert np.frombuffer(frame, "<u4", 1) == 5


def test_the_time_left_is_that_of_the_last_run(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("palpate.app.view.server.preparation.monotonic", lambda: now[0])
    file = tmp_path / "durations.json"

    def prepare():
        made, messages = Preparation("Organ", "organ", file=file), []
        for phase, seconds in (("filling", 2.0), ("compiling", 6.0)):
            made.begin(phase)
            now[0] += seconds / 2
            messages.append(made.message())
            now[0] += seconds / 2
        made.end()
        return messages

    first = prepare()
    assert [message["seconds_left"] for message in first] == [None, None]
    assert [message["fraction"] for message in first] == [None, None]
    second = prepare()
    assert [message["seconds_left"] for message in second] == pytest.approx([7.0, 3.0])
    assert [message["fraction"] for message in second] == pytest.approx([1 / 8, 5 / 8])
    other = Preparation("Organ", "another", file=file)
    other.close()
    assert other.message()["seconds_left"] is None
    file.write_text("{damaged")
    assert prepare()[0]["seconds_left"] is None
    file.write_text('{"organ": {"compiled": {"filling": "long"}}}')
    assert prepare()[0]["seconds_left"] is None


def test_a_run_that_compiles_gives_no_estimate_for_one_that_does_not(tmp_path):
    from numba import njit

    file = tmp_path / "durations.json"
    first = Preparation("Organ", "organ", file=file)
    first.begin("compiling")
    njit(lambda x: x + 1)(1)
    assert first.message()["functions_compiled"] == 1
    first.end()
    second = Preparation("Organ", "organ", file=file)
    second.close()
    assert second.message()["seconds_left"] is None


def test_a_surface_of_many_triangles_is_coarsened():
    coarse = coarsen(SURFACE, 1000)
    assert 500 < len(coarse.triangles) <= 1000
    assert coarse.volume == pytest.approx(SURFACE.volume, rel=0.1)
    assert coarsen(SURFACE, len(SURFACE.triangles)) is SURFACE


@pytest.fixture
def watched(monkeypatch):
    """Messages of a viewer of the command's page; the command's body waits until the first has come."""
    heard, seen = [], threading.Event()
    start = Host.serving

    async def follow(address):
        async with visit(address) as page:
            await greeted(page, address, preparation=True)
            async for data in page:
                heard.append(json.loads(data) if isinstance(data, str) else data)
                seen.set()

    def serving(host):
        threading.Thread(target=lambda: asyncio.run(follow(host.address)), daemon=True).start()
        return start(host)

    monkeypatch.setattr(Host, "serving", serving)
    return heard, seen


def test_a_failure_of_the_preparation_reaches_the_viewer_and_the_exit_status(
    write_organ, monkeypatch, tmp_path, capsys, watched
):
    heard, seen = watched
    monkeypatch.setattr("palpate.app.view.server.preparation.cache_folder", lambda: tmp_path)

    def refuse(scene, console, spacing=None):
        assert seen.wait(SECONDS)
        raise pt.InputError("spacing must be larger")

    monkeypatch.setattr("palpate.app.models.full_body.prepare_full_body", refuse)
    path = write_organ(SURFACE)
    assert main(["view", str(path), "--units", "mm", "--no-browser", "--port", "18620"]) == 2
    assert "spacing must be larger" in capsys.readouterr().err
    assert heard[0]["type"] == "preparing"
    assert heard[-1] == {"type": "failed", "reason": "spacing must be larger"}
    assert not (tmp_path / "preparation.json").exists()


def test_what_cannot_be_read_opens_no_page(tmp_path, assert_refused, monkeypatch):
    def opened(*arguments):
        raise AssertionError("a page was opened")

    monkeypatch.setattr("palpate.app.view.server.host.Host", opened)
    path = tmp_path / "organ.off"
    assert_refused(["view", str(path)], "there is no surface file")
    path.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    assert_refused(["view", str(path)], "must hold a closed surface")
    assert_refused(["view", str(tmp_path / "model.rom")], "model.rom")


PREPARES_FOREVER = """
import hashlib, signal, sys
import palpate.app.models.full_body as full_body
signal.signal(signal.SIGINT, signal.default_int_handler)  # which programs in the background ignore
from palpate.app.cli import main
def in_python(*arguments):
    while True:
        pass
def in_a_library(*arguments):  # returns to Python after minutes, as a compiler does after seconds
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
full_body.prepare_full_body = in_python if sys.argv[2] == "python" else in_a_library
sys.exit(main(["view", sys.argv[1], "--units", "mm", "--no-browser", "--port", "18640"]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["python", "library"])
def test_an_interrupt_ends_the_preparation_at_once(write_organ, kind):
    words = [sys.executable, "-c", PREPARES_FOREVER, str(write_organ(SURFACE)), kind]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    try:
        while not process.stderr.readline().startswith("open "):
            assert process.poll() is None
        time.sleep(2.0)
        os.kill(process.pid, signal.SIGINT)
        said = process.communicate(timeout=SECONDS)[1]
    finally:
        process.kill()
    assert process.returncode == 130
    assert "palpate: interrupted" in said
    assert "Traceback" not in said


COUNTS = """
import sys
from numba.core import event
class Count(event.Listener):
    count = 0
    def on_start(self, event): pass
    def on_end(self, event): self.count += 1
count = Count()
event.register("numba:compile", count)
from palpate.app.cli import main
code = main(["run", sys.argv[1], "--units", "mm", "--spacing", "0.02", "--full", "--realtime", "--seconds", "0.2"])
print("compiled", count.count)
sys.exit(code)
"""


@pytest.mark.slow
def test_the_second_start_compiles_nothing(write_organ):
    path = write_organ(SURFACE)
    for _ in range(2):
        run = subprocess.run([sys.executable, "-c", COUNTS, str(path)], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "compiled 0"


def test_the_console_reports_its_phases(capsys):
    heard = []
    with Console(heard.append).status("filling"):
        pass
    Console(heard.append).begin_phase("running")
    assert heard == ["filling", "running"]
    assert "filling" in capsys.readouterr().err
