"""Scalars of the Cauchy stress of states whose values are known."""

from __future__ import annotations

import numpy as np

from palpate.dynamics.material.stress_measures import pressure_of, von_mises


def test_measures_of_tension_shear_and_pressure():
    tension, shear, pressure = np.zeros((3, 3)), np.zeros((3, 3)), -4.0 * np.eye(3)
    tension[0, 0] = 6.0
    shear[0, 1] = shear[1, 0] = 2.0
    stress = np.array([tension, shear, pressure])
    np.testing.assert_allclose(von_mises(stress), [6.0, 2.0 * np.sqrt(3.0), 0.0], atol=1e-12)
    np.testing.assert_allclose(pressure_of(stress), [-2.0, 0.0, 4.0], atol=1e-12)


def test_measures_do_not_depend_on_the_frame(rotation):
    stress = np.diag([1.0, 2.0, 5.0])[None]
    turned = rotation @ stress @ rotation.T
    np.testing.assert_allclose(von_mises(turned), von_mises(stress))
    np.testing.assert_allclose(pressure_of(turned), pressure_of(stress))
