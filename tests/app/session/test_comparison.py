"""A reduced model and its full body under the same tool."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1]))

from view_scenes import BALL, MIDDLE, block

import palpate as pt
from palpate.app.session.comparison import Comparison
from palpate.app.session.full_model_replay import full_model
from palpate.app.session.messages import validate_message
from palpate.app.session.session import MAX_TOOL_SPEED, Session
from palpate.core.faults import InputError


@pytest.fixture(scope="module")
def comparison_of(model):
    """The session, made once, because its engines are compiled; each test gets it at rest."""
    made = Comparison(model, full_model(model, "view_scenes:block"), "Block")
    made.start()
    yield made
    made.close()


@pytest.fixture
def comparison(comparison_of):
    comparison_of.reset()
    comparison_of.resume()
    return comparison_of


def press(comparison, ball, until, depth=0.003):
    """Put the ball down and press, until both bodies feel it and rest."""
    comparison.handle(validate_message({**ball, "stiffness": 100.0}))
    place = [*MIDDLE[:2], MIDDLE[2] + BALL - depth]
    comparison.handle(validate_message({"type": "pose", "position": place, "sequence": 1}))

    def resting():
        full = comparison.second.snapshot()
        reduced = comparison.snapshot()
        kinetic = max(reduced.kinetic / max(reduced.strain, 1e-30), full.kinetic / max(full.strain, 1e-30))
        return kinetic < 1e-4 and min(reduced.tools[0].force[2], full.tools[0].force[2]) > 0.05

    until(resting)


def test_both_bodies_have_the_tool_and_nearly_the_same_force(comparison, ball, until):
    press(comparison, ball, until)
    own, full = comparison.snapshot().tools[0], comparison.second.snapshot().tools[0]
    np.testing.assert_allclose(own.position, full.position, atol=1e-9)  # whatever spring was asked for
    assert own.force[2] == pytest.approx(full.force[2], rel=0.3)
    assert not np.allclose(own.force, full.force, rtol=1e-6)  # not the same body twice


def test_the_overlay_is_the_full_body(comparison, ball, until):
    press(comparison, ball, until)
    comparison.pause()
    drawn, snapshot = comparison.overlay(0.0), comparison.second.snapshot()
    surface = comparison.second.surface
    np.testing.assert_array_equal(drawn.positions, surface.rest + snapshot.displacements(surface))
    np.testing.assert_array_equal(drawn.force, snapshot.tools[0].force)
    assert np.abs(drawn.positions - surface.rest).max() > 1e-3
    hello = comparison.hello()
    assert hello["overlay"]
    assert hello["compare"]


def test_both_tools_are_as_slow_as_in_training_unless_the_user_asks(comparison):
    speeds = []
    for fast in (False, True, False):
        comparison.handle(validate_message({"type": "follow", "fast": fast}))
        assert comparison.second.tool_speed == comparison.tool_speed
        speeds.append(comparison.tool_speed)
    assert speeds == [comparison.hello()["tool_speed"], MAX_TOOL_SPEED, comparison.hello()["tool_speed"]]


def test_a_release_a_reset_and_a_pause_hold_for_both(comparison, ball, until):
    press(comparison, ball, until)
    comparison.handle(validate_message({"type": "release"}))
    until(
        lambda: not comparison.snapshot().tools[0].force.any() and not comparison.second.snapshot().tools[0].force.any()
    )
    comparison.handle(validate_message({"type": "control", "action": "pause"}))
    assert (comparison.engine.state, comparison.second.engine.state) == ("paused", "paused")
    comparison.handle(validate_message({"type": "control", "action": "resume"}))
    comparison.handle(validate_message({"type": "material", "name": "shear modulus", "value": 10.0}))
    assert comparison.second.modulus_ratio == comparison.modulus_ratio != 1
    comparison.handle(validate_message({"type": "material", "name": "shear modulus", "value": 8.0}))
    comparison.handle(validate_message({"type": "speed", "factor": 0.5}))
    assert comparison.second.speed == comparison.speed == 0.5
    comparison.handle(validate_message({"type": "speed", "factor": 1.0}))
    comparison.handle(validate_message({"type": "control", "action": "reset"}))
    assert not comparison.second.snapshot().coordinates.any()
    assert comparison.second.tools[0].active.kind == comparison.tools[0].active.kind == "none"


def test_tools_that_one_body_refuses_are_refused(comparison, ball):
    assert comparison.tool_kinds == ["sphere", "capsule"]
    grasp = {"type": "tool", "kind": "grasp", "position": MIDDLE.tolist()}
    with pytest.raises(InputError, match="kind must be one of 'sphere', 'capsule' in a comparison, got 'grasp'"):
        comparison.handle(validate_message(grasp))
    with pytest.raises(InputError, match="radius of the tool must be at least the spacing"):
        comparison.handle(validate_message({**ball, "radius": 0.002}))
    assert comparison.second.tools[0].active.kind == comparison.tools[0].active.kind == "none"


@pytest.mark.parametrize("paces", [(1.0, 0.4), (0.4, 1.0)])
def test_the_pace_is_that_of_the_slower_body(comparison, paces, monkeypatch):
    pace_of = dict(zip((comparison, comparison.second), paces, strict=True))
    monkeypatch.setattr(Session, "statistics", lambda session: {"pace": pace_of[session]})
    assert comparison.statistics()["pace"] == 0.4


def test_springs_hold_both_bodies(model):
    springs = (pt.Foundation("z+", 1e5),)
    free, held = (Comparison(model, block().model, "Block", foundations=given) for given in ((), springs))
    assert springs_of(free) == (0, 0)
    assert min(springs_of(held)) > 0


def springs_of(comparison):
    """The sizes of the springs of the reduced model and of the full body."""
    first, second = (each.body.realtime.data for each in (comparison, comparison.second))
    return first.body.springs.stiffness.size, len(second.body.sites.foundation_node)


def test_a_model_without_a_scene_names_no_full_model(model):
    with pytest.raises(InputError, match="names in a file are not imported or opened: add --scene"):
        full_model(model)
    with pytest.raises(InputError, match="scene must be 'view_scenes:block'"):
        full_model(model, "os:system")


def test_another_body_is_not_compared(model):
    with pytest.raises(InputError, match="a solid that a tool touches"):
        Comparison(model, model, "Block")
