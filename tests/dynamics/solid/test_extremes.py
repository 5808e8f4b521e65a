"""Values far outside of tissue: each is refused by name, or the run ends with an error that says why."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.nodal.stability import stable_step
from palpate.dynamics.run import rollout as rollout_module
from palpate.dynamics.run.model import Outputs
from palpate.meshfree.stencils import moving_least_squares

# these values cause the warning
pytestmark = [pytest.mark.filterwarnings("ignore::palpate.core.faults.UnitWarning"), pytest.mark.slow]

SHORT = {"duration": 1e-3, "every": 5e-4, "progress": False}


def pull(newton):
    return [pt.SurfaceForce("x+", force=(newton, 0.0, 0.0))]


@pytest.fixture
def energetic(small_cloud, tissue):
    return pt.Solid(small_cloud, tissue, fixed="x-", form="energy")


@pytest.fixture(scope="module")
def reduced(small_cloud, tissue):
    full = pt.Solid(small_cloud, tissue, fixed="x-", form="energy")
    run = pt.rollout(full, pull(0.5), duration=0.02, every=1e-3, progress=False)
    return pt.hyper_reduce(full, run, modes=3)


@pytest.mark.parametrize("newton", [-2e3, 2e4, 1e9, 1e200, 1e308])
def test_excessive_forces_end_runs_of_every_model_with_a_divergence(newton, held, energetic, reduced, monkeypatch):
    monkeypatch.setattr(rollout_module, "MAX_STEP_RATIO", 3)
    for model in (held, energetic, reduced):
        with pytest.raises(pt.DivergenceError) as caught:
            pt.rollout(model, pull(newton), duration=0.02, every=1e-3, progress=False)
        partial = caught.value.trajectory
        assert all(np.isfinite(getattr(partial, name)).all() for name in ("displacements", "kinetic", "strain"))


def test_a_run_that_needs_ever_shorter_steps_is_ended_and_says_so(energetic, monkeypatch):
    steps, stable = iter([1e-4, *[1e-9] * 10**6]), 1e-4
    monkeypatch.setattr(type(energetic), "stable_step", lambda model, state, prepared, work: (next(steps), state))
    monkeypatch.setattr(rollout_module, "STEPS_PER_ESTIMATE", 2)
    with pytest.raises(
        pt.DivergenceError, match=r"became too small: \d+ steps, 100 times those of the first"
    ) as caught:
        pt.rollout(energetic, [], duration=stable * 40, every=stable * 20, progress=False)
    assert "smaller loads" in str(caught.value)


def test_a_divergence_names_the_first_node_that_is_not_finite(energetic, monkeypatch):
    advance = type(energetic).advance

    def broken(model, *arguments):
        after, report = advance(model, *arguments)
        after.coordinates[[7, 9]] = np.nan
        return after, report

    monkeypatch.setattr(type(energetic), "advance", broken)
    with pytest.raises(pt.DivergenceError, match="first non-finite node 7 at"):
        pt.rollout(energetic, [], step=1e-5, **SHORT)


@pytest.mark.parametrize("name", ["velocities", "kinetic", "external", "dissipated", "reactions"])
def test_no_snapshot_that_is_not_finite_is_kept_or_written(name, energetic, monkeypatch, tmp_path):
    outputs = type(energetic).outputs

    def spoilt(model, state, prepared, work=None) -> Outputs:
        found = outputs(model, state, prepared, work)
        if state.time < 4e-4:
            return found
        value = {"x-": np.full(3, np.inf)} if name == "reactions" else getattr(found, name) * np.inf + np.inf
        return replace(found, **{name: value})

    monkeypatch.setattr(type(energetic), "outputs", spoilt)
    file = tmp_path / "run.h5"
    with pytest.raises(pt.DivergenceError, match="became non-finite") as caught:
        pt.rollout(energetic, pull(0.1), file=file, **SHORT)
    assert len(caught.value.trajectory.times) == len(pt.Trajectory.load(file).times) == 1


def test_an_invalid_initial_state_leaves_no_file(energetic, tmp_path):
    u = np.zeros((64, 3))
    u[:, 0] = -1.5 * energetic.cloud.points[:, 0]
    for initial in ({"displacement": u}, {"velocity": np.full((64, 3), 1e200)}):
        with pytest.raises(pt.DivergenceError) as caught:
            pt.rollout(energetic, [], file=tmp_path / "run.h5", **initial, **SHORT)
        assert len(caught.value.trajectory.times) == 0
    assert list(tmp_path.iterdir()) == []


def test_an_initial_value_that_is_not_finite_is_named_by_its_node(energetic, reduced):
    for model in (energetic, reduced):
        for name in ("displacement", "velocity"):
            field = np.zeros((64, 3))
            field[17, 1] = np.inf
            with pytest.raises(pt.InputError, match=f"initial {name} must be finite, got .* at node 17"):
                pt.rollout(model, [], **{name: field}, **SHORT)
            with pytest.raises(pt.InputError, match=f"initial {name} must be an array of numbers"):
                pt.rollout(model, [], **{name: [["a"]]}, **SHORT)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"every": 5e-324}, "start must be .*, got 0.0|snapshots and .* MB, got inf"),
        ({"every": 1e-12}, "snapshots and .* MB, got 1e\\+09"),
        ({"duration": 1e9, "every": 1e-2}, "snapshots and .* MB, got 1e\\+11"),
        ({"start": 1e20}, "start must be .*, got 1e\\+20"),
        ({"start": np.nan}, "start must be .*, got nan"),
        ({"start": 10**400}, "start must be a number"),
        ({"step": 1e-300}, "step must be .*, got 1e-300"),
        ({"start": 4e5, "step": 1e-9}, "start must be near 0 for steps of 1e-09 s"),
    ],
)
def test_invalid_durations_and_intervals_are_refused(arguments, message, energetic):
    with pytest.raises(pt.InputError, match=message):
        pt.rollout(energetic, [], **(SHORT | arguments))


def test_snapshots_that_exceed_the_memory_are_refused(energetic, monkeypatch):
    monkeypatch.setattr(rollout_module, "machine_memory", lambda: 5e3)
    with pytest.raises(pt.InputError, match=r"at most 1000000 snapshots and 0\.005 MB, got 2 and 0\.00614 MB"):
        pt.rollout(energetic, [], **SHORT)


@pytest.mark.parametrize("form", ["strong", "energy"])
@pytest.mark.parametrize(
    "given", [{"C1": 1e-300}, {"C1": 5e-324}, {"density": 5e-324}, {"C1": 1e300}, {"density": 1e300}]
)
def test_bodies_beyond_double_precision_are_refused(form, given, small_cloud):
    with pytest.raises(pt.InputError, match=r"must be"):
        pt.Solid(
            small_cloud, pt.materials.NeoHookean(**({"C1": 5e3, "density": 1e3, "poisson": 0.45} | given)), form=form
        )


@pytest.mark.parametrize("given", [{"C1": 1e-300}, {"density": 5e-324}])
def test_sheets_beyond_double_precision_are_refused(given):
    material = pt.materials.NeoHookean(**({"C1": 5e3, "density": 1e3, "poisson": 0.5} | given))
    with pytest.raises(pt.InputError, match="highest frequency of the body must be"):
        pt.Membrane(pt.disc(0.1, 0.025), material, 1e-4, "rim")


def test_no_step_is_stable_where_a_frequency_is_not_finite():
    assert stable_step(np.inf, 0.1) == stable_step(np.nan, 0.1) == stable_step(1e300, 1.0) == 0.0


@pytest.mark.parametrize(
    "turn", [(1e300, 0.0, 0.0), (0.0, 10**400, 0.0), (np.nan, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "left"]
)
def test_invalid_rotations_are_refused(turn, energetic):
    with pytest.raises(pt.InputError, match="motion of Contact 'tool'"):  # a word only by the run
        pt.rollout(energetic, pt.tools.Contact(pt.tools.Sphere(0.005), ((0.0, 0.0, 1.0), turn)), **SHORT)


def test_quaternions_of_any_length_are_normalised():
    for length in (1e-300, 1e-3, 1.0, 1e300):
        pose = pt.tools.Contact(pt.tools.Sphere(0.005), ((0.0, 0.0, 1.0), (0.0, length, 0.0, -length))).poses(
            np.zeros(1)
        )[0]
        np.testing.assert_allclose(pose[3:], np.sqrt(0.5) * np.array([0.0, 1.0, 0.0, -1.0]), rtol=1e-15)


@pytest.mark.parametrize("value", [10**5000, np.inf, "much"], ids=["long", "inf", "text"])
def test_loads_that_are_not_finite_numbers_are_refused(value, energetic):
    for make in (lambda: pt.Gravity((0.0, 0.0, value)), lambda: pt.Pressure("x+", value)):
        with pytest.raises(pt.InputError, match=r"Gravity|Pressure"):
            pt.rollout(energetic, [make()], **SHORT)


@pytest.mark.parametrize("factor", [1e200, 1e12])
def test_clouds_far_away_are_refused(factor, small_cloud):
    with pytest.raises(pt.CloudError, match=r"within 1e\+09 m"):
        replace(small_cloud, points=small_cloud.points * factor)
    with pytest.raises(pt.CloudError, match=r"within 1e\+09 m"):
        moving_least_squares(small_cloud.points * factor, order=1, neighbours=20)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda cloud: {"points": cloud.points * 1e-200}, None),
        (lambda cloud: {"points": cloud.points * 1e5}, None),
        (lambda cloud: {"volumes": cloud.volumes * 1e200}, "volumes must be"),
        (lambda cloud: {"volumes": cloud.volumes * 1e-200}, "volumes must be"),
        (lambda cloud: {"volumes": cloud.volumes * np.inf}, "volumes must be"),
        (lambda cloud: {"spacing": np.nan}, "spacing must be"),
        (lambda cloud: {"spacing": 1e-300}, "spacing must be"),
        (lambda cloud: {"face_areas": cloud.face_areas * np.nan}, "must be finite"),
        (lambda cloud: {"face_areas": cloud.face_areas * 1e300}, "face_areas at most"),
        (lambda cloud: {"face_nodes": cloud.face_nodes + 64}, r"must hold nodes in \[0, 63\]"),
    ],
)
def test_clouds_with_inconsistent_arrays_are_refused(given, message, small_cloud, tissue):
    if message is not None:
        with pytest.raises(pt.CloudError, match=message):
            replace(small_cloud, **given(small_cloud))
        return
    cloud = replace(small_cloud, **given(small_cloud))
    with pytest.raises(pt.InputError), np.errstate(all="ignore"):
        pt.Solid(cloud, tissue, form="energy")


@pytest.mark.slow
def test_random_extreme_inputs_run_or_are_refused():
    place = Path(__file__).parents[3] / "validation" / "fuzz_physics.py"
    spec = importlib.util.spec_from_file_location("fuzz_physics", place)
    fuzz = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fuzz)
    ends = {fuzz.trial(np.random.default_rng([2026, k])) for k in range(25)}
    assert ends == {"refused", "ran"}
