"""What a file says of its tissue: materials, regions and fibres come back as they were; anything else is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.storage.material import (
    describe_fibres,
    describe_material,
    describe_regions,
    fibres_of,
    material_of,
    regions_of,
)
from palpate.tissue.catalogue import FIBRE_LAWS, LAWS
from palpate.tissue.fibres import VolumeOnly
from palpate.tissue.regions import Regions

REST = {"density": 1000.0, "poisson": 0.45}
SERIES = pt.materials.Prony(shares=(0.6, 0.3), times=(2e-3, 2e-2))
pytestmark = pytest.mark.filterwarnings("ignore::palpate.core.faults.UnitWarning")  # of damaged numbers

MATERIALS = [
    *(law.kind(**law.example, **REST, prony=SERIES) for law in LAWS),
    VolumeOnly(mu=1e3, **REST),
    pt.materials.Ogden(C=(800.0, 120.0), alpha=(4.0, -7.5), **REST, volumetric="mixed", split="isochoric"),
    pt.materials.NeoHookean(C1=5e3, density=1000, poisson=0.5),
    pt.materials.Hyperelastic("C1*(I1bar - 3) + C2*(I2bar - 3)", C1=5e3, C2=1e3, **REST),
]
DIRECTIONS = np.tile([1.0, 0.0, 0.0], (1, 4, 1))


def said_of(material):
    said = describe_material(material)
    return said["material"], json.loads(said["parameters"]), said["expression"], json.loads(said["prony"])


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_a_material_is_restored_from_its_description(material):
    assert material_of(*said_of(material)) == material


HOSTILE = (
    None, True, False, 0, -1, 5, 2**70, 10**400, -(10**5000), 0.0, -0.0, 0.5, 0.45, 1e-308, 5e-324, 1e300, 1.7e308,
    -1e300, math.nan, math.inf, -math.inf, "", "5", "NeoHookean", "quadratic", "isochoric", "\ud800", "a" * 9000,
    "9**9**9", [], {}, [[]], [None], ["5"], [True], [1.0], [1.0, [2.0]], [1e3] * 5000,
    {"shares": 1}, {"": []}, {"law": "Fibres"}, (1,),
)  # fmt: skip
PLACES = (
    "poisson", "bulk", "density", "C1", "C", "alpha", "mu", "prony", "shares", "times", "bulk_shares", "law", "k1",
    "volumetric", "split", "directions", "__class__", "self",
)  # fmt: skip


def deep(levels):
    value = []
    for _ in range(levels):
        value = [value]
    return value


def hostile(rng, depth=3):
    """Any value that JSON has, and some that it has not."""
    kind = rng.integers(0, 10)
    if depth == 0 or kind < 7:
        return deep(3000) if rng.integers(200) == 0 else HOSTILE[rng.integers(len(HOSTILE))]
    count = rng.integers(0, 4)
    if kind == 7:
        return [hostile(rng, depth - 1) for _ in range(count)]
    return {PLACES[rng.integers(len(PLACES))]: hostile(rng, depth - 1) for _ in range(count)}


def damaged(rng, value):
    """The same with another value in one of its places, or one more or less."""
    if rng.integers(4) == 0 or not isinstance(value, dict | list) or not value:
        return hostile(rng)
    copy = value.copy()
    place = list(copy)[rng.integers(len(copy))] if isinstance(copy, dict) else rng.integers(len(copy))
    change = rng.integers(8)
    if change == 0:
        del copy[place]
    elif change == 1 and isinstance(copy, dict):
        copy[PLACES[rng.integers(len(PLACES))]] = hostile(rng)
    else:
        copy[place] = damaged(rng, copy[place])
    return copy


def made_or_refused(make):
    """What is made, None if it is refused in one line; any other exception, or warning, is a failure."""
    try:
        return make()
    except pt.InputError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 500
    return None


def test_forged_descriptions_give_a_material_or_are_refused():
    rng, made = np.random.default_rng(0), 0
    for _ in range(4000):
        said = list(said_of(MATERIALS[rng.integers(len(MATERIALS))]))
        place = rng.choice([0, 1, 1, 1, 1, 2, 3])
        said[place] = damaged(rng, said[place])
        material = made_or_refused(lambda: material_of(*said))  # noqa: B023 - called at once
        if material is not None:
            made += 1
            assert 0 < material.shear_modulus < math.inf
            assert math.isfinite(material.lame) or material.incompressible
            assert np.isfinite(material.coefficients).all()
            assert all(isinstance(number, float) for number in (material.density, material.poisson, material.bulk))
    assert 20 < made < 2000


def test_forged_descriptions_give_regions_or_are_refused():
    first = MATERIALS[0]
    materials = (first, replace(first, C1=9e3, bulk=None), replace(first, C1=2e3, bulk=None))
    which = np.array([0, 1, 2, 1, 0])
    said = json.loads(describe_regions(Regions(materials, which)))
    assert regions_of(said, which, first).materials == materials
    rng = np.random.default_rng(1)
    for _ in range(1500):
        made_or_refused(lambda: regions_of(damaged(rng, said), which, first))


def test_more_materials_than_nodes_are_refused():
    material = MATERIALS[0]
    one = said_of(material)[1]
    with pytest.raises(pt.InputError, match="100000 materials for 3 nodes: allowed is one for each"):
        regions_of([one] * 100_000, np.zeros(3, dtype=int), material)


@pytest.mark.parametrize("law", FIBRE_LAWS, ids=lambda law: law.name)
def test_forged_descriptions_give_fibres_or_are_refused(law):
    fibres = law.kind(**law.example, directions=DIRECTIONS)
    said = json.loads(describe_fibres(fibres))
    assert fibres_of(said, DIRECTIONS).coefficients == fibres.coefficients
    rng = np.random.default_rng(2)
    for _ in range(1500):
        made_or_refused(lambda: fibres_of(damaged(rng, said), DIRECTIONS))


@pytest.mark.parametrize(
    "directions",
    [np.zeros(()), np.zeros((1, 4)), DIRECTIONS * np.nan, 2 * DIRECTIONS, DIRECTIONS[:, :, :2], np.ones((3, 4, 3)),
     np.full((1, 4, 3), "a"), DIRECTIONS * 1j, DIRECTIONS * 1e200],
)  # fmt: skip
def test_invalid_directions_are_refused(directions):
    with pytest.raises(pt.InputError, match="directions of fibres"):
        fibres_of({"law": "Fibres", "k1": 1e3, "k2": 1.0, "dispersion": 0.0}, directions)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"bulk": []}, r"bulk must be a number, got \(\)"),
        ({"bulk": "5"}, "bulk must be a number, got '5'"),
        ({"density": True}, "density must be a number, got True"),
        ({"C1": 10**400}, "C1 must be a number"),
        ({"C1": 1.7e308}, "shear modulus at rest must be .*, got inf"),
        ({"volumetric": []}, r"volumetric must be one of .*, got \[\]"),
        ({"split": {}}, r"split must be .*, got \{\}"),
        ({"energy": 1.0}, "NeoHookean has the parameters"),
    ],
)
def test_an_invalid_value_is_named(parameters, message):
    name, own, expression, prony = said_of(MATERIALS[0])
    with pytest.raises(pt.InputError, match=message):
        material_of(name, own | parameters, expression, prony)


def test_too_many_terms_or_branches_are_refused():
    rest = said_of(pt.materials.Ogden(C=1e3, alpha=2.0, **REST))[1]
    with pytest.raises(pt.InputError, match="C must have at most 16 entries, got 5000"):
        material_of("Ogden", rest | {"C": [1e3] * 5000, "alpha": [2.0] * 5000}, "", {})
    with pytest.raises(pt.InputError, match="shares must have at most 64 entries, got 5000"):
        material_of("Ogden", rest, "", {"shares": [0.1] * 5000, "times": [0.1] * 5000})


def test_an_invalid_energy_of_a_file_is_refused_as_that_of_a_user():
    with pytest.raises(pt.InputError, match=r"energy must be text, got \['I1bar'\]"):
        material_of("Hyperelastic", {}, ["I1bar"], {})
    with pytest.raises(pt.InputError, match="must be an expression of"):
        material_of("Hyperelastic", {}, "().__class__ + I1bar", {})
