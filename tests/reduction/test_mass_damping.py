"""Mass damping of reduced models: closed forms, ring-downs of full models, energies, engines and files."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import palpate as pt
from palpate.core.sealed import open_sealed
from palpate.dynamics.run.period_report import FORCES, KINETIC, STATUS

pytestmark = pytest.mark.slow

ALPHA, BETA = 12.0, 6e-4  # [1/s], [s]
SPEED = 0.02  # [m/s] of a tool
PERIOD = 1e-3


@cache
def body(alpha: float = ALPHA, beta: float = BETA) -> pt.Solid:
    cloud = pt.box((0.06, 0.015, 0.015), 0.005)
    law = pt.materials.MooneyRivlin(C1=60e3, C2=0.0, density=1000.0, poisson=0.45)
    return pt.Solid(cloud, law, "x-", mass_damping=alpha, stiffness_damping=beta)


@cache
def slowest() -> tuple[np.ndarray, float]:
    """Return a small displacement in the slowest vibration mode [m], and its circular frequency [rad/s]."""
    modes, frequencies = pt.vibration_modes(body(), 1)
    return 1e-5 * modes[0] / np.abs(modes[0]).max(), float(frequencies[0])


def ring_down(model, **options):
    return pt.rollout(model, displacement=slowest()[0], duration=0.25, every=0.002, progress=False, **options)


@cache
def full_run() -> pt.Trajectory:
    return ring_down(body())


@cache
def reduced(kind: str):
    """Return a model of a kind whose coordinates include the mode."""
    if kind == "linear":
        return pt.lti.reduce_linear(pt.lti.linearise(body(), outputs=["x+"], loads=[pull()]), "modal", 4)
    if kind == "Galerkin":
        return pt.galerkin(body(), full_run(), modes=1)
    model = pt.hyper_reduce(body(), full_run(), modes=1)
    return model.with_step(1e-3) if kind == "implicit" else model


@cache
def reduced_run(kind: str) -> pt.Trajectory:
    return ring_down(reduced(kind))


def pull() -> pt.SurfaceForce:
    return pt.SurfaceForce("x+", force=(0.0, 0.0, 0.0))


KINDS = ["explicit", "implicit", "Galerkin", "linear"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_vibration_decays_as_its_damping_ratio_says(kind):
    """The energy decays as exp(-2 zeta omega t) with zeta = alpha / (2 omega) + beta omega / 2."""
    run, frequency = reduced_run(kind), slowest()[1]
    period = round(np.pi / frequency / 0.002)  # of the energy
    energy = np.convolve(np.log(run.kinetic + run.strain), np.ones(period) / period, "valid")
    rate = -np.polyfit(run.times[: len(energy)], energy, 1)[0]
    assert rate == pytest.approx(ALPHA + BETA * frequency**2, rel=0.03)
    assert BETA * frequency**2 > 0.1 * ALPHA


@pytest.mark.parametrize("kind", KINDS)
def test_the_lost_energy_is_that_of_the_vibration(kind):
    run = reduced_run(kind)
    assert run.dissipated[-1] > 0.9 * run.strain[0]
    assert np.abs(run.balance).max() < 5e-3 * run.strain[0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_reduced_ring_down_is_that_of_the_full_body(kind):
    found, expected = reduced_run(kind), full_run()
    size = np.abs(expected.displacements).max()
    np.testing.assert_allclose(found.displacements, expected.displacements, atol=0.03 * size)
    force, wanted = found.reactions["x-"], expected.reactions["x-"]
    np.testing.assert_allclose(force, wanted, atol=0.1 * np.abs(wanted).max())


def with_mass_damping(model: pt.ReducedModel, alpha: float) -> pt.ReducedModel:
    return pt.ReducedModel(replace(model.data, mass_damping=alpha), step=model.step)


def test_mass_damping_leaves_the_stable_step():
    model, steps = reduced("explicit"), []
    for alpha in (0.0, 200.0):
        damped = with_mass_damping(model, alpha)
        prepared = damped.prepare([])
        steps.append(damped.stable_step(damped.state(prepared), prepared)[0])
    assert steps[0] == steps[1]


def test_any_mass_damping_is_stable_at_the_stable_step():
    """Damping far above critical: a push does not grow."""
    model, shape = with_mass_damping(reduced("explicit"), 1e6), slowest()[0]
    prepared = model.prepare([])
    state = model.state(prepared, displacement=shape, velocity=100 * shape)
    step = model.stable_step(state, prepared)[0]
    after, _ = model.advance(state, prepared, step, 200)
    reach = np.abs(state.coordinates) + step * np.abs(state.velocities)
    assert np.abs(after.coordinates).max() <= 1.01 * reach.max()


def test_steps_are_accepted_with_the_energy_that_mass_damping_takes():
    model, shape = reduced("explicit"), slowest()[0]
    prepared = model.prepare([])
    state = model.state(prepared, displacement=shape, velocity=100 * shape)
    after, report = model.advance(state, prepared, 0.2 * model.stable_step(state, prepared)[0], 20)
    assert model.accept_step(state, after, report)
    made = replace(report, dissipated=1.5 * report.dissipated)
    assert not model.accept_step(state, after, made)


def test_a_poles_real_part_is_half_of_the_damping():
    poles, frequency = reduced("linear").poles, slowest()[1]
    slow = poles[np.argmin(np.abs(poles))]
    assert -slow.real == pytest.approx(0.5 * (ALPHA + BETA * frequency**2), rel=1e-6)
    assert abs(slow) == pytest.approx(frequency, rel=1e-6)


def test_the_damping_comes_back_from_a_file_and_files_without_it_open(tmp_path):
    for model in (reduced("explicit"), with_mass_damping(reduced("explicit"), 0.0)):
        pt.save(model, tmp_path / "model.rom")
        header = open_sealed(tmp_path / "model.rom", "palpate reduced model", 14).header
        assert ("mass_damping" in header) == (model.mass_damping > 0)
        again = pt.load(tmp_path / "model.rom")
        assert again.mass_damping == model.mass_damping
        np.testing.assert_array_equal(ring_down(again).displacements, ring_down(model).displacements)


# in the engine


def ramp(time: float) -> tuple[float, float, float]:
    return (0.0, 0.0, SPEED * time)


@pytest.fixture(scope="module")
def moved() -> pt.Solid:
    """A body whose damping is a large share of the force of a tool that moves it."""
    return body(400.0)


@pytest.fixture(scope="module")
def grasped(moved) -> pt.ReducedModel:
    motion = pt.PrescribedMotion("x+", lambda X, t: (0.0, 0.0, 1e-3 * np.sin(30 * t) ** 2))
    run = pt.rollout(moved, [motion], duration=0.1, every=0.002, progress=False)
    return pt.hyper_reduce(moved, run, modes=4, prescribed="x+")


def periods(made, steps: int, speed: float):
    """Return the mean force along z of every period while the tool moves evenly."""
    q, v, report, forces = made.rest.copy(), np.zeros(len(made.rest)), np.zeros(8 + len(made.tool)), []
    for k in range(steps):
        pose = np.zeros(12)
        pose[2] = speed * (k + 1) * PERIOD
        made.advance(made.data, q, v, made.tool @ pose, PERIOD, report)
        assert report[STATUS] == 0.0
        forces.append(made.tool[:, 2] @ report[FORCES:])
    return np.array(forces)


@pytest.mark.parametrize("step", [None, PERIOD], ids=["explicit", "implicit"])
def test_the_engines_force_is_that_of_a_run(grasped, step):
    model = grasped.with_step(step)
    found = periods(pt.realtime_model(model), 40, SPEED)
    run = pt.rollout(
        model, [pt.PrescribedMotion("x+", lambda X, t: ramp(t))], duration=0.04, every=PERIOD / 4, progress=False,
        step=None if step is None else PERIOD / 4,
    )  # fmt: skip
    force = run.reactions["x+"][:, 2]
    mean = np.array([np.trapezoid(force[4 * k : 4 * k + 5]) / 4 for k in range(40)])
    without = periods(pt.realtime_model(with_mass_damping(model, 0.0)), 40, SPEED)
    size = np.abs(mean[5:]).max()
    np.testing.assert_allclose(found[5:], mean[5:], atol=0.05 * size)
    assert np.abs(without[5:] - mean[5:]).max() > 0.2 * size  # damping counts


def test_a_linear_engines_force_is_that_of_a_run(moved):
    motion = pt.PrescribedMotion("x+", lambda X, t: ramp(t))
    model = pt.lti.reduce_linear(pt.lti.linearise(moved, [motion]), "moments", 12)
    found = periods(pt.realtime_model(model), 40, SPEED)
    run = pt.rollout(model, [motion], duration=0.04, every=PERIOD / 4, progress=False)
    force = run.reactions["x+"][:, 2]
    mean = np.array([np.trapezoid(force[4 * k : 4 * k + 5]) / 4 for k in range(40)])
    np.testing.assert_allclose(found[5:], mean[5:], atol=0.05 * np.abs(mean[5:]).max())


def test_a_vibration_dies_out_in_the_engine(grasped):
    made = pt.realtime_model(grasped)
    q, v, report, kinetic = made.rest.copy(), np.zeros(len(made.rest)), np.zeros(8 + len(made.tool)), []
    for k in range(60):
        pose = np.zeros(12)
        pose[2] = 1e-3 * min(k, 5) / 5
        made.advance(made.data, q, v, made.tool @ pose, PERIOD, report)
        kinetic.append(report[KINETIC])
    assert kinetic[-1] < 1e-3 * max(kinetic)
