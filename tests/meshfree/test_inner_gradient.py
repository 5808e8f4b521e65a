"""Cubic fits at inner nodes: exact for quadratic fields, and waves of a few spacings."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree.inner_gradient import inner_nodes, with_inner_gradient


@pytest.fixture(scope="module")
def fits():
    """A filled ball of 12 spacings, its inner nodes, and its stencils before and after."""
    points = pt.box((1.0, 1.0, 1.0), 0.07, jitter=0.2).points
    cloud = pt.box((1.0, 1.0, 1.0), 0.07, jitter=0.2)
    before = pt.moving_least_squares(points, order=2, neighbours=42)
    return cloud, inner_nodes(cloud, before), before, with_inner_gradient(before, cloud)


def test_quadratic_fields_are_differentiated_exactly(fits):
    cloud, _, _, after = fits
    x = cloud.points
    field = 1 + x[:, 0] - 2 * x[:, 1] * x[:, 2] + x[:, 0] ** 2
    exact = np.stack([1 + 2 * x[:, 0], -2 * x[:, 2], -2 * x[:, 1]], axis=1)
    np.testing.assert_allclose(after.gradient(field), exact, atol=1e-9)


def test_only_nodes_away_from_the_surface_change(fits):
    cloud, inner, before, after = fits
    changed = np.any(before.first != after.first, axis=(1, 2))
    np.testing.assert_array_equal(changed, inner)
    depth = np.minimum(cloud.points, 1 - cloud.points).min(axis=1)
    assert depth[inner].min() > cloud.spacing
    assert inner.sum() > 0.3 * len(cloud)


@pytest.mark.parametrize(("length", "quadratic", "cubic"), [(6.0, 0.75, 0.86), (12.0, 0.93, 0.965)])
def test_waves_keep_their_energy(fits, length, quadratic, cubic):
    """Exact is 1; a quadratic fit has 1 - (kh)^2 / 3 and more terms."""
    cloud, inner, before, after = fits
    direction = np.array([0.6, 0.0, 0.8])
    k = 2 * np.pi / (length * cloud.spacing)
    deep = inner & (np.minimum(cloud.points, 1 - cloud.points).min(axis=1) > 3 * cloud.spacing)
    shares = []
    for stencils in (before, after):
        energy = 0.0
        for phase in (0.0, np.pi / 2):
            slope = stencils.gradient(np.sin(k * cloud.points @ direction + phase)) @ direction
            energy += np.mean(slope[deep] ** 2) / k**2
        shares.append(energy)
    assert shares[0] < quadratic
    assert cubic < shares[1] < 1.01


def test_lattices_keep_their_shared_rows():
    cloud = pt.box((1.0, 1.0, 1.0), 0.1)
    stencils = pt.moving_least_squares(cloud.points, order=2, neighbours=42)
    assert with_inner_gradient(stencils, cloud) is stencils
