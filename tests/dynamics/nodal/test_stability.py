"""Steps and stiffness damping against the dense spectrum of small bodies."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.nodal.stability import (
    STEP_SAFETY,
    _damping_by_steps,
    needed_stiffness_damping,
    spectrum,
    stable_step,
    stiffness,
)
from palpate.dynamics.run.model import State


@pytest.fixture(scope="module")
def model(bar, tissue):
    return pt.Solid(bar, tissue, form="strong", fixed="x-")


@pytest.fixture(scope="module")
def eigenvalues(model):
    return spectrum(model)


def test_the_stiffness_is_the_derivative_of_the_force(model):
    K = stiffness(model)
    free = np.repeat(~model.fixed_mask, 3)
    u = np.where(free, np.random.default_rng(0).normal(size=free.shape), 0.0).reshape(-1, 3)
    rate = -model.force(1e-9 * u).reshape(-1)[free] / (1e-9 * model.material.density)
    np.testing.assert_allclose(K @ u.reshape(-1)[free], rate, atol=1e-5 * np.abs(rate).max())


def test_a_free_body_has_six_modes_of_no_stiffness(free):
    values = np.sort(np.abs(spectrum(free)))
    assert values[5] < 1e-6 * values[-1]
    assert values[6] > 1e-4 * values[-1]


def test_power_iterations_find_the_highest_frequency(model, eigenvalues):
    highest = np.sqrt(np.abs(eigenvalues).max())
    found, _ = model.highest_frequency(np.zeros_like(model.cloud.points), model.fixed_mask)
    assert found == pytest.approx(highest, rel=0.05)
    assert model.stability.highest_frequency == pytest.approx(highest, rel=0.05)


def test_power_iterations_follow_the_body_as_it_stretches(model):
    u, vector = np.zeros_like(model.cloud.points), None
    for stretch in np.linspace(1, 2, 6):
        u[:, 0] = (stretch - 1) * model.cloud.points[:, 0]
        found, vector = model.highest_frequency(u, model.fixed_mask, start=vector)
    assert found == pytest.approx(np.sqrt(np.abs(spectrum(model, u)).max()), rel=0.1)


def test_the_damping_found_by_stepping_agrees_with_the_spectrum(bar, tissue, eigenvalues):
    model = pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=0.0)
    found, growth = _damping_by_steps(model, model.neighbours, model.stability.highest_frequency)
    needed = needed_stiffness_damping(eigenvalues)
    assert needed / 2 < found < 2 * needed
    assert growth < 200


def test_the_needed_damping_stops_the_fastest_growth():
    # x'' + w^2 (x + beta x') = 0 with a complex w^2: growth stops where beta = 2 |Im w| / |w|^2
    square = np.array([1e8 * (1 + 0.01j)])
    beta = needed_stiffness_damping(square)
    for factor, grows in ((0.99, True), (1.01, False)):
        roots = np.roots([1, factor * beta * square[0], square[0]])
        assert (roots.real.max() > 0) == grows


def test_the_report_has_method_eigenvalue_and_damping(model, eigenvalues):
    report = model.stability
    assert report.method == "dense spectrum"
    assert report.worst_real_part == pytest.approx(eigenvalues.real.min(), rel=1e-3)
    assert report.worst_real_part > 0
    assert report.needed == pytest.approx(needed_stiffness_damping(eigenvalues), rel=1e-3)
    assert report.used == model.stiffness_damping >= report.needed
    assert report.step == pytest.approx(stable_step(report.highest_frequency, report.used))
    for word in ("worst real part", "damping needed", "damping used", "stable step", "dense spectrum"):
        assert word in str(report)


def test_the_given_damping_is_used(bar, tissue):
    model = pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=1.25e-4)
    assert model.stiffness_damping == model.stability.used == 1.25e-4
    assert "not computed" in str(model.stability)


@pytest.mark.parametrize("stiffness_damping", [0.0, 1e-4])
def test_the_step_is_the_stability_limit_of_one_oscillator(stiffness_damping):
    w = 1e4
    limit = stable_step(w, stiffness_damping) / STEP_SAFETY
    for factor, bounded in ((0.99, True), (1.01, False)):
        h = factor * limit
        # v += -h w^2 (u + beta v); u += h v
        step = np.array(
            [
                [1 - h * h * w * w, h - h * h * w * w * stiffness_damping],
                [-h * w * w, 1 - h * w * w * stiffness_damping],
            ]
        )
        assert (np.abs(np.linalg.eigvals(step)).max() < 1 + 1e-9) == bounded


@pytest.mark.parametrize("viscous", [False, True], ids=["needed", "more"])
def test_the_stable_step_is_stable_and_a_third_more_is_not(bar, tissue, calm, viscous):
    model = pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=5 * calm if viscous else calm)
    prepared = model.prepare(())
    noise = 1e-9 * np.random.default_rng(0).normal(size=bar.points.shape)
    start = model.state(prepared, noise)
    step = model.stable_step(start, prepared)[0]
    size = {}
    for factor in (1.0, 1.3 / STEP_SAFETY):
        with np.errstate(all="ignore"):
            state = model.advance(start, prepared, factor * step, 400)[0]
        size[factor] = np.linalg.norm(state.coordinates) / np.linalg.norm(noise)
    assert size[1.0] < 1
    assert not size[1.3 / STEP_SAFETY] < 1e6


def test_the_stable_step_shrinks_as_the_body_stretches(model):
    prepared = model.prepare(())
    u = np.zeros_like(model.cloud.points)
    steps = []
    for stretch in (1.0, 1.5, 2.0, 3.0):
        u[:, 0] = (stretch - 1) * model.cloud.points[:, 0]
        steps.append(model.stable_step(model.state(prepared, u), prepared)[0])
    assert np.all(np.diff(steps) < 0)


@pytest.mark.slow
def test_a_body_that_no_damping_stabilises_is_refused_with_the_node():
    cloud = pt.box((0.02,) * 3, spacing=0.005, jitter=0.2)
    tissue = pt.materials.MooneyRivlin(C1=40e3, C2=0, density=1000, poisson=0.499)
    with pytest.raises(pt.CloudError, match=r"unstable at rest.*node \d+.*more neighbours \(now 27\)"):
        pt.Solid(cloud, tissue, form="strong", fixed="x-", neighbours=27)


@pytest.mark.slow
def test_stability_of_large_clouds_is_computed_by_the_step_map(tissue):
    cloud = pt.box((0.04, 0.02, 0.02), spacing=0.0025)
    model = pt.Solid(cloud, tissue, form="strong", fixed="x-")
    report = model.stability
    assert report.method == "step map"
    assert report.growth is not None
    assert "growth left" in str(report)
    prepared = model.prepare(())
    tiny = 1e-9 * np.random.default_rng(5).normal(size=cloud.points.shape)
    state = model.state(prepared, tiny)
    later = model.advance(State(state.coordinates, state.velocities), prepared, report.step, 1000)[0]
    assert np.linalg.norm(later.coordinates) < np.linalg.norm(tiny)
