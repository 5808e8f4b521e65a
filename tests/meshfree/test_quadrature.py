"""Nodal weights that integrate quadratics, a smoothing that keeps integrals, and what a quadratic fit misses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree import quadrature
from palpate.meshfree.quadrature import (
    MIN_WEIGHT_RATIO,
    conservative_smoothing,
    integration_weights,
    quadratic_residuals,
)

BOXES = {"cube of 4": ((0.03,) * 3, 0.01), "bar": ((0.06, 0.02, 0.025), 0.005), "cube of 8": ((0.07,) * 3, 0.01)}


def weights_of(cloud, neighbours=42):
    return integration_weights(cloud, pt.moving_least_squares(cloud.points, neighbours=neighbours))


def linear_fit(cloud):
    return pt.moving_least_squares(cloud.points, order=1, neighbours=27, interpolating=False)


def quadratics(cloud):
    """All quadratic monomials at the nodes, (n, 10), and their integrals over the box, relative to its volume."""
    size = np.ptp(cloud.points, axis=0)
    x = cloud.points / size
    pairs = [(a, b) for a in range(3) for b in range(a, 3)]
    fields = np.column_stack([np.ones(len(x)), x, *(x[:, a] * x[:, b] for a, b in pairs)])
    return fields, np.array([1, *[1 / 2] * 3, *(1 / 3 if a == b else 1 / 4 for a, b in pairs)])


@pytest.fixture
def unclipped(monkeypatch):
    """Without the least weight, which the corners of a box would fall short of."""
    monkeypatch.setattr(quadrature, "MIN_WEIGHT_RATIO", -1.0)


@pytest.mark.parametrize("neighbours", [35, 42, 60])
@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("name", BOXES)
def test_weights_are_positive_and_sum_to_the_volume(name, jitter, neighbours):
    size, spacing = BOXES[name]
    cloud = pt.box(size, spacing, jitter)
    weights = weights_of(cloud, neighbours)
    assert weights.sum() == pytest.approx(np.prod(size), rel=1e-12)
    assert (weights / cloud.volumes).min() > 0.95 * MIN_WEIGHT_RATIO


@pytest.mark.parametrize("neighbours", [27, 42, 60])
@pytest.mark.parametrize("name", BOXES)
def test_quadratics_on_a_lattice_are_integrated_exactly_where_no_weight_is_clipped(name, neighbours, unclipped):
    cloud = pt.box(*BOXES[name])
    fields, integrals = quadratics(cloud)
    weights = weights_of(cloud, neighbours)
    assert np.abs(weights / cloud.volumes - 1).max() > 0.2
    np.testing.assert_allclose(weights @ fields / weights.sum(), integrals, rtol=1e-12)


@pytest.mark.parametrize("name", BOXES)
def test_corners_receive_weight_with_the_same_integrals_of_quadratics(name, monkeypatch):
    cloud = pt.box(*BOXES[name])
    fields, integrals = quadratics(cloud)
    weights = weights_of(cloud)
    np.testing.assert_allclose(weights @ fields / weights.sum(), integrals, rtol=1e-9)
    monkeypatch.setattr(quadrature, "MIN_WEIGHT_RATIO", -1.0)
    small = np.flatnonzero(weights_of(cloud) < MIN_WEIGHT_RATIO * cloud.volumes)
    assert set(small) <= set(np.flatnonzero(np.bincount(cloud.face_nodes, minlength=len(cloud)) == 3))
    np.testing.assert_allclose(weights[small], MIN_WEIGHT_RATIO * cloud.volumes[small], rtol=1e-6)


@pytest.mark.parametrize("jitter", [0.1, 0.2, 0.3])
def test_quadratics_on_a_jittered_box_are_integrated_better_than_by_nodal_volumes(jitter):
    for seed in range(3):
        cloud = pt.box((0.05, 0.02, 0.02), 0.005, jitter, seed=seed)
        fields, integrals = quadratics(cloud)
        weights = weights_of(cloud)
        squares = slice(4, None, 1)
        missed, trapezium = (
            np.abs(w @ fields[:, squares] / w.sum() - integrals[squares]).mean() for w in (weights, cloud.volumes)
        )
        assert missed < 0.7 * trapezium


def test_a_smooth_function_is_integrated_with_order_3_and_by_nodal_volumes_with_order_2():
    slope = np.array([1.3, -0.7, 0.9])
    exact = np.prod((np.exp(slope) - 1) / slope)
    errors = []
    for cells in (6, 24):
        cloud = pt.box((1.0,) * 3, spacing=1 / cells)
        field = np.exp(cloud.points @ slope)
        errors.append([abs(weights_of(cloud) @ field - exact), abs(cloud.volumes @ field - exact)])
    rates = np.log2(np.array(errors[0]) / errors[1]) / 2
    assert rates[0] > 3.0
    assert rates[1] < 2.1
    assert errors[-1][0] < errors[-1][1] / 2000


def test_weights_on_a_lattice_are_end_corrections_by_the_depth_under_a_face(unclipped):
    cells = 16
    cloud = pt.box((1.0,) * 3, spacing=1 / cells)
    weights = (weights_of(cloud) * cells**3).reshape((cells + 1,) * 3)
    inner = weights[4:-4, 4:-4, 4:-4]
    np.testing.assert_allclose(inner, 1.0, rtol=1e-12)
    for axis in range(3):
        line = np.moveaxis(weights, axis, 0)[:, 7:10, 7:10]
        np.testing.assert_allclose(line, np.broadcast_to(line[:, :1, :1], line.shape), rtol=1e-12)
    rule = weights[:, 8, 8]
    np.testing.assert_allclose(rule, rule[::-1], rtol=1e-12)
    x = np.arange(cells + 1.0)
    np.testing.assert_allclose([rule.sum(), rule @ x, rule @ x**2], [cells, cells**2 / 2, cells**3 / 3], rtol=1e-12)
    np.testing.assert_allclose(rule[:4], [3 / 8, 7 / 6, 23 / 24, 1], atol=0.003)  # Gregory's of third order


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_weights_scale_with_the_body(jitter):
    near, far = (weights_of(pt.box((s, 0.5 * s, 0.5 * s), 0.125 * s, jitter)) for s in (1.0, 1e-3))
    np.testing.assert_allclose(far, 1e-9 * near, rtol=1e-9)


CLOUDS = {"lattice": (0.06, 0.0), "jitter": (0.03, 0.2), "more jitter": (0.03, 0.3)}


@pytest.fixture(params=CLOUDS)
def smoothed(request):
    """A cloud, its weights, and a linear fit before and after its change."""
    length, jitter = CLOUDS[request.param]
    cloud = pt.box((length, 0.02, 0.02), 0.005, jitter)
    volumes, fit = weights_of(cloud), linear_fit(cloud)
    return cloud, volumes, fit, conservative_smoothing(fit.neighbours, fit.value[fit.row], volumes)


def applied(fit, value, own, field):
    return np.sum(value * field[fit.neighbours], axis=1) + own * field


def test_a_conservative_smoothing_keeps_integrals_and_constants(smoothed):
    cloud, volumes, fit, (value, own) = smoothed
    field = np.random.default_rng(0).normal(size=len(cloud))
    after = applied(fit, value, own, field)
    assert abs(volumes @ (after - field)) < 1e-9 * volumes @ np.abs(field)
    assert abs(volumes @ (fit.fit(field) - field)) > 1e-3 * volumes @ np.abs(field)  # what it is there for
    np.testing.assert_allclose(value.sum(axis=1) + own, 1.0, rtol=1e-14)


def test_the_transpose_of_a_conservative_smoothing_keeps_a_uniform_field(smoothed):
    _, volumes, fit, (value, own) = smoothed
    back, before = own * volumes, fit.own[fit.row] * volumes
    np.add.at(back, fit.neighbours, volumes[:, None] * value)
    np.add.at(before, fit.neighbours, volumes[:, None] * fit.value[fit.row])
    np.testing.assert_allclose(back, volumes, rtol=1e-8)
    assert (before / volumes).min() < 0.7
    assert (before / volumes).max() > 3


def test_a_conservative_smoothing_still_smooths(smoothed):
    cloud, volumes, fit, (value, own) = smoothed
    noise = np.random.default_rng(1).normal(size=(20, len(cloud)))
    left = [volumes @ applied(fit, value, own, f) ** 2 / (volumes @ f**2) for f in noise]
    assert np.sqrt(np.mean(left)) < 0.65


def test_a_conservative_smoothing_misses_linear_fields_by_a_fraction_of_the_spacing(smoothed):
    cloud, _, fit, (value, own) = smoothed
    for x in cloud.points.T / cloud.spacing:
        np.testing.assert_allclose(applied(fit, value, own, x), x, atol=0.3)


def test_conservation_does_not_change_the_smoothing_inside_a_lattice():
    cloud = pt.box((0.13,) * 3, 0.01)
    fit = linear_fit(cloud)
    value, own = conservative_smoothing(fit.neighbours, fit.value[fit.row], weights_of(cloud))
    change = np.abs(value - fit.value[fit.row]).max(axis=1).reshape(14, 14, 14)
    assert change.max() > 0.03
    by_depth = [change[k:-k, k:-k, k:-k].max() for k in (1, 3, 5)]
    assert by_depth[1] < 0.1 * by_depth[0]
    assert by_depth[2] < 1e-4
    missed = np.abs(applied(fit, value, own, cloud.points[:, 0]) - cloud.points[:, 0]).reshape(14, 14, 14)
    assert missed[5:-5, 5:-5, 5:-5].max() < 1e-4 * cloud.spacing


def test_a_smoothing_without_solution_is_refused_with_the_node(monkeypatch):
    cloud = pt.box((0.02,) * 3, 0.005)
    monkeypatch.setattr(quadrature, "INTEGRAL_TOLERANCE", 0.0)
    fit = linear_fit(cloud)
    with pytest.raises(pt.CloudError, match=r"no smoothing of the pressure keeps its integral near node \d+ "):
        conservative_smoothing(fit.neighbours, fit.value[fit.row], cloud.volumes)


def missed(cloud, field):
    stencils = pt.moving_least_squares(cloud.points, neighbours=42)
    weights = quadratic_residuals(stencils, cloud.points)[stencils.row]
    return np.sum(weights * (field[stencils.neighbours] - field[:, None]), axis=1)


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_the_hourglass_residual_of_quadratics_is_zero(jitter):
    cloud = pt.box((0.06, 0.02, 0.02), 0.005, jitter)
    for field in quadratics(cloud)[0].T:
        np.testing.assert_allclose(missed(cloud, field), 0, atol=1e-11)
    noise = np.random.default_rng(0).normal(size=len(cloud))
    assert np.abs(missed(cloud, noise)).mean() > 0.3


@pytest.mark.parametrize("jitter", [0.0, 0.1])
@pytest.mark.parametrize("number", [(1, 0, 0), (0, 1, 0), (1, 0, 1), (1, 1, 1)])
def test_the_hourglass_residual_has_most_of_waves_of_two_spacings(number, jitter):
    cloud = pt.box((0.11,) * 3, 0.01, jitter)
    lattice = pt.box((0.11,) * 3, 0.01).points / 0.01
    wave = np.cos(np.pi * lattice @ np.array(number))
    inside = np.all((lattice > 1.5) & (lattice < 9.5), axis=1)
    assert (missed(cloud, wave) / wave)[inside].min() > 0.4


def test_the_hourglass_residual_of_smooth_fields_is_of_fourth_order_inside_a_lattice():
    sizes = []
    for cells in (8, 16):
        cloud = pt.box((1.0,) * 3, 1 / cells)
        inside = np.all(np.abs(cloud.points - 0.5) < 0.26, axis=1)
        sizes.append(np.abs(missed(cloud, np.sin(cloud.points @ (2.0, 1.3, 0.7))))[inside].max())
    assert np.log2(sizes[0] / sizes[1]) > 3.7


def test_transfers_raise_small_weights_and_keep_integrals_of_quadratics():
    cloud = pt.box((0.07,) * 3, 0.01, 0.2)
    stencils = pt.moving_least_squares(cloud.points, neighbours=42)
    least = np.full(len(cloud), -np.inf)
    rng = np.random.default_rng(0)
    light = rng.choice(np.flatnonzero(np.bincount(cloud.face_nodes, minlength=len(cloud)) == 0), 20, replace=False)
    weights = cloud.volumes.copy()
    weights[light] *= rng.uniform(-0.2, 0.4, len(light))
    least[light] = 0.5 * cloud.volumes[light]
    raised = quadrature._transfer(weights, least, cloud, stencils)
    assert (raised[light] > 0.99 * least[light]).all()
    fields, _ = quadratics(cloud)
    np.testing.assert_allclose(raised @ fields, weights @ fields, rtol=1e-12)
    cubes = cloud.points**3 @ np.ones(3)
    assert abs(raised @ cubes - weights @ cubes) > 1e-9 * abs(weights @ cubes)


@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("name", BOXES)
def test_weights_of_boxes_need_no_transfers(name, jitter, monkeypatch):
    """So figures of boxes do not depend on them."""
    cloud = pt.box(*BOXES[name], jitter)
    weights = weights_of(cloud)
    monkeypatch.setattr(quadrature, "MIN_SMOOTH_RATIO", -np.inf)
    monkeypatch.setattr(quadrature, "MIN_MEDIAN_RATIO", -np.inf)
    np.testing.assert_array_equal(weights_of(cloud), weights)


@pytest.mark.slow
def test_weights_of_a_filled_body_integrate_quadratics_alike_and_are_not_small(monkeypatch):
    cloud = pt.fill(pt.liver_surface(0.004), spacing=0.012)
    weights = weights_of(cloud)
    assert (weights > 0.45 * cloud.volumes).all()
    assert weights.min() > 0.2 * np.median(cloud.volumes)
    monkeypatch.setattr(quadrature, "MIN_SMOOTH_RATIO", -np.inf)
    monkeypatch.setattr(quadrature, "MIN_MEDIAN_RATIO", -np.inf)
    clipped = weights_of(cloud)
    monkeypatch.setattr(quadrature, "MIN_WEIGHT_RATIO", -np.inf)
    unlimited = weights_of(cloud)
    assert unlimited.min() < 0.1 * np.median(cloud.volumes)
    fields, _ = quadratics(replace(cloud, points=cloud.points - cloud.points.mean(axis=0)))
    missed, without = (np.abs(w @ fields - unlimited @ fields).max() for w in (weights, clipped))
    assert missed < without / 10
