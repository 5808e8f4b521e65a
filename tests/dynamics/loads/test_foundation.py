"""Elastic foundations, against what springs do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt

pytestmark = pytest.mark.slow

SIDE = 0.015


@pytest.fixture
def loose(small_cloud, tissue):
    """The smallest box, held nowhere; new for every test."""
    return pt.Solid(small_cloud, tissue, form="energy")


def mean_motion(model, trajectory):
    return np.einsum("n,fnc->fc", model.masses, trajectory.displacements) / model.masses.sum()


@pytest.mark.parametrize("damping", [0.0, 20.0])
def test_a_block_on_soft_springs_oscillates_as_a_mass(loose, damping):
    stiffness = 2e4  # so soft that the block hardly deforms
    speed = np.tile([0.0, 0.0, 0.05], (len(loose.cloud), 1))
    trajectory = pt.rollout(
        loose, [pt.Foundation("z-", stiffness, damping)], duration=0.2, every=2e-3, velocity=speed, progress=False
    )
    mass, area = loose.masses.sum(), SIDE**2
    decay = damping * area / (2 * mass)
    omega = np.sqrt(stiffness * area / mass - decay**2)
    expected = 0.05 / omega * np.exp(-decay * trajectory.times) * np.sin(omega * trajectory.times)
    assert np.allclose(mean_motion(loose, trajectory)[:, 2], expected, atol=0.02 * 0.05 / omega)


def test_springs_return_the_stored_energy(loose):
    speed = np.tile([0.02, 0.0, 0.05], (len(loose.cloud), 1))
    trajectory = pt.rollout(loose, [pt.Foundation("z-", 2e4)], duration=0.1, every=1e-3, velocity=speed, progress=False)
    assert np.abs(trajectory.balance).max() < 1e-3 * trajectory.kinetic[0]
    down = trajectory.displacements[:, loose.cloud.group("z-")]
    shares = loose.cloud.area_vectors("z-")
    stored = 0.5 * 2e4 * np.einsum("n,fnc->f", np.linalg.norm(shares, axis=1), down**2)
    assert np.allclose(-trajectory.external, stored, atol=1e-3 * trajectory.kinetic[0])


@pytest.mark.parametrize("load", [pt.Foundation("z-", 1e10), pt.Foundation("z-", 1e6, 1e6)])
def test_the_step_is_short_enough_for_stiff_foundations(loose, load):
    prepared = loose.prepare([load])
    free = loose.stable_step(loose.state(loose.prepare(())), loose.prepare(()))[0]
    state = loose.state(prepared)
    assert loose.stable_step(state, prepared)[0] < 0.2 * free
    speed = np.tile([0.0, 0.0, 0.05], (len(loose.cloud), 1))
    run = pt.rollout(loose, [load], duration=5e-3, every=1e-3, velocity=speed, progress=False)
    # the springs' own energy is minus the loads' work
    energy = run.kinetic + run.strain - run.external
    assert energy.max() < 1.02 * run.kinetic[0]


def test_a_patch_of_several_faces_has_all_their_areas(small_cloud, tissue):
    around = np.unique(small_cloud.face_nodes)
    cloud = replace(small_cloud, groups={**small_cloud.groups, "around": around})
    prepared = pt.Solid(cloud, tissue, form="energy").prepare([pt.Foundation("around", 1e5)])
    assert prepared.sites.foundation_spring.sum() == pytest.approx(1e5 * 6 * SIDE**2)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pt.Foundation("z-", -1.0), "stiffness of Foundation on 'z-' must be .*, got -1.0"),
        (lambda: pt.Foundation("z-", 1.0, np.nan), "damping of Foundation on 'z-'"),
        (lambda: pt.Foundation("top", 1.0), "group must be one of .*, got 'top'"),
        (lambda: pt.Foundation("inside", 1.0), "must be on the surface, got 'inside' with inner nodes 21"),
    ],
)
def test_invalid_foundations_are_refused_by_name(small_cloud, tissue, make, message):
    inside = np.setdiff1d(np.arange(len(small_cloud)), small_cloud.face_nodes)
    cloud = replace(small_cloud, groups={**small_cloud.groups, "inside": inside})
    model = pt.Solid(cloud, tissue, form="energy")
    with pytest.raises(pt.InputError, match=message):
        pt.rollout(model, [make()], duration=1e-3, every=1e-3)
