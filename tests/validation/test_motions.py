"""Motions of the beam are within the limits of their kind, and fill them."""

from __future__ import annotations

import numpy as np
import pytest
from motions import LIMITS_BY_KIND, random_motion, training_motions

TIMES = np.linspace(0.0, 1.0, 501)


def sizes(loads):
    """The axial force, the transverse force and the twisting moment, (t, 3)."""
    (load,) = loads
    force, moment = (np.array([of(time) for time in TIMES]) for of in (load.force, load.moment))
    values = np.column_stack([np.abs(force[:, 0]), np.linalg.norm(force[:, 1:], axis=1), np.abs(moment[:, 0])])
    np.testing.assert_array_equal(values[[0, -1]], 0)
    return values


@pytest.mark.parametrize("kind", LIMITS_BY_KIND)
def test_random_motions_fill_the_limits_of_their_kind(kind):
    low, high = np.sort(np.abs(LIMITS_BY_KIND[kind]), axis=1).T
    peaks = np.array([sizes(random_motion(seed, kind)).max(axis=0) for seed in range(100)])
    assert np.all((peaks >= low) & (peaks <= high))
    assert np.all(peaks.min(axis=0) < low + 0.1 * (high - low))
    assert np.all(peaks.max(axis=0) > high - 0.1 * (high - low))


def test_training_first_takes_each_component_to_its_limit():
    peaks = np.array([sizes(loads).max(axis=0) for loads in training_motions(12)]) / [10, 0.1, 5e-3]
    np.testing.assert_allclose(peaks[:6], [[1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1]])
    assert np.all((peaks[6:] > 0) & (peaks[6:] <= 1))
