"""The bridge to pyMOR: models there and back, and what theory promises of its reductions."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import palpate as pt

pytestmark = pytest.mark.slow

WHY = "pyMOR is not installed: pip install 'palpate[linear]'"
CONDENSED = 40


@pytest.fixture(scope="module", autouse=True)
def _pymor():
    pytest.importorskip("pymor", reason=WHY)


@pytest.fixture(scope="module")
def condensed(system):
    return pt.lti.reduce_linear(system, "condensed", CONDENSED)


@pytest.fixture(scope="module")
def strong_condensed(strong_system):
    return pt.lti.reduce_linear(strong_system, "condensed", CONDENSED)


@pytest.fixture(scope="module")
def tool_condensed(tool_system):
    return pt.lti.reduce_linear(tool_system, "condensed", CONDENSED)


def balanced(model, order, scales=None):
    """Return a balanced truncation of a model, and its reductor."""
    from pymor.reductors.bt import BTReductor

    reductor = BTReductor(pt.lti.to_pymor(model, scales=scales).to_lti())
    return pt.lti.from_pymor(reductor.reduce(order), model, reductor, scales=scales), reductor


def frequencies(model, count=150):
    """Frequencies over all of the spectrum, and every resonance."""
    poles = np.abs(model.poles)
    return np.unique(np.concatenate([[0.0], poles, np.geomspace(0.1 * poles.min(), 3 * poles.max(), count)]))


def sizes(response, scales):
    """Return the largest singular values (t,) of a scaled response (t, q, p)."""
    return np.linalg.norm(scales[0][:, None] * response * scales[1], 2, axis=(1, 2))


@pytest.mark.parametrize("form", ["system", "strong_system", "condensed", "tool_condensed"])
def test_pymor_has_the_same_transfer_function(form, request):
    source = request.getfixturevalue(form)
    fom = pt.lti.to_pymor(source)
    for frequency in (0.0, 40.0, 300.0, 2000.0):
        expected = source.frequency_response(frequency)[0]
        found = fom.transfer_function.eval_tf(1j * frequency)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_models_of_first_order_are_converted_too(condensed):
    model = balanced(condensed, 12)[0]
    fom = pt.lti.to_pymor(model)
    for frequency in (0.0, 300.0, 2000.0):
        expected = model.frequency_response(frequency)[0]
        found = fom.transfer_function.eval_tf(1j * frequency)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    again = reduced_again(fom, model)
    assert (again.count, again.columns.shape[1:]) == (6, (len(model.cloud), 3))
    assert again.stable


def reduced_again(fom, model):
    from pymor.reductors.bt import BTReductor

    reductor = BTReductor(fom)
    return pt.lti.from_pymor(reductor.reduce(6), model, reductor)


@pytest.mark.parametrize("form", ["condensed", "strong_condensed", "tool_condensed"])
def test_errors_stay_below_twice_the_sum_of_the_discarded_hankel_singular_values(form, request):
    model = request.getfixturevalue(form)
    scales, grid, errors = model.system.scales(), frequencies(model), []
    exact = model.frequency_response(grid)
    for order in (12, 16, 24, 30):
        reduced, reductor = balanced(model, order, scales)
        values = reductor.fom.hsv()
        assert reduced.report["bound"] == pytest.approx(2 * values[order:].sum(), rel=1e-9)
        assert reduced.report["method"] == "BTReductor"
        errors.append(sizes(exact - reduced.frequency_response(grid), scales).max())
        assert errors[-1] <= reduced.report["bound"] * (1 + 1e-6)
        # no system of as many states is nearer than the first value that it discards
        assert errors[-1] >= values[order] * (1 - 1e-6)
        assert reduced.stable
    assert errors[-1] < 0.5 * errors[0]


@pytest.mark.parametrize("form", ["condensed", "strong_condensed"])
@pytest.mark.parametrize("order", [2, 6, 12, 18])
def test_a_balanced_model_is_stable_and_has_the_transfer_function_of_pymor(form, order, request):
    from pymor.reductors.bt import BTReductor

    model = request.getfixturevalue(form)
    reductor = BTReductor(pt.lti.to_pymor(model).to_lti())
    rom = reductor.reduce(order)
    reduced = pt.lti.from_pymor(rom, model, reductor)
    assert reduced.stable
    assert (reduced.count, reduced.report["states"], reduced.report["unknowns"]) == (order, order, 288)
    for s in (0.0, 40.0j, 300.0j, 2000.0j):
        expected = rom.transfer_function.eval_tf(s)
        np.testing.assert_allclose(reduced.reduced.transfer(s)[0], expected, atol=1e-9 * np.abs(expected).max())


REDUCTORS = {
    "sobt": "SOBTReductor", "sobt-p": "SOBTpReductor", "sobt-v": "SOBTvReductor", "sobt-pv": "SOBTpvReductor",
    "sobt-fv": "SOBTfvReductor",
}  # fmt: skip


@pytest.mark.parametrize("form", ["condensed", "strong_condensed"])
@pytest.mark.parametrize("name", ["BTReductor", *REDUCTORS.values()])
def test_errors_decrease_with_more_modes(name, form, request, soft_pull):
    """The fields are those of the reductor's basis: a run has the displacements of the full, nonlinear body."""
    from pymor.reductors import bt, sobt

    model = request.getfixturevalue(form)
    scales = model.system.scales()
    fom = pt.lti.to_pymor(model, scales=scales)
    reductor = bt.BTReductor(fom.to_lti()) if name == "BTReductor" else getattr(sobt, name)(fom)
    full = pt.rollout(model.full, [soft_pull], duration=0.02, every=0.0005, progress=False)
    errors = []
    for modes in (3, 9):
        rom = reductor.reduce(2 * modes if name == "BTReductor" else modes)
        reduced = pt.lti.from_pymor(rom, model, reductor, scales=scales)
        run = pt.rollout(reduced, [soft_pull], duration=0.02, every=0.0005, progress=False)
        errors.append(pt.relative_errors(full, run).displacement)
    assert errors[1] < errors[0]
    assert errors[1] < 0.3


def test_a_projection_of_pymor_is_that_of_palpate(system):
    """On columns of moments, from the sparse system: equal matrices and fields."""
    from pymor.reductors.basic import SOLTIPGReductor

    expected = pt.lti.reduce_linear(system, "moments", 6)
    columns = (expected.reduced.fields.reshape(6, -1) @ system.directions).T
    fom = pt.lti.to_pymor(system)
    vectors = fom.solution_space.from_numpy(np.ascontiguousarray(columns))
    reductor = SOLTIPGReductor(fom, vectors, vectors)
    found = pt.lti.from_pymor(reductor.reduce(), system, reductor)
    np.testing.assert_allclose(found.columns, expected.columns, atol=1e-12 * np.abs(expected.columns).max())
    for matrix in ("mass", "damping", "stiffness", "input", "output", "rate_output", "feedthrough"):
        own = getattr(expected.reduced, matrix)
        np.testing.assert_allclose(getattr(found.reduced, matrix), own, atol=1e-9 * max(np.abs(own).max(), 1e-30))


def test_irka_meets_the_slowest_resonance(condensed):
    """It interpolates at the mirror images of its poles."""
    from pymor.reductors.bt import BTReductor
    from pymor.reductors.sor_irka import SORIRKAReductor

    scales = condensed.system.scales()
    fom = pt.lti.to_pymor(condensed, scales=scales)
    reductor = SORIRKAReductor(fom)
    options = {"tol": 1e-3, "maxit": 20, "irka_options": {"tol": 1e-3, "maxit": 20}}
    rom = reductor.reduce(BTReductor(fom.to_lti()).reduce(6), **options)
    model = pt.lti.from_pymor(rom, condensed, reductor, scales=scales)
    slowest = np.abs(condensed.poles).min()
    exact, found = (each.frequency_response(slowest) for each in (condensed, model))
    assert sizes(exact - found, scales)[0] < 0.02 * sizes(exact, scales)[0]


def test_without_a_reductor_fields_are_the_nearest(condensed, soft_pull):
    model, reductor = balanced(condensed, 18)
    nearest = pt.lti.from_pymor(reductor.reduce(18), condensed)
    assert (nearest.report["method"], nearest.report.get("bound")) == ("pyMOR", None)
    np.testing.assert_array_equal(nearest.A, model.A)
    full = pt.rollout(condensed, [soft_pull], duration=0.02, every=0.0005, progress=False)
    runs = [pt.rollout(each, [soft_pull], duration=0.02, every=0.0005, progress=False) for each in (model, nearest)]
    errors = [pt.relative_errors(full, run).displacement for run in runs]
    assert max(errors) < 0.3
    assert errors[1] < 1.5 * errors[0]


def test_a_model_goes_to_pymor_and_back(condensed):
    """Matrices are equal, and the nearest fields of coordinates that the inputs move are the model's own."""
    small = pt.lti.reduce_linear(condensed.system, "moments", 3)
    back = pt.lti.from_pymor(pt.lti.to_pymor(small), small)
    assert type(back.reduced) is type(small.reduced)
    for matrix in ("A", "B", "C", "D"):
        np.testing.assert_array_equal(getattr(back, matrix), getattr(small, matrix))
    np.testing.assert_allclose(back.columns, small.columns, atol=1e-6 * np.abs(small.columns).max())
    assert (back.system.inputs, back.system.outputs) == (small.system.inputs, small.system.outputs)
    scales = condensed.system.scales()
    scaled = pt.lti.from_pymor(pt.lti.to_pymor(small, scales=scales), small, scales=scales)
    for matrix in ("A", "B", "C", "D"):
        own = getattr(small, matrix)
        np.testing.assert_allclose(getattr(scaled, matrix), own, rtol=1e-14, atol=1e-14 * np.abs(own).max())


def test_the_model_exported_to_pymor_interpolates_tangentially(system):
    """Second-order Hermite interpolation, the step of its rational Krylov method.

    pyMOR divides directions by their norms over the points, one for every input and output, which turns them.
    """
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


@pytest.mark.parametrize("method", ["modal", "balanced", "sobt-p"])
def test_pymor_s_time_stepping_gives_the_same_result(method, condensed):
    from pymor.algorithms.timestepping import ImplicitMidpointTimeStepper
    from pymor.models.iosys import LTIModel
    from pymor.reductors.sobt import SOBTpReductor

    if method == "modal":
        model = pt.lti.reduce_linear(condensed.system, "modal", 6)
    elif method == "balanced":
        model = balanced(condensed, 12, condensed.system.scales())[0]
    else:
        reductor = SOBTpReductor(pt.lti.to_pymor(condensed))
        model = pt.lti.from_pymor(reductor.reduce(6), condensed, reductor)
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


def test_without_condensing_the_whole_body_is_balanced(system):
    from pymor.bindings.scipy import ScipyLyapunovSolverLR
    from pymor.reductors.bt import BTReductor

    reductor = BTReductor(pt.lti.to_pymor(system, ScipyLyapunovSolverLR()).to_lti())
    model = pt.lti.from_pymor(reductor.reduce(12), system, reductor)
    grid = np.array([0.0, 300.0, 2000.0])
    errors = np.linalg.norm(system.frequency_response(grid) - model.frequency_response(grid), 2, axis=(1, 2))
    assert errors.max() <= model.report["bound"]
    assert model.stable


def test_a_balanced_model_with_a_tool_runs_in_the_engine_s_period(tool_condensed):
    scales = tool_condensed.system.scales()
    model = balanced(tool_condensed, 24, scales)[0]
    assert model.lifting_count == 6
    tool = pt.PrescribedMotion("tip", lambda points, time: np.array([1e-6, 0.0, 6e-7]) * np.sin(250 * time) ** 2)
    runs = [pt.rollout(each, [tool], duration=0.02, every=0.0005, progress=False) for each in (tool_condensed, model)]
    assert pt.relative_errors(*runs).displacement < 0.1
    ready, period = pt.realtime_model(model, period=1e-3), 1e-3
    q, v, report = ready.rest.copy(), ready.rest.copy(), np.zeros(8 + 6)
    pose = np.concatenate([[1e-6, 0.0, 0.0], np.zeros(9)])
    for _ in range(2000):
        ready.advance(ready.data, q, v, ready.tool @ pose, period, report)
    # at rest the tool feels the static stiffness
    static = tool_condensed.system.static[-6:, 0] * 1e-6
    np.testing.assert_allclose(report[8:14], static, atol=0.02 * np.abs(static).max())


@pytest.mark.parametrize("reductor_kind", ["balanced", "nearest"])
def test_a_loaded_model_equals_the_saved_one(reductor_kind, condensed, soft_pull, tmp_path):
    model, reductor = balanced(condensed, 10)
    if reductor_kind == "nearest":
        model = pt.lti.from_pymor(reductor.reduce(10), condensed)
    pt.save(model, tmp_path / "bar.lti")
    loaded = pt.load(tmp_path / "bar.lti", condensed.system)
    first, second = (pt.rollout(each, [soft_pull], duration=0.005, every=0.0005) for each in (model, loaded))
    np.testing.assert_array_equal(first.displacements, second.displacements)
    assert loaded.report == model.report


def test_models_that_are_not_of_the_system_are_refused(condensed, tool_condensed):
    from pymor.models.iosys import LTIModel
    from pymor.reductors.bt import BTReductor
    from pymor.reductors.sobt import SOBTpReductor

    def lti(a=-1.0, inputs=3, outputs=6, **options):
        return LTIModel.from_matrices(a * np.eye(2), np.ones((2, inputs)), np.ones((outputs, 2)), **options)

    def refused(message, rom, source=condensed, reductor=None, **options):
        with pytest.raises(pt.InputError, match=message):
            pt.lti.from_pymor(rom, source, reductor, **options)

    refused("rom must be an LTIModel or a SecondOrderModel of pyMOR, got a LinearModel", condensed)
    refused("rom must have the 3 inputs and 6 outputs of the system, got 2 and 6; reduce", lti(inputs=2))
    refused("rom must have the 3 inputs and 6 outputs of the system, got 3 and 5; reduce", lti(outputs=5))
    refused("rom must be in continuous time", lti(sampling_time=1e-3))
    refused("matrices of rom must be real and finite", lti(np.nan))
    refused("matrices of rom must be real and finite", lti(-1.0 + 1.0j))
    refused("must not be singular", lti(E=np.diag([1.0, 0.0])))
    refused("rom and source must be stable without a reductor", lti(1.0))
    refused("reductor must be given for a rom of a LinearSystem", lti(), condensed.system)

    reductor = BTReductor(pt.lti.to_pymor(condensed).to_lti())
    rom = reductor.reduce(8)
    refused(r"reductor must have a basis of shape \(288, 8\), got \(43, 8\)", rom, condensed.system, reductor)
    reductor.reduce(6)
    refused(r"reductor must have a basis .*give", rom, condensed, reductor)
    other = SOBTpReductor(pt.lti.to_pymor(tool_condensed))
    refused("rom must have the 3 inputs and 6 outputs", other.reduce(4), condensed, other)
    refused("reductor must have a basis of the 8 coordinates of rom, got a object", rom, condensed, object())
    refused("scales must be 6 positive factors of outputs and 3 of inputs", rom, scales=(np.ones(3), np.ones(3)))
    with pytest.raises(pt.InputError, match="scales must be 6 positive factors"):
        pt.lti.to_pymor(condensed, scales=(-np.ones(6), np.ones(3)))


def test_unstable_models_are_refused_unless_they_are_allowed(condensed):
    from pymor.models.iosys import LTIModel
    from pymor.reductors.bt import BTReductor

    reductor = BTReductor(pt.lti.to_pymor(condensed).to_lti())
    a, b, c, d, e = reductor.reduce(6).to_matrices()
    rom = LTIModel.from_matrices(-a, b, c, d, e)
    with pytest.raises(pt.InputError, match=r"rom must be stable, got a pole with a real part of .* allow_unstable"):
        pt.lti.from_pymor(rom, condensed, reductor)
    model = pt.lti.from_pymor(rom, condensed, reductor, allow_unstable=True)
    assert not model.stable
    assert "not stable" in str(model)


def test_without_pymor_the_message_says_how_to_install_it(system, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymor", None)
    monkeypatch.setitem(sys.modules, "pymor.core.logger", None)
    for convert in (lambda: pt.lti.to_pymor(system), lambda: pt.lti.from_pymor(None, system)):
        with pytest.raises(pt.InputError, match=r"pip install 'palpate\[linear\]'"):
            convert()
    assert pt.lti.reduce_linear(system, "condensed", 4).stable  # needs none
