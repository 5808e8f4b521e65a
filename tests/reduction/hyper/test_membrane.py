"""Reduced models of a membrane: its tool lifted, its force, and the tool that lets go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

import palpate as pt
from palpate.reduction.galerkin.model import GalerkinModel
from palpate.reduction.hyper.error_indicator import residual_norm
from palpate.reduction.hyper.reactions import constraint_forces

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sheet():
    cloud = pt.disc(0.1, 0.0125).within("tool", (0.0, 0.0), 1e-6)
    return pt.Membrane(cloud, pt.materials.NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5), 1e-5, "rim")


def tip(points, time):
    return (0.0, 0.0, 0.1 * max(time, 0.0))


PUSH = pt.PrescribedMotion("tool", tip)
LET_GO = pt.PrescribedMotion("tool", tip, until=0.1)


@pytest.fixture(scope="module")
def push(sheet):
    return pt.rollout(sheet, [PUSH], duration=0.1, every=0.0025, progress=False)


@pytest.fixture(scope="module")
def freed(sheet):
    return pt.rollout(sheet, [LET_GO], duration=0.15, every=0.0025, progress=False)


def shapes(sheet, count, seed=0):
    """Random modes that vanish at the rim and the tool, and a column that moves the tool alone."""
    rng = np.random.default_rng(seed)
    held = sheet.fixed_mask.copy()
    held[sheet.cloud.group("tool")] = True
    fields = rng.standard_normal((count, len(sheet.cloud), 3)) * ~held[:, None]
    column = np.zeros((1, len(sheet.cloud), 3))
    column[0, sheet.cloud.group("tool"), 2] = 1.0
    return pt.pod(fields, sheet.weights, modes=count), column


def test_the_projected_force_is_the_projection_of_the_nodal_force(sheet):
    basis, column = shapes(sheet, 5)
    rom = GalerkinModel(sheet, basis, column)
    coordinates = np.concatenate([1e-7 * np.random.default_rng(1).standard_normal(5), [0.004]])
    u = np.tensordot(coordinates, rom.columns, 1)
    expected = np.einsum("n,mnc,nc->m", sheet.volumes, rom.columns, sheet.force(u)) / 1200.0
    np.testing.assert_allclose(rom.force(coordinates), expected, atol=1e-11 * np.abs(expected).max())


def test_the_reduced_tangent_of_a_pushed_sheet_is_symmetric(sheet, push):
    rom = pt.galerkin(sheet, push, modes=8, prescribed=["tool"], lifting="local")
    state = rom.state(rom.prepare([PUSH]), push.displacements[-1], push.velocities[-1], 0.1)
    tangent = rom.stiffness(state.coordinates)
    np.testing.assert_allclose(tangent, tangent.T, atol=1e-3 * np.abs(tangent).max())
    assert np.linalg.eigvalsh(tangent + tangent.T).min() > 0


@pytest.mark.parametrize(("modes", "displacement", "force"), [(8, 0.15, 0.1), (20, 0.01, 0.02), (39, 1e-3, 1e-2)])
def test_more_modes_reduce_the_error_of_the_push(sheet, push, modes, displacement, force):
    rom = pt.galerkin(sheet, push, modes=modes, prescribed=["tool"], lifting="local", relative=True)
    errors = pt.relative_errors(push, pt.rollout(rom, [PUSH], duration=0.1, every=0.0025, progress=False))
    assert errors.displacement < displacement
    assert errors.reaction < force


def test_local_lifting_and_relative_snapshots_each_reduce_the_error(sheet, push):
    errors = []
    for lifting, relative in (("fitted", False), ("local", False), ("local", True)):
        rom = pt.galerkin(sheet, push, modes=8, prescribed=["tool"], lifting=lifting, relative=relative)
        run = pt.rollout(rom, [PUSH], duration=0.1, every=0.0025, progress=False)
        errors.append(pt.relative_errors(push, run).displacement)
    assert errors[2] < 0.5 * errors[1] < 0.25 * errors[0]


def test_a_local_column_moves_the_tool_alone(sheet, push):
    rom = pt.galerkin(sheet, push, modes=4, prescribed=["tool"], lifting="local")
    tool = sheet.cloud.group("tool")
    others = np.setdiff1d(np.arange(len(sheet.cloud)), tool)
    assert np.all(rom.lifting[:, others] == 0)
    np.testing.assert_allclose(rom.basis.modes[:, tool], 0, atol=1e-9 * np.abs(rom.basis.modes).max())
    run = pt.rollout(rom, [PUSH], duration=0.1, every=0.0025, progress=False)
    np.testing.assert_allclose(run.displacements[:, tool[0], 2], 0.1 * run.times, atol=1e-12)


def test_the_tool_of_a_reduced_sheet_does_the_work_of_the_full_one(sheet, push):
    rom = pt.galerkin(sheet, push, modes=20, prescribed=["tool"], lifting="local", relative=True)
    run = pt.rollout(rom, [PUSH], duration=0.1, every=0.0025, progress=False)
    assert run.external[-1] == pytest.approx(push.external[-1], rel=0.02)
    assert np.abs(run.balance).max() < 0.02 * push.external.max()


def test_a_released_tool_of_a_galerkin_model_has_no_force(sheet, freed):
    rom = pt.galerkin(sheet, freed, modes=40, prescribed=["tool"], lifting="local")
    run = pt.rollout(rom, [LET_GO], duration=0.15, every=0.0025, progress=False)
    let_go = run.times > 0.1 + 1e-9
    assert np.all(run.reactions["tool"][let_go] == 0)
    tool = sheet.cloud.group("tool")[0]
    moved = freed.displacements[let_go, tool, 2]
    assert np.ptp(moved) > 1e-3
    np.testing.assert_allclose(run.displacements[let_go, tool, 2], moved, atol=0.1 * np.ptp(moved))
    work = run.external[let_go]
    np.testing.assert_allclose(work, work[0], rtol=1e-9)  # nothing pushes then


def test_a_reduced_run_can_start_after_the_release(sheet, freed):
    start = 44  # 0.11 s
    u, v = freed.displacements[start], freed.velocities[start]
    rom = pt.galerkin(sheet, freed, modes=40, prescribed=["tool"], lifting="local")
    prepared = rom.prepare([LET_GO])
    state = rom.state(prepared, u, v, 0.11)
    assert np.abs(rom.displacement(state, prepared) - u).max() < 0.02 * np.abs(u).max()
    run = pt.rollout(rom, [LET_GO], duration=0.02, every=0.0025, start=0.11, displacement=u, velocity=v, progress=False)
    expected = freed.displacements[start : start + 9]
    assert np.abs(run.displacements - expected).max() < 0.1 * np.abs(expected).max()


def test_tools_released_at_different_times_are_refused(sheet, push):
    cloud = sheet.cloud.within("other", (0.05, 0.0), 0.007)
    model = pt.Membrane(cloud, sheet.material, 1e-5, "rim")
    rom = GalerkinModel(model, *shapes(sheet, 2))
    with pytest.raises(pt.InputError, match="give all motions one `until`"):
        rom.prepare([LET_GO, pt.PrescribedMotion("other", (0.0, 0.0, 0.0), until=0.2)])


def test_bad_training_is_refused(sheet, push):
    with pytest.raises(pt.InputError, match="must be 'fitted' or 'local'"):
        pt.galerkin(sheet, push, modes=2, prescribed=["tool"], lifting="global")
    with pytest.raises(pt.InputError, match="prescribed must name groups"):
        pt.galerkin(sheet, push, modes=2, lifting="local")
    still = replace(push, displacements=np.zeros_like(push.displacements))
    with pytest.raises(pt.InputError, match="snapshots must be non-zero"):
        pt.galerkin(sheet, still, modes=2, relative=True)


def test_tools_other_than_those_of_the_training_are_refused(sheet, push):
    cloud = sheet.cloud.within("other", (0.05, 0.0), 0.007)
    model = pt.Membrane(cloud, sheet.material, 1e-5, "rim")
    rom = pt.galerkin(model, push, modes=4, prescribed="tool", lifting="local")
    with pytest.raises(pt.InputError, match="got group 'other'"):
        rom.prepare([PUSH, pt.PrescribedMotion("other", (0.0, 0.0, 0.0))])
    with pytest.raises(pt.InputError, match="motion of the prescribed groups"):
        rom.prepare([])


def test_a_tool_may_be_released_between_snapshots(sheet):
    tool = pt.PrescribedMotion("tool", tip, until=0.03)
    full = pt.rollout(sheet, [tool], duration=0.06, every=0.002, progress=False)
    rom = pt.galerkin(sheet, full, modes=20, prescribed="tool", lifting="local", relative=True)
    for every in (0.02, 0.0125):
        run = pt.rollout(rom, [tool], duration=0.06, every=every, progress=False)
        energy = run.kinetic + run.strain
        assert energy[-1] < 1.01 * run.external.max()
        assert energy[-1] == pytest.approx((full.kinetic + full.strain)[-1], rel=0.3)


def test_consecutive_runs_equal_one_run(sheet, push):
    half = pt.rollout(sheet, [PUSH], duration=0.05, every=0.0025, progress=False)
    rest = pt.rollout(
        sheet, [PUSH], duration=0.05, every=0.0025, start=0.05, progress=False,
        displacement=half.displacements[-1], velocity=half.velocities[-1],
    )  # fmt: skip
    whole = half.concatenate(rest)
    np.testing.assert_allclose(whole.times, push.times, atol=1e-12)
    np.testing.assert_allclose(whole.displacements, push.displacements, atol=2e-5)
    np.testing.assert_allclose(whole.external, push.external, atol=0.02 * push.external[-1])
    assert whole.steps[-1] == half.steps[-1] + rest.steps[-1]
    assert whole.wall_seconds == half.wall_seconds + rest.wall_seconds
    with pytest.raises(pt.InputError, match="other must start at"):
        rest.concatenate(half)
    with pytest.raises(pt.InputError, match="the same body"):
        half.concatenate(replace(rest, points=1.1 * rest.points))
    with pytest.raises(pt.InputError, match="the same body, supports and tools"):
        half.concatenate(replace(rest, reactions={}))


# the sampled energy


@pytest.fixture(scope="module")
def sampled(sheet, push):
    return pt.hyper_reduce(sheet, push, modes=10, prescribed="tool")


def every_point(sheet, run, **options):
    data = pt.hyper_reduce(sheet, run, modes=6, prescribed="tool", cubature=0.0, **options).data
    return pt.ReducedModel(data, single=False)


def test_a_hyper_reduced_sheet_has_few_points_and_reproduces_the_push(sheet, push, sampled):
    assert len(sampled.data.cubature.nodes) < 0.15 * 6 * len(sheet.cloud)
    assert sampled.data.cubature.pressure.shape[0] == 0
    run = pt.rollout(sampled, [PUSH], duration=0.1, every=0.0025, progress=False)
    errors = pt.relative_errors(push, run)
    assert errors.displacement < 0.15
    assert errors.energy < 0.01
    assert errors.reaction < 0.1
    assert np.abs(run.balance).max() < 0.01 * run.external.max()
    moved = run.displacements[-1, sheet.cloud.group("tool")[0]]
    np.testing.assert_allclose(moved, [0.0, 0.0, 0.01], atol=1e-9)


def test_few_points_of_a_taut_sheet_give_the_tool_force_of_all_points(sheet, push, tmp_path):
    """At rest the stresses of a taut sheet do work on every mode, which sums to nothing."""
    taut = pt.Membrane(sheet.cloud, sheet.material, 1e-5, "rim", prestretch=1.05)
    full = pt.rollout(taut, [PUSH], duration=0.05, every=0.0025, progress=False)
    models = [pt.hyper_reduce(taut, full, modes=6, prescribed="tool", cubature=share) for share in (1e-3, 0.0)]
    few, whole = (pt.rollout(model, [PUSH], duration=0.05, every=0.0025, progress=False) for model in models)
    errors = pt.relative_errors(whole, few)
    assert errors.reaction < 0.05
    assert errors.displacement < 0.05
    for model in models:
        pt.save(model, tmp_path / "taut.rom")
        assert len(pt.load(tmp_path / "taut.rom").data.cubature.nodes) == len(model.data.cubature.nodes)


def test_few_points_give_the_tool_force_of_all_points(sheet, push):
    few = pt.hyper_reduce(sheet, push, modes=6, prescribed="tool")
    runs = [
        pt.rollout(model, [PUSH], duration=0.1, every=0.0025, progress=False)
        for model in (few, every_point(sheet, push))
    ]
    assert pt.relative_errors(runs[1], runs[0]).reaction < 0.05  # 40 % where the weights do not know the tool's force


def test_the_tool_of_a_hyper_reduced_sheet_may_be_released(sheet, freed):
    model = pt.hyper_reduce(sheet, freed, modes=16, prescribed="tool")
    run = pt.rollout(model, [LET_GO], duration=0.15, every=0.0025, progress=False)
    assert pt.relative_errors(freed, run).displacement < 0.2
    after = run.times > 0.1 + 1e-9
    assert np.all(run.reactions["tool"][after] == 0)


def test_the_step_of_a_slack_sheet_is_that_of_its_taut_states(sampled):
    prepared = sampled.prepare([PUSH])
    assert sampled.data.trained.taut_frequency > 1.2 * sampled.body.frequencies()[-1]
    assert sampled.stable_step(sampled.state(prepared), prepared)[0] < 2 / sampled.data.trained.taut_frequency


def test_a_sampled_sheet_is_saved_and_loaded(sampled, tmp_path):
    pt.save(sampled, tmp_path / "sheet.rom")
    loaded = pt.load(tmp_path / "sheet.rom")
    assert loaded.data.kinematics == sampled.data.kinematics
    assert loaded.material == sampled.material
    assert loaded.data.trained.taut_frequency == sampled.data.trained.taut_frequency
    a = 1e-4 * np.random.default_rng(0).standard_normal(sampled.count)
    np.testing.assert_array_equal(loaded.body.force(a), sampled.body.force(a))


def test_a_hyper_reduced_sheet_refuses_nodal_stress_and_pressures(sampled):
    with pytest.raises(pt.InputError, match="stress at nodes"):
        sampled.stress(np.zeros((len(sampled.cloud), 3)))
    with pytest.raises(pt.InputError, match=r"got Pressure\(.*; run the full model or palpate.galerkin"):
        sampled.prepare([PUSH, pt.Pressure("face", lambda t: 1.0)])


def test_a_sampled_sheet_is_trusted_near_its_training(sheet, push, sampled):
    prepared = sampled.prepare([PUSH])
    near, far = (
        pt.State(scale * sampled.data.training_states[-1], np.zeros(sampled.count), 0.1) for scale in (1.0, 3.0)
    )
    assert sampled.trust(near, prepared) < 0.2
    assert sampled.trust(far, prepared) > 1


@pytest.fixture(scope="module")
def taut():
    corners = 0.03 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    skin = pt.materials.NeoHookean(C1=10e3, density=1000.0, poisson=0.5)
    return pt.Membrane(pt.sheet(corners, 0.003), skin, 1e-3, "rim", prestretch=1.1, stiffness_damping=1e-4)


def blown(*force: float) -> list[pt.SurfaceForce]:
    return [pt.SurfaceForce("face", force=lambda t: np.sin(0.5 * np.pi * min(t / 0.05, 1.0)) ** 2 * np.array(force))]


def blown_run(model, loads) -> pt.Trajectory:
    return pt.rollout(model, loads, duration=0.1, every=0.005, progress=False)


def residual_norms(model, loads, run) -> np.ndarray:
    coordinates, velocities = model.body.project(run.displacements), model.body.project(run.velocities)
    states, prepared = zip(coordinates, velocities, run.times.tolist(), strict=True), model.prepare(loads)
    return np.array([residual_norm(model.data, constraint_forces(model.body, pt.State(*each), prepared))
                     for each in states])  # fmt: skip


def test_the_residual_norm_of_a_taut_sheet_ranks_the_errors_of_a_run(taut):
    """The tension of the sheet at rest does work on the residual fields at every point, which sums to nothing."""
    training = [blown_run(taut, blown(*force)) for force in ((0.01, 0, 0.1), (0, 0.02, 0.05), (0, 0, -0.1))]
    few, every = (pt.hyper_reduce(taut, training, modes=4, cubature=share) for share in (1.5e-3, 0.0))
    loads = blown(0.015, 0.01, 0.08)
    full, run = blown_run(taut, loads), blown_run(few, loads)
    norms, expected = (residual_norms(model, loads, run) for model in (few, every))
    assert few.data.residual_fields > 0
    assert len(few.data.cubature.nodes) < 0.1 * len(every.data.cubature.nodes)
    assert np.linalg.norm(norms - expected) < 0.25 * np.linalg.norm(expected)
    missed = np.sqrt(np.sum((run.displacements - full.displacements) ** 2, axis=2) @ taut.volumes / taut.volumes.sum())
    assert spearmanr(norms, missed)[0] > 0.9
    assert 0.2 * missed.max() < norms.max() < 5.0 * missed.max()
