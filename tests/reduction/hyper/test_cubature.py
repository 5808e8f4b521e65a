"""Few nodes with positive weights."""

import numpy as np
import pytest
from scipy.optimize import nnls

from palpate.reduction.hyper.cubature import fit_moments, sketch, sparse_nnls


def test_a_sparse_positive_solution_is_found_exactly():
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((60, 300))
    wanted = np.zeros(300)
    wanted[rng.choice(300, 8, replace=False)] = rng.uniform(0.5, 2.0, 8)
    x, left = sparse_nnls(columns, columns @ wanted, 1e-10)
    assert left < 1e-10
    np.testing.assert_allclose(x, wanted, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_the_solution_equals_that_of_scipy_nnls(seed):
    rng = np.random.default_rng(seed)
    columns, target = rng.standard_normal((40, 25)), rng.standard_normal(40)
    x, left = sparse_nnls(columns, target, 0.0)
    expected, norm = nnls(columns, target)
    assert np.all(x >= 0)
    assert left * np.linalg.norm(target) == pytest.approx(norm, rel=1e-6)
    np.testing.assert_allclose(x, expected, atol=1e-6)


def test_the_solver_stops_at_the_tolerance():
    rng = np.random.default_rng(1)
    columns = np.abs(rng.standard_normal((80, 400)))
    target = columns.sum(axis=1)
    counts = []
    for tolerance in (1e-1, 1e-2, 1e-3):
        x, left = sparse_nnls(columns, target, tolerance)
        assert left <= tolerance
        assert np.linalg.norm(columns @ x - target) <= 1.001 * tolerance * np.linalg.norm(target)
        counts.append(np.count_nonzero(x))
    assert counts[0] < counts[1] < counts[2] <= 80


def test_the_number_of_columns_is_limited():
    rng = np.random.default_rng(2)
    columns = np.abs(rng.standard_normal((80, 400)))
    x, left = sparse_nnls(columns, columns.sum(axis=1), 0.0, max_columns=17)
    assert np.count_nonzero(x) <= 17
    assert left > 0


def test_without_improving_columns_the_solution_is_zero():
    x, left = sparse_nnls(-np.eye(3), np.ones(3), 1e-6)
    assert not x.any()
    assert left == 1.0


def test_a_sketch_preserves_norms_on_average():
    rng = np.random.default_rng(3)
    vector = rng.standard_normal(500)
    sizes = [np.linalg.norm(sketch(40, 500, rng) @ vector) ** 2 for _ in range(200)]
    assert np.mean(sizes) == pytest.approx(vector @ vector, rel=0.05)
    np.testing.assert_array_equal(sketch(500, 500, rng), np.eye(500))


def test_representable_moments_are_fitted_exactly():
    rng = np.random.default_rng(4)
    sampled, wanted = rng.standard_normal((30, 400)), rng.standard_normal((5, 30))
    np.testing.assert_allclose(fit_moments(sampled, wanted @ sampled), wanted, atol=1e-8)
