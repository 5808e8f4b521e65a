"""Derivatives whose nodal sums are the divergence theorem's."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

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


@pytest.mark.parametrize("size", [(0.06, 0.02, 0.025), (0.05, 0.05, 0.05), (0.03, 0.03, 0.03)])
def test_a_uniform_stress_moves_no_inner_node_of_a_lattice(size):
    cloud = pt.box(size, 0.005)
    _, stencils, volumes = consistent.consistent_stencils(cloud, (42,))
    edges = cloud.boundary_vectors() * cloud.volumes[:, None]
    fit = moving_least_squares(cloud.points, order=2, neighbours=42)
    left, before = (
        np.abs(summed(s, s.first[s.row], volumes) - edges).max() / (np.median(volumes) / cloud.spacing)
        for s in (stencils, fit)
    )
    assert left < 1e-9
    assert before > 0.4  # on the nodes one layer below the edges
    slope = np.random.default_rng(0).normal(size=(3, 2))
    expected = np.broadcast_to(slope.T, (len(cloud), 2, 3))
    np.testing.assert_allclose(stencils.gradient(cloud.points @ slope), expected, atol=1e-9)


def test_nodes_of_a_lattice_share_rows_whose_number_does_not_grow_with_it():
    numbers = []
    for length in (0.06, 0.08, 0.12):
        cloud = pt.box((length, 0.02, 0.02), 0.005)
        _, stencils, volumes = consistent.consistent_stencils(cloud, (42,))
        numbers.append(len(stencils.first))
        assert all(len(np.unique(volumes[stencils.row == r])) == 1 for r in range(numbers[-1]))
        assert {len(a) for a in (stencils.value, stencils.own, stencils.own_first, stencils.condition)} == {numbers[-1]}
    assert numbers[0] == numbers[1] == numbers[2] < 200


def test_nodes_of_a_lattice_have_rows_of_their_own_where_no_shared_ones_balance(monkeypatch):
    cloud = pt.box((0.06, 0.02, 0.02), 0.005)
    monkeypatch.setattr(consistent, "MAX_CONDITIONS", 10)
    _, stencils, volumes = consistent.consistent_stencils(cloud, (42,))
    assert len(stencils.first) == len(cloud)
    edges = cloud.boundary_vectors() * cloud.volumes[:, None]
    left = summed(stencils, stencils.first[stencils.row], volumes) - edges
    assert np.abs(left).max() < 1e-10 * np.median(volumes) / cloud.spacing


@pytest.mark.slow
def test_iterations_do_not_increase_with_the_size_of_the_cloud(monkeypatch):
    """Without the patches 500 to 1,000 are taken."""
    monkeypatch.setattr(consistent, "MAX_ITERATIONS", 80)
    for spacing in (0.004, 0.0025):
        cloud = pt.box((0.05, 0.04, 0.04), spacing, jitter=0.25)
        pt.Solid(cloud, pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45), "x-", form="energy")
    monkeypatch.setattr(consistent, "MAX_ITERATIONS", 5)
    with pytest.raises(pt.CloudError, match="too irregular"):
        pt.Solid(cloud, pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45), "x-", form="energy")


def drop(height, seed):
    """A flat body that tapers to a tip, filled coarsely."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    corners = ball.vertices.copy()
    corners[:, 1:] *= 1 - 0.35 * (corners[:, :1] + 1)
    return pt.fill((corners * (0.04, *height), ball.faces), 0.0035, seed=seed)


@pytest.mark.slow
def test_stencils_widen_where_a_tip_needs_it():
    tissue, wide = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45), {2: 50, 5: 63}
    for seed, neighbours in wide.items():
        cloud = drop((0.015, 0.008), seed)
        with pytest.raises(pt.CloudError, match="too irregular"):
            pt.Solid(cloud, tissue, form="energy", neighbours=42)
        model = pt.Solid(cloud, tissue, form="energy")
        assert model.neighbours == neighbours
    # and the tip holds: stretched and let go, it makes no energy
    start = 0.2 * cloud.points * (1.0, -0.3, -0.3)
    run = pt.rollout(model, displacement=start, duration=0.05, every=0.005, progress=False)
    assert np.all(np.diff(run.kinetic + run.strain) < 0)
    assert np.abs(run.balance).max() < 5e-3 * run.strain[0]


@pytest.mark.slow
def test_a_tip_without_a_regular_stencil_is_refused_with_the_node():
    with pytest.raises(pt.CloudError, match=r"near node \d+ at .* spread the points there") as refused:
        pt.Solid(
            drop((0.02, 0.006), 1), pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45), form="energy"
        )
    assert len(refused.value.nodes) == 1
