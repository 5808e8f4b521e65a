"""Runs of the full model: motion, forces and energies."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt


def mean(model, field):
    """Mass average of nodal fields."""
    return model.masses @ field / model.masses.sum()


def test_a_body_without_loads_stays_at_rest(held):
    run = pt.rollout(held, duration=0.005, every=0.005)
    assert not run.displacements.any()
    assert not run.velocities.any()


def test_a_free_body_falls(free):
    run = pt.rollout(free, [pt.Gravity((0.0, 1.0, -9.81))], duration=0.02, every=0.005)
    fall = 0.5 * run.times[:, None] ** 2 * (0.0, 1.0, -9.81)
    np.testing.assert_allclose(run.displacements, np.broadcast_to(fall[:, None], run.displacements.shape), atol=1e-12)
    np.testing.assert_allclose(run.strain, 0, atol=1e-12)
    np.testing.assert_allclose(run.external, run.kinetic, rtol=1e-9)


def test_gravity_may_change_with_time(free):
    run = pt.rollout(free, [pt.Gravity(lambda t: (12 * t, 0, 0))], duration=0.02, every=0.005)
    np.testing.assert_allclose(run.displacements[:, 0, 0], 2 * run.times**3, rtol=1e-2)


def test_a_free_body_moves_on_with_its_velocity(free):
    velocity = np.broadcast_to((0.1, -0.2, 0.3), (len(free.cloud), 3))
    run = pt.rollout(free, velocity=velocity, duration=0.02, every=0.01)
    np.testing.assert_allclose(run.displacements, run.times[:, None, None] * velocity, atol=1e-12)


def test_the_centre_of_mass_follows_the_force(free):
    force = np.array([0.5, 0.1, -0.2])
    run = pt.rollout(free, [pt.Traction("x+", force=force)], duration=0.02, every=0.02)
    centre = mean(free, run.displacements[-1])
    assert np.linalg.norm(run.displacements[-1] - centre, axis=1).max() > 1e-3  # it deforms and turns
    np.testing.assert_allclose(centre, 0.5 * 0.02**2 * force / free.masses.sum(), rtol=3e-3)


def test_equal_and_opposite_forces_leave_the_centre_of_mass(free):
    loads = [pt.Traction("x+", force=(0.5, 0.0, 0.0)), pt.Traction("x-", force=(-0.5, 0.0, 0.0))]
    run = pt.rollout(free, loads, duration=0.01, every=0.01)
    assert np.abs(run.displacements[-1]).max() > 1e-4
    np.testing.assert_allclose(mean(free, run.displacements[-1]), 0, atol=1e-13)


def test_a_run_turns_with_the_frame(free, rotation):
    random = np.random.default_rng(0)
    X = free.cloud.points
    velocity = 0.3 * np.sin(200 * X @ random.normal(size=(3, 3)))
    force, gravity = np.array([0.5, 0.2, -0.1]), np.array([0.0, 3.0, -9.0])
    runs = []
    for R in (np.eye(3), rotation):
        loads = [
            pt.Traction("x+", force=R @ force),
            pt.Traction("z-", pressure=lambda t: 500 * np.sin(500 * t)),
            pt.Gravity(R @ gravity),
        ]
        runs.append(
            pt.rollout(free, loads, duration=0.01, every=0.002, step=2e-5, displacement=X @ (R - np.eye(3)).T, velocity=velocity @ R.T)
        )
    turned = (X + runs[0].displacements) @ rotation.T - X
    assert np.abs(runs[0].displacements).max() > 1e-3
    np.testing.assert_allclose(runs[1].displacements, turned, atol=1e-9 * np.abs(runs[0].displacements).max())
    np.testing.assert_allclose(runs[1].velocities, runs[0].velocities @ rotation.T, atol=1e-8)
    np.testing.assert_allclose(runs[1].strain, runs[0].strain, rtol=1e-8, atol=1e-14)


def test_a_symmetric_pull_stays_symmetric(held):
    run = pt.rollout(held, [pt.Traction("x+", force=(2.0, 0.0, 0.0))], duration=0.02, every=0.02)
    u = run.displacements[-1].reshape(9, 5, 5, 3)
    bound = 1e-10 * np.abs(u).max()
    np.testing.assert_allclose(u[:, ::-1] * (1, -1, 1), u, atol=bound)
    np.testing.assert_allclose(u[:, :, ::-1] * (1, 1, -1), u, atol=bound)
    np.testing.assert_allclose(u.transpose(0, 2, 1, 3)[..., [0, 2, 1]], u, atol=bound)


def test_a_bar_without_contraction_rings_at_its_axial_frequency():
    cloud = pt.box((0.06, 0.015, 0.015), spacing=0.005)
    material = pt.NeoHookean(C1=20e3, density=1000, poisson=0.0)
    model = pt.FullModel(cloud, material, fixed="x-")
    frequency = np.pi / 2 / 0.06 * np.sqrt(2 * material.shear_modulus / 1000)
    shape = np.zeros((len(cloud), 3))
    shape[:, 0] = np.sin(np.pi / 2 * cloud.points[:, 0] / 0.06)
    period = 2 * np.pi / frequency
    run = pt.rollout(model, velocity=1e-6 * shape, duration=2 * period, every=period / 40)
    amplitude = run.displacements[:, :, 0] @ shape[:, 0] / np.sum(shape[:, 0] ** 2)
    decay = np.exp(-model.viscosity * frequency**2 / 2 * run.times)
    expected = 1e-6 / frequency * decay * np.sin(frequency * run.times)
    np.testing.assert_allclose(amplitude, expected, atol=0.04 * 1e-6 / frequency)


def test_initial_states_are_kept_where_the_body_is_free(held):
    random = np.random.default_rng(0)
    u, v = 1e-5 * random.normal(size=(2, len(held.cloud), 3))
    run = pt.rollout(held, displacement=u, velocity=v, duration=1e-4, every=1e-4)
    free = np.setdiff1d(np.arange(len(held.cloud)), held.cloud.group("x-"))
    np.testing.assert_array_equal(run.displacements[0, free], u[free])
    np.testing.assert_array_equal(run.velocities[0, free], v[free])
    np.testing.assert_array_equal(run.displacements[:, held.cloud.group("x-")], 0)


def test_a_free_vibration_only_loses_energy(held):
    u = np.zeros((len(held.cloud), 3))
    u[:, 2] = 5 * held.cloud.points[:, 0] ** 2
    run = pt.rollout(held, displacement=u, duration=0.03, every=0.001)
    total = run.kinetic + run.strain
    assert np.diff(total).max() < 2e-3 * total[0]
    assert total[-1] < total[0]
    assert run.kinetic.max() > 0.3 * total[0]


def test_energy_balances(run):
    assert np.abs(run.balance).max() < 0.05 * run.external.max()
    assert np.all(np.diff(run.dissipated) >= 0)


def test_momentum_balances_the_forces(held, run, pull):
    momentum = run.velocities.transpose(0, 2, 1) @ held.masses
    rate = (momentum[2:] - momentum[:-2]) / (run.times[2:] - run.times[:-2])[:, None]
    force = run.reactions["x-"][1:-1] + np.array([pull.force(t) for t in run.times[1:-1]])
    assert np.abs(rate - force).max() < 0.1 * np.abs(run.reactions["x-"]).max()


def test_velocities_are_the_rates_of_the_displacements(run):
    rate = (run.displacements[2:] - run.displacements[:-2]) / 0.001
    np.testing.assert_allclose(rate, run.velocities[1:-1], atol=0.05 * np.abs(run.velocities).max())


def test_a_support_carries_the_weight(bar, tissue):
    model = pt.FullModel(bar, tissue, fixed="z-", viscosity=1e-3)
    run = pt.rollout(model, [pt.Gravity()], duration=0.05, every=0.05)
    weight = 9.81 * model.masses.sum()
    np.testing.assert_allclose(run.reactions["z-"][-1], (0, 0, weight), atol=1e-3 * weight)


class TestATool:
    """A tool that pulls the end of the bar."""

    @pytest.fixture(scope="class")
    def motion(self):
        return pt.PrescribedMotion("x+", lambda points, t: 1e-3 * np.array([np.sin(60 * t) ** 2, 0.2 * t, 0]))

    @pytest.fixture(scope="class")
    def driven(self, held, motion):
        return pt.rollout(held, [motion], duration=0.02, every=0.001)

    def test_holds_its_nodes_exactly(self, held, driven, motion):
        nodes = held.cloud.group("x+")
        for time, u in zip(driven.times, driven.displacements, strict=True):
            wanted = np.broadcast_to(motion.displacement(None, time), (len(nodes), 3))
            np.testing.assert_allclose(u[nodes], wanted, atol=1e-15)

    def test_gives_its_nodes_its_velocity(self, held, driven):
        found = driven.velocities[:, held.cloud.group("x+")[3], 0]
        # velocities of driven nodes are those of the step just taken
        np.testing.assert_allclose(found[1:], 0.06 * np.sin(120 * driven.times[1:]), atol=0.02 * 0.06)

    def test_is_balanced_with_the_support_by_the_momentum(self, held, driven):
        momentum = driven.velocities.transpose(0, 2, 1) @ held.masses
        rate = (momentum[2:] - momentum[:-2]) / 0.002
        force = (driven.reactions["x-"] + driven.reactions["x+"])[1:-1]
        assert np.abs(rate - force).max() < 0.1 * np.abs(driven.reactions["x+"]).max()

    def test_work_goes_into_the_body(self, driven):
        assert driven.external.max() > 0
        assert np.abs(driven.balance).max() < 0.1 * driven.external.max()

    def test_pulls_as_hard_as_the_support_when_nothing_moves(self, bar):
        material = pt.NeoHookean(C1=20e3, density=1000, poisson=0.0)
        model = pt.FullModel(bar, material, fixed="x-", viscosity=1e-3)
        stretch = pt.PrescribedMotion("x+", lambda points, t: (0.003 * min(1, t / 0.02), 0, 0))
        run = pt.rollout(model, [stretch], duration=0.06, every=0.06)
        tool, support = (run.reactions[name][-1] for name in ("x+", "x-"))
        closed_form = material.stress(np.diag([1.1, 1, 1]))[0, 0] * 0.015**2
        np.testing.assert_allclose(tool, -support, atol=1e-4 * closed_form)
        np.testing.assert_allclose(tool, (closed_form, 0, 0), atol=2e-3 * closed_form)

    def test_on_a_patch_starts_where_it_is_told(self, held):
        motion = pt.PrescribedMotion("tip", lambda points, t: 1e-4 + 0 * points)
        run = pt.rollout(held, [motion], duration=1e-3, every=1e-3)
        np.testing.assert_array_equal(run.displacements[:, held.cloud.group("tip")], 1e-4)

    def test_may_be_given_as_constant(self, held):
        run = pt.rollout(held, [pt.PrescribedMotion("tip", (0, 0, 1e-4))], duration=1e-3, every=1e-3)
        np.testing.assert_array_equal(run.displacements[-1, held.cloud.group("tip")], np.tile((0, 0, 1e-4), (9, 1)))


@pytest.mark.parametrize("jitter", [0.0, 0.2], ids=["lattice", "jitter"])
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45, 0.49, 0.499])
def test_a_poked_body_calms_down(poisson, jitter):
    cloud = pt.box((0.02, 0.015, 0.015), spacing=0.005, jitter=jitter)
    model = pt.FullModel(cloud, pt.MooneyRivlin(C1=20e3, C2=2e3, density=1000, poisson=poisson), fixed="z-")
    poke = pt.Traction("z+", force=lambda t: (0.5, 0, -1.0) if t < 0.005 else (0, 0, 0))
    run = pt.rollout(model, [poke], duration=0.03, every=0.001)
    total = run.kinetic + run.strain
    assert np.abs(run.displacements).max() > 3e-4
    assert total[-1] < 0.9 * total[6]
    assert np.diff(total[6:]).max() < 0.01 * total[6]


def test_a_run_repeats_bit_by_bit(held, run, pull):
    again = pt.rollout(held, [pull], duration=0.03, every=0.0005)
    np.testing.assert_array_equal(again.steps, run.steps)
    for name in ("displacements", "velocities", "kinetic", "strain", "external", "dissipated"):
        np.testing.assert_array_equal(getattr(again, name), getattr(run, name))
    np.testing.assert_array_equal(again.reactions["x-"], run.reactions["x-"])
