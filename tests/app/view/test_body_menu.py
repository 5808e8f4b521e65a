"""The menu of a body: laws of the same stiffness, and reduced models next to the full body, whose end forceps hold."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from palpate.app.common.console import Console
from palpate.app.models.trained import compared_file, compared_modes
from palpate.app.session.comparison import Comparison
from palpate.app.session.messages import validate_message
from palpate.app.session.session import Session, latest
from palpate.app.view import body_menu
from palpate.app.view.body_menu import BodyMenu, has_menu, offers_modes
from palpate.core.faults import InputError
from palpate.scenes.open_scene import open_scene

sys.path.append(str(Path(__file__).parent))

from pulled_bar import BAR, END, Trainer

pytestmark = pytest.mark.slow

AWAY = 0.004  # [m] by which the end is pulled
COMPILE_SECONDS = 300.0  # in which a law is compiled on a busy machine


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "bar.toml").write_text(BAR)
    return open_scene(tmp_path / "bar.toml")


@pytest.fixture
def shown(scene):
    """The session of the full bar, and its menu."""
    session = Session(scene.body, "Bar", end=scene.held_group)
    session.start()
    menu = BodyMenu(scene, session, Console(), Trainer)
    yield session, menu
    menu.close()


@pytest.fixture
def choose(shown):
    """A function that chooses in the menu, and returns the session that is shown next."""
    menu = shown[1]

    def made(law="MooneyRivlin", modes=0, second=""):
        menu.handle(validate_message({"type": "body", "law": law, "modes": modes, "second": second}))
        end = time.monotonic() + COMPILE_SECONDS
        while (source := menu.next_source()) is None:
            assert menu.message()["state"] == "preparing", menu.message()["note"]
            assert time.monotonic() < end, menu.message()["phase"]
            time.sleep(0.02)
        return source

    return made


def pull(session, until, way=AWAY):
    """Hold the end with forceps, pull it, and wait until it is there and at rest."""
    place = [END, 0.012, 0.011]
    session.handle(validate_message({"type": "tool", "kind": "grasp", "radius": 0.008, "position": place}))
    to = [END + way, *place[1:]]
    session.handle(validate_message({"type": "pose", "position": to, "sequence": 1}))
    until(lambda: abs(moved(session)[0] - way) < 1e-5 and session.snapshot().kinetic < 1e-9)
    return to


def moved(session):
    """The mean displacement (3,) [m] of the end."""
    displacements = session.snapshot().displacements(session.surface)[session.hello()["end"]]
    return displacements.mean(axis=0)


def test_forceps_at_the_end_hold_all_of_it_and_those_elsewhere_do_not(shown, until):
    session, _ = shown
    assert session.tool_kinds[0] == "grasp"
    pull(session, until)
    displacements = session.snapshot().displacements(session.surface)
    end = session.hello()["end"]
    np.testing.assert_allclose(displacements[end], np.tile([AWAY, 0, 0], (len(end), 1)), atol=2e-5)
    second = np.setdiff1d(np.arange(len(displacements)), end)
    assert displacements[second, 0].max() < 0.95 * AWAY  # as a bar that is stretched
    assert session.status()["end_tools"] == [0]
    session.release()
    middle = {"type": "tool", "kind": "grasp", "radius": 0.008, "position": [0.03, 0.01, 0.02]}
    session.handle(validate_message(middle))
    assert session.status()["end_tools"] == []


def test_another_law_keeps_the_shape_and_the_tools_and_has_another_force(shown, choose, until):
    session, menu = shown
    to = pull(session, until, 0.02)  # a third of its length
    session.handle(validate_message({"type": "pin", "pinned": True}))
    before = session.snapshot()
    other = choose("NeoHookean")
    first = other.snapshot()
    assert session.engine.state == "stopped"
    assert menu.message()["law"] == "NeoHookean"
    np.testing.assert_allclose(first.coordinates, before.coordinates, atol=5e-4)  # it already moves
    until(lambda: other.snapshot().steps > 200 and other.snapshot().kinetic < 1e-9)
    tool, was = other.snapshot().tools[0], before.tools[0]
    assert tool.pinned
    assert tool.kind == "grasp"
    assert other.status()["end_tools"] == [0]
    np.testing.assert_allclose(tool.position, to, atol=1e-6)
    np.testing.assert_allclose(moved(other), [0.02, 0, 0], atol=2e-5)
    assert abs(tool.force[0] - was.force[0]) > 0.02 * abs(was.force[0])
    modulus = other.model.material.shear_modulus
    assert modulus == pytest.approx(session.model.material.shear_modulus, rel=1e-12)


def test_a_body_that_a_ball_touches_begins_at_rest_with_another_law(shown, choose):
    session, _ = shown
    above = {"type": "tool", "kind": "sphere", "radius": 0.01, "position": [0.03, 0.01, 0.04]}
    session.handle(validate_message(above))
    other = choose("NeoHookean")
    assert other.snapshot().tools[0].kind == "none"
    assert other.tools[0].selected.kind == "sphere"
    np.testing.assert_allclose(other.snapshot().coordinates, 0.0, atol=1e-6)


def test_a_reduced_model_and_its_full_body_have_the_same_end_and_nearly_the_same_force(scene, choose, shown, until):
    _, menu = shown
    modes = compared_modes(scene)
    assert menu.message()["modes"] == [0, *modes]
    assert not menu.message()["trained"]
    both = choose(modes=modes[-1])
    assert isinstance(both, Comparison)
    assert both.model.data.modes == modes[-1]
    assert both.tool_kinds == []
    assert menu.message()["trained"]
    assert compared_file(scene, modes[0]).is_file()
    centre = both.status()["tool"]["position"]
    np.testing.assert_allclose(centre, [END, 0.01, 0.01], atol=1e-9)
    pose = {"type": "pose", "position": [END + AWAY, 0.01, 0.01], "sequence": 1}
    both.handle(validate_message(pose))
    until(lambda: all(abs(moved(each)[0] - AWAY) < 1e-5 and each.snapshot().kinetic < 1e-9 for each in both.sessions))
    reduced, full = (each.snapshot().tools[0].force for each in (both, both.second))
    assert reduced[0] == pytest.approx(full[0], rel=0.05)
    assert full[0] < -0.1
    both.reset()
    until(lambda: all(np.abs(moved(each)).max() < 1e-6 for each in both.sessions))
    alone = choose()
    assert not isinstance(alone, Comparison)
    assert alone.model.cloud is scene.body.cloud


def test_two_laws_are_pulled_side_by_side(choose, until):
    both = choose(second="NeoHookean")
    assert isinstance(both, Comparison)
    assert both.hello()["compared"] == ["MooneyRivlin", "NeoHookean"]
    both.handle(validate_message({"type": "pose", "position": [END + 0.02, 0.01, 0.01], "sequence": 1}))
    until(lambda: all(abs(moved(each)[0] - 0.02) < 1e-5 and each.snapshot().kinetic < 1e-9 for each in both.sessions))
    first, second = (abs(each.snapshot().tools[0].force[0]) for each in both.sessions)
    assert abs(first - second) > 0.02 * first
    np.testing.assert_allclose(both.overlay(0.0).force, both.second.snapshot().tools[0].force)


@pytest.mark.quick
def test_choices_that_a_body_does_not_have_are_refused(scene):
    session = Session(scene.body, "Bar", end=scene.held_group)
    menu = BodyMenu(scene, session, Console(), Trainer)
    for choice, reason in (
        ({"law": "Hooke"}, "law must be one of"),
        ({"law": "Ogden", "modes": 5}, "modes must be one of"),
        ({"law": "Ogden", "second": "Hooke"}, "second must be one of"),
        ({"law": "Ogden", "second": "Ogden"}, "second must be another law"),
        ({"law": "Ogden", "modes": 4, "second": "Gent"}, "second must be empty"),
    ):
        with pytest.raises(InputError, match=reason):
            menu.handle(validate_message({"type": "body", **choice}))
    assert menu.message()["state"] == "ready"
    assert menu.next_source() is None
    menu.close()


def test_a_training_that_fails_leaves_the_body_and_says_why(scene, until):
    class Failing(Trainer):
        def events(self):
            yield {"failed": "the disk is full"}

    session = Session(scene.body, "Bar", end=scene.held_group)
    menu = BodyMenu(scene, session, Console(), Failing)
    menu.handle(validate_message({"type": "body", "law": "MooneyRivlin", "modes": 4}))
    until(lambda: menu.message()["state"] == "failed")
    assert menu.message()["note"] == "the disk is full"
    assert menu.next_source() is None
    menu.handle(validate_message({"type": "body", "law": "MooneyRivlin", "modes": 0}))  # it may be tried again
    until(menu.next_source)
    menu.close()


def made(menu, until, **choice):
    """Choose in the menu, and wait until the body is made."""
    menu.handle(validate_message({"type": "body", "law": "MooneyRivlin", **choice}))
    until(lambda: menu._next is not None)


def test_a_body_that_cannot_start_leaves_the_former_one_running(shown, until, monkeypatch):
    session, menu = shown

    def fail(*_):
        raise OSError("no thread is left")

    made(menu, until)
    with monkeypatch.context() as patch:
        patch.setattr(Session, "_take_settings", fail)
        assert menu.next_source() is None
    assert menu.next_source() is None
    assert (menu.message()["state"], menu.message()["note"]) == ("failed", "no thread is left")
    assert session.engine.state == "running"
    assert latest(session) is session
    made(menu, until)  # it may be tried again
    assert menu.next_source() is latest(session) is not session


def test_a_recording_ends_with_its_body_and_the_menu_says_so(shown, until, tmp_path):
    session, menu = shown
    session.recordings.start(tmp_path / "first.h5")
    made(menu, until)
    other = menu.next_source()
    assert menu.message()["note"] == "The recording ended with the former body."
    assert not other.recordings.is_active
    made(menu, until)
    menu.next_source()
    assert menu.message()["note"] == ""
    until(lambda: other.notifications)
    assert other.notifications[0]["file"] == str(tmp_path / "first.h5")


def test_no_training_begins_after_the_page_was_closed(scene, monkeypatch):
    trained, looked, closed = [], threading.Event(), threading.Event()
    menu = BodyMenu(scene, Session(scene.body, "Bar", end=scene.held_group), Console(), trained.append)

    def look(*given):
        looked.set()
        closed.wait(COMPILE_SECONDS)
        return compared_file(*given)

    monkeypatch.setattr(body_menu, "compared_file", look)
    monkeypatch.setattr(body_menu, "JOIN_SECONDS", 0.0)
    menu.handle(validate_message({"type": "body", "law": "MooneyRivlin", "modes": 4}))
    assert looked.wait(COMPILE_SECONDS)
    menu.close()
    closed.set()
    menu._thread.join()
    assert not trained
    assert menu.message()["note"] == "the page has ended"


def test_a_body_that_was_made_and_not_shown_is_closed(scene, until, monkeypatch):
    session, closed = Session(scene.body, "Bar", end=scene.held_group), []
    menu = BodyMenu(scene, session, Console(), Trainer)
    made(menu, until)
    (unseen, _), close = menu._next, Session.close
    monkeypatch.setattr(Session, "close", lambda each: (closed.append(each), close(each)))
    menu.close()
    assert closed == [unseen, session]


def test_springs_hold_both_laws(tmp_path, until):
    springs = '[[support]]\nname = "bed"\nkind = "springs"\nplace = { side = "z-" }\nstiffness = 1e5\n'
    (tmp_path / "bar.toml").write_text(BAR + springs)
    scene = open_scene(tmp_path / "bar.toml")
    menu = BodyMenu(scene, Session(scene.body, "Bar", end=scene.held_group), Console(), Trainer)
    made(menu, until, second="NeoHookean")
    both = menu._next[0]
    assert all(len(each.body.realtime.data.body.sites.foundation_node) for each in both.sessions)
    menu.close()


@pytest.mark.quick
def test_a_surface_has_no_modes_whose_training_has_other_nodes(scene, tmp_path):
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 0.06) for y in (0, 0.02) for z in (0, 0.02))
    faces = ("1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2", "3 4 8", "3 8 7", "1 3 7", "1 7 5", "2 6 8", "2 8 4")
    (tmp_path / "organ.obj").write_text(corners + "".join(f"f {face}\n" for face in faces))
    box = 'generated = "box"\nsize = [0.06, 0.02, 0.02]\n'
    organ = BAR.replace(box, 'file = "organ.obj"\nunits = "m"\n').replace('{ group = "x-" }', '{ side = "x-" }')
    organ = organ.replace('holds = "x+"', 'holds = "end"') + '[[support]]\nname = "end"\nplace = { side = "x+" }\n'
    (tmp_path / "organ.toml").write_text(organ)
    surface = open_scene(tmp_path / "organ.toml")
    session = Session(scene.body, "Bar", end=scene.held_group)
    assert offers_modes(scene, session)
    assert not offers_modes(scene, Session(scene.body, "Bar"))
    assert not offers_modes(surface, session)
    menu = BodyMenu(surface, session, Console(), Trainer)
    assert menu.message()["modes"] == []
    with pytest.raises(InputError, match="modes must be one of 0 for this body"):
        menu.handle(validate_message({"type": "body", "law": "MooneyRivlin", "modes": 4}))
    menu.close()


@pytest.mark.quick
@pytest.mark.parametrize(
    ("changed", "offered"),
    [
        ("", True),
        ('[[region]]\nplace = { side = "z+" }\nparameters = { C1 = 2e3 }\n', False),
        ('[[load]]\nkind = "gravity"\nacceleration = [0, 0, -9.81]\ntimes = [0, 1]\nfactors = [1, 1]\n', True),
    ],
)
def test_a_body_of_one_tissue_has_the_menu(tmp_path, changed, offered):
    (tmp_path / "bar.toml").write_text(BAR + changed)
    assert has_menu(open_scene(tmp_path / "bar.toml")) is offered
