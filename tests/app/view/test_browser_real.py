"""The page in a real browser, with real sessions, and the pictures of the documentation.

With PALPATE_SCREENSHOTS=DIR the pictures are left there, of the full liver that ``palpate view liver`` opens.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
from dataclasses import replace
from pathlib import Path
from time import sleep

import numpy as np
import pytest
from scipy.spatial import cKDTree

import palpate as pt
from palpate.app.recordings.recording import ERROR_NAMES, load_recording, save_recording
from palpate.app.session.comparison import Comparison
from palpate.app.session.full_model_replay import full_model
from palpate.app.session.messages import validate_message
from palpate.app.session.replay import Replay
from palpate.app.session.session import Session
from palpate.app.view.server.label_choice import LabelChoice
from palpate.app.view.server.preparation import Preparation
from palpate.realtime.bodies import full_blade
from palpate.scenes.open_scene import open_scene
from palpate.surface.labels.inner import InnerLabel
from palpate.surface.labels.label_map import Segment
from palpate.surface.labels.listing import LabelRow
from palpate.surface.labels.surroundings import NO_SURROUNDINGS
from palpate.surface.surface import Surface

sys.path.append(str(Path(__file__).parent))

from browser_input import hold, needs_chromium, opening, picture
from view_scenes import BALL, MIDDLE

LINE = "palpate.scene.body.line"
AREA = "Number(document.getElementById('cut').textContent.match(/Cut: ([\\d.]+)/)?.[1] ?? 0)"  # [mm^2]

pytestmark = [pytest.mark.slow, needs_chromium]


@pytest.fixture
def pressed_body(browser, site):
    """A function that opens the page on the real session of a block."""
    with opening(browser) as open_tab:
        yield lambda *options, **more: open_tab(site.address, *options, **more)


def test_a_real_body_is_pressed_let_go_and_reset(pressed_body, session):
    tab = pressed_body()
    x, y = hold(tab)
    first = tab.wait("palpate.force > 0.02 && palpate.force")
    for k in range(10):
        tab.mouse("Moved", x, y + 2 * k)
        sleep(0.02)
    tab.wait(f"palpate.force > {1.2 * first}")
    assert tab.evaluate("palpate.session.state.tool") == "sphere"
    tab.mouse("Released", x, y + 20)
    tab.wait("palpate.force === 0 && palpate.session.state.tool === 'none'")
    hold(tab)
    tab.wait("palpate.force > 0.02")
    tab.evaluate("document.getElementById('reset').click()")
    tab.wait("palpate.force === 0")
    tab.wait("Math.max(...palpate.scene.body.positions.map((x, k) => Math.abs(x - palpate.scene.body.rest[k]))) < 1e-6")
    assert tab.evaluate("palpate.statusLine.errors") == []


def test_a_real_body_answers_every_tool_without_a_complaint(pressed_body):
    tab = pressed_body()
    for kind in ("capsule", "grasp", "sphere"):
        tab.evaluate(f"document.querySelector('#kinds [value={kind}]').click()")
        x, y = hold(tab)
        tab.mouse("Moved", x, y + (-25 if kind == "grasp" else 15))
        tab.wait(f"palpate.force > 0.01 && palpate.session.state.tool === '{kind}'")
        tab.mouse("Released", x, y)
        tab.wait("palpate.force === 0")
    assert tab.evaluate("palpate.statusLine.errors") == []


@pytest.fixture
def recording(session, ball, until, tmp_path):
    """A recorded press, with the same press moved by a millimetre as the full model's."""
    path = tmp_path / "press.h5"
    session.recordings.start()
    session.handle(validate_message(ball))
    for depth in (0.0, 0.003, 0.005):
        session.handle(validate_message({"type": "pose", "position": [*MIDDLE[:2], MIDDLE[2] + BALL + 0.002 - depth]}))
        before = len(session.recordings.recorder.times)
        until(lambda before=before: len(session.recordings.recorder.times) > before + 20)
    session.recordings.finish(path, wait=True)
    own = load_recording(path)
    positions = np.array([session.surface.rest + m.displacements(session.surface) for m in own.snapshots]) + 1e-3
    tools = len(own.snapshots[0].tools)
    full = {"times": own.times, "positions": positions, "force": np.zeros((len(own.times), tools, 3))}
    full["errors"] = dict.fromkeys(ERROR_NAMES, 0.0)
    save_recording(path, replace(own, full=full))
    return load_recording(path)


def test_a_real_recording_is_replayed_with_the_full_model_over_it(browser, site_of, recording):
    show = Replay(recording)
    with opening(browser) as open_tab:
        tab = open_tab(site_of(show).address)
        tab.wait("palpate.session.state.newtons > 0.05")
        assert tab.evaluate("document.getElementById('connection').textContent").startswith("Replay")
        assert tab.evaluate("palpate.scene.tool.group.visible")
        tab.evaluate("document.getElementById('play').click()")
        tab.wait("palpate.session.state.state === 'paused'")
        most = max(range(len(recording.snapshots)), key=lambda k: recording.snapshots[k].tools[0].force[2])
        at, newtons = (
            float(recording.times[most]) + 1e-4,
            float(np.linalg.norm(recording.snapshots[most].tools[0].force)),
        )
        seek = f"(e => {{ e.step = 'any'; e.value = {at}; e.oninput({{ target: e }}); }})"
        tab.evaluate(f"{seek}(document.getElementById('time'))")
        tab.wait(f"Math.abs(palpate.session.state.newtons - {newtons}) < 1e-9")
        assert tab.evaluate("palpate.scene.overlay.lines.visible") is False
        tab.evaluate("document.getElementById('overlay').click()")
        assert tab.evaluate("palpate.scene.overlay.lines.visible") is True
        shown = np.array(tab.evaluate("[...palpate.scene.overlay.place.array]")).reshape(-1, 3)
        own = np.array(tab.evaluate("[...palpate.scene.body.positions]")).reshape(-1, 3)
        np.testing.assert_allclose(shown, own + 1e-3, atol=1e-6)
        tab.evaluate("document.getElementById('play').click()")
        tab.wait(f"palpate.session.state.time !== {float(recording.times[most])}")


def test_a_replay_of_two_tools_shows_both(browser, site_of, session, until, tmp_path):
    path = tmp_path / "two.h5"
    session.recordings.start()
    for index, x in enumerate((0.012, 0.036)):
        tool = {"type": "tool", "kind": "sphere", "radius": 0.006, "friction": 0.2, "index": index}
        session.handle(validate_message({**tool, "position": [x, MIDDLE[1], MIDDLE[2] + 0.008]}))
        pressed = [x, MIDDLE[1], MIDDLE[2] + 0.004]
        session.handle(validate_message({"type": "pose", "position": pressed, "index": index}))
    before = len(session.recordings.recorder.times)
    until(lambda: len(session.recordings.recorder.times) > before + 60)
    session.recordings.finish(path, wait=True)
    with opening(browser) as open_tab:
        tab = open_tab(site_of(Replay(load_recording(path))).address)
        tab.wait("palpate.hands.slots.filter(({ state }) => state.newtons > 0.01).length === 2", 60)
        assert tab.evaluate("palpate.scene.tools.map(({ group }) => group.visible).slice(0, 2)") == [True, True]
        places = tab.evaluate("palpate.scene.tools.slice(0, 2).map(({ group }) => group.position.x)")
        np.testing.assert_allclose(places, (0.012, 0.036), atol=1e-3)


def test_a_comparison_shows_both_bodies_and_both_forces(browser, model, site_of):
    compared = Comparison(model, full_model(model, "view_scenes:block"), "Block")
    compared.start()
    try:
        with opening(browser) as open_tab:
            tab = open_tab(site_of(compared).address)
            assert tab.evaluate("palpate.scene.overlay.lines.visible") is True
            assert tab.evaluate("document.querySelector('#kinds [value=grasp]')") is None
            x, y = hold(tab)
            text = "document.getElementById('force-comparison').textContent"
            said = tab.wait(f"palpate.force > 0.02 && palpate.session.fullNewtons > 0.02 && {text}")
            assert re.fullmatch(r"reduced [\d.]+ N, full [\d.]+ N: [\d.]+ N (more|less)( \(\d+ %\))?", said)
            moved = "palpate.scene.overlay.place.array.some((x, k) => Math.abs(x - palpate.scene.body.rest[k]) > 1e-4)"
            tab.wait(moved)
            tab.mouse("Released", x, y)
            tab.wait("palpate.force === 0 && palpate.session.fullNewtons === 0")
    finally:
        compared.close()


CUT_SIZE = (0.06, 0.05, 0.02)  # [m]


@pytest.fixture(scope="module")
def soft_block():
    """A session of a soft full body, which forceps hold and a scalpel cuts."""
    tissue = pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45)
    body = pt.Solid(pt.box(CUT_SIZE, 5e-3, jitter=0.2), tissue, fixed="z-", mass_damping=8.0)
    session = Session(body, "Block")
    session.start()
    yield session
    session.close()


def _place(tab, point):
    """Where a point of the body's frame is in the window [px]."""
    return tab.evaluate(
        "(() => { const b = document.getElementById('view').getBoundingClientRect();"
        f"const [x, y] = palpate.project({list(point)}); return [b.x + x, b.y + y]; }})()"
    )


def _drag(tab, start, end, steps, pause):
    """Press at a place of the body and move to another one in steps, with a pause [s] after each."""
    (x, y), (u, v) = _place(tab, start), _place(tab, end)
    tab.mouse("Moved", x, y, "none")
    tab.mouse("Pressed", x, y)
    for k in range(1, steps + 1):
        tab.mouse("Moved", x + (u - x) * k / steps, y + (v - y) * k / steps)
        sleep(pause)
    return u, v


def _wound(tab):
    """Return the largest distance [m] of two vertices that are at the same place at rest: of the faces of a cut."""
    both = tab.evaluate("[[...palpate.scene.body.rest], [...palpate.scene.body.positions]]")
    rest, now = np.array(both).reshape(2, -1, 3)
    pairs = cKDTree(rest).query_pairs(1e-6, output_type="ndarray")
    return float(np.linalg.norm(now[pairs[:, 0]] - now[pairs[:, 1]], axis=1).max()) if len(pairs) else 0.0


def _wait(tab, condition, seconds=200):
    """Wait for a condition of the page, longer on a busy machine."""
    return tab.wait(condition, seconds)


def _picture_at_leisure(tab, path):
    """Take a picture with all its pixels, which software draws too slowly for a motion."""
    fine = "Object.assign(palpate.scene.resolution, { fixed: true, ratio: 1.5 }); palpate.scene.resize();"
    tab.evaluate(f"{{ {fine} }}")
    sleep(1.5)
    tab.screenshot(path)
    tab.evaluate("{ palpate.scene.resolution.ratio = 0.6; palpate.scene.resize(); }")


def test_tissue_is_grasped_held_and_cut_and_the_wound_opens_under_tension(browser, site_of, soft_block):
    length, width, height = CUT_SIZE
    with opening(browser) as open_tab:
        folder = os.environ.get("PALPATE_SCREENSHOTS")
        tab = open_tab(site_of(soft_block).address, (1280, 800))
        _wait(tab, "palpate.hands.max === 4")
        tab.key("3")
        end = _drag(tab, (0.5 * length, 0.2 * width, height), (0.5 * length, -0.3 * width, height + 0.004), 12, 0.05)
        _wait(tab, "palpate.hands.state(0).kind === 'grasp' && palpate.force > 0.05")
        tab.key("h")
        _wait(tab, "palpate.hands.state(0).pinned")
        tab.mouse("Released", *end)
        _wait(tab, "palpate.hands.inHand === 1")
        tab.key("4")
        tab.evaluate("palpate.hands.change({ toughness: 5, depth: 0.008, length: 0.024 })")
        end = _drag(tab, (0.25 * length, 0.42 * width, height), (0.78 * length, 0.42 * width, height), 30, 0.1)
        _wait(tab, "palpate.hands.state(1).kind === 'scalpel'")
        _wait(tab, "palpate.scene.body.count > palpate.session.hello.vertices")
        _wait(tab, f"({AREA}) > 80")
        if folder:
            _picture_at_leisure(tab, Path(folder) / "page_two_hands.png")
        tab.mouse("Released", *end)
        _wait(tab, "palpate.hands.state(1).kind === 'none'")
        assert tab.evaluate("palpate.hands.state(0).newtons") > 0.05  # it held all the time
        assert tab.evaluate("palpate.hands.held") == [0]
        sleep(1.0)
        taut = _wound(tab)
        assert taut > 1e-3
        tab.evaluate("document.querySelector('.held-label button').click()")
        _wait(tab, "palpate.hands.state(0).kind === 'none'")
        sleep(2.0)
        assert _wound(tab) < 0.5 * taut
        _sees_the_cut(tab)
        tab.call("Page.reload")
        sleep(1.0)
        tab.wait("window.palpate?.ready", 60)
        _wait(tab, f"{LINE} && ({AREA}) > 60")
        _sees_the_cut(tab)
        tab.evaluate("document.getElementById('reset').click()")
        _wait(tab, f"!{LINE} && document.getElementById('cut').textContent === ''")
        assert tab.evaluate("palpate.statusLine.errors") == []


def _press_key(tab, key, code, modifiers=0):
    """Press a key that moves the focus, or one with Ctrl (2) or Shift (8)."""
    for kind in ("rawKeyDown", "keyUp"):
        event = {"type": kind, "key": key, "windowsVirtualKeyCode": code, "modifiers": modifiers}
        tab.call("Input.dispatchKeyEvent", event)


def _tab_to(tab, selector, back=False):
    """Move the focus by Tab, or Shift and Tab, to an element."""
    for _ in range(40):
        _press_key(tab, "Tab", 9, 8 if back else 0)
        if tab.evaluate(f"document.activeElement.matches('{selector}')"):
            return
    raise AssertionError(f"no focus on {selector}")


def test_a_cut_is_made_undone_and_made_again_by_keyboard_alone(browser, site_of, soft_block, monkeypatch):
    soft_block.reset()
    hint, cut = "document.getElementById('hint').textContent", "document.getElementById('cut').textContent"
    with opening(browser) as open_tab:
        tab = open_tab(site_of(soft_block).address, (1280, 800))
        tab.evaluate("localStorage.removeItem('palpate-hints')")
        tab.call("Page.reload")
        sleep(1.0)
        tab.wait("window.palpate?.ready", 60)
        tab.wait(f"{hint}.startsWith('Hold on the body and drag')")
        _tab_to(tab, "#kinds button")
        tab.wait(f"{hint}.startsWith('Arrow keys')")
        for _ in range(3):
            tab.key("ArrowRight")
        tab.wait("palpate.hands.tool.kind === 'scalpel'")
        tab.wait(f"{hint}.includes('lowers the blade')")
        tab.evaluate("palpate.hands.change({ toughness: 1 })")
        _tab_to(tab, "#view", back=True)

        def draw():
            tab.key("ArrowLeft")
            tab.key("+")
            _wait(tab, "palpate.hands.state(0).kind === 'scalpel'")
            sleep(1.0)
            for _ in range(12):
                tab.key("ArrowRight")
                sleep(0.1)
            _wait(tab, f"{AREA} > 40")
            tab.key(" ")
            _wait(tab, "palpate.hands.state(0).kind === 'none' && palpate.session.status.strokes === 1")

        draw()
        assert tab.evaluate(hint) == ""  # its use dismisses it
        _press_key(tab, "z", 90, 2)
        _wait(tab, f"!{LINE} && {cut} === '' && palpate.session.status.strokes === 0")
        tab.wait("document.getElementById('spoken').textContent === 'The last cut is undone.'")
        assert tab.evaluate("document.getElementById('undo').disabled")
        _wait(tab, "palpate.session.state.state === 'running'")
        draw()
        monkeypatch.setattr(full_blade, "MAX_STRETCH", 0.0)  # no wound is closed at once
        _press_key(tab, "z", 90, 2)
        _wait(tab, f"!{LINE} && {cut} === '' && palpate.session.status.strokes === 0")
        tab.wait("palpate.statusLine.shown.some((text) => text.includes('starts from rest'))")
        assert (
            tab.evaluate("Math.max(...palpate.scene.body.positions.map((x, k) => x - palpate.scene.body.rest[k]))")
            < 1e-6
        )
        tab.call("Page.reload")
        sleep(1.0)
        tab.wait("window.palpate?.ready", 60)
        tab.key("4")
        tab.wait("palpate.hands.tool.kind === 'scalpel'")
        assert tab.evaluate(hint) == ""  # remembered
        tab.key("3")
        tab.wait(f"{hint}.includes('grasps')")
        assert tab.evaluate("palpate.statusLine.errors") == []


def _sees_the_cut(tab):
    """Assert that the line of a cut darkens the body in all colours, and that its size is stated without a blade."""
    text = tab.evaluate("document.getElementById('cut').textContent")
    assert re.fullmatch(r"Cut: [\d.]+ mm², [\d.]+ mm long, [\d.]+ mm deep\.", text), text
    assert float(re.search(r"([\d.]+) mm long", text)[1]) > 15.0
    for scalar in ("displacement", "stress", "pressure", "none"):
        tab.evaluate(f"document.querySelector('#scalars [value={scalar}]').click()")
        sleep(1.0)
        with_line = picture(tab)
        tab.evaluate(f"{{ {LINE}.mesh.visible = false; palpate.scene.dirty = true; }}")
        sleep(0.3)
        darker = picture(tab).sum(axis=2) - with_line.sum(axis=2)
        tab.evaluate(f"{{ {LINE}.mesh.visible = true; }}")
        assert np.sum(darker > 0.3) > 100, scalar  # of three colours from 0 to 1


def _shape(name, low, high):
    """Return a box between two corners [m], counter-clockwise from outside."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [triangle for a, b, c, d in faces for triangle in ((a, b, c), (a, c, d))]
    return Surface(np.asarray(low) + corners * (np.asarray(high) - np.asarray(low)), triangles, name)


def test_faces_that_the_image_cuts_off_are_hatched_with_a_line_in_the_legend(browser, site, session):
    low, high = session.surface.rest.min(axis=0), session.surface.rest.max(axis=0)
    key = "document.getElementById('edge-key')"
    with opening(browser) as open_tab:
        tab = open_tab(site.address)
        tab.evaluate("{ palpate.scene.orbitCamera.goal.elevation = 1.2; }")
        tab.evaluate("document.querySelector('#scalars [value=none]').click()")
        sleep(1.5)
        assert tab.evaluate(f"{key}.hidden")
        plain = picture(tab)
        planes = np.array([[[*(0.5 * (low + high))[:2], high[2]], [0.0, 0.0, -1.0]]])  # at the top
        site.loop.call_soon_threadsafe(site.server.surround, NO_SURROUNDINGS._replace(edges=planes))
        tab.wait(f"!{key}.hidden")
        assert tab.evaluate("document.getElementById('surroundings').hidden")  # nothing is around the body
        marks = "(_, k) => [palpate.scene.body.rest[3 * k + 2], palpate.scene.body.scalar.array[3 * k + 2]]"
        heights, flags = np.array(tab.evaluate(f"Array.from({{ length: palpate.scene.body.count }}, {marks})")).T
        np.testing.assert_array_equal(flags[heights < high[2] - 1e-3], 0.0)
        assert flags[heights > high[2] - 1e-4].mean() > 0.5  # those at its rim face aside, too
        sleep(1.0)
        x, y = _place(tab, planes[0, 0].tolist())
        before, after = (image[int(y) - 12 : int(y) + 12, int(x) - 12 : int(x) + 12] for image in (plain, picture(tab)))
        lines = (after - before).sum(axis=2) > 0.3  # of three colours from 0 to 1
        assert 0.1 < lines.mean() < 0.5


def test_shapes_around_a_body_are_named_by_a_click_and_hidden_by_a_key(browser, site, session):
    high = session.surface.rest.max(axis=0)
    size = high - session.surface.rest.min(axis=0)
    left = _shape("kidney_left", high + size * [0.05, -1.0, -1.0], high + size * [0.4, 0.0, 0.0])
    behind = _shape("rib_7", left.vertices.min(axis=0) + 0.1 * size, left.vertices.max(axis=0) - 0.1 * size)
    with opening(browser) as open_tab:
        tab = open_tab(site.address)
        assert tab.evaluate("document.getElementById('surroundings').hidden")
        around = NO_SURROUNDINGS._replace(shapes=(left, behind))
        site.loop.call_soon_threadsafe(site.server.surround, around)
        tab.wait("!document.getElementById('surroundings').hidden")
        text = tab.evaluate("document.getElementById('surroundings-text').textContent")
        assert text == "Surroundings (2 shapes)"
        assert tab.evaluate("palpate.scene.surroundings.mesh") is None  # hidden at first in software
        tab.key("s")
        assert tab.evaluate("palpate.scene.graph.children.includes(palpate.scene.surroundings.mesh)")
        middle = left.vertices.mean(axis=0).tolist()
        colours = "palpate.scene.surroundings.mesh.material.uniforms.colours.value.map((c) => c.getHexString())"
        assert len(set(tab.evaluate(colours))) == 5
        assert tab.evaluate("palpate.scene.surroundings.kinds") == ["organ", "bone"]
        keys = "[...document.querySelectorAll('#surroundings-kinds span')].map((e) => e.textContent)"
        assert tab.evaluate(keys) == ["bone", "organ"]

        def click():
            place = "(() => { const b = document.getElementById('view').getBoundingClientRect();"
            x, y = tab.evaluate(f"{place} const [x, y] = palpate.project({middle}); return [b.x + x, b.y + y]; }})()")
            tab.mouse("Moved", x, y, "none")
            tab.mouse("Pressed", x, y)
            tab.mouse("Released", x, y)

        tab.mouse("Moved", *_place(tab, middle), "none")
        label = "document.getElementById('hover-name')"
        tab.wait(f"!{label}.hidden && {label}.textContent === 'kidney left'")
        assert tab.evaluate("palpate.scene.surroundings.mesh.material.uniforms.hovered.value") == 0
        tab.mouse("Moved", *_place(tab, (high - 0.5 * size * [1, 1, 0]).tolist()), "none")
        tab.wait(f"{label}.hidden")  # over the body the tool is shown
        assert tab.evaluate("palpate.scene.surroundings.hovered") == -1
        for name in ("kidney left", "rib 7", "kidney left"):  # the nearest, the one behind it, and again
            click()
            tab.wait(f"document.getElementById('spoken').textContent === '{name}'")
        assert tab.evaluate("document.getElementById('surroundings-names').selectedOptions[0].text") == "kidney left"
        assert tab.evaluate("palpate.scene.surroundings.mesh.material.uniforms.marked.value") == 0
        tab.key("Escape")
        tab.wait("palpate.scene.surroundings.mesh.material.uniforms.marked.value === -1")
        tab.key("s")
        tab.wait("!palpate.scene.graph.children.includes(palpate.scene.surroundings.mesh)")
        assert tab.evaluate("document.getElementById('surroundings-shown').checked") is False
        click()
        assert tab.evaluate("palpate.scene.surroundings.marked") == -1
        tab.key("s")
        tab.wait("palpate.scene.graph.children.includes(palpate.scene.surroundings.mesh)")
        x, y = hold(tab)  # a body is pressed as before
        tab.wait("palpate.force > 0.02")
        tab.mouse("Released", x, y)
        assert tab.evaluate("palpate.statusLine.errors") == []


def test_what_joins_a_label_is_listed_and_can_be_left_out(browser, site_of):
    inner = [
        InnerLabel(
            Segment(4, "lung_right", 0, 4, 9), "lung_right", 1.6e-7, False, "another organ by its name", "empty"
        ),
        InnerLabel(Segment(2, "tumour", 0, 2, 9), "tumour", 2.4e-5, True, "a lesion by its name", "empty"),
    ]
    rows = [
        LabelRow(1, "liver", "liver", 5e-4, 1, False, tuple(inner)),
        LabelRow(2, "tumour", "tumour", 2e-5, 1, False),
    ]
    choice = LabelChoice("trunk.nii.gz", rows)
    site = site_of(choice)
    tab = browser.open(site.address, 1024, 640)
    tab.wait("document.querySelectorAll('#choice-rows tr').length === 2")
    lines = tab.evaluate("[...document.querySelector('#choice-rows .inner').children].map((line) => line.textContent)")
    assert lines == [
        "with tumour (24 ml, a lesion by its name)", "without lung_right (0.16 ml, another organ by its name)"
    ]  # fmt: skip
    tab.evaluate("document.querySelector('#choice-rows .inner input').click()")  # which starts nothing
    tab.evaluate("document.querySelector('#choice-rows button').click()")
    assert choice.wait() == (("liver",), ("tumour",))
    site.loop.call_soon_threadsafe(site.server.refuse, "another")
    tab.wait("document.getElementById('choice-error').textContent === 'another'")
    tab.evaluate("document.querySelector('#choice-rows .inner input').click()")
    tab.evaluate("document.querySelector('#choice-rows button').click()")
    assert choice.wait() == (("liver",), ())
    errors = tab.errors
    tab.close()
    assert not errors


def test_a_body_is_chosen_in_the_list_of_labels(browser, site_of, session, tmp_path):
    rows = [LabelRow(k, f"organ_{k}", f"organ_{k}", 1e-4 * k, 1 + k % 2, k == 3) for k in range(1, 14)]
    choice = LabelChoice("trunk.nii.gz", rows)
    site = site_of(choice)
    tab = browser.open(site.address, 1024, 640)
    tab.wait("document.querySelectorAll('#choice-rows tr').length === 13")
    assert tab.evaluate("document.getElementById('panel').inert")
    assert tab.evaluate("document.getElementById('choice-start').disabled")
    texts = tab.evaluate(
        "[...document.querySelectorAll('#choice-rows tr')[2].children].map((cell) => cell.textContent)"
    )
    assert texts == ["", "organ_3", "3", "300", "2", "yes"]
    tab.evaluate("{ const find = document.getElementById('choice-find'); find.value = 'organ 12'; find.oninput(); }")
    assert tab.evaluate("document.querySelectorAll('#choice-rows tr:not([hidden])').length") == 1
    tab.evaluate("document.querySelector('#choice-rows tr:not([hidden]) button').click()")
    assert choice.wait().parts == ("organ_12",)
    site.loop.call_soon_threadsafe(site.server.refuse, "organ_12 must be closed")
    tab.wait("document.getElementById('choice-error').textContent === 'organ_12 must be closed'")
    tab.evaluate("{ const find = document.getElementById('choice-find'); find.value = ''; find.oninput(); }")
    for k in (1, 4):
        tab.evaluate(f"document.querySelectorAll('#choice-rows input')[{k}].click()")
    tab.evaluate("document.getElementById('choice-start').click()")
    assert choice.wait() == (("organ_2", "organ_5"), ())
    remarks = {"subtitle": "with tumour", "notes": ["the image cuts it: its face there is flat"]}
    with contextlib.closing(
        Preparation("Organ 2", "organ", None, tmp_path / "durations.json", **remarks)
    ) as preparation:
        site.loop.call_soon_threadsafe(site.server.prepare, preparation)
        tab.wait("document.getElementById('contents').textContent === 'with tumour'")
        assert tab.evaluate("document.getElementById('notes').innerText") == remarks["notes"][0]
        site.loop.call_soon_threadsafe(site.server.show, session)
    tab.wait("window.palpate?.ready && document.getElementById('choice').hidden", 60)
    assert tab.evaluate("document.getElementById('panel').inert") is False
    errors = tab.errors
    tab.close()
    assert not errors


@pytest.mark.skipif("PALPATE_SCREENSHOTS" not in os.environ, reason="PALPATE_SCREENSHOTS names no folder")
def test_pictures_of_the_documentation(browser, site_of):
    folder = Path(os.environ["PALPATE_SCREENSHOTS"])
    folder.mkdir(parents=True, exist_ok=True)
    scene = open_scene("liver", {"spacing": "9 mm"})
    show = Session(scene.body, scene.title, foundations=scene.foundations)
    show.start()
    try:
        tab = browser.open(site_of(show).address.replace("/#", "/?still#"), 1280, 800)
        tab.wait("window.palpate?.ready", 60)
        x, y = hold(tab)
        tab.wait("palpate.session.state.tool !== 'none'")
        for k in range(20):
            tab.mouse("Moved", x, y + 2 * k)
            sleep(0.05)
        tab.wait("palpate.force > 0.05")
        sleep(6.0)  # a still picture is drawn at leisure in software
        assert picture(tab).std() > 0.05
        tab.screenshot(folder / "page.png")
        tab.close()
    finally:
        show.stop()
