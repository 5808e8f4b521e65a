"""Sessions of a full body: tools, grasps, and recordings that are replayed."""

from __future__ import annotations

import dataclasses
import time

import h5py
import numpy as np
import pytest
from view_scenes import BALL, MIDDLE, block

import palpate as pt
from palpate.app.cli import main
from palpate.app.recordings.recording import FORMAT, VERSION, load_recording
from palpate.app.recordings.recording_journal import is_recording
from palpate.app.session.messages import validate_message
from palpate.app.session.replay import Replay
from palpate.app.session.session import MAX_TOOL_SPEED, Session

SOFT = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45)
ABOVE = MIDDLE + np.array([0, 0, BALL + 0.002])


@pytest.fixture(scope="module")
def body():
    model = block().model
    return pt.Solid(model.cloud, SOFT, model.supports, mass_damping=8.0)


@pytest.fixture(scope="module")
def recorded(body, tmp_path_factory, until):
    """A recorded press, the snapshot at its end, and the surface."""
    path = tmp_path_factory.mktemp("recorded") / "press.h5"
    session = Session(body, "Full block")
    session.start()
    session.handle(validate_message({"type": "record", "action": "start"}))
    session.handle(
        validate_message(
            {"type": "tool", "kind": "sphere", "radius": BALL, "position": ABOVE.tolist(), "friction": 0.2}
        )
    )
    for k in range(9):
        before = len(session.recordings.recorder.times)
        deep = 0.005 * k / 8
        session.handle(validate_message({"type": "pose", "position": (ABOVE - np.array([0, 0, deep])).tolist()}))
        until(lambda before=before: len(session.recordings.recorder.times) > before)
    session.pause()
    seen = session.snapshot()
    before = len(session.recordings.recorder.times)
    until(lambda: len(session.recordings.recorder.times) > before + 1)
    session.recordings.finish(path, wait=True)
    session.stop()
    (news,) = session.notifications
    assert news == {"type": "recorded", "file": str(path), "frames": news["frames"]}
    return path, seen, session.surface


def moved(body, way):
    """The body at another place."""
    cloud = dataclasses.replace(body.cloud, points=body.cloud.points + way)
    return pt.Solid(cloud, SOFT, body.supports, mass_damping=8.0)


def test_the_tool_of_a_full_body_has_no_limit_of_a_training(body):
    session = Session(body, "Full block")
    assert session.hello()["tool_speed"] is None
    assert session.tool_speed == MAX_TOOL_SPEED
    with pytest.raises(pt.InputError, match="follow must be left out here"):
        session.handle(validate_message({"type": "follow", "fast": True}))


@pytest.mark.slow
def test_a_body_far_from_the_origin_is_pressed_as_one_there(body, until):
    forces = []
    for way in (np.zeros(3), np.array([100.0, -200.0, 50.0])):
        session, above = Session(moved(body, way), "Block"), ABOVE + way
        session.start()
        ball = {"type": "tool", "kind": "sphere", "radius": BALL, "position": above.tolist()}
        session.handle(validate_message(ball))
        session.handle(validate_message({"type": "pose", "position": (above - [0, 0, 0.005]).tolist()}))
        until(lambda session=session: session.snapshot().tools[0].force[2] > 0.02)
        for _ in range(60):  # until it rests
            count = session.snapshot().time + 0.02
            until(lambda session=session, count=count: session.snapshot().time > count)
        forces.append(session.snapshot().tools[0].force[2])
        session.stop()
    assert forces[1] == pytest.approx(forces[0], rel=0.03)
    with pytest.raises(pt.InputError, match=r"body must lie within 999\.7 m of the origin"):
        Session(moved(body, np.array([2000.0, 0, 0])), "Block")


def test_a_recording_of_a_full_body_has_its_states_and_makes_it_again(recorded, body):
    path, seen, surface = recorded
    recording = load_recording(path)
    last = recording.snapshots[-1]
    assert seen.tools[0].force[2] > 0.02
    for one, other in zip((last, *last.tools), (seen, *seen.tools), strict=True):
        for field in dataclasses.fields(other):
            if field.name != "tools":
                np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), field.name)
    assert last.coordinates.dtype == np.float32
    again = recording.model
    assert isinstance(again, pt.Solid)
    assert again.supports == body.supports
    assert (again.mass_damping, again.stiffness_damping) == (8.0, body.stiffness_damping)
    u = np.random.default_rng(0).standard_normal(body.cloud.points.shape) * 1e-4
    np.testing.assert_array_equal(again.force(u), body.force(u))
    shown, own = Replay(recording), last.displacements(surface)
    np.testing.assert_array_equal(last.displacements(shown.surface), own)
    for name in ("stress", "pressure"):
        np.testing.assert_array_equal(last.scalar(shown.surface, name, own), last.scalar(surface, name, own))
    assert shown.hello()["full"]
    assert shown.hello()["training_errors"] is None


def test_the_surface_of_a_full_body_is_written_for_paraview(recorded):
    path, seen, surface = recorded
    with h5py.File(path.with_suffix(".vtkhdf")) as file:
        assert set(file["VTKHDF/PointData"]) >= {"displacement", "stress", "pressure"}
        moved = file["VTKHDF/PointData/displacement"][-len(surface.rest) :]
    np.testing.assert_allclose(moved, seen.displacements(surface), atol=1e-9)


def test_a_recording_of_a_full_body_is_replayed_as_a_picture_and_not_on_the_full_model(
    recorded, assert_refused, capsys
):
    path = recorded[0]
    assert main(["replay", str(path), "--png", str(path.with_suffix(".png")), "--scalar", "stress"]) == 0
    assert path.with_suffix(".png").stat().st_size > 5000
    capsys.readouterr()
    assert_refused(["replay", str(path), "--full"], "full must be left out for a recording of a full body")


def test_a_campaign_refuses_a_recording_of_a_full_body(recorded):
    from palpate.app.train.paths import _check

    with pytest.raises(pt.InputError, match="a recording of a reduced model, got one of a full body"):
        _check(load_recording(recorded[0]), None, recorded[0])


def test_an_interrupted_recording_of_a_full_body_is_read(body, tmp_path, until):
    session = Session(body, "Full block")
    session.start()
    session.recordings.start(tmp_path / "cut.h5")
    until(lambda: session.recordings.recorder.journal.count > 0)
    first = session.recordings.recorder.journal.count
    until(lambda: session.recordings.recorder.journal.count > first)
    content = (tmp_path / "cut.h5").read_bytes()
    session.recordings.finish(wait=True)
    session.close()
    cut = tmp_path / "again.h5"
    cut.write_bytes(content[:-7])  # the end of the last record is missing
    assert is_recording(cut)
    found = load_recording(cut)
    assert len(found.snapshots) >= first
    assert len(found.model.cloud) == len(body.cloud)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda header: header["model"].update(neighbours=10**9), "neighbours must be"),
        (lambda header: header["model"].update(mass_damping=-1.0), "mass_damping must be"),
        (lambda header: header["model"].update(more=1), "header more is not one of a model"),
        (lambda header: header["model"].update(supports='[{"kind": "nothing"}]'), "support"),
    ],
)
def test_forged_bodies_are_refused(recorded, tmp_path, forge, change, message):
    path = forge(recorded[0], lambda header, arrays: change(header), FORMAT, VERSION, tmp_path / "forged.h5")
    with pytest.raises(pt.FileFormatError, match=message):
        load_recording(path)


def test_forceps_pull_a_full_body_on_a_session(body, until):
    session = Session(body, "Full block")
    assert session.hello()["tools"] == ["sphere", "capsule", "grasp", "scalpel"]
    session.start()
    session.handle(validate_message({"type": "tool", "kind": "grasp", "radius": BALL / 2, "position": MIDDLE.tolist()}))
    pulled = MIDDLE + np.array([0.0, 0.0, 0.003])
    session.handle(validate_message({"type": "pose", "position": pulled.tolist()}))
    until(lambda: session.snapshot().tools[0].force[2] < -0.01)
    until(lambda: session.snapshot().displacements(session.surface)[:, 2].max() > 0.0025)
    began = time.monotonic()

    def stiffness_of_the_next_place():  # the contact stiffness follows from slow ways of a tool that is in contact
        height = 0.001 * np.sin(6.0 * (time.monotonic() - began))
        place = pulled + np.array([0.0, 0.0, height])
        session.handle(validate_message({"type": "pose", "position": place.tolist()}))
        return bool(np.any(session.snapshot().tools[0].stiffness))

    until(stiffness_of_the_next_place)
    session.release()
    until(lambda: not session.snapshot().tools[0].force.any())
    session.reset()
    assert not session.snapshot().coordinates.any()
    session.stop()


def test_a_sheet_is_pressed_grasped_and_recorded(tmp_path, until):
    rubber = pt.materials.NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5)
    sheet = pt.Membrane(pt.disc(0.1, 0.02), rubber, 1e-3, "rim", prestretch=1.05)
    session = Session(sheet, "Sheet")
    assert session.hello()["least_radius"] == 2 * sheet.cloud.spacing
    assert [each["name"] for each in session.hello()["scalars"]] == ["displacement"]
    assert "scalpel" not in session.tool_kinds
    session.start()
    try:
        session.recordings.start()
        session.handle(validate_message({"type": "tool", "kind": "sphere", "radius": 0.04, "position": [0, 0, 0.045]}))
        session.handle(validate_message({"type": "pose", "position": [0.0, 0.0, 0.036]}))
        until(lambda: session.snapshot().tools[0].force[2] > 0.05)
        session.handle(validate_message({"type": "release"}))
        until(lambda: abs(session.snapshot().tools[0].force[2]) == 0.0)
        session.handle(validate_message({"type": "tool", "kind": "grasp", "radius": 0.03, "position": [0.0, 0.0, 0.0]}))
        session.handle(validate_message({"type": "pose", "position": [0.0, 0.0, 0.005]}))
        until(lambda: session.snapshot().displacements(session.surface)[:, 2].max() > 0.0045)
        assert session.snapshot().tools[0].force[2] < -0.05
        before = len(session.recordings.recorder.times)
        until(lambda: len(session.recordings.recorder.times) > before + 2)
        session.recordings.finish(tmp_path / "sheet.h5", wait=True)
    finally:
        session.close()
    recording = load_recording(tmp_path / "sheet.h5")
    assert recording.model.prestretch == 1.05
    show = Replay(recording)
    assert show.hello()["full"]
    assert show.hello()["duration"] > 0
