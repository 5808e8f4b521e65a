"""Laws of the isochoric strain: the chain rule, rest, and what a change of volume alone costs."""

from __future__ import annotations

import json

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.jit import law_digest
from palpate.reduction.storage.material import describe_material, material_of
from palpate.tissue.catalogue import LAWS
from palpate.tissue.volumetric import volumetric_form

KINDS = {law.name: law for law in LAWS if law.name != "LinearElastic"}
ORDER = {"invariants": [0, 1, 3, 1, 2, 4, 3, 4, 5], "stretches": [0, 3, 4, 3, 1, 5, 4, 5, 2]}
LOW, HIGH = (
    {"invariants": (3.1, 3.1, 0.7), "stretches": (0.7,) * 3},
    {"invariants": (4.5, 4.5, 1.4), "stretches": (1.4,) * 3},
)


def made(name, **changes):
    return getattr(pt.materials, name)(
        **KINDS[name].example, density=1000.0, **{"poisson": 0.45, "split": "isochoric"} | changes
    )


def differences(function, place):
    step = 1e-5
    turns = step * np.eye(3)
    ahead, behind = (np.array([function(*(place + s * t)) for t in turns]) for s in (1, -1))
    return ((ahead - behind) / (2 * step)).T


@pytest.mark.parametrize("name", KINDS)
def test_derivatives_are_those_of_the_energy_at_random_states(name, deformations):
    material = made(name)
    law, c = material.law, material.coefficients
    random = np.random.default_rng(4)
    for place in random.uniform(LOW[law.variables], HIGH[law.variables], (12, 3)):
        first, second = np.array(law.first(*place, c), dtype=float), np.array(law.second(*place, c), dtype=float)
        size = material.shear_modulus
        np.testing.assert_allclose(first, differences(lambda *i: law.energy(*i, c), place), rtol=1e-6, atol=1e-6 * size)
        expected = differences(lambda *i: law.first(*i, c), place)
        np.testing.assert_allclose(second[ORDER[law.variables]].reshape(3, 3), expected, rtol=1e-6, atol=1e-6 * size)
    for F in deformations:
        slope = np.empty((3, 3))
        for i, j in np.ndindex(3, 3):
            turn = np.zeros((3, 3))
            turn[i, j] = 1e-5
            slope[i, j] = (material.strain_energy(F + turn) - material.strain_energy(F - turn)) / 2e-5
        np.testing.assert_allclose(material.stress(F), slope, atol=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize("name", KINDS)
def test_rest_has_no_stress_and_a_change_of_volume_only_the_volumetric_stress(name):
    material = made(name, volumetric="mixed")
    assert material.lame == material.bulk_modulus
    np.testing.assert_allclose(material.stress(np.eye(3)), 0, atol=1e-9 * material.shear_modulus)
    for J in (0.3, 0.8, 1.5, 3.0):
        slope, _ = volumetric_form("mixed").pressure(J - 1)
        expected = material.bulk_modulus * slope * J ** (2 / 3) * np.eye(3)
        np.testing.assert_allclose(
            material.stress(np.cbrt(J) * np.eye(3)), expected, atol=1e-9 * expected[0, 0].__abs__()
        )


@pytest.mark.parametrize("name", KINDS)
def test_an_isochoric_law_is_the_coupled_law_of_the_isochoric_strain(name, deformations):
    whole = deformations / np.cbrt(np.linalg.det(deformations))[:, None, None]
    coupled = made(name, split="coupled").shear_energy(whole)
    np.testing.assert_allclose(made(name).shear_energy(whole), coupled, rtol=1e-12)
    np.testing.assert_allclose(made(name).shear_energy(deformations), coupled, rtol=1e-9)


@pytest.mark.parametrize("name", ["NeoHookean", "Ogden"])
def test_small_strain_has_the_declared_moduli(name):
    material, step = made(name), 1e-5
    shear = (material.stress(np.eye(3) + step * np.eye(3, k=1)) - material.stress(np.eye(3))) / step
    assert shear[0, 1] == pytest.approx(material.shear_modulus, rel=1e-4)
    pull = np.diag([1, -material.poisson, -material.poisson])
    slope = np.diag(material.stress(np.eye(3) + 1e-6 * pull)) / 1e-6
    young = 2 * material.shear_modulus * (1 + material.poisson)
    np.testing.assert_allclose(slope, [young, 0, 0], atol=2e-3 * young)


def test_an_energy_that_is_written_down_may_be_isochoric():
    symbolic = pt.materials.Hyperelastic(
        "C1*(I1 - 3)", C1=5e3, density=1e3, poisson=0.45, split="isochoric"
    )  # coupled it has stress
    bars = pt.materials.Hyperelastic("C1*(I1bar - 3)", C1=5e3, density=1e3, poisson=0.45)
    F = np.eye(3) + np.random.default_rng(0).uniform(-0.3, 0.3, (3, 3))
    np.testing.assert_allclose(symbolic.stress(F), bars.stress(F), rtol=1e-9)


def test_coupled_and_isochoric_laws_have_different_digests():
    laws = [made(name, split=split).law for name in ("NeoHookean", "Gent") for split in ("coupled", "isochoric")]
    assert len({law_digest(__name__, law.first) for law in laws}) == 4
    assert made("Gent").law is made("Gent", poisson=0.3).law


@pytest.mark.parametrize("split", ["coupled", "isochoric"])
def test_the_split_of_a_law_is_stored(split):
    material = made("Gent", split=split)
    said = describe_material(material)
    again = material_of(said["material"], json.loads(said["parameters"]), said["expression"], {})
    assert again == material
    assert ("split" in json.loads(said["parameters"])) == (split == "isochoric")


@pytest.mark.parametrize(
    ("law", "split", "message"),
    [
        (pt.materials.NeoHookean, "deviatoric", "split must be 'coupled' or 'isochoric', got 'deviatoric'"),
        (pt.materials.LinearElastic, "isochoric", "split must be 'coupled' for small strain"),
    ],
)
def test_unknown_splits_are_refused(law, split, message):
    with pytest.raises(pt.InputError, match=message):
        law(**({"C1": 1.0} if law is pt.materials.NeoHookean else {"mu": 1.0}), density=1.0, poisson=0.4, split=split)
