"""A scalpel in a session: the body is cut in the engine, drawn open, recorded, replayed, and whole after a reset."""

from __future__ import annotations

import time

import numpy as np
import pytest

import palpate as pt
from palpate.app.recordings.recording import load_recording
from palpate.app.session.messages import validate_message
from palpate.app.session.replay import Replay
from palpate.app.session.session import Session

SIZE = (0.05, 0.04, 0.025)
TOUGHNESS = 5.0
pytestmark = pytest.mark.slow


def send(session, **message):
    session.handle(validate_message(message))


def lower(session, area, height=0.04, deadline=60.0, depth=0.012):
    """Lower the scalpel into the body until it has cut an area [m^2]; return the cutter and the scalpel's height."""
    cutter, end, sequence = session.body.cutter, time.monotonic() + deadline, int(1e4 * (0.04 - height))
    while cutter.totals[0] < area and time.monotonic() < end:
        height = max(height - 2e-4, SIZE[2] - depth)
        sequence += 1
        send(session, type="pose", position=[0.025, 0.02, height], sequence=sequence)
        time.sleep(0.01)
    return cutter, height


@pytest.fixture(scope="module")
def cut_session(tmp_path_factory):
    tissue = pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45)
    body = pt.Solid(pt.box(SIZE, 5e-3, jitter=0.2), tissue, fixed="z-")
    session = Session(body, "Block")
    path = tmp_path_factory.mktemp("cut") / "session.h5"
    session.start()
    send(session, type="tool", kind="scalpel", length=0.03, toughness=TOUGHNESS, position=[0.025, 0.02, 0.045])
    session.recordings.start(path)
    cutter, height = lower(session, 5e-5)
    entered = cutter.totals
    lower(session, 1.5e-4, height)
    time.sleep(0.3)
    shown = session.shown_surface
    session.recordings.finish(wait=True)
    yield session, cutter, shown, path, entered
    session.close()


def test_a_full_body_offers_a_scalpel(cut_session):
    assert cut_session[0].tool_kinds == ["sphere", "capsule", "grasp", "scalpel"]


def test_the_scalpel_cuts_the_body_and_costs_work(cut_session):
    session, cutter, _, _, entered = cut_session
    area, released, edge, friction = cutter.totals - entered  # an edge that enters cuts without a force at first
    assert not cutter.failure
    assert area > 8e-5
    assert edge + released == pytest.approx(TOUGHNESS * area, rel=0.35)  # it moves on while the body is cut
    assert friction == 0.0
    assert session.engine.state == "running"
    assert cutter.model.cut_state.touched.any()


def test_the_statistics_state_what_is_cut_and_the_force_that_cuts(cut_session):
    session, cutter, _, _, _ = cut_session
    statistics = session.statistics()
    assert statistics["cut_area"] == pytest.approx(cutter.totals[0], rel=0.05)
    length = 0.03
    assert 0.2 * TOUGHNESS * length < statistics["cutting_force"] < 1.3 * TOUGHNESS * length


def test_the_cut_body_is_drawn_open_with_both_faces(cut_session):
    session, cutter, shown, _, _ = cut_session
    assert len(shown.rest) > len(session.surface.rest)
    assert shown.triangles.max() < len(shown.rest)
    coordinates = session.engine.read().coordinates
    moved = shown.displacements(
        coordinates, np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros(0, dtype=bool), np.zeros(0, dtype=int)
    )
    assert np.isfinite(moved).all()
    translated = np.tile([0.01, 0.0, 0.0], len(cutter.model.cloud))
    moved = shown.displacements(
        translated, np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros(0, dtype=bool), np.zeros(0, dtype=int)
    )
    np.testing.assert_allclose(moved, np.broadcast_to([0.01, 0, 0], moved.shape), atol=1e-6)
    scalar = shown.scalar("stress", translated, moved)
    assert scalar.shape == (len(shown.rest),)


def test_a_recording_holds_the_cut_and_its_replay_shows_it(cut_session):
    recording = load_recording(cut_session[3])
    assert recording.cuts
    assert recording.tool_at(len(recording.snapshots) - 1)["toughness"] == TOUGHNESS
    replay = Replay(recording)
    replay.pause()
    replay._seek(0.0)
    whole = len(replay.shown_surface.rest)
    replay._seek(replay.duration)
    assert len(replay.shown_surface.rest) > whole == len(replay.surface.rest)


def test_a_reset_restores_the_whole_body(cut_session):
    session, cutter, _, _, _ = cut_session
    session.reset()
    time.sleep(0.1)
    assert session.shown_surface is session.surface
    assert cutter.model is cutter.whole_model
    assert session.engine.state == "running"
    assert not np.any(session.engine.read().force)


def test_the_engine_of_a_body_with_planes_of_symmetry_refuses_a_blade():
    tissue = pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45)
    body = pt.Solid(pt.box(SIZE, 5e-3), tissue, fixed=["z-", pt.SymmetryPlane("x-")])
    blade = pt.tools.Contact(pt.tools.Blade([(-0.01, 0, 0), (0.01, 0, 0)], TOUGHNESS), (0.02, 0.02, 0.05))
    with pytest.raises(pt.InputError, match="planes of symmetry"):
        pt.realtime_model(body, contact=blade)
