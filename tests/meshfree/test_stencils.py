"""Moving least squares: what the weights reproduce, how fast they converge, and which clouds they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.linalg import norm

import palpate as pt
from palpate.meshfree.stencils import MAX_CONDITION

SIZES = {2: (0.8, 0.7), 3: (0.5, 0.5, 0.6)}
ENOUGH = {(2, 1): 9, (2, 2): 16, (2, 3): 30, (3, 1): 20, (3, 2): 42, (3, 3): 90}
SECOND = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))}


def polynomial(points, order, seed=0):
    """A random polynomial of a total degree: its values, first and second derivatives."""
    d = points.shape[1]
    powers = np.stack(np.meshgrid(*[np.arange(order + 1)] * d, indexing="ij"), axis=-1).reshape(-1, d)
    powers = powers[powers.sum(axis=1) <= order]
    factors = np.random.default_rng(seed).normal(size=len(powers))

    def derivative(*axes):
        p, f = powers.copy(), factors.copy()
        for a in axes:
            f = f * p[:, a]
            p[:, a] = np.maximum(p[:, a] - 1, 0)
        return np.prod(points[:, None, :] ** p, axis=2) @ f

    first = np.stack([derivative(a) for a in range(d)], axis=-1)
    return derivative(), first, np.stack([derivative(a, b) for a, b in SECOND[d]], axis=-1)


@pytest.mark.parametrize("interpolating", [True, False], ids=["interpolating", "plain"])
@pytest.mark.parametrize("jitter", [0.0, 0.25], ids=["lattice", "jitter"])
@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("d", [2, 3])
def test_polynomials_of_the_order_are_reproduced(d, order, jitter, interpolating):
    points = pt.box(SIZES[d], spacing=0.1, jitter=jitter).points
    stencils = pt.moving_least_squares(points, order=order, neighbours=ENOUGH[d, order], interpolating=interpolating)
    value, first, second = polynomial(points, order)
    np.testing.assert_allclose(stencils.fit(value), value, atol=1e-10)
    np.testing.assert_allclose(stencils.gradient(value), first, atol=1e-8)
    if order > 1:
        np.testing.assert_allclose(stencils.hessian(value), second, atol=1e-6)
    else:
        assert not stencils.second.any()
        assert not stencils.own_second.any()


@pytest.mark.parametrize(("d", "cells"), [(2, (10, 20, 40)), (3, (6, 12))])
def test_first_derivatives_converge_with_order_2_and_second_with_order_1(d, cells):
    direction = np.array([2.0, 1.3, 0.7])[:d]
    errors = []
    for count in cells:
        points = pt.box((1.0,) * d, spacing=1 / count, jitter=0.2).points
        stencils = pt.moving_least_squares(points, order=2, neighbours=ENOUGH[d, 2])
        phase = points @ direction
        field, first = np.sin(phase), np.cos(phase)[:, None] * direction
        second = -np.stack([np.sin(phase) * direction[a] * direction[b] for a, b in SECOND[d]], axis=-1)
        errors.append([norm(stencils.gradient(field) - first), norm(stencils.hessian(field) - second)] / norm(phase))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert rates[:, 0].min() > 1.8
    assert rates[:, 1].min() > 0.8


def test_third_order_fits_converge_faster():
    errors = []
    for count in (10, 20):
        points = pt.box((1.0, 1.0), spacing=1 / count, jitter=0.2).points
        slope = pt.moving_least_squares(points, order=3, neighbours=30).gradient(np.sin(2 * points[:, 0]))[:, 0]
        errors.append(np.abs(slope - 2 * np.cos(2 * points[:, 0])).mean())
    assert np.log2(errors[0] / errors[1]) > 2.7


def test_an_interpolating_fit_passes_through_its_nodes(jittered_points):
    field = np.random.default_rng(0).normal(size=len(jittered_points))
    through = pt.moving_least_squares(jittered_points, neighbours=42)
    smoothing = pt.moving_least_squares(jittered_points, neighbours=42, interpolating=False)
    np.testing.assert_array_equal(through.fit(field), field)
    assert np.abs(smoothing.fit(field) - field).max() > 0.1


def test_a_vector_field_is_differentiated_component_by_component(jittered_points):
    stencils = pt.moving_least_squares(jittered_points, neighbours=42)
    field = np.random.default_rng(0).normal(size=(len(jittered_points), 3))
    for apply, width in ((stencils.gradient, 3), (stencils.hessian, 6)):
        result = apply(field)
        assert result.shape == (len(field), 3, width)
        np.testing.assert_array_equal(result[:, 1], apply(field[:, 1].copy()))


def test_stencils_scale_with_the_body(jittered_points):
    near, far = (pt.moving_least_squares(s * jittered_points, neighbours=42) for s in (1.0, 1e-3))
    field = np.sin(5 * jittered_points).sum(axis=1)
    np.testing.assert_allclose(far.gradient(field), 1e3 * near.gradient(field), rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(far.hessian(field), 1e6 * near.hessian(field), rtol=1e-7, atol=1e-1)


@pytest.mark.parametrize("wished", [27, 35, 42, 60])
def test_stencils_of_a_lattice_hold_whole_shells(wished):
    points = pt.box((0.6, 0.6, 0.6), spacing=0.1).points
    stencils = pt.moving_least_squares(points, neighbours=wished)
    for node, near in enumerate(stencils.neighbours):
        distance = norm(points - points[node], axis=1)
        near = near[near != node]
        reached = distance <= distance[near].max() * (1 + 1e-9)
        assert reached.sum() - 1 == len(near)
        assert int(0.8 * wished) <= len(near) + 1 <= 1.3 * wished + 1


def test_stencils_inside_a_lattice_are_mirror_symmetric():
    points = pt.box((0.6, 0.6, 0.6), spacing=0.1).points
    middle = int(np.argmin(norm(points - 0.3, axis=1)))
    stencils = pt.moving_least_squares(points, neighbours=42)
    near = stencils.neighbours[middle]
    offsets = np.rint((points[near] - points[middle]) / 0.1).astype(int)
    first, second = stencils.first[stencils.row[middle]], stencils.second[stencils.row[middle]]
    at = {tuple(offset): k for k, offset in enumerate(offsets.tolist())}
    for a in range(3):
        sign = np.where(np.arange(3) == a, -1, 1)
        mirrored = [at[tuple(offset)] for offset in (offsets * sign).tolist()]
        np.testing.assert_allclose(first[mirrored] * sign, first, atol=1e-12 * np.abs(first).max())
        np.testing.assert_allclose(second[mirrored, :3], second[:, :3], atol=1e-12 * np.abs(second).max())


def test_nodes_that_share_a_row_get_the_weights_they_would_get_alone():
    lattice = pt.box((0.8, 0.8, 0.8), spacing=0.1).points
    apart = pt.box((1.0, 1.0, 1.0), spacing=0.1, jitter=0.3).points + 50  # so irregular that nothing is shared
    shared = pt.moving_least_squares(lattice, neighbours=42)
    alone = pt.moving_least_squares(np.concatenate([lattice, apart]), neighbours=42)
    n = len(lattice)
    assert len(np.unique(shared.row)) < n / 2
    assert len(np.unique(alone.row[:n])) == n
    field = np.random.default_rng(0).normal(size=n)
    padded = np.concatenate([field, np.zeros(len(apart))])
    np.testing.assert_allclose(shared.gradient(field), alone.gradient(padded)[:n], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(shared.hessian(field), alone.hessian(padded)[:n], rtol=1e-8, atol=1e-7)


def test_a_radius_holds_the_nodes_nearer_than_it(jittered_points):
    stencils = pt.moving_least_squares(jittered_points, radius=0.31)
    for node, near in enumerate(stencils.neighbours):
        inside = np.flatnonzero(norm(jittered_points - jittered_points[node], axis=1) < 0.31)
        assert set(near[near != node]) == set(inside) - {node}
    _, first, second = (field := polynomial(jittered_points, 2))
    np.testing.assert_allclose(stencils.gradient(field[0]), first, atol=1e-9)
    np.testing.assert_allclose(stencils.hessian(field[0]), second, atol=1e-7)


def test_the_same_points_give_the_same_weights(jittered_points):
    one, two = (pt.moving_least_squares(jittered_points, neighbours=42) for _ in range(2))
    np.testing.assert_array_equal(one.neighbours, two.neighbours)
    np.testing.assert_array_equal(one.second, two.second)


def test_accepted_moment_matrices_are_well_conditioned(jittered_points):
    assert pt.moving_least_squares(jittered_points, neighbours=42).condition.max() < MAX_CONDITION


@pytest.mark.parametrize("distance", [0.0, 0.01])
def test_duplicate_and_nearly_duplicate_nodes_are_refused_by_number(jittered_points, distance):
    points = np.concatenate([jittered_points, jittered_points[17:18] + np.array([distance, 0, 0])])
    with pytest.raises(pt.CloudError, match=rf"nodes 17, {len(jittered_points)} are duplicates.*node 17 at"):
        pt.moving_least_squares(points, neighbours=42)


def test_nodes_with_too_few_neighbours_are_refused_by_number(jittered_points):
    points = np.concatenate([jittered_points, [[3.0, 0, 0], [3.1, 0, 0]]])
    n = len(jittered_points)
    with pytest.raises(pt.CloudError, match=rf"{n}, {n + 1}\b.*must have at least"):
        pt.moving_least_squares(points, radius=0.31)


def test_coplanar_neighbours_are_refused_by_number(jittered_points):
    plate = pt.box((1.2, 1.2), spacing=0.1, jitter=0.2).points
    n = len(jittered_points)
    points = np.concatenate([jittered_points, np.column_stack([plate + 5, np.full(len(plate), 5.0)])])
    with pytest.raises(pt.CloudError, match=rf"nodes {n}, {n + 1}, .*ill-conditioned.*plane"):
        pt.moving_least_squares(points, neighbours=42)


def test_neighbours_on_a_line_are_refused_in_the_plane():
    points = np.column_stack([np.arange(30.0), np.zeros(30)])
    with pytest.raises(pt.CloudError, match="ill-conditioned"):
        pt.moving_least_squares(points, neighbours=12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "either neighbours or radius"),
        ({"neighbours": 42, "radius": 0.3}, "either neighbours or radius"),
        ({"neighbours": 42, "order": 4}, "order must be .*, got 4"),
        ({"neighbours": 42, "order": 0}, "order must be .*, got 0"),
        ({"neighbours": 9}, r"neighbours must be an integer in \[10, .*, got 9"),
        ({"neighbours": 42.5}, r"neighbours must be .*, got 42\.5"),
        ({"radius": -0.3}, r"radius must be .*, got -0\.3"),
        ({"radius": 0.0}, r"radius must be .*, got 0\.0"),
    ],
)
def test_arguments_out_of_range_are_refused_by_name(jittered_points, arguments, message):
    with pytest.raises(pt.InputError, match=message):
        pt.moving_least_squares(jittered_points, **arguments)


@pytest.mark.parametrize("count", [1, 2, 8])
def test_too_few_points_are_refused(jittered_points, count):
    with pytest.raises(pt.CloudError):
        pt.moving_least_squares(jittered_points[:count], neighbours=42)


def test_points_that_are_not_finite_are_refused(jittered_points):
    points = jittered_points.copy()
    points[4, 1] = np.nan
    with pytest.raises(pt.CloudError, match=r"points must be finite.*\b4\b"):
        pt.moving_least_squares(points, neighbours=42)
