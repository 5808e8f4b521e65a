"""The taut membrane whose middle a tool pushes: its paths, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.scenes.push import GROUP, MAX_DEPTH, MAX_TANGENTIAL, SWINGS, TOOL_RADIUS, pushed_membrane


@pytest.fixture(scope="module")
def scene():
    return pushed_membrane(prestretch=1.2, lasting=0.2)


def way(scene, seed, times):
    (load,), duration = scene.path(seed)
    assert (load.group, duration) == (GROUP, 0.2)
    return np.array([load.displacement(np.zeros((1, 2)), time) for time in times])


def test_a_path_starts_and_ends_at_rest_and_stays_within_its_amplitudes(scene):
    for seed in range(5):
        path = way(scene, seed, np.linspace(0.0, 0.2, 101))
        np.testing.assert_allclose(path[[0, -1]], 0.0, atol=1e-15)
        early, later = way(scene, seed, [1e-6, 2e-6])
        np.testing.assert_allclose(later, 4 * early, rtol=1e-6)  # its speed is zero there
        assert np.all(np.abs(path).max(axis=0) <= SWINGS * np.array([MAX_TANGENTIAL, MAX_TANGENTIAL, MAX_DEPTH]))
        assert np.abs(path[:, 2]).max() > 0


def test_equal_seeds_are_equal_paths_and_others_are_not(scene):
    times = np.linspace(0.0, 0.2, 11)
    np.testing.assert_array_equal(way(scene, 3, times), way(pushed_membrane(lasting=0.2), 3, times))
    assert np.abs(way(scene, 3, times) - way(scene, 4, times)).max() > 1e-3


def test_the_sheet_is_taut_and_its_middle_is_prescribed(scene):
    model = scene.model
    assert scene.tools == (GROUP,)
    held = np.linalg.norm(model.cloud.points[model.cloud.group(GROUP)], axis=1)
    assert held.max() <= TOOL_RADIUS * (1 + 1e-9)
    assert set(model.tension(np.zeros((len(model.cloud), 3)))) == {2}
    expected = 2 * 0.17e6 * (1.2**2 - 1.2**-4)
    np.testing.assert_allclose(model.principal_stress(np.zeros((len(model.cloud), 3))), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "value"), [("spacing", 0.02), ("prestretch", 1.0), ("lasting", 0.0), ("lasting", 11.0), ("every", 1.0)]
)
def test_values_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(pt.InputError, match=f"{name} must be .*, got"):
        pushed_membrane(**{name: value})
