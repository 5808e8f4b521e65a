"""Tissue that relaxes: closed forms of relaxation, creep and the loss modulus; energy is lost, never made."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt

pytestmark = pytest.mark.slow

SERIES = pt.materials.Prony(shares=(0.5, 0.3), times=(0.02, 0.3))
MU = 10e3


def tissue(prony=SERIES, poisson=0.4):
    return pt.materials.MooneyRivlin(C1=MU, C2=0.0, density=1000.0, poisson=poisson, prony=prony)


@pytest.fixture(scope="module")
def body():
    return pt.Solid(pt.box((0.02, 0.02, 0.02), 0.005), tissue(), form="energy", stiffness_damping=0.0)


def responses(body, courses, times):
    """First Piola-Kirchhoff stresses (t, 3, 3), stored and lost energies [J/m^3] of uniform deformations F(t)."""
    history, points = body.state(body.prepare([])).history, body.cloud.points
    stresses, stored, lost = [], [], []
    for before, time in zip([times[0], *times], times, strict=False):
        u = points @ (courses(time) - np.eye(3)).T
        history, dissipated = body.history_after(u, history, time - before) if time > before else (history, 0.0)
        stresses.append(body.stress(u, history).mean(axis=0))
        stored.append(body.strain_energy(u, history) / body.volumes.sum())
        lost.append((lost[-1] if lost else 0.0) + dissipated / body.volumes.sum())
    return np.array(stresses), np.array(stored), np.array(lost)


def shear(amount):
    return np.eye(3) + amount * np.outer([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])


def test_a_held_shear_relaxes_as_the_series_says(body):
    times = np.array([0.0, 1e-9, 0.005, 0.02, 0.1, 0.4, 3.0])
    amount = 1e-4
    stresses, _, _ = responses(body, lambda t: shear(amount if t > 0 else 0.0), times)
    np.testing.assert_allclose(stresses[1:, 0, 1], MU * amount * SERIES.relaxation(times[1:]), rtol=1e-6)


def test_a_large_held_stretch_relaxes_to_the_law_from_all_branches(body):
    times = np.array([0.0, 1e-9, 10.0])
    F = np.diag([1.5, 0.8, 0.9])
    stresses, _, _ = responses(body, lambda t: F if t > 0 else np.eye(3), times)
    law = tissue(None).stress(F)
    np.testing.assert_allclose(stresses[-1], law, rtol=1e-6, atol=1e-6 * MU)
    J = np.linalg.det(F)
    change = J ** (-2 / 3) * F.T @ F - np.eye(3)
    isochoric = change - np.trace(change @ F.T @ F) / 3 * np.linalg.inv(F.T @ F)
    expected = law + MU * sum(SERIES.shares) * J ** (-2 / 3) * F @ isochoric
    np.testing.assert_allclose(stresses[1], expected, rtol=1e-6, atol=1e-6 * MU)


@pytest.mark.parametrize("step", [1e-4, 0.05, 0.4])
def test_a_linear_change_is_integrated_exactly_at_any_step(body, step):
    """C̄ changes evenly; F = sqrt(C) of plane incompressible stretch."""
    rate, end = 0.5, 0.4

    def course(t):
        c = np.diag([1 + rate * t, 0.0, 1.0])
        c[1, 1] = 1 / c[0, 0]
        return np.sqrt(c)

    times = np.linspace(0, end, round(end / step) + 1)
    stresses, _, _ = responses(body, course, times)
    F = course(end)
    A = sum(
        s * MU * rate * t * -np.expm1(-end / t) for s, t in zip(SERIES.shares, SERIES.times, strict=True)
    )  # of the component 00; that of 11 does not change evenly, and is left out below
    law = tissue(None).stress(F)
    over = stresses[-1] - law
    # P F^-1 = J^(-2/3) (Q - (Q : C) / 3 C^-1); its 00 and 22 components give Q_00 alone where Q_22 = 0
    S = np.linalg.solve(F, over)
    inverse = np.linalg.inv(F.T @ F)
    Q = S - S[2, 2] * inverse / inverse[2, 2]
    assert Q[0, 0] == pytest.approx(A, rel=1e-6)


def test_an_oscillation_has_the_storage_and_loss_of_the_complex_modulus(body):
    amount = 1e-3
    for frequency in (5.0, 50.0, 300.0):
        period = 2 * np.pi / frequency
        settle = np.ceil(5 * max(SERIES.times) / period) * period
        times = np.concatenate([np.linspace(0, settle, 4000)[:-1], settle + np.linspace(0, period, 401)])
        stresses, _, lost = responses(body, lambda t, w=frequency: shear(amount * np.sin(w * t)), times)
        last = slice(-401, None)
        t, stress = times[last], stresses[last, 0, 1]
        found = 2 / period * np.trapezoid(stress * np.array([np.sin(frequency * t), np.cos(frequency * t)]), t)
        modulus = SERIES.complex_modulus(np.array(frequency))
        expected = MU * amount * np.array([modulus.real, modulus.imag])
        np.testing.assert_allclose(found, expected, rtol=2e-3)
        cycle = np.pi * MU * modulus.imag * amount**2
        assert lost[-1] - lost[last][0] == pytest.approx(cycle, rel=2e-3)


def test_work_is_stored_or_dissipated(body):
    random = np.random.default_rng(0)
    knots = np.array([np.eye(3), *(np.eye(3) + random.uniform(-0.25, 0.25, (12, 3, 3)))])
    times = np.linspace(0, 1.2, 6001)

    def course(t):
        place = min(t / 0.1, len(knots) - 1 - 1e-9)
        k = int(place)
        return knots[k] + (place - k) * (knots[k + 1] - knots[k])

    stresses, stored, lost = responses(body, course, times)
    F = np.array([course(t) for t in times])
    work = np.concatenate(
        [[0], np.cumsum(0.5 * np.sum((stresses[1:] + stresses[:-1]) * np.diff(F, axis=0), axis=(1, 2)))]
    )
    assert np.diff(lost).min() > 0
    np.testing.assert_allclose(work, stored + lost, atol=2e-3 * work.max())


def test_the_volume_relaxes_with_bulk_shares():
    prony = pt.materials.Prony(shares=0.5, times=0.02, bulk_shares=0.4)
    material = tissue(prony)
    body = pt.Solid(pt.box((0.02, 0.02, 0.02), 0.005), material, form="energy", stiffness_damping=0.0)
    times, amount = np.array([0.0, 1e-9, 0.02, 1.0]), 1e-4
    stresses, stored, lost = responses(body, lambda t: (1 + amount * (t > 0)) * np.eye(3), times)
    pressure = np.trace(stresses[1:], axis1=1, axis2=2) / 3
    expected = 3 * amount * material.bulk_modulus * (1 + 0.4 * np.exp(-times[1:] / 0.02))
    np.testing.assert_allclose(pressure, expected, rtol=1e-3)
    work = 0.5 * 9 * amount**2 * material.bulk_modulus * 0.4
    assert lost[-1] == pytest.approx(work, rel=1e-3)
    assert stored[1] - stored[-1] == pytest.approx(work, rel=1e-3)


def test_a_block_creeps_under_a_step_of_force_as_the_standard_solid():
    """One branch: strain = F/G (1 - s/(1 + s) exp(-t / ((1 + s) tau)))."""
    prony = pt.materials.Prony(shares=1.0, times=0.05)
    cloud = pt.box((0.06, 0.01, 0.01), 0.0025)
    bar = pt.Solid(cloud, tissue(prony, poisson=0.45), "x-", form="energy", stiffness_damping=2e-5)
    area, young = 1e-4, 2 * MU * 1.45
    force = 2e-3 * young * area
    run = pt.rollout(
        bar, [pt.SurfaceForce("x+", force=lambda t: (force, 0, 0))], duration=0.4, every=0.004, progress=False
    )
    tip = run.displacements[:, cloud.group("x+"), 0].mean(axis=1)
    assert np.abs(run.balance).max() < 0.01 * np.abs(run.external).max()
    ease = pt.rollout(  # the same bar without branches, slowly pulled: the end of the creep
        pt.Solid(cloud, tissue(None, poisson=0.45), "x-", form="energy", stiffness_damping=5e-4),
        [pt.SurfaceForce("x+", force=lambda t: (force * min(t / 0.1, 1), 0, 0))],
        duration=0.3, every=0.01, progress=False,
    )  # fmt: skip
    final = ease.displacements[-5:, cloud.group("x+"), 0].mean()
    # nearly incompressible, so shear alone decides; the bar rings about the creep, fast and damped
    smooth = np.convolve(tip, np.ones(9) / 9, "valid")
    expected = final * (1 - 0.5 * np.exp(-run.times[4:-4] / 0.1))
    late = run.times[4:-4] > 0.2
    np.testing.assert_allclose(smooth[late], expected[late], rtol=0.03)


def test_a_divided_run_equals_the_whole_run_and_a_new_run_starts_relaxed():
    cloud = pt.box((0.03, 0.01, 0.01), 0.0025)
    bar = pt.Solid(cloud, tissue(), "x-", form="energy", stiffness_damping=2e-5)
    loads = [pt.SurfaceForce("x+", force=lambda t: (0.02 * np.sin(60 * t), 0.01, 0))]
    options = {"duration": 0.03, "progress": False, "step": 2.5e-5}
    coarse, fine, again = (pt.rollout(bar, loads, every=e, **options) for e in (0.03, 0.003, 0.03))
    np.testing.assert_array_equal(again.displacements, coarse.displacements)
    np.testing.assert_allclose(
        fine.displacements[-1], coarse.displacements[-1], atol=1e-4 * np.abs(coarse.displacements[-1]).max()
    )
    assert fine.dissipated[-1] == pytest.approx(coarse.dissipated[-1], rel=1e-3)


def test_a_body_without_relaxation_has_no_history():
    cloud = pt.box((0.03, 0.01, 0.01), 0.0025)
    model = pt.Solid(cloud, tissue(None), "x-", form="energy")
    assert model.state(model.prepare([])).history == ()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shares": (0.5, -0.1), "times": (1.0, 2.0)}, r"shares\[1\] must be .*, got -0.1"),
        ({"shares": 0.5, "times": 0.0}, r"times\[0\] must be .*, got 0"),
        ({"shares": (0.5, 0.1), "times": 1.0}, "equal, non-zero length, got 2 and 1"),
        ({"shares": (), "times": ()}, "equal, non-zero length, got 0 and 0"),
        ({"shares": 0.5, "times": 1.0, "bulk_shares": (0.1, 0.1)}, "as long as times, got lengths 2 and 1"),
        ({"shares": "a", "times": 1.0}, r"shares\[0\] must be a number"),
    ],
)
def test_bad_series_are_refused(options, message):
    with pytest.raises(pt.InputError, match=message):
        pt.materials.Prony(**options)


def test_the_strong_form_and_invalid_series_are_refused():
    cloud = pt.box((0.03, 0.01, 0.01), 0.0025)
    with pytest.raises(pt.InputError, match="form='energy'"):
        pt.Solid(cloud, tissue(), "x-", form="strong")
    with pytest.raises(pt.InputError, match=r"must be a palpate\.materials\.Prony"):
        pt.materials.NeoHookean(C1=1.0, density=1.0, poisson=0.4, prony=0.5)
