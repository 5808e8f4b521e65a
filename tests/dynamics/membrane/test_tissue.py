"""Membranes of tissue that relaxes and of tissue with fibres, against closed forms and the balance of energy."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt

pytestmark = pytest.mark.slow

SERIES = pt.materials.Prony(shares=(0.5, 0.3), times=(0.02, 0.3))
MU = 10e3
LAW = {"C1": MU / 2, "density": 1000.0, "poisson": 0.5}
HGO = {"k1": 8e3, "k2": 2.0, "dispersion": 0.1}
SHEET = [(0, 0), (0.06, 0), (0.06, 0.04), (0, 0.04)]


@pytest.fixture(scope="module", params=[True, False], ids=["relaxed", "taut"])
def relaxing(request):
    return made(request.param)


def made(relaxed, prestretch=1.0, fibres=None, prony=SERIES):
    cloud = pt.sheet(SHEET, 0.01)
    return pt.Membrane(
        cloud, pt.materials.NeoHookean(**LAW, prony=prony), 1e-3, relaxed=relaxed, fibres=fibres, prestretch=prestretch,
        stiffness_damping=0.0,
    )  # fmt: skip


def uniform(model, F):
    return model.cloud.points @ (F / model.prestretch - np.eye(3, 2)).T


def responses(model, course, times):
    """Mean stresses (t, 3, 2), stored and lost energies [J/m^3] of uniform deformations F(t) (3, 2)."""
    history = model.state(model.prepare([])).history
    stresses, stored, lost = [], [], []
    for before, time in zip([times[0], *times], times, strict=False):
        u = uniform(model, course(time))
        history, dissipated = model.history_after(u, history, time - before) if time > before else (history, 0.0)
        stresses.append(model.stress(u, history).mean(axis=0))
        stored.append(model.strain_energy(u, history) / model.volumes.sum())
        lost.append((lost[-1] if lost else 0.0) + dissipated / model.volumes.sum())
    return np.array(stresses), np.array(stored), np.array(lost)


@pytest.mark.parametrize("stretch", [1.0001, 1.4])
def test_a_held_equibiaxial_stretch_relaxes_as_the_series_says(relaxing, stretch):
    times = np.array([0.0, 1e-9, 0.005, 0.02, 0.1, 0.4])
    stresses, _, lost = responses(relaxing, lambda t: np.eye(3, 2) * (stretch if t > 0 else 1.0), times)
    s = stretch
    law = MU * (s - s**-5)
    at_once = MU * s * ((s**2 - 1) - s**-6 * (s**-4 - 1))
    fading = SERIES.relaxation(times[1:]) - 1
    np.testing.assert_allclose(stresses[1:, 0, 0], law + at_once * fading, rtol=1e-6)
    np.testing.assert_allclose(stresses[:, 1, 1], stresses[:, 0, 0], rtol=1e-9)
    strain = 2 * (s**2 - 1) ** 2 + (s**-4 - 1) ** 2
    each = zip(SERIES.shares, SERIES.times, strict=True)
    gone = sum(share * MU / 4 * strain * (1 - np.exp(-2 * times / tau)) for share, tau in each)
    np.testing.assert_allclose(lost[2:], gone[2:], rtol=1e-6)


def test_a_prestretched_sheet_starts_fully_relaxed():
    model = made(True, prestretch=1.2)
    stress = model.stress(np.zeros((len(model.cloud), 3)))
    np.testing.assert_allclose(stress[:, 0, 0], MU * (1.2 - 1.2**-5), rtol=1e-9)


def test_work_is_stored_or_dissipated(relaxing):
    """Over a course in which a relaxed sheet is taut, wrinkled and slack."""
    random = np.random.default_rng(3)
    knots = np.array([np.eye(3, 2), *(np.eye(3, 2) + random.uniform(-0.3, 0.35, (10, 3, 2)))])
    times = np.linspace(0, 1.0, 4001)

    def course(t):
        place = min(t / 0.1, len(knots) - 1 - 1e-9)
        k = int(place)
        return knots[k] + (place - k) * (knots[k + 1] - knots[k])

    stresses, stored, lost = responses(relaxing, course, times)
    F = np.array([course(t) for t in times])
    if relaxing.relaxed:
        singular = np.linalg.svd(F, compute_uv=False)
        taut = singular[:, 1] > np.maximum(singular[:, 0], 1) ** -0.5
        assert min(taut.sum(), (~taut).sum()) > 300
    work = np.concatenate(
        [[0], np.cumsum(0.5 * np.sum((stresses[1:] + stresses[:-1]) * np.diff(F, axis=0), axis=(1, 2)))]
    )
    assert np.diff(lost).min() >= 0
    np.testing.assert_allclose(work, stored + lost - stored[0], atol=2e-3 * work.max())


def test_forces_are_the_slope_of_the_energy_taut_and_wrinkled(relaxing):
    model = relaxing
    points = model.cloud.points
    fields = np.column_stack([np.sin(40 * points[:, 1]), np.cos(30 * points[:, 0]), np.sin(50 * points[:, 0])])
    before = uniform(model, np.array([[1.1, 0.2], [0.0, 1.2], [0.0, 0.1]]))
    history, _ = model.history_after(before, (), 0.01)
    u = uniform(model, np.array([[1.15, 0.0], [0.0, 0.93], [0.0, 0.0]])) + 0.001 * fields
    direction, step = np.random.default_rng(0).standard_normal(u.shape), 1e-8
    energies = [model.strain_energy(u + sign * step * direction, history) for sign in (1, -1)]
    slope = (energies[0] - energies[1]) / (2 * step)
    work = -np.sum(model.volumes[:, None] * model.force(u, history) * direction)
    assert work == pytest.approx(slope, rel=5e-6)


def test_a_released_sheet_dissipates_energy_in_its_branches_and_balances():
    model = made(True)
    F = np.diag([1.2, 1.1, 1.0])[:, :2]
    run = pt.rollout(model, [], duration=0.02, every=0.002, displacement=uniform(model, F), progress=False)
    assert np.abs(run.balance).max() < 0.02 * run.strain[0]
    assert np.diff(run.dissipated).min() >= 0
    assert run.dissipated[-1] > 0.01 * run.strain[0]


@pytest.mark.parametrize("prony", [None, SERIES])
def test_fibres_pull_as_the_closed_form_says(prony):
    along = {**HGO, "directions": (1.0, 0.0, 0.0)}
    model = made(False, fibres=pt.materials.Fibres(**along), prony=prony)
    bare = made(False, prony=prony)
    k1, k2, kappa = HGO.values()
    for l1, l2 in ((1.3, 1.3**-0.5), (1.2, 1.2), (0.9, 1.02), (1.02, 1.3)):
        F = np.diag([l1, l2, 1.0])[:, :2]
        found = (model.stress(uniform(model, F)) - bare.stress(uniform(bare, F))).mean(axis=0)
        E = max(kappa * (l1**2 + l2**2 + (l1 * l2) ** -2 - 3) + (1 - 3 * kappa) * (l1**2 - 1), 0.0)
        rate = 2 * k1 * E * np.exp(k2 * E**2)
        one = rate * (kappa * (l1 - l1**-3 * l2**-2) + (1 - 3 * kappa) * l1)
        two = rate * kappa * (l2 - l2**-3 * l1**-2)
        np.testing.assert_allclose(found[:2], np.diag([one, two]), atol=1e-9 * MU)
        energy = model.strain_energy(uniform(model, F)) - bare.strain_energy(uniform(bare, F))
        assert energy == pytest.approx(model.volumes.sum() * k1 / (2 * k2) * np.expm1(k2 * E**2), rel=1e-9, abs=1e-18)
    if prony is None:
        principal = model.principal_stress(uniform(model, np.diag([1.2, 1.1, 1.0])[:, :2]))
        P = model.stress(uniform(model, np.diag([1.2, 1.1, 1.0])[:, :2]))
        np.testing.assert_allclose(principal, np.stack([1.2 * P[:, 0, 0], 1.1 * P[:, 1, 1]], axis=1), rtol=1e-9)


def test_turned_fibres_in_a_bent_sheet_pull_by_the_slope_of_the_energy():
    def about(points):
        angle = 20 * points[:, 0]
        return np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])

    model = made(False, fibres=pt.materials.Fibres(**HGO, directions=about), prony=None)
    points = model.cloud.points
    u = 0.002 * np.column_stack([np.sin(40 * points[:, 1]), np.cos(30 * points[:, 0]), np.sin(50 * points[:, 0])])
    direction, step = np.random.default_rng(0).standard_normal(u.shape), 1e-8
    slope = (model.strain_energy(u + step * direction) - model.strain_energy(u - step * direction)) / (2 * step)
    assert -np.sum(model.volumes[:, None] * model.force(u) * direction) == pytest.approx(slope, rel=5e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fibres": pt.materials.Fibres(**HGO, directions=(1.0, 0.0, 0.0))}, "relaxed=False"),
        (
            {"fibres": pt.materials.Fibres(**HGO, directions=(0.0, 0.6, 0.8)), "relaxed": False},
            "in the plane of the sheet",
        ),
        ({"fibres": 3.0}, "must be palpate.materials.Fibres"),
    ],
)
def test_fibres_in_unsupported_sheets_are_refused(options, message):
    with pytest.raises(pt.InputError, match=message):
        pt.Membrane(pt.sheet(SHEET, 0.01), pt.materials.NeoHookean(**LAW), 1e-3, **options)


def test_a_volume_that_relaxes_is_refused():
    prony = pt.materials.Prony(shares=1.0, times=1.0, bulk_shares=0.5)
    with pytest.raises(pt.InputError, match="bulk_shares"):
        made(True, prony=prony)


def test_hyper_reduced_membranes_refuse_fibres_and_relaxation():
    model = made(True)
    run = pt.rollout(model, [], duration=1e-4, every=1e-4, progress=False)
    with pytest.raises(pt.InputError, match="leave out fibres= and prony="):
        pt.hyper_reduce(model, run, modes=1)
