"""Laws of fibres: derivatives, closed forms, tension only, objectivity, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.tissue.catalogue import FIBRE_LAWS

X = np.array([1.0, 0.0, 0.0])
HGO = {"k1": 3e3, "k2": 2.0}
HEART = {"C": 2e3, "bf": 8.0, "bt": 2.0, "bfs": 4.0}


def units(*shape, seed=0):
    random = np.random.default_rng(seed).standard_normal((*shape, 3))
    return random / np.linalg.norm(random, axis=-1, keepdims=True)


# every law of fibres of the catalogue with its example, and other families
LAWS = {law.name: law.kind(**law.example, directions=units(60)) for law in FIBRE_LAWS} | {
    "one family": pt.materials.Fibres(**HGO, dispersion=0.1, directions=units(60)),
    "two families": pt.materials.Fibres(**HGO, dispersion=0.2, directions=units(2, 60)),
    "no dispersion": pt.materials.Fibres(**HGO, directions=units(60)),
    "the heart": pt.materials.Guccione(**HEART, directions=units(60)),
}


def gradients(scale, seed=1):
    return np.eye(3) + scale * np.random.default_rng(seed).uniform(-1, 1, (60, 3, 3))


@pytest.mark.parametrize("scale", [0.05, 0.3, 1.0])  # the last one turns many inside out
@pytest.mark.parametrize("name", LAWS)
def test_stress_is_the_slope_of_the_energy(name, scale):
    law, F, step = LAWS[name], gradients(scale), 1e-6
    slopes = np.zeros_like(F)
    for i, j in np.ndindex(3, 3):
        d = np.zeros((3, 3))
        d[i, j] = step
        slopes[:, i, j] = (law.energy(F + d) - law.energy(F - d)) / (2 * step)
    stress = law.stress(F)
    sizes = np.maximum(np.abs(stress).max(axis=(1, 2)), 1e-3 * np.abs(stress).max())
    assert (np.abs(stress - slopes).max(axis=(1, 2)) < 1e-6 * sizes).all()
    assert law.energy(F).min() >= 0


@pytest.mark.parametrize("name", LAWS)
def test_rest_and_a_change_of_volume_have_no_stress(name):
    for size in (0.7, 1.0, 1.4):
        F = np.tile(size * np.eye(3), (60, 1, 1))
        assert np.abs(LAWS[name].energy(F)).max() < 1e-9
        assert np.abs(LAWS[name].stress(F)).max() < 1e-9


@pytest.mark.parametrize("name", LAWS)
def test_turning_the_body_turns_the_stress(name):
    law, F, turn = LAWS[name], gradients(0.3), Rotation.from_rotvec([0.4, -1.0, 0.7]).as_matrix()
    np.testing.assert_allclose(law.energy(turn @ F), law.energy(F), rtol=1e-11)
    expected = turn @ law.stress(F)
    np.testing.assert_allclose(law.stress(turn @ F), expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("name", LAWS)
def test_turning_tissue_and_fibres_together_changes_nothing(name):
    law, F, turn = LAWS[name], gradients(0.3), Rotation.from_rotvec([0.4, -1.0, 0.7]).as_matrix()
    turned = replace(law, directions=law.directions @ turn.T)
    np.testing.assert_allclose(turned.energy(F @ turn.T), law.energy(F), rtol=1e-10)


@pytest.mark.parametrize("kappa", [0.0, 0.1, 1 / 3])
def test_a_pull_along_the_fibres_is_the_printed_curve(kappa):
    law, (k1, k2) = pt.materials.Fibres(**HGO, dispersion=kappa, directions=X), HGO.values()
    for stretch in (1.05, 1.3, 1.6):
        F = np.diag([stretch, stretch**-0.5, stretch**-0.5])
        E = kappa * (stretch**2 + 2 / stretch - 3) + (1 - 3 * kappa) * (stretch**2 - 1)
        assert float(law.energy(F)) == pytest.approx(k1 / (2 * k2) * np.expm1(k2 * E**2), rel=1e-12)
        slope = kappa * (2 * stretch - 2 / stretch**2) + (1 - 3 * kappa) * 2 * stretch
        P = law.stress(F)  # its part along the path of incompressible stretches
        along = P[0, 0] - stretch**-1.5 * P[1, 1]
        assert along == pytest.approx(k1 * E * np.exp(k2 * E**2) * slope, rel=1e-12)


def test_the_cauchy_stress_is_that_of_the_paper():
    """The printed sigma = 2/J dev sum of k1 E exp(k2 E^2) [kappa b̄ + (1 - 3 kappa) F̄a F̄a]."""
    kappa, F, a = 0.15, gradients(0.25), units(2, 60, seed=5)
    stress = pt.materials.Fibres(**HGO, dispersion=kappa, directions=a).stress(F)
    J = np.linalg.det(F)
    bar = J[:, None, None] ** (-1 / 3) * F
    b, sigma = bar @ np.swapaxes(bar, 1, 2), np.zeros_like(F)
    for family in a:
        turned = np.einsum("nij,nj->ni", bar, family)
        E = kappa * (np.trace(b, axis1=1, axis2=2) - 3) + (1 - 3 * kappa) * (np.sum(turned**2, axis=1) - 1)
        rise = HGO["k1"] * np.maximum(E, 0) * np.exp(HGO["k2"] * E**2)
        sigma += rise[:, None, None] * (kappa * b + (1 - 3 * kappa) * turned[:, :, None] * turned[:, None, :])
    sigma -= np.trace(sigma, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    expected = 2 * sigma @ np.swapaxes(np.linalg.inv(F), 1, 2)
    np.testing.assert_allclose(stress, expected, atol=1e-10 * np.abs(expected).max())


def test_fibres_carry_no_compression():
    law = pt.materials.Fibres(**HGO, directions=X)
    for stretch in (0.5, 0.9, 0.999):
        F = np.diag([stretch, stretch**-0.5, stretch**-0.5])
        assert float(law.energy(F)) == 0.0
        np.testing.assert_array_equal(law.stress(F), 0.0)
        assert float(law.energy(np.diag([stretch**-0.5, stretch, stretch**-0.5]))) > 0.0


def test_evenly_dispersed_fibres_have_no_direction():
    F = gradients(0.3)
    one, other = (pt.materials.Fibres(**HGO, dispersion=1 / 3, directions=units(60, seed=s)).energy(F) for s in (3, 4))
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_two_families_add_up():
    F, both = gradients(0.3), units(2, 60)
    single = [pt.materials.Fibres(**HGO, dispersion=0.1, directions=a).stress(F) for a in both]
    np.testing.assert_allclose(
        pt.materials.Fibres(**HGO, dispersion=0.1, directions=both).stress(F), sum(single), atol=1e-9
    )


def test_the_exponent_of_the_heart_law_is_the_printed_one():
    a = units(60)
    b = np.cross(a, units(60, seed=9))
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    axes = np.stack([a, b, np.cross(a, b)], axis=1)  # rows
    F = gradients(0.2)
    bar = np.linalg.det(F)[:, None, None] ** (-1 / 3) * F
    E = axes @ (np.swapaxes(bar, 1, 2) @ bar - np.eye(3)) @ np.swapaxes(axes, 1, 2) / 2
    C, bf, bt, bfs = HEART.values()
    Q = bf * E[:, 0, 0] ** 2 + bt * (E[:, 1, 1] ** 2 + E[:, 2, 2] ** 2 + 2 * E[:, 1, 2] ** 2)
    Q += 2 * bfs * (E[:, 0, 1] ** 2 + E[:, 0, 2] ** 2)
    np.testing.assert_allclose(pt.materials.Guccione(**HEART, directions=a).energy(F), C / 2 * np.expm1(Q), rtol=1e-10)


@pytest.mark.parametrize(
    "law",
    [
        pt.materials.Fibres(k1=1.0, k2=10.0, directions=X),
        pt.materials.Guccione(C=1.0, bf=8.0, bt=2.0, bfs=4.0, directions=X),
    ],
)
def test_a_steep_exponential_continues_as_a_parabola(law):
    stretches = np.linspace(1.0, 8.0, 4001)
    F = np.eye(3) * np.stack([stretches, stretches**-0.5, stretches**-0.5], axis=-1)[:, None, :]
    law = law.at(np.zeros((4001, 3)))
    energy, P = law.energy(F), law.stress(F)
    along = P[:, 0, 0] - stretches**-1.5 * P[:, 1, 1]
    assert np.isfinite(energy).all()
    assert (np.diff(along) > 0).all()
    work = np.concatenate([[0], np.cumsum((along[1:] + along[:-1]) / 2 * np.diff(stretches))])
    np.testing.assert_allclose(work, energy, atol=1e-4 * energy[-1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"k1": 0.0}, "k1 must be .*, got 0"),
        ({"k2": -1.0}, "k2 must be .*, got -1"),
        ({"dispersion": 0.4}, "dispersion must be .*, got 0.4"),
        ({"directions": (1.0, 1.0, 0.0)}, "unit vectors, got a length of 1.41"),
        ({"directions": np.array([X, X, 2 * X, X])}, "got a length of 2 at nodes 2"),
        ({"directions": (np.nan, 0.0, 0.0)}, "unit vectors"),
        ({"directions": "x"}, "must be an array of numbers"),
        ({"directions": (1.0, 0.0)}, r"must have shape .*, got \(2,\)"),
        ({"directions": np.ones((3, 4, 3))}, r"must have shape .*, got \(3, 4, 3\)"),
    ],
)
def test_bad_fibres_are_refused(options, message):
    with pytest.raises(pt.InputError, match=message):
        pt.materials.Fibres(**{**HGO, "directions": X, **options})


def test_the_hearts_law_has_one_direction():
    with pytest.raises(pt.InputError, match="of Guccione must be one family, got 2"):
        pt.materials.Guccione(**HEART, directions=np.eye(3)[:2])
