"""Refinement of a session: a fake training drives it, then the real one on a small box."""

from __future__ import annotations

import asyncio
import json
import os
import queue
import re
import signal
import struct
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from view_scenes import BALL, MIDDLE, block
from websockets.asyncio.client import connect

from palpate.app.common.console import Console
from palpate.app.session.comparison import Comparison
from palpate.app.session.messages import validate_message
from palpate.app.session.session import Session, latest
from palpate.app.train.folder import manifest_of, open_campaign
from palpate.app.train.scene_folder import name_in_folder, training_folder
from palpate.app.view.command import view
from palpate.app.view.refinement import Refinement
from palpate.app.view.server.frames import STATE
from palpate.app.view.training_process import MIN_SHARE, Progress, TrainingProcess
from palpate.core.faults import InputError
from palpate.reduction.storage.models import save
from palpate.scenes.open_scene import json_of_scene, open_description, open_scene
from palpate.scenes.open_surface import complete_for_training
from palpate.scenes.training import open_training

GOOD, BAD = {"force": 0.07, "surface": 0.02}, {"force": 0.14, "surface": 0.02}
SCENE = """
[surface]
generated = "box"
size = [0.06, 0.06, 0.04]
[body]
spacing = 0.01
[[support]]
place = { side = "z-" }
[tool]
radius = 0.021
[training]
paths = 4
held_out = 1
modes = 8
grasps = 0.0
"""


class FakeTrainer:
    """A training whose events the test gives."""

    def __init__(self):
        self.given, self.stopped = queue.Queue(), False

    def events(self):
        while (event := self.given.get()) is not None:
            yield event

    def stop(self):
        self.stopped = True
        self.given.put({"failed": "stopped"})
        self.given.put(None)


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "box.toml").write_text(SCENE)
    return open_scene(tmp_path / "box.toml")


@pytest.fixture(scope="module")
def model_path(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.rom"
    save(model, path)
    return path


@pytest.fixture
def full(tmp_path):
    session = Session(block().model, "Block")
    session.recordings.folder = tmp_path
    session.start()
    yield session
    session.close()


@pytest.fixture
def refining(full, scene):
    """A refinement of the block, and the trainings that it starts."""
    trainers = []

    def train(_):
        trainers.append(FakeTrainer())
        return trainers[-1]

    made = Refinement(scene, full, Console(), train)
    yield made, trainers
    made.close()


def state(refinement):
    return refinement.message()["state"]


def finish(refinement, trainers, until, path, errors):
    refinement.handle({"action": "start"})
    until(lambda: trainers)
    trainers[-1].given.put({"trained": str(path), "errors": errors})
    trainers[-1].given.put(None)
    until(lambda: state(refinement) == "ready")


def test_the_time_left_falls_between_two_reports(refining, until, monkeypatch):
    refinement, trainers = refining
    refinement.handle({"action": "start"})
    until(lambda: trainers)
    trainers[0].given.put({"phase": "3 of 16 runs", "left": 100.0})
    until(lambda: refinement.message()["phase"] == "3 of 16 runs")
    assert refinement.message()["seconds_left"] in (99, 100)
    now = refinement._phase_began
    monkeypatch.setattr("palpate.app.view.refinement.monotonic", lambda: now + 40.0)
    message = refinement.message()
    assert message["seconds_left"] == 60
    assert message["fraction"] == pytest.approx(0.4, abs=0.02)
    monkeypatch.setattr("palpate.app.view.refinement.monotonic", lambda: now + 101.0)
    message = refinement.message()  # longer than it was expected to take
    assert (message["seconds_left"], message["fraction"]) == (None, None)


def test_a_good_model_takes_over_with_tool_speed_moduli_and_pause(refining, full, until, model_path):
    refinement, trainers = refining
    position = (MIDDLE + np.array([0, 0, BALL + 0.002])).tolist()
    full.handle(validate_message({"type": "tool", "kind": "sphere", "radius": BALL, "friction": 0.3,
                                  "position": position}))  # fmt: skip
    full.handle(validate_message({"type": "release"}))
    full.handle({"type": "speed", "factor": 0.5})
    modulus = 1.5e-3 * float(full.model.material.shear_modulus)
    full.handle({"type": "material", "name": "shear modulus", "value": modulus})
    full.pause()
    finish(refinement, trainers, until, model_path, GOOD)
    new = refinement.next_source()
    assert isinstance(new, Session)
    assert refinement.next_source() is None
    tool, status = new.status()["tool"], new.status()
    assert (tool["kind"], tool["radius"], tool["friction"], tool["active"]) == ("sphere", BALL, 0.3, False)
    assert (status["speed"], status["state"], new.body.is_full) == (0.5, "paused", False)
    assert new.modulus_ratio == pytest.approx(1.5)
    assert full.engine.state == "stopped"
    assert state(refinement) == "used"
    new.resume()
    new.handle(validate_message({"type": "pose", "position": position}))
    assert new.status()["tool"]["active"]


def test_a_model_waits_while_a_tool_touches_the_body(refining, full, until, model_path):
    refinement, trainers = refining
    above = MIDDLE + np.array([0, 0, BALL + 0.002])
    full.handle(validate_message({"type": "tool", "kind": "sphere", "radius": BALL, "position": above.tolist()}))
    pressed = (above - np.array([0, 0, 0.006])).tolist()
    full.handle(validate_message({"type": "pose", "position": pressed}))
    until(lambda: full.snapshot().tools[0].force[2] > 0)
    full._last_pose = -np.inf  # long ago: the force alone says that it touches
    finish(refinement, trainers, until, model_path, GOOD)
    assert refinement.next_source() is None
    full.release()
    assert refinement.next_source() is not None


def test_a_poor_model_is_used_only_if_it_is_accepted(refining, until, model_path):
    refinement, trainers = refining
    finish(refinement, trainers, until, model_path, BAD)
    assert refinement.next_source() is None
    assert refinement.message()["errors"] == BAD
    assert not refinement.message()["good"]
    refinement.handle({"action": "use"})
    assert refinement.next_source() is not None


def test_a_model_waits_behind_a_comparison_and_is_ready_again_after_another_body(refining, full, until, model_path):
    refinement, trainers = refining
    finish(refinement, trainers, until, model_path, GOOD)
    both = Comparison(block().model, block().model, "Block")
    both.continue_from(full)
    assert refinement.message() is None
    assert refinement.next_source() is None
    alone = Session(block().model, "Block")
    alone.continue_from(both)
    used = refinement.next_source()
    assert state(refinement) == "used"
    alone = Session(block().model, "Block")
    alone.continue_from(used)
    assert state(refinement) == "ready"
    again = refinement.next_source()
    assert again.engine.state == "running"
    assert again.model is used.model
    assert latest(full) is again
    assert state(refinement) == "used"


def test_a_poor_model_is_accepted_for_one_time(refining, until, model_path):
    refinement, trainers = refining
    finish(refinement, trainers, until, model_path, BAD)
    refinement.handle({"action": "use"})
    alone = Session(block().model, "Block")
    alone.continue_from(refinement.next_source())
    assert state(refinement) == "ready"
    assert refinement.next_source() is None
    alone.close()


def test_a_model_of_unmeasured_errors_does_not_take_over(refining, until, model_path):
    refinement, trainers = refining
    finish(refinement, trainers, until, model_path, {})
    assert refinement.next_source() is None


def test_a_failed_training_keeps_the_full_body_and_may_start_again(refining, full, until):
    refinement, trainers = refining
    refinement.handle({"action": "start"})
    until(lambda: trainers)
    trainers[0].given.put({"failed": "organ.palpate is in use by a campaign that runs"})
    trainers[0].given.put(None)
    until(lambda: state(refinement) == "failed")
    assert "in use" in refinement.message()["note"]
    assert full.engine.state == "running"
    refinement.handle({"action": "start"})
    until(lambda: len(trainers) == 2)
    assert state(refinement) == "training"


def test_a_stopped_training_says_nothing_about_the_next(refining, until):
    refinement, trainers = refining
    refinement.handle({"action": "start"})
    until(lambda: trainers)
    refinement.handle({"action": "stop"})
    assert trainers[0].stopped
    assert state(refinement) == "offered"
    refinement.handle({"action": "start"})
    until(lambda: len(trainers) == 2)
    assert state(refinement) == "training"


@pytest.mark.parametrize("action", ["stop", "use"])
def test_actions_of_another_state_are_refused(refining, action):
    with pytest.raises(InputError, match=f"got '{action}'"):
        refining[0].handle({"action": action})


def test_viewers_stay_and_a_recording_is_saved_when_the_model_takes_over(refining, full, until, model_path, site_of):
    refinement, trainers = refining
    site = site_of(full)
    site.loop.call_soon_threadsafe(site.server.show, full, {"refine": refinement})

    async def visit():
        async with site.client() as client:
            await client.told("refinement", state="offered")
            await client.say(type="record", action="start")
            await client.told("status", recording=True)
            await client.say(type="refine", action="start")
            await client.told("refinement", state="training")
            await client.hear_until(lambda c: c.states)
            trainers[0].given.put({"trained": str(model_path), "errors": GOOD})
            trainers[0].given.put(None)
            used = await client.told("refinement", state="used")
            recorded = await client.told("recorded")
            count = len(client.states)
            await client.hear_until(lambda c: len(c.states) > count + 5)
            hellos = [message for message in client.messages if message["type"] == "hello"]
            return hellos, used, recorded, hellos[-1]["driver"]

    hellos, used, recorded, drives = asyncio.run(visit())
    assert [hello["full"] for hello in hellos] == [True, False]
    assert "recording ended" in used["note"]
    assert recorded["frames"] > 0
    assert drives


def test_only_the_driver_starts_a_refinement(refining, full, site_of):
    site = site_of(full)
    site.loop.call_soon_threadsafe(site.server.show, full, {"refine": refining[0]})

    async def visit():
        async with site.client(), site.client() as second:
            await second.say(type="refine", action="start")
            return await second.told("error")

    assert "driver" in asyncio.run(visit())["reason"]
    assert not refining[1]


def test_a_session_without_refinement_refuses_it(site):
    async def visit():
        async with site.client() as client:
            await client.say(type="refine", action="start")
            return await client.told("error")

    assert "refine must be left out" in asyncio.run(visit())["reason"]


# the process


def test_the_time_left_counts_the_training_after_the_runs():
    seconds, events = [0.0], []
    progress = Progress(events.append, lambda: seconds[0])
    progress.phase("preparing")
    progress.runs(0.0, "0 of 4 runs")
    seconds[0] = 10.0
    progress.runs(0.25, "1 of 4 runs")
    progress.runs(0.5 * MIN_SHARE, "too early")
    first, begun, later, early = events
    assert [first["left"], begun["left"], early["left"]] == [None, None, None]
    assert later["left"] > 30.0  # three runs, and the training


def test_a_surface_has_one_folder_from_wherever_it_is_opened(tmp_path, monkeypatch):
    (tmp_path / "organ.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1))
        + "".join(f"f {face}\n" for face in ("1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2", "3 4 8", "3 8 7",
                                              "1 3 7", "1 7 5", "2 6 8", "2 8 4"))
    )  # fmt: skip
    monkeypatch.chdir(tmp_path)
    near, far = (complete_for_training(open_scene(name)) for name in ("organ.obj", tmp_path / "organ.obj"))
    assert training_folder(near) == training_folder(far)
    assert training_folder(near).parent == tmp_path / "organ.palpate"
    assert 3000 < 1e-3 * 1.45 / near.description.body.spacing**3 < 5000
    parameters = {"description": json_of_scene(near)}
    assert open_description(near.name, parameters["description"]).digest == near.digest


def test_a_scene_of_a_description_is_opened_by_workers(scene):
    changed = scene.with_body(spacing=0.008)
    made = open_training(changed.name, {"description": json_of_scene(changed)})
    assert made.model.cloud.spacing == pytest.approx(0.008, rel=0.05)
    assert made.parameters["description"] == json_of_scene(changed)


def run(process):
    return list(process.events())


@pytest.mark.slow
def test_a_box_is_trained_in_a_process_and_at_once_the_second_time(scene):
    for _ in range(2):
        process = TrainingProcess(complete_for_training(scene))
        events = run(process)
        process.stop()
        assert "trained" in events[-1], events[-1]
        assert set(events[-1]["errors"]) == {"force", "surface"}
    assert not any("runs" in event.get("phase", "") for event in events)  # of the second time


@pytest.mark.slow
def test_a_folder_in_use_is_a_message(scene):
    scene = complete_for_training(scene)
    manifest = manifest_of(
        name_in_folder(scene.name, training_folder(scene)),
        open_training(scene.name, {}),
        scene.description.training.seed,
    )
    with open_campaign(training_folder(scene), manifest):
        process = TrainingProcess(scene)
        events = run(process)
        process.stop()
    assert "in use" in events[-1]["failed"]


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "nice"), reason="needs a process that can be killed, and its descendants")
def test_a_training_and_its_workers_end_with_a_killed_parent(scene, until):
    code = (
        "import sys; from palpate.scenes.open_scene import open_scene\n"
        "from palpate.app.view.training_process import TrainingProcess\n"
        "process = TrainingProcess(open_scene(sys.argv[1]))\n"
        "for event in process.events():\n"
        "    print(process._child.pid, event.get('phase'), flush=True)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, scene.name], stdout=subprocess.PIPE, text=True)
    for line in parent.stdout:
        pid, _, phase = line.partition(" ")
        if "runs" in phase:
            break
    until(lambda: children(int(pid)))
    group = {int(pid), *children(int(pid))}
    assert os.getpriority(os.PRIO_PROCESS, int(pid)) == 19
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    until(lambda: not any(is_running(each) for each in group))


@pytest.mark.slow
def test_the_command_changes_over_and_ends_its_training_at_an_interrupt(scene, tmp_path):
    words = [sys.executable, "-m", "palpate", "view", scene.name, "--refine", "--no-browser", "--port", "18800"]
    command = subprocess.Popen(
        words,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # which the background ignores
    )
    said = []
    for line in command.stderr:
        said.append(line)
        if address := re.search(r"http://(\S+)/#(\S+)", line):
            break
    reading = threading.Thread(target=lambda: said.extend(command.stderr))
    reading.start()

    async def visit():
        """Return whether each body that is shown is a full one, until the state of the refinement is the last."""
        full, end = [], time.monotonic() + 300.0
        async with connect(f"ws://{address[1]}/session", subprotocols=["palpate.v2"], max_size=None) as socket:
            await socket.send(json.dumps({"type": "hello", "protocol": 2, "token": address[2]}))
            while time.monotonic() < end:
                message = await asyncio.wait_for(socket.recv(), 200.0)
                if isinstance(message, bytes):
                    kind, sequence = struct.unpack("<2I", message[:8])
                    if kind == STATE:
                        await socket.send(json.dumps({"type": "ack", "sequence": sequence}))
                    continue
                message = json.loads(message)
                if message["type"] == "hello":
                    full.append(message["full"])
                if message["type"] == "refinement" and message["state"] == "ready" and not message["good"]:
                    await socket.send(json.dumps({"type": "refine", "action": "use"}))
                if message["type"] == "refinement" and message["state"] in ("used", "failed"):
                    return full, message
        raise AssertionError("".join(said))

    try:
        full, last = asyncio.run(visit())
    finally:
        command.send_signal(signal.SIGINT)
        code = command.wait(300)
        reading.join()
        command.stderr.close()
    assert last["state"] == "used", "".join(said)
    assert full == [True, False]
    assert code == 0, "".join(said)
    assert (training_folder(scene) / "model.rom").is_file()


@pytest.mark.parametrize(("source", "reduced"), [("liver", True), ("membrane", False)])
def test_nothing_but_a_shown_full_solid_is_refined(source, reduced):
    with pytest.raises(InputError, match="refine must be left out"):
        view(source, refine=True, reduced=reduced, browser=False)


def children(pid):
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False)
    return {int(each) for each in listed.stdout.split()}


def is_running(pid):
    listed = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False)
    return bool(listed.stdout.strip()) and not listed.stdout.startswith("Z")
