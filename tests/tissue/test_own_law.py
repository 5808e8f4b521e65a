"""Laws of one's own: their functions are those of the same built-in law, and what is no energy is refused."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import palpate as pt
from palpate import Hyperelastic

REST = {"density": 1000.0, "poisson": 0.45}
TWINS = {
    "neo": ("C1*(I1 - 3) - 2*C1*log(J)", {"C1": 5e3}, lambda p: pt.NeoHookean(**p, **REST)),
    "mooney": (
        "C1/2*(I1 - 3) + C2/2*(I2 - 3) - (C1 + 2*C2)*log(J)", {"C1": 8e3, "C2": 2e3},
        lambda p: pt.MooneyRivlin(**p, **REST),
    ),
    "yeoh": (
        "C1*(I1 - 3 - 2*log(J)) + C2*(I1 - 3 - 2*log(J))**2 + C3*(I1 - 3 - 2*log(J))**3",
        {"C1": 5e3, "C2": 1e3, "C3": 200.0}, lambda p: pt.Yeoh(**p, **REST),
    ),
    "fung": ("mu/(2*b)*(exp(b*(I1 - 3 - 2*log(J))) - 1)", {"mu": 1e4, "b": 0.6}, lambda p: pt.Fung(**p, **REST)),
    "ogden": (
        "C*(l1**a + l2**a + l3**a - 3 - a*log(l1*l2*l3))", {"C": 800.0, "a": 4.0},
        lambda p: pt.Ogden(C=p["C"], alpha=p["a"], **REST),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TWINS)
def test_it_is_the_built_in_law_of_the_same_energy(name, deformations):
    text, parameters, built_in = TWINS[name]
    own, other = Hyperelastic(text, **parameters, **REST), built_in(parameters)
    np.testing.assert_allclose(own.strain_energy(deformations), other.strain_energy(deformations), rtol=1e-10)
    np.testing.assert_allclose(own.stress(deformations), other.stress(deformations), rtol=1e-9, atol=1e-7)
    assert own.shear_modulus == pytest.approx(other.shear_modulus, rel=1e-12)
    assert own.shear_bulk_modulus == pytest.approx(other.shear_bulk_modulus, rel=1e-12)
    assert own.bulk == pytest.approx(other.bulk, rel=1e-12)


@pytest.mark.parametrize(("name", "form"), [("mooney", "strong"), ("ogden", "energy")])
def test_a_body_of_it_has_the_forces_of_the_built_in_law(name, form):
    text, parameters, built_in = TWINS[name]
    cloud = pt.box((0.03, 0.01, 0.01), 0.0025)
    own = pt.FullModel(cloud, Hyperelastic(text, **parameters, **REST), "x-", form=form, viscosity=1e-5)
    other = pt.FullModel(cloud, built_in(parameters), "x-", form=form, viscosity=1e-5)
    u = 0.1 * np.sin(60 * cloud.points) * 0.01
    expected = other.force(u)
    np.testing.assert_allclose(own.force(u), expected, atol=1e-9 * np.abs(expected).max())


def test_isochoric_invariants_do_not_change_with_the_volume(deformations):
    own = Hyperelastic("C1*(I1bar - 3) + C2*(I2bar**1.5 - 3*sqrt(3))", C1=5e3, C2=100.0, **REST)
    np.testing.assert_allclose(own.shear_energy(1.3 * deformations), own.shear_energy(deformations), rtol=1e-12)
    assert own.shear_bulk_modulus == pytest.approx(0, abs=1e-8)


def test_the_stress_is_the_slope_of_the_energy(deformations):
    own = Hyperelastic("C1*(I1bar - 3) + C2*sinh(I2bar - 3)**2 + k*(J - 1)**4", C1=5e3, C2=900.0, k=1e3, **REST)
    step = 1e-6
    for F in deformations:
        for i in np.ndindex(3, 3):
            change = np.zeros((3, 3))
            change[i] = step
            slope = (own.strain_energy(F + change) - own.strain_energy(F - change)) / (2 * step)
            assert own.stress(F)[i] == pytest.approx(slope, rel=1e-6, abs=1e-2)


def test_one_text_is_one_class_whatever_its_parameters_and_spaces():
    one, two = (Hyperelastic("C1 * (I1bar-3)", C1=c, **REST) for c in (1.0, 2.0))
    assert type(one) is type(two)
    assert (one.C1, two.C1) == (1.0, 2.0)
    assert type(Hyperelastic("C1  *  (I1bar-3)", C1=1.0, **REST)) is type(one)
    assert one.expression == "C1 * (I1bar-3)"


REFUSED = {
    "stress at rest": ("C1*(I1 - 3)", {"C1": 1.0}, r"stress of 2 Pa at rest: write it in I1bar"),
    "stretches at rest": ("C1*(l1 + l2 + l3)", {"C1": 1.0}, r"stress of 1 Pa at rest: subtract"),
    "no text": (3.0, {}, r"write it down as text"),
    "no expression": ("C1*(I1bar - 3", {"C1": 1.0}, r"cannot be read"),
    "a call": ("I1bar + __import__('os').getpid()", {}, r"which no energy may have"),
    "an attribute": ("I1bar.real", {}, r"'I1bar.real', which no energy may have"),
    "a string": ("I1bar + 'a'", {}, r"which no energy may have"),
    "a function": ("abs(I1bar)", {}, r"the function abs: it may have exp, log"),
    "two kinds": ("I1bar + l1", {}, r"of invariants and of stretches"),
    "no deformation": ("C1", {"C1": 1.0}, r"does not depend on the deformation"),
    "anisotropic": ("C1*(l1 - log(l1))", {"C1": 1.0}, r"not isotropic"),
    "missing": ("C1*(I1bar - 3)", {}, r"parameter C1 is missing"),
    "unknown": ("C1*(I1bar - 3)", {"C1": 1.0, "C2": 2.0}, r"C2 = 2.0 is no parameter of the energy"),
    "no number": ("C1*(I1bar - 3)", {"C1": "a"}, r"C1 must be a number"),
    "infinite": ("C1*log(J - 1) + I1bar", {"C1": 1.0}, r"not finite at rest"),
    "singular slope": ("C1*sqrt(I1bar - 3)", {"C1": 1.0}, r"not finite at rest"),
    "soft": ("-C1*(I1bar - 3)", {"C1": 1.0}, r"shear modulus of -2 Pa"),
    "long": ("I1bar" + " + 1" * 2000, {}, r"characters; 4000 are allowed"),
}


def test_a_law_that_gives_way_is_refused_with_a_report_unless_it_is_wanted():
    text, parameters = "C1*(I1bar - 3) - C2*(I1bar - 3)**2", {"C1": 5e3, "C2": 3e4}
    with pytest.raises(pt.InputError, match=r"not elliptic, worst at principal stretches"):
        Hyperelastic(text, **parameters, **REST)
    assert Hyperelastic(text, stable=(0.97, 1.03), **parameters, **REST).C2 == 3e4
    assert Hyperelastic(text, stable=None, **parameters, **REST).C2 == 3e4


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_energy_is_refused(case):
    text, parameters, message = REFUSED[case]
    with pytest.raises(pt.InputError, match=message):
        Hyperelastic(text, **parameters, **REST)


def test_another_process_finds_the_compiled_law_in_the_cache(tmp_path):
    script = """
import sys, palpate as pt
from palpate import Hyperelastic
law = Hyperelastic("C1*(I1bar - 3) + C2*(I1bar - 3)**2", C1=5e3, C2=1e3, density=1000, poisson=0.45)
body = pt.FullModel(pt.box((0.03, 0.01, 0.01), 0.0025), law, "x-", form="energy", viscosity=1e-5)
force = body._internal_force
body.force(body.cloud.points * 0)
print(sum(force.stats.cache_hits.values()), sum(force.stats.cache_misses.values()))
"""
    environment = {"NUMBA_CACHE_DIR": str(tmp_path), "PATH": "", "PYTHONPATH": ":".join(sys.path)}
    said = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True)
        for _ in range(2)
    ]
    assert [run.stdout.split() for run in said] == [["0", "1"], ["1", "0"]]
