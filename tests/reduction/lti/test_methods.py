"""Linear reductions: what theory promises of each."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import palpate as pt
from palpate.reduction.lti.budget import Budget, dense_lyapunov
from palpate.reduction.lti.hankel import Realisation, hankel_norm, lyapunov_factor
from palpate.reduction.lti.projection_methods import condense, eigenvectors
from palpate.reduction.lti.reductors import PYMOR_METHODS, TITLE_BY_METHOD, Reduction

pytestmark = pytest.mark.slow

WHY = "pyMOR is not installed: pip install 'palpate[linear]'"
CONDENSED = 40


def need(method):
    if method in PYMOR_METHODS:
        pytest.importorskip("pymor", reason=WHY)


@pytest.fixture(scope="module")
def training(soft_pull):
    return ([soft_pull], 0.02, 0.0005)


@pytest.fixture(scope="module")
def reduction(system, training):
    return Reduction(system, condense=CONDENSED, training=training)


@pytest.fixture(scope="module")
def strong_reduction(strong_system, training):
    return Reduction(strong_system, condense=CONDENSED, training=training)


def frequencies(reduction, count=150):
    """Frequencies over all of the spectrum, and every resonance."""
    poles = np.abs(reduction.source.poles())
    return np.unique(np.concatenate([[0.0], poles, np.geomspace(0.1 * poles.min(), 3 * poles.max(), count)]))


@pytest.mark.parametrize("form", ["reduction", "strong_reduction"])
@pytest.mark.parametrize("method", ["balanced", "hankel"])
def test_errors_stay_below_twice_the_sum_of_the_discarded_hankel_singular_values(method, form, request):
    need(method)
    own = request.getfixturevalue(form)
    grid, errors = frequencies(own), []
    for modes in (2, 4, 8, 12):
        reduced = own.model(method, modes).reduced
        errors.append(own.scaled_error(reduced, grid).max())
        assert errors[-1] <= own.bound(reduced.states) * (1 + 1e-6)
        # no system of as many states is nearer than the first value that it discards
        assert errors[-1] >= own.hankel_singular_values[reduced.states] * (1 - 1e-6)
    assert errors[-1] < 0.2 * errors[0]


def test_the_hankel_norm_of_the_error_is_the_first_discarded_value(reduction):
    own, values, _ = reduction.realisation
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
    own, values, into = reduction.realisation
    leading = slice(0, 20)
    for a, b in ((own.A, own.B), (own.A.T, own.C.T)):
        gramian = scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T)
        np.testing.assert_allclose(gramian[leading, leading], np.diag(values[leading]), atol=1e-6 * values[0])
    assert into.shape == (reduction.source.states, len(values))


def test_pymor_finds_the_same_hankel_singular_values(reduction):
    pytest.importorskip("pymor", reason=WHY)
    found = reduction.pymor.to_lti().hsv()
    np.testing.assert_allclose(found[:20], reduction.hankel_singular_values[:20], rtol=1e-5)


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


def test_the_model_exported_to_pymor_interpolates_tangentially(system):
    """Second-order Hermite interpolation, the step of its rational Krylov method.

    pyMOR divides directions by their norms over the points, one for every input and output, which turns them.
    """
    pytest.importorskip("pymor", reason=WHY)
    from pymor.reductors.interpolation import SOBHIReductor

    fom = pt.lti.to_pymor(system)
    sigma, rng = np.array([150.0, 800.0]), np.random.default_rng(0)
    b, c = rng.standard_normal((2, 3)), rng.standard_normal((2, 6))
    rom = SOBHIReductor(fom).reduce(sigma, b, c)
    turned = b / np.linalg.norm(b, axis=0), c / np.linalg.norm(c, axis=0)
    for s, right, left in zip(sigma, *turned, strict=True):
        exact, found = system.transfer(s)[0], rom.transfer_function.eval_tf(s)
        np.testing.assert_allclose(found @ right, exact @ right, atol=1e-6 * np.abs(exact).max())
        np.testing.assert_allclose(left @ found, left @ exact, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("form", ["system", "strong_system"])
def test_pymor_has_the_same_transfer_function(form, request):
    pytest.importorskip("pymor", reason=WHY)
    system = request.getfixturevalue(form)
    fom = pt.lti.to_pymor(system)
    for s in (0.0, 300.0j, 50.0 + 900.0j):
        expected = system.transfer(s)[0]
        np.testing.assert_allclose(fom.transfer_function.eval_tf(s), expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("method", ["modal", "balanced", "hankel", "sobt-p"])
def test_pymor_s_time_stepping_gives_the_same_result(method, reduction):
    pytest.importorskip("pymor", reason=WHY)
    from pymor.algorithms.timestepping import ImplicitMidpointTimeStepper
    from pymor.models.iosys import LTIModel

    model = reduction.model(method, 6)
    pull = pt.SurfaceForce("x+", force=lambda t: (1e-4 * t * (0.02 - t), 0.0, 5e-5 * t * (0.02 - t)))
    prepared, end, missed = model.prepare([pull]), 0.02, []
    state = model.advance(model.state(prepared), prepared, end / 800, 800)[0]
    expected = model.responses(state, prepared)
    for steps in (800, 1600):
        lti = LTIModel.from_matrices(
            model.A, model.B, model.C, model.D, T=end, time_stepper=ImplicitMidpointTimeStepper(steps)
        )
        outputs = np.asarray(lti.output(input="[1e-4 * t[0] * (0.02 - t[0]), 0, 5e-5 * t[0] * (0.02 - t[0])]"))
        last = outputs[:, -1] if outputs.shape[0] == len(expected) else outputs[-1]
        missed.append(np.abs(last - expected).max() / np.abs(expected).max())
    assert missed[1] < 2e-3
    assert missed[0] / missed[1] > 3 or missed[1] < 1e-8  # it comes nearer with the square of its step


@pytest.mark.parametrize("method", ["modal", "moments", "pod", "sobt-fv", "balanced", "hankel"])
@pytest.mark.parametrize("modes", [1, 3, 6, 9])
def test_methods_that_preserve_stability_give_stable_models_of_the_energy_form(method, modes, reduction):
    need(method)
    assert reduction.model(method, modes).stable


@pytest.mark.parametrize("method", ["modal", "balanced", "hankel"])
@pytest.mark.parametrize("modes", [1, 3, 6])
def test_methods_that_preserve_stability_give_stable_models_of_the_strong_form(method, modes, strong_reduction):
    need(method)
    assert strong_reduction.model(method, modes).stable


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


@pytest.mark.parametrize("form", ["reduction", "strong_reduction"])
def test_errors_of_every_method_decrease_with_more_modes(form, request, soft_pull):
    own = request.getfixturevalue(form)
    full = pt.rollout(own.system.model, [soft_pull], duration=0.02, every=0.0005, progress=False)
    for method in TITLE_BY_METHOD:
        if method in ("sobt-vp", "irka"):  # these promise nothing of the kind
            continue
        need(method)
        runs = [
            pt.rollout(own.model(method, modes), [soft_pull], duration=0.02, every=0.0005, progress=False)
            for modes in (3, 9)
        ]
        few, many = (pt.relative_errors(full, run).displacement for run in runs)
        assert many < few, method
        assert many < 0.3, method


@pytest.mark.parametrize("modes", [6, 8])  # with 4 it does not converge
def test_irka_meets_the_slowest_resonance(modes, reduction):
    """It interpolates at the mirror images of its poles."""
    need("irka")
    slowest = np.abs(reduction.source.poles()).min()
    outputs, inputs = reduction.scales
    response = outputs[:, None] * reduction.source.transfer(1j * slowest)[0] * inputs
    missed = reduction.scaled_error(reduction.model("irka", modes).reduced, [slowest])[0]
    assert missed < 0.02 * np.linalg.norm(response, 2)


def test_condensation_preserves_poles_and_the_static_response(system):
    reduced, (wide, test) = condense(system, 30)
    np.testing.assert_allclose(
        reduced.transfer(0.0), system.transfer(0.0), atol=1e-9 * np.abs(system.transfer(0.0)).max()
    )
    assert wide.shape == test.shape == (system.order, 33)
    slow = 1j * np.array([50.0, 200.0])
    np.testing.assert_allclose(
        reduced.transfer(slow), system.transfer(slow), atol=1e-2 * np.abs(system.transfer(slow)).max()
    )


def test_without_condensing_the_whole_body_is_balanced(system, training):
    pytest.importorskip("pymor", reason=WHY)
    own = Reduction(system, condense=0, training=training)
    model = own.model("balanced", 6)
    assert len(own.source.mass) == system.order
    assert own.scaled_error(model.reduced, [0.0, 300.0, 2000.0], whole=True).max() <= own.bound(12)


def test_too_expensive_reductions_are_refused_with_an_estimate(system):
    small = Reduction(system, condense=0, budget=Budget(memory=1e6))
    with pytest.raises(
        pt.InputError, match=r"must cover about .* MB and \d+ s for dense .* of order 576.*condense=240"
    ):
        small.model("hankel", 2)
    assert dense_lyapunov(2000).seconds == pytest.approx(8 * dense_lyapunov(1000).seconds)
    assert dense_lyapunov(2000).memory == pytest.approx(4 * dense_lyapunov(1000).memory)
    Reduction(system, condense=30, budget=Budget(memory=1e6)).model("hankel", 2)  # a small body's is cheap


def test_reduced_systems_with_a_tool_are_stable(tool_system):
    own = Reduction(tool_system, condense=30)
    for method in ("modal", "moments", "hankel"):
        model = own.model(method, 6)
        assert model.lifting_count == 6
        assert model.stable
        assert len(model.C) == 9


@pytest.mark.parametrize(
    ("method", "modes", "options", "message"),
    [
        ("fourier", 4, {}, "method must be one of 'modal'"),
        ("modal", 0, {}, r"modes must be an integer in \[1, 287\], got 0"),
        ("modal", 4, {"points": (0.0,)}, "must be empty for method 'modal', got points"),
        ("moments", 4, {"points": (-1.0,)}, "real parts of at least 0"),
        ("moments", 4, {"points": ()}, "real parts of at least 0"),
        ("pod", 4, {}, "give training="),
        ("hankel", 30, {"condense": 20}, "Hankel singular values"),
    ],
)
def test_bad_requests_are_refused(system, method, modes, options, message):
    with pytest.raises(pt.InputError, match=message):
        pt.lti.reduce_linear(system, method, modes, **options)


def test_without_pymor_the_message_says_how_to_install_it(system, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pymor", None)
    monkeypatch.setitem(sys.modules, "pymor.core.logger", None)
    for method in PYMOR_METHODS:
        with pytest.raises(pt.InputError, match=r"pip install 'palpate\[linear\]'"):
            pt.lti.reduce_linear(system, method, 4)
    with pytest.raises(pt.InputError, match=r"pip install 'palpate\[linear\]'"):
        pt.lti.to_pymor(system)
    assert pt.lti.reduce_linear(system, "modal", 4).stable  # needs none


def test_emphasis_on_an_input_reduces_its_error(system, soft_pull):
    names = list(system.inputs)
    emphasis = [1.0 if name == "force x on x+" else 1e-3 for name in names]
    alike, along = Reduction(system, condense=CONDENSED), Reduction(system, condense=CONDENSED, emphasis=emphasis)
    grid = np.geomspace(10.0, 2000.0, 100)
    exact = system.frequency_response(grid)[:, :, names.index("force x on x+")]
    missed = [np.abs(own.model("hankel", 4).frequency_response(grid)[:, :, 0] - exact).max() for own in (alike, along)]
    assert missed[1] < 0.3 * missed[0]
    with pytest.raises(pt.InputError, match="one per input"):
        Reduction(system, emphasis=[1.0])


def test_the_sizes_of_inputs_are_those_of_the_run(tool_system, system, soft_pull):
    from palpate.reduction.lti.simulate import input_sizes

    found = input_sizes(system, [soft_pull], 0.02)
    np.testing.assert_allclose(found, 1e-4 * np.array([0.6, 0.15, 0.05]), rtol=1e-3)
    swung = pt.PrescribedMotion("tip", lambda points, time: (1e-5 * np.sin(200 * time), 0.0, 0.0))
    bends = input_sizes(tool_system, [swung], 0.05)
    np.testing.assert_allclose(bends[0], 1e-5 * 200**2, rtol=1e-3)
    assert np.abs(bends[1:]).max() < 1e-6 * bends[0]
