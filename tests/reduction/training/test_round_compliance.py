"""The rounding of a surface compliance is small, keeps it positive definite, and makes its file small."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

import palpate as pt
from palpate.reduction.basis.linear_modes import vibration_modes
from palpate.reduction.contact.compliance import NO_COMPLIANCE, contact_displacements
from palpate.reduction.contact.interior import interior_flexibility
from palpate.reduction.contact.near_field import add_own_compliance, near_field_compliance
from palpate.reduction.contact.residual_flexibility import carriers, residual_flexibility
from palpate.reduction.training.fit_compliance import _free_nodes
from palpate.reduction.training.round_compliance import MAX_INTERIOR_STEP, MAX_STEP, round_compliance

pytestmark = pytest.mark.slow

SIZE, FACTOR = (0.06, 0.06, 0.03), 1.37


@pytest.fixture(scope="module")
def body(tissue):
    return pt.Solid(pt.box(SIZE, spacing=0.006), tissue, "z-", form="energy")


@pytest.fixture(scope="module")
def statics(tissue):
    return pt.Solid(pt.box(SIZE, spacing=0.01), tissue, "z-", form="energy")


def compliance_of(body, statics):
    """The compliance of a body by the statics of a model of it, with a factor."""
    modes = vibration_modes(body, 10)[0]
    (carrying, deeper), (nodes, deep) = (_free_nodes(of) for of in (statics, body))
    rows = residual_flexibility(statics, carrying, body.cloud.points, modes, deeper)
    flexibility, inner = np.split(rows, [3 * len(carrying)])
    places, weights = carriers(statics.cloud, carrying, body.cloud, nodes)
    compliance = NO_COMPLIANCE._replace(
        nodes=nodes, carriers=places, weights=weights, flexibility=flexibility.astype(np.float32),
        nearby=np.zeros((len(nodes), 0), dtype=np.int64), near_field=np.zeros((len(nodes), 0, 3, 3), dtype=np.float32),
        interior=interior_flexibility(statics.cloud, deeper, carrying, inner, body.cloud, deep),
    )  # fmt: skip
    if statics is not body:
        nearby, near_field = near_field_compliance(body, nodes, statics, carrying, places, weights)
        near_field = add_own_compliance(flexibility, places, weights, nearby, near_field)
        compliance = compliance._replace(nearby=nearby, near_field=near_field)
    return compliance.scaled(FACTOR)


@pytest.fixture(scope="module", params=["own statics", "coarse statics"])
def exact(request, body, statics):
    return compliance_of(body, body if request.param == "own statics" else statics)


@pytest.fixture(scope="module")
def rounded(exact):
    return round_compliance(exact)


def matrix(compliance):
    """Compliance (3 k, 3 k) between all nodes."""
    count, size = len(compliance.nodes), len(compliance.flexibility) // 3
    spread = np.zeros((count, size))
    np.add.at(spread, (np.arange(count)[:, None], compliance.carriers), compliance.weights)
    blocks = compliance.flexibility.astype(float).reshape(size, 3, size, 3)
    whole = np.einsum("ia,acbd,jb->icjd", spread, blocks, spread, optimize=True)
    for q in range(compliance.nearby.shape[1]):
        whole[np.arange(count), :, compliance.nearby[:, q]] += compliance.near_field[:, q]
    return whole.reshape(3 * count, 3 * count)


def test_all_values_are_multiples_of_a_power_of_two_and_err_by_half_of_it(exact, rounded):
    typical = np.median(np.diagonal(exact.flexibility))
    for limit, before, after in (
        (MAX_STEP * typical, exact.flexibility, rounded.flexibility),
        (MAX_STEP * typical, exact.near_field, rounded.near_field),
        (MAX_INTERIOR_STEP * typical / FACTOR, exact.interior.flexibility, rounded.interior.flexibility),
    ):
        step = 2.0 ** np.floor(np.log2(limit))
        assert np.all(after == step * np.rint(after / step))
        assert np.all(np.abs(after - before) <= 0.5001 * step)
        assert after.dtype == np.float32


def test_it_stays_symmetric_and_positive_definite(exact, rounded):
    before, after = np.linalg.eigvalsh(matrix(exact)), np.linalg.eigvalsh(matrix(rounded))
    assert before[0] > 0
    assert after[0] > 0
    np.testing.assert_array_equal(rounded.flexibility, rounded.flexibility.T)


def test_a_compliance_that_the_step_would_make_indefinite_has_a_smaller_step():
    """Two nodes that move almost as one."""
    typical, apart = 1.0, 1e-4
    pair = np.full((2, 2), typical - apart) + apart * np.eye(2)
    compliance = NO_COMPLIANCE._replace(
        nodes=np.arange(2), carriers=np.arange(2)[:, None], weights=np.ones((2, 1)),
        flexibility=np.kron(pair, np.eye(3)).astype(np.float32),
        nearby=np.zeros((2, 0), np.int64), near_field=np.zeros((2, 0, 3, 3), np.float32),
    )  # fmt: skip
    found = round_compliance(compliance).flexibility
    assert np.linalg.eigvalsh(found)[0] > 0
    np.testing.assert_allclose(found, compliance.flexibility, atol=apart)


def test_rounding_again_changes_nothing(rounded):
    again = round_compliance(rounded)
    for name in ("flexibility", "near_field"):
        np.testing.assert_array_equal(getattr(again, name), getattr(rounded, name))
    np.testing.assert_array_equal(again.interior.flexibility, rounded.interior.flexibility)


def test_an_empty_compliance_stays():
    zero = NO_COMPLIANCE._replace(nodes=np.arange(1), flexibility=np.zeros((3, 3), np.float32))
    assert round_compliance(zero) is zero


def test_displacements_and_forces_under_a_tool_change_by_less_than_their_bounds(body, exact, rounded):
    """Under known forces at many places, and the total force of a patch that is displaced by a given vector."""
    points, random = body.cloud.points, np.random.default_rng(3)
    surface = points[exact.nodes]
    before, after = matrix(exact), matrix(rounded)
    for middle in random.choice(len(surface), 8, replace=False):
        patch = cKDTree(surface).query_ball_point(surface[middle], 0.0126)
        forces = np.zeros_like(surface)
        forces[patch] = random.standard_normal(3) / len(patch)
        expected, found = (contact_displacements(c, points, forces[None], [True])[0] for c in (exact, rounded))
        size = np.abs(expected).max()
        error = np.linalg.norm(found - expected, axis=1)
        assert error[exact.nodes].max() < 0.004 * size
        assert error.max() < 0.008 * size
        rows = (3 * np.array(patch)[:, None] + np.arange(3)).ravel()
        way = np.tile(random.standard_normal(3), len(patch))
        pushes = [np.linalg.solve(c[np.ix_(rows, rows)], way).reshape(-1, 3).sum(axis=0) for c in (before, after)]
        assert np.linalg.norm(pushes[1] - pushes[0]) < 0.003 * np.linalg.norm(pushes[0])
