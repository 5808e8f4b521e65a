"""Tensors of a deformation gradient against linear algebra and the characteristic polynomial."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.dynamics.material.invariants import cofactor_of, first_invariants, right_cauchy_green


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["regular", "inverted"])
def test_cofactor_and_invariants_are_those_of_linear_algebra(sign):
    F = np.diag([sign, 1.0, 1.0]) + 0.3 * np.random.default_rng(0).uniform(-1, 1, (3, 3))
    numbers = tuple(F.ravel())
    assert np.sign(np.linalg.det(F)) == sign
    cofactor = np.reshape(cofactor_of.py_func(numbers), (3, 3))
    np.testing.assert_allclose(cofactor @ F.T, np.linalg.det(F) * np.eye(3), atol=1e-14)
    C = right_cauchy_green.py_func(numbers)
    matrix = np.array([[C[0], C[3], C[4]], [C[3], C[1], C[5]], [C[4], C[5], C[2]]])
    np.testing.assert_allclose(matrix, F.T @ F, atol=1e-14)
    # det(x - C) = x^3 - I1 x^2 + I2 x - I3
    np.testing.assert_allclose(first_invariants.py_func(C), np.poly(matrix)[1:3] * [-1.0, 1.0], rtol=1e-12)
