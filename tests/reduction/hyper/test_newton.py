"""Cholesky's method of the implicit step against linear algebra."""

from __future__ import annotations

import numpy as np

from palpate.reduction.hyper.newton import cholesky_factor, cholesky_solve


def test_a_factor_of_the_leading_block_solves_its_system():
    random, count = np.random.default_rng(0), 5
    root = random.standard_normal((7, 7))
    matrix = root @ root.T + np.triu(random.standard_normal((7, 7)), 1)  # its symmetric part is factorised
    symmetric = 0.5 * (matrix + matrix.T)[:count, :count] + 10.0 * np.eye(count)
    matrix[:count, :count] += 10.0 * np.eye(count)
    right = random.standard_normal(count)
    solution = right.copy()
    assert cholesky_factor.py_func(matrix, count)
    np.testing.assert_allclose(np.tril(matrix[:count, :count]), np.linalg.cholesky(symmetric), rtol=1e-12)
    cholesky_solve.py_func(matrix, count, solution)
    np.testing.assert_allclose(solution, np.linalg.solve(symmetric, right), rtol=1e-12)


def test_an_indefinite_matrix_has_no_factor():
    assert not cholesky_factor.py_func(np.diag([1.0, -1.0, 2.0]), 3)
    assert not cholesky_factor.py_func(np.diag([1.0, np.nan, 2.0]), 3)
