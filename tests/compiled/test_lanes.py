"""Stencils laid out for vector lanes say the same as the stencils."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.lanes import LANES, lane_table

CLOUDS = {
    "mixed": pt.box((0.5, 0.4, 0.3), spacing=0.1, jitter=0.2),
    "shared": pt.box((1.2, 0.8, 0.8), spacing=0.1),
}


@pytest.fixture(params=CLOUDS)
def stencils(request):
    return pt.moving_least_squares(CLOUDS[request.param].points, neighbours=42)


def table(stencils, *kinds):
    return lane_table(stencils.neighbours, stencils.row, *(getattr(stencils, kind) for kind in kinds))


def sums(lanes, weights, field):
    """The weighted sums of differences that the kernels take, block by block."""
    result = np.full((len(field), weights.one.shape[1]), np.nan)
    for b, nodes in enumerate(lanes.nodes):
        near = lanes.neighbours[lanes.start[b] : lanes.stop[b]]
        begin = lanes.weight_start[b]
        numbers = weights.one[..., None] if lanes.shared[b] else weights.lanes
        difference = field[near] - field[nodes]
        result[nodes] = np.einsum(
            "kwl,kl->lw",
            np.broadcast_to(numbers[begin : begin + len(near)], (len(near), *numbers.shape[1:-1], LANES)),
            difference,
        )
    return result


def test_every_node_lies_in_a_block(stencils):
    lanes, _ = table(stencils, "first")
    np.testing.assert_array_equal(np.unique(lanes.nodes), np.arange(len(stencils.row)))
    assert len(lanes.nodes) <= len(stencils.row) // LANES + len(np.unique(stencils.row)) + 1


def test_blocks_keep_the_derivatives(stencils):
    field = np.random.default_rng(0).normal(size=len(stencils.row))
    lanes, (first, second) = table(stencils, "first", "second")
    for weights, expected in ((first, stencils.gradient(field)), (second, stencils.hessian(field))):
        np.testing.assert_allclose(sums(lanes, weights, field), expected, atol=1e-11 * np.abs(expected).max())


def test_a_lattice_has_shared_and_mixed_blocks_and_a_jittered_cloud_only_mixed_ones():
    shared = {}
    for name, cloud in CLOUDS.items():
        lanes, (first,) = table(pt.moving_least_squares(cloud.points, neighbours=42), "first")
        shared[name] = lanes.shared
        assert (len(first.one) > 0) == lanes.shared.any()
        assert (len(first.lanes) > 0) == (not lanes.shared.all())
    assert not shared["mixed"].any()
    assert shared["shared"].any()
    assert not shared["shared"].all()


def test_nodes_of_a_shared_block_share_their_row(stencils):
    lanes, _ = table(stencils, "first")
    for nodes in lanes.nodes[lanes.shared]:
        assert len(np.unique(stencils.row[nodes])) == 1


def test_lanes_keep_the_values_of_a_fit_that_does_not_interpolate():
    points = CLOUDS["shared"].points
    smoother = pt.moving_least_squares(points, order=1, neighbours=27, interpolating=False)
    lanes, (value,) = table(smoother, "value")
    field = np.random.default_rng(0).normal(size=len(points))
    # weights of a fitted value sum to 1 with the node's own, so the sum of differences is the fit less the node's value
    np.testing.assert_allclose(sums(lanes, value, field)[:, 0], smoother.fit(field) - field, atol=1e-11)
