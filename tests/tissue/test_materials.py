"""The contract of every strain energy."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from functools import partial
from itertools import product

import numpy as np
import pytest

import palpate as pt
from palpate.tissue.catalogue import LAWS as CATALOGUE
from palpate.tissue.volumetric import FORM_BY_NAME

pytestmark = pytest.mark.quick(law=["LinearElastic", "MooneyRivlin", "Ogden of three terms"])  # one of each kind

LAWS = {law.name: (law.kind, law.example) for law in CATALOGUE} | {
    "Mooney-Rivlin without C2": (pt.materials.MooneyRivlin, {"C1": 60e3, "C2": 0.0}),
    "Yeoh that softens": (pt.materials.Yeoh, {"C1": 5e3, "C2": -1e3, "C3": 200.0}),
    "Ogden of one term": (pt.materials.Ogden, {"C": 6e3, "alpha": 1.37}),
    "Ogden of three terms": (pt.materials.Ogden, {"C": (4.8e3, 24.0, 50.0), "alpha": (1.3, 5.0, -2.0)}),
    "exponential without C3": (
        pt.materials.Exponential,
        {"C1": 2e3, "C2": 1.5, "C3": 0.0, "alpha1": -3.1, "alpha2": 1.0},
    ),
}  # every law of the catalogue, and special parameters
EYE = np.eye(3)
VARIANTS = [
    (poisson, form)
    for form in FORM_BY_NAME
    for poisson in ((0.0, 0.3, 0.45, 0.499) if form == "quadratic" else (0.45, 0.499))
]


@pytest.fixture(params=LAWS)
def law(request):
    return LAWS[request.param]


@pytest.fixture
def materials(law):
    """The law at several Poisson's ratios, in every volumetric form; small strain has one form."""
    kind, parameters = law
    return [
        kind(**parameters, density=1000.0, poisson=poisson, volumetric=form)
        for poisson, form in VARIANTS
        if form == "quadratic" or kind is not pt.materials.LinearElastic
    ]


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


def at(function, coefficients, *numbers):
    """Return the value of a function of a law, whose coefficients come last."""
    return function(*numbers, coefficients)


def energy_at(material, *entries):
    """Return the strain energy at the nine entries of a deformation gradient."""
    return material.strain_energy(np.reshape(entries, (3, 3)))


PLACES = {
    "small strain": [(0.0, 0.0, 1.0), (0.3, 0.1, 1.2)],
    "invariants": [(3.0, 3.0, 1.0), (3.6, 3.9, 0.8), (4.4, 5.1, 1.3), (9.0, 8.0, 1.0)],
    "stretches": [(1.0, 1.0, 1.0), (0.8, 1.1, 1.1), (1.3, 1.2, 0.7), (0.6, 2.0, 0.9)],
}


def test_first_derivatives_are_those_of_the_energy(materials):
    for material in materials:
        c = material.coefficients
        for place in PLACES[material.variables]:
            found = material.first(*place, c)
            expected = differences(partial(at, material.energy, c), place, 1e-5)
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * material.shear_modulus)


def test_second_derivatives_are_those_of_the_first(materials):
    for material in materials:
        c = material.coefficients
        for place in PLACES[material.variables]:
            expected = differences(partial(at, material.first, c), place, 1e-5)
            order = [0, 3, 4, 3, 1, 5, 4, 5, 2] if material.variables == "stretches" else [0, 1, 3, 1, 2, 4, 3, 4, 5]
            found = np.array(material.second(*place, c))[order].reshape(3, 3)
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * material.shear_modulus)


def test_stress_is_the_derivative_of_the_energy(materials, deformations):
    for material in materials:
        for F in deformations:
            gradient = differences(partial(energy_at, material), F.ravel(), 1e-5)
            stress = material.stress(F)
            np.testing.assert_allclose(stress, gradient.reshape(3, 3), atol=1e-6 * np.abs(stress).max())


def test_rest_has_no_energy_and_no_stress(materials):
    for material in materials:
        assert material.strain_energy(EYE) == pytest.approx(0, abs=1e-9)
        np.testing.assert_allclose(material.stress(EYE), 0, atol=1e-9)


def test_rest_is_a_minimum_of_the_energy(materials):
    for material in materials:
        small = EYE + 0.02 * np.random.default_rng(2).normal(size=(50, 3, 3))
        assert np.all(material.strain_energy(small) > 0)


def test_small_shear_has_the_declared_shear_modulus(materials):
    for material in materials:
        gamma = 1e-5
        slope = (material.stress(EYE + gamma * np.eye(3, k=1)) - material.stress(EYE - gamma * np.eye(3, k=1))) / (
            2 * gamma
        )
        assert slope[0, 1] == pytest.approx(material.shear_modulus, rel=1e-7)
        assert slope[1, 0] == pytest.approx(material.shear_modulus, rel=1e-7)


def test_small_swelling_has_the_declared_bulk_modulus(materials):
    for material in materials:
        stretch = 1e-5
        slope = (material.stress((1 + stretch) * EYE) - material.stress((1 - stretch) * EYE)) / (2 * stretch)
        np.testing.assert_allclose(slope, 3 * material.bulk_modulus * EYE, atol=1e-6 * material.bulk_modulus)


def test_small_pull_contracts_by_poissons_ratio(materials):
    for material in materials:
        strain = 1e-6
        slope = np.diag(material.stress(EYE + strain * np.diag([1, -material.poisson, -material.poisson]))) / strain
        young = 2 * material.shear_modulus * (1 + material.poisson)
        np.testing.assert_allclose(slope, [young, 0, 0], atol=2e-3 * young)


def test_energy_and_stress_turn_with_the_frame_but_in_linear_elasticity(materials, deformations, rotations):
    for material in materials:
        if material.variables == "small strain":
            assert material.strain_energy(rotations[0]) > 0
            continue
        turned = rotations @ deformations
        np.testing.assert_allclose(material.strain_energy(turned), material.strain_energy(deformations), rtol=1e-11)
        stress = material.stress(deformations)
        np.testing.assert_allclose(material.stress(turned), rotations @ stress, atol=1e-11 * np.abs(stress).max())


def test_tissue_is_isotropic(materials, deformations, rotations):
    for material in materials:
        energy = material.strain_energy(deformations)
        turned = deformations @ rotations
        if material.variables == "small strain":
            turned = np.swapaxes(rotations, 1, 2) @ turned
        np.testing.assert_allclose(material.strain_energy(turned), energy, rtol=1e-11)


def test_cauchy_stress_is_symmetric(materials, deformations):
    for material in materials:
        small = material.variables == "small strain"  # there is one stress then
        cauchy = material.stress(deformations) @ (EYE if small else np.swapaxes(deformations, 1, 2))
        np.testing.assert_allclose(cauchy, np.swapaxes(cauchy, 1, 2), atol=1e-11 * np.abs(cauchy).max())


def test_poissons_ratio_and_bulk_modulus_give_the_same_law(materials, law):
    for material in materials:
        kind, parameters = law
        again = kind(**parameters, density=1000.0, bulk=material.bulk_modulus, volumetric=material.volumetric)
        assert again.poisson == pytest.approx(material.poisson, abs=1e-12)
        assert again.lame == pytest.approx(material.lame, rel=1e-9)
        mu, nu = material.shear_modulus, material.poisson
        assert material.bulk_modulus == pytest.approx(2 * mu * (1 + nu) / (3 * (1 - 2 * nu)))


def test_energy_increases_monotonically_as_tissue_is_squeezed_flat(materials):
    for material in materials:
        energies = [float(material.strain_energy(np.diag([1, 1, s]))) for s in (1.0, 1e-1, 1e-5, 1e-10)]
        assert np.diff(energies).min() > 0


def test_energy_increases_monotonically_under_tension_and_shear(materials):
    for material in materials:
        if material.lame < 0:  # at this Poisson's ratio Mooney and Rivlin's I2 holds the volume more than is asked for
            continue
        amounts = np.linspace(0, 2, 41)
        for shape in (np.diag([1.0, 0, 0]), np.diag([1.0, 1.0, 0]), np.eye(3, k=1)):
            energies = material.strain_energy(EYE + amounts[:, None, None] * shape)
            assert np.isfinite(energies).all()
            assert np.diff(energies).min() > 0


def test_energy_is_convex_in_the_logarithmic_strain_at_constant_volume(materials):
    for material in materials:
        strains = np.linspace(-0.7, 0.7, 29)
        for rates in ((1.0, -0.5, -0.5), (1.0, 0.0, -1.0)):
            energies = material.strain_energy(np.exp(strains[:, None] * rates)[:, :, None] * EYE)
            convex = np.diff(energies, 2).min() > 0
            assert convex or isinstance(material, pt.materials.StVenantKirchhoff)


def test_stress_is_continuous_at_equal_stretches(materials, rotations):
    """The stress at equal stretches is that of almost equal ones, and neither is a nan."""
    for material, pair in product(materials, [(1.0, 1.0), (1.3, 1.3), (0.7, 0.7)]):
        third = 1 / (pair[0] * pair[1])
        for turn in rotations[:2]:
            equal = material.stress(np.diag([*pair, third]) @ turn)
            near = material.stress(np.diag([pair[0] + 1e-9, pair[1], third]) @ turn)
            np.testing.assert_allclose(equal, near, atol=1e-6 * material.bulk_modulus * third)


def isochoric(deformations):
    return deformations / np.cbrt(np.linalg.det(deformations))[:, None, None]


def test_neo_hookean_has_the_factor_of_equation_17(deformations):
    F = isochoric(deformations)
    C = np.swapaxes(F, 1, 2) @ F
    material = pt.materials.NeoHookean(C1=30e3, density=1000, poisson=0.4)
    np.testing.assert_allclose(material.strain_energy(F), 30e3 * (np.trace(C, axis1=1, axis2=2) - 3), rtol=1e-10)
    assert material.shear_modulus == 60e3


def test_mooney_rivlin_has_the_factors_of_equation_16(deformations):
    F = isochoric(deformations)
    C = np.swapaxes(F, 1, 2) @ F
    first = np.trace(C, axis1=1, axis2=2)
    second = (first**2 - np.trace(C @ C, axis1=1, axis2=2)) / 2
    material = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.4)
    np.testing.assert_allclose(material.strain_energy(F), 30e3 * (first - 3) + 0.6e3 * (second - 3), rtol=1e-10)
    assert material.shear_modulus == pytest.approx(61.2e3)


def test_mooney_rivlin_without_C2_is_neo_hookean(deformations):
    one = pt.materials.MooneyRivlin(C1=60e3, C2=0, density=1000, poisson=0.45)
    other = pt.materials.NeoHookean(C1=30e3, density=1000, poisson=0.45)
    np.testing.assert_allclose(one.stress(deformations), other.stress(deformations), rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"C1": 0.0}, r"C1 must be in \(0, inf\) Pa, got 0.0"),
        ({"C1": -1.0}, r"C1 must be .*, got -1.0"),
        ({"C2": -1.0}, r"C2 must be in \[0, inf\) Pa, got -1.0"),
        ({"C2": np.nan}, r"C2 must be .*, got nan"),
        ({"C1": "stiff"}, "C1 must be a number"),
        ({"density": 0.0}, r"density must be in \(0, inf\) kg/m\^3, got 0.0"),
        ({"density": np.inf}, "density must be .*, got inf"),
        ({"poisson": 0.4995}, r"poisson must be in \[0, 0.499\], got 0.4995"),
        ({"poisson": -0.1}, r"poisson must be .*, got -0.1"),
        ({"poisson": None}, "either poisson or bulk"),
        ({"bulk": 1e5}, "either poisson or bulk"),
        ({"poisson": None, "bulk": 1e3}, r"bulk must be .*, got 1000.0"),
        ({"poisson": None, "bulk": 1e12}, r"bulk must be .*, got 1000000000000.0"),
        ({"volumetric": "cubic"}, "volumetric must be one of 'quadratic', 'logarithmic', 'mixed', got 'cubic'"),
        ({"volumetric": 2}, "volumetric must be one of .*, got 2"),
    ],
)
def test_a_parameter_out_of_range_is_refused_by_name_and_range(change, message):
    with pytest.raises(pt.InputError, match=message):
        pt.materials.MooneyRivlin(**({"C1": 60e3, "C2": 1e3, "density": 1000.0, "poisson": 0.3} | change))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("Yeoh", {"C2": -2e3}, r"C2 must be in \(-1732.05, inf\) Pa, from -sqrt\(3 C1 C3\), got -2000.0"),
        ("Yeoh", {"C2": -1.0, "C3": 0.0}, r"C2 must be in \[0, inf\) Pa, from .*, got -1.0"),
        ("Gent", {"Jm": 0.0}, r"Jm must be in \(0, inf\), got 0.0"),
        ("ArrudaBoyce", {"N": 0.5}, r"N must be in \[1, inf\), got 0.5"),
        ("Fung", {"b": -1.0}, r"b must be .*, got -1.0"),
        ("LinearElastic", {"volumetric": "mixed"}, "volumetric must be 'quadratic' for small strain, got 'mixed'"),
        ("StVenantKirchhoff", {"mu": 0.0}, r"mu must be in \(0, inf\) Pa, got 0.0"),
        ("Ogden of three terms", {"C": (1.0, -2.0, 3.0)}, r"C\[1\] must be in \(0, inf\) Pa, got -2.0"),
        ("Ogden of three terms", {"C": 1.0}, "C and alpha must have equal, non-zero length, got 1 and 3"),
        ("Ogden of three terms", {"C": (), "alpha": ()}, "equal, non-zero length, got 0 and 0"),
        (
            "Ogden of one term",
            {"alpha": 0},
            r"alpha\[0\] must be nonzero and in \[-100, 100\], got 0",
        ),
        ("Ogden of one term", {"alpha": "steep"}, r"alpha\[0\] must be a number"),
        ("Exponential", {"alpha2": 0.0}, "alpha2 must be .*, got 0"),
        ("Logarithmic", {"alpha1": 200.0}, r"alpha1 must be in \[-100, 100\], got 200.0"),
        ("Logarithmic", {"C2": 0.0}, r"C2 must be in \(0, inf\), got 0.0"),
    ],
)
def test_each_law_refuses_by_name_and_range(name, change, message):
    kind, parameters = LAWS[name]
    with pytest.raises(pt.InputError, match=message):
        kind(**(parameters | change), density=1000.0, poisson=0.3)


def test_a_material_cannot_be_changed(materials):
    with pytest.raises(FrozenInstanceError):
        materials[0].density = 2.0
