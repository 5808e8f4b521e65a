"""Full bodies in the engine: force, energy, momentum and limits of the period, against runs."""

from __future__ import annotations

import runpy
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.reference import StoredRecord
from palpate.dynamics.contact.tools import Forceps
from palpate.dynamics.nodal import period_data as nodal
from palpate.realtime.instrumented import make_instrumented

pytestmark = pytest.mark.slow

SIZE, SPACING, BALL = (0.03, 0.03, 0.02), 0.005, 0.012  # [m]
HOME = np.array([0.015, 0.015, SIZE[2] + BALL + 0.0005])
PERIOD = 1e-3  # [s]


def law(**more):
    return pt.materials.MooneyRivlin(C1=1e3, C2=0.0, density=1000.0, poisson=0.45, **more)


def depth(time: float) -> float:
    return 0.0045 * np.sin(np.pi * min(time / 0.3, 1.0)) ** 2


def ball(path) -> pt.tools.Contact:
    return pt.tools.Contact(pt.tools.Sphere(BALL), path, friction=0.3)


@pytest.fixture(scope="module")
def block() -> pt.Solid:
    return pt.Solid(pt.box(SIZE, SPACING), law(), "z-")


class Stepped:
    """A body in the periods of an engine, without its thread."""

    def __init__(self, body, contact=None, **options):
        self.model: Any = pt.realtime_model(body, contact=contact or ball(tuple(HOME)), **options)
        self.q, self.v = np.zeros((2, len(self.model.rest)))
        self.report, self.data = np.zeros(20), StoredRecord(self.model.data)

    def to(self, displacement, turn=None):
        rotation = np.zeros(9) if turn is None else (turn - np.eye(3)).ravel()
        target = np.concatenate([displacement, rotation])
        self.model.advance(self.data, self.q, self.v, target, PERIOD, self.report)
        return self.report.copy()

    def press(self, duration, path=depth):
        return np.array([self.to([0.0, 0.0, -path((k + 1) * PERIOD)]) for k in range(round(duration / PERIOD))])


@pytest.mark.quick
def test_the_force_of_a_slow_press_is_that_of_a_run(block):
    stepped = Stepped(block)
    reports = stepped.press(0.3)
    assert not reports[:, 0].any()
    path = lambda t: tuple(HOME - [0.0, 0.0, depth(t)])  # noqa: E731
    run = pt.rollout(block, [ball(path)], duration=0.3, every=0.01, progress=False)
    means = reports[:, 10].reshape(30, 10).mean(axis=1)
    force = run.reactions["tool"][1:, 2]
    assert np.abs(force).max() > 0.05
    # the body is behind the clock by less than a step of 0.7 ms, in which the force changes by up to 1.2 %
    np.testing.assert_allclose(means, force, atol=0.015 * np.abs(force).max())
    np.testing.assert_allclose(means.sum(), force.sum(), rtol=2e-3)
    scale = np.abs(run.displacements).max()
    pressed = Stepped(block)
    pressed.press(0.15)
    np.testing.assert_allclose(pressed.q.reshape(-1, 3), run.displacements[15], atol=0.015 * scale)


def test_a_body_at_rest_is_touched_in_periods_shorter_than_its_step(block):
    stepped, period = Stepped(block), 2e-4
    assert stepped.model.data.stepping[nodal.STEP] > 2 * period
    reports = []
    for k in range(500):
        target = np.zeros(12)
        target[2] = -depth(min((k + 1) * period, 0.1))
        stepped.model.advance(stepped.data, stepped.q, stepped.v, target, period, stepped.report)
        reports.append(stepped.report.copy())
    means = np.array(reports)[:, 10].reshape(10, 50).mean(axis=1)
    slower = Stepped(block).press(0.1)[:, 10].reshape(10, 10).mean(axis=1)
    np.testing.assert_allclose(means, slower, atol=0.02 * np.abs(slower).max())


@pytest.mark.parametrize(
    ("tool", "height"),
    [
        (pt.tools.Capsule(BALL, 0.03), BALL),
        (pt.tools.Plane(), 0.0),
        (pt.tools.Punch(0.008, 0.002), 0.0),
    ],
    ids=["capsule", "plane", "punch"],
)
def test_the_force_of_other_tools_is_that_of_a_run(block, tool, height):
    over = np.array([0.015, 0.015, SIZE[2] + height + 0.0005])
    turn = {"Capsule": (0.0, np.pi / 2, 0.0), "Plane": (np.pi, 0.0, 0.0)}.get(type(tool).__name__, (0.0, 0.0, 0.0))

    def path(time):
        return tuple(over - np.array([0.0, 0.0, 0.4 * depth(time)])), turn

    stepped = Stepped(block, pt.tools.Contact(tool, path(0.0), friction=0.2))
    reports = stepped.press(0.3, lambda t: 0.4 * depth(t))
    run = pt.rollout(block, [pt.tools.Contact(tool, path, friction=0.2)], duration=0.3, every=0.01, progress=False)
    force = run.reactions["tool"][1:, 2]
    assert np.abs(force).max() > 0.05
    means = reports[:, 10].reshape(30, 10).mean(axis=1)
    np.testing.assert_allclose(means.sum(), force.sum(), rtol=5e-3)
    np.testing.assert_allclose(means, force, atol=0.02 * np.abs(force).max())


def test_the_force_on_a_membrane_is_that_of_a_run():
    rubber = pt.materials.NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5)
    sheet = pt.Membrane(pt.disc(0.05, 0.005), rubber, 1e-3, "rim", prestretch=1.05)
    home = np.array([0.0, 0.0, BALL + 0.0005])
    path = lambda t: tuple(home - [0.0, 0.0, depth(t)])  # noqa: E731
    stepped = Stepped(sheet, ball(tuple(home)))
    means = stepped.press(0.3)[:, 10].reshape(30, 10).mean(axis=1)
    run = pt.rollout(sheet, [ball(path)], duration=0.3, every=0.01, progress=False)
    force = run.reactions["tool"][1:, 2]
    assert np.abs(force).max() > 0.1
    np.testing.assert_allclose(means, force, atol=0.01 * np.abs(force).max())


@pytest.mark.quick
def test_energies_are_those_of_the_body(block):
    stepped = Stepped(block)
    report = stepped.press(0.15)[-1]
    u, v = stepped.q.reshape(-1, 3), stepped.v.reshape(-1, 3)
    assert report[3] == pytest.approx(0.5 * block.masses @ np.sum(v**2, axis=1), rel=1e-12)
    assert report[4] == pytest.approx(block.strain_energy(u), rel=0.02)


@pytest.mark.quick
def test_a_body_at_rest_stays_at_rest_and_returns_to_it(block):
    stepped = Stepped(block)
    stepped.press(0.02, lambda t: 0.0)
    assert not stepped.q.any()
    stepped.press(0.15)
    first = stepped.model.data.energies.copy()
    stepped.q[:], stepped.v[:] = 0.0, 0.0  # what a reset of the engine does
    stepped.to(np.zeros(3))
    assert not stepped.q.any()
    assert stepped.model.data.energies[nodal.WORK] == 0.0 != first[nodal.WORK]


def test_steps_need_not_divide_the_period(block):
    stepped = Stepped(block)
    counts = stepped.press(0.2)[:, 2]
    stepping = stepped.model.data.stepping
    assert set(counts.tolist()) == {1.0, 2.0}
    assert 0.0 <= stepping[nodal.BEHIND] < stepping[nodal.STEP]
    assert counts.mean() * block.stability.step == pytest.approx(PERIOD, rel=0.15)


def test_equal_motions_give_equal_bits_for_any_number_of_threads(block):
    import numba

    results = []
    for threads in (1, numba.config.NUMBA_NUM_THREADS):
        before = numba.get_num_threads()
        numba.set_num_threads(threads)
        stepped = Stepped(block)
        results.append(stepped.press(0.05)[:, 10].tobytes() + stepped.q.tobytes())
        numba.set_num_threads(before)
    assert results[0] == results[1]


def test_storms_of_poses_leave_a_finite_body(block):
    stepped, rng = Stepped(block), np.random.default_rng(0)
    pose, aim = np.zeros(3), np.zeros(3)
    for k in range(2000):
        if k % 20 == 0:
            aim = rng.uniform([-0.02, -0.02, -0.012], [0.02, 0.02, 0.01])
        way = aim - pose
        pose = pose + way * min(1.0, 5e-4 / max(float(np.linalg.norm(way)), 1e-12))
        report = stepped.to(pose)
        assert np.isfinite(report).all()
        assert np.isfinite(stepped.q).all()


def test_a_period_with_too_long_steps_is_repeated_with_shorter_ones(block):
    stepped = Stepped(block)
    stepped.press(0.15)
    stepping = stepped.model.data.stepping
    stepping[nodal.FREQUENCY] /= 4
    stepping[nodal.UNTIL_ESTIMATE] = 1e9
    before = stepping[nodal.FREQUENCY]
    reports = stepped.press(0.05, lambda t: depth(0.15))
    assert not reports[:, 0].any()
    assert stepping[nodal.FREQUENCY] > 2 * before
    assert stepped.model.data.counts[nodal.REPEATED] > 0
    assert np.abs(stepped.q).max() < SIZE[2]


def test_a_drift_of_the_sums_of_work_stops_no_body(block):
    stepped, same = Stepped(block), Stepped(block)
    stepped.press(0.15)
    same.press(0.15)
    stepped.model.data.energies[nodal.GIVEN] -= 1.0  # J, after hours of presses
    drifted, still = (each.press(0.1, lambda t: depth(0.15)) for each in (stepped, same))
    assert not drifted[:, 0].any()
    assert stepped.model.data.energies[nodal.GAINED] == pytest.approx(1.0, rel=0.01)
    assert same.model.data.energies[nodal.GAINED] == 0.0
    assert drifted[20:, 2].max() <= 2 * still[:, 2].max()
    # that of the repeated period, too, whose steps are shorter
    np.testing.assert_allclose(drifted[[0, 1, -1], 10], still[[0, 1, -1], 10], rtol=0.03)


def test_a_force_without_a_step_is_that_of_the_last_one(block):
    """With half the modulus the body's time is slower, and some periods have no step."""
    made = make_instrumented(pt.realtime_model(block, contact=ball(tuple(HOME))))
    made.set_modulus_ratio(0.25)
    q, v = np.zeros((2, len(made.rest)))
    report, forces, steps = np.zeros(20), [], []
    for k in range(600):
        target = np.concatenate([[0.0, 0.0, -depth(min((k + 1) * PERIOD, 0.15))], np.zeros(9)])
        made.advance(made.data, q, v, target, PERIOD, report)
        forces.append(report[10])
        steps.append(report[2])
    assert 0.0 in steps[400:]
    late = np.abs(forces[400:])
    assert late.min() > 0.7 * late.max()


def test_relaxing_tissue_and_foundations_are_stepped():
    prony = pt.materials.Prony(shares=[1.0], times=[0.02])
    body = pt.Solid(pt.box(SIZE, SPACING), law(prony=prony), "z-")
    springs = pt.Foundation("x-", stiffness=1e6)
    stepped = Stepped(body, foundations=[springs])
    held = stepped.press(0.4, lambda t: depth(min(t, 0.15)))[:, 10]
    assert abs(held[-1]) < 0.95 * np.abs(held).max()  # the overstress has relaxed
    path = lambda t: tuple(HOME - [0.0, 0.0, depth(min(t, 0.15))])  # noqa: E731
    run = pt.rollout(body, [ball(path), springs], duration=0.4, every=0.02, progress=False)
    force = run.reactions["tool"][1:, 2]
    np.testing.assert_allclose(held.reshape(20, 20).mean(axis=1), force, atol=0.015 * np.abs(force).max())


@pytest.mark.quick
def test_another_tool_takes_the_place_of_the_first(block):
    stepped = Stepped(block)
    stepped.press(0.15)
    pose = np.concatenate([HOME + np.array([0.0, 0.0, 0.05]), [1.0, 0.0, 0.0, 0.0]])
    stepped.model.change_tool(pt.tools.Capsule(0.01, 0.02), pose, 0.0)
    assert not stepped.to(np.zeros(3))[8:11].any()  # it is above the body
    stepped.to([0.0, 0.0, -0.05])
    stepped.model.change_tool(None, pose, 0.0)
    assert not stepped.to([0.0, 0.0, -0.06])[8:11].any()
    with pytest.raises(pt.InputError, match="at least the spacing of the body, 5 mm"):
        stepped.model.change_tool(pt.tools.Sphere(0.004), pose, 0.0)


def test_the_least_radius_on_a_sheet_is_two_spacings():
    rubber = pt.materials.NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5)
    sheet = pt.Membrane(pt.disc(0.05, 0.01), rubber, 1e-3, "rim", prestretch=1.05)
    stepped = Stepped(sheet, pt.tools.Contact(pt.tools.Sphere(0.02), (0.0, 0.0, 0.03)))
    pose = np.array([0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0])
    with pytest.raises(pt.InputError, match="at least two spacings of the body, 20 mm"):
        stepped.model.change_tool(pt.tools.Sphere(0.015), pose, 0.0)


CORNER = np.array([0.03, 0.015, 0.02])
GRASP = pt.tools.Grasp(tuple(CORNER), 0.0051, tuple(CORNER))


def turned(angle):
    return np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])


@pytest.mark.quick
def test_a_slow_grasp_has_force_and_moment_of_a_run(block):
    lift, angle = lambda t: depth(t) * np.array([0.7, 0.0, 0.7]), lambda t: 40 * depth(t)
    stepped = Stepped(block, GRASP)
    reports = np.array([stepped.to(lift(t), turned(angle(t))) for t in PERIOD * np.arange(1, 301)])
    assert not reports[:, 0].any()
    moving = pt.tools.Grasp(tuple(CORNER), 0.0051, lambda t: (tuple(CORNER + lift(t)), (angle(t), 0.0, 0.0)))
    run = pt.rollout(block, [moving], duration=0.3, every=0.01, progress=False)
    force, means = run.reactions["grasp"][1:], reports[:, 8:11].reshape(30, 10, 3).mean(axis=1)
    assert np.abs(force).max() > 0.05
    np.testing.assert_allclose(means, force, atol=0.02 * np.abs(force).max())
    held = stepped.model.data.tools.grip.node[0, : stepped.model.data.tools.grip.numbers[0, 0]]
    at = block.cloud.points[held] + stepped.q.reshape(-1, 3)[held]
    share = 1 - stepped.model.data.stepping[nodal.BEHIND] / PERIOD  # of the last way; the body is behind the clock
    time = 0.299 + share * PERIOD
    wanted = (block.cloud.points[held] - CORNER) @ turned(angle(time)).T + CORNER + lift(time)
    np.testing.assert_allclose(at, wanted, atol=1e-6)
    balance = nodal_energy(stepped)
    assert balance == pytest.approx(block.strain_energy(stepped.q.reshape(-1, 3)), abs=1e-6)


def nodal_energy(stepped):
    energies = stepped.model.data.energies
    return energies[nodal.WORK] - energies[nodal.LOST] - energies[nodal.KINETIC_ENERGY]


def test_the_work_of_forceps_is_in_the_energy_balance(block):
    stepped = Stepped(block, GRASP)
    for t in PERIOD * np.arange(1, 151):
        stepped.to(depth(t) * np.array([0.7, 0.0, 0.7]), turned(40 * depth(t)))
    strain = block.strain_energy(stepped.q.reshape(-1, 3))
    assert strain > 1e-5
    assert nodal_energy(stepped) == pytest.approx(strain, rel=0.01)


def test_forceps_that_hold_still_dissipate_nothing():
    body = pt.Solid(pt.box(SIZE, SPACING), law(), "z-", mass_damping=8.0)
    stepped = Stepped(body, GRASP)
    for t in PERIOD * np.arange(1, 151):
        stepped.to(depth(t) * np.array([0.7, 0.0, 0.7]))
    lost = []
    for _ in range(1000):
        report = stepped.to(depth(0.15) * np.array([0.7, 0.0, 0.7]))
        lost.append(stepped.model.data.energies[nodal.LOST])
    strain = body.strain_energy(stepped.q.reshape(-1, 3))
    assert report[4] == pytest.approx(strain, rel=0.01)
    assert abs(lost[-1] - lost[-200]) < 1e-3 * strain
    assert stepped.model.data.counts[nodal.REPEATED] == 0


def test_a_tool_slides_with_friction_over_a_support_where_nothing_else_moves():
    body = pt.Solid(pt.box(SIZE, SPACING), law(), "z+")
    stepped = Stepped(body)
    for k in range(40):
        report = stepped.to([0.0, 0.0, -5e-5 * (k + 1)])
    assert report[10] < 0.0
    assert not stepped.q.any()
    held = stepped.model.data.tools.contacts.held
    assert held.energy[0] > 0.0
    assert report[4] == pytest.approx(held.energy[0], rel=1e-6)
    slides = [stepped.to([3e-4 * (k + 1), 0.0, -2e-3])[8:11] for k in range(10)]
    assert slides[-1][0] == pytest.approx(-0.3 * slides[-1][2], rel=0.3)  # the normals lean
    pose = np.array([*HOME, 1.0, 0.0, 0.0, 0.0])
    stepped.model.change_tool(None, pose, 0.0)
    assert stepped.to(np.zeros(3))[4] == pytest.approx(0.0, abs=1e-9)


def test_a_held_tool_reports_where_it_is_and_the_pose_follows():
    from palpate.realtime.pose import pose_of_coordinates, tool_coordinates

    rng, out = np.random.default_rng(0), np.zeros(12)
    for turn in (*rng.standard_normal((20, 4)), [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0], [1.0, 0, 0, 0]):
        pose = np.concatenate([rng.standard_normal(3), np.array(turn) / np.linalg.norm(turn)])
        tool_coordinates(np.eye(12)[None], pose[None], out)
        found = pose * [1, 1, 1, 1, 0.9, 1, 1]
        pose_of_coordinates(out, found)
        np.testing.assert_allclose(found, pose, atol=1e-7)


def test_an_engine_reports_the_place_of_a_held_tool(block, monkeypatch):
    engine = pt.Engine(pt.realtime_model(block, contact=ball(tuple(HOME))), max_speed=1.0, out_of_training="ignore")
    engine.set_pose((0.0, 0.0, -0.019))  # nearly through the block
    with engine:
        end = monotonic() + 300.0
        while engine.read().time < 0.3 and monotonic() < end:
            sleep(0.01)
        reading = engine.read()
    assert np.isfinite(reading.coordinates).all()
    assert engine.state == "stopped"
    assert -0.019 <= reading.position[2] < -0.005


def test_forceps_take_hold_of_strained_tissue_without_a_tug(block):
    stepped = Stepped(block)
    stepped.press(0.15)
    held = np.array([stepped.to([0.0, 0.0, -depth(0.15)]) for _ in range(300)])[-1, 10]
    assert abs(held) > 0.05
    corner = np.flatnonzero(np.linalg.norm(block.cloud.points - CORNER, axis=1) < 1e-9)[0]
    place = CORNER + stepped.q.reshape(-1, 3)[corner]
    before = stepped.q.copy()
    stepped.model.change_tool(Forceps(0.0051, CORNER, np.inf), np.array([*place, 1.0, 0, 0, 0]), 0.0)
    forces = [np.abs(stepped.to(np.zeros(3))[8:11]).max() for _ in range(3)]
    assert max(forces) < 0.1 * abs(held)
    grip = stepped.model.data.tools.grip
    nodes = grip.node[0, : grip.numbers[0, 0]]
    moved = np.abs(stepped.q - before).reshape(-1, 3)
    assert moved[nodes].max() < 1e-9 < moved.max()
    stepped.model.change_tool(None, np.array([*place, 1.0, 0, 0, 0]), 0.0)
    for _ in range(20):
        assert not stepped.to(np.zeros(3))[8:11].any()
    assert np.abs(stepped.q - before).reshape(-1, 3)[nodes].max() > 1e-5


@pytest.mark.quick
@pytest.mark.parametrize(
    ("forceps", "message"),
    [
        (pt.tools.Grasp((0.0, 0.0, 0.2), 0.005, (0.0, 0.0, 0.2)), "within 5 mm of a surface node"),
        (pt.tools.Grasp((0.0, 0.0, 0.0), 0.006, (0.0, 0.0, 0.0)), "away from supports"),
        (pt.tools.Grasp(tuple(CORNER), 0.006, tuple(CORNER), until=1.0), "must be infinite in the engine"),
    ],
)
def test_forceps_that_cannot_hold_are_refused(block, forceps, message):
    with pytest.raises(pt.InputError, match=message):
        pt.realtime_model(block, contact=forceps)


def test_contact_stiffness_is_the_slope_of_the_force(block):
    stepped, out, slopes = Stepped(block), np.zeros((12, 12)), []
    for k in range(500):
        report = stepped.to([0.0, 0.0, -0.004 * k / 500 - 0.0005])
        if k % 50 == 0:
            stepped.model.stiffness(stepped.model.data, stepped.q, out)
            slopes.append((0.004 * k / 500, report[10], out[2, 2]))
    z, force, stiffness = np.array(slopes).T
    slope = np.gradient(force, -z)
    assert slope[-1] > 20.0
    # ends of steps do not fall on those of periods: the ball is there by up to 2 % of its way later
    np.testing.assert_allclose(stiffness[4:], np.diff(force)[3:] / -np.diff(z)[3:], rtol=0.02)
    np.testing.assert_array_equal(out, out.T)
    for _ in range(2):  # the first period begins in contact
        stepped.to([0.0, 0.0, 0.05])
    stepped.model.stiffness(stepped.model.data, stepped.q, out)
    assert not out.any()


def test_sliding_nodes_count_in_the_stable_step():
    """A light node on a roller has the highest frequency of the body."""
    body = pt.Solid(pt.box(SIZE, SPACING), law(), pt.Roller("z-", normal=(0.0, 0.0, 1.0)))
    stepped = Stepped(body)
    stepping = stepped.model.data.stepping
    stepped.press(0.1)
    data = stepped.model.data
    sliding = data.body.sites.slide_of >= 0
    assert np.abs(data.iteration.vector[sliding, :2]).max() > 0.0
    assert not data.iteration.vector[sliding, 2].any()
    assert stepping[nodal.FREQUENCY] == pytest.approx(data.body.resting_frequency, rel=0.3)


@pytest.mark.quick
def test_an_engine_steps_a_full_body(block):
    engine = pt.Engine(pt.realtime_model(block, contact=ball(tuple(HOME))), out_of_training="ignore", max_speed=0.2)
    engine.set_pose((0.0, 0.0, -0.003))
    with engine:
        end = monotonic() + 300.0
        while engine.read().time < 0.1 and monotonic() < end:
            sleep(0.01)
    reading = engine.read()
    assert reading.force[2] > 0.0
    assert reading.trust == 0.0
    engine.reset()
    assert not engine.read().coordinates.any()


def test_the_force_at_rest_grows_with_the_moduli():
    """Statics: at one displacement of the tool, forces are proportional to the moduli."""
    block = pt.Solid(pt.box(SIZE, SPACING), law(), "z-", mass_damping=60.0)
    model = pt.realtime_model(block, contact=pt.tools.Contact(pt.tools.Sphere(BALL), tuple(HOME)))
    engine = pt.Engine(model, out_of_training="ignore", max_speed=0.2, adjustable=True)

    def step_to(time):
        end = monotonic() + 300.0
        while engine.read().time < time and monotonic() < end:
            sleep(0.01)
        return engine.read().force[2]

    engine.set_pose((0.0, 0.0, -0.003))
    with engine:
        soft = step_to(0.5)
        engine.set_modulus_ratio(2.0)
        assert engine.state == "running"
        assert step_to(1.1) == pytest.approx(2.0 * soft, rel=0.04)  # contact at rest varies by 2 %
        with pytest.raises(pt.InputError, match="ratio"):
            engine.set_modulus_ratio(0.0)


def test_moduli_of_tissue_that_relaxes_and_of_other_engines_are_not_changed(block):
    relaxing = pt.Solid(pt.box(SIZE, SPACING), law(prony=pt.materials.Prony(shares=[0.3], times=[0.05])), "z-")
    with pytest.raises(pt.InputError, match="relax"):
        pt.Engine(pt.realtime_model(relaxing, contact=ball(tuple(HOME))), adjustable=True)
    with pytest.raises(pt.InputError, match="adjustable=True"):
        pt.Engine(pt.realtime_model(block, contact=ball(tuple(HOME)))).set_modulus_ratio(2.0)


def test_the_example_prints_a_growing_force(capsys):
    runpy.run_path(str(Path(__file__).parents[3] / "examples" / "engine.py"))
    lines = capsys.readouterr().out.splitlines()
    forces = [float(line.split()[-2]) for line in lines[:-1]]
    assert len(forces) == 50
    assert max(forces) > 0.1
    assert forces[-1] > forces[10]


@pytest.mark.quick
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pt.realtime_model(pt.Solid(pt.box(SIZE, SPACING), law(), "z-")), "contact must be a Contact"),
        (
            lambda: pt.realtime_model(
                pt.Solid(pt.box(SIZE, SPACING), law(), "z-", form="strong"), contact=ball(tuple(HOME))
            ),
            "must have the energy form",
        ),
        (
            lambda: pt.realtime_model(
                pt.Solid(pt.box(SIZE, SPACING), law(), "z-"), contact=ball((0.015, 0.015, SIZE[2]))
            ),
            "must start outside the body",
        ),
    ],
)
def test_bodies_that_the_engine_cannot_step_are_refused(make, message):
    with pytest.raises(pt.InputError, match=message):
        make()
