"""Stencils in compressed rows say the same as the stencils, and so do the sums over them."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.lanes import LANES, transpose
from palpate.compiled.rows import ROW_WIDTHS, aligned_zeros, gather_fluxes, row_table

CLOUDS = {
    "jittered": pt.box((0.5, 0.4, 0.3), spacing=0.1, jitter=0.2),
    "lattice": pt.box((1.2, 0.8, 0.8), spacing=0.1),
}


@pytest.fixture(params=CLOUDS)
def stencils(request):
    return pt.moving_least_squares(CLOUDS[request.param].points, neighbours=42)


def random_weights(stencils, numbers):
    """Random weights (s, k, numbers) by row, 0 where a row is padded."""
    weights = np.random.default_rng(0).normal(size=(*stencils.first.shape[:2], numbers))
    weights[np.all(stencils.first == 0.0, axis=2)] = 0.0
    return weights


@pytest.mark.parametrize("numbers", [4, 5])  # of a solid, of a membrane
def test_the_gather_is_the_transposed_sum(stencils, numbers):
    weights = random_weights(stencils, numbers)[stencils.row]
    random, n = np.random.default_rng(1), len(stencils.row)
    volumes = random.uniform(0.5, 2.0, n)
    own = -weights.sum(axis=1)
    near, back = transpose(stencils.neighbours, weights, volumes)
    rows = row_table(near, np.arange(n), back, own)
    width, flux = rows.weights.shape[1], random.normal(size=(n, 3, numbers))
    assert width in ROW_WIDTHS
    padded, force = aligned_zeros(n, 3, width), np.full((n, 3), np.nan)
    padded[:, :, :numbers] = flux
    gather_fluxes[width](rows, padded, force)

    work = np.einsum("nkw,ncw->nkc", weights, flux) * volumes[:, None, None]
    expected = np.einsum("nw,ncw->nc", -own, flux) * volumes[:, None]
    np.add.at(expected, stencils.neighbours, -work)
    expected /= volumes[:, None]
    np.testing.assert_allclose(force, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


def test_rows_keep_neighbours_and_weights(stencils):
    weights = random_weights(stencils, 4)
    rows = row_table(stencils.neighbours, stencils.row, weights)
    np.testing.assert_array_equal(np.unique(rows.nodes), np.arange(len(stencils.row)))
    assert rows.nodes.shape[1] == LANES
    field = np.random.default_rng(1).normal(size=len(stencils.row))
    difference = field[stencils.neighbours] - field[:, None]
    expected = np.einsum("nkw,nk->nw", weights[stencils.row], difference)
    for i, (begin, end) in enumerate(zip(rows.start, rows.stop, strict=True)):
        first = rows.weight_start[i]
        found = (field[rows.neighbours[begin:end]] - field[i]) @ rows.weights[first : first + end - begin]
        np.testing.assert_allclose(found, expected[i], rtol=0.0, atol=1e-12)


def test_nodes_of_a_lattice_share_their_weights():
    entries = {}
    for name, cloud in CLOUDS.items():
        stencils = pt.moving_least_squares(cloud.points, neighbours=42)
        rows = row_table(stencils.neighbours, stencils.row, random_weights(stencils, 4))
        entries[name] = len(rows.weights) / len(rows.neighbours)
    assert entries["jittered"] == 1.0
    assert entries["lattice"] < 0.5


def test_weights_start_at_a_cache_line():
    assert all(aligned_zeros(size, 3).ctypes.data % 64 == 0 for size in range(1, 40))
