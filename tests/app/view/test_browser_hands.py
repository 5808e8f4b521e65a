"""Several tools on the page, in a real browser: held where they are, taken back, by two fingers, watched and replayed.

They speak to a session made by a formula; test_browser_real.py lets the page speak to real ones.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest

import palpate.app

sys.path.append(str(Path(__file__).parent))

from browser_input import NARROW, middle, needs_chromium, opening
from synthetic_hands import SyntheticHands
from synthetic_session import SyntheticSession

PAGE = Path(palpate.app.__file__).parent / "view" / "page"
HANDS = "[palpate.hands.inHand, palpate.hands.held, palpate.hands.tool.kind]"
FORCE = "palpate.hands.state({}).newtons"

pytestmark = [pytest.mark.slow, needs_chromium]


@pytest.fixture
def synthetic():
    with SyntheticHands(PAGE) as made:
        yield made


@pytest.fixture
def opened(browser, synthetic):
    """A function that opens the page of the formula."""
    with opening(browser) as open_tab:
        yield lambda *options, **more: open_tab(synthetic.address, *options, **more)


def choose(tab, kind):
    tab.evaluate(f"document.querySelector('#kinds [value={kind}]').click()")
    tab.wait(f"palpate.hands.tool.kind === '{kind}'")


def drag(tab, start, way, steps=5):
    """Press at a place and move by a way [px]; returns the end."""
    tab.mouse("Moved", *start, "none")
    tab.mouse("Pressed", *start)
    for k in range(1, steps + 1):
        end = start[0] + way[0] * k / steps, start[1] + way[1] * k / steps
        tab.mouse("Moved", *end)
        sleep(0.02)
    return end


def hold_forceps(tab):
    """Pull with forceps to the left, hold them there by a key, and let the button go; returns where they are."""
    x, y = middle(tab)
    choose(tab, "grasp")
    end = drag(tab, (x - 60, y - 20), (-40, -20))
    tab.wait("palpate.hands.state(palpate.hands.inHand).newtons > 0.5")
    tab.key("h")
    tab.wait("palpate.hands.held.length === 1")
    tab.mouse("Released", *end)
    settled_force(tab, 0)
    return end


def settled_force(tab, index):
    """The force of a tool [N], once no tool approaches and three more frames show the same force: all poses arrived."""
    approaching = "palpate.controls.presses.some(({ approach }) => approach > 0)"
    now = f"[palpate.session.state.sequence, {FORCE.format(index)}, {approaching}]"
    since, force, end = None, None, monotonic() + 300
    while True:
        sequence, newtons, moves = tab.evaluate(now)
        if moves or newtons != force or since is None:
            since, force = sequence, newtons
        elif sequence >= since + 3:
            return force
        assert monotonic() < end, f"tool {index} does not come to rest: {newtons} N, it approaches: {moves}"
        sleep(0.1)


def draw_frames(tab):
    """Wait until what was done before is drawn: three more frames."""
    tab.wait(f"palpate.session.state.sequence >= {tab.evaluate('palpate.session.state.sequence') + 3}")


def told(session, kind):
    return [message for message in session.received if message["type"] == kind]


def test_forceps_are_held_and_a_second_tool_presses(opened, synthetic):
    tab = opened()
    hold_forceps(tab)
    held = tab.evaluate(FORCE.format(0))
    assert tab.evaluate(HANDS) == [1, [0], "grasp"]
    assert told(synthetic, "pin") == [{"type": "pin", "index": 0, "pinned": True}]
    choose(tab, "sphere")
    x, y = middle(tab)
    end = drag(tab, (x + 60, y + 30), (0, 20))
    tab.wait(f"{FORCE.format(1)} > 0.3 && palpate.force === {FORCE.format(1)}")
    assert tab.evaluate(FORCE.format(0)) == held  # it holds while another presses
    poses = told(synthetic, "pose")
    assert poses[-1]["index"] == 1
    assert tab.evaluate("palpate.scene.tools.map(({ group }) => group.visible)") == [True, True, False, False]
    assert tab.evaluate("palpate.scene.arrows.map(({ group }) => group.visible)") == [True, True, False, False]
    rows = "[...document.querySelectorAll('#hands li')].map((row) => row.querySelector('.where').textContent)"
    tab.wait(f"{rows}.join() === 'held,in hand'")
    tab.wait(f"document.querySelector('.held-label span').textContent === '{held:.1f} N'")
    tab.mouse("Released", *end)
    tab.wait(f"{FORCE.format(1)} === 0")
    assert tab.evaluate(FORCE.format(0)) == held
    assert told(synthetic, "release")[-1]["index"] == 1
    assert tab.evaluate("palpate.statusLine.errors") == []


def test_each_tool_has_its_colour_and_its_line_in_the_plot(opened):
    tab = opened()
    hold_forceps(tab)
    choose(tab, "sphere")
    x, y = middle(tab)
    end = drag(tab, (x + 60, y + 30), (0, 20))
    tab.wait(f"{FORCE.format(1)} > 0.3")
    tab.wait("palpate.plots.values.tool1.at(-1) > 0.3 && palpate.plots.values.newtons.at(-1) > 0.5")
    assert tab.evaluate("palpate.plots.values.tool2.at(-1)") is None
    colours = tab.evaluate("palpate.scene.tools.map(({ material }) => material.uniforms.colour.value.toArray())")
    arrows = tab.evaluate("palpate.scene.arrows.map(({ material }) => material.uniforms.colour.value.toArray())")
    for each in (np.array(colours), np.array(arrows)):
        apart = np.linalg.norm(each[:, None] - each[None], axis=2)[np.triu_indices(4, 1)]
        assert apart.min() > 0.2
    tab.mouse("Released", *end)


def test_a_held_tool_is_taken_back_moved_and_held_again(opened, synthetic):
    tab = opened()
    place = hold_forceps(tab)
    held = tab.evaluate(FORCE.format(0))
    end = drag(tab, place, (-40, 0))
    tab.wait("palpate.hands.inHand === 0")
    tab.wait(f"{FORCE.format(0)} > {held} + 0.3")  # pulled on from where it was
    tab.mouse("Released", *end)
    tab.wait("palpate.hands.held.length === 1")  # it stays where it is let go
    assert [message["pinned"] for message in told(synthetic, "pin")] == [True, False, True]
    before = settled_force(tab, 0)
    tab.mouse("Pressed", *end)  # a click takes it in hand where it is
    tab.mouse("Released", *end)
    tab.wait("palpate.hands.held.length === 0 && palpate.hands.inHand === 0")
    assert settled_force(tab, 0) == pytest.approx(before)
    tab.key(" ")
    tab.wait(f"{FORCE.format(0)} === 0")
    assert tab.evaluate("palpate.statusLine.errors") == []


def test_a_tool_taken_in_hand_is_held_again_when_another_kind_is_chosen(opened):
    tab = opened()
    place = hold_forceps(tab)
    held = tab.evaluate(FORCE.format(0))
    tab.mouse("Pressed", *place)
    tab.mouse("Released", *place)
    tab.wait("palpate.hands.held.length === 0")
    choose(tab, "sphere")
    assert tab.evaluate(HANDS) == [1, [0], "sphere"]
    assert tab.evaluate(FORCE.format(0)) == pytest.approx(held)


@pytest.mark.parametrize("where", ["list", "label"])
def test_a_cross_releases_a_held_tool(opened, synthetic, where):
    tab = opened()
    hold_forceps(tab)
    cross = {"list": "#hands li[data-index='0'] button:last-child", "label": ".held-label button"}[where]
    tab.evaluate(f'document.querySelector("{cross}").click()')
    tab.wait(f"{FORCE.format(0)} === 0 && palpate.hands.held.length === 0")
    assert told(synthetic, "release")[-1] == {"type": "release", "index": 0}
    tab.wait("document.getElementById('hands').hidden && !document.querySelector('.held-label')")


def test_the_button_holds_the_next_tool_where_it_is_let_go(opened):
    tab = opened()
    button = "document.getElementById('hold')"
    tab.evaluate(f"{button}.click()")
    assert tab.evaluate(f"{button}.getAttribute('aria-pressed')") == "true"
    x, y = middle(tab)
    end = drag(tab, (x, y), (0, 25))
    tab.wait(f"{FORCE.format(0)} > 0.3")
    held = settled_force(tab, 0)  # the approach has ended
    tab.mouse("Released", *end)
    tab.wait(f"{button}.getAttribute('aria-pressed') === 'false' && palpate.hands.held.length === 1")
    assert settled_force(tab, 0) == pytest.approx(held, rel=0.05)


def test_a_second_blade_and_a_fifth_tool_are_refused(opened):
    tab = opened()
    x, y = middle(tab)
    choose(tab, "scalpel")
    end = drag(tab, (x, y - 60), (30, 0))
    tab.key("h")
    tab.mouse("Released", *end)
    assert tab.evaluate(HANDS) == [1, [0], "sphere"]  # a blade is no more at hand
    tab.key("4")
    assert tab.evaluate("palpate.hands.tool.kind") == "sphere"
    assert tab.evaluate("palpate.statusLine.shown.at(-1)").startswith("One blade at a time")
    for k, place in enumerate(((-60, 20), (60, 30), (0, 80))):
        end = drag(tab, (x + place[0], y + place[1]), (0, 10))
        tab.key("h")
        tab.mouse("Released", *end)
        assert len(tab.evaluate("palpate.hands.held")) == min(k + 2, 3)
    assert tab.evaluate("palpate.statusLine.shown.at(-1)").startswith("4 tools at most")
    tab.wait(f"{FORCE.format(3)} === 0")  # it was let go with the button
    tab.key("r")
    tab.wait("palpate.hands.held.length === 0 && palpate.hands.inHand === 0")
    assert tab.evaluate("palpate.statusLine.errors") == []


def _frame(tab, index=0):
    """Axes x and z of a tool in space, as it is drawn."""
    axes = f"palpate.scene.tools[{index}].group.matrixWorld.elements"
    elements = tab.evaluate(f"(palpate.scene.graph.updateMatrixWorld(), [...{axes}])")
    return np.array(elements[:3]), np.array(elements[8:11])


def test_a_blade_stands_on_the_surface_and_turns_into_its_stroke(opened, synthetic):
    tab = opened()
    choose(tab, "scalpel")
    x, y = middle(tab)
    end = drag(tab, (x - 40, y - 60), (50, 70), steps=3)
    settled_force(tab, 0)
    pose = synthetic.poses[0]
    along, up = _frame(tab)
    place = np.array(pose["position"])
    outward = place / np.linalg.norm(place)  # of a ball
    assert up @ outward > 0.98
    right, top = (
        np.array(tab.evaluate(f"[...palpate.scene.camera.matrixWorld.elements].slice({4 * k}, {4 * k + 3})"))
        for k in range(2)
    )
    stroke = 50 * right - 70 * top
    stroke -= (stroke @ outward) * outward
    assert abs(along @ stroke) / np.linalg.norm(stroke) > 0.95
    depth = tab.evaluate("palpate.hands.tool.depth")
    assert np.linalg.norm(place) == pytest.approx(0.05 - depth, abs=4e-4)  # it follows the curved surface
    tab.mouse("Released", *end)


def test_the_handle_of_a_scalpel_ends_in_the_view_from_every_side(opened):
    tab = opened()
    choose(tab, "scalpel")
    x, y = middle(tab)
    place = (
        "(() => { const { ghost } = palpate.scene, end = ghost.group.position.clone().set(2.1 * ghost.length, 0, 0);"
    )
    shares = set()
    for azimuth in np.arange(0.0, 6.28, 0.8):
        for zoom in (1.0, 0.4):
            goal = f"azimuth: {azimuth}, elevation: {0.2 + 0.1 * azimuth}, distance: {zoom} * o.home.distance"
            tab.evaluate(
                f"{{ const o = palpate.scene.orbitCamera; o.still = true; Object.assign(o.goal, {{ {goal} }}); }}"
            )
            tab.mouse("Moved", x, y - 1, "none")
            tab.mouse("Moved", x, y, "none")
            tab.wait("palpate.scene.ghost.group.visible")
            sleep(0.15)
            seen = "[...palpate.project(ghost.handle.localToWorld(end).toArray()), ghost.handle.scale.x]"
            u, v, share = tab.evaluate(f"{place} return {seen}; }})()")
            width, height = tab.evaluate("[palpate.scene.width, palpate.scene.height]")
            shares.add(share)
            assert share == 0.3 or (0 < u < width and 0 < v < height), (azimuth, zoom)
    assert {1.0} < shares  # whole where there is room, and shorter elsewhere


@pytest.mark.parametrize("by", ["key", "wheel"])
def test_a_tool_is_rolled_by_keys_and_wheel_while_it_hovers_and_presses(opened, synthetic, by):
    tab = opened()
    choose(tab, "scalpel")
    x, y = middle(tab)

    def roll():
        if by == "key":
            for _ in range(4):
                tab.key("]")
        else:
            tab.mouse("Wheel", x, y - 40, "none", deltaX=0, deltaY=-260, modifiers=8)  # with Shift

    def turned(before, after, normal):
        side = np.cross(normal, before)
        return np.arctan2(after @ side, after @ before)

    ghost = "(palpate.scene.graph.updateMatrixWorld(), [...palpate.scene.ghost.group.matrixWorld.elements])"
    tab.mouse("Moved", x, y - 40, "none")
    tab.wait("palpate.scene.ghost.group.visible")
    eye = tab.evaluate("palpate.scene.orbitCamera.goal.distance")
    before = np.array(tab.evaluate(ghost))
    roll()
    draw_frames(tab)
    after = np.array(tab.evaluate(ghost))
    np.testing.assert_allclose(after[8:11], before[8:11], atol=1e-6)  # upright as before
    assert turned(before[:3], after[:3], before[8:11]) == pytest.approx(-0.52, abs=0.02)
    tab.mouse("Pressed", x, y - 40)
    tab.wait("palpate.hands.state(0).kind === 'scalpel'")
    settled_force(tab, 0)
    pressed = _frame(tab)
    assert pressed[0] @ after[:3] > 0.999  # as it hovered
    roll()
    draw_frames(tab)
    along, up = _frame(tab)
    assert turned(pressed[0], along, up) == pytest.approx(-0.52, abs=0.02)
    assert tab.evaluate("palpate.scene.orbitCamera.goal.distance") == eye
    quaternions = [message["quaternion"] for message in told(synthetic, "pose")]
    assert abs(np.dot(quaternions[-1], quaternions[0])) == pytest.approx(np.cos(0.26), abs=0.01)
    tab.mouse("Released", x, y - 40)


def test_two_fingers_on_the_body_are_two_tools(opened, synthetic):
    tab = opened(NARROW, touch_screen=True)
    x, y = middle(tab)
    eye = tab.evaluate("palpate.scene.orbitCamera.goal.distance")
    tab.touch("Start", (x - 40, y))
    tab.touch("Start", (x - 40, y), (x + 40, y))
    tab.touch("Move", (x - 40, y + 15), (x + 40, y + 15))
    tab.wait(f"{FORCE.format(0)} > 0.1 && {FORCE.format(1)} > 0.1")
    assert tab.evaluate("palpate.scene.orbitCamera.goal.distance") == eye
    kinds = {message["index"]: message["kind"] for message in told(synthetic, "tool")}
    assert kinds == {0: "sphere", 1: "sphere"}
    up = "new PointerEvent('pointerup', { pointerId: palpate.controls.presses[1].pointer, pointerType: 'touch' })"
    tab.evaluate(f"document.getElementById('view').dispatchEvent({up})")  # Chromium's own events lift all fingers
    tab.wait(f"{FORCE.format(1)} === 0")
    assert tab.evaluate(FORCE.format(0)) > 0.1
    tab.touch("End")
    tab.wait(f"{FORCE.format(0)} === 0")
    assert tab.evaluate("palpate.statusLine.errors") == []


def test_a_finger_next_to_the_body_makes_a_pinch(opened):
    tab = opened(NARROW, touch_screen=True)
    x, y = middle(tab)
    eye = tab.evaluate("palpate.scene.orbitCamera.goal.distance")
    tab.touch("Start", (x, 30))
    tab.touch("Start", (x, 30), (x, y))
    tab.touch("Move", (x, 10), (x, y + 60))
    tab.touch("End")
    assert tab.evaluate("palpate.scene.orbitCamera.goal.distance") < 0.9 * eye
    assert tab.evaluate("palpate.hands.active") == []


def test_who_watches_sees_all_tools(opened):
    first, second = opened(), opened((640, 480))
    hold_forceps(first)
    choose(first, "sphere")
    x, y = middle(first)
    end = drag(first, (x + 60, y + 30), (0, 20))
    visible = "palpate.scene.tools.map(({ group }) => group.visible).join()"
    second.wait(f"{visible} === 'true,true,false,false'")
    assert second.evaluate("palpate.hands.slots.slice(0, 2).map(({ tool }) => tool.kind)") == ["grasp", "sphere"]
    assert second.evaluate("document.getElementById('hold').hidden")
    assert second.evaluate("document.querySelectorAll('#hands li').length") == 2
    assert second.evaluate("document.querySelectorAll('#hands button, .held-label button').length") == 0
    first.mouse("Released", *end)


def test_a_held_tool_survives_a_reload_of_the_page(opened, synthetic):
    tab = opened()
    place = hold_forceps(tab)
    held = tab.evaluate(FORCE.format(0))
    tab.call("Page.reload")
    tab.wait("window.palpate?.ready && palpate.driver && palpate.hands.held.length === 1", 60)
    assert tab.evaluate("palpate.hands.inHand") == 1
    end = drag(tab, place, (-40, 0))
    tab.wait(f"palpate.hands.inHand === 0 && {FORCE.format(0)} > {held} + 0.3")
    tab.mouse("Released", *end)
    tab.wait("palpate.hands.held.length === 1")


def test_a_replay_shows_all_tools(browser):
    with SyntheticHands(PAGE, mode="replay", duration=4.0, tools=[], driver=False) as replay:
        replay.hands[0] = {**replay.hands[0], "kind": "grasp", "pinned": True}
        replay.hands[1] = {**replay.hands[1], "kind": "sphere", "radius": 0.01}
        replay.poses = [{"position": [-0.04, 0, 0.03], "quaternion": [1, 0, 0, 0]},
                        {"position": [0.03, -0.04, 0.03], "quaternion": [1, 0, 0, 0]}, None, None]  # fmt: skip
        replay.places = [np.array([-0.03, 0, 0.03])] * 4
        tab = browser.open(replay.address, 1024, 640)
        tab.wait("window.palpate?.ready", 60)
        tab.wait("palpate.scene.tools.map(({ group }) => group.visible).join() === 'true,true,false,false'")
        assert tab.evaluate("document.getElementById('tools').hidden")
        tab.wait("document.querySelectorAll('.held-label').length === 1")
        assert not tab.errors
        tab.close()


def test_a_server_of_one_tool_is_offered_nothing_more(browser):
    with SyntheticSession(PAGE) as session, opening(browser) as open_tab:
        tab = open_tab(session.address)
        assert tab.evaluate("palpate.hands.max") == 1
        assert tab.evaluate("document.getElementById('hold').hidden && document.getElementById('hands').hidden")
        x, y = middle(tab)
        end = drag(tab, (x, y), (0, 20))
        tab.wait("palpate.force > 0.3")
        tab.key("h")
        tab.mouse("Released", *end)
        tab.wait("palpate.force === 0")
        assert not told(session, "pin")
        assert not [message for message in session.received if "index" in message]
