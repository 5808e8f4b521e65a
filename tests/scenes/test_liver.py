"""The liver of the package: a scene whose tool presses and pulls, and the smooth shapes that stand for modes."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree.cloud import BORDER_MARGIN
from palpate.reduction.basis.linear_modes import interpolated_modes
from palpate.scenes.open_scene import open_scene
from palpate.scenes.training import open_training

pytestmark = pytest.mark.slow

COARSE = {"spacing": 0.012, "tool.radius": 0.03, "depth": 0.02}


@pytest.fixture(scope="module")
def scene():
    return open_training("liver", COARSE)


def ball(scene, seed):
    (contact,), duration = scene.path(seed)
    return contact.poses(np.linspace(0.0, duration, 13))[:, :3]


def test_presses_begin_and_end_outside_and_go_in(scene):
    points = scene.model.cloud.points
    for seed in (0, 1, 2, 4, 5):
        way = ball(scene, seed)
        depth = 0.03 - np.linalg.norm(points[:, None] - way, axis=2).min(axis=0)
        assert depth[0] < 0
        assert depth[-1] < 0
        assert 0.25 * 0.02 <= depth.max() <= 0.023  # pressed along a smoothed normal, and slid with some sag
    np.testing.assert_array_equal(ball(scene, 2), ball(scene, 2))
    assert np.abs(ball(scene, 2) - ball(scene, 4)).max() > 1e-3


def test_every_fourth_path_is_a_pull_of_forceps(scene):
    kinds = [type(scene.path(seed)[0][0]) for seed in range(8)]
    assert kinds == 2 * [pt.tools.Contact, pt.tools.Contact, pt.tools.Contact, pt.tools.Grasp]


def test_the_back_is_fixed_and_the_tissue_is_that_of_a_healthy_liver(scene):
    model = scene.model
    back, points = model.cloud.group("back"), model.cloud.points
    assert points[back, 1].min() >= points[:, 1].max() - 0.0701 - BORDER_MARGIN * model.cloud.spacing
    assert np.isin(back, model.cloud.face_nodes).all()
    assert model.material.shear_modulus == pytest.approx(2200.0)
    assert (model.material.poisson, model.material.density, model.mass_damping) == (0.45, 1060.0, 8.0)


def test_the_full_model_runs_a_press_and_a_grasp(scene):
    for seed in (0, 3):
        loads, _ = scene.path(seed)
        run = pt.rollout(scene.model, loads, duration=0.1, every=0.05)
        assert np.isfinite(run.displacements).all()


def test_modes_are_zero_at_the_back_and_nearly_orthogonal(scene):
    finer = open_scene("liver", {"spacing": 0.010}).body
    shapes = interpolated_modes(scene.model, finer, 6)
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
        open_training("liver", {"spacing": 0.012, "tool.radius": 0.02})
    with pytest.raises(pt.InputError, match="poisson"):
        open_training("liver", {"poisson": 0.5})
