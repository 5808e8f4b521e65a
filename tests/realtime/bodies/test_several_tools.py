"""Several tools in the engine: forces of each, equal to those of runs, tool changes while others hold, one blade."""

from __future__ import annotations

import time

import numba
import numpy as np
import pytest

import palpate as pt
from palpate.compiled.reference import StoredRecord
from palpate.dynamics.contact.shapes import Capsule, Forceps, Punch, Sphere
from palpate.dynamics.nodal.period_data import BEHIND
from palpate.realtime.bodies.model import idle_model
from palpate.realtime.instrumented import make_instrumented
from palpate.realtime.period import Work

pytestmark = pytest.mark.slow

PERIOD, RADIUS, TOP = 1e-3, 0.01, 0.03


@pytest.fixture(scope="module")
def block():
    cloud = pt.box((0.06, 0.03, TOP), spacing=0.005)
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    return pt.Solid(cloud, tissue, fixed="z-", stiffness_damping=2e-4)


def ball(x, name, motion=None, friction=0.2):
    place = np.array([x, 0.015, TOP + RADIUS + 5e-4])
    moved = place if motion is None else lambda t: place + motion(t)
    return pt.tools.Contact(Sphere(RADIUS), moved, friction=friction, name=name)


def press(t):
    return np.array([0.0, 0.0, -0.03 * min(t, 0.12)])


def drag(t):
    return np.array([0.002 * np.sin(20 * t), 0.0, -0.02 * min(t, 0.15)])


def steps(model, *motions, periods=200):
    """Advance a model by periods while its tools move; return coordinates and the mean forces (periods, t, 3)."""
    work, forces, data = Work.at_rest(model.rest, model.tool), [], StoredRecord(model.data)
    for k in range(periods):
        for t, motion in enumerate(motions):
            work.target[12 * t : 12 * t + 3] = motion((k + 1) * PERIOD)
        model.advance(data, work.q, work.v, work.target, PERIOD, work.report)
        forces.append(work.report[8:].reshape(-1, 12)[:, :3].copy())
    return work.q, np.array(forces)


@pytest.mark.quick
def test_two_tools_in_the_engine_are_those_of_a_run(block):
    tools = [ball(0.015, "left", press), ball(0.045, "right", drag)]
    run = pt.rollout(block, tools, duration=0.2, every=0.01, progress=False)
    model = pt.realtime_model(block, contact=[ball(0.015, "left"), ball(0.045, "right")], scaled_modes=0)
    displacements, forces = steps(model, press, drag)
    error = np.abs(displacements.reshape(-1, 3) - run.displacements[-1]).max()
    assert error < 2e-3 * np.abs(run.displacements[-1]).max()
    for t, name in enumerate(("left", "right")):  # a run has the means since its frame before
        pushed = run.reactions[name][-1]
        assert np.linalg.norm(forces[-10:, t].mean(axis=0) - pushed) < 0.01 * np.linalg.norm(pushed)


def test_a_second_tool_that_touches_nothing_changes_no_bit(block):
    alone, forces = steps(pt.realtime_model(block, contact=ball(0.015, "left")), press)
    pair = idle_model(block, tools=2)
    pair.change_tool(Sphere(RADIUS), np.array([0.015, 0.015, TOP + RADIUS + 5e-4, 1, 0, 0, 0]), 0.2, 0)
    together, both = steps(pair, press, lambda t: np.zeros(3))
    np.testing.assert_array_equal(together, alone)
    np.testing.assert_array_equal(both[:, 0], forces[:, 0])
    assert not both[:, 1].any()


def test_tools_far_apart_push_as_they_do_alone_and_near_ones_do_not(block):
    alone = steps(pt.realtime_model(block, contact=ball(0.012, "left")), press)[1]
    far, near = (
        steps(pt.realtime_model(block, contact=[ball(0.012, "left"), ball(x, "right")]), press, press)[1]
        for x in (0.048, 0.033)
    )
    size = np.linalg.norm(alone[-1, 0])
    assert np.linalg.norm(far[-1, 0] - alone[-1, 0]) < 0.1 * size
    assert np.linalg.norm(near[-1, 0] - alone[-1, 0]) > 1.5 * np.linalg.norm(far[-1, 0] - alone[-1, 0])


def test_the_order_of_the_tools_does_not_matter(block):
    first = steps(pt.realtime_model(block, contact=[ball(0.015, "a"), ball(0.045, "b")]), press, drag)[1]
    second = steps(pt.realtime_model(block, contact=[ball(0.045, "b"), ball(0.015, "a")]), drag, press)[1]
    np.testing.assert_allclose(second[:, ::-1], first, atol=0.02 * np.abs(first).max())


def test_forceps_hold_while_another_tool_is_changed(block):
    model = idle_model(block, tools=3)
    point = np.array([0.045, 0.015, TOP])
    model.change_tool(Forceps(0.006, tuple(point)), np.array([*point, 1, 0, 0, 0]), 0.0, 1)
    work, data = Work.at_rest(model.rest, model.tool), StoredRecord(model.data)

    def lift(k):
        work.target[12:15] = (0.0, 0.0, 2e-5 * min(k, 200))
        model.advance(data, work.q, work.v, work.target, PERIOD, work.report)
        return work.report[8 + 12 : 8 + 15].copy()

    for k in range(1500):  # at rest again
        held = lift(k)
    assert held[2] > 0.05
    place = np.array([0.012, 0.015, TOP + RADIUS + 5e-3, 1, 0, 0, 0])  # clear of the body, which is lifted
    for tool in (Sphere(RADIUS), Capsule(RADIUS, 0.01), Punch(RADIUS), None):
        model.change_tool(tool, place if not isinstance(tool, Punch) else place - [0, 0, RADIUS, 0, 0, 0, 0], 0.0, 0)
        work.target[:12] = 0.0
        for k in range(20):
            after = lift(200 + k)
        assert after[2] == pytest.approx(held[2], rel=0.02)
    nodes = model.data.tools.grip.node[1, : model.data.tools.grip.numbers[1, 0]]
    np.testing.assert_allclose(work.q.reshape(-1, 3)[nodes], [[0.0, 0.0, 4e-3]] * len(nodes), atol=1e-9)


def test_momentum_of_a_free_body_between_two_tools_is_that_of_their_impulses():
    """What forceps and a ball next to them push is the change of momentum, also where they share patches."""
    cloud = pt.box((0.04, 0.03, 0.03), spacing=0.005)
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    free = pt.Solid(cloud, tissue, fixed=())
    model = idle_model(free, tools=2)
    point = np.array([0.03, 0.015, TOP])
    model.change_tool(Forceps(0.006, tuple(point)), np.array([*point, 1, 0, 0, 0]), 0.0, 0)
    model.change_tool(Sphere(RADIUS), np.array([0.014, 0.015, TOP + RADIUS + 2e-4, 1, 0, 0, 0]), 0.0, 1)
    work, masses = Work.at_rest(model.rest, model.tool), free.volumes * free.material.density
    impulse, data = np.zeros(3), StoredRecord(model.data)
    for k in range(120):
        work.target[:3] = (0.0, 0.0, 1e-5 * k)
        work.target[12:15] = (0.0, 0.0, -2e-5 * k)
        before = model.data.stepping[BEHIND]
        model.advance(data, work.q, work.v, work.target, PERIOD, work.report)
        seconds = PERIOD + before - model.data.stepping[BEHIND]  # of the steps that were taken
        impulse += seconds * work.report[8:].reshape(2, 12)[:, :3].sum(axis=0)
    momentum = masses @ work.v.reshape(-1, 3)
    assert np.abs(work.report[8 + 12 : 8 + 15]).max() > 0.01  # the ball presses
    np.testing.assert_allclose(momentum, impulse, atol=1e-6 * np.abs(impulse).max())


@pytest.mark.quick
def test_each_tool_has_its_own_force_stiffness_and_name(block):
    model = pt.realtime_model(block, contact=[ball(0.015, "left"), ball(0.045, "right")])
    until = time.monotonic() + 300.0  # compiles, and on a machine with other work
    with pt.Engine(model) as engine:
        for k in range(60):
            engine.set_pose((0.0, 0.0, -1e-4 * k), tool="left", sequence=k)
            engine.set_pose((0.0, 0.0, -5e-5 * k), tool=1, sequence=2 * k)
            steps = engine.read().steps
            while engine.read().steps < steps + 10 and time.monotonic() < until:
                time.sleep(0.001)
        arrived = engine.read().steps
        while engine.read().steps < arrived + 300 and time.monotonic() < until:
            time.sleep(0.01)
        reading = engine.read()
    left, right = reading.tools
    assert left.force[2] > 1.3 * right.force[2] > 0.0
    assert left.position[2] == pytest.approx(-5.9e-3)
    assert right.position[2] == pytest.approx(-2.95e-3)
    assert (left.sequence, right.sequence) == (59, 118)
    np.testing.assert_array_equal(reading.force, left.force)
    assert left.stiffness[2, 2] > 0.0


@pytest.mark.quick
@pytest.mark.parametrize("tool", ["middle", 2, -1, True, None])
def test_a_tool_that_is_not_there_is_named(block, tool):
    engine = pt.Engine(pt.realtime_model(block, contact=[ball(0.015, "left"), ball(0.045, "right")]))
    with pytest.raises(pt.InputError, match=r"number or name of a tool.*'left'.*'right'"):
        engine.set_pose((0.0, 0.0, 0.0), tool=tool)


@pytest.mark.quick
def test_bad_lists_of_tools_are_refused_in_a_line(block):
    left = ball(0.015, "left")
    blade = pt.tools.Blade(edge=[(-0.02, 0, 0), (0.02, 0, 0)], toughness=1.0)
    blades = [pt.tools.Contact(blade, (0.03, 0.015, z), name=f"blade {z}") for z in (0.05, 0.06)]
    for tools, message in (
        ([left, ball(0.045, "left")], "unique, got 'left' twice"),
        ([left, ball(0.02, "right")], "begin apart, got 'left' in 'right'"),
        ([ball(0.015 + 0.03 * k, str(k)) for k in range(16)], "at most 4 tools, got 16"),
        ([left, pt.tools.Contact(Sphere(RADIUS), (0.045, 0.015, TOP), name="in")], "outside the body"),
        (blades, "one Blade at most"),
        ([left, "right"], "must be one of"),
    ):
        with pytest.raises(pt.InputError, match=message):
            pt.realtime_model(block, contact=tools)


def test_a_second_blade_and_forceps_on_nodes_of_others_are_refused(block):
    blade = pt.tools.Blade(edge=[(-0.02, 0, 0), (0.02, 0, 0)], toughness=1.0)
    model = idle_model(block, tools=2)
    model.change_tool(blade, np.array([0.03, 0.015, 0.06, 1, 0, 0, 0]), 0.0, 0)
    with pytest.raises(pt.InputError, match="one Blade at most, got tool 0 as another"):
        model.change_tool(blade, np.array([0.03, 0.015, 0.08, 1, 0, 0, 0]), 0.0, 1)
    model.change_tool(Forceps(0.006, (0.03, 0.015, TOP)), np.array([0.03, 0.015, TOP, 1, 0, 0, 0]), 0.0, 0)
    with pytest.raises(pt.InputError, match="away from other forceps"):
        model.change_tool(Forceps(0.006, (0.034, 0.015, TOP)), np.array([0.034, 0.015, TOP, 1, 0, 0, 0]), 0.0, 1)


def test_couplings_of_two_tools_are_their_own(block):
    model = make_instrumented(pt.realtime_model(block, contact=[ball(0.015, "left"), ball(0.045, "right")]))
    model.set_coupling(200.0, index=1)
    work, data = Work.at_rest(model.rest, model.tool), StoredRecord(model.data)
    for k in range(300):
        for t in range(2):
            work.target[12 * t : 12 * t + 3] = (0.0, 0.0, -2e-5 * min(k, 200))
        model.advance(data, work.q, work.v, work.target, PERIOD, work.report)
    seen = model.observe()
    assert seen.tool_positions[0, 2] == pytest.approx(-4e-3)
    lag = seen.tool_positions[1, 2] + 4e-3  # a spring of 200 N/m carries the force
    assert seen.device_forces[1, 2] == pytest.approx(200.0 * lag, rel=0.05)
    assert lag > 1e-4
    assert set(seen.contact_tools) == {0, 1}


def test_forces_are_equal_for_any_number_of_threads(block):
    results = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        results.append(steps(pt.realtime_model(block, contact=[ball(0.015, "a"), ball(0.045, "b")]), press, drag))
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


def test_a_wound_opens_where_forceps_hold_it_under_tension():
    """Forceps pull to one side and stay; a blade cuts next to them: the cut opens, and they pull no harder."""
    cloud = pt.box((0.05, 0.04, 0.025), 5e-3, jitter=0.2)
    body = pt.Solid(cloud, pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45), fixed="z-")
    forceps = pt.tools.Grasp((0.012, 0.02, 0.025), 0.006, (0.012, 0.02, 0.025), name="forceps")
    across = (0.0, 0.0, np.pi / 2)
    blade = pt.tools.Blade([(-0.03, 0, 0), (0.03, 0, 0)], toughness=5.0)
    scalpel = pt.tools.Contact(blade, ((0.025, 0.02, 0.03), across), name="scalpel")
    model = pt.realtime_model(body, contact=[forceps, scalpel])
    top = cloud.points[:, 2] > 0.0225
    middle = top & (np.abs(cloud.points[:, 1] - 0.02) < 0.012)
    left = middle & (cloud.points[:, 0] > 0.018) & (cloud.points[:, 0] < 0.025)
    right = middle & (cloud.points[:, 0] > 0.025) & (cloud.points[:, 0] < 0.032)

    def opening(reading):
        moved = reading.coordinates.reshape(-1, 3)[:, 0]
        return moved[right].mean() - moved[left].mean()

    with pt.Engine(model) as engine:
        until = time.monotonic() + 300.0  # compiles, and on a machine with other work
        while model.cutter.cut_front is None and time.monotonic() < until:
            time.sleep(0.01)
        for k in range(60):
            engine.set_pose((-1e-4 * k, 0.0, 0.0), tool="forceps")
            time.sleep(0.01)
        time.sleep(0.5)
        before, began = engine.read(), time.monotonic()
        while model.cutter.totals[0] < 4e-4 and time.monotonic() < until:
            depth = min(0.017, 0.017 * (time.monotonic() - began) / 10.0)  # in 10 s
            engine.set_pose((0.0, 0.0, -depth), tool="scalpel")
            time.sleep(0.02)
        while opening(engine.read()) < 2 * opening(before) and time.monotonic() < until:
            time.sleep(0.02)
        after = engine.read()
        assert not model.cutter.failure
    assert model.cutter.totals[0] >= 4e-4
    assert after.tools[0].position[0] == pytest.approx(before.tools[0].position[0])  # they hold
    assert abs(after.tools[0].force[0]) < 1.05 * abs(before.tools[0].force[0])  # at rest it varies by 2 %
    assert opening(after) >= 2 * opening(before)


def test_a_blade_waits_before_nodes_that_forceps_hold():
    """Its tissue is not cut out of the forceps: the blade stays above, with a reason, and the engine goes on."""
    cloud = pt.box((0.05, 0.04, 0.025), 5e-3, jitter=0.2)
    body = pt.Solid(cloud, pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45), fixed="z-")
    place = (0.025, 0.02, 0.025)
    forceps = pt.tools.Grasp(place, 0.006, place, name="forceps")
    blade = pt.tools.Blade([(-0.03, 0, 0), (0.03, 0, 0)], toughness=5.0)
    scalpel = pt.tools.Contact(blade, ((*place[:2], 0.03), (0.0, 0.0, np.pi / 2)), name="scalpel")
    model = pt.realtime_model(body, contact=[forceps, scalpel])
    with pt.Engine(model) as engine:
        until = time.monotonic() + 300.0  # compiles, and on a machine with other work
        while model.cutter.cut_front is None and time.monotonic() < until:
            time.sleep(0.01)
        depth = 0.0
        while not model.cutter.failure and time.monotonic() < until:
            depth = min(depth + 1e-4, 0.02)
            engine.set_pose((0.0, 0.0, -depth), tool="scalpel")
            time.sleep(0.02)
        assert "holds" in model.cutter.failure
        engine.set_pose((0.0, 0.0, -0.02), tool="scalpel")
        before = engine.read()
        time.sleep(0.5)
        after = engine.read()
        assert engine.state == "running"
        assert after.steps > before.steps
        assert after.tools[1].position[2] > -0.012  # half a spacing below the place of the last cut, at most
        assert np.isfinite(after.coordinates).all()
        for k in range(100):  # out of the tissue
            engine.set_pose((0.0, 0.0, -0.01 + 1e-4 * k), tool="scalpel")
            time.sleep(0.01)
        assert engine.read().tools[1].position[2] > -0.005
