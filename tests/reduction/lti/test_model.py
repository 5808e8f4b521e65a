"""Linear models against the full body, against themselves with every mode, and in the engine's loop."""

from __future__ import annotations

from contextlib import nullcontext
from time import perf_counter, sleep

import numpy as np
import pytest

import palpate as pt
from palpate.core.sealed import write_sealed
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.projection_methods import project
from palpate.reduction.lti.state_space import FirstOrder, first_order_hold
from palpate.reduction.lti.stiffness import linear_stress
from palpate.reduction.lti.storage import FORMAT, VERSION
from palpate.reduction.storage.model_file import FORMAT as REDUCED

pytestmark = pytest.mark.slow

HOLD = {"duration": 0.02, "every": 0.0005, "progress": False}


def swing(points, time):
    return np.array([1e-6, -4e-7, 6e-7]) * np.sin(250 * time) ** 2


@pytest.fixture(scope="module")
def whole(system):
    """The linear model that has every motion of the body."""
    return LinearModel(system, project(system, np.diag(1 / np.sqrt(system.mass.diagonal()))))


def test_steps_are_exact_for_inputs_linear_in_time():
    a, b = np.array([[0.0, 1.0], [-9.0, -0.3]]), np.array([[0.0], [1.0]])
    long, short = first_order_hold(a, b, 0.5), first_order_hold(a, b, 0.5 / 64)
    x = np.array([0.3, -1.0])
    fine = x.copy()
    for s in range(64):
        f = 2.0 + np.array([s, s + 1]) / 64
        fine = short[0] @ fine + short[1] @ f[:1] + short[2] @ f[1:]
    np.testing.assert_allclose(long[0] @ x + long[1] @ [2.0] + long[2] @ [3.0], fine, rtol=1e-12)


def test_with_all_modes_the_linear_model_equals_the_full_model_under_small_loads(whole, energetic, soft_pull):
    full, own = (pt.rollout(model, [soft_pull], **HOLD) for model in (energetic, whole))
    errors = pt.relative_errors(full, own)
    assert max(errors.displacement, errors.velocity, errors.energy, errors.reaction) < 5e-3
    assert np.abs(own.balance).max() < 1e-3 * own.external.max()
    assert own.model == "linear"


def test_with_all_modes_the_linear_model_equals_the_strong_form_under_small_loads(strong_system, strong, soft_pull):
    whole = LinearModel(strong_system, project(strong_system, np.diag(1 / np.sqrt(strong_system.mass.diagonal()))))
    full, own = (pt.rollout(model, [soft_pull], **HOLD) for model in (strong, whole))
    errors = pt.relative_errors(full, own)
    assert max(errors.displacement, errors.velocity, errors.reaction) < 1e-2


def test_a_tool_moves_the_linear_model_as_the_full_model(tool_system, energetic):
    tool = pt.PrescribedMotion("tip", swing)
    model = LinearModel(tool_system, project(tool_system, np.diag(1 / np.sqrt(tool_system.mass.diagonal()))))
    full, own = (pt.rollout(body, [tool], **HOLD) for body in (energetic, model))
    errors = pt.relative_errors(full, own)
    assert max(errors.displacement, errors.velocity, errors.reaction) < 1e-2
    assert np.abs(own.balance).max() < 2e-3 * own.external.max()
    # the outputs of the system are the tool's force
    prepared = model.prepare([tool])
    state = model.advance(model.state(prepared), prepared, 1e-4, 100)[0]
    np.testing.assert_allclose(
        model.responses(state, prepared)[3:6], model.outputs(state, prepared).reactions["tip"], rtol=1e-3, atol=1e-9
    )


def test_one_long_step_equals_many_short_ones(system):
    model = pt.lti.reduce_linear(system, "modal", 5)
    ramp = pt.SurfaceForce("x+", force=lambda t: (1e-4 * t, 0.0, 2e-5))
    prepared = model.prepare([ramp])
    one, many = (model.advance(model.state(prepared), prepared, 0.01 / n, n)[0] for n in (1, 50))
    np.testing.assert_allclose(one.coordinates, many.coordinates, rtol=1e-9)
    np.testing.assert_allclose(one.velocities, many.velocities, rtol=1e-9)


def test_initial_states_are_projected(whole, energetic):
    prepared = whole.prepare([])
    u, v = 1e-6 * np.random.default_rng(0).standard_normal((2, len(energetic.cloud), 3))
    u[energetic.fixed_mask] = v[energetic.fixed_mask] = 0.0
    state = whole.state(prepared, u, v)
    np.testing.assert_allclose(whole.displacement(state, prepared), u, atol=1e-15)
    np.testing.assert_allclose(whole.velocity(state, prepared, np.array([5, 7])), v[[5, 7]], atol=1e-15)


@pytest.mark.parametrize("order", ["second", "first"])
def test_a_tool_with_initial_velocity_is_followed(order, tool_system, energetic):
    tool = pt.PrescribedMotion("tip", lambda points, time: (1e-5 * time, 0.0, 0.0))
    model = pt.lti.reduce_linear(tool_system, "modal", 20)
    if order == "first":
        model = as_first_order(model)
    full, own = (pt.rollout(body, [tool], **HOLD) for body in (energetic, model))
    errors = pt.relative_errors(full, own)
    assert errors.energy < 0.02
    assert errors.displacement < 0.1
    with pytest.raises(pt.InputError, match="starts at rest") if order == "first" else nullcontext():
        model.state(model.prepare([tool]), 1e-6 * np.ones((len(energetic.cloud), 3)))


def as_first_order(model):
    """Return a model of second order as one of first order, whose rates of coordinates have no displacements."""
    fields = np.concatenate([model.reduced.fields, np.zeros_like(model.reduced.fields)])
    return LinearModel(model.system, FirstOrder(model.A, model.B, model.C, model.D, fields), model.report)


def test_a_model_of_first_order_moves_as_its_model_of_second_order(system, soft_pull):
    second = pt.lti.reduce_linear(system, "modal", 6)
    runs = [pt.rollout(each, [soft_pull], **HOLD) for each in (second, as_first_order(second))]
    for name in ("displacements", "velocities", "external"):
        expected, found = (getattr(run, name) for run in runs)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_forces_energy_and_stress_are_those_of_the_linear_body(whole, energetic):
    u = 1e-4 * energetic.cloud.spacing * np.sin(200 * energetic.cloud.points)
    force, energy = energetic.force(u), energetic.strain_energy(u)
    pushed = -(whole.system.whole @ u.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(pushed / energetic.weights[:, None], force, atol=2e-3 * np.abs(force).max())
    assert -0.5 * np.sum(pushed * u) == pytest.approx(energy, rel=1e-3)
    stress = linear_stress(energetic, u)
    np.testing.assert_allclose(stress, energetic.stress(u), atol=2e-3 * np.abs(stress).max())
    np.testing.assert_allclose(linear_stress(energetic, 1e3 * u), 1e3 * stress, rtol=1e-6)  # linear, however far


@pytest.mark.quick
@pytest.mark.parametrize(
    ("loads", "message"),
    [
        ([pt.SurfaceForce("z+", force=(1.0, 0.0, 0.0))], "loads must be those of the linear system"),
        ([pt.Gravity()], "linearise with Gravity"),
        ([pt.PrescribedMotion("tip", (0.0, 0.0, 0.0))], r"must prescribe .* got \['tip'\]"),
        ([pt.tools.Contact(pt.tools.Sphere(0.01), (0.0, 0.0, 0.1))], "linear model must be one of .* got Contact"),
    ],
)
def test_loads_that_are_not_inputs_of_the_system_are_refused(whole, loads, message):
    with pytest.raises(pt.InputError, match=message):
        whole.prepare(loads)


def test_large_rotations_of_a_tool_are_refused(tool_system):
    model = pt.lti.reduce_linear(tool_system, "modal", 4)

    def turn(points, time):
        arms = points - points.mean(axis=0)
        return np.stack([0 * arms[:, 0], -2 * arms[:, 1], -2 * arms[:, 2]], axis=1)

    with pytest.raises(pt.InputError, match="must be small and rigid"):
        model.state(model.prepare([pt.PrescribedMotion("tip", turn)]))


def test_periods_of_the_engine_equal_the_run(tool_system):
    model = pt.lti.reduce_linear(tool_system, "modal", 8)
    ready, period = pt.realtime_model(model, period=1e-3), 1e-3
    q, v, report = ready.rest.copy(), ready.rest.copy(), np.zeros(8 + model.lifting_count)

    def ramped(points, time):  # evenly within every period
        steps = time / period
        low = np.floor(steps + 1e-9)
        ends = [swing(points, period * max(s - 2, 0)) for s in (low, low + 1)]  # at rest to begin with
        return ends[0] + (steps - low) * (ends[1] - ends[0])

    tool = pt.PrescribedMotion("tip", ramped)
    run = pt.rollout(model, [tool], duration=0.02, every=period, progress=False)
    forces = []
    for k in range(1, 21):
        ready.advance(
            ready.data, q, v, ready.tool @ np.concatenate([ramped(0, k * period), np.zeros(9)]), period, report
        )
        forces.append(report[8:11].copy())
        found = np.tensordot(q, model.columns, 1)
        np.testing.assert_allclose(found, run.displacements[k], atol=1e-9 * np.abs(run.displacements).max())
    middle = 0.5 * (run.reactions["tip"][1:] + run.reactions["tip"][:-1])
    np.testing.assert_allclose(np.array(forces), middle, atol=0.2 * np.abs(middle).max())
    assert report[0] == 0
    assert 0 < report[1] < 1
    out = np.zeros((6, 6))
    ready.stiffness(ready.data, q, out)
    np.testing.assert_allclose(out, tool_system.static[-6:])
    # another period than the one made ready
    half = (q.copy(), v.copy())
    target = q[model.count :].copy()
    for _ in range(2):
        ready.advance(ready.data, *half, target, 0.5 * period, report)
    ready.advance(ready.data, q, v, target, period, report)
    np.testing.assert_allclose(half[0], q, atol=1e-10 * np.abs(q).max())


def test_the_engine_steps_a_linear_model(tool_system):
    model = pt.lti.reduce_linear(tool_system, "modal", 8)
    with pt.Engine(pt.realtime_model(model), 500.0) as engine:
        engine.set_pose((1e-6, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        until = perf_counter() + 300.0
        while engine.read().steps < 400 and perf_counter() < until:
            sleep(0.01)
        reading = engine.read()
    assert reading.steps >= 400
    # at rest the hand feels the static stiffness, against its motion
    np.testing.assert_allclose(reading.force, -tool_system.static[3:6, 0] * 1e-6, rtol=0.05, atol=1e-8)


def test_the_engine_requires_one_tool(system):
    with pytest.raises(pt.InputError, match="one tool"):
        pt.realtime_model(pt.lti.reduce_linear(system, "modal", 4))


def test_the_linear_range_ends_where_the_force_is_nonlinear_by_a_tenth(tool_system):
    from palpate.reduction.lti.realtime import linear_range

    found = linear_range(pt.lti.reduce_linear(tool_system, "modal", 4))
    assert np.all(found > 0)
    full, field = tool_system.model, tool_system.lifting[0]
    rigid = np.zeros_like(field)
    rigid[full.cloud.group("tip")] = field[full.cloud.group("tip")]
    straight = np.sum(rigid * (tool_system.whole @ field.ravel()).reshape(-1, 3))
    worst = [
        max(
            abs(-np.sum(rigid * full.force(sign * size * field) * full.volumes[:, None]) / (sign * size * straight) - 1)
            for sign in (-1, 1)
        )
        for size in (0.5 * found[0], 1.01 * found[0])
    ]
    assert worst[0] < 0.1 < worst[1] < 0.12


@pytest.mark.parametrize("method", ["modal", "condensed", "first order"])
def test_a_loaded_model_equals_the_saved_one(method, system, tool_system, soft_pull, tmp_path):
    model = pt.lti.reduce_linear(system, "condensed" if method == "condensed" else "modal", 5)
    if method == "first order":
        model = LinearModel(system, as_first_order(model).reduced, {"method": method})
    pt.save(model, tmp_path / "bar.lti")
    loaded = pt.load(tmp_path / "bar.lti", system)
    first, second = (pt.rollout(each, [soft_pull], duration=0.005, every=0.0005) for each in (model, loaded))
    np.testing.assert_array_equal(first.displacements, second.displacements)
    assert loaded.report["method"] == method
    assert [path.name for path in tmp_path.iterdir()] == ["bar.lti"]
    with pytest.raises(pt.InputError, match="another linear system"):
        pt.load(tmp_path / "bar.lti", tool_system)


def test_the_header_of_a_file_selects_the_kind_of_model(system, tmp_path):
    pt.save(pt.lti.reduce_linear(system, "modal", 3), tmp_path / "bar.lti")
    write_sealed(tmp_path / "bar.rom", REDUCED, 1, {}, {})
    with pytest.raises(pt.FileFormatError, match=r"system must be given for the linear model .*bar\.lti"):
        pt.load(tmp_path / "bar.lti")
    with pytest.raises(pt.FileFormatError, match=r"system must not be given for the reduced model .*bar\.rom"):
        pt.load(tmp_path / "bar.rom", system)
    with pytest.raises(pt.FileFormatError, match=r"bar\.rom: .*version 1"):  # by the reader of reduced models
        pt.load(tmp_path / "bar.rom")


@pytest.mark.quick
def test_files_that_are_not_a_linear_model_are_refused(system, tmp_path):
    with pytest.raises(FileNotFoundError):
        pt.load(tmp_path / "none.lti", system)
    (tmp_path / "text.lti").write_text("no model", encoding="utf-8")
    with pytest.raises(pt.FileFormatError):
        pt.load(tmp_path / "text.lti", system)
    model = pt.lti.reduce_linear(system, "modal", 3)
    pt.save(model, tmp_path / "cut.lti")
    content = (tmp_path / "cut.lti").read_bytes()
    (tmp_path / "cut.lti").write_bytes(content[: len(content) // 2])
    with pytest.raises(pt.FileFormatError):
        pt.load(tmp_path / "cut.lti", system)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda header, arrays: arrays.update(mass=1e-320 * arrays["mass"]), "not finite"),
        (lambda header, arrays: arrays.update(mass=0 * arrays["mass"]), "linear model again"),
        (lambda header, arrays: arrays["stiffness"].__setitem__((0, 0), np.nan), "stiffness must be finite"),
        (lambda header, arrays: arrays.update(input=arrays["input"][:, :1]), "array input must have shape"),
        (lambda header, arrays: arrays.pop("fields"), "array fields is missing"),
        (lambda header, arrays: header.update(kind="third"), "kind must be one of"),
        (lambda header, arrays: header.update(kind=["second"]), "kind must be one of"),
        (lambda header, arrays: header.update(report=[]), "header is not that of a linear model"),
    ],
)
def test_forged_linear_models_are_refused_even_with_right_checksums(system, tmp_path, forge, change, message):
    pt.save(pt.lti.reduce_linear(system, "modal", 3), tmp_path / "lie.lti")
    forge(tmp_path / "lie.lti", change, FORMAT, VERSION)
    with pytest.raises(pt.FileFormatError, match=rf"lie\.lti: .*{message}"):
        pt.load(tmp_path / "lie.lti", system)


def test_a_flipped_bit_of_a_linear_model_is_refused_wherever_it_is(system, tmp_path):
    path = tmp_path / "bar.lti"
    pt.save(pt.lti.reduce_linear(system, "modal", 3), path)
    data, generator = path.read_bytes(), np.random.default_rng(4)
    for place in [0, 30, 511, *generator.integers(len(data), size=60)]:
        changed = bytearray(data)
        changed[place] ^= 1 << int(generator.integers(8))
        path.write_bytes(changed)
        with pytest.raises(pt.FileFormatError, match=r"bar\.lti"):
            pt.load(path, system)
