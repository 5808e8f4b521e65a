"""Forces of steps, in single precision around a law in double, against those of double precision."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt

SIZE, SPACING = np.array([0.03, 0.025, 0.02]), 0.005
LAW = pt.materials.MooneyRivlin(C1=2e3, C2=500.0, density=1000.0, poisson=0.45)
RELAXING = pt.materials.MooneyRivlin(
    C1=2e3, C2=500.0, density=1000.0, poisson=0.45,
    prony=pt.materials.Prony(shares=(0.5,), times=(0.01,), bulk_shares=(0.2,)),
)  # fmt: skip
FIBRES = pt.materials.Fibres(k1=2e3, k2=3.0, directions=(1.0, 0.0, 0.0))
LARGEST_ERROR = 1e-6  # root of the mean square, over that of the forces


def cloud():
    return pt.box(tuple(SIZE), spacing=SPACING, jitter=0.2)


def cut():
    corners = np.array([[0.015, -0.01, -0.01], [0.015, 0.04, -0.01], [0.015, 0.04, 0.01], [0.015, -0.01, 0.01]])
    return pt.cut(pt.Solid(cloud(), LAW, "x-"), corners[[[0, 1, 2], [0, 2, 3]]])


def two_tissues():
    base = cloud()
    stiffness = np.where(base.points[:, 0] > 0.015, 4.0, 1.0)
    return pt.Solid(base, LAW, "x-", stiffness=stiffness)


BODIES = {
    "law": lambda: pt.Solid(cloud(), LAW, "x-"),
    "planes": lambda: pt.Solid(pt.box(tuple(SIZE), spacing=SPACING), LAW, ["x-", pt.SymmetryPlane("y-")]),
    "cut": cut,
    "stiffness": two_tissues,
    "relaxing": lambda: pt.Solid(cloud(), RELAXING, "x-"),
    "fibres": lambda: pt.Solid(cloud(), LAW, "x-", fibres=FIBRES),
    "Ogden": lambda: pt.Solid(cloud(), pt.materials.Ogden(C=2e3, alpha=4.0, density=1000.0, poisson=0.45), "x-"),
}
pytestmark = [pytest.mark.slow, pytest.mark.each_kind(kind=["law", "cut", "relaxing", "fibres"])]


@pytest.fixture(scope="module", params=BODIES)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def body(kind):
    return BODIES[kind]()


def forces(body, displacements):
    """Return the force densities in double precision, and in the precision of the steps."""
    work = body.workspace()
    return body.force(displacements, work=work), body.step_force(displacements, work)


def bend(points, strain):
    """Return waves with the strain, about the size of the body long."""
    x, y, z = (points / SIZE).T
    shapes = np.stack([np.sin(2 * x + y), np.cos(3 * z) * x, x * z + 0.3 * y**2], axis=1)
    return strain * SIZE.min() * shapes


@pytest.mark.parametrize("strain", [3e-5, 3e-3, 0.1, 0.4])
def test_the_force_has_six_digits_at_every_strain(kind, body, strain):
    expected, found = forces(body, bend(body.cloud.points, strain))
    error = np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2))
    assert 0.0 < error < LARGEST_ERROR


@pytest.mark.parametrize("strain", [3e-5, 0.1])
def test_a_body_that_is_moved_and_turned_has_as_small_an_error(rotation, strain):
    body = BODIES["law"]()
    points = body.cloud.points
    moved = (points + bend(points, strain)) @ rotation.T - points + 0.1
    expected, found = forces(body, moved)
    assert np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2)) < LARGEST_ERROR


def test_a_rigid_motion_has_no_force_beyond_rounding(rotation):
    body = BODIES["law"]()
    points = body.cloud.points
    force = forces(body, points @ rotation.T - points + 0.1)[1]
    assert np.abs(force).max() < 1e-9 * LAW.shear_modulus / SPACING


def test_a_long_free_vibration_keeps_its_energy_and_its_momentum():
    body = pt.Solid(cloud(), LAW, stiffness_damping=0.0)
    x = body.cloud.points[:, 0] / SIZE[0]
    velocity = np.stack([0.0 * x, 0.1 * np.cos(3.0 * x), 0.2 * np.sin(np.pi * x)], axis=1)
    velocity -= body.masses @ velocity / body.masses.sum()
    step = 0.8 * body.stability.step
    run = pt.rollout(body, duration=6000 * step, every=600 * step, velocity=velocity, step=step, progress=False)
    energy = run.kinetic + run.strain
    assert np.abs(energy / energy[0] - 1.0).max() < 5e-3
    momentum = np.einsum("n,tnc->tc", body.masses, run.velocities)
    assert np.abs(momentum).max() < 1e-6 * body.masses.sum() * np.abs(velocity).max()
