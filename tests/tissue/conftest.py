"""Deformations that the tests of materials share."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def deformations():
    return np.eye(3) + np.random.default_rng(0).uniform(-0.3, 0.3, size=(8, 3, 3))


@pytest.fixture
def rotations():
    q, r = np.linalg.qr(np.random.default_rng(1).normal(size=(8, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    return q * np.sign(np.linalg.det(q))[:, None, None]
