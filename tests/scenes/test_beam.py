"""The paper's beam, as printed."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.scenes.beam import beam, pull

COARSE = 0.02 / 3


@pytest.fixture(scope="module")
def case():
    return beam(spacing=COARSE, load=2.0)


@pytest.mark.parametrize("time", [0.0, 0.1, 0.4999, 0.5, 0.7, 1.0])
def test_the_pull_is_equation_33(time):
    printed = 200 * time if time < 0.5 else 200 * (1 - time)
    assert pull(time) == pytest.approx(printed, abs=1e-12)


def test_the_pull_is_zero_outside_the_run():
    assert pull(-0.1) == 0.0
    assert pull(1.1) == 0.0


@pytest.mark.slow
def test_the_body_has_the_size_mass_and_stiffness_printed(case):
    np.testing.assert_allclose(np.ptp(case.model.cloud.points, axis=0), (0.2, 0.02, 0.02))
    assert case.model.masses.sum() == pytest.approx(1120 * 0.2 * 0.02**2)
    assert case.model.material.shear_modulus == pytest.approx(61.2e3)
    assert case.model.fixed == ("x-",)
    assert (case.duration, case.every) == (1.0, 0.01)


def test_the_load_pulls_on_the_free_end_along_the_axis(case):
    prepared = case.model.prepare(case.loads)
    half = prepared.schedule(np.array([0.25])).amplitudes[0, 0]
    np.testing.assert_allclose(half, (1.0, 0.0, 0.0))
    assert case.loads[0].group == "x+"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("spacing", 0.01),
        ("spacing", 0.0),
        ("spacing", 1e-6),
        ("spacing", np.nan),
        ("load", 0.0),
        ("load", 1e6),
        ("load", np.inf),
        ("poisson", 0.6),
        ("poisson", -0.1),
    ],
)
def test_values_out_of_range_are_refused_by_name_and_range(name, value):
    with pytest.raises(pt.InputError, match=rf"{name} must be .*, got"):
        beam(**{name: value})
