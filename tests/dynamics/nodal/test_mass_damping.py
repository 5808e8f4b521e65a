"""Mass-proportional damping of full bodies: decay, energy balance, reactions, and the unchanged stable step."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.nodal.period_data import GIVEN

pytestmark = pytest.mark.slow

TISSUE = {"C1": 2e3, "C2": 0.0, "density": 1000.0, "poisson": 0.45}
ALPHA = 4.0  # [1/s], far below the slowest vibration of 14 rad/s


def bar(mass_damping: float, form: str = "energy", **more) -> pt.Solid:
    cloud = pt.box((0.06, 0.015, 0.015), 0.005)
    return pt.Solid(cloud, pt.materials.MooneyRivlin(**TISSUE), "x-", form=form, mass_damping=mass_damping, **more)


@pytest.fixture(scope="module")
def shape() -> np.ndarray:
    """Return a small displacement in the slowest vibration mode."""
    return 1e-4 * pt.vibration_modes(bar(0.0), 1)[0][0]


def free_run(model, shape, **options):
    return pt.rollout(model, displacement=shape, duration=1.0, every=0.005, progress=False, **options)


def test_a_free_vibration_decays_with_half_of_alpha(shape):
    damped, free = (free_run(bar(alpha, stiffness_damping=0.0), shape) for alpha in (ALPHA, 0.0))
    energy = damped.kinetic + damped.strain
    rate = -np.polyfit(damped.times, np.log(energy), 1)[0]
    assert rate == pytest.approx(ALPHA, rel=0.05)
    total = free.kinetic + free.strain
    np.testing.assert_allclose(total, total[0], rtol=5e-3)


def test_the_energy_balance_counts_what_is_dissipated(shape):
    run = free_run(bar(ALPHA), shape)
    assert run.dissipated[-1] > 0.9 * run.strain[0]
    assert np.abs(run.balance).max() < 2e-3 * run.strain[0]


def test_the_stable_step_does_not_change():
    assert bar(ALPHA).stability.step == bar(0.0).stability.step


def test_bits_without_damping_are_those_of_before(shape):
    runs = [free_run(bar(0.0), shape, step=2e-4) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].displacements, runs[1].displacements)


def test_reactions_include_the_damping_forces():
    """The forces of support and tool are the change of momentum and alpha times the momentum."""
    body, strong = bar(50.0), 50.0
    shaken = [pt.PrescribedMotion("x+", lambda X, t: (1e-4 * np.sin(60 * t) ** 2, 0.0, 0.0))]
    run = pt.rollout(body, shaken, duration=0.05, every=0.0005, progress=False)
    momentum = np.einsum("n,tnc->tc", body.masses, run.velocities)[:, 0]
    force = sum(run.reactions.values())[:, 0]
    rate = np.gradient(momentum, run.times)
    missed = force - rate - strong * momentum
    assert np.abs(missed[2:-2]).max() < 0.1 * np.abs(strong * momentum).max()


def test_a_static_load_is_borne_without_change():
    load = [pt.SurfaceForce("x+", force=(0.01, 0.0, 0.0))]
    settled = pt.rollout(bar(ALPHA), load, duration=4.0, every=0.5, progress=False)
    still = pt.equilibrium(bar(0.0), load)
    scale = np.abs(still.displacements).max()
    np.testing.assert_allclose(settled.displacements[-1], still.displacements, atol=2e-3 * scale)


def test_the_engine_damps_as_a_run_does(shape):
    body = bar(ALPHA)
    away = tuple(body.cloud.points.max(axis=0) + 0.1)
    made = pt.realtime_model(body, contact=pt.tools.Contact(pt.tools.Sphere(0.01), away))
    q, v, report = shape.reshape(-1).copy(), np.zeros(shape.size), np.zeros(20)
    start = made.data.energies[GIVEN] = body.strain_energy(shape)
    times, energies = 1e-3 * np.arange(1, 1001), []
    for _ in times:
        made.advance(made.data, q, v, np.zeros(12), 1e-3, report)
        energies.append(body.strain_energy(q.reshape(-1, 3)) + report[3])
    # velocities are those of half a step before, so the sum oscillates: compare means over the last tenth
    assert np.mean(energies[900:]) == pytest.approx(start * np.exp(-ALPHA * times[900:]).mean(), rel=0.1)


@pytest.mark.quick
def test_a_negative_damping_is_refused():
    with pytest.raises(pt.InputError, match="mass_damping must be"):
        bar(-1.0)


def test_stiffness_damping_that_shortens_the_step_tenfold_is_warned_of_once():
    highest = bar(0.0).stability.highest_frequency
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bar(0.0, stiffness_damping=8.0 / highest)
    with pytest.warns(RuntimeWarning, match=r"stable step 1\d times shorter.*mass_damping=") as caught:
        bar(0.0, stiffness_damping=12.0 / highest)
    assert len(caught) == 1
    assert caught[0].filename == __file__


def test_the_loss_to_mass_damping_of_moved_nodes_is_counted():
    """A tool that shakes one end does work on the mass of its nodes, too."""
    shaken = [pt.PrescribedMotion("x+", lambda X, t: (1e-4 * np.sin(60 * t) ** 2, 0.0, 0.0))]
    run = pt.rollout(bar(50.0, stiffness_damping=0.0), shaken, duration=0.3, every=0.005, progress=False)
    assert np.abs(run.balance).max() < 0.02 * run.dissipated[-1]
