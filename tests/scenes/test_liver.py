"""The pressed liver: its presses, and the smooth shapes that stand for modes."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.linear import carried_modes
from palpate.scenes.liver import pressed_liver
from palpate.scenes.training import training_scene


@pytest.fixture(scope="module")
def scene():
    return pressed_liver(spacing=0.012, radius=0.03)


def ball(scene, seed):
    (contact,), duration = scene.path(seed)
    return contact.poses(np.linspace(0.0, duration, 13))[:, :3]


def test_presses_begin_and_end_outside_and_go_in(scene):
    points = scene.model.cloud.points
    for seed in range(5):
        way = ball(scene, seed)
        depth = 0.03 - np.linalg.norm(points[:, None] - way, axis=2).min(axis=0)
        assert depth[0] < 0
        assert depth[-1] < 0
        assert 0.3 * 0.02 - 1e-9 <= depth.max() <= 0.021
    np.testing.assert_array_equal(ball(scene, 3), ball(scene, 3))
    assert np.abs(ball(scene, 3) - ball(scene, 4)).max() > 1e-3


def test_the_full_model_takes_a_press(scene):
    loads, _ = scene.path(0)
    run = pt.rollout(scene.model, loads, duration=0.1, every=0.05)
    assert np.isfinite(run.displacements).all()


def test_shapes_are_held_at_the_back_and_orthogonal_enough(scene):
    assert scene.coarse() is scene.model  # coarse enough itself
    finer = pressed_liver(spacing=0.010, radius=0.03).model
    shapes = carried_modes(scene.coarse(), finer, 6)
    cloud = finer.cloud
    assert shapes.shape == (6, len(cloud), 3)
    assert not shapes[:, cloud.group("back")].any()
    flat = shapes.reshape(6, -1) * np.sqrt(np.repeat(finer.masses, 3))
    gram = flat @ flat.T
    sizes = np.sqrt(np.diag(gram))
    gram /= sizes * sizes[:, None]
    assert np.abs(gram[:3, :3] - np.eye(3)).max() < 0.05  # vibrations
    assert np.linalg.cond(gram) < 100  # with their derivatives


def test_bad_parameters_are_refused_by_name():
    with pytest.raises(pt.InputError, match="radius"):
        pressed_liver(spacing=0.01, radius=0.02)
    with pytest.raises(pt.InputError, match="poisson"):
        training_scene("liver", {"poisson": 0.5})
