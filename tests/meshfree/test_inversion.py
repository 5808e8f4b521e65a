"""Cells between nodes, and the share of them that a deformation turns inside out."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree.inversion import cells_between, inverted_share


@pytest.fixture(scope="module")
def cloud():
    return pt.fill(pt.liver_surface(resolution=0.008, volume=2e-4), spacing=0.01)


def test_cells_fill_the_body(cloud):
    corners = cloud.points[cells_between(cloud)]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert np.all(volumes > 0)
    assert volumes.sum() == pytest.approx(cloud.volumes.sum(), rel=0.1)


def test_affine_deformations_turn_no_cell_and_mirrors_turn_all(cloud):
    cells = cells_between(cloud)
    stretch = np.array([[2.0, 0.5, 0.0], [0.0, 0.3, 0.0], [0.4, 0.0, 1.0]])
    assert inverted_share(cloud, cells, cloud.points @ stretch.T - cloud.points) == 0
    assert inverted_share(cloud, cells, -2 * cloud.points * [1, 0, 0]) == 1
    assert inverted_share(cloud, cells, 0 * cloud.points) == 0


def test_layers_that_pass_each_other_turn_the_cells_between_them():
    box = pt.box((0.05, 0.05, 0.05), 0.01)
    u, cells = np.zeros_like(box.points), cells_between(box)
    u[np.isclose(box.points[:, 2], 0.05), 2] = -0.012  # through the layer below, of five
    assert inverted_share(box, cells, u) == pytest.approx(0.2, abs=0.01)
