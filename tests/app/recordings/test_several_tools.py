"""Recordings of several tools: what is stored by index, files of version 3, forgeries, and replays."""

from __future__ import annotations

import asyncio
import gzip
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.app.recordings.recorded_paths import recorded_paths
from palpate.app.recordings.recording import FORMAT, VERSION, Recording, load_recording, save_recording
from palpate.app.recordings.recording_journal import RecordingJournal, is_recording
from palpate.app.recordings.snapshot import Snapshot, ToolSnapshot
from palpate.app.session.replay import Replay
from palpate.app.view.server.frames import force_frame, tools_frame
from palpate.dynamics.contact.tools import Contact, Grasp

OLD = Path(__file__).parent
COUNT, EVERY = 6, 0.01
SIZES = {"radius": 0.004, "length": 0.03, "toughness": 20.0, "friction": 0.2, "stiffness": None}


def tool(index, start, kind):
    return {"kind": kind, **SIZES, "index": index, "start": start}


TOOLS = [tool(0, 0, "sphere"), tool(1, 0, "none"), tool(1, 2, "grasp")]


@pytest.fixture(scope="module")
def body():
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45)
    return pt.Solid(pt.box((0.018, 0.018, 0.018), 0.006), tissue, fixed="z-")


def snapshot(body, k):
    """A snapshot at 10 ms times k: a ball presses, and forceps hold from the third snapshot on, pinned at the end."""
    tools = ToolSnapshot(
        force=np.array([0.0, 0.0, 1.0 + k]), moment=np.array([0.1, 0.0, 0.0]), stiffness=10.0 * np.eye(3),
        position=np.array([0.009, 0.009, 0.022 - 1e-3 * k]), quaternion=np.array([1.0, 0.0, 0.0, 0.0]), sequence=k,
        device_force=np.array([0.0, 0.0, 0.5]), kind="sphere",
    ), ToolSnapshot(
        force=np.array([0.0, 2.0 * k, 0.0]), moment=np.zeros(3), stiffness=20.0 * np.eye(3),
        position=np.array([0.0, 0.018, 0.018 + 1e-3 * k]), quaternion=np.array([0.0, 1.0, 0.0, 0.0]), sequence=3 * k,
        device_force=np.zeros(3), kind="grasp" if k > 1 else "none", pinned=k > 4,
    )  # fmt: skip
    return Snapshot(
        tools=tools, time=EVERY * k, steps=10 * k, trust=0.5, kinetic=0.0, strain=1e-6, computing=1e-4,
        lateness=0.0, coordinates=np.full(3 * len(body.cloud), 1e-4 * k, dtype=np.float32), state="running",
        contact_nodes=np.array([60, 61, 63]), contact_forces=np.full((3, 3), 0.01), contact_tools=np.array([0, 0, 1]),
        modulus_ratio=1.0,
    )  # fmt: skip


@pytest.fixture
def recording(body):
    return Recording("Block", body, EVERY * np.arange(COUNT), [snapshot(body, k) for k in range(COUNT)], TOOLS, {})


def assert_equal(snapshots, others):
    for one, other in zip(snapshots, others, strict=True):
        for first, second in zip((one, *one.tools), (other, *other.tools), strict=True):
            for field in fields(first):
                if field.name != "tools":
                    np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name), field.name)


def test_a_loaded_recording_has_all_tools_by_index(recording, tmp_path):
    save_recording(tmp_path / "two.h5", recording)
    loaded = load_recording(tmp_path / "two.h5")
    assert_equal(loaded.snapshots, recording.snapshots)
    assert loaded.tools == TOOLS
    assert [loaded.tool_at(frame, 1)["kind"] for frame in (0, 1, 2, 5)] == ["none", "none", "grasp", "grasp"]


def test_a_journal_keeps_all_tools(recording, tmp_path):
    journal = RecordingJournal(tmp_path / "two.h5", recording.title, recording.model)
    for k in range(0, COUNT, 2):
        tools = [each for each in TOOLS if each["start"] in (k, k + 1)]
        journal.add(recording.times[k : k + 2], recording.snapshots[k : k + 2], tools)
    journal.close()
    loaded = load_recording(tmp_path / "two.h5")
    assert_equal(loaded.snapshots, recording.snapshots)
    assert loaded.tools == TOOLS


@pytest.mark.slow
@pytest.mark.parametrize("name", ["version3.h5", "version3-journal.h5"])
def test_a_recording_of_version_3_is_loaded(tmp_path, name):
    """They were written by the program before recordings had several tools; the values are those of its maker."""
    path = tmp_path / name
    path.write_bytes(gzip.decompress((OLD / f"{name}.gz").read_bytes()))
    assert is_recording(path)
    loaded = load_recording(path)
    assert [moment.tools[0].kind for moment in loaded.snapshots] == ["none", "sphere", "sphere", "sphere"]
    assert [moment.tools[0].force[2] for moment in loaded.snapshots] == [0.0, 1.0, 2.0, 3.0]
    assert [len(moment.tools) for moment in loaded.snapshots] == [1] * 4
    np.testing.assert_array_equal(loaded.snapshots[3].tools[0].position, [0.01, 0.01, 0.03 - 3e-3])
    np.testing.assert_array_equal(loaded.snapshots[3].contact_tools, [0, 0])
    assert [(each["kind"], each["index"], each["start"]) for each in loaded.tools] == [("none", 0, 0), ("sphere", 0, 1)]
    save_recording(tmp_path / "again.h5", loaded)
    assert_equal(load_recording(tmp_path / "again.h5").snapshots, loaded.snapshots)
    assert Replay(loaded).hello()["max_tools"] == 1


def entry(name, where, value):
    return lambda header, arrays: arrays[name].__setitem__(where, value)


def tools(number, **changes):
    return lambda header, arrays: header["tools"][number].update(changes)


def five_tools(header, arrays):
    for name in [each for each in arrays if each.startswith("tools/")]:
        arrays[name] = np.repeat(arrays[name][:, :1], 5, axis=1)


LIES = {
    "a tool of index 4": (tools(0, index=4), "index of a tool must be"),
    "a tool of index 16": (tools(2, index=16), "index of a tool must be"),
    "half an index": (tools(0, index=0.5), "index of a tool must be"),
    "no tool of an index": (tools(1, index=0), "starts of tools of index 0 must increase"),
    "a tool that comes later": (tools(1, start=1), "starts of tools of index 1 must increase from 0"),
    "five tools": (five_tools, "array tools/.* must have shape"),
    "a contact of no tool": (entry("contact/tools", 0, 2), "contact/tools must have indices from 0 to 1"),
    "an unknown kind": (entry("tools/kind", (1, 1), 99), "array tools/kind must be"),
    "half a pose": (entry("tools/sequence", (1, 1), 0.5), "tools/sequence must be whole numbers"),
    "a turn of no length": (entry("tools/quaternion", (1, 1), 0.0), "tools/quaternion must be of length 1"),
    "a force that is not finite": (entry("tools/force", (1, 1, 0), np.nan), "tools/force must be finite"),
    "the arrays of version 3 as well": (
        lambda header, arrays: arrays.update(tool=np.zeros(COUNT, "|u1")), "array tools.* must have shape"
    ),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_forged_tools_are_refused_even_with_right_checksums(recording, tmp_path, forge, lie):
    change, message = LIES[lie]
    save_recording(tmp_path / "sound.h5", recording)
    path = forge(tmp_path / "sound.h5", change, FORMAT, VERSION, tmp_path / "lie.h5")
    with pytest.raises(pt.FileFormatError, match=rf"lie\.h5: .*({message})"):
        load_recording(path)


def test_each_tool_of_a_recording_has_a_path(recording):
    paths = recorded_paths(recording)
    assert [type(path.load) for path in paths] == [Contact, Grasp]
    assert paths[0].duration == pytest.approx((COUNT - 1) * EVERY)
    assert paths[1].duration == pytest.approx((COUNT - 3) * EVERY)  # from the third snapshot on
    np.testing.assert_allclose(paths[1].load.motion[1][0], [0.0, 0.018, 0.020])


def test_frames_of_tools_have_16_numbers_each(recording):
    shown = recording.snapshots[5]
    frame = tools_frame(shown.tools, 7)
    assert np.frombuffer(frame, "<u4", 4).tolist() == [8, 7, 2, 0]
    numbers = np.frombuffer(frame, "<f8", offset=16).reshape(2, 16)
    np.testing.assert_array_equal(
        numbers[1], [3, 1, 0, 10, 0, 0, 0, 0, *shown.tools[1].position, 0, 1, 0, 0, 15]
    )  # kind, pinned, force, moment, position, quaternion, sequence
    assert (numbers[0, 0], numbers[0, 1], numbers[0, 15]) == (1, 0, 5)
    for index, tool in enumerate(shown.tools):
        frame = force_frame(shown, 9, index)
        assert np.frombuffer(frame, "<u4", 4).tolist() == [4, 9, index, 0]
        numbers = np.frombuffer(frame, "<f8", offset=16)
        np.testing.assert_array_equal(numbers[2:5], tool.device_force)
        np.testing.assert_array_equal(numbers[17:20], tool.position)


def test_a_replay_shows_all_tools_to_version_3_and_the_first_one_to_version_2(recording, site_of):
    last = float(recording.times[-1])

    def statuses(client):
        return [each for each in client.messages if each["type"] == "status"]

    def at_last(client):
        return client.states and client.states[-1][1][0] == last

    def both_tools(client):  # of the frame that was received last: frames of tools come before the states
        shown = [(tool["kind"], tool["pinned"]) for tool in statuses(client)[-1]["all_tools"]]
        return shown == [("sphere", False), ("grasp", True)] and client.tools[-1][0] == client.states[-1][0]

    async def visit():
        site = site_of(Replay(recording))
        async with site.client(version=3) as new, site.client() as old:
            await new.say(type="replay", action="pause")
            await new.say(type="replay", action="seek", time=last)
            await new.hear_until(lambda c: at_last(c) and statuses(c) and both_tools(c))
            await old.hear_until(at_last)
            return new, old

    new, old = asyncio.run(visit())
    hello = new.messages[0]
    assert (hello["protocol"], hello["max_tools"]) == (3, 2)
    assert [tool["kind"] for tool in hello["all_tools"]] in (["sphere", "none"], ["sphere", "grasp"])  # it plays
    _, numbers = new.tools[-1]
    np.testing.assert_array_equal(numbers[1, 2:5], recording.snapshots[-1].tools[1].force)
    assert old.messages[0]["protocol"] == 2
    assert not old.tools
    assert not {"max_tools", "all_tools"} & {name for message in old.messages for name in message}
    np.testing.assert_array_equal(old.states[-1][1], new.states[-1][1])
