"""Tool paths of recordings: where they begin and end, and the loads that they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.app.recordings.recorded_paths import recorded_paths
from palpate.app.recordings.recording import Recording
from palpate.app.recordings.snapshot import Snapshot, ToolSnapshot
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion

EVERY = 0.01
BALL = {"kind": "sphere", "radius": 0.004, "length": 0.0, "friction": 0.3, "stiffness": None, "index": 0, "start": 0}


@pytest.fixture(scope="module")
def model():
    tissue = pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000.0, poisson=0.45)
    body = pt.Solid(pt.box((0.03, 0.015, 0.015), 0.005), tissue, "x-", form="energy")
    motion = pt.PrescribedMotion("x+", lambda points, time: np.array([0.1 * time, 0.0, 0.0]))
    run = pt.rollout(body, [motion], duration=0.01, every=0.001, progress=False)
    return pt.hyper_reduce(body, run, modes=3, prescribed="x+")


def snapshot(k, tool="sphere", touching=True, trust=2.0, **values):
    """A snapshot at 10 ms times k, whose tool moves along x."""
    moved = ToolSnapshot(
        force=np.zeros(3), moment=np.zeros(3), stiffness=np.eye(3), position=np.array([0.1 * k, 0.0, 0.05]),
        quaternion=np.array([1.0, 0.0, 0.0, 0.0]), sequence=k, device_force=np.zeros(3), kind=tool,
    )  # fmt: skip
    still = Snapshot(
        time=EVERY * k, steps=k, trust=trust, kinetic=0.0, strain=0.0, computing=0.0, lateness=0.0,
        coordinates=np.zeros(9), state="running", contact_nodes=np.arange(2),
        contact_forces=np.full((2, 3), float(touching)), modulus_ratio=1.0, contact_tools=np.zeros(2, dtype=int),
        tools=(moved,),
    )  # fmt: skip
    return replace(still, **values)


def recording(model, snapshots, tools=(BALL,)):
    times = EVERY * np.arange(len(snapshots))
    return Recording("Bar", model, times, list(snapshots), list(tools), {})


def test_a_path_begins_just_before_the_touch(model):
    touching = [False] * 4 + [True] * 3 + [False] * 3 + [True] * 4 + [False]
    paths = recorded_paths(recording(model, [snapshot(k, touching=on, trust=k) for k, on in enumerate(touching)]))
    assert [path.trust for path in paths] == [6, 13]
    assert [path.duration for path in paths] == pytest.approx([3 * EVERY, 4 * EVERY])
    load = paths[0].load
    assert isinstance(load, Contact)
    assert load.tool.radius == BALL["radius"]
    assert load.friction == BALL["friction"]
    times, positions, _ = load.motion
    np.testing.assert_allclose(times, EVERY * np.arange(4), atol=1e-12)
    np.testing.assert_allclose(positions[1], [0.4, 0.0, 0.05], atol=1e-12)


def test_resets_and_changes_of_tools_end_a_path_and_short_touches_give_none(model):
    reset = [snapshot(k) for k in range(4)] + [snapshot(k) for k in range(3)]
    assert [path.duration for path in recorded_paths(recording(model, reset))] == pytest.approx([3 * EVERY, 2 * EVERY])
    larger = BALL | {"radius": 0.006, "start": 3}
    paths = recorded_paths(recording(model, [snapshot(k) for k in range(8)], [BALL, larger]))
    assert [path.load.tool.radius for path in paths] == [0.004, 0.006]
    assert not recorded_paths(recording(model, [snapshot(k) for k in range(2)]))
    assert not recorded_paths(recording(model, [snapshot(k, tool="none") for k in range(6)]))


def test_pauses_are_left_out_and_long_paths_are_cut(model):
    paused = [snapshot(k) for k in (0, 1, 2, 2, 2, 3)]
    assert recorded_paths(recording(model, paused))[0].duration == pytest.approx(3 * EVERY)
    long = [snapshot(100 * k) for k in range(30)]
    assert recorded_paths(recording(model, long))[0].duration == pytest.approx(10.0)


def test_paths_of_forceps_and_prescribed_groups_need_no_touch(model):
    forceps = BALL | {"kind": "grasp", "radius": 0.01}
    (path,) = recorded_paths(recording(model, [snapshot(k, tool="grasp", touching=False) for k in range(4)], [forceps]))
    assert isinstance(path.load, Grasp)
    (path,) = recorded_paths(
        recording(model, [snapshot(k, tool="group", touching=False) for k in range(4)], [BALL | {"kind": "group"}])
    )
    assert isinstance(path.load, PrescribedMotion)
    group = model.cloud.points[model.cloud.group("x+")]
    displacement = path.load.displacement
    np.testing.assert_allclose(displacement(group, 0.0), np.zeros_like(group), atol=1e-12)  # from rest
    first = np.array([0.0, 0.0, 0.05]) - group.mean(axis=0)
    np.testing.assert_allclose(displacement(group, 0.1), np.broadcast_to(first, group.shape), atol=1e-12)
    last = np.array([0.3, 0.0, 0.05]) - group.mean(axis=0)
    np.testing.assert_allclose(displacement(group, path.duration), np.broadcast_to(last, group.shape), atol=1e-12)
