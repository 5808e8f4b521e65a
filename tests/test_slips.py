"""Common slips are caught: a load outside a list, an unknown parameter, a value in another unit."""

from __future__ import annotations

import copy
import pickle
import warnings

import numpy as np
import pytest

import palpate as pt
from palpate.core.faults import UnitWarning
from palpate.tissue.catalogue import LAWS


def test_one_load_is_taken_as_a_list_of_one(held, pull):
    one = pt.rollout(held, pull, duration=1e-3, every=5e-4)
    several = pt.rollout(held, [pull], duration=1e-3, every=5e-4)
    np.testing.assert_array_equal(one.displacements, several.displacements)
    assert held.prepare(pull).loads == (pull,)
    assert pt.lti.linearise(held, pull, outputs=["x+"]).loads == (pull,)


@pytest.mark.parametrize("loads", ["x+", None, 3.0, {"x+": 1.0}])
def test_values_that_are_not_a_list_of_loads_are_refused(held, loads):
    with pytest.raises(pt.InputError, match="loads must be a load or a list of loads, got "):
        pt.rollout(held, loads, duration=1e-3, every=5e-4)


def test_loads_may_come_from_a_generator(held, pull):
    assert held.prepare(load for load in (pull, pt.Gravity())).loads == (pull, pt.Gravity())


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_an_unknown_parameter_is_refused_with_all_names_and_the_nearest(law):
    wrong = {f"{name}x": value for name, value in law.example.items()}
    first = next(iter(law.example))
    with pytest.raises(pt.InputError) as caught:
        law.kind(**wrong, density=1000, poisson=0.4)
    said = str(caught.value)
    assert said.endswith(f"got {first}x; did you mean {first}?")
    for name in (*law.example, "density [kg/m^3]", "poisson", "bulk [Pa]", "prony"):
        assert name in said


def test_parameters_of_fibres_and_of_relaxation_are_named_too():
    with pytest.raises(pt.InputError, match=r"Fibres must be among directions, k1 \[Pa\], k2, dispersion, got k3"):
        pt.materials.Fibres(k1=1e3, k3=5.0, directions=(1, 0, 0))
    with pytest.raises(pt.InputError, match=r"times \[s\], bulk_shares, got time; did you mean times\?"):
        pt.materials.Prony(shares=0.5, time=0.1)


def test_parameters_without_names_are_refused_with_the_names():
    with pytest.raises(pt.InputError, match=r"must have names, got 5000.0; give C1=..., density=..., poisson=..."):
        pt.materials.NeoHookean(5e3, 1000, 0.4)


def test_laws_can_be_copied_and_pickled():
    law = pt.materials.Ogden(C=(800.0, 120.0), alpha=(4.0, -7.5), density=1060, poisson=0.45)
    assert pickle.loads(pickle.dumps(law)) == copy.copy(law) == copy.deepcopy(law) == law  # noqa: S301


@pytest.mark.parametrize("size", [40.0, 5e-5])
@pytest.mark.parametrize(
    "make",
    [
        lambda size: pt.box((size, size / 4, size / 4), size / 12),
        lambda size: pt.disc(size / 2, size / 20),
        lambda size: pt.sheet([(0, 0), (size, 0), (size, size), (0, size)], size / 10),
    ],
    ids=["box", "disc", "sheet"],
)
def test_a_body_of_40_m_or_50_um_warns_of_metres(make, size):
    with pytest.warns(UnitWarning, match=rf"size of a body should be .* m, got {size:.4g} m; lengths are in metres"):
        make(size)


def test_a_filled_surface_in_millimetres_warns_of_metres():
    vertices = 200.0 * np.array(
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]]
    )
    triangles = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
                 [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]  # fmt: skip
    with pytest.warns(UnitWarning, match="got 200 m; lengths are in metres"):
        pt.fill((vertices, triangles), 40.0)


@pytest.mark.parametrize("density", [1.0, 1e-6, 1.06e6])
def test_tissue_of_1_kg_per_cubic_metre_warns_of_the_unit(density):
    with pytest.warns(UnitWarning, match=r"density of NeoHookean should be .* kg/m\^3, got"):
        pt.materials.NeoHookean(C1=5e3, density=density, poisson=0.45)


@pytest.mark.parametrize("modulus", [1e9, 0.01])
def test_tissue_of_1_GPa_warns_of_pascals(modulus):
    with pytest.warns(UnitWarning, match="shear modulus of Gent should be .* Pa, got .*; moduli are in pascals"):
        pt.materials.Gent(mu=modulus, Jm=3.0, density=1060, poisson=0.45)


def test_the_warning_names_the_line_of_the_caller():
    with pytest.warns(UnitWarning) as of_a_box:
        pt.box((40.0, 10.0, 10.0), 2.5)
    with pytest.warns(UnitWarning) as of_a_law:
        pt.materials.Yeoh(C1=1e9, C2=0.0, C3=0.0, density=1060, poisson=0.45)
    assert [each.filename for each in (*of_a_box, *of_a_law)] == [__file__] * 2


def test_bodies_and_tissue_of_usual_sizes_do_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for size in (2e-4, 0.2, 2.0):
            pt.box((size, size / 2, size / 2), size / 8)
        for modulus, density in ((50.0, 250.0), (5e3, 1060.0), (5e7, 1900.0)):  # brain and lung, muscle, bone
            pt.materials.NeoHookean(C1=modulus / 2, density=density, poisson=0.45)


def test_a_fit_warns_of_its_result_and_not_of_trial_values():
    stretch = np.linspace(1.0, 1.4, 9)
    law = pt.materials.NeoHookean(C1=5e3, density=1060, poisson=0.45)
    stress = 2 * law.C1 * (stretch - stretch**-2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pt.materials.fit(
            pt.materials.Yeoh,
            pt.materials.Measurement(kind="uniaxial", deformation=stretch, stress=stress),
            bounds={"C1": (1e-6, 1e12)},
        )
    with pytest.warns(UnitWarning, match="shear modulus of NeoHookean"):
        pt.materials.fit(
            pt.materials.NeoHookean, pt.materials.Measurement(kind="uniaxial", deformation=stretch, stress=1e6 * stress)
        )
