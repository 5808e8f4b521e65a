"""Linear reductions by projection: what theory promises of each."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.lti.projection_methods import eigenvectors
from palpate.reduction.lti.reductors import PROJECTION_METHODS

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("points", [(0.0,), (200.0,), (0.0, 300.0j), (400.0j,)])
@pytest.mark.parametrize("form", ["system", "strong_system"])
def test_transfer_functions_match_at_the_expansion_points(points, form, request):
    system = request.getfixturevalue(form)
    blocks = sum(2 if np.imag(s) else 1 for s in points)
    model = pt.lti.reduce_linear(system, "moments", 6 * blocks, points=points)  # two moments at every point
    exact, found = (source.transfer(points) for source in (system, model.reduced))
    scale = np.abs(exact).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(found / scale, exact / scale, atol=1e-7)
    # and so do their slopes
    shift = 1e-3 * max(100.0, np.abs(points).max())
    near = np.array(points) + shift
    slopes = [(source.transfer(near) - source.transfer(points)) / shift for source in (system, model.reduced)]
    size = np.abs(slopes[0]).max()
    np.testing.assert_allclose(slopes[1], slopes[0], atol=2e-3 * size)


@pytest.mark.parametrize("method", PROJECTION_METHODS)
@pytest.mark.parametrize("modes", [1, 3, 6, 9])
def test_methods_that_preserve_stability_give_stable_models_of_the_energy_form(method, modes, system):
    assert pt.lti.reduce_linear(system, method, modes).stable


@pytest.mark.parametrize("method", ["modal", "condensed"])
@pytest.mark.parametrize("modes", [1, 3, 6])
def test_methods_that_preserve_stability_give_stable_models_of_the_strong_form(method, modes, strong_system):
    assert pt.lti.reduce_linear(strong_system, method, modes).stable


@pytest.mark.parametrize("form", ["system", "strong_system"])
def test_modal_truncation_keeps_the_slowest_poles(form, request):
    system = request.getfixturevalue(form)
    squares = np.linalg.eigvals(np.linalg.solve(system.mass.toarray(), system.stiffness.toarray()))
    slowest = np.sort(np.abs(squares))[:10]
    values, right, left = eigenvectors(system, 10)
    np.testing.assert_allclose(np.sort(np.abs(values))[:10], slowest, rtol=1e-6)
    beta = system.model.stiffness_damping
    expected = [root for square in values for root in np.roots([1, beta * square, square])]
    found = pt.lti.reduce_linear(system, "modal", 10).poles
    for pole in found:
        assert np.abs(np.array(expected) - pole).min() < 1e-5 * abs(pole)
    cross = left.T @ (system.mass @ right)
    assert np.linalg.matrix_rank(cross) == len(cross)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 20, 61, 120])
def test_left_and_right_modes_of_double_frequencies_are_not_separated(count, strong_system):
    """The bar is as wide as high: frequencies of its bending come in twos, and sets of them must not be parted."""
    _, right, left = eigenvectors(strong_system, count)
    assert count <= right.shape[1] == left.shape[1]
    cross = left.T @ (strong_system.mass @ right)
    sizes = [np.sqrt(np.sum(columns * (strong_system.mass @ columns), axis=0)) for columns in (left, right)]
    assert np.linalg.cond(cross / np.outer(*sizes)) < 100


@pytest.mark.parametrize("form", ["system", "strong_system"])
@pytest.mark.parametrize("method", PROJECTION_METHODS)
def test_errors_decrease_with_more_modes(method, form, request, soft_pull):
    system = request.getfixturevalue(form)
    full = pt.rollout(system.model, [soft_pull], duration=0.02, every=0.0005, progress=False)
    runs = [
        pt.rollout(
            pt.lti.reduce_linear(system, method, modes), [soft_pull], duration=0.02, every=0.0005, progress=False
        )
        for modes in (3, 9)
    ]
    few, many = (pt.relative_errors(full, run).displacement for run in runs)
    assert many < few
    assert many < 0.3


def test_condensation_preserves_poles_and_the_static_response(system):
    model = pt.lti.reduce_linear(system, "condensed", 30)
    assert (model.count, model.report["method"]) == (33, "condensed")  # three inputs
    exact = system.transfer(0.0)
    np.testing.assert_allclose(model.reduced.transfer(0.0), exact, atol=1e-9 * np.abs(exact).max())
    frequencies = np.array([50.0, 200.0])
    exact = system.frequency_response(frequencies)
    np.testing.assert_allclose(model.frequency_response(frequencies), exact, atol=1e-2 * np.abs(exact).max())
    modal = pt.lti.reduce_linear(system, "modal", 30)
    for pole in modal.poles:
        assert np.abs(model.poles - pole).min() < 1e-5 * abs(pole)


@pytest.mark.parametrize("form", ["system", "strong_system", "tool_system"])
def test_transfer_functions_are_those_of_a_dense_solve(form, request):
    """Of the system at several frequencies, and of a condensed model with nearly all modes."""
    system = request.getfixturevalue(form)
    m, e, k = (matrix.toarray() for matrix in (system.mass, system.damping, system.stiffness))
    condensed = pt.lti.reduce_linear(system, "condensed", system.order - 20)
    for s in (0.0, 40.0j, 300.0j, 2000.0j, 30.0 + 700.0j):
        solved = np.linalg.solve(s * s * m + s * e + k, system.input.toarray().astype(complex))
        exact = (system.output.toarray() + s * system.rate_output.toarray()) @ solved + system.feedthrough
        scale = np.abs(exact).max()
        np.testing.assert_allclose(system.transfer(s)[0], exact, atol=1e-9 * scale)
        np.testing.assert_allclose(condensed.reduced.transfer(s)[0], exact, atol=5e-3 * scale)


def test_reduced_systems_with_a_tool_are_stable(tool_system):
    for method in PROJECTION_METHODS:
        model = pt.lti.reduce_linear(tool_system, method, 6)
        assert model.lifting_count == 6
        assert model.stable
        assert len(model.C) == 9


@pytest.mark.parametrize(
    ("method", "modes", "options", "message"),
    [
        ("fourier", 4, {}, "method must be one of 'modal', 'moments', 'condensed', got 'fourier'"),
        ("balanced", 4, {}, r"got 'balanced'; .*to_pymor\(model\) .*from_pymor\(rom, model, reductor\).*'condensed'"),
        ("modal", 0, {}, r"modes must be an integer in \[1, 287\], got 0"),
        ("condensed", 287, {}, r"modes must be an integer in \[1, 286\], got 287"),
        ("modal", 4, {"points": (0.0,)}, r"points must be None for method 'modal', got \(0.0,\)"),
        ("moments", 4, {"points": (-1.0,)}, "real parts of at least 0"),
        ("moments", 4, {"points": ()}, "real parts of at least 0"),
    ],
)
def test_bad_requests_are_refused(system, method, modes, options, message):
    with pytest.raises(pt.InputError, match=message):
        pt.lti.reduce_linear(system, method, modes, **options)


def test_scales_divide_by_the_largest_static_response_of_a_unit(system, tool_system):
    outputs, inputs = system.scales([1.0, 0.1, 0.1])
    np.testing.assert_array_equal(inputs, [1.0, 0.1, 0.1])
    scaled = np.abs(outputs[:, None] * system.transfer(0.0)[0].real * inputs)
    assert scaled[:3].max() == pytest.approx(1.0)  # displacements
    assert scaled[3:].max() == pytest.approx(1.0)  # forces of the support
    inputs = tool_system.scales()[1]
    np.testing.assert_allclose(inputs[:3], 1.0)
    np.testing.assert_allclose(1 / inputs[3:], np.abs(tool_system.lifting[3:]).max(axis=(1, 2)))
    with pytest.raises(pt.InputError, match="one per input"):
        system.scales([1.0])
