"""An exported page in a browser: real time without a server, press, grasp, record and replay, and what it refuses."""

from __future__ import annotations

import functools
import gzip
import http.server
import json
import shutil
import threading
from pathlib import Path
from time import sleep

import numpy as np
import pytest
from browser_input import NARROW, hold, needs_chromium, opening, picture
from chromium import Chromium
from exported import BALL, SIZE, TOOL_FORCE, Engine, export, pose_at, set_tool, tool_record, train

import palpate as pt

pytestmark = [pytest.mark.slow, pytest.mark.release, needs_chromium]  # compiles the step for a browser
SOURCES = Path(__file__).parents[3] / "page" / "src"
PLACE, SMALL_BALL = (0.024, 0.038, SIZE[2] + BALL + 0.001), 0.006
OTHER = (0.052, 0.012, SIZE[2] + SMALL_BALL + 0.001)
SESSION = """
(async () => {
  const [{ openModel }, { LocalSession }, { decode }] = await Promise.all(
    ["exportedModel", "localSession", "protocol"].map((name) => import(`./${name}.js`)));
  let clock = 0;
  performance.now = () => clock;
  LocalSession.prototype.turn = () => {}; // periods are taken below
  const reasons = [];
  const told = ({ type, reason }) => type === "error" && reasons.push(reason);
  const session = new LocalSession(await openModel(new URL("model/", location.href).href), told);
  const turns = GIVEN.map((messages) => {
    for (const message of messages) session.handle(message);
    session.stepTo(++clock);
    return decode(session.toolFrame()).tools.map(({ force, pinned }) => [...force, Number(pinned)]);
  });
  return { turns, reasons };
})()
"""


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *words):
        pass


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("web") / "organ.rom"
    train("MooneyRivlin", path)
    return path


@pytest.fixture(scope="module")
def folder(model_file):
    return export(model_file, "--c", str(model_file.parent / "library"), "--web", str(model_file.parent / "web"))


def test_a_library_of_the_same_compilation_is_next_to_the_page(folder):
    names = (folder.parent / "library" / "organ.h").read_text()
    assert "organ_step" in names
    assert b"model_step" in (folder / "model" / "simd.wasm").read_bytes()
    assert b"organ_step" not in (folder / "model" / "simd.wasm").read_bytes()


@pytest.fixture(scope="module")
def serve():
    servers = []

    def start(target):
        handler = functools.partial(QuietHandler, directory=str(target))
        servers.append(http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler))
        threading.Thread(target=servers[-1].serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{servers[-1].server_port}/"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.fixture(scope="module")
def address(folder, serve):
    return serve(folder)


@pytest.fixture(scope="module")
def browser():
    with Chromium() as running:
        yield running


@pytest.fixture
def page(browser):
    with opening(browser) as open_page:
        yield open_page


def press(tab, depth=40, at=(0, 0)):
    x, y = hold(tab, at)
    for k in range(1, 9):
        tab.mouse("Moved", x, y + depth * k / 8)
        sleep(0.02)
    return x, y + depth


def click(tab, name):
    tab.evaluate(f"document.getElementById('{name}').click()")


def test_a_press_is_in_real_time_with_its_force(page, address):
    tab = page(address)
    x, y = press(tab)
    tab.wait("palpate.force > 0.1")
    before = tab.evaluate("[palpate.session.state.steps, performance.now()]")
    sleep(2.0)
    after = tab.evaluate("[palpate.session.state.steps, performance.now()]")
    assert after[0] - before[0] > 0.5 * (after[1] - before[1])  # periods of 1 ms, drawn in software on one machine
    assert tab.evaluate("document.getElementById('force').textContent") not in ("", "0")
    assert tab.evaluate("document.getElementById('disclaimer').checkVisibility()")
    tab.mouse("Released", x, y)
    tab.wait("palpate.force === 0")


def test_forceps_pull_the_surface(page, address):
    tab = page(address)
    tab.key("3")
    x, y = hold(tab)
    for k in range(1, 9):
        tab.mouse("Moved", x, y - 5 * k)
        sleep(0.02)
    tab.wait("palpate.session.state.tool === 'grasp' && palpate.force > 0.05")
    tab.mouse("Released", x, y)


def test_a_recording_is_replayed_and_left(page, address):
    tab = page(address)
    click(tab, "record")
    x, y = press(tab)
    tab.wait("palpate.force > 0.1")
    sleep(0.5)
    tab.mouse("Released", x, y)
    click(tab, "record")
    tab.wait("palpate.session.hello.mode === 'replay'")
    tab.wait("palpate.session.hello.duration > 0.5 && palpate.force > 0.1")
    assert tab.evaluate("document.getElementById('replay').checkVisibility()")
    click(tab, "live")
    tab.wait("palpate.session.hello.mode === 'live' && palpate.session.status.state === 'running'")
    press(tab)
    tab.wait("palpate.force > 0.1")


def test_keys_pause_reset_and_moduli_act(page, address):
    tab = page(address)
    tab.key("p")
    tab.wait("palpate.session.status.state === 'paused'")
    tab.key("p")
    tab.wait("palpate.session.status.state === 'running'")
    press(tab)
    tab.wait("palpate.force > 0.1")
    tab.key("r")
    tab.wait("palpate.force === 0 && palpate.session.state.time < 1")


def test_the_page_is_dark_and_narrow(page, address):
    bright, dark = (picture(page(address, dark=dark)).mean() for dark in (False, True))
    assert dark < bright - 0.3
    tab = page(address, NARROW, touch_screen=True)
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    press(tab)
    tab.wait("palpate.force > 0.1")


def test_the_browser_computes_the_forces_of_two_tools_as_the_engine(browser, folder, serve, model_file, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "web")
    for source in SOURCES.glob("*.js"):
        shutil.copy(source, copy)
    tab = browser.open(serve(copy))
    first, second = (ball_message(0, BALL, PLACE), ball_message(1, SMALL_BALL, OTHER))
    moves = [pose_at(0.5 * k / 200, True) for k in range(200)] + [pose_at(k / 200, True) for k in range(200)]
    messages = [[pose_message(k // 200, (PLACE, OTHER)[k // 200], move)] for k, move in enumerate(moves)]
    messages[0].insert(0, first)
    messages[200] = [{"type": "pin", "index": 0, "pinned": True}, second, *messages[200]]
    refused = [pose_message(0, PLACE, moves[0]), {**second, "position": PLACE}, ball_message(2, BALL, OTHER)]
    answer = tab.evaluate(
        SESSION.replace("GIVEN", json.dumps([*messages, [*refused, {"type": "release", "index": 1}]]))
    )
    tab.close()
    words = ("held where it is", "clear of the other tools", "takes 2 tools at most")
    assert len(answer["reasons"]) == len(words)
    assert all(word in reason for word, reason in zip(words, answer["reasons"], strict=True))
    turns = np.array(answer["turns"])
    assert turns[:200, 0, 3].sum() == 0
    assert turns[200:, 0, 3].all()
    assert not turns[-1, 1].any()  # it is put away
    engine, expected = Engine(pt.load(model_file)), []
    for k, move in enumerate(moves):
        if k % 200 == 0:
            set_tool(engine, 0, ((BALL, SMALL_BALL)[k // 200], 0.0, 0.0), (PLACE, OTHER)[k // 200], 0.3, k // 200)
        engine.arrays["pose"][k // 200] = move
        assert engine("step") == 0
        expected.append([tool_record(engine, index)[TOOL_FORCE : TOOL_FORCE + 3] for index in (0, 1)])
    assert np.abs(expected[-1]).max(axis=1).min() > 0.1  # both press
    np.testing.assert_allclose(turns[:-1, :, :3], expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_ball_is_held_while_a_second_presses(page, address, model_file):
    tab = page(address)
    tab.evaluate(f"palpate.hands.change({{ radius: {SMALL_BALL}, friction: 0 }})")
    x, y = press(tab, at=(-110, 0))
    tab.wait("palpate.force > 0.1")
    sleep(0.5)  # the approach has ended
    tab.key("h")
    tab.mouse("Released", x, y)
    tab.wait("palpate.hands.held.join() === '0' && palpate.hands.inHand === 1")
    click(tab, "record")
    press(tab, at=(110, 0))
    tab.wait("palpate.force > 0.1 && palpate.hands.state(0).newtons > 0.1")
    sleep(1.5)  # the body is at rest
    shown = "[...document.querySelectorAll('#hands li output')].map((each) => each.textContent)"
    states = "[0, 1].map((index) => palpate.hands.state(index)).map((each) => [...each.position, each.newtons])"
    texts, states = tab.evaluate(f"[{shown}, {states}]")
    model, starts = Engine(pt.load(model_file)), [np.add(state[:3], (0.0, 0.0, 0.008)) for state in states]
    for index, start in enumerate(starts):
        set_tool(model, 0, (SMALL_BALL, 0.0, 0.0), start, 0.0, index)
    for k in range(3000):
        for index, start in enumerate(starts):
            model.arrays["pose"][index, :3] = min(1.0, k / 500) * (states[index][:3] - start)
        assert model("step") == 0
    for index, state in enumerate(states):
        newtons = np.linalg.norm(tool_record(model, index)[TOOL_FORCE : TOOL_FORCE + 3])
        assert state[3] == pytest.approx(newtons, rel=0.01)
        assert float(texts[index].removesuffix(" N")) == pytest.approx(newtons, abs=0.06)
    click(tab, "record")
    tab.wait("palpate.session.hello.mode === 'replay' && palpate.hands.held.join() === '0'")
    tab.wait("palpate.hands.state(0).newtons > 0.1 && palpate.hands.state(1).newtons > 0.1")


def ball_message(index, radius, place):
    return {"type": "tool", "index": index, "kind": "sphere", "radius": radius, "friction": 0.3, "position": place}


def pose_message(index, place, move):
    return {"type": "pose", "index": index, "position": list(np.add(place, move[:3])), "quaternion": list(move[3:])}


def test_damaged_files_are_named(browser, folder, serve, tmp_path):
    for name in ("model.gz", "simd.wasm", "model.json"):
        copy = shutil.copytree(folder, tmp_path / name)
        (copy / "model" / name).unlink()
        tab = browser.open(serve(copy))
        tab.wait(f"document.getElementById('message')?.textContent.includes('{name} cannot be read')")
        tab.close()
    copy = shutil.copytree(folder, tmp_path / "damaged")
    content = bytearray(gzip.decompress((copy / "model" / "model.gz").read_bytes()))
    content[len(content) // 2] ^= 1
    (copy / "model" / "model.gz").write_bytes(gzip.compress(bytes(content)))
    tab = browser.open(serve(copy))
    tab.wait("document.getElementById('message')?.textContent.includes('damaged')")
    tab.close()
