"""States of rest that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

import palpate as pt

pytestmark = pytest.mark.slow


def uniaxial(material, stretch):
    """Lateral stretch and nominal stress of a bar pulled or pushed along x with free sides."""

    def sides(lateral):
        return material.stress(np.diag([stretch, lateral, lateral]))[1, 1]

    lateral = brentq(sides, 0.5 * stretch**-0.5, 1.5 * stretch**-0.5, xtol=1e-15)
    return lateral, material.stress(np.diag([stretch, lateral, lateral]))[0, 0]


@pytest.mark.parametrize("jitter", [0.0, 0.2], ids=["lattice", "jitter"])
@pytest.mark.parametrize("stretch", [0.7, 1.5])
@pytest.mark.parametrize("poisson", [0.45, 0.49])
def test_the_closed_form_of_a_pulled_bar_is_an_exact_equilibrium(poisson, stretch, jitter):
    cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005, jitter=jitter)
    material = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=poisson)
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=5e-5)
    lateral, nominal = uniaxial(material, stretch)
    force = np.array([nominal * 0.015**2, 0, 0])
    loads = [pt.SurfaceForce("x+", force=force), pt.SurfaceForce("x-", force=-force)]
    u = cloud.points * (np.array([stretch, lateral, lateral]) - 1)
    prepared = model.prepare(loads)
    rates = model.acceleration(model.state(prepared, u), prepared)
    np.testing.assert_allclose(rates, 0, atol=1e-8 * abs(nominal) / (1000 * cloud.spacing))


@pytest.mark.parametrize("stretch", [0.85, 1.4])
@pytest.mark.parametrize("poisson", [0.45, 0.49])
def test_a_slowly_pulled_bar_comes_to_the_closed_form(poisson, stretch):
    cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    material = pt.materials.MooneyRivlin(C1=40e3, C2=0, density=1000, poisson=poisson)
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=1e-3)
    lateral, nominal = uniaxial(material, stretch)
    force = np.array([nominal * 0.015**2, 0, 0])
    ramp = lambda t: min(1.0, t / 0.01)  # noqa: E731
    loads = [
        pt.SurfaceForce("x+", force=lambda t: ramp(t) * force),
        pt.SurfaceForce("x-", force=lambda t: -ramp(t) * force),
    ]
    last = pt.rollout(model, loads, duration=0.03, every=0.03).displacements[-1]
    # in the long run a compressed bar would turn over: dead forces push it
    size = np.ptp(cloud.points + last, axis=0) / np.ptp(cloud.points, axis=0)
    np.testing.assert_allclose(size, [stretch, lateral, lateral], rtol=1e-4)


def test_pressure_all_around_shrinks_a_body_evenly(small_cloud, tissue):
    model = pt.Solid(small_cloud, tissue, form="strong", stiffness_damping=0.0)
    F = 0.95 * np.eye(3)
    cauchy = (tissue.stress(F) @ F.T / np.linalg.det(F))[0, 0]
    prepared = model.prepare([pt.Pressure(side, -cauchy) for side in ("x-", "x+", "y-", "y+", "z-", "z+")])
    rates = model.acceleration(model.state(prepared, -0.05 * small_cloud.points), prepared)
    np.testing.assert_allclose(rates, 0, atol=1e-9 * abs(cauchy) / (1000 * 0.005))


def test_pressure_follows_the_face_as_it_stretches_and_turns(small_cloud, tissue, rotation):
    model = pt.Solid(small_cloud, tissue, form="strong", stiffness_damping=0.0)
    F = rotation @ np.diag([1.1, 0.9, 1.3])
    prepared = model.prepare([pt.Pressure("x+", lambda t: 100.0)])
    state = model.state(prepared, small_cloud.points @ (F - np.eye(3)).T)
    normal, area = rotation[:, 0], 0.015**2 * 0.9 * 1.3
    np.testing.assert_allclose(model.external_force(state, prepared).sum(axis=0), -100 * area * normal, rtol=1e-10)


def test_a_pressure_at_rest_is_a_force_against_the_normal(small_cloud, tissue):
    model = pt.Solid(small_cloud, tissue, form="strong", stiffness_damping=0.0)
    forces = []
    for load in (pt.Pressure("x+", 100.0), pt.SurfaceForce("x+", force=(-100 * 0.015**2, 0, 0))):
        prepared = model.prepare([load])
        forces.append(model.external_force(model.state(prepared), prepared))
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-12, atol=1e-18)


def test_a_small_following_pressure_acts_like_a_fixed_force(held):
    area = 0.015**2
    runs = [
        pt.rollout(held, [load], duration=0.005, every=0.005).displacements[-1]
        for load in (pt.Pressure("x+", 10.0), pt.SurfaceForce("x+", force=(-10 * area, 0, 0)))
    ]
    strain = 10 / held.material.shear_modulus
    assert np.abs(runs[1]).max() > 1e-7
    np.testing.assert_allclose(runs[0], runs[1], atol=5 * strain * np.abs(runs[1]).max())


def test_a_total_force_is_spread_evenly_over_the_face(held):
    prepared = held.prepare([pt.SurfaceForce("x+", force=(1.0, 2.0, 3.0))])
    force = held.external_force(held.state(prepared), prepared)
    end = held.cloud.group("x+")
    areas = np.linalg.norm(held.cloud.area_vectors("x+"), axis=1)
    np.testing.assert_allclose(force[end], np.outer(areas / areas.sum(), (1.0, 2.0, 3.0)), rtol=1e-12)
    np.testing.assert_array_equal(np.delete(force, end, axis=0), 0)


@pytest.mark.parametrize("half_cell", [2.0, 3.0])
def test_tractions_and_gravity_do_their_true_virtual_work_in_the_inner_product(small_cloud, tissue, half_cell):
    model = pt.Solid(small_cloud, tissue, form="strong", stiffness_damping=0.0, half_cell=half_cell)
    prepared = model.prepare([pt.SurfaceForce("x+", force=(1.0, 2.0, 3.0))])
    rates = model.acceleration(model.state(prepared), prepared)
    moved = np.sin(100 * small_cloud.points)
    work = np.sum(model.weights[:, None] * 1000 * rates * moved)
    expected = np.sum(model.external_force(model.state(prepared), prepared) * moved)
    assert work == pytest.approx(expected, rel=1e-12)


def test_a_uniformly_accelerated_bar_has_the_acceleration_of_its_mass(small_cloud):
    """Without lateral contraction a linear stress, quadratic in displacement, pulls every node with F / m."""
    material = pt.materials.MooneyRivlin(C1=40e3, C2=0, density=1000, poisson=0.0)
    model = pt.Solid(small_cloud, material, form="strong", stiffness_damping=0.0)
    force = 1e-7
    x = small_cloud.points[:, 0]
    u = np.zeros_like(small_cloud.points)
    u[:, 0] = force / 0.015**2 * x**2 / (2 * 0.015) / (2 * material.shear_modulus)
    prepared = model.prepare([pt.SurfaceForce("x+", force=(force, 0, 0))])
    rates = model.acceleration(model.state(prepared, u), prepared)
    expected = np.tile([force / model.masses.sum(), 0, 0], (64, 1))
    np.testing.assert_allclose(rates, expected, atol=1e-3 * expected.max())
