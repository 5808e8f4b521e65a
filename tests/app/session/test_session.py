"""What a session does with the tool in a hand."""

from __future__ import annotations

import errno
import runpy
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from view_scenes import BALL, MIDDLE, SIZE

import palpate as pt
from palpate.app.recordings.recording import load_recording, save_recording
from palpate.app.session.messages import validate_message
from palpate.app.session.session import HAND_FORCE, MAX_TOOL_SPEED, TRAINED_SHARE, Session
from palpate.core.sealed import kind_of_file
from palpate.dynamics.run.journal import Journal

ABOVE = MIDDLE + np.array([0, 0, BALL + 0.002])
PRESSED = MIDDLE + np.array([0, 0, BALL - 0.003])


def pose(position, **more):
    return validate_message({"type": "pose", "position": list(position), **more})


def calm(moment):
    return moment.tools[0].force[2] > 0.01 and moment.kinetic < 1e-4 * moment.strain


@pytest.fixture
def pressed(session, ball, until):
    """A session whose ball stands 3 mm deep."""
    session.handle(validate_message(ball))
    session.handle(pose(PRESSED))
    until(lambda: session.snapshot().tools[0].position[2] == pytest.approx(PRESSED[2]))
    until(lambda: calm(session.snapshot()))
    return session


def test_a_press_has_force_and_displacement_and_a_release_ends_both(pressed, until):
    moment = pressed.snapshot()
    moved, tool = moment.displacements(pressed.surface), moment.tools[0]
    assert tool.kind == "sphere"
    assert len(moment.contact_nodes) > 0
    middle = int(np.argmin(np.linalg.norm(pressed.surface.rest - MIDDLE, axis=1)))
    assert -0.0035 < moved[middle, 2] < -0.0025  # the ball's lowest point is 3 mm deep
    np.testing.assert_allclose(tool.device_force, tool.force, atol=1e-3 * abs(tool.force[2]))  # held firmly
    pressed.release()
    until(lambda: not pressed.snapshot().tools[0].force.any())
    until(lambda: np.abs(pressed.snapshot().displacements(pressed.surface)).max() < 1e-4)
    assert pressed.snapshot().tools[0].kind == "none"


def test_forces_on_nodes_are_of_the_same_period_as_the_force_on_the_tool(pressed):
    for _ in range(50):
        moment = pressed.snapshot()
        force = moment.tools[0].force
        assert moment.state == "running"
        np.testing.assert_allclose(-moment.contact_forces.sum(axis=0), force, atol=0.05 * abs(force[2]))


def test_a_released_ball_returns_at_a_pose_outside_the_body(pressed, until):
    pressed.release()
    pressed.handle(pose(PRESSED))  # inside: it stays away
    assert pressed.snapshot().tools[0].kind == "none"
    pressed.handle(pose(ABOVE))
    assert pressed.snapshot().tools[0].kind == "sphere"
    np.testing.assert_allclose(pressed.snapshot().tools[0].position, ABOVE)
    pressed.handle(pose(PRESSED))
    until(lambda: pressed.snapshot().tools[0].force[2] > 0.01)


def test_a_reset_restores_rest(pressed):
    pressed.reset()
    moment = pressed.snapshot()
    assert not moment.displacements(pressed.surface).any()
    assert moment.tools[0].kind == "none"
    assert moment.time < 0.1
    assert moment.state == "running"


def test_after_a_reset_trust_is_0_and_the_next_touch_has_a_bound(model, ball, until):
    """The bound is known up to an error indicator of 0.01: a deep press is beyond it, and a reset forgets that."""
    curve = {"typical_size": 0.1, "least_trust": 0.001, "largest_trust": 0.01, "exponent": 1.0, "median": 0.01,
             "bound": 0.05}  # fmt: skip
    curves = {"forgetting": 0.0, "level": 0.95, "least_level": 0.9, "displacement": curve, "force": curve}
    report = {**model.report, "held_out": {"mean": {}, "expected_error": curves}}
    unlimited = dict.fromkeys(("nearness_scale", "speed_scale", "distance_scale", "residual_scale"), 1e300)
    compliance = 1e3 * model.data.scales.flexibility_scale
    session = Session(
        model.with_data(
            report=report, trained=model.data.with_scales(flexibility_scale=compliance, **unlimited).trained
        ),
        "Block",
    )
    shallow = PRESSED + np.array([0, 0, 0.0025])  # 0.5 mm deep
    session.start()
    try:
        session.handle(validate_message(ball))
        session.handle(pose(PRESSED))
        until(lambda: session.snapshot().trust > 0.015, lambda: session.snapshot().trust)
        session.handle(pose(shallow))
        until(lambda: 0.0 < session.snapshot().trust < 0.008, lambda: session.snapshot().trust)
        assert session.statistics()["force_bound"] is None
        session.reset()
        assert session.engine.read().trust == 0.0
        assert session.statistics()["force_bound"] == pytest.approx(0.05 * 0.001 * 0.05)
        session.handle(validate_message(ball))
        session.handle(pose(shallow))
        until(lambda: session.snapshot().tools[0].force[2] > 0.005)
        assert session.statistics()["force_bound"] is not None
    finally:
        session.stop()


def test_a_change_of_tool_keeps_the_state(pressed, until):
    before, parts = pressed.snapshot(), pressed.model.data
    aside = [0.040, 0.008, SIZE[2] + 0.02]
    capsule = {"type": "tool", "kind": "capsule", "radius": 0.01, "length": 0.01, "position": aside}
    pressed.handle(validate_message(capsule))
    moment = pressed.snapshot()
    assert moment.tools[0].kind == "capsule"
    assert moment.steps >= before.steps
    assert pressed.model.data is parts  # nothing was built again
    np.testing.assert_allclose(moment.tools[0].position, aside)


def test_a_grasp_pulls_and_lets_go(session, until):
    session.handle(validate_message({"type": "tool", "kind": "grasp", "radius": 0.008, "position": MIDDLE.tolist(),
                            "quaternion": [0.0, 1.0, 0.0, 0.0]}))  # fmt: skip
    held = session.snapshot().tools[0]
    np.testing.assert_allclose(held.position, MIDDLE, atol=1e-6)
    np.testing.assert_allclose(np.abs(held.quaternion), [0.0, 1.0, 0.0, 0.0], atol=1e-9)
    session.handle(pose(MIDDLE + np.array([0, 0, 0.003]), quaternion=[0.0, 1.0, 0.0, 0.0]))
    until(lambda: session.snapshot().tools[0].position[2] == pytest.approx(MIDDLE[2] + 0.003))
    until(lambda: session.snapshot().tools[0].force[2] < -0.05)  # the body pulls it down
    moment = session.snapshot()
    middle = int(np.argmin(np.linalg.norm(session.surface.rest - MIDDLE, axis=1)))
    np.testing.assert_allclose(moment.displacements(session.surface)[middle], [0, 0, 0.003], atol=1e-4)
    session.release()
    until(lambda: not session.snapshot().tools[0].force.any())
    session.handle(pose(ABOVE))  # forceps do not come back by themselves
    assert session.snapshot().tools[0].kind == "none"


@pytest.mark.parametrize(
    ("tool", "said"),
    [
        ({"kind": "sphere", "position": [0.024, 0.024, 0.012]}, "outside the body"),
        ({"kind": "sphere", "radius": 0.003, "position": [0.024, 0.024, 0.015]}, "outside the body"),
        ({"kind": "grasp", "position": [0.024, 0.024, 0.09]}, "mm of the surface"),
        ({"kind": "grasp", "position": [0.0, 0.024, 0.006], "radius": 0.008}, "away from the support"),
    ],
)
def test_a_tool_inside_the_body_or_away_from_it_is_refused(session, tool, said):
    with pytest.raises(pt.InputError, match=said):
        session.handle(validate_message({"type": "tool", **tool}))


def test_a_tool_is_faster_than_in_training_only_if_the_user_asks(model, ball, until):
    limited = Session(pt.ReducedModel(model.data.with_scales(speed_scale=0.05)), "Block")
    speed, way = limited.hello()["tool_speed"], 0.06
    assert speed == pytest.approx(TRAINED_SHARE * 0.05)

    def seconds_to(height):
        """Return the model time [s] in which the ball reaches a height above the body."""
        begin, place = limited.snapshot().time, ABOVE + np.array([0, 0, height])
        limited.handle(pose(place))
        until(lambda: limited.snapshot().tools[0].position[2] == pytest.approx(place[2]))
        return limited.snapshot().time - begin

    limited.start()
    try:
        limited.handle(validate_message(ball))
        seconds_to(0.0)
        assert limited.status()["fast"] is False
        assert seconds_to(way) > 0.98 * way / speed
        limited.handle(validate_message({"type": "follow", "fast": True}))
        assert limited.status()["fast"] is True
        assert seconds_to(0.0) < 0.5 * way / speed
        limited.handle(validate_message({"type": "follow", "fast": False}))
        assert seconds_to(way) > 0.98 * way / speed
    finally:
        limited.stop()


def test_a_model_of_a_fast_training_does_not_slow_its_tool(model):
    session = Session(pt.ReducedModel(model.data.with_scales(speed_scale=10.0)), "Block")
    assert session.hello()["tool_speed"] is None
    assert session.tool_speed == MAX_TOOL_SPEED
    with pytest.raises(pt.InputError, match="follow must be left out here"):
        session.handle(validate_message({"type": "follow", "fast": True}))


def test_slow_motion_is_slow(session, until):
    session.handle(validate_message({"type": "speed", "factor": 0.1}))
    first = session.snapshot()
    until(lambda: session.snapshot().steps >= first.steps + 100)
    last = session.snapshot()
    assert last.time - first.time == pytest.approx(1e-4 * (last.steps - first.steps), rel=1e-6)


@pytest.fixture
def clocks(monkeypatch):
    """The clocks of a machine [s] that a test sets."""
    at = SimpleNamespace(total=1000.0, up=900.0)
    monkeypatch.setattr("palpate.realtime.suspension.HAS_CLOCKS", True)
    monkeypatch.setattr("palpate.realtime.suspension.time_since_start", lambda: at.total)
    monkeypatch.setattr("palpate.realtime.suspension.uptime", lambda: at.up)
    return at


def test_a_pause_stops_the_steps_and_a_suspended_machine_pauses(clocks, session, until):
    session.tick()
    session.handle(validate_message({"type": "control", "action": "pause"}))
    still = session.snapshot().steps
    time.sleep(0.05)
    assert session.snapshot().steps == still
    session.handle(validate_message({"type": "control", "action": "resume"}))
    until(lambda: session.snapshot().steps > still)
    session.tick()
    assert session.status()["state"] == "running"
    clocks.total += 3600.0  # the lid was closed for an hour
    session.tick()
    assert session.status()["state"] == "paused"
    assert session.status()["pause_reason"] == "sleep"
    session.handle(validate_message({"type": "control", "action": "resume"}))
    session.tick()
    assert session.status()["state"] == "running"
    assert session.status()["pause_reason"] is None


def test_a_suspended_machine_pauses_under_a_tool_that_presses(clocks, pressed):
    pressed.tick()
    clocks.total += 10.0
    pressed.tick()
    assert pressed.status()["pause_reason"] == "sleep"


def test_a_stall_does_not_pause_a_driver_nor_a_session_without_one(clocks, session, ball, until):
    session.tick()
    for seconds in (3.5, 60.0):
        clocks.total, clocks.up = clocks.total + seconds, clocks.up + seconds
        session.tick()
        assert session.status()["state"] == "running"
    session.handle(validate_message(ball))
    session.handle(pose(PRESSED))
    until(lambda: session.snapshot().tools[0].force[2] > 0.01)
    for seconds in (3.5, 60.0):
        clocks.total, clocks.up = clocks.total + seconds, clocks.up + seconds
        session.tick()
        assert session.status()["state"] == "running"
        assert session.snapshot().tools[0].force[2] > 0.01


def test_twice_the_moduli_give_twice_the_force_at_the_same_depth(pressed, until):
    begun = pressed.snapshot().steps  # a body that swings is still for a moment, too: wait until it has swung out
    until(lambda: pressed.snapshot().steps > begun + 2000 and calm(pressed.snapshot()))
    soft = pressed.snapshot()
    own = pressed.hello()["materials"][0]
    assert own["value"] == pytest.approx(4.0)  # C1 + C2
    pressed.handle(validate_message({"type": "material", "name": "shear modulus", "value": 8.0}))
    until(lambda: pressed.snapshot().steps > soft.steps + 2000 and calm(pressed.snapshot()))
    firm = pressed.snapshot()
    assert firm.tools[0].force[2] == pytest.approx(2 * soft.tools[0].force[2], rel=0.02)
    assert firm.strain == pytest.approx(2 * soft.strain, rel=0.02)
    np.testing.assert_allclose(
        firm.displacements(pressed.surface), soft.displacements(pressed.surface), atol=0.02 * 0.003
    )
    stress = [m.scalar(pressed.surface, "stress", m.displacements(pressed.surface)) for m in (soft, firm)]
    assert np.linalg.norm(stress[1]) == pytest.approx(
        2 * np.linalg.norm(stress[0]), rel=0.1
    )  # modes still ring a little
    with pytest.raises(pt.InputError, match="must be from 1 to 16 kPa"):
        pressed.handle(validate_message({"type": "material", "name": "shear modulus", "value": 100.0}))


def test_alternating_moduli_excite_no_motion(session, until):
    """In step with the body's vibrations, jumps would: this body ran away in half a second."""
    session.handle(validate_message({"type": "tool", "kind": "grasp", "radius": 0.008, "position": MIDDLE.tolist()}))
    session.handle(pose(MIDDLE + np.array([-0.0151, -0.0120, 0.0057])))
    for k in range(60):
        session.handle(validate_message({"type": "material", "name": "shear modulus", "value": (1.0, 16.0)[k % 2]}))
        begun = session.snapshot().steps
        until(lambda begun=begun: session.snapshot().steps >= begun + 15)
    moment = session.snapshot()
    assert moment.state == "running"
    assert moment.kinetic < 0.01 * moment.strain
    assert 0.25 <= moment.modulus_ratio <= 4.0
    session.handle(validate_message({"type": "material", "name": "shear modulus", "value": 16.0}))
    until(lambda: session.snapshot().modulus_ratio == 4.0)


def test_a_coupled_tool_rests_where_spring_and_body_balance(session, ball, until):
    session.handle(validate_message({**ball, "stiffness": 200.0}))
    session.handle(pose(PRESSED))
    until(lambda: session.snapshot().steps > 500 and calm(session.snapshot()))
    tool = session.snapshot().tools[0]
    np.testing.assert_allclose(tool.force[2], 200.0 * (tool.position - PRESSED)[2], rtol=0.05)
    np.testing.assert_allclose(tool.device_force[2], tool.force[2], rtol=0.05)


@pytest.mark.slow  # the periods are called from Python, which compiles them for one test
def test_the_virtual_coupling_produces_no_energy(model):
    """The example's energy balance, in periods of 1 ms without a clock."""
    path = Path(__file__).parents[3] / "validation" / "virtual_coupling.py"
    example = runpy.run_path(str(path))
    terms = example["balance"](model, 300.0, radius=BALL, depth=0.004)
    most = terms["body"].max()
    assert most > 1e-4  # [J]: it was pressed
    assert terms["work"].min() > -1e-3 * most  # the hand never gets more than it gave
    assert (terms["work"] - terms["body"] - terms["coupling"]).min() > -0.02 * most
    assert terms["work"][-1] > 0.0


@pytest.mark.slow  # as above
def test_a_saturated_coupling_produces_no_energy_and_pulls_with_its_limit(model):
    path = Path(__file__).parents[3] / "validation" / "virtual_coupling.py"
    balance = runpy.run_path(str(path))["balance"]
    free = balance(model, 300.0, radius=BALL, depth=0.004)
    limit = 0.3 * free["force"].max()
    terms = balance(model, 300.0, radius=BALL, depth=0.004, limit=limit)
    most = terms["body"].max()
    assert most < 0.9 * free["body"].max()  # the tool lags behind
    assert np.isclose(terms["force"], limit, rtol=1e-9).mean() > 0.1
    assert terms["work"].min() > -1e-3 * most
    assert (terms["work"] - terms["body"] - terms["coupling"]).min() > -0.02 * most


def test_a_coupled_tool_lags_behind_a_pointer_deep_in_the_body(session, ball, until):
    session.handle(validate_message({**ball, "stiffness": 2000.0}))
    session.handle(pose(tuple(np.array(PRESSED) - [0.0, 0.0, 0.02])))
    until(lambda: session.snapshot().steps > 500 and calm(session.snapshot()))
    assert abs(session.snapshot().tools[0].force[2]) <= 1.05 * HAND_FORCE


def test_a_model_without_tools_is_refused(model):
    bare = pt.ReducedModel(replace(model.data, compliance=None))
    with pytest.raises(pt.InputError, match="one prescribed group for the engine"):
        Session(bare, "Bare")


def test_recordings_of_the_same_second_have_different_names(session, tmp_path, monkeypatch, until):
    monkeypatch.setattr("palpate.app.session.recordings.time.strftime", lambda form: "recording-now")
    session.recordings.folder = tmp_path / "recordings"
    for _ in range(3):
        session.recordings.start()
        until(lambda: len(session.recordings.recorder.times) > 1)
        session.recordings.finish()
    session.recordings.start()
    until(lambda: len(session.recordings.recorder.times) > 1)
    session.close()  # ends the one that goes on, and returns when all are written
    names = ["recording-now", "recording-now-2", "recording-now-3", "recording-now-4"]
    assert sorted(path.stem for path in session.recordings.folder.glob("*.h5")) == names
    assert sorted(path.stem for path in session.recordings.folder.glob("*.vtkhdf")) == names
    assert sorted(news["file"] for news in session.notifications) == sorted(
        str(session.recordings.folder / f"{n}.h5") for n in names
    )
    assert all(load_recording(path).snapshots for path in session.recordings.folder.glob("*.h5"))


def test_a_recording_that_cannot_be_written_keeps_its_journal(session, tmp_path, monkeypatch, until):
    def full(path, recording):
        raise OSError("no space left")

    monkeypatch.setattr("palpate.app.session.recordings.save_recording", full)
    session.recordings.folder = tmp_path
    session.recordings.start()
    until(lambda: len(session.recordings.recorder.times) > 1)
    seen = session.recordings.recorder.snapshots
    session.recordings.finish(wait=True)
    (path,) = tmp_path.iterdir()
    reason = f"the recording was not written: no space left; its first {len(seen)} snapshots are in {path}"
    assert session.notifications == [{"type": "error", "reason": reason}]
    assert session.recordings.failures == [reason]
    stored = load_recording(path)
    assert len(stored.snapshots) == len(seen)
    np.testing.assert_array_equal(stored.snapshots[-1].coordinates, seen[-1].coordinates)


def test_a_recording_that_cannot_be_written_is_written_elsewhere(session, tmp_path, monkeypatch, until):
    def full(path, recording):
        if path.parent == tmp_path / "full":
            raise OSError("no space left")
        save_recording(path, recording)

    (tmp_path / "full").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr("palpate.app.session.recordings.save_recording", full)
    session.recordings.start(tmp_path / "full" / "all.h5")
    until(lambda: len(session.recordings.recorder.times) > 1)
    session.recordings.finish(wait=True)
    (other,) = tmp_path.glob("palpate-recording-*/all.h5")
    assert session.recordings.failures == [f"the recording was not written: no space left; it is in {other}"]
    assert load_recording(other).snapshots


def test_a_recording_is_on_the_disk_while_it_goes_on(session, tmp_path, until):
    path, copy = tmp_path / "all.h5", tmp_path / "killed.h5"
    session.recordings.start(path)
    recorder = session.recordings.recorder
    until(lambda: recorder.journal.count > 60)
    copy.write_bytes(path.read_bytes())  # what a killed process leaves
    killed = load_recording(copy)
    assert len(killed.snapshots) >= 60
    np.testing.assert_array_equal(killed.times, recorder.times[: len(killed.times)])
    for name in ("steps", "coordinates", "contact_nodes", "contact_forces"):
        np.testing.assert_array_equal(getattr(killed.snapshots[50], name), getattr(recorder.snapshots[50], name))
    (tool, *_), (recorded, *_) = killed.snapshots[50].tools, recorder.snapshots[50].tools
    np.testing.assert_array_equal(tool.position, recorded.position)
    cut = tmp_path / "cut.h5"
    cut.write_bytes(copy.read_bytes()[:-100])
    assert 0 < len(load_recording(cut).snapshots) < len(killed.snapshots)
    session.recordings.finish(wait=True)
    assert kind_of_file(path) == "palpate recording"
    assert len(load_recording(path).snapshots) > len(killed.snapshots)
    assert not [each for each in tmp_path.iterdir() if each.name.startswith(".")]


def test_a_disk_that_is_full_for_a_while_costs_no_snapshot_of_the_journal(session, tmp_path, until, monkeypatch):
    write, failed = Journal._write, []

    def full(self, content):
        if len(content) > 100 and len(failed) < 3:
            failed.append(self)
            write(self, content[: len(content) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, content)

    monkeypatch.setattr(Journal, "_write", full)
    session.recordings.start(tmp_path / "all.h5")
    recorder = session.recordings.recorder
    until(lambda: len(failed) == 3 and recorder.journal.count > 60)
    copy = tmp_path / "killed.h5"
    copy.write_bytes((tmp_path / "all.h5").read_bytes())
    np.testing.assert_array_equal(load_recording(copy).times, recorder.times[: len(load_recording(copy).times)])
    session.recordings.finish(wait=True)
    assert session.recordings.failures == []
    assert sorted(each.name for each in tmp_path.iterdir()) == ["all.h5", "all.vtkhdf", "killed.h5"]


def test_a_page_cannot_record_into_a_folder_that_does_not_exist(session, tmp_path):
    (tmp_path / "file").touch()
    session.recordings.folder = tmp_path / "file"
    with pytest.raises(pt.InputError, match="record must have a folder that can be written"):
        session.handle(validate_message({"type": "record", "action": "start"}))
    assert session.recordings.recorder is None


def test_a_recording_is_kept_if_only_the_paraview_file_fails(session, tmp_path, monkeypatch, until):
    def full(path, recording):
        raise OSError("no space left")

    monkeypatch.setattr("palpate.app.recordings.recording._write_surface", full)
    session.recordings.folder = tmp_path
    session.recordings.start()
    until(lambda: len(session.recordings.recorder.times) > 1)
    session.recordings.finish(wait=True)
    reason = "the file for ParaView was not written: no space left"
    assert session.notifications == [{"type": "error", "reason": reason}]
    (path,) = tmp_path.iterdir()
    assert load_recording(path).snapshots


def test_a_recording_is_written_to_its_path_whoever_stops_it(session, tmp_path, until):
    session.recordings.start(tmp_path / "all.h5")
    until(lambda: len(session.recordings.recorder.times) > 1)
    session.handle(validate_message({"type": "record", "action": "stop"}))
    session.close()
    assert session.notifications[0]["file"] == str(tmp_path / "all.h5")


def test_the_pace_is_that_of_the_last_seconds(session, monkeypatch):
    session.pause()
    paces, real = [], session.engine.statistics()
    for count, dropped in ((1000, 1000), (2000, 1000), (2300, 1600)):
        told = replace(real, count=count, dropped=dropped)
        monkeypatch.setattr(session.engine, "statistics", lambda told=told: told)
        paces.append(session.statistics()["pace"])
    assert paces == pytest.approx([0.5, 1.0, 1300 / 1900])  # the first one since the start
