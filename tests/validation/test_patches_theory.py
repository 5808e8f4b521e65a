"""Closed forms of the contact of a paraboloid: Hertz's limit, and the known solutions of a ball and a half-space."""

from __future__ import annotations

import numpy as np
import patches_theory as theory
import pytest

SHEAR_MODULUS, POISSON = 2200.0, 0.45


@pytest.mark.parametrize("depth", [0.02, 2.0])
def test_a_thick_layer_has_the_force_of_hertz(depth):
    found = theory.layer_forces(2.0, [depth], 1e5, SHEAR_MODULUS, POISSON)[0]
    assert found == pytest.approx(theory.hertz_force(2.0, depth, SHEAR_MODULUS, POISSON), rel=1e-3)


def test_a_thin_layer_is_stiffer():
    thick, thin = (theory.layer_forces(2.0, [0.5], size, SHEAR_MODULUS, POISSON)[0] for size in (1e5, 4.0))
    assert thin > 1.2 * thick


def test_a_small_contact_on_a_ball_has_the_force_of_hertz():
    radius, depth = 0.2, 5e-3
    found = theory.ball_forces(radius, [depth], 5.0, SHEAR_MODULUS, POISSON)[0]
    hertz = theory.hertz_force(1 / (1 / radius + 1 / 5.0), depth, SHEAR_MODULUS, POISSON)
    assert found == pytest.approx(hertz, rel=0.015)


def test_a_ball_yields_to_a_uniform_pressure_by_its_bulk_modulus():
    bulk = 2 * SHEAR_MODULUS * (1 + POISSON) / (3 * (1 - 2 * POISSON))
    found = theory.ball_compliances(np.array([0]), 5.0, SHEAR_MODULUS, POISSON)
    assert found == pytest.approx(5.0 / (3 * bulk))


def test_a_ball_yields_to_the_second_polynomial_as_its_fields_do():
    """The field of degree 2 solves Navier's equations, and its stress at the surface is the pressure without shear."""
    nu, radius, step = POISSON, 1.3, 1e-4
    ratio = (4 + 4 - 1 + 2 * nu) * radius**2

    def displacement(x):
        """Return the sum of Lur'e's two fields of degree 2, by their radial and tangential parts."""
        r, cosine = np.linalg.norm(x), x[2] / np.linalg.norm(x)
        wave, slope = 0.5 * (3 * cosine**2 - 1), 3 * cosine
        radial = 3 * 4 * nu * r**3 - 2 * ratio * r
        tangential = (7 - 4 * nu) * r**3 - ratio * r
        across = (np.array([0, 0, 1.0]) - cosine * x / r) * slope  # gradient on the unit sphere
        return radial * wave * x / r + tangential * across

    def stress(x):
        slope = np.stack([(displacement(x + step * e) - displacement(x - step * e)) / (2 * step) for e in np.eye(3)], 1)
        volume = 2 * SHEAR_MODULUS * nu / (1 - 2 * nu) * np.trace(slope)
        return SHEAR_MODULUS * (slope + slope.T) + volume * np.eye(3)

    found = theory.ball_compliances(np.array([2]), radius, SHEAR_MODULUS, nu)[0]
    for angle in (0.3, 1.2):
        way = np.array([np.sin(angle), 0.0, np.cos(angle)])
        traction = stress(radius * way) @ way
        assert np.abs(traction - (traction @ way) * way).max() < 1e-5 * abs(traction @ way)
        assert displacement(radius * way) @ way == pytest.approx(found * traction @ way, rel=1e-6)
        inner = 0.7 * radius * way
        balance = sum((stress(inner + 0.01 * e) - stress(inner - 0.01 * e)) @ e / 0.02 for e in np.eye(3))
        assert np.abs(balance).max() < 1e-4 * np.abs(stress(inner)).max()


def test_contact_forces_push_and_displace_at_least_to_the_depth():
    random = np.random.default_rng(0)
    root = random.normal(size=(8, 8))
    compliance, depth = root @ root.T + np.eye(8), random.normal(size=8)
    forces = theory.signorini(compliance, depth)
    gaps = compliance @ forces - depth
    assert forces.min() == 0.0
    assert gaps.min() > -1e-6
    assert abs(gaps @ forces) < 1e-6
