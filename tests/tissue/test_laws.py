"""The printed laws, by closed forms, and what the list of laws says."""

from __future__ import annotations

from inspect import isabstract
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.tissue.catalogue import LAWS

STRETCHES = np.linspace(0.6, 1.6, 21)
KINDS = {law.name: law for law in LAWS}


def made(name, **changes):
    return getattr(pt.materials, name)(**KINDS[name].example | changes, density=1000.0, poisson=0.45)


def isochoric(l1, l2):
    """Deformation gradients with these stretches that keep the volume, turned to no axis."""
    q, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    return q @ (np.stack([l1, l2, 1 / (l1 * l2)], axis=-1)[..., None] * np.eye(3)) @ q.T


PRINTED = [law.name for law in LAWS if law.expression]


def printed(name, l1, l2):
    """Return the energy of a law by the catalogue's expression, with the volume kept."""
    l3 = 1 / (l1 * l2)
    I1 = l1**2 + l2**2 + l3**2

    def q(a):
        return l1**a + l2**a + l3**a - 3

    values = {"I1": I1, "I2": q(-2) + 3, "J": 1.0, "x": I1 - 3, "q": q, "l1": l1, "l2": l2, "l3": l3}
    return eval(KINDS[name].expression, {**values, "log": np.log, "exp": np.exp, **KINDS[name].example})


@pytest.mark.parametrize("name", PRINTED)
def test_the_energy_is_the_printed_one_where_the_volume_stays(name):
    material = made(name)
    for l1, l2 in ((STRETCHES, STRETCHES**-0.5), (STRETCHES, STRETCHES), (STRETCHES, 1 / STRETCHES)):
        inside = l1**2 + l2**2 + (l1 * l2) ** -2 - 3 < 2.5  # of the limits of Gent and of the logarithm
        expected = printed(name, l1[inside], l2[inside])
        energy = material.strain_energy(isochoric(l1, l2)[inside])
        np.testing.assert_allclose(energy, expected, rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("name", PRINTED)
def test_uniaxial_and_equibiaxial_stress_are_derivatives_of_the_printed_energy(name):
    """With the volume kept, t_1 - t_3 = l1 dw/dl1 of the energy w(l1, l2) of the printed law."""
    material = made(name)
    step = 1e-6
    for l1, l2 in ((1.4, 1.4**-0.5), (0.7, 0.7**-0.5), (1.25, 1.25), (1.2, 1 / 1.2)):
        slope = np.subtract(*(printed(name, l1 + s, l2) for s in (step, -step)))
        F = np.diag([l1, l2, 1 / (l1 * l2)])
        cauchy = material.stress(F) @ F.T
        expected = l1 * slope / (2 * step)
        assert cauchy[0, 0] - cauchy[2, 2] == pytest.approx(expected, rel=1e-6, abs=1e-3)


@pytest.mark.parametrize("name", [law.name for law in LAWS if law.kind.variables != "small strain"])
@pytest.mark.parametrize("gamma", [0.2, 1.0])
def test_simple_shear_obeys_the_universal_relation(name, gamma):
    """Of every isotropic law: t_11 - t_22 = gamma t_12 (Rivlin)."""
    F = np.eye(3) + gamma * np.outer([1, 0, 0], [0, 1, 0])
    cauchy = made(name).stress(F) @ F.T
    assert cauchy[0, 1] > 0
    assert cauchy[0, 0] - cauchy[1, 1] == pytest.approx(gamma * cauchy[0, 1], rel=1e-10)


def test_ogden_with_the_exponent_2_is_neo_hookean(deformations):
    one, other = made("Ogden", C=5e3, alpha=2), made("NeoHookean", C1=5e3)
    np.testing.assert_allclose(one.stress(deformations), other.stress(deformations), rtol=1e-9, atol=1e-6)


def test_ogden_with_the_exponents_2_and_minus_2_is_mooney_rivlin_where_the_volume_stays():
    F = isochoric(STRETCHES, STRETCHES**0.3)
    one, other = made("Ogden", C=(4e3, 1e3), alpha=(2, -2)), made("MooneyRivlin", C1=8e3, C2=2e3)
    np.testing.assert_allclose(one.strain_energy(F), other.strain_energy(F), rtol=1e-9, atol=1e-8)


def test_laws_with_a_limit_become_neo_hookean_far_from_it(deformations):
    neo = made("NeoHookean", C1=5e3).stress(deformations)
    for name, far in (("Gent", {"Jm": 1e9}), ("ArrudaBoyce", {"mu": 1e4, "N": 1e9}), ("Fung", {"b": 1e-9})):
        np.testing.assert_allclose(made(name, **far).stress(deformations), neo, rtol=1e-6, atol=1e-2)


@pytest.mark.parametrize(("name", "change"), [("Gent", {"Jm": 3.0}), ("Logarithmic", {"C2": 1 / 3, "C3": 0.0})])
def test_energy_stress_and_stiffness_continue_beyond_the_limit(name, change):
    """The two laws with the exponent 2 are the same; their limit is x = 3."""
    material = made(name, **change)
    share = np.linspace(0.9, 1.5, 4001)
    l1 = np.array([_pulled(3 * y) for y in share])
    F = isochoric(l1, l1**-0.5)
    energy = material.strain_energy(F)
    x = 3 * share
    slope, stiffness = np.gradient(energy, x), np.gradient(np.gradient(energy, x), x)
    assert np.isfinite(energy).all()
    assert np.diff(energy).min() > 0
    inner = slice(5, -5)
    assert np.abs(np.diff(slope))[inner].max() < 0.02 * slope[inner].max()
    assert np.abs(np.diff(stiffness))[inner].max() < 0.02 * stiffness[inner].max()
    assert stiffness[inner].min() > 0


def _pulled(x):
    """Stretch l with l^2 + 2/l - 3 = x."""
    return max(np.roots([1.0, 0.0, -3.0 - x, 2.0]).real)


def test_every_law_is_listed_with_its_parameters():
    for law in LAWS:
        assert getattr(pt.materials, law.name) is law.kind
        assert [p.name for p in law.parameters] == list(law.example)
        assert law.formula
        assert law.expression or law.kind.variables == "small strain"
        assert law.reference
        assert made(law.name).shear_modulus == pytest.approx(10e3, rel=0.35)


def test_every_public_law_is_in_the_catalogue():
    public = [getattr(pt.materials, name) for name in pt.materials.__all__]
    laws = [
        each
        for each in public
        if isinstance(each, type) and issubclass(each, pt.materials.Material) and not isabstract(each)
    ]
    assert {law.kind for law in LAWS} == set(laws) - {pt.materials.VolumeOnly}


def test_listed_ranges_are_those_of_the_laws():
    (C, alpha) = KINDS["Ogden"].parameters
    assert (C.unit, C.range) == ("Pa", "(0, inf)")
    assert (alpha.unit, alpha.range) == ("", "[-100, 100]")


def test_the_documentation_names_every_law_with_its_source():
    text = (Path(__file__).parents[2] / "docs" / "reference" / "laws.md").read_text()
    for law in LAWS:
        assert f"`{law.name}`" in text
        assert law.reference.split(",")[0].split(";")[0] in text
