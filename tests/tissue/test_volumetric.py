"""The forms of U(J): closed forms, derivatives, and rest."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.tissue.volumetric import FORM_BY_NAME, volumetric_form

VOLUMES = np.array([0.05, 0.3, 0.7, 0.9, 0.979, 0.981, 0.999, 1.0, 1.001, 1.019, 1.021, 1.3, 2.0, 2.6])
PRINTED = {
    "quadratic": lambda J: (J - 1) ** 2 / 2,
    "logarithmic": lambda J: np.log(J) ** 2 / 2,
    "mixed": lambda J: (J**2 - 1 - 2 * np.log(J)) / 4,
}


@pytest.fixture(params=list(FORM_BY_NAME))
def form(request):
    return volumetric_form(request.param)


def test_half_the_measure_squared_is_the_printed_energy(form):
    measure, _ = form.measure(VOLUMES - 1)
    np.testing.assert_allclose(measure**2 / 2, PRINTED[form.name](VOLUMES), rtol=1e-11, atol=1e-16)


def test_slopes_are_those_of_the_measure_and_the_energy(form):
    step = 1e-6
    ahead, behind = (form.measure(VOLUMES - 1 + s)[0] for s in (step, -step))
    measure, slope = form.measure(VOLUMES - 1)
    np.testing.assert_allclose(slope * np.ones_like(VOLUMES), (ahead - behind) / (2 * step), rtol=1e-7)
    pressure, bend = form.pressure(VOLUMES - 1)
    np.testing.assert_allclose(pressure, measure * slope, rtol=1e-12, atol=1e-16)
    ahead, behind = (form.pressure(VOLUMES - 1 + s)[0] for s in (step, -step))
    np.testing.assert_allclose(bend * np.ones_like(VOLUMES), (ahead - behind) / (2 * step), rtol=1e-6)


def test_all_forms_have_the_same_value_and_slopes_at_rest(form):
    rest = np.zeros(1)
    assert form.measure(rest)[0] == 0
    assert form.measure(rest)[1] == pytest.approx(1, abs=1e-15)
    assert form.pressure(rest)[1] == pytest.approx(1, abs=1e-15)


def test_the_measure_is_accurate_near_rest(form):
    x = np.array([-1e-9, 1e-9, 1e-5, 0.0199999, 0.0200001])
    measure, slope = form.measure(x)
    bend = {"quadratic": 0.0, "logarithmic": -1.0, "mixed": -1 / 3}[form.name]
    np.testing.assert_allclose(measure[:3], x[:3] * (1 + bend * x[:3] / 2), rtol=1e-9)
    assert measure[4] - measure[3] == pytest.approx(2e-7 * np.ravel(slope)[-1], rel=1e-6)


@pytest.mark.parametrize(
    ("name", "slope"), [("quadratic", -0.2), ("logarithmic", np.log(0.8) / 0.8), ("mixed", (0.8 - 1 / 0.8) / 2)]
)
def test_the_pressure_in_a_body_squeezed_to_four_fifths_is_the_closed_forms(name, slope):
    law = pt.materials.NeoHookean(C1=1.0, density=1000, bulk=300.0, volumetric=name)
    F = np.cbrt(0.8) * np.eye(3)
    pressure = (law.stress(F) - law.shear_stress(F))[0, 0] / law.cofactor(F)[0, 0]
    assert pressure == pytest.approx(law.lame * slope, rel=1e-12)
