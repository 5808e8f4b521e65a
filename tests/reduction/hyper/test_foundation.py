"""Reduced bodies on springs: compared with the full model, in both steps, in real time, and their energy."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.hyper.reactions import accelerations

pytestmark = pytest.mark.slow

EVERY, DURATION = 0.0005, 0.02
TISSUE = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.49)
SPRINGS = pt.Foundation("z-", 2e7, 1e3)  # halve what the beam bends by


@pytest.fixture(scope="module")
def beam():
    return pt.Solid(pt.box((0.04, 0.015, 0.015), 0.005), TISSUE, "x-", form="energy", stiffness_damping=2e-5)


def pull(x, y, z):
    return pt.SurfaceForce("x+", force=lambda t: np.sin(300.0 * t) ** 2 * np.array([x, y, z]))


def rollout(model, loads, **options):
    return pt.rollout(model, loads, duration=DURATION, every=EVERY, progress=False, **options)


@pytest.fixture(scope="module")
def rom(beam):
    runs = [rollout(beam, [pull(*way), SPRINGS]) for way in ((8.0, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, -0.8))]
    return pt.hyper_reduce(beam, runs, modes=16)


LOADS = [pull(3.0, 0.2, -0.6), SPRINGS]


def test_a_reduced_beam_on_springs_agrees_with_the_full_one(beam, rom):
    full, own, bare = rollout(beam, LOADS), rollout(rom, LOADS), rollout(rom, LOADS[:1])
    assert pt.relative_errors(full, own).displacement < 0.05
    assert pt.relative_errors(full, own).reaction < 0.02
    assert pt.relative_errors(full, bare).displacement > 0.3


def test_projected_springs_are_those_at_the_nodes(beam, rom):
    rng, columns = np.random.default_rng(0), rom.data.trial_and_test_basis
    prepared, other = rom.prepare(LOADS), beam.prepare(LOADS)
    a, v = (1e-3 * rng.standard_normal(rom.count) / rom.body.sizes for _ in range(2))
    state = pt.State(a, v, 0.003)
    same = pt.State(rom.displacement(state, prepared), rom.velocity(state, prepared), 0.003)
    nodal = beam.external_force(same, other)
    forces = accelerations(rom.body, state, prepared)[1] - rom.body.all_forces(a + rom.stiffness_damping * v)
    expected = np.tensordot(columns, nodal, 2)
    np.testing.assert_allclose(forces, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("step", [None, 1e-4])
def test_springs_return_stored_energy_and_dashpots_dissipate(rom, step):
    model = rom.with_step(step)
    speed = np.zeros((len(rom.cloud), 3))
    speed[:, 2] = 2.0 * rom.cloud.points[:, 0]
    springs = pt.Foundation("z-", 2e7)
    run = rollout(model, [springs], velocity=speed)
    assert np.abs(run.balance).max() < 3e-3 * run.kinetic[0]
    down = run.displacements[:, rom.cloud.group("z-")]
    stored = 0.5 * 2e7 * np.einsum("n,fnc->f", np.linalg.norm(rom.cloud.area_vectors("z-"), axis=1), down**2)
    np.testing.assert_allclose(-run.external, stored, atol=2e-3 * run.kinetic[0])
    assert stored.max() > 0.1 * run.kinetic[0]
    slowed = rollout(model, [SPRINGS], velocity=speed)
    assert np.abs(slowed.balance).max() < 3e-3 * slowed.kinetic[0]
    assert (slowed.kinetic + slowed.strain)[-1] < (run.kinetic + run.strain)[-1]


def test_explicit_and_implicit_steps_agree_on_springs(rom):
    explicit, implicit = rollout(rom, LOADS), rollout(rom.with_step(2e-5), LOADS)
    assert pt.relative_errors(explicit, implicit).displacement < 5e-3


@pytest.mark.parametrize("load", [pt.Foundation("z-", 1e11), pt.Foundation("z-", 1e6, 1e7)])
def test_the_step_is_short_enough_for_stiff_springs(rom, load):
    prepared, free = rom.prepare([load]), rom.prepare(())
    assert rom.stable_step(rom.state(prepared), prepared)[0] < 0.3 * rom.stable_step(rom.state(free), free)[0]
    speed = np.tile([0.0, 0.0, 0.05], (len(rom.cloud), 1))
    run = pt.rollout(rom, [load], duration=5e-3, every=1e-3, velocity=speed, progress=False)
    energy = run.kinetic + run.strain - run.external  # the springs' own is minus the loads' work
    assert energy.max() < 1.02 * run.kinetic[0]


def test_an_unsupported_block_on_springs_oscillates_as_a_mass():
    cloud = pt.box((0.015, 0.015, 0.015), 0.005)
    loose = pt.Solid(cloud, TISSUE, form="energy")
    stiffness, speed = 2e4, np.tile([0.01, 0.0, 0.05], (len(cloud), 1))
    springs = pt.Foundation("z-", stiffness)
    run = pt.rollout(loose, [springs], duration=0.05, every=2e-3, velocity=speed, progress=False)
    own = pt.hyper_reduce(loose, run, modes=2)
    again = pt.rollout(own, [springs], duration=0.12, every=2e-3, velocity=speed, progress=False)
    omega = np.sqrt(stiffness * 0.015**2 / loose.masses.sum())
    mean = np.einsum("n,fnc->fc", loose.masses, again.displacements) / loose.masses.sum()
    expected = np.sin(omega * again.times)[:, None] * [0.01, 0.0, 0.05] / omega
    np.testing.assert_allclose(mean, expected, atol=0.03 * 0.05 / omega)


# held by a tool


@pytest.fixture(scope="module")
def grasped(beam):
    def motion(_, t):
        share = np.sin(250 * t) ** 2
        return (1e-3 * share, 2e-3 * share, -1e-3 * share)

    loads = [pt.PrescribedMotion("x+", motion), SPRINGS]
    run = rollout(beam, loads)
    return loads, run, pt.hyper_reduce(beam, run, modes=12, prescribed="x+")


@pytest.mark.parametrize("step", [None, 1e-4])
def test_the_force_of_a_tool_includes_the_springs(grasped, step):
    loads, full, rom = grasped
    own, bare = (rollout(rom.with_step(step), some, step=None if step else 5e-5) for some in (loads, loads[:1]))
    peak = np.abs(full.reactions["x+"]).max()
    assert np.abs(own.reactions["x+"] - full.reactions["x+"]).max() < 0.05 * peak
    assert np.abs(bare.reactions["x+"] - full.reactions["x+"]).max() > 0.2 * peak
    assert np.abs(own.balance).max() < 0.02 * np.abs(own.external).max()


@pytest.mark.parametrize("step", [None, 2e-4])
def test_the_force_of_a_tool_in_real_time_includes_the_springs(grasped, step):
    rom = grasped[2].with_step(step)
    ready = pt.realtime_model(rom, foundations=[SPRINGS])
    q, v, report = np.zeros(len(ready.rest)), np.zeros(len(ready.rest)), np.zeros(8 + len(ready.tool))
    target = ready.tool[:, :3] @ [1e-3, 5e-4, 0.0]
    for k in range(300):
        ready.advance(ready.data, q, v, min(1.0, k / 20) * target, 1e-3, report)
    assert report[0] == 0
    held = [pt.PrescribedMotion("x+", (1e-3, 5e-4, 0.0)), SPRINGS]
    still = pt.rollout(rom.with_step(1e-3), held, duration=0.3, every=0.3, progress=False)
    expected = still.reactions["x+"][-1]
    felt = ready.tool[:, :3].T @ report[8:]
    np.testing.assert_allclose(felt, expected, atol=0.01 * np.abs(expected).max())
    out = np.zeros((rom.data.lifting_count, rom.data.lifting_count))
    ready.stiffness(ready.data, q, out)
    around = ready.tool[:, :3].T @ out @ ready.tool[:, :3]
    nearby = [pt.PrescribedMotion("x+", (1.01e-3, 5e-4, 0.0)), SPRINGS]
    moved = pt.rollout(rom.with_step(1e-3), nearby, duration=0.3, every=0.3, progress=False).reactions["x+"][-1]
    np.testing.assert_allclose(around[:, 0], (moved - expected) / 1e-5, atol=0.03 * np.abs(around[0, 0]))
    prepared = rom.prepare(held)
    assert report[1] == pytest.approx(rom.trust(pt.State(q, v, 0.3), prepared), rel=1e-3)


def test_other_loads_are_refused_in_real_time(grasped):
    with pytest.raises(pt.InputError, match="must be Foundation objects, got Gravity"):
        pt.realtime_model(grasped[2], foundations=[pt.Gravity((0.0, 0.0, -9.81))])
