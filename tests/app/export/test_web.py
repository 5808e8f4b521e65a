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
from exported import BALL, FORCE, SIZE, Engine, export, pose_at, set_tool, train

import palpate as pt

pytestmark = [pytest.mark.slow, needs_chromium]
SOURCES = Path(__file__).parents[3] / "page" / "src"
PLACE = (0.024, 0.038, SIZE[2] + BALL + 0.001)
STEPS = """
import("./exportedModel.js").then(async ({ openModel }) => {
  const model = await openModel(new URL("model/", location.href).href);
  const { arrays } = model;
  arrays.tool_kind[0] = 0n;
  arrays.tool_sizes.set(SIZES);
  arrays.tool_friction[0] = 0.3;
  arrays.tool_pose.set(PLACE);
  if (model.call("set_tool")) throw new Error("tool");
  return POSES.map((pose) => {
    arrays.pose.set(pose);
    if (model.call("step")) throw new Error("step");
    return Array.from(arrays.record.subarray(FORCE, FORCE + 3));
  });
})
"""


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *words):
        pass


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("web") / "organ.rom"
    train("NeoHookean", path)
    return path


@pytest.fixture(scope="module")
def folder(model_file):
    return export(model_file, "--web", str(model_file.parent / "web"))


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


def press(tab, depth=40):
    x, y = hold(tab)
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


def test_the_browser_computes_the_forces_of_the_engine(browser, folder, serve, model_file, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "web")
    shutil.copy(SOURCES / "exportedModel.js", copy)
    tab = browser.open(serve(copy))
    poses = [pose_at(k / 200, True) for k in range(200)]
    words = {"SIZES": [BALL, 0, 0], "PLACE": [*PLACE, 1, 0, 0, 0], "POSES": np.array(poses).tolist(), "FORCE": FORCE}
    script = STEPS
    for name, value in words.items():
        script = script.replace(name, json.dumps(value))
    forces = np.array(tab.evaluate(script))
    tab.close()
    engine = Engine(pt.load(model_file))
    set_tool(engine, 0, (BALL, 0.0, 0.0), PLACE, 0.3)
    expected = []
    for pose in poses:
        engine.arrays["pose"][:] = pose
        assert engine("step") == 0
        expected.append(engine.arrays["record"][FORCE : FORCE + 3].copy())
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


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


def test_options_of_a_library_are_refused_for_a_page(model_file, tmp_path):
    with pytest.raises(RuntimeError, match="--web must be alone"):
        export(model_file, "--relaxed", "--web", str(tmp_path / "page"))
