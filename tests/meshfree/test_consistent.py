"""Derivatives whose nodal sums are the divergence theorem's."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree import consistent
from palpate.meshfree.quadrature import integration_weights
from palpate.meshfree.stencils import moving_least_squares


@pytest.fixture(scope="module", params=[0.2, 0.3])
def cloud(request):
    return pt.box((0.05, 0.04, 0.04), 0.004, jitter=request.param)


@pytest.fixture(scope="module")
def made(cloud):
    stencils = moving_least_squares(cloud.points, order=2, neighbours=42)
    volumes = integration_weights(cloud, stencils)
    edges = cloud.boundary_vectors() * cloud.volumes[:, None]
    return stencils, volumes, consistent.consistent_gradient(stencils, cloud.points, volumes, edges)


def summed(stencils, weights, values):
    """For every node J the sum over the nodes I of values_I times the weight of J in the gradient at I."""
    n, d = len(values), weights.shape[2]
    total = -values[:, None] * weights.sum(axis=1)
    spread = (values[:, None, None] * weights).reshape(-1, d)
    return total + np.stack([np.bincount(stencils.neighbours.ravel(), spread[:, a], n) for a in range(d)], axis=1)


def test_a_uniform_stress_moves_no_node_inside(cloud, made):
    stencils, volumes, weights = made
    left = summed(stencils, weights, volumes) / (np.median(volumes) / cloud.spacing)
    on = np.zeros(len(cloud), dtype=bool)
    on[cloud.face_nodes] = True
    assert np.abs(left[~on]).max() < 1e-10
    assert np.abs(left[on]).max() > 0.1
    plain = stencils.first[stencils.row]
    assert np.abs(summed(stencils, plain, volumes)[~on]).max() > 1e-3 * np.median(volumes) / cloud.spacing


def test_linear_fields_are_still_differentiated_exactly(cloud, made):
    stencils, _, weights = made
    slope = np.random.default_rng(0).normal(size=(3, 2))
    field = cloud.points @ slope
    found = np.einsum("nkd,nkc->ncd", weights, field[stencils.neighbours] - field[:, None])
    np.testing.assert_allclose(found, np.broadcast_to(slope.T, found.shape), atol=1e-9)


def test_a_large_cloud_takes_no_more_steps_than_a_small_one(monkeypatch):
    """Without the patches 500 to 1,000 are taken."""
    monkeypatch.setattr(consistent, "MOST_STEPS", 80)
    for spacing in (0.004, 0.0025):
        cloud = pt.box((0.05, 0.04, 0.04), spacing, jitter=0.25)
        pt.FullModel(cloud, pt.NeoHookean(C1=1e3, density=1000.0, poisson=0.45), "x-", form="energy")
    monkeypatch.setattr(consistent, "MOST_STEPS", 5)
    with pytest.raises(pt.CloudError, match="too irregular"):
        pt.FullModel(cloud, pt.NeoHookean(C1=1e3, density=1000.0, poisson=0.45), "x-", form="energy")
