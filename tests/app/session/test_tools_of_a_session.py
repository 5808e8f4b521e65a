"""Several tools in one session: each presses or holds by itself, pinned or moved, and what is refused."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace

import numpy as np
import pytest
from view_scenes import MIDDLE, SIZE, block

import palpate as pt
from palpate.app.cli import main
from palpate.app.recordings.recording import load_recording
from palpate.app.session.full_model_replay import replay_on_full_model, tool_path
from palpate.app.session.messages import validate_message
from palpate.app.session.replay import Replay
from palpate.app.session.session import Session

RADIUS = 0.008
LEFT, RIGHT = (np.array([x, 0.024, SIZE[2] + RADIUS + 0.001]) for x in (0.013, 0.035))
DEPTH = np.array([0.0, 0.0, 0.003])  # from above the body into it


def send(session, **message):
    session.handle(validate_message(message))


def ball(session, index, position, **more):
    send(session, type="tool", kind="sphere", radius=RADIUS, index=index, position=list(position), **more)


def press(session, index, position):
    send(session, type="pose", index=index, position=list(position))


def forces(session):
    return np.array([tool.force for tool in session.snapshot().tools])


def kinds(session):
    return [tool.kind for tool in session.snapshot().tools]


def calm(session):
    snapshot = session.snapshot()
    return snapshot.steps > 300 and snapshot.kinetic < 1e-4 * snapshot.strain


@pytest.fixture
def two(session, until):
    """A session in which two balls press, one of index 0 on the left, and one of index 2 on the right."""
    ball(session, 0, LEFT)
    ball(session, 2, RIGHT)
    press(session, 0, LEFT - DEPTH)
    press(session, 2, RIGHT - 1.5 * DEPTH)

    def pressed():
        tools = session.snapshot().tools
        ends = (tools[0].position, LEFT - DEPTH), (tools[2].position, RIGHT - 1.5 * DEPTH)
        return all(np.allclose(place, end, atol=1e-6) for place, end in ends)

    until(lambda: pressed() and min(forces(session)[[0, 2], 2]) > 0.02 and calm(session))
    return session


@pytest.fixture(scope="module")
def full_body():
    return block().model


@pytest.fixture
def full_session(full_body):
    session = Session(full_body, "Full block")
    session.start()
    yield session
    session.close()


def test_each_tool_has_its_own_force_and_pose(two):
    snapshot = two.snapshot()
    assert kinds(two) == ["sphere", "none", "sphere", "none"]
    np.testing.assert_allclose(snapshot.tools[0].position, LEFT - DEPTH, atol=1e-6)
    np.testing.assert_allclose(snapshot.tools[2].position, RIGHT - 1.5 * DEPTH, atol=1e-6)
    assert snapshot.tools[2].force[2] > snapshot.tools[0].force[2]
    assert not forces(two)[[1, 3]].any()
    for index in (0, 2):  # the forces on the nodes are those on the tool, up to the sign
        pushes = snapshot.contact_forces[snapshot.contact_tools == index].sum(axis=0)
        np.testing.assert_allclose(-pushes, snapshot.tools[index].force, atol=0.05 * snapshot.tools[2].force[2])


def test_a_pinned_tool_keeps_pressing_while_another_is_moved_and_changed(two, until):
    before = forces(two)[0]
    send(two, type="pin", index=0, pinned=True)
    assert [tool["pinned"] for tool in two.status()["all_tools"]] == [True, False, False, False]
    with pytest.raises(pt.InputError, match="pose: index must be of a tool that is not pinned, got 0; unpin it first"):
        press(two, 0, LEFT)
    press(two, 2, RIGHT)
    send(two, type="tool", kind="capsule", radius=RADIUS, length=0.01, index=2, position=(RIGHT + 3 * DEPTH).tolist())
    until(lambda: not forces(two)[2].any() and calm(two))
    snapshot = two.snapshot()
    assert (snapshot.tools[0].pinned, snapshot.tools[2].kind) == (True, "capsule")
    np.testing.assert_allclose(snapshot.tools[0].position, LEFT - DEPTH, atol=1e-6)
    assert snapshot.tools[0].force[2] == pytest.approx(before[2], rel=0.3)  # the other one has left the body
    send(two, type="pin", index=0, pinned=False)
    press(two, 0, LEFT + DEPTH)
    until(lambda: not forces(two).any())


def test_forceps_hold_while_a_ball_presses(session, until):
    send(session, type="tool", kind="grasp", radius=RADIUS, index=1, position=[0.012, 0.024, SIZE[2]])
    held = session.snapshot().tools[1].position
    press(session, 1, held + DEPTH)
    until(lambda: forces(session)[1, 2] < -0.02 and calm(session))
    send(session, type="pin", index=1, pinned=True)
    ball(session, 0, RIGHT + DEPTH)
    press(session, 0, RIGHT - DEPTH)
    # the tool follows in some periods, and can be calm at its first touch
    until(lambda: np.allclose(session.snapshot().tools[0].position, RIGHT - DEPTH, atol=1e-6) and calm(session))
    assert forces(session)[0, 2] > 0.02
    moved = session.snapshot().displacements(session.surface)
    near = int(np.argmin(np.linalg.norm(session.surface.rest - held, axis=1)))
    np.testing.assert_allclose(moved[near], DEPTH, atol=2e-4)  # at the forceps
    pressed = int(np.argmin(np.linalg.norm(session.surface.rest - [*RIGHT[:2], SIZE[2]], axis=1)))
    assert moved[pressed, 2] < -0.001
    send(session, type="release", index=1)
    until(lambda: not forces(session)[1].any())
    assert kinds(session) == ["sphere", "none", "none", "none"]
    assert forces(session)[0, 2] > 0.01


def test_a_coupled_tool_is_not_pushed_when_another_is_put_down(session, until):
    """Its spring and damper go on: restarted at the tool, the stretched spring would give it a kick."""
    ball(session, 0, LEFT, stiffness=300.0)
    press(session, 0, LEFT - 2 * DEPTH)
    until(lambda: forces(session)[0, 2] > 0.02 and calm(session))
    before = session.snapshot().tools[0]
    assert np.linalg.norm(before.position - (LEFT - 2 * DEPTH)) > 1e-4  # the spring is stretched
    session.recordings.start(None)
    recorder = session.recordings.recorder
    until(lambda: len(recorder.snapshots) > 1)
    for _ in range(5):
        ball(session, 1, RIGHT + DEPTH)
        count = len(recorder.snapshots)
        until(lambda count=count: len(recorder.snapshots) > count)
    places = np.array([snapshot.tools[0].position for snapshot in recorder.snapshots])
    session.recordings.finish(wait=True)
    np.testing.assert_allclose(places, np.broadcast_to(before.position, places.shape), atol=1e-4)


@pytest.fixture(autouse=True)
def recordings_go_to_a_folder_of_the_test(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_release_puts_one_tool_away_and_a_reset_or_the_end_of_a_driver_all(two, until):
    send(two, type="pin", index=2, pinned=True)
    send(two, type="release", index=0)
    assert kinds(two) == ["none", "none", "sphere", "none"]
    press(two, 0, LEFT)  # the ball comes back
    assert kinds(two) == ["sphere", "none", "sphere", "none"]
    send(two, type="control", action="reset")
    assert kinds(two) == ["none"] * 4
    assert not any(tool.pinned for tool in two.snapshot().tools)
    assert not two.snapshot().displacements(two.surface).any()
    ball(two, 0, LEFT)
    send(two, type="pin", index=0, pinned=True)
    two.release()
    assert kinds(two) == ["none"] * 4
    assert not any(tool["pinned"] for tool in two.status()["all_tools"])


def test_a_tool_that_is_put_away_or_exchanged_in_a_pause_has_no_force(two):
    two.pause()
    send(two, type="release", index=0)
    send(two, type="tool", kind="capsule", radius=RADIUS, length=0.01, index=2, position=(RIGHT + 3 * DEPTH).tolist())
    snapshot = two.snapshot()
    assert kinds(two) == ["none", "none", "capsule", "none"]
    assert not forces(two).any()
    assert not len(snapshot.contact_nodes)
    assert not any(tool.device_force.any() or tool.stiffness.any() for tool in snapshot.tools)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"type": "pin", "index": 1, "pinned": True}, "pin: index must be of a tool that is put down, got 1"),
        ({"type": "tool", "kind": "sphere", "index": 1, "radius": RADIUS, "position": LEFT.tolist()},
         "clear of tool 0"),
        ({"type": "tool", "kind": "capsule", "index": 3, "radius": RADIUS, "position": (RIGHT + 7 * DEPTH).tolist()},
         "clear of tool 2"),
        ({"type": "tool", "kind": "sphere", "index": 1, "radius": 0.004, "position": [0.024, 0.024, 0.02]},
         "outside the body"),
        ({"type": "tool", "kind": "scalpel", "index": 1, "position": [0.024, 0.024, 0.05]}, "kind must be one of"),
    ],
)  # fmt: skip
def test_a_tool_in_another_one_or_in_the_body_is_refused_and_nothing_is_lost(two, message, said):
    with pytest.raises(pt.InputError, match=said) as refused:
        send(two, **message)
    assert "\n" not in str(refused.value)
    assert kinds(two) == ["sphere", "none", "sphere", "none"]
    assert min(forces(two)[[0, 2], 2]) > 0.01


def test_a_tool_does_not_come_back_inside_another_one(two):
    send(two, type="release", index=0)
    press(two, 0, RIGHT)
    assert kinds(two)[0] == "none"
    ball(two, 1, LEFT)
    press(two, 0, LEFT)
    assert kinds(two) == ["none", "sphere", "sphere", "none"]


def test_forceps_do_not_take_hold_of_what_others_hold(session):
    send(session, type="tool", kind="grasp", radius=RADIUS, index=0, position=MIDDLE.tolist())
    with pytest.raises(pt.InputError, match="clear of tool 0"):
        send(session, type="tool", kind="grasp", radius=RADIUS, index=1, position=[0.036, 0.024, SIZE[2]])
    send(session, type="tool", kind="grasp", radius=0.005, index=1, position=[0.006, 0.042, SIZE[2]])
    assert kinds(session)[:2] == ["grasp", "grasp"]


@pytest.mark.slow  # a blade compiles
def test_only_one_tool_is_a_scalpel(full_session):
    above = [0.024, 0.024, 0.045]
    send(full_session, type="tool", kind="scalpel", length=0.02, index=1, position=above)
    with pytest.raises(pt.InputError, match="only scalpel, got a second one; release tool 1 first"):
        send(full_session, type="tool", kind="scalpel", length=0.02, index=0, position=[0.024, 0.0, 0.06])
    with pytest.raises(pt.InputError, match="clear of tool 1"):  # a ball in the edge
        ball(full_session, 0, above)
    send(full_session, type="release", index=1)
    send(full_session, type="tool", kind="scalpel", length=0.02, index=0, position=above)
    press(full_session, 1, [0.024, 0.0, 0.06])  # the first scalpel does not come back
    assert kinds(full_session)[:2] == ["scalpel", "none"]


@pytest.mark.slow  # periods of a body that is held compile
def test_a_body_with_a_prescribed_group_has_one_tool(until):
    tissue = pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000.0, poisson=0.45)
    body = pt.Solid(pt.box((0.03, 0.015, 0.015), 0.005), tissue, "x-", form="energy")
    motion = pt.PrescribedMotion("x+", lambda points, time: np.array([0.1 * time, 0.0, 0.0]))
    run = pt.rollout(body, [motion], duration=0.01, every=0.001, progress=False)
    session = Session(pt.hyper_reduce(body, run, modes=3, prescribed="x+"), "Bar")
    session.start()
    try:
        assert session.hello()["max_tools"] == len(session.hello()["all_tools"]) == 1
        home = session.snapshot().tools[0].position
        press(session, 0, home + np.array([0.002, 0.0, 0.0]))
        until(lambda: session.snapshot().tools[0].force[0] < 0.0)
        send(session, type="pin", index=0, pinned=True)
        for message in ({"type": "pose", "index": 1, "position": [0, 0, 0]}, {"type": "release", "index": 3}):
            with pytest.raises(pt.InputError, match="index must be below 1 for this body"):
                send(session, **message)
        with pytest.raises(pt.InputError, match="not pinned"):
            press(session, 0, home)
        session.release()
        until(lambda: np.allclose(session.snapshot().tools[0].position, home, atol=1e-6))
    finally:
        session.close()


def test_a_new_session_of_the_body_keeps_the_selected_tools(two, model):
    other = Session(model, "Block")
    other.continue_from(two)
    try:
        assert [tool["kind"] for tool in other.status()["all_tools"]] == ["sphere", "none", "sphere", "none"]
        assert not any(tool["active"] for tool in other.status()["all_tools"])
        press(other, 2, RIGHT)
        assert kinds(other) == ["none", "none", "sphere", "none"]
    finally:
        other.close()


# clients


def test_a_client_of_version_3_moves_two_tools_and_one_of_version_2_sees_the_first(site, session, until):
    async def visit():
        async with site.client(version=3) as client, site.client() as old:
            for index, place in ((0, LEFT), (1, RIGHT)):
                await client.say(
                    type="tool", kind="sphere", radius=RADIUS, index=index, position=place.tolist(), sequence=1
                )
                await client.say(type="pose", index=index, position=(place - DEPTH).tolist(), sequence=2 + index)
            await client.say(type="force", rate=200, tools=[0, 1])
            await old.say(type="force", rate=200, tools=[1])
            await client.hear_until(lambda c: c.tools and min(c.tools[-1][1][:2, 4]) > 0.02)
            await client.say(type="pin", index=1, pinned=True)
            await client.hear_until(lambda c: c.tools[-1][1][1, 1] == 1)
            await client.say(type="pose", index=1, position=RIGHT.tolist())
            await client.told("error")
            await client.hear_until(lambda c: len(c.forces) > 20 and c.forces[-1][22] > 1)
            await client.hear_until(lambda c: c.tools[-1][0] == c.states[-1][0])  # a state follows its tools
            await old.hear_until(lambda c: len(c.forces) > 5 and c.states and c.states[-1][1][4] > 0.02)
            return client, old

    client, old = asyncio.run(visit())
    assert {sequence for sequence, _ in client.tools} == {state[0] for state in client.states}
    numbers = client.tools[-1][1]
    assert numbers.shape == (4, 16)
    assert numbers[:2, 0].tolist() == [1, 1]
    np.testing.assert_array_equal(numbers[0, 2:5], client.states[-1][1][2:5])
    assert numbers[:2, 15].tolist() == [2, 3]
    assert set(client.force_indices) == {0, 1}
    last = dict(zip(client.force_indices, client.forces, strict=True))
    assert last[1][17] > last[0][17] + 0.01  # x of the tools
    assert set(old.force_indices) == {0}
    assert not old.tools
    assert not any("all_tools" in message for message in old.messages)
    until(lambda: kinds(session) == ["none"] * 4)  # the driver has left, pinned tools too
    assert not any(tool.pinned for tool in session.tools)


def test_the_protocol_must_be_that_of_the_subprotocol(site):
    async def visit(subprotocol, protocol):
        from websockets.asyncio.client import connect
        from websockets.exceptions import ConnectionClosed

        async with connect(f"ws://127.0.0.1:{site.port}/session", subprotocols=subprotocol) as socket:
            await socket.send(json.dumps({"type": "hello", "protocol": protocol, "token": site.address.split("#")[1]}))
            try:
                return json.loads(await socket.recv())["protocol"]
            except ConnectionClosed as closed:
                return closed.rcvd.code, closed.rcvd.reason

    assert asyncio.run(visit(["palpate.v2", "palpate.v3"], 3)) == 3  # the newer of both
    code, reason = asyncio.run(visit(["palpate.v3"], 2))
    assert code == 4400
    assert reason == "protocol must be 3 of palpate.v3, got 2; reload the page"
    assert asyncio.run(visit(["palpate.v2"], 3))[0] == 4400


# recordings


@pytest.fixture(scope="module")
def recorded(model, tmp_path_factory, until):
    """A recording of two balls that press, one after the other, from rest."""
    path, session = tmp_path_factory.mktemp("two") / "two.h5", Session(model, "Block")
    session.start()
    session.recordings.start(path)
    recorder = session.recordings.recorder
    ball(session, 1, LEFT)
    ball(session, 0, RIGHT)
    for k in range(31):
        before = len(recorder.times)
        deep = 1.8 * DEPTH * np.sin(0.5 * np.pi * k / 30)
        press(session, 1, LEFT - deep)
        press(session, 0, RIGHT - 0.7 * deep)
        until(lambda before=before: len(recorder.times) > before)
    send(session, type="pin", index=1, pinned=True)
    count = len(recorder.times)
    until(lambda: len(recorder.times) > count + 2)
    seen = session.snapshot()
    session.close()
    return path, seen


def test_a_recording_of_two_hands_is_loaded_and_replayed(recorded):
    path, seen = recorded
    recording = load_recording(path)
    assert [tool["kind"] for tool in recording.tools if tool["start"] == 0][:1] == ["none"]
    last = recording.snapshots[-1]
    assert [tool.kind for tool in last.tools] == ["sphere", "sphere", "none", "none"]
    assert [tool.pinned for tool in last.tools] == [False, True, False, False]
    np.testing.assert_allclose(last.tools[1].position, seen.tools[1].position, atol=1e-6)
    show = Replay(recording)
    show.pause()
    show._seek(show.duration)
    assert [tool["kind"] for tool in show.status()["all_tools"]] == ["sphere", "sphere", "none", "none"]
    assert show.max_tools == 4


def test_the_full_model_has_nearly_the_same_forces_on_both_tools(recorded):
    recording = load_recording(recorded[0])
    part, tools = tool_path(recording)
    assert [tool["index"] for tool in tools] == [0, 1]
    full = replay_on_full_model(recording, block().model)
    shown = np.array([[tool.force for tool in snapshot.tools] for snapshot in recording.snapshots[part]])
    largest, reduced = full["force"][..., 2].max(axis=0), shown[..., 2].max(axis=0)
    assert largest[1] > 1.2 * largest[0] > 0.02  # deeper, and both of them press
    np.testing.assert_allclose(reduced[:2], largest[:2], rtol=0.5)
    assert not full["force"][:, 2:].any()
    assert full["errors"]["force"] < 0.3


def test_paths_that_the_full_model_cannot_follow_are_refused(recorded):
    recording = load_recording(recorded[0])
    count = len(recording.snapshots)

    def with_second(active):
        """The recording with the second tool where it is active."""
        snapshots = [
            replace(each, tools=(one, replace(two, kind="sphere" if active(k) else "none"), *more))
            for k, each in enumerate(recording.snapshots)
            for one, two, *more in (each.tools,)
        ]
        return replace(recording, snapshots=snapshots)

    first = tool_path(recording)[0].start
    assert tool_path(with_second(lambda k: first <= k < count - 5))[0].stop == count - 5  # the first release ends it
    with pytest.raises(pt.InputError, match="released or changed"):
        tool_path(with_second(lambda k: k >= first and k != count // 2))
    with pytest.raises(pt.InputError, match="tool 1 must be clear of the body until it is put down"):
        tool_path(with_second(lambda k: k >= count - 5))  # it stands where the body was before


@pytest.mark.slow
def test_pictures_show_both_tools(recorded, tmp_path):
    import imageio.v3 as imageio

    picture = tmp_path / "two.png"
    assert main(["replay", str(recorded[0]), "--png", str(picture)]) == 0
    pixels = imageio.imread(picture)[..., :3].astype(int)
    red, green, blue = (pixels[..., k] for k in range(3))
    assert np.count_nonzero((green > red + 30) & (blue > red + 30)) > 200  # the teal ball of index 1


def test_a_script_moves_two_tools(model, tmp_path, capsys):
    pt.save(model, tmp_path / "block.rom")
    lines = [
        {"time": 0.0, "type": "tool", "kind": "sphere", "radius": RADIUS, "position": LEFT.tolist()},
        {"time": 0.1, "type": "pose", "position": (LEFT - DEPTH).tolist()},
        {"time": 0.4, "type": "pin", "pinned": True},
        {"time": 0.5, "type": "tool", "kind": "sphere", "radius": RADIUS, "index": 1, "position": RIGHT.tolist()},
        {"time": 0.6, "type": "pose", "index": 1, "position": (RIGHT - DEPTH).tolist()},
        {"time": 0.7, "type": "pose", "position": LEFT.tolist()},
    ]
    (tmp_path / "script.jsonl").write_text("\n".join(map(json.dumps, lines)))
    record = tmp_path / "run.h5"
    run = ["run", str(tmp_path / "block.rom"), "--out", str(tmp_path / "out"), "--seconds", "1.5", "--json"]
    assert main([*run, "--script", str(tmp_path / "script.jsonl"), "--record", str(record)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [refused["time"] for refused in told["script"]["refused"]] == [0.7]  # it is pinned
    last = load_recording(record).snapshots[-1]
    assert [tool.force[2] > 0.02 for tool in last.tools] == [True, True, False, False]
