"""Reductions of validation/linear_methods.py, on a small bar: what theory promises of the Hankel norm and the rest."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hankel_norm import Realisation, hankel_norm, lyapunov_factor
from linear_methods import METHODS, Reductions
from linear_runs import input_sizes, linear_run

import palpate as pt

pytestmark = [pytest.mark.slow, pytest.mark.release]

WHY = "pyMOR is not installed: pip install 'palpate[linear]'"
CONDENSED = 40


@pytest.fixture(scope="module")
def pull():
    return pt.SurfaceForce("x+", force=lambda time: 1e-4 * np.sin(300 * time) ** 2 * np.array([0.6, 0.15, 0.05]))


def held_bar(bar, tissue, form, damping, pull):
    body = pt.Solid(bar, tissue, fixed="x-", form=form, stiffness_damping=damping)
    return pt.lti.linearise(body, [pull], ["x+", "x-"])


@pytest.fixture(scope="module")
def reduction(bar, tissue, pull):
    return Reductions(held_bar(bar, tissue, "energy", 2e-5, pull), CONDENSED, ([pull], 0.02, 0.0005))


@pytest.fixture(scope="module")
def strong_reduction(bar, tissue, calm, pull):
    return Reductions(held_bar(bar, tissue, "strong", calm, pull), CONDENSED, ([pull], 0.02, 0.0005))


@pytest.fixture(scope="module")
def tool_system(bar, tissue):
    body = pt.Solid(bar, tissue, fixed="x-", form="energy", stiffness_damping=2e-5)
    return pt.lti.linearise(body, [pt.PrescribedMotion("tip", (0.0, 0.0, 0.0))], ["z+"])


def frequencies(model, count=150):
    """Frequencies over all of the spectrum, and every resonance."""
    poles = np.abs(model.poles)
    return np.unique(np.concatenate([[0.0], poles, np.geomspace(0.1 * poles.min(), 3 * poles.max(), count)]))


@pytest.mark.parametrize("form", ["reduction", "strong_reduction"])
@pytest.mark.parametrize("method", ["balanced", "hankel"])
def test_errors_stay_below_twice_the_sum_of_the_discarded_hankel_singular_values(method, form, request):
    pytest.importorskip("pymor", reason=WHY)
    own = request.getfixturevalue(form)
    grid, errors = frequencies(own.condensed), []
    exact = own.condensed.frequency_response(grid)
    for modes in (2, 4, 8, 12):
        model = own.model(method, modes)
        errors.append(own.sizes(exact - model.frequency_response(grid)).max())
        assert errors[-1] <= own.bound(model.reduced.states) * (1 + 1e-6)
        # no system of as many states is nearer than the first value that it discards
        assert errors[-1] >= own.hankel_singular_values[model.reduced.states] * (1 - 1e-6)
        assert model.stable
        if method == "balanced":
            assert model.report["bound"] == pytest.approx(own.bound(2 * modes), rel=1e-4)
    assert errors[-1] < 0.2 * errors[0]


def test_the_hankel_norm_of_the_error_is_the_first_discarded_value(reduction):
    own, values = reduction.realisation
    for order in (4, 10):
        reduced = hankel_norm(own, values, order)
        kept = len(reduced.A)
        apart = Realisation(
            scipy.linalg.block_diag(own.A, reduced.A), np.vstack([own.B, reduced.B]),
            np.hstack([own.C, -reduced.C]), own.D,
        )  # fmt: skip
        controlled, observed = lyapunov_factor(apart.A, apart.B), lyapunov_factor(apart.A.T, apart.C.T)
        norm = np.linalg.norm(observed.T @ controlled, 2)
        assert norm == pytest.approx(values[kept], rel=1e-3)


def test_a_balanced_realisation_has_its_values_as_both_gramians(reduction):
    own, values = reduction.realisation
    leading = slice(0, 20)
    for a, b in ((own.A, own.B), (own.A.T, own.C.T)):
        gramian = scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T)
        np.testing.assert_allclose(gramian[leading, leading], np.diag(values[leading]), atol=1e-6 * values[0])


def test_pymor_finds_the_same_hankel_singular_values(reduction):
    pytest.importorskip("pymor", reason=WHY)
    found = reduction.pymor.to_lti().hsv()
    np.testing.assert_allclose(found[:20], reduction.hankel_singular_values[:20], rtol=1e-5)


@pytest.mark.parametrize("form", ["reduction", "strong_reduction"])
@pytest.mark.parametrize("method", METHODS)
def test_errors_decrease_with_more_modes(method, form, request, pull):
    if method in ("sobt-vp", "irka"):  # these promise nothing of the kind
        pytest.skip("no promise")
    pytest.importorskip("pymor", reason=WHY)
    own = request.getfixturevalue(form)
    hold = {"duration": 0.02, "every": 0.0005, "progress": False}
    full = pt.rollout(own.system.model, [pull], **hold)
    runs = [pt.rollout(own.model(method, modes), [pull], **hold) for modes in (3, 9)]
    few, many = (pt.relative_errors(full, run).displacement for run in runs)
    assert many < few
    assert many < 0.3


@pytest.mark.parametrize("modes", [1, 3, 6, 9])
@pytest.mark.parametrize("method", ["pod", "sobt-fv", "hankel"])
def test_methods_that_preserve_stability_give_stable_models(method, modes, reduction):
    pytest.importorskip("pymor", reason=WHY)
    assert reduction.model(method, modes).stable


def test_emphasis_on_an_input_reduces_its_error(reduction):
    pytest.importorskip("pymor", reason=WHY)
    system = reduction.system
    names = list(system.inputs)
    emphasis = [1.0 if name == "force x on x+" else 1e-3 for name in names]
    alike, along = Reductions(system, CONDENSED), Reductions(system, CONDENSED, emphasis=emphasis)
    grid = np.geomspace(10.0, 2000.0, 100)
    exact = system.frequency_response(grid)[:, :, names.index("force x on x+")]
    missed = [np.abs(own.model("hankel", 4).frequency_response(grid)[:, :, 0] - exact).max() for own in (alike, along)]
    assert missed[1] < 0.3 * missed[0]


def test_requests_that_cannot_be_met_are_refused(reduction):
    pytest.importorskip("pymor", reason=WHY)
    with pytest.raises(pt.InputError, match="Hankel singular values"):
        reduction.model("hankel", CONDENSED)
    with pytest.raises(pt.InputError, match="increase condense"):
        reduction.model("balanced", 50)
    with pytest.raises(pt.InputError, match="give training="):
        Reductions(reduction.system, CONDENSED).model("pod", 4)


def test_the_sizes_of_inputs_are_those_of_the_run(tool_system, reduction, pull):
    found = input_sizes(reduction.system, [pull], 0.02)
    np.testing.assert_allclose(found, 1e-4 * np.array([0.6, 0.15, 0.05]), rtol=1e-3)
    swung = pt.PrescribedMotion("tip", lambda points, time: (1e-5 * np.sin(200 * time), 0.0, 0.0))
    bends = input_sizes(tool_system, [swung], 0.05)
    np.testing.assert_allclose(bends[0], 1e-5 * 200**2, rtol=1e-3)
    assert np.abs(bends[1:]).max() < 1e-6 * bends[0]


def test_a_small_run_of_the_full_body_is_the_linear_one(reduction, pull):
    run = pt.rollout(reduction.system.model, [pull], duration=0.01, every=0.0005, progress=False)
    times, free, whole = linear_run(reduction.system, [pull], duration=0.01, every=0.0005)
    np.testing.assert_allclose(times, run.times, atol=1e-12)
    np.testing.assert_allclose(whole, run.displacements, atol=5e-3 * np.abs(run.displacements).max())
    np.testing.assert_array_equal(free, whole)  # no tool
