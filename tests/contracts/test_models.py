"""The contract of every kind of model: rest, states, energy, threads and files."""

from __future__ import annotations

import re
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace

import numba
import numpy as np
import pytest
from contract_models import EACH_KIND, EVERY, KINDS, QUICK, run

import palpate as pt

pytestmark = [pytest.mark.quick(kind=QUICK, name=QUICK), pytest.mark.each_kind(kind=EACH_KIND)]

STEPS = 24


@pytest.fixture(scope="module", params=KINDS)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def model(kind):
    return KINDS[kind].make()


@pytest.fixture(scope="module")
def loads(kind):
    return KINDS[kind].loads()


@pytest.fixture(scope="module")
def prepared(model, loads):
    return model.prepare(loads)


@pytest.fixture(scope="module")
def step(model, prepared):
    """A step that is stable and divides the time between snapshots."""
    return EVERY / np.ceil(EVERY / min(EVERY / 20, 0.5 * model.stable_step(model.state(prepared), prepared)[0]))


@pytest.fixture(scope="module")
def state(model, prepared, step):
    """A state on the way."""
    return model.advance(model.state(prepared), prepared, step, int(2 * EVERY / step))[0]


def bits(value):
    """Return the bytes of all numbers in a state, in outputs, or in an array."""
    if is_dataclass(value):
        value = [getattr(value, own.name) for own in fields(value)]
    if isinstance(value, dict):
        value = [part for name in sorted(value) for part in (name, value[name])]
    if isinstance(value, list | tuple):
        return [bits(part) for part in value]
    return value if value is None or isinstance(value, str) else np.asarray(value).tobytes()


def same_runs(first, second):
    for name in (
        "displacements",
        "velocities",
        "kinetic",
        "strain",
        "external",
        "dissipated",
        "contact_forces",
        "steps",
    ):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
    for name, force in first.reactions.items():
        np.testing.assert_array_equal(force, second.reactions[name], err_msg=name)


def bent(model, prepared, state):
    """Return displacements that the model can make and that are not those of the state."""
    return -0.5 * model.displacement(state, prepared)


def crushed(model):
    """Return displacements of a body squeezed nearly flat."""
    points = model.cloud.points
    return np.pad(-0.7 * points, ((0, 0), (0, 3 - points.shape[1])))


def evaluations(model):
    """Return the functions of nodal displacements that a model has."""
    names = ("stress", "nodal_force", "evaluate", "strain_energy", "deformation_gradient")
    return [getattr(model, name) for name in names if hasattr(model, name)]


def state_functions(model):
    """Return the functions of a state that a model has interleaveds its outputs."""
    names = ("acceleration", "external_force", "trust")
    return [getattr(model, name) for name in names if hasattr(model, name)]


def use(model, prepared, state, step):
    """Evaluate all that a model offers at another state, and run it from there."""
    other, again = bent(model, prepared, state), model.prepare(prepared.loads)
    model.advance(model.state(again), again, step, 2)
    elsewhere = replace(state, coordinates=-0.5 * state.coordinates, velocities=0.3 * state.velocities)
    for evaluate in evaluations(model):
        with suppress(pt.InputError):  # a reduced membrane has no stress at nodes
            evaluate(other)
    model.outputs(elsewhere, prepared)
    model.stable_step(elsewhere, prepared)
    for evaluate in state_functions(model):
        evaluate(elsewhere, prepared)
    model.accept_step(elsewhere, *model.advance(elsewhere, prepared, step, 3))
    near = replace(state, coordinates=1.001 * state.coordinates)
    model.stable_step(near, prepared)
    model.advance(near, prepared, step, 1)


@pytest.mark.parametrize("name", ["stiffness_damping", "cloud", "a_new_name"])
def test_constants_cannot_be_set(model, name):
    before = dict(vars(model))
    with pytest.raises(AttributeError, match=f"{name} of {type(model).__name__} is constant"):
        setattr(model, name, 1.0)
    assert all(vars(model)[key] is value for key, value in before.items())


def test_rest_stays_at_rest(kind, model, loads, step):
    still = [replace(load, displacement=(0.0, 0.0, 0.0)) for load in loads if isinstance(load, pt.PrescribedMotion)]
    prepared = model.prepare(still)
    begun = model.state(prepared)
    ended = model.advance(begun, prepared, step, STEPS)[0]
    outputs, first, loaded = model.outputs(ended, prepared), model.outputs(begun, prepared), run(model, loads)
    for name in ("displacements", "velocities"):
        assert np.abs(getattr(outputs, name)).max() <= KINDS[kind].still * np.abs(getattr(loaded, name)).max(), name
    work = np.abs(loaded.external).max()
    for name in ("kinetic", "strain", "external", "dissipated"):
        assert abs(getattr(outputs, name) - getattr(first, name)) <= KINDS[kind].still * work, name


def test_supports_and_tools_constrain_their_nodes(model, loads, prepared):
    own = run(model, loads)
    moved = np.abs(own.displacements).max()
    for field in (own.displacements, own.velocities):
        for support in model.supports:
            across = field[:, model.cloud.group(support.group)] @ support.directions(model.cloud).T
            assert np.abs(across).max() <= 1e-6 * np.abs(field).max(), support
    for motion, where in prepared.motions:
        nodes = prepared.sites.prescribed[where]
        wanted = np.array([motion.displacement(model.cloud.points[nodes], t) for t in own.times])
        np.testing.assert_allclose(own.displacements[:, nodes], wanted[:, None] + 0 * nodes[:, None], atol=1e-6 * moved)


def test_supports_bear_the_loads(kind, model, loads):
    """The impulse of all forces on the body is the change of its momentum."""
    own = run(model, loads, every=EVERY / 20)
    assert own.kinetic[-1] > 0
    total = sum(own.reactions.values())
    for load in loads:
        if isinstance(load, pt.SurfaceForce):
            total = total + np.array([load.force(t) for t in own.times])
    impulse = np.trapezoid(total, own.times, axis=0)
    momentum = np.einsum("n,tnc->tc", model.masses, own.velocities)
    left = momentum[-1] + model.mass_damping * np.trapezoid(momentum, own.times, axis=0)
    size = np.trapezoid(np.abs(total), own.times, axis=0).max()
    np.testing.assert_allclose(impulse, left, atol=KINDS[kind].momentum * size)


def test_equal_states_take_equal_steps(model, prepared, state, step):
    model.state(prepared)
    first = model.advance(state, prepared, step, STEPS)[0]
    assert np.abs(first.coordinates - state.coordinates).max() > 1e-3 * np.abs(state.coordinates).max()
    use(model, prepared, state, step)
    assert bits(model.advance(state, prepared, step, STEPS)[0]) == bits(first)


def test_a_state_from_displacements_and_velocities_has_them(model, loads, state):
    """Those that the model can make are those of the state."""
    prepared = model.prepare([load for load in loads if not isinstance(load, pt.tools.Contact)])
    bare = replace(state, contact_state=None)
    u, v = model.displacement(bare, prepared), model.velocity(bare, prepared)
    begun = model.state(prepared, u, v, state.time)
    np.testing.assert_allclose(model.displacement(begun, prepared), u, atol=1e-9 * np.abs(u).max())
    if not prepared.motions:  # a tool's velocity is that of its motion
        np.testing.assert_allclose(model.velocity(begun, prepared), v, atol=1e-9 * np.abs(v).max())


def test_steps_in_two_parts_equal_steps_at_once(model, prepared, state, step):
    """A run that ends and goes on is the run: halves of a kick make the whole one."""
    whole, half = model.advance(state, prepared, step, STEPS)[0], model.advance(state, prepared, step, STEPS // 2)[0]
    parts = model.advance(half, prepared, step, STEPS // 2)[0]
    size = np.abs(model.displacement(whole, prepared) - model.displacement(state, prepared)).max()
    missed = np.abs(model.displacement(whole, prepared) - model.displacement(parts, prepared)).max()
    assert missed < 1e-2 * size


def test_equal_states_have_equal_outputs(model, prepared, state, step):
    model.state(prepared)
    functions = (model.outputs, *state_functions(model))
    first = [bits(function(state, prepared)) for function in functions]
    use(model, prepared, state, step)
    assert [bits(function(state, prepared)) for function in functions] == first


def test_equal_states_have_equal_stable_steps(model, prepared, state, step):
    model.state(prepared)
    first, after = model.stable_step(state, prepared)
    use(model, prepared, state, step)
    again, same = model.stable_step(state, prepared)
    assert again == first
    assert bits(same) == bits(after)


def test_equal_displacements_have_equal_stresses(model, prepared, state, step):
    u = bent(model, prepared, state)

    def evaluated():
        found = []
        for evaluate in evaluations(model):
            with suppress(pt.InputError):
                found.append(bits(evaluate(u)))
        return found

    first = evaluated()
    use(model, prepared, state, step)
    model.advance(state, prepared, step, STEPS)
    assert evaluated() == first


def test_accepting_a_step_is_a_function_of_its_states_and_report(model, prepared, state, step):
    before, report = model.advance(state, prepared, step, 1)
    wild = replace(before, velocities=1e3 * (before.velocities + np.abs(before.velocities).max()))
    for each in (report, replace(report, least_dilatation=-0.9)):
        first = model.accept_step(state, wild, each)
        use(model, prepared, state, step)
        if hasattr(model, "strain_energy"):
            model.strain_energy(crushed(model))
        assert model.accept_step(state, wild, each) == first


@pytest.mark.slow
def test_interleaved_runs_with_fixed_steps_are_independent(model, loads, step):
    alone = run(model, loads, step=step)
    interleaved = run(model, loads, step=step, progress=lambda *_: run(model, loads, step=0.8 * step, duration=EVERY))
    same_runs(alone, interleaved)


@pytest.mark.slow
def test_interleaved_runs_are_independent(model, loads):
    alone = run(model, loads)
    interleaved = run(model, loads, progress=lambda *_: run(model, loads, duration=3 * EVERY))
    same_runs(alone, interleaved)


@pytest.mark.slow
def test_two_threads_can_step_two_states_of_one_model(model, loads, step):
    """Each has its own workspace; the model is shared and only read."""
    durations = (2 * EVERY, 3 * EVERY)
    alone = [run(model, loads, step=step, duration=duration) for duration in durations]
    switches = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(2) as pool:
            together = list(pool.map(lambda duration: run(model, loads, step=step, duration=duration), durations))
    finally:
        sys.setswitchinterval(switches)
    for first, second in zip(alone, together, strict=True):
        same_runs(first, second)


def test_results_do_not_depend_on_the_contents_of_the_workspace(model, prepared, state, step):
    """Results are those of new scratch arrays, whatever a workspace was used for before."""
    work = model.workspace()
    model.advance(model.state(prepared), prepared, step, 3, work)
    model.stable_step(replace(state, coordinates=-state.coordinates), prepared, work)
    few = model.prepare([load for load in prepared.loads if isinstance(load, pt.PrescribedMotion)])
    begun = replace(model.state(few), coordinates=state.coordinates)
    for loads, at in ((few, begun), (prepared, state), (few, begun)):
        assert bits(model.advance(at, loads, step, STEPS, work)) == bits(model.advance(at, loads, step, STEPS))
        assert bits(model.stable_step(at, loads, work)) == bits(model.stable_step(at, loads))
        assert bits(model.outputs(at, loads, work)) == bits(model.outputs(at, loads))
    after = model.advance(state, prepared, step, STEPS, work)
    before = bits(after)
    model.advance(begun, few, step, 3, work)
    assert bits(after) == before  # a state shares no array with a workspace


def test_repeated_runs_are_equal_bit_by_bit(model, loads):
    same_runs(run(model, loads), run(model, loads))


def missed(run):
    return np.abs(run.balance).max() / np.abs(run.external).max()


def test_the_energy_balance_closes(kind, model, loads):
    own = run(model, loads)
    bound = KINDS[kind].balance
    assert missed(own) < bound
    # the bound is small: it shows each part that is left out, and energy that is made of nothing
    largest = np.abs(own.external).max()
    assert largest > 0
    for name in ("kinetic", "strain"):
        assert missed(replace(own, **{name: 0 * own.times})) > bound, name
    assert missed(replace(own, external=(1 - 3 * bound) * own.external)) > bound
    assert missed(replace(own, kinetic=own.kinetic + 3 * bound * largest * (own.times > 0))) > bound


def test_dissipated_energy_does_not_decrease(kind, model, loads, step):
    lost = run(model, loads, step=step / 4).dissipated
    assert np.diff(lost).min() >= -KINDS[kind].lost * np.abs(lost).max()
    assert lost[-1] > 0


def test_any_number_of_threads_gives_the_same_bits(model, loads):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    runs = []
    try:
        for threads in (1, 2):
            numba.set_num_threads(threads)
            runs.append(run(model, loads))
    finally:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    same_runs(*runs)


SAVED = [name for name, kind in KINDS.items() if name.startswith(("hyper-reduced", "linear"))]


def test_a_model_is_saved_by_the_ending_of_the_name(kind, model, tmp_path):
    own_format = {"hyper-reduced": ".rom", "linear": ".lti"}.get(re.match("hyper-reduced|linear|", kind)[0])
    if own_format is not None:
        pt.save(model, tmp_path / f"model{own_format}")
        pt.save(model, tmp_path / "model")
    for ending in {"", ".vtk", ".rom", ".lti"} - {own_format, "" if own_format else None}:
        with pytest.raises(pt.InputError, match=r"path of a .* must end in .*\.vtkhdf"):
            pt.save(model, tmp_path / f"other{ending}")
        assert not (tmp_path / f"other{ending}").exists()


@pytest.mark.each_kind(name=EACH_KIND)
@pytest.mark.parametrize("name", SAVED)
def test_a_loaded_model_has_the_same_run(name, tmp_path):
    own, loads = KINDS[name].make(), KINDS[name].loads()
    pt.save(own, tmp_path / "model")
    again = pt.load(tmp_path / "model", own.system) if hasattr(own, "system") else pt.load(tmp_path / "model")
    same_runs(run(own, loads), run(again, loads))
    assert (again.stiffness_damping, again.mass_damping) == (own.stiffness_damping, own.mass_damping)
    u = own.displacement(own.state(own.prepare(loads)), own.prepare(loads))
    for mine, its in zip(evaluations(own), evaluations(again), strict=True):
        with suppress(pt.InputError):
            assert bits(its(u)) == bits(mine(u))
