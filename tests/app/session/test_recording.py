"""Recordings: what was seen is what is replayed, drawn, and run again on the full model."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest
from view_scenes import BALL, MIDDLE, block

import palpate as pt
from palpate.app.cli import main
from palpate.app.recordings.recording import FORMAT, VERSION, load_recording, save_recording
from palpate.app.session.full_model_replay import full_model, replay_on_full_model
from palpate.app.session.messages import validate_message
from palpate.app.session.replay import Replay
from palpate.app.session.session import Session
from palpate.app.view.server.frames import state_body

ABOVE = MIDDLE + np.array([0, 0, BALL + 0.002])


@pytest.fixture(scope="module")
def recorded(model, tmp_path_factory, until):
    """A recorded press, and the moment that was seen in the end."""
    path = tmp_path_factory.mktemp("recorded") / "press.h5"
    session = Session(model, "Block")
    session.start()
    session.handle(validate_message({"type": "record", "action": "start"}))
    session.handle(
        validate_message(
            {"type": "tool", "kind": "sphere", "radius": BALL, "position": ABOVE.tolist(), "friction": 0.2}
        )
    )
    steps = 30
    for k in range(steps + 1):
        before = len(session.recordings.recorder.times)
        deep = 0.005 * np.sin(np.pi * k / steps)
        session.handle(validate_message({"type": "pose", "position": (ABOVE - np.array([0, 0, deep])).tolist()}))
        until(lambda before=before: len(session.recordings.recorder.times) > before)
    with pytest.raises(pt.InputError, match="stop the present one"):
        session.recordings.start()
    session.pause()
    seen = session.snapshot()
    time.sleep(0.1)
    session.recordings.finish(path, wait=True)
    session.stop()
    (news,) = session.notifications
    assert news == {"type": "recorded", "file": str(path), "frames": news["frames"]}
    assert news["frames"] > 20
    return path, seen, session.surface


def test_a_loaded_recording_equals_the_session(recorded, model):
    path, seen, surface = recorded
    recording = load_recording(path)
    assert recording.title == "Block"
    last = recording.snapshots[-1]
    for name in ("time", "steps", "coordinates", "contact_nodes", "contact_forces"):
        np.testing.assert_array_equal(getattr(last, name), getattr(seen, name))
    assert last.state == seen.state
    for name in ("position", "quaternion", "kind"):
        np.testing.assert_array_equal(getattr(last.tools[0], name), getattr(seen.tools[0], name))
    np.testing.assert_array_equal(recording.model.data.cubature.weights, model.data.cubature.weights)
    assert {moment.tools[0].kind for moment in recording.snapshots} == {"none", "sphere"}
    own = Replay(recording).surface
    strained = max(recording.snapshots, key=lambda moment: moment.tools[0].force[2])
    assert len(strained.contact_nodes) > 0
    # the model in the file keeps its columns in single precision
    moved = strained.displacements(surface)
    np.testing.assert_allclose(strained.displacements(own), moved, atol=1e-5 * np.abs(moved).max())


def test_a_replay_shows_the_recorded_positions(recorded, site_of):
    path, _, _ = recorded
    recording = load_recording(path)
    show = Replay(recording)
    deepest = max(range(len(recording.snapshots)), key=lambda k: recording.snapshots[k].tools[0].force[2])

    async def visit():
        async with site_of(show).client() as client:
            assert client.messages[0]["mode"] == "replay"
            assert client.messages[0]["duration"] == pytest.approx(recording.times[-1])
            await client.say(type="replay", action="pause")
            await client.say(type="replay", action="seek", time=float(recording.times[deepest]) + 1e-6)
            await client.hear_until(lambda c: c.states and c.states[-1][1][0] == recording.times[deepest])
            state = client.states[-1]
            client.messages.clear()
            await client.say(type="tool", kind="sphere", position=[0, 0, 1])
            assert "a replay takes no tool" in (await client.told("error"))["reason"]
            await client.say(type="replay", action="play")
            await client.hear_until(lambda c: c.states[-1][1][20] == 1 and c.states[-1][1][0] != state[1][0])
            return state

    _, head, points, _ = asyncio.run(visit())
    moment = recording.snapshots[deepest]
    np.testing.assert_array_equal(points, show.surface.rest + moment.displacements(show.surface))
    np.testing.assert_array_equal(head[2:5], moment.tools[0].force)
    np.testing.assert_array_equal(head[8:11], moment.tools[0].position)


def test_the_surface_is_written_for_paraview(recorded):
    path, _, surface = recorded
    with h5py.File(path.with_suffix(".vtkhdf")) as file:
        root = file["VTKHDF"]
        np.testing.assert_allclose(root["Points"][:], surface.rest, rtol=1e-6)
        frames = root["Steps"].attrs["NSteps"]
        moved = root["PointData/displacement"][:].reshape(frames, -1, 3)
        assert set(root["PointData"]) == {"displacement", "stress", "pressure"}
    assert moved[:, :, 2].min() < -0.0015
    assert frames > 5


@pytest.mark.slow
def test_the_full_model_has_nearly_the_same_force_and_displacement(recorded, capsys, assert_refused):
    path, _, _ = recorded
    full = replay_on_full_model(load_recording(path), block().model)
    assert full["errors"]["force"] < 0.15
    assert abs(full["errors"]["peak"]) < 0.25
    assert full["errors"]["displacement"] < 0.45  # twelve modes do not swing as the body does
    deepest = int(np.argmax(full["force"][:, 0, 2]))
    assert full["force"][deepest, 0, 2] > 0.05
    assert full["positions"][deepest, :, 2].max() <= MIDDLE[2] + 0.002
    assert_refused(["replay", str(path), "--full"], "got 'view_scenes:block'", "--scene")
    assert_refused(["replay", str(path), "--full", "--scene", "os:getcwd"], "scene must be 'view_scenes:block'")
    assert_refused(["replay", str(path), "--scene", "view_scenes:block"], "add --full")
    assert main(["replay", str(path), "--full", "--scene", "view_scenes:block"]) == 0
    assert "largest force over the full model's" in capsys.readouterr().out
    replay = Replay(load_recording(path))
    assert replay.hello()["overlay"] is True
    drawn = replay.overlay(full["times"][deepest])
    np.testing.assert_array_equal(drawn.positions, full["positions"][deepest])
    np.testing.assert_array_equal(drawn.force, full["force"][deepest, 0])


@pytest.mark.slow
def test_replay_writes_pictures_and_films(recorded, tmp_path, assert_drawn, monkeypatch):
    import imageio.v3 as imageio

    path, _, _ = recorded
    picture, film = tmp_path / "press.png", tmp_path / "press.gif"
    monkeypatch.setattr("palpate.app.view.film.FRAME_RATE", 6.5 / float(load_recording(path).times[-1]))
    assert main(["replay", str(path), "--png", str(picture), "--movie", str(film), "--scalar", "stress"]) == 0
    assert_drawn(picture)
    frames = imageio.imread(film, index=None)
    assert 3 <= len(frames) <= 6  # those that are alike are one
    assert np.abs(frames[0].astype(float) - frames[len(frames) // 2]).max() > 50  # something moves


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # imageio's reader leaves pipes open
@pytest.mark.parametrize("suffix", [".mp4", ".webp"])
def test_replay_writes_films_by_ffmpeg(recorded, tmp_path, monkeypatch, suffix):
    import imageio.v3 as imageio

    pytest.importorskip("imageio_ffmpeg", reason="pip install 'palpate[film]'")
    path, film = recorded[0], tmp_path / f"press{suffix}"
    monkeypatch.setattr("palpate.app.view.film.FRAME_RATE", 6.5 / float(load_recording(path).times[-1]))
    assert main(["replay", str(path), "--movie", str(film)]) == 0
    frames = imageio.imread(film, index=None)
    assert len(frames) >= 6
    assert np.abs(frames[0].astype(float) - frames[len(frames) // 2]).max() > 50


def test_invalid_films_are_refused(recorded, tmp_path, assert_refused, monkeypatch):
    path = recorded[0]
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "imageio_ffmpeg", None)
        assert_refused(["replay", str(path), "--movie", str(tmp_path / "press.mp4")], "palpate[film]")
    assert_refused(["replay", str(path), "--movie", str(tmp_path / "press.avi")], ".gif", ".mp4")


def test_files_that_are_not_a_recording_are_refused(recorded, tmp_path, assert_refused):
    path, _, _ = recorded
    assert_refused(["replay", str(tmp_path / "none.h5")], "FILE.h5 must be an existing file")
    (tmp_path / "text.h5").write_text("hello")
    assert_refused(["replay", str(tmp_path / "text.h5")], "is not a palpate recording")
    content = path.read_bytes()
    (tmp_path / "cut.h5").write_bytes(content[: len(content) // 2])
    assert_refused(["replay", str(tmp_path / "cut.h5")], "is truncated", "record the session again")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.attrs["format"] = "another"
    assert_refused(["replay", str(tmp_path / "other.h5")], "is not a palpate recording")
    os.mkfifo(tmp_path / "pipe.h5")
    assert_refused(["replay", str(tmp_path / "pipe.h5")], "must be a regular file")


def test_an_older_recording_is_refused_with_the_remedy(recorded, tmp_path):
    own, older = (f"{FORMAT}\nversion {version}\n".encode() for version in (VERSION, 2))
    content = recorded[0].read_bytes()
    assert content.startswith(own)
    path = tmp_path / "older.h5"
    path.write_bytes(older + content[len(own) :])
    with pytest.raises(pt.FileFormatError, match=r"version 2.*record the session again"):
        load_recording(path)


def test_a_flipped_bit_is_refused_wherever_it_is(recorded, tmp_path):
    data, generator = recorded[0].read_bytes(), np.random.default_rng(5)
    for place in [0, 20, 511, 600, *generator.integers(len(data), size=60)]:
        changed = bytearray(data)
        changed[place] ^= 1 << int(generator.integers(8))
        (tmp_path / "damaged.h5").write_bytes(changed)
        with pytest.raises(pt.FileFormatError, match=r"damaged\.h5"):
            load_recording(tmp_path / "damaged.h5")


def header(name, value):
    return lambda header, arrays: header.update({name: value})


def entry(name, where, value):
    return lambda header, arrays: arrays[name].__setitem__(where, value)


def tool(**changes):
    return lambda header, arrays: header["tools"][0].update(changes)


LIES = {
    "a title that is a number": (header("title", 5), "title must be text"),
    "a title without end": (header("title", "x" * 500), "title must be text"),
    "no model": (header("model", None), "header must be that of a recording"),
    "tools that are a mapping": (header("tools", {}), "tools must be a list of tools"),
    "no tools": (header("tools", []), "tools must be a list of tools"),
    "a tool that is none": (header("tools", [{}]), "must be a tool"),
    "an unknown tool": (tool(kind="saw"), "must be a tool"),
    "a tool of an odd kind": (tool(kind=["sphere"]), "must be a tool"),
    "a tool without size": (tool(radius="big"), "radius of a tool must be a number"),
    "a tool without end": (tool(length=1e300), "length of a tool"),
    "a coupling that pulls": (tool(stiffness=-1.0), "stiffness of a tool"),
    "a tool that comes later": (tool(start=3), "must increase from 0"),
    "a tool after the end": (tool(start=10**6), "start of a tool"),
    "errors of a full model that was not run": (header("errors", {}), r"errors must have|array full/\w+ is missing"),
    "an array too many": (lambda header, arrays: arrays.update(colour=np.zeros(3)), "array colour is not one"),
    "no moments": (lambda header, arrays: arrays.update(wall=np.zeros(0)), "must have shape"),
    "a force that is not finite": (entry("tools/force", (2, 0, 1), np.nan), "array tools/force must be finite"),
    "a force without end": (entry("tools/force", (2, 0, 1), 1e30), "array tools/force must be finite, from -1e"),
    "moments of another model": (
        lambda header, arrays: arrays.update(coordinates=arrays["coordinates"][:, 1:]),
        "array coordinates must have shape",
    ),
    "fewer moments of one kind": (
        lambda header, arrays: arrays.update(trust=arrays["trust"][1:]), "array trust must have shape"
    ),
    "time before the start": (entry("time", 0, -1.0), "array time must be finite, from 0 to 1e"),
    "a clock without end": (entry("wall", -1, 1e6), "array wall must be finite, from 0 to 600 s"),
    "a clock that goes back": (entry("wall", 0, 9.0), "array wall must not decrease"),
    "half a step": (entry("steps", 0, 0.5), "steps must be whole numbers"),
    "no moduli": (entry("modulus_ratio", 3, 0.0), "array modulus_ratio must be finite, positive"),
    "a turn of no length": (entry("tools/quaternion", 3, 0.0), "tools/quaternion must be of length 1"),
    "an unknown state": (entry("state", 1, 9), "array state must be finite, from 0 to 3"),
    "spans that go back": (entry("contact/start", 1, 10**6), "contact/start must not decrease"),
    "places outside": (
        lambda header, arrays: arrays["contact/nodes"].__setitem__(0, 10**6), "contact/nodes must have indices from 0"
    ),
    "a model of another law": (
        lambda header, arrays: header["model"].update(material="__import__"), "unknown material '__import__'"
    ),
    "a model with other modes": (
        lambda header, arrays: header["model"].update(modes=3), "array basis_vectors must have shape"
    ),
    "a report that is text": (lambda header, arrays: header["model"].update(report="5"), "report is not a mapping"),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_forged_recordings_are_refused_even_with_right_checksums(recorded, tmp_path, forge, lie):
    change, message = LIES[lie]
    path = forge(recorded[0], change, FORMAT, VERSION, tmp_path / "lie.h5")
    with pytest.raises(pt.FileFormatError, match=rf"lie\.h5: .*{message}"):
        load_recording(path)


def active_tool(kind, code):
    def change(header, arrays):
        for each in header["tools"]:
            each["kind"] = kind if each["kind"] == "sphere" else each["kind"]
        arrays["tools/kind"][arrays["tools/kind"] > 0] = code

    return change


def slow(header, arrays):
    arrays["time"] *= 1e8


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (active_tool("group", 1), "tools of the snapshots must all be"),
        (active_tool("group", 4), "one prescribed group"),
        (active_tool("none", 1), "tools of the snapshots must all be"),
        (active_tool("sphere", 2), "tools of the snapshots must all be"),
        (slow, "at most 1200 s"),
    ],
)
def test_a_forged_tool_path_is_not_run_on_the_full_model(recorded, tmp_path, forge, change, message):
    path = forge(recorded[0], change, FORMAT, VERSION, tmp_path / "lie.h5")
    with pytest.raises(pt.InputError, match=message):
        replay_on_full_model(load_recording(path), block().model)


def test_viewers_get_finite_numbers_from_any_recording(recorded, tmp_path, forge):
    def change(header, arrays):
        arrays["coordinates"][:] = 1e9
        arrays["modulus_ratio"][:] = 1e9

    show = Replay(load_recording(forge(recorded[0], change, FORMAT, VERSION, tmp_path / "lie.h5")))
    for scalar in show.surface.scalars:
        body = state_body(show.surface, show.snapshot(), scalar)
        assert np.isfinite(np.frombuffer(body[:200], "<f8")).all()
        assert np.isfinite(np.frombuffer(body[200:], "<f4")).all()


def with_first(snapshot, **values):
    """The snapshot with other values of its first tool."""
    return replace(snapshot, tools=(replace(snapshot.tools[0], **values), *snapshot.tools[1:]))


SESSIONS = {
    "a title without end": lambda r, m: replace(r, title="x" * 255),
    "a title of odd characters": lambda r, m: replace(r, title="\0\udc80"),
    "a body far from its training": lambda r, m: replace(r, snapshots=[replace(each, trust=np.inf) for each in m]),
    "a week": lambda r, m: replace(
        r, snapshots=[replace(with_first(each, sequence=10**10), steps=10**10) for each in m]
    ),
    "a stiff body": lambda r, m: replace(r, snapshots=[with_first(each, stiffness=1e11 * np.eye(3)) for each in m]),
    "a reset": lambda r, m: replace(r, snapshots=[*m[:-1], replace(m[-1], time=0.0, steps=0)]),
    "one moment": lambda r, m: replace(
        r, snapshots=m[:1], times=r.times[:1], tools=[each for each in r.tools if each["start"] == 0]
    ),
}


@pytest.mark.parametrize("what", SESSIONS)
def test_recordings_of_every_kind_of_session_are_loaded(recorded, tmp_path, what):
    own = load_recording(recorded[0])
    save_recording(tmp_path / "own.h5", SESSIONS[what](own, own.snapshots))
    assert load_recording(tmp_path / "own.h5").snapshots


def test_exports_do_not_overwrite_the_recording(recorded, tmp_path, assert_refused):
    path = tmp_path / "press.vtkhdf"
    content = recorded[0].read_bytes()
    path.write_bytes(content)
    assert_refused(["replay", str(path), "--full"], "must not replace the recording")
    with pytest.raises(pt.InputError, match="vtkhdf"):
        save_recording(path, load_recording(path))
    (tmp_path / "press.png").symlink_to(path)
    assert_refused(["replay", str(path), "--png", str(tmp_path / "press.png")], "must not replace the recording")
    assert path.read_bytes() == content


@pytest.mark.parametrize("scene", ["evil_module:run", "os:system", "palpate.app.cli:main", "builtins:exec", "beam:x"])
def test_no_module_that_a_recording_names_is_imported(recorded, tmp_path, forge, assert_refused, monkeypatch, scene):
    (tmp_path / "evil_module.py").write_text("open('ran', 'w')\ndef run(): open('ran', 'w')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def change(header, arrays):
        report = {"scene": {"name": scene, "parameters": {"command": "touch ran"}}}
        header["model"]["report"] = json.dumps(report)

    path = forge(recorded[0], change, FORMAT, VERSION, tmp_path / "evil.h5")
    assert_refused(["replay", str(path), "--full"], "must be one of", "--scene")
    assert "evil_module" not in sys.modules
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("scene", "parameters", "message"),
    [
        ("beam", {}, "must be that of the model"),
        ("beam", {"spacing": 1e-9}, "spacing"),
        ("liver", {"depth": "deep"}, "depth"),
        ("liver", {"colour": 1}, "got 'colour'"),
    ],
)
def test_a_recording_that_names_another_body_is_refused(recorded, tmp_path, forge, scene, parameters, message):
    def change(header, arrays):
        header["model"]["report"] = json.dumps({"scene": {"name": scene, "parameters": parameters}})

    path = forge(recorded[0], change, FORMAT, VERSION, tmp_path / "other.h5")
    with pytest.raises(pt.InputError, match=message):
        full_model(load_recording(path).model)


def test_recordings_with_several_tools_are_not_run_on_the_full_model(recorded):
    from dataclasses import replace

    recording = load_recording(recorded[0])
    gone = [
        with_first(m, kind="none") if k == len(recording.snapshots) // 2 else m
        for k, m in enumerate(recording.snapshots)
    ]
    with pytest.raises(pt.InputError, match="released or changed"):
        replay_on_full_model(replace(recording, snapshots=gone), block().model)
    never = [with_first(moment, kind="none") for moment in recording.snapshots]
    with pytest.raises(pt.InputError, match="must have an active tool"):
        replay_on_full_model(replace(recording, snapshots=never), block().model)


# without a page


def test_a_script_moves_the_tool_of_a_session(model, tmp_path, capsys, assert_refused):
    pt.save(model, tmp_path / "block.rom")
    ball = {"type": "tool", "kind": "sphere", "radius": BALL, "position": ABOVE.tolist()}
    lines = [
        {"time": 0.0, **ball},
        {"time": 0.1, "type": "pose", "position": (ABOVE - np.array([0, 0, 0.005])).tolist()},
        {"time": 2.0, "type": "release"},
        {"time": 2.1, "type": "material", "name": "colour", "value": 1},
        {"time": 99.0, "type": "control", "action": "reset"},
    ]
    script = tmp_path / "script.jsonl"
    script.write_text("\n".join(map(json.dumps, lines)) + "\n\n")
    run = ["run", str(tmp_path / "block.rom"), "--out", str(tmp_path / "out")]
    record = tmp_path / "run.h5"
    assert main([*run, "--seconds", "3", "--script", str(script), "--json", "--record", str(record)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["tool"]["largest_force"] > 0.05
    assert told["tool"]["last_force"] == 0.0
    assert told["timing"]["periods"] > 100
    assert told["script"]["messages"] == 4
    assert [refused["time"] for refused in told["script"]["refused"]] == [2.1]
    assert max(moment.tools[0].force[2] for moment in load_recording(record).snapshots) > 0.05
    script.write_text('{"time": 0, "type": "pose"}\n')
    assert_refused([*run, "--script", str(script)], "line 1", "position must be given")
    assert_refused([*run, "--realtime"], "--script must be given for the model of a file")
    assert_refused(["view", str(tmp_path / "block.rom"), "--headless"], "use palpate run SCENE|FILE --script FILE")
    assert_refused(["view", "spleen"], "beam, liver")
