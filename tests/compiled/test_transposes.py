"""Transposes in registers, against those of numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from palpate.compiled.lanes import LANES
from palpate.compiled.transposes import LINE_NUMBERS, lanes_to_nodes, nodes_to_lanes


@njit
def to_lanes(nodes, rows):
    nodes_to_lanes(nodes, rows)


@njit
def to_nodes(rows, nodes, first):
    lanes_to_nodes(rows, nodes, first)


def expected_rows(nodes):
    """Derivatives row by row, then the fourth numbers of the three components."""
    return np.concatenate([nodes[:, :3, :3].reshape(len(nodes), 9), nodes[:, :3, 3]], axis=1).T


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_nodes_and_lanes_are_transposes_of_each_other(dtype):
    lines = LINE_NUMBERS[dtype] // 4
    nodes = np.random.default_rng(0).standard_normal((3 * LANES, lines, 4)).astype(dtype)
    rows = np.zeros(12 * LANES)
    to_lanes(nodes[:LANES], rows)
    np.testing.assert_array_equal(rows.reshape(12, LANES), expected_rows(nodes[:LANES].astype(float)))
    copy = np.zeros_like(nodes)
    to_nodes(rows, copy, LANES)
    np.testing.assert_array_equal(copy[LANES : 2 * LANES, :3], nodes[:LANES, :3])
    assert not copy[:LANES].any()
    assert not copy[2 * LANES :].any()
    assert not copy[:, 3:].any()
