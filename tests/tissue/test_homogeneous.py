"""Nominal stress in homogeneous tests, against closed forms, limits and the law's own stress."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.tissue.homogeneous import (
    DEFORMATION_KINDS,
    compressible,
    deformation_gradient,
    isochoric_stress,
    nominal_stress,
    rest,
)

STRETCHES = np.array([0.3, 0.7, 0.95, 1.0, 1.1, 1.8, 4.0])
C1, C2 = 8e3, 3e3  # of a Mooney-Rivlin law [Pa]

# Stress of the incompressible Mooney-Rivlin law of (16): a factor times C1 + C2 times another stretch
CLOSED = {
    "uniaxial": lambda s: (s - s**-2) * (C1 + C2 / s),
    "equibiaxial": lambda s: (s - s**-5) * (C1 + C2 * s**2),
    "planar": lambda s: (s - s**-3) * (C1 + C2),
    "shear": lambda gamma: gamma * (C1 + C2),
}
STRETCHED = [kind for kind in DEFORMATION_KINDS if kind != "shear"]


def tissue(poisson):
    return pt.materials.MooneyRivlin(C1=C1, C2=C2, density=1000, poisson=poisson)


@pytest.mark.parametrize("kind", DEFORMATION_KINDS)
def test_an_incompressible_law_has_the_stress_of_the_closed_form(kind):
    deformation = STRETCHES - (kind == "shear")
    expected = CLOSED[kind](deformation)
    np.testing.assert_allclose(nominal_stress(tissue(0.5), kind, deformation), expected, rtol=1e-12, atol=1e-8)
    assert compressible(tissue(0.5)).poisson == 0.25


@pytest.mark.parametrize("kind", STRETCHED)
@pytest.mark.parametrize("poisson", [0.2, 0.3, 0.45, 0.49, 0.499])
def test_a_compressible_specimen_has_no_stress_on_its_free_sides(kind, poisson):
    material, stretches = tissue(poisson), STRETCHES[1:-1]
    F = deformation_gradient(material, kind, stretches)
    P = material.stress(F)
    np.testing.assert_allclose(P[:, 2, 2], 0, atol=1e-9 * material.bulk_modulus)
    np.testing.assert_allclose(
        nominal_stress(material, kind, stretches), P[:, 0, 0], rtol=1e-8, atol=1e-12 * material.bulk_modulus
    )
    held = {"uniaxial": F[:, 2, 2], "equibiaxial": stretches, "planar": np.ones_like(stretches)}[kind]
    np.testing.assert_allclose(F[:, 1, 1], held, rtol=1e-14)
    np.testing.assert_array_equal(F[:, 0, 0], stretches)


@pytest.mark.parametrize("kind", STRETCHED)
def test_stress_converges_to_the_incompressible_one_linearly_in_the_compressibility(kind):
    limit = nominal_stress(tissue(0.5), kind, STRETCHES[1:-1])
    away = []
    for share in (2e-2, 4e-3):  # of the shear modulus in the bulk modulus
        material = pt.materials.MooneyRivlin(C1=C1, C2=C2, density=1000, bulk=(C1 + C2) / share)
        away.append(np.abs(nominal_stress(material, kind, STRETCHES[1:-1]) - limit).max() / np.abs(limit).max())
    assert away[0] < 0.15
    assert away[1] == pytest.approx(away[0] / 5, rel=0.2)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.49, 0.5])
def test_small_deformations_have_the_slopes_of_linear_elasticity(poisson):
    material, small = tissue(poisson), 1e-6
    mu = material.shear_modulus
    young = 2 * mu * (1 + poisson)
    slopes = {
        "uniaxial": young,
        "equibiaxial": young / (1 - poisson),
        "planar": young / (1 - poisson**2),
        "shear": mu,
    }
    for kind, slope in slopes.items():
        ends = rest(kind) + np.array([-small, small])
        found = np.diff(nominal_stress(material, kind, ends)) / (2 * small)
        np.testing.assert_allclose(found, slope, rtol=1e-6, err_msg=kind)


@pytest.mark.parametrize("kind", DEFORMATION_KINDS)
def test_a_specimen_at_rest_has_no_stress(kind):
    for poisson in (0.3, 0.5):
        np.testing.assert_allclose(nominal_stress(tissue(poisson), kind, [rest(kind)]), 0, atol=1e-8)


@pytest.mark.parametrize("kind", DEFORMATION_KINDS)
def test_the_isochoric_stress_does_not_depend_on_the_compressibility(kind):
    deformation = STRETCHES - (kind == "shear")
    expected = isochoric_stress(tissue(0.5), kind, deformation)
    for poisson in (0.1, 0.49):
        np.testing.assert_allclose(isochoric_stress(tissue(poisson), kind, deformation), expected, rtol=1e-9, atol=1e-6)


def test_the_work_of_the_testing_machine_is_the_gain_of_energy():
    material = tissue(0.4)
    stretches = np.linspace(1, 1.6, 2001)
    energy = material.strain_energy(deformation_gradient(material, "uniaxial", stretches))
    stress = nominal_stress(material, "uniaxial", stretches)
    work = np.sum((stress[1:] + stress[:-1]) / 2 * np.diff(stretches))
    assert energy[-1] - energy[0] == pytest.approx(work, rel=1e-6)


def test_stress_is_nan_where_no_side_stretch_frees_the_sides():
    # without Poisson effect the bulk term of this law is negative: pulled far, the sides never come to rest
    material = pt.materials.MooneyRivlin(C1=1e3, C2=1e4, density=1000, poisson=0.0)
    stress = nominal_stress(material, "equibiaxial", [1.05, 4.0])
    assert np.isfinite(stress[0])
    assert np.isnan(stress[1])


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        ("torsion", [1.1], "kind must be one of uniaxial, equibiaxial, planar, shear, got 'torsion'"),
        ("uniaxial", [1.1, 0.0], r"stretch must be in \(0, inf\), got 0"),
        ("planar", [np.nan], "stretch must be .*, got nan"),
    ],
)
def test_an_unknown_test_or_stretch_is_refused(kind, values, message):
    with pytest.raises(pt.InputError, match=message):
        nominal_stress(tissue(0.3), kind, values)
