"""Residual flexibility: what modes leave of statics, carried to finer surfaces, kept from step to step."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.sparse.linalg import splu

import palpate as pt
from palpate.reduction.basis.linear_modes import rest_stiffness, vibration_modes
from palpate.reduction.contact.compliance import (
    NO_COMPLIANCE,
    active_compliance,
    compliance_table,
    contact_displacements,
    energy_factor,
    pair,
    refresh,
    secant_factor,
    stiffened_force,
)
from palpate.reduction.contact.residual_flexibility import carriers, residual_flexibility
from palpate.reduction.training.fit_compliance import fit_stiffening

pytestmark = pytest.mark.slow

TISSUE = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000, poisson=0.4)


def block(spacing, fixed="z-"):
    return pt.Solid(pt.box((0.04, 0.04, 0.02), spacing=spacing), TISSUE, fixed, form="energy")


def free_surface(body):
    return np.setdiff1d(np.unique(body.cloud.face_nodes), body.cloud.group("z-"))


@pytest.fixture(scope="module")
def solved():
    body = block(0.005)
    modes = vibration_modes(body, 10)[0]
    nodes = free_surface(body)
    return body, modes, nodes, residual_flexibility(body, nodes, body.cloud.points, modes)


def loaded(body, modes, nodes):
    """Return random forces (n, 3) [N] on some nodes, and how they move all and the modes alone (n, 3) [m]."""
    free = np.flatnonzero(np.repeat(~body.fixed_mask, 3))
    stiffness = rest_stiffness(body)[free][:, free].tocsc()
    load = np.zeros((len(body.cloud), 3))
    load[nodes] = np.random.default_rng(0).standard_normal((len(nodes), 3))
    whole = np.zeros(load.size)
    whole[free] = splu(stiffness).solve(load.reshape(-1)[free])
    flat = modes.reshape(len(modes), -1)
    modal = flat.T @ np.linalg.solve(flat[:, free] @ (stiffness @ flat[:, free].T), flat @ load.reshape(-1))
    return load, whole.reshape(-1, 3), modal.reshape(-1, 3)


def test_modes_plus_residual_flexibility_are_the_static_response(solved):
    body, modes, nodes, rest = solved
    load, whole, modal = loaded(body, modes, nodes)
    both = modal[nodes] + (rest @ load[nodes].reshape(-1)).reshape(-1, 3)
    np.testing.assert_allclose(both, whole[nodes], atol=1e-9 * np.abs(whole).max())


def test_modes_plus_residual_flexibility_are_the_static_response_of_interior_nodes(solved):
    body, modes, nodes, rest = solved
    within = np.setdiff1d(np.flatnonzero(~body.fixed_mask), nodes)
    both = residual_flexibility(body, nodes, body.cloud.points, modes, within[::2])
    np.testing.assert_array_equal(both[: len(rest)], rest)
    load, whole, modal = loaded(body, modes, nodes)
    found = (both[len(rest) :] @ load[nodes].reshape(-1)).reshape(-1, 3)
    np.testing.assert_allclose(found, (whole - modal)[within[::2]], atol=1e-9 * np.abs(whole).max())


def test_residual_flexibility_is_positive_definite_and_decreases_with_more_modes(solved):
    body, modes, nodes, rest = solved
    values = np.linalg.eigvalsh(rest)
    assert values[0] > 0
    fewer = residual_flexibility(body, nodes, body.cloud.points, modes[:4])
    assert np.linalg.eigvalsh(fewer - rest)[0] > -1e-9 * values[-1]


def test_residual_flexibility_of_a_coarser_model_agrees_with_that_of_the_finer():
    """The displacement under a patch of uniform pressure, by a coarser model and by the body's own statics."""
    coarse, fine = block(0.005), block(0.04 / 12)
    modes = vibration_modes(fine, 10)[0]
    those, nodes = free_surface(coarse), free_surface(fine)
    places, weights = carriers(coarse.cloud, those, fine.cloud, nodes)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    middle = np.linalg.norm(fine.cloud.points[nodes] - (0.02, 0.02, 0.02), axis=1) < 0.0076
    force = np.zeros((len(nodes), 3))
    force[middle, 2] = -1.0 / middle.sum()
    own = (residual_flexibility(fine, nodes, fine.cloud.points, modes) @ force.reshape(-1)).reshape(-1, 3)
    compliance = NO_COMPLIANCE._replace(
        nodes=nodes, carriers=places, weights=weights,
        flexibility=residual_flexibility(coarse, those, fine.cloud.points, modes).astype(np.float32),
    )  # fmt: skip
    carried = contact_displacements(compliance, fine.cloud.points, force[None], [True])[0][nodes]
    assert carried[middle, 2].mean() == pytest.approx(own[middle, 2].mean(), rel=0.15)


def test_bodies_without_supports_and_too_large_bodies_are_refused(solved):
    body, modes, nodes, _ = solved
    with pytest.raises(pt.InputError, match="must have supports"):
        residual_flexibility(block(0.005, fixed=()), nodes, body.cloud.points, modes)
    large = block(0.00125)
    with pytest.raises(pt.InputError, match="give hyper_reduce a coarser model"):
        residual_flexibility(large, nodes, large.cloud.points, np.zeros((1, len(large.cloud), 3)))


def test_cached_blocks_stay_correct_as_touched_nodes_change(solved):
    body, _, nodes, rest = solved
    count = len(nodes)
    nearby = (np.arange(count)[:, None] + np.array([0, 1, 2, -2, -1])) % count  # in a ring, each twice as far again
    near_field = np.tile(0.01 * np.eye(3), (count, 5, 1, 1))
    compliance = NO_COMPLIANCE._replace(
        nodes=nodes, carriers=np.arange(len(nodes))[:, None], weights=np.ones((len(nodes), 1)),
        flexibility=rest.astype(np.float32),
        patches=np.column_stack([np.arange(len(nodes)), np.roll(np.arange(len(nodes)), 1)]),
        shares=np.full((len(nodes), 2), 0.5), nearby=nearby, near_field=near_field.astype(np.float32),
    )  # fmt: skip
    order = np.random.default_rng(1).permutation(len(nodes))
    laid, block_ = compliance_table(compliance, order), np.zeros((3, 3))
    cached = active_compliance(laid, 1)
    random = np.random.default_rng(2)
    for _ in range(120):  # more than there is room for: some are forgotten
        now = random.permutation(2 * len(nodes))[: random.integers(0, 12)]
        assert refresh(laid, cached, now, len(now))
        assert len(now) <= cached.used[0] <= len(cached.node)
        for i in now:
            for j in now:
                pair(laid, i, j, block_)
                np.testing.assert_allclose(cached.matrix[cached.slot[i], cached.slot[j]], block_, rtol=1e-5, atol=1e-9)
    force = np.zeros((len(nodes), 3))  # and the step's pairs are those of the run's displacements
    force[order[3]] = (0.1, -0.2, 0.3)
    found = contact_displacements(compliance, body.cloud.points, force[None], [True])[0]
    pair(laid, len(nodes) + 7, len(nodes) + 3, block_)
    np.testing.assert_allclose(found[nodes[order[7]]], block_ @ force[order[3]], rtol=1e-3)


def test_a_fit_recovers_the_stiffening_and_its_energy_is_the_work():
    force = np.linspace(0.01, 3.0, 60)
    stiffening = np.array([0.3, 1.5])
    linear = force**2
    factor, found = fit_stiffening(force, 0.9 * secant_factor(stiffening, force) * linear, linear)
    assert factor == pytest.approx(0.9, rel=0.02)
    np.testing.assert_allclose(secant_factor(found, force), secant_factor(stiffening, force), rtol=0.01)
    depth = lambda f: 2e-3 * f * secant_factor(stiffening, f)  # noqa: E731
    work = 3.0 * depth(3.0) - quad(depth, 0.0, 3.0)[0]
    assert energy_factor(stiffening, 3.0) * 0.5 * 3.0 * depth(3.0) == pytest.approx(work, rel=1e-9)
    assert energy_factor(np.array([0.0, 1.0]), 3.0) == 1.0


@pytest.mark.parametrize("exponent", [0.0, 0.3, 0.8])
def test_the_stiffened_force_solves_its_equation(exponent):
    stiffening = np.array([exponent, 0.02])
    for force in (0.0, 1e-9, 1e-3, 0.02, 1.0, 1e4):
        factor = secant_factor(stiffening, force)
        assert stiffened_force(stiffening, factor * force, 0.0) == (pytest.approx(factor, rel=1e-11), 1.0)
        slope = factor * (1.0 - exponent * force / (force + 0.02))  # d(h f)/df
        share = stiffened_force(stiffening, factor * force, 10.0)[1]
        assert share == pytest.approx(slope / 10.0, rel=1e-9)  # an explicit step follows no stiffer surface
