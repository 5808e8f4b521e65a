"""Principal axes, and forces where stretches meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.eigenvectors import principal
from palpate.compiled.jit import law_digest
from palpate.dynamics.material.principal_point import make_principal_point

pytestmark = [pytest.mark.slow, pytest.mark.each_kind(point=["ogden"])]

SIDE = 0.02
OGDEN = pt.materials.Ogden(C=(5e3, 300.0, 500.0), alpha=(1.3, 5.0, -2.0), density=1000, poisson=0.4)


def spectra(random):
    """Squared stretches of every kind: apart, two equal, three equal, almost equal, far apart."""
    near = 10.0 ** random.uniform(-17, -1, 3) * random.normal(size=3)
    yield random.uniform(0.1, 3, 3)
    yield np.array([1.0, 1.0, random.uniform(0.2, 3)])
    yield np.full(3, random.uniform(0.1, 5))
    yield 1 + near
    yield random.uniform(0.2, 3) * np.array([1.0, 1 + abs(near[0]), 2.0])
    yield 10.0 ** random.uniform(-6, 6, 3)


@pytest.mark.parametrize("turned", [True, False])
def test_axes_are_orthonormal_and_diagonalise(turned):
    random = np.random.default_rng(0)
    for _ in range(300):
        for squares in spectra(random):
            q = np.linalg.qr(random.normal(size=(3, 3)))[0] if turned else np.eye(3)
            C = (q * squares) @ q.T
            C = (C + C.T) / 2
            found, axes = principal(C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[0, 2], C[1, 2])
            N, size = np.reshape(axes, (3, 3)), 1e-14 * squares.max()
            np.testing.assert_allclose(N.T @ N, np.eye(3), atol=1e-14)
            np.testing.assert_allclose((N * found) @ N.T, C, atol=size)
            np.testing.assert_allclose(np.sort(found), np.linalg.eigvalsh(C), atol=size)


@pytest.mark.parametrize("stretches", [(1, 1, 1), (1.2, 1.2, 1.2), (1.3, 1.3, 0.7), (1.1, 0.8, 0.8)], ids=str)
@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-6, 1e-4])
def test_the_strong_form_is_the_divergence_of_the_stress_where_stretches_meet(stretches, apart, rotation):
    """Of x = F0 X + B X X / 2 about X = 0, where the stretches are equal or almost so."""
    cloud = pt.box((SIDE,) * 3, spacing=SIDE / 4)
    centre = int(np.argmin(np.abs(cloud.points - SIDE / 2).sum(axis=1)))
    X = cloud.points - cloud.points[centre]
    F0 = (rotation * (np.array(stretches) + apart * np.array([0.0, 1.0, -1.0]))) @ rotation.T
    B = 0.1 / SIDE * np.random.default_rng(0).uniform(-1, 1, (3, 3, 3))
    B = (B + B.transpose(0, 2, 1)) / 2
    law = replace(OGDEN, poisson=None, bulk=OGDEN.shear_bulk_modulus)  # without a pressure
    model = pt.Solid(cloud, law, form="strong", stiffness_damping=0.0)
    force = model.force(X @ F0.T + np.einsum("ijk,nj,nk->ni", B, X, X) / 2 - X)[centre]
    expected, step = np.zeros(3), 1e-4 * SIDE
    for a in range(3):
        ahead, behind = (law.stress(F0 + s * step * B[:, :, a]) for s in (1, -1))
        expected += (ahead - behind)[:, a] / (2 * step)
    np.testing.assert_allclose(force, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("form", ["strong", "energy"])
def test_rest_has_no_force(form):
    model = pt.Solid(pt.box((SIDE,) * 3, SIDE / 4, jitter=0.2), OGDEN, form=form, stiffness_damping=0.0)
    scale = OGDEN.shear_modulus / model.cloud.spacing
    assert np.abs(model.force(np.zeros_like(model.cloud.points))).max() < 1e-12 * scale


@pytest.mark.parametrize("form", ["strong", "energy"])
def test_ogden_with_the_exponent_2_moves_as_neo_hookean(form):
    """The one law by principal axes, the other by invariants."""
    common = {"density": 1000.0, "poisson": 0.4}
    laws = (pt.materials.Ogden(C=10e3, alpha=2.0, **common), pt.materials.NeoHookean(C1=10e3, **common))
    cloud = pt.box((SIDE,) * 3, SIDE / 4, jitter=0.2)
    u = 0.1 * SIDE * np.sin(cloud.points @ np.random.default_rng(0).uniform(-80, 80, (3, 3)))
    one, other = (pt.Solid(cloud, law, form=form, stiffness_damping=0.0).force(u) for law in laws)
    np.testing.assert_allclose(one, other, atol=1e-11 * np.abs(other).max())


def test_membranes_of_ogden_and_neo_hookean_are_the_same():
    common = {"density": 1000.0, "poisson": 0.5}
    cloud = pt.disc(0.05, 0.01)
    u = 0.005 * np.random.default_rng(0).normal(size=(len(cloud), 3))
    forces = [
        pt.Membrane(cloud, law, 1e-3, prestretch=1.2).force(u)
        for law in (pt.materials.Ogden(C=10e3, alpha=2.0, **common), pt.materials.NeoHookean(C1=10e3, **common))
    ]
    np.testing.assert_allclose(*forces, atol=1e-10 * np.abs(forces[1]).max())


POINTS = {
    "ogden": OGDEN,
    "exponential": pt.materials.Exponential(C1=2e3, C2=0.5, C3=3e3, alpha1=2.0, alpha2=-1.5, density=1000, poisson=0.4),
}


@pytest.fixture(scope="module", params=POINTS)
def point(request):
    """A law, and the stress and energy of its points, compiled."""
    law = POINTS[request.param]
    digest = law_digest("test point", law.energy, law.first, law.second)
    return law, *make_principal_point(digest, law.energy, law.first, law.second, 0.1)


def test_a_point_that_is_not_crushed_has_the_energy_and_stress_of_the_law(point):
    law, stress, density = point
    for seed in range(20):
        F = np.eye(3) + np.random.default_rng(seed).uniform(-0.3, 0.3, (3, 3))
        found, cofactor, change = stress(*(F - np.eye(3)).ravel(), law.coefficients)
        np.testing.assert_allclose(np.reshape(found, (3, 3)), law.shear_stress(F), atol=1e-10 * law.shear_modulus)
        np.testing.assert_allclose(np.reshape(cofactor, (3, 3)), law.cofactor(F), atol=1e-12)
        assert change == pytest.approx(np.linalg.det(F) - 1, abs=1e-12)
        assert density(*(F - np.eye(3)).ravel(), law.coefficients)[0] == pytest.approx(law.shear_energy(F), rel=1e-10)


@pytest.mark.parametrize("smallest", [0.3, 0.1, 0.02, 0.0, -0.1, -0.5])
def test_the_stress_of_a_crushed_point_is_the_slope_of_its_energy(point, smallest):
    law, stress, density = point
    q, r = (np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0] for seed in (0, 1))
    q, r = q * np.linalg.det(q), r * np.linalg.det(r)
    F = (q * (1.2, 0.8, smallest)) @ r.T
    found = stress(*(F - np.eye(3)).ravel(), law.coefficients)[0]
    slope, step = np.empty(9), 1e-6
    for k in range(9):
        change = step * np.eye(9)[k]
        ahead, behind = (density(*((F - np.eye(3)).ravel() + s * change), law.coefficients)[0] for s in (1, -1))
        slope[k] = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(found, slope, atol=1e-6 * np.abs(slope).max())


def test_energy_and_stress_have_no_jump_where_a_point_counts_as_crushed(point):
    law, stress, density = point
    near = [np.diag([1.2, 0.8, (0.1 + change) / 0.96]) - np.eye(3) for change in (-1e-9, 1e-9)]
    for function in (stress, density):
        one, other = (np.hstack([np.ravel(f) for f in function(*d.ravel(), law.coefficients)]) for d in near)
        np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(one).max())


def test_a_point_of_zero_volume_has_finite_energy_and_stress(point):
    law, stress, density = point
    crushed = (-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0)
    assert np.isfinite(density(*crushed, law.coefficients)).all()
    assert np.isfinite(stress(*crushed, law.coefficients)[0]).all()
