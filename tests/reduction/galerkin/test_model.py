"""The reduced model against the full one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.nodal.stability import stiffness

LOADS = [
    pt.SurfaceForce("x+", force=lambda t: np.sin(300 * t) ** 2 * np.array([0.6, 0.15, 0.05])),
    pt.Pressure("z+", lambda t: 300 * np.sin(200 * t)),
    pt.Gravity((0.0, 2.0, -9.81)),
]


def explicit(model):
    """Return a model whose step the reduced spectrum limits, where it would otherwise slow its fast modes."""
    return pt.GalerkinModel(model.full, model.basis, implicit=False)


@pytest.fixture(scope="module")
def body(small_cloud, tissue):
    return pt.Solid(small_cloud, tissue, form="strong", fixed="x-", stiffness_damping=6e-5)


@pytest.fixture(scope="module")
def everything(body):
    """A basis that spans every free motion, and the reduced model on it."""
    count = 3 * int(np.sum(~body.fixed_mask))
    fields = np.random.default_rng(0).normal(size=(count, len(body.cloud), 3))
    fields[:, body.fixed_mask] = 0
    return explicit(pt.GalerkinModel(body, pt.pod(fields, body.weights, modes=count)))


@pytest.fixture
def model(bar, tissue, calm):
    return pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=calm)


def test_a_full_rank_reduced_model_has_the_full_force(body, everything):
    u = 3e-4 * np.random.default_rng(1).normal(size=body.cloud.points.shape)
    u[body.fixed_mask] = 0
    found = everything.basis.lift(everything.force(everything.basis.project(u)))
    expected = body.force(u) / body.material.density
    np.testing.assert_allclose(found[~body.fixed_mask], expected[~body.fixed_mask], atol=1e-9 * np.abs(expected).max())


def test_a_full_rank_reduced_run_is_the_full_run(small_cloud, tissue, everything):
    full = pt.Solid(small_cloud, tissue, form="strong", fixed="x-", stiffness_damping=6e-5)
    runs = [pt.rollout(m, LOADS, duration=0.01, every=0.002, step=2e-5) for m in (full, everything)]
    assert np.abs(runs[0].displacements).max() > 1e-4
    for name in ("displacements", "velocities", "kinetic", "strain", "external"):
        expected = getattr(runs[0], name)
        np.testing.assert_allclose(getattr(runs[1], name), expected, atol=1e-8 * np.abs(expected).max())
    force = runs[0].reactions["x-"]
    np.testing.assert_allclose(runs[1].reactions["x-"], force, atol=1e-7 * np.abs(force).max())
    assert runs[1].model == "projected"


def test_a_full_rank_spectrum_is_the_full_spectrum(body, everything):
    found = np.sort(everything.spectrum(np.zeros(len(everything.basis))).real)
    np.testing.assert_allclose(found, np.sort(np.linalg.eigvals(stiffness(body)).real), rtol=1e-3)


def test_the_reduced_force_is_the_projected_full_force(model, run):
    rom = pt.galerkin(model, run, modes=5)
    for frame in (10, 40):
        a = rom.basis.project(run.displacements[frame])
        force = model.force(rom.basis.lift(a)) / model.material.density
        expected = rom.basis.project(force)
        np.testing.assert_allclose(rom.force(a), expected, atol=1e-10 * np.abs(expected).max())


def test_a_reduced_run_reproduces_the_run_it_was_trained_on(model, run, pull):
    found = {}
    for modes in (2, 6, 10):
        rom = pt.galerkin(model, run, modes=modes)
        reduced = pt.rollout(rom, [pull], duration=0.03, every=0.0005)
        found[modes] = pt.relative_errors(run, reduced)
    assert found[10].displacement < 0.05
    assert found[10].velocity < 0.1
    assert found[10].energy < 0.02
    assert found[10].reaction < 0.05
    assert found[10].displacement < found[6].displacement < found[2].displacement


def test_fewer_modes_allow_longer_steps(model, run):
    steps = []
    for modes in (2, 8, 20):
        rom = explicit(pt.galerkin(model, run, modes=modes))
        prepared = rom.prepare(())
        steps.append(rom.stable_step(rom.state(prepared), prepared)[0])
    full = model.stable_step(model.state(model.prepare(())), model.prepare(()))[0]
    assert steps[0] > steps[1] > steps[2] > 0.99 * full


def test_the_reduced_step_is_stable_and_a_third_more_is_not(model, run):
    rom = explicit(pt.galerkin(model, run, modes=8))
    prepared = rom.prepare(())
    start = replace(rom.state(prepared), coordinates=1e-12 * np.random.default_rng(0).normal(size=8))
    step = rom.stable_step(start, prepared)[0]
    sizes = [np.linalg.norm(rom.advance(start, prepared, f * step, 400)[0].coordinates) for f in (1.0, 1.3 / 0.85)]
    assert sizes[0] < 3e-12
    assert not sizes[1] < 1e-6


def test_displacements_of_a_subset_of_nodes_are_those_of_all(model, run):
    rom = pt.galerkin(model, run, modes=4)
    prepared = rom.prepare(())
    state = rom.state(prepared, run.displacements[20], run.velocities[20])
    nodes = np.array([5, 77, 100])
    np.testing.assert_allclose(
        rom.displacement(state, prepared, nodes), rom.displacement(state, prepared)[nodes], atol=1e-15
    )
    np.testing.assert_allclose(rom.velocity(state, prepared, nodes), rom.velocity(state, prepared)[nodes], atol=1e-13)


def test_initial_states_are_projected(model, run):
    rom = pt.galerkin(model, run, modes=4)
    prepared = rom.prepare(())
    state = rom.state(prepared, run.displacements[20], run.velocities[20])
    np.testing.assert_allclose(state.coordinates, rom.basis.project(run.displacements[20]), rtol=1e-12)
    np.testing.assert_allclose(state.velocities, rom.basis.project(run.velocities[20]), rtol=1e-12)


def test_supports_stay_fixed(model, run, pull):
    reduced = pt.rollout(pt.galerkin(model, run, modes=4), [pull], duration=0.005, every=0.005)
    np.testing.assert_allclose(reduced.displacements[:, model.fixed_mask], 0, atol=1e-16)


def test_energy_of_a_reduced_run_balances_as_in_the_full_run(model, run, pull):
    reduced = pt.rollout(pt.galerkin(model, run, modes=10), [pull], duration=0.03, every=0.0005)
    scale = run.external.max()
    np.testing.assert_allclose(reduced.external, run.external, atol=0.02 * scale)
    np.testing.assert_allclose(reduced.balance, run.balance, atol=0.05 * scale)


def test_a_reduced_run_repeats_bit_by_bit(model, run, pull):
    rom = pt.galerkin(model, run, modes=4)
    runs = [pt.rollout(rom, [pull], duration=0.01, every=0.005) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].displacements, runs[1].displacements)
    np.testing.assert_array_equal(runs[0].dissipated, runs[1].dissipated)


@pytest.fixture(scope="module")
def motion():
    return pt.PrescribedMotion("x+", lambda points, t: (1e-3 * np.sin(100 * t) ** 2, 4e-4 * np.sin(60 * t), 0))


@pytest.fixture(scope="module")
def prescribed(bar, tissue, calm, motion):
    return pt.rollout(
        pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=calm), [motion], duration=0.03, every=0.0005
    )


@pytest.fixture(scope="module")
def lifted(bar, tissue, calm, prescribed, motion):
    rom = pt.galerkin(
        pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=calm), prescribed, modes=8, prescribed=["x+"]
    )
    return rom, pt.rollout(rom, [motion], duration=0.03, every=0.0005)


def test_lifted_nodes_follow_the_prescribed_motion(bar, prescribed, lifted):
    tool = bar.group("x+")
    scale = np.abs(prescribed.displacements[:, tool]).max()
    np.testing.assert_allclose(lifted[1].displacements[:, tool], prescribed.displacements[:, tool], atol=1e-9 * scale)


def test_modes_vanish_at_the_tool_and_the_support(bar, lifted):
    for name in ("x+", "x-"):
        assert np.abs(lifted[0].basis.modes[:, bar.group(name)]).max() < 1e-9 * np.abs(lifted[0].basis.modes).max()


def test_a_lifted_tool_feels_the_force_of_the_full_model(prescribed, lifted):
    errors = pt.relative_errors(prescribed, lifted[1])
    wrong = np.abs(lifted[1].displacements - prescribed.displacements).max()
    assert wrong < 0.05 * np.abs(prescribed.displacements).max()
    assert errors.energy < 0.02
    assert errors.reaction < 0.05


def test_the_work_of_a_lifted_tool_is_that_of_the_full_model(prescribed, lifted):
    np.testing.assert_allclose(lifted[1].external, prescribed.external, atol=0.05 * prescribed.external.max())


def test_a_motion_that_was_not_trained_is_refused(lifted, model, run):
    sideways = pt.PrescribedMotion("x+", lambda points, t: (0, 0, 1e-3 * np.sin(100 * t)))
    with pytest.raises(pt.InputError, match="must be as in training"):
        pt.rollout(lifted[0], [sideways], duration=0.01, every=0.005)
    with pytest.raises(pt.InputError, match="unless it was part of the training"):
        pt.rollout(pt.galerkin(model, run, modes=3), [sideways], duration=0.01, every=0.005)


def test_invalid_training_is_refused(model, run, body):
    with pytest.raises(pt.InputError, match="independent shapes of 61 snapshots, got 62"):
        pt.galerkin(model, run, modes=62)
    with pytest.raises(pt.InputError, match="trajectories must hold at least one"):
        pt.galerkin(model, [], modes=2)
    with pytest.raises(pt.InputError, match="another cloud"):
        pt.galerkin(body, run, modes=2)
    with pytest.raises(pt.InputError, match="groups that move"):
        pt.galerkin(model, run, modes=2, prescribed=["x-"])
    with pytest.raises(pt.InputError, match="group must be one of"):
        pt.galerkin(model, run, modes=2, prescribed=["tool"])
    with pytest.raises(pt.InputError, match="modes or tolerance must be given"):
        pt.galerkin(model, run)
    with pytest.raises(pt.InputError, match=r"basis must have the 64 nodes of full, got 112"):
        pt.GalerkinModel(body, pt.pod(run, model.weights, modes=2))
