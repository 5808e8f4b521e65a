"""Shares of nodal cells in a region."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt

CLOUD = pt.box((0.05, 0.04, 0.04), 0.005)


def test_the_shares_of_a_ball_sum_to_its_volume():
    centre, radius = np.array([0.023, 0.021, 0.019]), 0.011
    share = pt.cell_fractions(CLOUD, lambda x: np.linalg.norm(x - centre, axis=1) < radius)
    assert share @ CLOUD.volumes == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.02)
    away = np.linalg.norm(CLOUD.points - centre, axis=1)
    assert np.all(share[away < radius - 0.0045] == 1)
    assert np.all(share[away > radius + 0.0045] == 0)


def test_a_plane_between_nodes_divides_their_cells():
    share = pt.cell_fractions(CLOUD, lambda x: x[:, 0] < 0.021)
    column = np.isclose(CLOUD.points[:, 0], 0.02)
    np.testing.assert_allclose(share[column], 0.7, atol=0.1)  # the cell reaches from 17.5 to 22.5 mm
    assert share @ CLOUD.volumes == pytest.approx(0.021 * 0.04 * 0.04, rel=0.02)


def test_another_shape_and_a_plane_cloud_are_refused():
    with pytest.raises(pt.InputError, match=r"inside must return one truth value per point"):
        pt.cell_fractions(CLOUD, lambda x: True)
    with pytest.raises(pt.InputError, match=r"cloud must be in space"):
        pt.cell_fractions(pt.box((0.05, 0.04), 0.005), lambda x: x[:, 0] < 1)
