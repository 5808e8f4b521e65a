"""The contract of every strain energy."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

import palpate as pt

LAWS = {
    "neo-hookean": (pt.NeoHookean, {"C1": 30e3}),
    "mooney-rivlin": (pt.MooneyRivlin, {"C1": 40e3, "C2": 15e3}),
    "mooney-rivlin-without-C2": (pt.MooneyRivlin, {"C1": 60e3, "C2": 0.0}),
}
EYE = np.eye(3)


@pytest.fixture(params=LAWS)
def law(request):
    return LAWS[request.param]


@pytest.fixture(params=[0.0, 0.3, 0.45, 0.499], ids=lambda nu: f"nu{nu}")
def material(request, law):
    kind, parameters = law
    return kind(**parameters, density=1000.0, poisson=request.param)


@pytest.fixture
def deformations():
    return EYE + np.random.default_rng(0).uniform(-0.3, 0.3, size=(8, 3, 3))


@pytest.fixture
def rotations():
    q, r = np.linalg.qr(np.random.default_rng(1).normal(size=(8, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    return q * np.sign(np.linalg.det(q))[:, None, None]


def differences(function, at, step):
    """Central differences of a function of several numbers, along a new last axis."""
    at = np.asarray(at, dtype=float)
    columns = []
    for k in range(len(at)):
        ahead, behind = at.copy(), at.copy()
        ahead[k] += step
        behind[k] -= step
        columns.append((np.asarray(function(*ahead)) - np.asarray(function(*behind))) / (2 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("invariants", [(3.0, 3.0, 1.0), (3.6, 3.9, 0.8), (4.4, 5.1, 1.3)])
def test_first_derivatives_are_those_of_the_energy(material, invariants):
    c = material.coefficients
    found = material.first(*invariants, c)
    expected = differences(lambda *i: material.energy(*i, c), invariants, 1e-4)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * material.shear_modulus)


@pytest.mark.parametrize("invariants", [(3.0, 3.0, 1.0), (3.6, 3.9, 0.8), (4.4, 5.1, 1.3)])
def test_second_derivatives_are_those_of_the_first(material, invariants):
    c = material.coefficients
    s11, s12, s22, s1J, s2J, sJJ = material.second(*invariants, c)
    expected = differences(lambda *i: material.first(*i, c), invariants, 1e-4)
    found = [[s11, s12, s1J], [s12, s22, s2J], [s1J, s2J, sJJ]]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * material.shear_modulus)


def test_stress_is_the_derivative_of_the_energy(material, deformations):
    for F in deformations:
        gradient = differences(lambda *f: material.strain_energy(np.reshape(f, (3, 3))), F.ravel(), 1e-5)
        stress = material.stress(F)
        np.testing.assert_allclose(stress, gradient.reshape(3, 3), atol=1e-6 * np.abs(stress).max())


def test_rest_has_no_energy_and_no_stress(material):
    assert material.strain_energy(EYE) == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(material.stress(EYE), 0, atol=1e-9)


def test_rest_is_a_minimum_of_the_energy(material):
    small = EYE + 0.02 * np.random.default_rng(2).normal(size=(50, 3, 3))
    assert np.all(material.strain_energy(small) > 0)


def test_small_shear_has_the_declared_shear_modulus(material):
    gamma = 1e-5
    slope = (material.stress(EYE + gamma * np.eye(3, k=1)) - material.stress(EYE - gamma * np.eye(3, k=1))) / (
        2 * gamma
    )
    assert slope[0, 1] == pytest.approx(material.shear_modulus, rel=1e-7)
    assert slope[1, 0] == pytest.approx(material.shear_modulus, rel=1e-7)


def test_small_swelling_has_the_declared_bulk_modulus(material):
    stretch = 1e-5
    slope = (material.stress((1 + stretch) * EYE) - material.stress((1 - stretch) * EYE)) / (2 * stretch)
    np.testing.assert_allclose(slope, 3 * material.bulk_modulus * EYE, atol=1e-6 * material.bulk_modulus)


def test_small_pull_contracts_by_poissons_ratio(material):
    strain = 1e-6
    slope = np.diag(material.stress(EYE + strain * np.diag([1, -material.poisson, -material.poisson]))) / strain
    young = 2 * material.shear_modulus * (1 + material.poisson)
    np.testing.assert_allclose(slope, [young, 0, 0], atol=2e-3 * young)


def test_energy_and_stress_turn_with_the_frame(material, deformations, rotations):
    turned = rotations @ deformations
    np.testing.assert_allclose(material.strain_energy(turned), material.strain_energy(deformations), rtol=1e-11)
    stress = material.stress(deformations)
    np.testing.assert_allclose(material.stress(turned), rotations @ stress, atol=1e-11 * np.abs(stress).max())


def test_tissue_is_isotropic(material, deformations, rotations):
    energy = material.strain_energy(deformations)
    np.testing.assert_allclose(material.strain_energy(deformations @ rotations), energy, rtol=1e-11)


def test_cauchy_stress_is_symmetric(material, deformations):
    cauchy = material.stress(deformations) @ np.swapaxes(deformations, 1, 2)
    np.testing.assert_allclose(cauchy, np.swapaxes(cauchy, 1, 2), atol=1e-11 * np.abs(cauchy).max())


def test_poissons_ratio_and_bulk_modulus_say_the_same(material, law):
    kind, parameters = law
    again = kind(**parameters, density=1000.0, bulk=material.bulk_modulus)
    assert again.poisson == pytest.approx(material.poisson, abs=1e-12)
    assert again.lame == pytest.approx(material.lame, rel=1e-9)
    mu, nu = material.shear_modulus, material.poisson
    assert material.bulk_modulus == pytest.approx(2 * mu * (1 + nu) / (3 * (1 - 2 * nu)))


def test_squeezing_flat_costs_ever_more_energy(material):
    energies = [float(material.strain_energy(np.diag([1, 1, s]))) for s in (1.0, 1e-1, 1e-10, 1e-100)]
    assert np.diff(energies).min() > 0


def isochoric(deformations):
    return deformations / np.cbrt(np.linalg.det(deformations))[:, None, None]


def test_neo_hookean_has_the_factor_of_equation_17(deformations):
    F = isochoric(deformations)
    C = np.swapaxes(F, 1, 2) @ F
    material = pt.NeoHookean(C1=30e3, density=1000, poisson=0.4)
    np.testing.assert_allclose(material.strain_energy(F), 30e3 * (np.trace(C, axis1=1, axis2=2) - 3), rtol=1e-10)
    assert material.shear_modulus == 60e3


def test_mooney_rivlin_has_the_factors_of_equation_16(deformations):
    F = isochoric(deformations)
    C = np.swapaxes(F, 1, 2) @ F
    first = np.trace(C, axis1=1, axis2=2)
    second = (first**2 - np.trace(C @ C, axis1=1, axis2=2)) / 2
    material = pt.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.4)
    np.testing.assert_allclose(material.strain_energy(F), 30e3 * (first - 3) + 0.6e3 * (second - 3), rtol=1e-10)
    assert material.shear_modulus == pytest.approx(61.2e3)


def test_mooney_rivlin_without_C2_is_neo_hookean(deformations):
    one = pt.MooneyRivlin(C1=60e3, C2=0, density=1, poisson=0.45)
    other = pt.NeoHookean(C1=30e3, density=1, poisson=0.45)
    np.testing.assert_allclose(one.stress(deformations), other.stress(deformations), rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"C1": 0.0}, r"C1 = 0.0 is out of range: allowed is \(0, inf\) Pa"),
        ({"C1": -1.0}, r"C1 = -1.0 is out of range"),
        ({"C2": -1.0}, r"C2 = -1.0 is out of range: allowed is \[0, inf\) Pa"),
        ({"C2": np.nan}, r"C2 = nan is out of range"),
        ({"C1": "stiff"}, "C1 must be a number"),
        ({"density": 0.0}, r"density = 0.0 is out of range: allowed is \(0, inf\) kg/m\^3"),
        ({"density": np.inf}, "density = inf is out of range"),
        ({"poisson": 0.4995}, r"poisson = 0.4995 is out of range: allowed is \[0, 0.499\]"),
        ({"poisson": -0.1}, r"poisson = -0.1 is out of range"),
        ({"poisson": None}, "either poisson or bulk"),
        ({"bulk": 1e5}, "either poisson or bulk"),
        ({"poisson": None, "bulk": 1e3}, r"bulk = 1000.0 is out of range"),
        ({"poisson": None, "bulk": 1e12}, r"bulk = 1000000000000.0 is out of range"),
    ],
)
def test_a_parameter_out_of_range_is_refused_by_name_and_range(change, message):
    with pytest.raises(pt.InputError, match=message):
        pt.MooneyRivlin(**({"C1": 60e3, "C2": 1e3, "density": 1000.0, "poisson": 0.3} | change))


def test_a_material_cannot_be_changed(material):
    with pytest.raises(FrozenInstanceError):
        material.density = 2.0
