"""A hand that moves as told drives an engine."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.realtime.device import DummyDevice


@pytest.mark.slow
def test_the_device_sends_its_path_and_reads_forces_of_springs(engine_of):
    engine = engine_of(rate=500.0, damping=8.0)
    device = DummyDevice(lambda t: ((0.0, 0.0, -0.01 * np.sin(20 * t) ** 2), (1.0, 0.0, 0.0, 0.0)))
    with engine:
        recording = device.run(engine, 0.4)
    times = recording.times
    assert times[0] == 0.0
    assert 0.2 < times[-1] < 0.4
    assert np.all(np.diff(times) > 0)
    assert 10 < len(times) <= 201  # no more than once a period
    np.testing.assert_allclose(recording.positions[:, 2], -0.01 * np.sin(20 * times) ** 2, atol=1e-15)
    assert recording.quaternions.shape == (len(times), 4)
    assert recording.forces.shape == (len(times), 3)
    assert recording.forces[:, 2].max() > 0.3  # pushed down by a centimetre against 75 N/m and inertia
    assert not np.any(recording.forces[:, :2])


def test_a_path_that_jumps_is_refused(engine_of):
    device = DummyDevice(lambda t: ((2.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    with pytest.raises(pt.InputError, match="jump"):
        device.run(engine_of(), 0.1)


def test_a_duration_must_be_positive(engine_of):
    with pytest.raises(pt.InputError, match="duration"):
        DummyDevice(lambda t: ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))).run(engine_of(), 0.0)
