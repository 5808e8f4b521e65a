"""The page in a real browser: it draws the body, a hand presses it, others watch, and it comes back by itself.

It speaks to a session made by a formula, whose forces are known; test_browser_real.py lets it speak to real ones.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest

import palpate.app

sys.path.append(str(Path(__file__).parent))

from browser_input import NARROW, WIDE, around, middle, needs_chromium, opening, picture, press
from synthetic_session import SyntheticSession, sphere

PAGE = Path(palpate.app.__file__).parent / "view" / "page"

pytestmark = [pytest.mark.slow, needs_chromium]


@pytest.fixture
def synthetic():
    assert (PAGE / "index.html").is_file(), f"{PAGE} holds no page: pip install -e . bundles it"
    with SyntheticSession(PAGE) as made:
        yield made


@pytest.fixture
def opened(browser, synthetic):
    """A function that opens the page of the formula."""
    with opening(browser) as open_tab:
        yield lambda *options, **more: open_tab(synthetic.address, *options, **more)


def test_the_body_is_drawn_in_its_colour_on_a_calm_ground(opened):
    tab = opened()
    tab.evaluate("document.querySelector('#scalars [value=none]').click()")
    tab.wait("palpate.session.state.scalar === null")
    sleep(0.5)
    image, (x, y) = picture(tab), middle(tab)
    red, green, blue = around(image, x, y)
    assert red > 1.8 * green  # tissue
    assert red > 1.8 * blue
    corner = around(image, 20, WIDE[1] // 2)
    assert corner.min() > 0.9  # light ground
    assert image.std() > 0.05


def test_the_near_plane_follows_the_camera(opened):
    tab = opened()
    tab.wait("palpate.ready")
    tab.evaluate("palpate.scene.orbitCamera.zoom(0.01)")
    tab.wait("palpate.scene.camera.near < 0.015 * palpate.scene.size")


def test_a_drag_presses_and_letting_go_ends_the_force(opened):
    tab = opened()
    assert tab.evaluate("palpate.force") == 0
    x, y = press(tab, 20)
    first = tab.wait("palpate.force > 0.05 && palpate.force")
    for k in range(8):
        tab.mouse("Moved", x, y + 3 * k)
        sleep(0.02)
    tab.wait(f"palpate.force > {1.2 * first}")  # deeper is more
    tab.wait("document.getElementById('force-lead').textContent === 'about'")
    assert float(tab.evaluate("document.getElementById('force').textContent")) > 0
    assert tab.evaluate("palpate.scene.arrow.group.visible && palpate.scene.tool.group.visible")
    tab.mouse("Released", x, y)
    tab.wait("palpate.force === 0")
    tab.wait("document.getElementById('force').textContent === '0'")


def test_the_force_has_its_error_bound(opened):
    tab = opened()
    press(tab, 20)
    tab.wait("palpate.force > 0.5")
    sleep(0.8)  # the approach has ended
    newtons = tab.evaluate("palpate.force")
    text = tab.wait("document.getElementById('force-range').textContent")  # the bound is 0.12 N
    low, high = (float(part) for part in text.strip("()").split(" to "))
    assert "nodes, which is not known" in tab.evaluate("document.getElementById('force-note').textContent")
    assert newtons - 0.2 < low < newtons < high < newtons + 0.2  # rounded outward by up to 0.75 of 0.1 N


def test_beyond_training_a_sentence_replaces_the_force(opened):
    tab = opened()
    x, y = press(tab, 20)
    for k in range(60):
        tab.mouse("Moved", x, y + 10 * k)
        sleep(0.02)
    tab.wait("palpate.session.state.trust > 1.1")
    tab.wait("document.getElementById('force-section').classList.contains('beyond')")
    assert tab.evaluate("document.getElementById('force').textContent") == ""
    assert tab.evaluate("document.getElementById('force-note').textContent").startswith("Beyond what the model")
    assert tab.evaluate("palpate.scene.arrow.group.visible") is False
    assert around(picture(tab), *_place(tab, "palpate.session.state.position"))[0] > 0.5  # the tool is red
    tab.mouse("Released", x, y)
    tab.wait("!document.getElementById('force-section').classList.contains('beyond')")


def test_a_click_presses_lightly_and_deeper_while_it_is_held(opened):
    tab = opened()
    x, y = middle(tab)
    tab.mouse("Pressed", x, y)
    full = tab.evaluate("(p => p.depth === p.growth.light && p.growth.full)(palpate.controls.press)")
    assert full > 0.003
    tab.wait("palpate.controls.press.growth === null")
    assert tab.evaluate("palpate.controls.press.depth") == pytest.approx(full)
    tab.wait(f"Number(document.getElementById('depth').textContent) === {1e3 * full:.1f}")
    newtons = tab.evaluate("palpate.force")
    stiffness = float(tab.evaluate("document.getElementById('stiffness').textContent"))
    assert stiffness == pytest.approx(newtons / (1e3 * full), rel=0.04)
    tab.wait("palpate.plots.curve.depths.length > 3")
    tab.evaluate("document.querySelector('#plot-kind [value=depth]').click()")
    assert tab.evaluate("document.getElementById('plot-force').hidden && !document.getElementById('plot-depth').hidden")
    tab.mouse("Released", x, y)
    tab.wait("document.getElementById('depth-part').hidden && palpate.force === 0")
    assert tab.evaluate("palpate.plots.curve.depths.length") > 3  # kept until the next press


def test_a_short_click_touches_before_it_ends(opened):
    tab = opened()
    x, y = middle(tab)
    tab.mouse("Pressed", x, y)
    tab.mouse("Released", x, y)
    tab.wait("palpate.controls.presses.length === 0 && palpate.force === 0")
    assert tab.evaluate("Math.max(...palpate.plots.curve.depths)") > 0


def test_details_scroll_into_view(opened):
    tab = opened((1280, 560))
    tab.evaluate("document.querySelector('#details summary').click()")
    tab.wait(
        "(([details, panel]) => details.top < panel.top + 40 || details.bottom <= panel.bottom)"
        "(['details', 'panel'].map((name) => document.getElementById(name).getBoundingClientRect()))"
    )


def _place(tab, point):
    """Where a point of the body's frame, given by an expression, is in the window [px]."""
    return tab.evaluate(
        f"(() => {{ const b = document.getElementById('view').getBoundingClientRect();"
        f"const [x, y] = palpate.project([...{point}]); return [b.x + x, b.y + y]; }})()"
    )


def _box(tab, name):
    """Left, top, right and bottom of an element in the window [px]."""
    return tab.evaluate(
        f"(b => [b.left, b.top, b.right, b.bottom])(document.getElementById('{name}').getBoundingClientRect())"
    )


def _look(tab, elevation):
    """Turn the camera, and wait until the picture shows it."""
    tab.evaluate(f"(o => {{ o.goal.elevation = o.now.elevation = {elevation}; }})(palpate.scene.orbitCamera)")
    tab.evaluate("palpate.scene.dirty = true")
    sleep(0.6)


def _callout(tab):
    return tab.evaluate("document.getElementById('callout').textContent")


def test_a_press_that_cannot_begin_says_why_at_the_place(opened, synthetic):
    tab = opened()
    for kind, words in (("sphere", "nothing here to press"), ("grasp", "nothing here to hold")):
        tab.evaluate(f"document.querySelector('#kinds [value={kind}]').click()")
        tab.wait(f"palpate.session.tool.kind === '{kind}'")
        tab.mouse("Pressed", 60, 300)
        tab.mouse("Released", 60, 300)
        assert _callout(tab) == words
        left, _, right, bottom = _box(tab, "callout")
        assert left < 120
        assert right < 200
        assert 0 < 300 - bottom < 40
    _look(tab, elevation=-1.2)  # at the support
    for kind in ("grasp", "sphere"):
        tab.evaluate(f"document.querySelector('#kinds [value={kind}]').click()")
        tab.wait(f"palpate.session.tool.kind === '{kind}'")
        before = len(synthetic.received)
        x, y = _place(tab, f"[0, 0, {synthetic.rest[:, 2].min()}]")
        tab.mouse("Pressed", x, y)
        if kind == "sphere":  # tools press the tissue over supports
            tab.wait("palpate.force > 0")
        else:
            assert _callout(tab) == "fixed here"
        tab.mouse("Released", x, y)
        sent = [m for m in synthetic.received[before:] if m["type"] in ("pose", "tool")]
        assert bool(sent) == (kind == "sphere")


def test_a_tool_that_touches_nothing_is_in_the_air(opened):
    tab = opened()
    x, y = press(tab, 10)
    tab.wait("palpate.force > 0.05")
    assert _callout(tab) == ""
    for _ in range(30):
        tab.mouse("Moved", x, y - 60)
        y -= 2
    tab.wait("document.getElementById('callout').textContent === 'in the air'")
    tab.mouse("Moved", x, y + 40)
    tab.wait("palpate.force > 0.05 && document.getElementById('callout').hidden")
    tab.mouse("Released", x, y)


def test_the_support_is_drawn_paler_and_has_its_legend(opened):
    tab = opened()
    tab.evaluate("document.querySelector('#scalars [value=none]').click()")
    _look(tab, elevation=-1.2)  # at the support
    assert tab.evaluate("document.getElementById('fixed-key').hidden") is False
    image = picture(tab)
    fixed, free = around(image, *_place(tab, "[0, 0, -0.05]")), around(image, *_place(tab, "[0, -0.04, -0.03]"))
    assert fixed[1] / fixed[0] > 1.4 * free[1] / free[0]  # less red


def test_tissue_at_rest_has_the_colour_of_zero_in_the_legend(opened):
    tab = opened()
    tab.evaluate("document.querySelector('#scalars [value=pressure]').click()")
    tab.wait("Number(document.getElementById('legend-low').textContent.slice(1)) > 0")  # after a minus sign
    _look(tab, elevation=0.5)
    image = picture(tab)
    left, top, right, bottom = _box(tab, "legend-bar")
    zero = around(image, 0.5 * (left + right), 0.5 * (top + bottom), half=2)
    assert np.abs(around(image, *middle(tab)) - zero).max() < 0.06


def test_a_vertex_in_a_pit_is_not_drawn_black(browser):
    vertices, triangles = sphere(rows=16, columns=32)
    eye = np.array([0.277, -0.833, 0.479])
    deep = int(np.argmax(vertices @ eye))
    vertices[deep] *= 0.6  # its triangles are steep
    with SyntheticSession(PAGE, surface=(vertices, triangles)) as pitted:
        tab = browser.open(pitted.address, *WIDE)
        tab.wait("window.palpate?.ready", 60)
        tab.evaluate("document.querySelector('#scalars [value=none]').click()")
        sleep(1)
        x, y = _place(tab, vertices[deep].tolist())
        shades = picture(tab)[int(y) - 6 : int(y) + 6, int(x) - 6 : int(x) + 6, 0]
        assert shades.min() > 0.5  # some of its triangles were black
        assert shades.std() < 0.02
        tab.close()


def test_the_pressed_surface_moves_in_the_picture(opened, synthetic):
    tab = opened()
    sleep(0.5)
    before = tab.evaluate("[...palpate.scene.body.positions]")
    x, y = press(tab, 60)
    tab.wait("palpate.force > 0.05")
    moved = np.array(tab.evaluate("[...palpate.scene.body.positions]")) - before
    assert 0.001 < np.linalg.norm(moved.reshape(-1, 3), axis=1).max() < synthetic.size
    tab.mouse("Released", x, y)


def test_the_wheel_presses_deeper_while_held_and_zooms_otherwise(opened):
    tab = opened()
    x, y = press(tab, 0)
    before = tab.wait("palpate.force > 0.05 && palpate.force")
    eye = tab.evaluate("palpate.scene.orbitCamera.goal.distance")
    tab.mouse("Wheel", x, y, deltaX=0, deltaY=-240)
    tab.wait(f"palpate.force > {before} + 0.5")
    assert tab.evaluate("palpate.scene.orbitCamera.goal.distance") == eye
    tab.mouse("Released", x, y)
    tab.mouse("Wheel", x, y, "none", deltaX=0, deltaY=240)
    tab.wait(f"palpate.scene.orbitCamera.goal.distance > {1.05 * eye}")


def test_the_right_button_rotates_the_view_and_does_not_press(opened):
    tab = opened()
    x, y = middle(tab)
    before = tab.evaluate("palpate.scene.orbitCamera.goal.azimuth")
    tab.mouse("Pressed", x, y, "right")
    tab.mouse("Moved", x + 60, y, "right")
    tab.mouse("Released", x + 60, y, "right")
    assert tab.evaluate("palpate.scene.orbitCamera.goal.azimuth") == pytest.approx(before - 0.36, abs=0.05)
    assert tab.evaluate("palpate.force") == 0


def test_forceps_pull_the_body(opened, synthetic):
    tab = opened()
    tab.key("3")
    tab.wait("document.querySelector('#kinds [value=grasp]').ariaChecked === 'true'")
    x, y = press(tab, -40)
    tab.wait("palpate.force > 0.5 && palpate.session.state.tool === 'grasp'")
    told = [message for message in synthetic.received if message["type"] == "tool" and message["kind"] == "grasp"]
    assert len(told) == 1
    assert np.linalg.norm(told[0]["position"]) == pytest.approx(0.05, rel=0.02)  # a place of the surface
    tab.mouse("Released", x, y)
    tab.wait("palpate.force === 0")


def test_keys_press_move_let_go_and_reset(opened, synthetic):
    tab = opened()
    tab.evaluate("document.getElementById('view').focus()")
    for _ in range(4):
        tab.key("+")
    before = tab.wait("palpate.force > 0.3 && palpate.force")
    for _ in range(3):
        tab.key("+")
    tab.wait(f"palpate.force > {before} + 0.5")
    tab.key(" ")
    tab.wait("palpate.force === 0")
    tab.key("+")
    tab.wait("palpate.force > 0.3")
    tab.key("r")
    tab.wait("palpate.force === 0")
    assert {"type": "control", "action": "reset"} in synthetic.received
    tab.key("p")
    tab.wait("document.getElementById('pause-text').textContent === 'Resume'")
    assert tab.evaluate("document.getElementById('pause').getAttribute('aria-pressed')") == "true"


def test_one_finger_presses_and_two_fingers_zoom(opened):
    tab = opened(NARROW, touch_screen=True)
    x, y = middle(tab)
    tab.touch("Start", (x, y))
    tab.touch("Move", (x, y + 20))
    tab.wait("palpate.force > 0.05")
    tab.touch("End")
    tab.wait("palpate.force === 0")
    far = tab.evaluate("palpate.scene.orbitCamera.goal.distance")
    tab.touch("Start", (x - 20, y), (x + 20, y))
    tab.touch("Move", (x - 40, y), (x + 40, y))
    tab.touch("End")
    assert tab.evaluate("palpate.scene.orbitCamera.goal.distance") < 0.8 * far
    assert tab.evaluate("palpate.force") == 0


def test_the_reset_button_sends_a_reset_and_ends_the_force(opened, synthetic):
    tab = opened()
    press(tab)
    tab.wait("palpate.force > 0.05")
    tab.evaluate("document.getElementById('reset').click()")
    tab.wait("palpate.force === 0")
    assert {"type": "control", "action": "reset"} in synthetic.received


def test_a_second_viewer_watches(opened):
    first, second = opened(), opened((640, 480))
    first.wait("palpate.viewers === 2")
    assert first.evaluate("palpate.driver") is True
    assert second.evaluate("palpate.driver") is False
    assert second.evaluate("document.getElementById('watching').hidden") is False
    x, y = press(first)
    second.wait("palpate.force > 0.05 && palpate.scene.tool.group.visible")
    first.mouse("Released", x, y)
    second.wait("palpate.force === 0")
    own_x, own_y = press(second)  # is told that it only watches
    second.wait("palpate.statusLine.shown.includes('Another viewer controls the tool.')")
    assert second.evaluate("palpate.force") == 0
    second.mouse("Released", own_x, own_y)


def test_a_dropped_connection_is_restored(opened, synthetic):
    tab = opened()
    synthetic.drop()
    tab.wait("document.getElementById('connection').textContent === 'Not connected'")
    tab.wait("document.getElementById('connection').textContent.startsWith('Live')")
    assert tab.evaluate("document.getElementById('message').hidden") is True
    x, y = press(tab)
    tab.wait("palpate.force > 0.05")
    tab.mouse("Released", x, y)
    tab.errors.clear()  # the browser's own note of the failed connection


def test_an_address_with_another_token_shows_that_it_has_expired(browser, synthetic):
    tab = browser.open(synthetic.address[:-2], *WIDE)
    tab.wait("!!document.getElementById('message')?.textContent.includes('expired')", 60)  # the page may be loading yet
    tab.close()


def test_a_narrow_screen_needs_no_horizontal_scrolling(opened):
    tab = opened(NARROW)
    wide = "[...document.querySelectorAll('body *')].filter(e => e.getBoundingClientRect().right > innerWidth + 0.5"
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert tab.evaluate(f"{wide} && !e.closest('.hidden')).map(e => e.id || e.className || e.tagName)") == []
    assert tab.evaluate("document.getElementById('panel').scrollHeight > innerHeight / 3")


def test_colours_follow_the_system_and_the_switch(opened):
    tab = opened(dark=True)
    assert around(picture(tab), 20, WIDE[1] // 2).max() < 0.2
    tab.evaluate("document.getElementById('theme').click()")
    sleep(0.3)
    assert around(picture(tab), 20, WIDE[1] // 2).min() > 0.9
    tab.evaluate("document.getElementById('theme').click()")


def test_every_control_has_an_accessible_name(opened):
    tab = opened()
    tree = tab.call("Accessibility.getFullAXTree")["nodes"]
    asked = {"button", "slider", "radio", "combobox", "checkbox", "radiogroup", "application"}
    nodes = [node for node in tree if node.get("role", {}).get("value") in asked and not node.get("ignored")]
    assert len(nodes) > 12
    assert [node for node in nodes if not node.get("name", {}).get("value")] == []


def test_the_panel_sends_the_chosen_values(opened, synthetic):
    tab = opened()
    tab.evaluate("document.querySelector('#kinds [value=capsule]').click()")
    shown = "[...document.querySelectorAll('#sizes .slider:not([hidden]) input')]"
    assert tab.wait(f"{shown}.map(e => e.ariaLabel)") == ["Radius", "Length"]  # as the tool declares them
    tab.evaluate(f"(e => {{ e.value = 7; e.oninput(); e.onchange(); }})({shown}[0])")
    tab.evaluate("document.querySelector('#scalars [value=pressure]').click()")
    tab.wait("!document.getElementById('legend').hidden")
    slide = "(e => { e.value = 4; e.oninput(); e.onchange(); })(document.querySelector('#material-sliders input'))"
    tab.evaluate(slide)
    tab.evaluate("(e => { e.value = '0.25'; e.onchange({ target: e }); })(document.getElementById('speed'))")
    tab.evaluate("document.getElementById('record').click()")
    tab.wait("document.getElementById('record-text').textContent === 'Stop'")
    tab.evaluate("document.getElementById('record').click()")
    tab.wait("[...document.querySelectorAll('.toast')].some(e => e.textContent.includes('run.h5'))")
    told = {message["type"]: message for message in synthetic.received}
    assert synthetic.tool["kind"] == "capsule"
    assert synthetic.tool["radius"] == pytest.approx(0.007)
    assert told["show"]["scalar"] == "pressure"
    assert told["material"] == {"type": "material", "name": "shear modulus", "value": 4}
    assert told["speed"]["factor"] == 0.25


@pytest.mark.parametrize("hello", [{"tool_speed": 0.1}, {"tool_speed": None}, {}])
def test_fast_movements_are_offered_where_training_slows_the_tool(browser, hello):
    with SyntheticSession(PAGE, **hello) as synthetic:
        tab = browser.open(synthetic.address, *WIDE)
        tab.wait("window.palpate?.ready", 60)
        tab.evaluate("document.getElementById('details').open = true")
        shown, checked = (
            f"document.getElementById('fast').{name}" for name in ("parentNode.checkVisibility()", "checked")
        )
        assert tab.evaluate(shown) is bool(hello.get("tool_speed"))
        if hello.get("tool_speed"):
            assert tab.evaluate(checked) is False
            tab.evaluate("document.getElementById('fast').click()")
            sleep(0.2)
            assert {"type": "follow", "fast": True} in synthetic.received
            tab.wait(f"{checked} === false")  # this session does not follow: the page shows what is so
        assert not tab.errors
        tab.close()


def test_a_replay_has_a_time_line_and_no_tools(browser):
    with SyntheticSession(PAGE, mode="replay", duration=4.0, overlay=True) as replay:
        tab = browser.open(replay.address, *WIDE)
        tab.wait("window.palpate?.ready", 60)
        assert tab.evaluate("document.getElementById('replay').hidden") is False
        assert tab.evaluate("document.getElementById('transport').hidden") is True
        assert tab.evaluate("document.getElementById('overlay-row').hidden") is False
        tab.evaluate("(e => { e.value = 2.5; e.oninput({ target: e }); })(document.getElementById('time'))")
        tab.evaluate("1")
        sleep(0.2)
        assert {"type": "replay", "action": "seek", "time": 2.5} in replay.received
        assert not tab.errors
        tab.close()


def test_a_model_with_large_errors_has_its_advice_on_the_page(browser):
    text = "the model errs by 45% in force and 8% in surface on held-out runs; use more modes than 8"
    for advice in (text, None):
        with SyntheticSession(PAGE, training_errors={"force_error": 0.5, "advice": advice}) as session:
            tab = browser.open(session.address, *WIDE)
            tab.wait("window.palpate?.ready", 60)
            assert tab.evaluate("document.getElementById('message').textContent") == (advice or "")
            assert tab.evaluate("document.getElementById('message').hidden") is (advice is None)
            assert not tab.errors
            tab.close()


def test_a_hidden_page_still_acknowledges_frames(opened, synthetic):
    tab = opened()
    tab.evaluate("window.requestAnimationFrame = () => 0")  # what a browser does with a tab that is hidden
    sleep(1.0)
    before = synthetic.sequence
    end = monotonic() + 300
    while synthetic.sequence < before + 4:  # each of them needs that one before is acknowledged
        assert monotonic() < end, "the page is silent"
        sleep(0.1)
    drawn = tab.evaluate("palpate.session.state.sequence")
    sleep(1.2)
    assert tab.evaluate("palpate.session.state.sequence") == drawn


def refinement(state, **more):
    message = {"phase": None, "fraction": None, "seconds_left": None, "errors": None, "good": False, "note": ""}
    return {"type": "refinement", "state": state, **message, **more}


def test_a_finer_model_is_trained_and_changed_over_to(opened, synthetic):
    tab = opened()
    hidden, text = (
        "document.getElementById('refinement').hidden",
        "document.getElementById('refinement-text').textContent",
    )
    assert tab.evaluate(hidden)
    synthetic.tell(**refinement("offered"))
    tab.wait(f"!{hidden} && {text}.includes('in the background')")
    tab.evaluate("document.querySelector('#refinement-buttons button').click()")
    tab.wait("palpate.ready")
    synthetic.tell(**refinement("training", phase="3 of 16 runs", fraction=0.2, seconds_left=600))
    tab.wait(f"{text} === '3 of 16 runs: about 10 min left'")
    assert {"type": "refine", "action": "start"} in synthetic.received
    errors = {"force": 0.14, "surface": 0.024}
    synthetic.tell(**refinement("ready", errors=errors))
    tab.wait(f"{text}.includes('the force errs by 14\u00a0% and the surface by 2\u00a0%')")
    assert tab.evaluate("document.querySelector('#refinement-buttons button').textContent") == "Use it anyway"
    tab.evaluate("document.querySelector('#refinement-buttons button').click()")
    tab.evaluate("palpate.scene.orbitCamera.rotate(80, 20)")
    tab.evaluate("palpate.session.tool.radius = 0.011")
    camera = "[palpate.scene.orbitCamera.goal.azimuth, palpate.scene.orbitCamera.goal.distance]"
    seen = tab.evaluate(camera)
    synthetic.replace(sphere(60, 120), training_errors={"force_error": 0.14})
    synthetic.tell(**refinement("used", errors=errors, note="The recording ended with the full body."))
    tab.wait(f"{text}.startsWith('In use.')")
    tab.wait("palpate.session.state.positions.length === palpate.scene.body.rest.length")
    assert {"type": "refine", "action": "use"} in synthetic.received
    assert tab.evaluate(camera) == pytest.approx(seen, rel=1e-3)
    assert tab.evaluate("palpate.session.tool.radius") == 0.011
    assert tab.evaluate("palpate.statusLine.shown.at(-1)") == (
        "The finer model is in use. The recording ended with the full body."
    )


def test_a_failed_training_says_why_and_may_be_tried_again(opened, synthetic):
    tab = opened()
    synthetic.tell(**refinement("failed", note="organ.palpate is in use by a campaign that runs: wait for it"))
    tab.wait("document.getElementById('refinement-text').textContent.includes('is in use by a campaign')")
    assert tab.evaluate("document.querySelector('#refinement-buttons button').textContent") == "Try again"
