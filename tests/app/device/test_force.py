"""The force on a hand: local contact model, age of readings, ramp, and the energy that it may take."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palpate.app.device.force import (
    MAX_DAMPING,
    MAX_PREDICTION,
    MAX_PULL,
    RAMP_SECONDS,
    PassivityObserver,
    ToolForce,
    Watchdog,
    contact_force,
    limited_force,
    stable_stiffness,
    stored_energy,
)
from palpate.app.device.options import DeviceOptions

UP = np.array([0.0, 0.0, 1.0])
MAX_AGE = DeviceOptions().max_age


def reading(force, stiffness=0.0, bonded=False):
    return ToolForce(force * UP, np.diag([0.0, 0.0, stiffness]), np.zeros(3), bonded)


def test_a_linear_body_answers_at_the_present_position():
    for depth in (-1e-3, 0.0, 2e-3):  # the reading is of 4 mm, the force now of 4 mm and this
        force = contact_force(reading(2.0, 500.0), -depth * UP)
        np.testing.assert_allclose(force, 500.0 * (4e-3 + depth) * UP)


def test_a_tool_that_touches_does_not_pull_and_one_that_grasps_does():
    np.testing.assert_array_equal(contact_force(reading(1.0, 1000.0), 2e-3 * UP), 0.0)
    np.testing.assert_allclose(contact_force(reading(1.0, 1000.0, bonded=True), 2e-3 * UP), -UP)
    np.testing.assert_array_equal(contact_force(reading(0.0, 1000.0), -2e-3 * UP), 0.0)


def test_the_local_contact_model_ends_at_a_distance():
    near = contact_force(reading(1.0, 100.0), -MAX_PREDICTION * UP)
    np.testing.assert_allclose(contact_force(reading(1.0, 100.0), -0.1 * UP), near)


def test_a_contact_stiffness_becomes_symmetric_and_passive():
    matrix = np.random.default_rng(0).standard_normal((3, 3)) * 1e3
    local = stable_stiffness(matrix, 500.0)
    np.testing.assert_allclose(local, local.T, atol=1e-10)
    assert np.linalg.eigvalsh(local).min() > -1e-9
    assert np.linalg.eigvalsh(local).max() < 500.0 + 1e-9
    good = np.diag([1.0, 20.0, 300.0])
    np.testing.assert_allclose(stable_stiffness(good, 500.0), good)
    np.testing.assert_array_equal(stable_stiffness(np.full((3, 3), np.nan), 500.0), 0.0)


def test_a_limited_force_keeps_its_direction():
    force = np.array([3.0, 0.0, 4.0])
    np.testing.assert_allclose(limited_force(force, 1.0), force / 5.0)
    np.testing.assert_array_equal(limited_force(force, 5.0), force)
    np.testing.assert_array_equal(limited_force(np.array([np.inf, 0.0, 0.0]), 1.0), 0.0)


def test_the_force_ends_within_20_ms_of_the_last_new_reading_and_is_ramped_in_again():
    fresh, interval = Watchdog(MAX_AGE), 1e-3
    for k in range(1000):  # readings in each millisecond
        fresh.note_reading(k, k * interval)
        share = fresh.share(k * interval, interval)
        assert share == pytest.approx(min(k * interval / RAMP_SECONDS, 1.0))
    last = 999 * interval
    shares = []
    for k in range(1, 20):  # the engine has stalled: the same reading comes again and again
        fresh.note_reading(999, last + k * interval)
        shares.append(fresh.share(last + k * interval, interval))
    assert shares[: round(MAX_AGE / interval) - 1] == [1.0] * (round(MAX_AGE / interval) - 1)
    assert shares[round(MAX_AGE / interval) + 1 :] == [0.0] * 6  # 14 ms and more; a message takes the rest of 20 ms
    fresh.note_reading(1000, 2.0)
    assert fresh.share(2.0, interval) == 0.0
    fresh.note_reading(1001, 2.01)
    assert fresh.share(2.01, interval) == pytest.approx(0.01 / RAMP_SECONDS)


def test_a_slow_engine_has_four_periods_and_a_clutch_restarts_the_ramp():
    fresh = Watchdog(MAX_AGE)
    fresh.note_reading(1, 0.0)
    assert fresh.share(0.0, 0.02) == 0.0
    assert fresh.share(0.079, 0.02) == pytest.approx(0.079 / RAMP_SECONDS)
    assert fresh.share(0.081, 0.02) == 0.0
    fresh.note_reading(2, 1.0)
    assert fresh.share(1.0, 1.0, coupled=False) == 0.0
    assert fresh.share(1.1, 1.0) == 0.0
    assert fresh.share(1.2, 1.0) == pytest.approx(0.1 / RAMP_SECONDS)


def test_no_more_energy_goes_out_than_came_in():
    observer = PassivityObserver()
    observer.note_motion([2.0 * UP], [-1e-3 * UP])  # pressed: 2 mJ came in
    assert observer.energy == pytest.approx(2e-3)
    (force,) = observer.passive_forces([2.0 * UP], [0.5 * UP], 1e-3)  # takes 1 mJ
    np.testing.assert_array_equal(force, 2.0 * UP)
    (force,) = observer.passive_forces([4.0 * UP], [1.0 * UP], 1e-3)  # would take 4 mJ
    assert 1e-3 * force @ UP == pytest.approx(2e-3)
    (force,) = observer.passive_forces([100.0 * UP], [1.0 * UP], 1e-3)
    assert force[2] == pytest.approx(100.0 - MAX_DAMPING)
    observer.energy = -1.0  # more went out than came in
    (force,) = observer.passive_forces([0.2 * UP], [0.1 * UP], 1e-3)
    assert force[2] == pytest.approx(-MAX_PULL)
    (force,) = observer.passive_forces([0.2 * UP], [-0.1 * UP], 1e-3)
    assert force[2] == pytest.approx(0.2 + 0.1 * MAX_DAMPING)
    (force,) = observer.passive_forces([100.0 * UP], [np.zeros(3)], 1e-3)  # at rest it costs nothing
    np.testing.assert_array_equal(force, 100.0 * UP)


def test_one_hand_may_be_moved_by_the_energy_of_the_other():
    observer = PassivityObserver()
    forces = observer.passive_forces([2.0 * UP, 2.0 * UP], [-1.0 * UP, 0.9 * UP], 1e-3)
    np.testing.assert_array_equal(forces, [2.0 * UP, 2.0 * UP])
    alone = observer.passive_forces([2.0 * UP], [0.9 * UP], 1e-3)[0]
    assert alone[2] == pytest.approx(0.0, abs=1e-12)


def test_what_the_body_does_not_store_is_forgotten():
    observer = PassivityObserver()
    observer.energy = 1.0
    observer.limit_energy(math.inf)
    assert observer.energy == 1.0
    observer.limit_energy(0.3)
    assert observer.energy == 0.3


@pytest.mark.parametrize("power", [1.0, 1.5, 3.0, 10.0])
def test_a_body_of_a_power_law_stores_less_than_the_estimate(power):
    depth, force = 0.01, 2.0  # F = c d^p, so k = p F / d, and the energy is F d / (p + 1)
    estimate = stored_energy(force * UP, np.diag([0.0, 0.0, power * force / depth]))
    energy = force * depth / (power + 1)
    assert energy <= estimate <= 2 * energy
    assert stored_energy(np.zeros(3), np.zeros((3, 3))) == 0.0
    assert stored_energy(UP, np.zeros((3, 3))) == math.inf
