"""A person pulls the end of a bar on its page in a real browser, changes the law, and compares a reduced model."""

from __future__ import annotations

import sys
from pathlib import Path
from time import sleep

import pytest

sys.path.append(str(Path(__file__).parent))

from browser_input import NARROW, WIDE, needs_chromium, opening
from pulled_bar import BAR, Trainer

from palpate.app.common.console import Console
from palpate.app.session.session import Session
from palpate.app.view.body_menu import BodyMenu
from palpate.scenes.open_scene import open_scene

pytestmark = [pytest.mark.slow, needs_chromium]

# a place of the end [px] on the face that is seen, and a reading of the page
END_PLACE = """(() => {
  const box = document.getElementById("view").getBoundingClientRect(), { rest, positions } = palpate.scene.body;
  const chosen = palpate.session.hello.end.filter((i) => rest[3 * i + 2] > 0.019);
  const mean = [0, 1, 2].map((k) => chosen.reduce((sum, i) => sum + positions[3 * i + k], 0) / chosen.length);
  const [x, y] = palpate.project([mean[0] - 0.002, mean[1], mean[2]]);
  return [box.x + x, box.y + y];
})()"""
READ = "document.getElementById('{}').textContent"
VISIBLE = "document.getElementById('{}').checkVisibility()"


@pytest.fixture
def pulled(browser, site_of, tmp_path):
    """A function that opens the page of a bar in a window of a size [px]."""
    (tmp_path / "bar.toml").write_text(BAR)
    scene = open_scene(tmp_path / "bar.toml")
    session = Session(scene.body, "Bar", end=scene.held_group)
    session.start()
    menu = BodyMenu(scene, session, Console(), Trainer)
    site = site_of(session)
    site.loop.call_soon_threadsafe(site.server.show, session, {"body": menu})
    with opening(browser) as open_tab:
        yield lambda size, **options: open_tab(site.address, size, **options)
    menu.close()


def drag(tab, way):
    """Hold on the end and drag by pixels (2,); returns where the pointer is."""
    x, y = tab.evaluate(END_PLACE)
    tab.mouse("Moved", x, y, "none")
    tab.mouse("Pressed", x, y)
    for k in range(1, 7):
        tab.mouse("Moved", x + way[0] * k / 6, y + way[1] * k / 6)
        sleep(0.03)
    return x + way[0], y + way[1]


def number(tab, name):
    return float(tab.evaluate(READ.format(name)))


def test_the_end_is_pulled_and_its_force_and_displacement_are_read(pulled):
    tab = pulled(WIDE)
    assert tab.evaluate("palpate.hands.tool.kind") == "grasp"
    assert tab.evaluate(READ.format("task")) == "Pull the end of the bar: hold the button on its free end and drag."
    end = drag(tab, (40, 10))
    tab.wait("Number(document.getElementById('end-moved').textContent) > 1")
    tab.wait("Number(document.getElementById('end-force').textContent) > 0.05")
    for name in ("task", "end-moved", "end-force", "force"):
        assert tab.evaluate(VISIBLE.format(name))
    assert tab.evaluate(READ.format("end")).replace("  ", " ").count(" mm") == 1
    tab.wait(f"{READ.format('force')} === {READ.format('end-force')}")  # the forceps pull the end
    tab.mouse("Released", *end)
    tab.wait("Number(document.getElementById('end-moved').textContent) < 0.1 && palpate.force === 0")
    assert tab.evaluate(READ.format("end-force")) == "0"


def test_a_law_is_chosen_and_the_held_end_stays(pulled):
    tab = pulled(WIDE)
    end = drag(tab, (60, 10))
    tab.wait("Number(document.getElementById('end-moved').textContent) > 2")
    tab.evaluate("document.getElementById('hold').click()")
    tab.mouse("Released", *end)
    tab.wait("palpate.hands.held.length === 1 && palpate.session.state.kinetic < 1e-8")
    moved, force = number(tab, "end-moved"), number(tab, "end-force")
    tab.evaluate(
        "(e => { e.value = 'NeoHookean'; e.dispatchEvent(new Event('change')); })(document.getElementById('law'))"
    )
    tab.wait("/^(Compiling|Making|Preparing)/.test(document.getElementById('body-text').textContent)")
    tab.wait("!document.getElementById('law').disabled && document.getElementById('body-text').textContent === ''", 300)
    assert tab.evaluate("document.getElementById('law').value") == "NeoHookean"
    assert "as before" in tab.evaluate(READ.format("law-text"))
    tab.wait("palpate.hands.held.length === 1 && palpate.session.state.steps > 300")
    assert number(tab, "end-moved") == pytest.approx(moved, abs=0.11)
    tab.wait(f"Math.abs(Number({READ.format('end-force')}) - {force}) < 0.3 * {force}")
    assert tab.evaluate("palpate.statusLine.errors") == []


@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_a_reduced_model_is_compared_with_the_full_bar(pulled, size):
    tab = pulled(size)
    assert "train" in tab.evaluate(READ.format("modes-text"))
    tab.evaluate("document.querySelector('#modes [value=\"4\"]').click()")
    tab.wait("palpate.session.hello.compare && palpate.scene.overlay.lines.visible", 300)
    assert tab.evaluate(READ.format("modes-text")) == ""
    assert "drag anywhere" in tab.evaluate(READ.format("task"))
    end = drag(tab, (30, 10))
    tab.wait("/^reduced 0[.]\\d+ N, full 0[.]\\d+ N/.test(document.getElementById('force-comparison').textContent)")
    tab.wait("Number(document.getElementById('end-moved').textContent) > 0.5")
    assert tab.evaluate("palpate.scene.tools[0].group.visible")  # the forceps are drawn
    tab.mouse("Released", *end)
    tab.evaluate("document.querySelector('#modes [value=\"0\"]').click()")
    tab.wait("!palpate.session.hello.compare && palpate.hands.tool.kind === 'grasp'", 60)
    assert tab.evaluate("palpate.statusLine.errors") == []


def test_help_lists_what_the_page_has(pulled):
    tab = pulled(WIDE)
    shown = "[...document.querySelectorAll('#help dl > div > *')].filter(e => e.checkVisibility())"
    rows = f"{shown}.map(e => e.innerText.replaceAll('\\n', ''))"
    tab.evaluate("document.getElementById('help-open').click()")
    full = tab.evaluate(rows)
    assert {"Press", "Pull", "Cut", "Touch", "F"} <= set(full)
    assert {"1234", "Forceps, Sphere, Capsule, Scalpel", "Two hands"} <= set(full)
    assert not any("surroundings" in row or row == "Name" for row in full)
    tab.evaluate("document.getElementById('help').close()")
    tab.evaluate("document.querySelector('#modes [value=\"4\"]').click()")
    tab.wait("palpate.session.hello.compare", 300)
    tab.evaluate("document.getElementById('help-open').click()")
    held = tab.evaluate(rows)
    assert not {"Press", "Cut", "Two hands", "H", "+\u2212"} & set(held)
    assert "Pull" in held
    assert any("the end follows" in row for row in held)
