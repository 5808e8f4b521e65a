"""A scalpel in a session: the body is cut in the engine, drawn open, recorded, replayed, and whole after a reset."""

from __future__ import annotations

import time
from copy import copy

import numpy as np
import pytest

import palpate as pt
from palpate.app.recordings.recording import load_recording
from palpate.app.session.messages import validate_message
from palpate.app.session.replay import Replay
from palpate.app.session.session import Session
from palpate.app.view import film
from palpate.app.view.server.frames import FRAME_HEADER, cut_geometry_frame

SIZE = (0.05, 0.04, 0.025)
TOUGHNESS = 5.0
pytestmark = pytest.mark.slow


def send(session, **message):
    session.handle(validate_message(message))


def lower(session, area, height=0.04, deadline=60.0, depth=0.012, place=(0.025, 0.02)):
    """Lower the scalpel into the body until it has cut an area [m^2]; return the cutter and the scalpel's height."""
    cutter, end, sequence = session.body.cutter, time.monotonic() + deadline, int(1e4 * (0.04 - height))
    while cutter.totals[0] < area and time.monotonic() < end:
        height = max(height - 2e-4, SIZE[2] - depth)
        sequence += 1
        send(session, type="pose", position=[*place, height], sequence=sequence)
        time.sleep(0.01)
    return cutter, height


def drawn(session, deadline=30.0):
    """Wait until the body is drawn as it is cut now, and return its surface."""
    end = time.monotonic() + deadline
    while session.shown_surface.model is not session.body.cutter.model and time.monotonic() < end:
        time.sleep(0.02)
    assert session.shown_surface.model is session.body.cutter.model
    return session.shown_surface


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
    shown = drawn(session)
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
    # it moves on while the body is cut, on a busy machine by up to half a spacing that costs nothing
    assert 0.4 * TOUGHNESS * area < edge + released < 1.35 * TOUGHNESS * area
    assert friction == 0.0
    assert session.engine.state == "running"
    assert cutter.model.cut_state.touched.any()


def test_the_statistics_state_what_is_cut_and_the_force_that_cuts(cut_session):
    session, cutter, _, _, _ = cut_session
    drawn(session)
    statistics = session.statistics()
    assert statistics["cut_area"] == pytest.approx(cutter.totals[0], rel=0.05)
    depth = statistics["cut_depth"]
    assert 4e-3 < depth < SIZE[2] - 0.005
    belly = (0.03 / 0.97) * np.sqrt(1.0 - (1.0 - 2 * depth / 0.03) ** 2)  # of an edge at its ends, so deep
    assert statistics["cut_length"] == pytest.approx(belly, rel=0.1)
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


def test_the_line_of_the_cut_is_drawn_on_the_surface(cut_session):
    shown = cut_session[2]
    corners, ends = shown.cut_line
    shares = np.concatenate([1.0 - ends.reshape(-1, 2, 2).sum(axis=2, keepdims=True), ends.reshape(-1, 2, 2)], axis=2)
    assert shares.min() > -1e-6
    places = np.einsum("lek,lkc->lec", shares, shown.rest[corners])
    step, along = 1e-5, np.sort(places[..., 0], axis=1)  # the blade is along x
    is_drawn = np.array([np.any((along[:, 0] <= x) & (x < along[:, 1])) for x in np.arange(0.0, SIZE[0], step)])
    assert is_drawn.sum() * step == pytest.approx(shown.cut_measures.length, rel=0.01)
    np.testing.assert_allclose(places[..., 2], SIZE[2], atol=1e-6)
    drawn_triangles = {tuple(corner) for corner in shown.triangles.tolist()}
    assert {tuple(corner) for corner in corners.tolist()} <= drawn_triangles


def test_the_frame_of_a_cut_holds_its_line_behind_the_mesh(cut_session):
    shown = cut_session[2]
    frame = cut_geometry_frame(shown)
    kind, pieces, vertices, triangles = FRAME_HEADER.unpack_from(frame)
    assert (kind, pieces, vertices, triangles) == (
        6,
        len(shown.cut_line.corners),
        len(shown.rest),
        len(shown.triangles),
    )
    start = FRAME_HEADER.size + 12 * vertices + 12 * triangles + vertices
    start += -start % 4
    assert len(frame) == start + 28 * pieces
    np.testing.assert_array_equal(np.frombuffer(frame, "<u4", 3 * pieces, start), shown.cut_line.corners.ravel())
    ends = np.frombuffer(frame, "<f4", 4 * pieces, start + 12 * pieces)
    np.testing.assert_array_equal(ends, shown.cut_line.ends.ravel())


def test_a_recording_holds_the_cut_and_its_replay_shows_it(cut_session):
    recording = load_recording(cut_session[3])
    assert recording.cuts
    assert recording.tool_at(len(recording.snapshots) - 1)["toughness"] == TOUGHNESS
    replay = Replay(recording)
    replay.pause()
    replay._seek(0.0)
    whole = len(replay.shown_surface.rest)
    assert "cut_area" not in replay.statistics()
    replay._seek(replay.duration)
    assert len(replay.shown_surface.rest) > whole == len(replay.surface.rest)
    assert len(replay.shown_surface.cut_line.corners)
    assert replay.statistics()["cut_area"] == pytest.approx(cut_session[2].cut_measures.area, rel=0.1)


def test_a_picture_of_a_recording_has_the_line_of_the_cut(cut_session, monkeypatch):
    pytest.importorskip("pyvista", reason="pip install 'palpate[film]'")
    recording = load_recording(cut_session[3])
    pictures = []
    for add_line in (film.DrawnBody._add_line, lambda self, line: None):
        monkeypatch.setattr(film.DrawnBody, "_add_line", add_line)
        with film.RecordingPlotter(recording, "displacement", 640) as draw:
            draw(0)  # without a cut
            pictures.append(np.asarray(draw(len(recording.snapshots) - 1), dtype=float))
    darker = pictures[1].sum(axis=2) - pictures[0].sum(axis=2)
    assert np.sum(darker > 100.0) > 50
    assert np.sum(darker < -100.0) == 0


def test_the_size_of_the_cut_stays_without_a_scalpel_and_strokes_add(cut_session):
    session = cut_session[0]
    before = session.statistics()
    session.release()
    send(session, type="tool", kind="sphere", radius=0.01, position=[0.025, 0.02, 0.05])
    after = session.statistics()
    assert "cutting_force" not in after
    assert {name: after[name] for name in after if name.startswith("cut_")} == {
        name: before[name] for name in before if name.startswith("cut_")
    }
    send(session, type="tool", kind="scalpel", length=0.012, toughness=TOUGHNESS, position=[0.025, 0.033, 0.045])
    lower(session, 1.5e-5, depth=0.006, place=(0.025, 0.033))
    drawn(session)
    added = session.statistics()
    assert added["cut_area"] > before["cut_area"] + 1e-5
    assert added["cut_length"] > before["cut_length"] + 5e-3
    assert added["cut_depth"] >= before["cut_depth"] - 1e-6


def test_undo_takes_the_strokes_back_one_by_one_and_the_body_goes_on(cut_session):
    session, cutter, _, _, _ = cut_session
    assert session.status()["strokes"] == 2
    assert session.tools[0].active.kind == "scalpel"
    areas = [session.statistics()["cut_area"]]
    time_before = session.engine.read().time
    send(session, type="control", action="undo")
    assert session.tools[0].active.kind == "none"
    assert session.tools[0].selected.kind == "scalpel"  # the next pose puts it down again
    assert session.status()["strokes"] == 1
    areas.append(drawn(session).cut_measures.area)
    assert 1e-4 < areas[1] < areas[0] - 1e-6
    session.undo()
    assert session.status()["strokes"] == 0
    assert cutter.model is cutter.whole_model
    assert session.shown_surface is session.surface
    with pytest.raises(pt.InputError, match="undo must follow a stroke"):
        session.undo()
    assert session.engine.state == "running"
    assert session.engine.read().time > time_before  # never at rest meanwhile
    send(session, type="pose", position=[0.025, 0.02, 0.045], sequence=1)
    lower(session, 1e-5)
    assert session.status()["strokes"] == 1


def test_undo_keeps_the_last_ten_strokes(cut_session):
    session, cutter, _, _, _ = cut_session
    session.release()
    session.reset()
    for _ in range(12):
        send(session, type="tool", kind="scalpel", length=0.012, toughness=TOUGHNESS, position=[0.025, 0.02, 0.05])
        with cutter.lock:
            cutter.model = copy(cutter.model)  # as a cut leaves it
        session.release()
    assert session.status()["strokes"] == 10


def test_a_reset_restores_the_whole_body(cut_session):
    session, cutter, _, _, _ = cut_session
    session.reset()
    time.sleep(0.1)
    assert session.shown_surface is session.surface
    assert not any(name.startswith("cut_") for name in session.statistics())
    assert cutter.model is cutter.whole_model
    assert session.status()["strokes"] == 0
    assert session.engine.state == "running"
    assert not np.any(session.engine.read().force)


def test_the_engine_resets_a_body_as_it_is_cut_and_puts_the_blade_away(cut_session):
    session, cutter, _, _, _ = cut_session
    session.reset()
    session.engine.reset(keep_cut=True)  # of a body without a cut
    assert session.engine.state == "running"
    send(session, type="tool", kind="scalpel", length=0.03, toughness=TOUGHNESS, position=[0.025, 0.02, 0.045])
    lower(session, 5e-5)
    session.engine.reset(keep_cut=True)
    cut = cutter.model
    time.sleep(0.3)
    assert cutter.model is cut is not cutter.whole_model
    assert cutter.cut_front is None
    assert np.abs(session.engine.read().coordinates).max() < 1e-6
    session.reset()


@pytest.mark.parametrize("gape", [0.003, 0.026])
def test_undo_goes_on_from_a_small_wound_and_starts_from_rest_at_a_wide_one(cut_session, gape):
    """A stroke next to forceps that pull by a way [m], at which the wound opens."""
    session, cutter, _, _, _ = cut_session
    session.reset()
    place, held = [0.025, 0.008, SIZE[2]], [0.025, 0.008 - gape, SIZE[2] + 0.3 * gape]
    send(session, type="tool", kind="grasp", radius=0.008, position=place, index=1)
    for share in np.linspace(0.0, 1.0, 50):
        send(session, type="pose", position=((1 - share) * np.array(place) + share * np.array(held)).tolist(), index=1)
        time.sleep(0.02)
    send(session, type="tool", kind="scalpel", length=0.04, toughness=1.0, position=[0.025, 0.02, 0.05])
    lower(session, 3e-4, depth=0.014)
    session.release(0)
    time.sleep(1.0)
    wide = np.linalg.norm(session.engine.read().coordinates.reshape(-1, 3), axis=1).max()
    goes_on = session.undo()
    assert goes_on == (gape < 0.01)
    assert (session.tools[1].active.kind == "grasp") == goes_on
    assert cutter.model is cutter.whole_model
    time.sleep(1.0)
    assert session.engine.state == "running"
    moved = np.linalg.norm(session.engine.read().coordinates.reshape(-1, 3), axis=1).max()
    assert moved < 1.2 * wide if goes_on else moved < 1e-5
    assert session.statistics()["energy_gained"] < 1e-6


def test_the_engine_of_a_body_with_planes_of_symmetry_refuses_a_blade():
    tissue = pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45)
    body = pt.Solid(pt.box(SIZE, 5e-3), tissue, fixed=["z-", pt.SymmetryPlane("x-")])
    blade = pt.tools.Contact(pt.tools.Blade([(-0.01, 0, 0), (0.01, 0, 0)], TOUGHNESS), (0.02, 0.02, 0.05))
    with pytest.raises(pt.InputError, match="planes of symmetry"):
        pt.realtime_model(body, contact=blade)
