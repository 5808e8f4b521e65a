"""What an engine does with a body whose motion is known in closed form."""

from __future__ import annotations

import gc
import math
import time
import weakref

import h5py
import numpy as np
import pytest
from mass_spring import CONTACT, FAILS, FAULT, NOT_FINITE, RAISES, labour_of, mass_spring, stiffness
from numba import njit

import palpate as pt
from palpate.realtime.engine import Engine

SECONDS = 20.0  # to wait for what takes a fraction of one on an idle machine


def until(condition):
    """Wait until something is so."""
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.002)


def run_steps(engine, steps):
    """Let an engine take so many steps, or some more, and stop it."""
    aim = engine.read().steps + steps
    engine.start()
    until(lambda: engine.read().steps >= aim or engine.state != "running")
    engine.stop()


@pytest.fixture
def history(tmp_path):
    """A function that returns what an engine's black box holds, by name."""

    def read(engine):
        engine.dump(tmp_path / "flight.h5")
        with h5py.File(tmp_path / "flight.h5") as file:
            return {name: file[name][:] for name in list(file) if name != "tools"}

    return read


def test_the_engine_converges_to_the_equilibrium_of_the_springs(engine_of):
    engine = engine_of(damping=12.0, ground=100.0, contact=300.0, turn=2.0)
    angle = 0.2
    engine.set_pose((0.01, 0.0, -0.02), (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)))
    run_steps(engine, 300)
    reading, place = engine.read(), np.array([0.01, 0.0, -0.02])
    np.testing.assert_allclose(reading.coordinates[:3], 0.75 * place, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(reading.force, -75.0 * place, rtol=1e-6, atol=1e-12)  # pushes the hand back
    np.testing.assert_allclose(reading.moment, [0, 0, -2.0 * math.sin(angle) * math.cos(angle)], atol=1e-12)
    np.testing.assert_allclose(reading.stiffness, 300.0 * np.eye(3))
    np.testing.assert_allclose(reading.position, place)
    assert reading.time == pytest.approx(1e-3 * reading.steps)
    assert (reading.limited, reading.clamped, reading.state) == (False, False, "stopped")


def test_the_tools_work_becomes_energy(engine_of, history):
    engine = engine_of()
    engine.set_pose((0.02, -0.01, 0.005))
    run_steps(engine, 300)
    seen = history(engine)
    force = -np.vstack([np.zeros(3), seen["force"]])  # on the body
    way = np.diff(np.vstack([np.zeros(3), seen["position"]]), axis=0)
    work = np.cumsum(np.sum(0.5 * (force[1:] + force[:-1]) * way, axis=1))
    energy = seen["kinetic"] + seen["strain"]
    np.testing.assert_allclose(work, energy, atol=3e-3 * energy.max())
    assert seen["kinetic"].max() > 0.1 * energy.max()  # it swings
    assert np.ptp(energy[-100:]) < 1e-3 * energy.max()  # and goes on swinging with the tool at rest


def test_every_period_advances_the_body_by_a_period(engine_of, history):
    engine = engine_of(rate=500.0)
    run_steps(engine, 50)
    seen = history(engine)
    np.testing.assert_allclose(seen["time"], 2e-3 * np.arange(1, len(seen["time"]) + 1), rtol=1e-12)
    assert np.all(seen["iterations"] == 8)
    assert np.all(seen["lateness"] >= 0)
    assert np.all(seen["computing"] > 0)


def test_the_engine_is_never_ahead_of_the_clock(engine_of):
    engine = engine_of()
    before = time.monotonic()
    run_steps(engine, 300)
    passed = (engine.statistics().count + engine.statistics().dropped) * engine.period
    assert 300 * engine.period <= passed <= time.monotonic() - before


def test_the_statistics_count_the_steps(engine_of):
    engine = engine_of()
    run_steps(engine, 100)
    statistics = engine.statistics()
    assert statistics.count == engine.read().steps
    assert statistics.computing.counts.sum() == statistics.wakeup_latency.counts.sum() == statistics.count
    assert 0 < statistics.computing.percentile(50) <= statistics.computing.maximum
    assert statistics.is_real_time
    run_steps(engine, 10)
    assert engine.statistics().count == engine.read().steps - statistics.count  # since the last start


def test_a_model_that_is_too_slow_does_not_hold_its_rate(engine_of):
    engine = engine_of(rate=2000.0, labour=labour_of(2.5e-3))
    run_steps(engine, 40)
    statistics = engine.statistics()
    assert statistics.overrun > 0.9 * statistics.count
    assert statistics.missed >= statistics.overrun
    assert statistics.dropped > statistics.count  # several each
    assert not statistics.is_real_time
    assert "is not in real time" in statistics.status


def test_commands_may_be_given_twice(engine_of):
    engine = engine_of()
    engine.stop()
    engine.pause()
    engine.resume()
    assert engine.state == "stopped"
    for command, state in [
        ("start", "running"), ("resume", "running"), ("pause", "paused"), ("resume", "running"), ("pause", "paused"),
        ("start", "running"), ("reset", "running"), ("pause", "paused"), ("reset", "paused"), ("stop", "stopped"),
        ("reset", "stopped"), ("start", "running"), ("stop", "stopped"),
    ]:  # fmt: skip
        for _ in range(2):
            getattr(engine, command)()
            assert engine.state == engine.read().state == state, command


def test_a_pause_stops_the_motion_and_resuming_continues_it(engine_of):
    engine = engine_of()
    engine.set_pose((0.02, 0.0, 0.0))
    engine.start()
    until(lambda: engine.read().steps > 20)
    engine.pause()
    before, count = engine.read(), engine.statistics().count
    time.sleep(0.02)
    assert engine.read().steps == before.steps
    engine.resume()
    until(lambda: engine.read().steps > before.steps)
    engine.stop()
    assert engine.statistics().count == engine.read().steps > count


def test_a_reading_has_the_number_of_the_pose_of_its_force(engine_of, history):
    engine = engine_of()
    run_steps(engine, 5)
    assert engine.read().sequence == 0
    for number in (7, 9):
        engine.set_pose((1e-3 * number, 0.0, 0.0), sequence=number)
        run_steps(engine, 5)
        assert engine.read().sequence == number
    with pytest.raises(pt.InputError, match=r"sequence must be .*, got -1"):
        engine.set_pose((0.0, 0.0, 0.0), sequence=-1)
    run = history(engine)
    moved = np.linalg.norm(run["position"], axis=1) > 0
    np.testing.assert_array_equal(moved, run["sequence"] >= 7)  # it moves in the period that knows the pose
    engine.place_tool((0.0, 0.0, 0.0), sequence=11)
    assert engine.read().sequence == 11
    engine.reset()
    assert engine.read().sequence == 0


def test_a_reset_restores_rest(engine_of):
    engine = engine_of()
    engine.set_pose((0.02, 0.0, 0.0), (0.9, 0.1, 0.0, 0.0))
    run_steps(engine, 20)
    engine.reset()
    for steps in (0, 5):  # and there it stays
        run_steps(engine, steps) if steps else None
        reading = engine.read()
        assert steps <= reading.steps
        assert not np.any(reading.coordinates)
        assert not np.any(reading.velocities)
        assert not np.any(reading.force)
        np.testing.assert_array_equal(reading.quaternion, [1, 0, 0, 0])


def test_the_tool_keeps_its_speed_limits(engine_of, history):
    engine = engine_of(options={"max_speed": 0.5, "max_angular_speed": 3.0})
    engine.set_pose((0.03, 0.04, 0.0), (0.0, 1.0, 0.0, 0.0))
    run_steps(engine, 120)
    seen = history(engine)
    ways = np.linalg.norm(np.diff(seen["position"], axis=0), axis=1)
    cosines = np.abs(np.sum(seen["quaternion"][1:] * seen["quaternion"][:-1], axis=1))
    assert ways.max() == pytest.approx(0.5e-3, rel=1e-9)
    assert 2 * np.arccos(cosines.min()) == pytest.approx(3e-3, rel=1e-6)
    np.testing.assert_array_equal(seen["position"][-1], [0.03, 0.04, 0.0])


def test_the_force_is_limited_and_keeps_its_direction(engine_of):
    engine = engine_of(damping=12.0, options={"force_limit": 0.5})
    engine.set_pose((0.03, 0.04, 0.0), (math.cos(0.1), 0.0, 0.0, math.sin(0.1)))
    run_steps(engine, 300)
    reading = engine.read()
    assert reading.limited
    np.testing.assert_allclose(reading.force, [-0.3, -0.4, 0.0], rtol=1e-9)
    full = 75.0 * 0.05
    assert reading.moment[2] == pytest.approx(-2.0 * math.sin(0.2) * math.cos(0.2) * 0.5 / full, rel=1e-5)


def test_a_bad_pose_is_refused_and_the_last_one_kept(engine_of):
    engine = engine_of()
    engine.set_pose((0.002, 0.0, 0.0))
    for pose in [((np.nan, 0, 0),), ((0.0, 0, 0), (0, 0, 0, 0)), ((1.5, 0, 0),)]:
        with pytest.raises(pt.InputError, match="last pose is kept"):
            engine.set_pose(*pose)
    run_steps(engine, 5)
    np.testing.assert_array_equal(engine.read().position, [0.002, 0, 0])


def test_lost_trust_is_reported_once(engine_of):
    engine = engine_of(trusted=0.01)
    engine.set_pose((0.005, 0.0, 0.0))
    run_steps(engine, 20)
    assert engine.read().trust == pytest.approx(0.5)
    engine.set_pose((0.02, 0.0, 0.0))
    engine.start()
    with pytest.warns(RuntimeWarning, match="not trained") as told:
        until(lambda: engine.read().trust == pytest.approx(2.0))
    assert len(told) == 1
    assert not engine.read().clamped
    assert engine.state == "running"
    engine.set_pose((0.005, 0.0, 0.0))
    until(lambda: engine.read().trust == pytest.approx(0.5))
    assert engine.read().worst_trust == pytest.approx(2.0)
    engine.reset()
    assert engine.read().worst_trust < 0.5


def test_the_largest_trust_is_forgotten_when_the_body_is_at_rest_again(engine_of):
    """Not while it still vibrates: rest is 1e-4 of the largest energy of the motion."""
    engine = engine_of(trusted=0.01, damping=2.0, options={"out_of_training": "ignore"})
    engine.set_pose((0.02, 0.0, 0.0))
    run_steps(engine, 50)
    bad = engine.read()
    assert bad.worst_trust == pytest.approx(2.0)
    assert bad.largest_force > 0
    engine.set_pose((0.0, 0.0, 0.0))
    until_back = engine.read().steps + 30
    while engine.read().steps < until_back:
        run_steps(engine, 5)
        vibrating = engine.read()
        assert vibrating.worst_trust == pytest.approx(2.0)
    assert vibrating.kinetic + vibrating.strain > 0
    run_steps(engine, 1500)
    calm = engine.read()
    assert calm.kinetic + calm.strain < 1e-4 * (bad.kinetic + bad.strain)
    assert calm.worst_trust < 1.0
    assert calm.largest_force < 0.1 * bad.largest_force


def test_clamping_holds_the_tool_where_the_model_was_trusted(engine_of, history):
    engine = engine_of(trusted=0.01, options={"out_of_training": "clamp", "max_speed": 0.5})
    engine.set_pose((0.03, 0.0, 0.0))
    run_steps(engine, 60)
    reading, seen = engine.read(), history(engine)
    assert reading.clamped
    assert 0.0095 <= reading.position[0] <= 0.01
    assert reading.trust <= 1.0
    assert seen["trust"].max() <= 1.05 + 1e-9  # one period of 0.5 mm beyond, and back
    assert np.sum(seen["trust"] > 1.0) == 1  # and no trembling about it

    engine.set_pose((0.03, 0.02, 0.0))  # sideways, but still beyond
    run_steps(engine, 20)
    np.testing.assert_array_equal(engine.read().position, reading.position)

    engine.set_pose((0.004, 0.002, 0.0))  # back: it is free again
    run_steps(engine, 30)
    assert not engine.read().clamped
    np.testing.assert_array_equal(engine.read().position, [0.004, 0.002, 0.0])


def test_stopping_pauses_when_trust_is_lost_and_may_be_resumed(engine_of):
    engine = engine_of(trusted=0.01, options={"out_of_training": "stop", "max_speed": 0.5})
    engine.set_pose((0.03, 0.0, 0.0))
    engine.start()
    until(lambda: engine.state == "paused")
    paused = engine.read()
    assert 1.0 < paused.trust <= 1.05 + 1e-9
    engine.resume()  # and go on, as told
    until(lambda: engine.read().position[0] == 0.03)
    engine.set_pose((0.002, 0.0, 0.0))
    until(lambda: engine.read().position[0] == 0.002)
    assert engine.state == "running"
    engine.set_pose((0.03, 0.0, 0.0))
    until(lambda: engine.state == "paused")
    assert 1.0 < engine.read().trust <= 1.05 + 1e-9


@pytest.mark.parametrize("fault", [FAILS, NOT_FINITE, RAISES])
def test_the_periods_before_a_divergence_are_kept_and_written(fault, tmp_path, recwarn):
    body, box = mass_spring(), tmp_path / "flight.h5"
    engine = Engine(body, black_box=box)
    engine.set_pose((0.02, 0.0, 0.0))
    engine.start()
    until(lambda: engine.read().steps > 20)
    body.data[FAULT] = fault
    until(lambda: engine.state == "diverged")
    last = engine.read()
    assert last.state == "diverged"
    assert np.isfinite(last.coordinates).all()
    assert last.force[0] == pytest.approx(-300.0 * (last.coordinates[3] - last.coordinates[0]))
    with h5py.File(box) as file:
        good = file["failed"][:] == 0
        assert file["steps"][:][good][-1] == last.steps
        assert good.sum() >= len(good) - 1
        assert np.array_equal(file["coordinates"][:][good][-1], last.coordinates)
        assert good.all() == (fault == RAISES)  # else the last row is the failed step
    for command in (engine.start, engine.resume):
        with pytest.raises(pt.InputError, match=r"reset\(\)"):
            command()
    engine.stop()
    engine.pause()
    assert engine.state == "diverged"
    assert ("on purpose" in "".join(str(w.message) for w in recwarn)) == (fault == RAISES)

    body.data[FAULT] = 0.0
    engine.reset()
    assert engine.state == "stopped"
    run_steps(engine, 5)
    assert engine.state == "stopped"
    assert not np.any(engine.read().coordinates)


def test_a_black_box_that_cannot_be_written_is_reported(tmp_path):
    folder = tmp_path / "gone"
    folder.mkdir()
    body = mass_spring()
    engine = Engine(body, black_box=folder / "flight.h5")
    folder.rmdir()
    body.data[FAULT] = FAILS
    engine.start()
    until(lambda: engine.state == "diverged")
    with pytest.warns(RuntimeWarning, match="cannot write"):
        engine.read()


@pytest.mark.slow
def test_contact_stiffness_is_computed_at_the_given_interval(engine_of):
    never = engine_of(options={"stiffness_every": 0})
    run_steps(never, 5)
    assert not np.any(never.read().stiffness)
    body = mass_spring(contact=300.0)
    rarely = Engine(body, stiffness_every=1000)
    run_steps(rarely, 5)
    body.data[CONTACT] = 400.0
    run_steps(rarely, 5)
    np.testing.assert_allclose(rarely.read().stiffness, 300.0 * np.eye(3))
    without = Engine(body._replace(stiffness=None))
    run_steps(without, 2)
    assert not np.any(without.read().stiffness)


@pytest.mark.slow
def test_a_contact_stiffness_of_a_reading_has_no_negative_eigenvalue():
    """Whatever the model writes: a hand that multiplies by it would be pushed on."""
    engine = Engine(mass_spring(contact=-30.0))
    run_steps(engine, 3)
    np.testing.assert_array_equal(engine.read().stiffness, 0.0)


def test_other_python_threads_run_while_the_engine_steps(engine_of):
    """The loop computes all the time, and does not return: with Python's lock it would stop everything."""
    engine = engine_of(rate=20_000.0, labour=labour_of(1e-3))
    with engine:
        until(lambda: engine.read().steps > 2)
        count, start = 0, engine.read().steps
        while engine.read().steps < start + 50:
            count += 1
    assert count > 20
    assert not engine.statistics().is_real_time


def test_an_engine_without_references_ends_its_thread():
    engine = Engine(mass_spring())
    engine.start()
    thread = engine._runner._thread
    gone = weakref.ref(engine)
    del engine
    gc.collect()
    assert gone() is None
    thread.join(SECONDS)
    assert not thread.is_alive()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("rate", 0.0), ("rate", -1.0), ("rate", 20_001.0), ("rate", math.nan), ("force_limit", 0.0), ("history", 0.0),
        ("history", 1e4), ("max_speed", 0.0), ("max_angular_speed", -1.0), ("spin", 0.1), ("stiffness_every", -1),
        ("out_of_training", "nothing"), ("black_box", "/nowhere/at/all.h5"),
    ],
)  # fmt: skip
def test_arguments_out_of_range_are_refused(name, value):
    with pytest.raises(pt.InputError, match=name):
        Engine(mass_spring(), **{name: value})


def test_moduli_of_a_model_of_ones_own_are_not_adjustable():
    with pytest.raises(pt.InputError, match="realtime_model"):
        Engine(mass_spring(), adjustable=True)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"rest": np.full(7, np.nan)}, "rest"), ({"tool": np.zeros((4, 11))}, "tool"), ({"advance": len}, "numba"),
        ({"stiffness": len}, "numba"), ({"stiffness": njit(parallel=True)(stiffness.py_func)}, "parallel"),
    ],
)  # fmt: skip
def test_a_model_that_breaks_the_contract_is_refused(changed, said):
    with pytest.raises(pt.InputError, match=said):
        Engine(mass_spring()._replace(**changed))


def test_an_object_that_is_not_a_model_is_refused_with_its_missing_attributes():
    with pytest.raises(pt.InputError, match="advance, stiffness, data, rest, tool"):
        Engine(object())


def test_place_tool_moves_the_tool_at_once_and_slow_motion_slows_time(engine_of, history):
    engine = engine_of()
    run_steps(engine, 20)
    with pytest.raises(pt.InputError, match="finite"):
        engine.place_tool((math.nan, 0.0, 0.0))
    engine.place_tool((0.02, 0.0, 0.0))
    np.testing.assert_array_equal(engine.read().position, (0.02, 0.0, 0.0))
    engine.slow_down(0.1)
    before = engine.read()
    run_steps(engine, 50)
    after = engine.read()
    np.testing.assert_array_equal(after.position, (0.02, 0.0, 0.0))  # it did not travel there
    assert after.time - before.time == pytest.approx(1e-4 * (after.steps - before.steps), rel=1e-9)
    engine.set_pose((0.02, 0.01, 0.0))
    run_steps(engine, 10)
    way = np.diff(history(engine)["position"][:, 1])
    assert way.max() == pytest.approx(0.1 * 2.0 * 1e-3, rel=1e-9)  # the tool is as much slower
    with pytest.raises(pt.InputError, match="factor"):
        engine.slow_down(2.0)
    engine.start()
    with pytest.raises(RuntimeError, match="pause"):
        engine.place_tool((0.0, 0.0, 0.0))


def test_an_engine_prints_its_state_rate_and_status(engine_of):
    engine = engine_of()
    assert "no steps yet" in repr(engine)
    run_steps(engine, 20)
    line, reading = repr(engine), engine.read()
    for part in ("Engine(state=stopped, rate=1 kHz, ", " coordinates, time=", "in real time "):
        assert part in line
    for part in ("force=(", " N", "trust=", "engine=stopped"):
        assert part in repr(reading)
    assert "array(" not in line + repr(reading)
    assert max(len(line), len(repr(reading))) <= 160
