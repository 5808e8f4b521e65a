"""By which nodes the patches of a surface move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_surfaces import ball

import palpate as pt
from palpate.meshfree.patches import KERNEL_RADIUS, surface_patches


@pytest.fixture(scope="module", params=["lattice", "irregular", "ball"])
def cloud(request):
    if request.param == "ball":
        return pt.fill(ball(0.02, 0.004), 0.005)
    return pt.box((0.02, 0.02, 0.015), 0.0025, jitter=0.25 if request.param == "irregular" else 0.0)


@pytest.fixture(scope="module")
def patches(cloud):
    return surface_patches(cloud)


def test_linear_fields_are_kept(cloud, patches):
    assert np.allclose(patches.sum(axis=1), 1.0, atol=1e-12)
    assert np.allclose(patches @ cloud.points, cloud.points, atol=1e-14)


def test_forces_on_patches_have_the_same_sum_and_moment_as_their_shares(cloud, patches):
    forces = np.random.default_rng(0).normal(size=(len(cloud), 3))
    shares = patches.T @ forces
    assert np.allclose(shares.sum(axis=0), forces.sum(axis=0), atol=1e-10)
    moments = [np.cross(cloud.points, f).sum(axis=0) for f in (shares, forces)]
    assert np.allclose(*moments, atol=1e-12)


def test_interior_nodes_are_their_own_patch_and_surface_nodes_share_patches(cloud, patches):
    surface = np.unique(cloud.face_nodes)
    inside = np.setdiff1d(np.arange(len(cloud)), surface)
    assert np.array_equal(patches[inside].toarray(), np.eye(len(cloud))[inside])
    own = patches.diagonal()[surface]
    assert own.min() > 0.2
    assert 0.3 < np.median(own) < 0.65  # those at edges and corners have less around them
    assert patches.data.min() > -0.15


def test_waves_of_two_spacings_are_filtered_and_long_ones_are_not():
    cloud = pt.box((0.03, 0.03, 0.006), 0.002)
    patches, top = surface_patches(cloud), cloud.group("z+")
    x, y = cloud.points[:, 0] / 0.002, cloud.points[:, 1] / 0.002
    inner = top[np.all(np.abs(cloud.points[top, :2] - 0.015) < 0.009, axis=1)]
    near, diagonal = (0.5 + 0.5 * np.cos(np.pi * d / KERNEL_RADIUS) for d in (1.0, np.sqrt(2.0)))
    total = 1 + 4 * near + 4 * diagonal
    along, both = (1 - 4 * diagonal) / total, (1 - 4 * near + 4 * diagonal) / total  # kept by the kernel mean
    assert along < 0.6
    assert both < 0.12
    for wave, most in ((x, 1.1 * along), (x + y, 1.1 * both)):
        field = np.cos(np.pi * wave)
        assert np.abs((patches @ field)[inner]).max() < most
    field = np.cos(2 * np.pi * x / 12)
    assert np.allclose((patches @ field)[inner], field[inner], atol=0.12)


def test_patches_contain_no_nodes_of_the_other_side_of_a_thin_body():
    cloud = pt.box((0.02, 0.02, 0.006), 0.002)
    thin = replace(cloud, points=cloud.points * [1.0, 1.0, 0.3])
    middle = thin.group("z+")[np.all(np.abs(thin.points[thin.group("z+"), :2] - 0.01) < 0.005, axis=1)]
    assert np.abs(surface_patches(thin)[middle][:, thin.group("z-")].toarray()).max() < 1e-12
