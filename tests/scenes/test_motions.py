"""Motions of the beam: their limits, their courses, and that they can be had again."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.scenes.motions import LIMITS_BY_KIND, Course, random_motion, training_motions

TIMES = np.linspace(0.0, 1.0, 2001)
SEEDS = range(100)


def sizes(loads):
    """The axial force, the transverse force and the twisting moment at `TIMES`, shape (t, 3), all else being zero."""
    (load,) = loads
    force, moment = (np.array([of(time) for time in TIMES]) for of in (load.force, load.moment))
    assert load.group == "x+"
    np.testing.assert_array_equal(moment[:, 1:], 0)
    return np.column_stack([force[:, 0], np.linalg.norm(force[:, 1:], axis=1), moment[:, 0]])


@pytest.mark.parametrize(
    ("kind", "low", "high"),
    [
        ("inside", (0, 0, 0), (10, 0.1, 5e-3)),
        ("outside", (13, 0.13, 6.5e-3), (20, 0.2, 0.01)),
        ("buckling", (0.2, 0, 0), (0.5, 0.02, 1e-3)),
    ],
)
def test_peaks_fill_the_limits_of_their_kind(kind, low, high):
    low, high = np.array(low), np.array(high)
    runs = np.array([sizes(random_motion(seed, kind)) for seed in SEEDS])
    peaks = np.abs(runs).max(axis=1)
    assert np.all((peaks >= low) & (peaks <= high))
    assert np.all(peaks.min(axis=0) < low + 0.1 * (high - low))
    assert np.all(peaks.max(axis=0) > high - 0.1 * (high - low))
    pull = runs[:, :, 0] if kind != "buckling" else -runs[:, :, 0]
    assert pull.min() == 0
    twist = runs[:, :, 2].sum(axis=1)
    assert 0.3 < np.mean(twist > 0) < 0.7


def test_bends_go_in_all_directions():
    ends = np.array([random_motion(seed)[0].force(time)[1:] for seed in SEEDS for time in TIMES[::100]])
    quadrants = np.unique(np.sign(ends), axis=0)
    assert {(1, 1), (1, -1), (-1, 1), (-1, -1)} <= set(map(tuple, quadrants.tolist()))


@pytest.mark.parametrize(
    "loads",
    [random_motion(seed, kind) for seed in range(20) for kind in LIMITS_BY_KIND] + training_motions(12),
)
def test_a_motion_starts_and_ends_at_zero_without_jumps(loads):
    values = sizes(loads)
    np.testing.assert_array_equal(values[[0, -1]], 0)
    steepest = 1.01 * np.abs(values).max(axis=0) / 0.05  # the shortest ramp
    assert np.all(np.abs(np.diff(values, axis=0)) <= steepest * TIMES[1])


def test_the_same_seed_is_the_same_motion_and_another_seed_or_kind_is_not():
    first = sizes(random_motion(3))
    np.testing.assert_array_equal(first, sizes(random_motion(3)))
    courses = [np.any(sizes(loads) != 0, axis=1) for loads in (random_motion(3), random_motion(3, "outside"))]
    assert np.any(courses[0] != courses[1])
    assert np.any(first != sizes(random_motion(4)))


def test_a_course_is_linear_between_its_corners():
    course = Course(start=0.1, rise=0.2, hold=0.3, fall=0.1)
    shares = [course(time) for time in TIMES]
    np.testing.assert_allclose(shares, np.interp(TIMES, [0.1, 0.3, 0.6, 0.7], [0, 1, 1, 0]), atol=1e-12)


def test_training_first_takes_each_component_to_its_limit():
    peaks = np.array([np.abs(sizes(loads)).max(axis=0) for loads in training_motions(12)])
    limits = np.array([10, 0.1, 5e-3])
    np.testing.assert_allclose(peaks[:6] / limits, [[1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1]])
    assert np.all((peaks[6:] > 0) & (peaks[6:] <= limits))
    assert len({tuple(row) for row in peaks[6:]}) == 6
    assert [len(training_motions(count)) for count in (1, 6, 8)] == [1, 6, 8]


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: random_motion(-1), "seed"),
        (lambda: random_motion(0.5), "seed"),
        (lambda: random_motion(0, "wild"), "kind"),
        (lambda: training_motions(0), "count"),
    ],
)
def test_values_out_of_range_are_refused_by_name(call, name):
    with pytest.raises(pt.InputError, match=rf"{name} must be .*, got"):
        call()
