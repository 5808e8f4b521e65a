"""Solids of linear elasticity: linear, the limit of the other laws, and no more than that."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.nodal.stability import stiffness

pytestmark = pytest.mark.slow

SIDE, MU, GIVEN = 0.02, 20e3, {"density": 1000.0, "poisson": 0.4}
LAW = pt.materials.LinearElastic(mu=MU, **GIVEN)
FORMS = ("strong", "energy")


@pytest.fixture(params=[0.0, 0.2], ids=["lattice", "jitter"])
def cloud(request):
    return pt.box((SIDE,) * 3, spacing=SIDE / 4, jitter=request.param)


def body(cloud, law, form, fixed=()):
    return pt.Solid(cloud, law, fixed, form=form, stiffness_damping=0.0)


@pytest.mark.parametrize("form", FORMS)
def test_forces_are_linear_in_the_displacements(cloud, form):
    model, random = body(cloud, LAW, form), np.random.default_rng(0)
    u, w = SIDE * random.normal(size=(2, len(cloud), 3))
    sum_of_forces = model.force(u) - 3 * model.force(w)
    np.testing.assert_allclose(model.force(u - 3 * w), sum_of_forces, atol=1e-11 * np.abs(sum_of_forces).max())


@pytest.mark.parametrize("form", FORMS)
def test_small_strain_is_the_tangent_of_neo_hookean_at_rest(form):
    cloud = pt.box((SIDE,) * 3, spacing=SIDE / 3, jitter=0.1)
    one, other = (stiffness(body(cloud, law, form, "x-")) for law in (LAW, pt.materials.NeoHookean(C1=MU / 2, **GIVEN)))
    np.testing.assert_allclose(one, other, atol=1e-5 * np.abs(one).max())


def test_quadratic_displacements_have_naviers_force(cloud):
    """Inside: mu lap u + (mu + lame) grad div u."""
    B = np.random.default_rng(1).normal(size=(3, 3, 3))
    B = B + B.transpose(0, 2, 1)
    u = np.einsum("ijk,nj,nk->ni", B, cloud.points, cloud.points) / 2
    force = body(cloud, LAW, "strong").force(u)
    inside = np.setdiff1d(np.arange(len(cloud)), cloud.face_nodes)
    expected = MU * np.einsum("ijj->i", B) + (MU + LAW.lame) * np.einsum("jji->i", B)
    np.testing.assert_allclose(force[inside], np.broadcast_to(expected, (len(inside), 3)), rtol=1e-8)


def test_forces_of_the_energy_form_are_the_slope_of_the_energy(cloud):
    model, random = body(cloud, LAW, "energy"), np.random.default_rng(2)
    u, direction = 0.1 * SIDE * random.normal(size=(2, len(cloud), 3))
    slope = (model.strain_energy(u + direction) - model.strain_energy(u - direction)) / 2
    assert -np.sum(model.volumes[:, None] * model.force(u) * direction) == pytest.approx(slope, rel=1e-10)


def test_uniform_strain_has_hookes_stress(cloud):
    H = 0.3 * np.random.default_rng(3).normal(size=(3, 3))
    expected = MU * (H + H.T) + LAW.lame * np.trace(H) * np.eye(3)
    for form in FORMS:
        stress = body(cloud, LAW, form).stress(cloud.points @ H.T)
        np.testing.assert_allclose(stress, np.broadcast_to(expected, stress.shape), atol=1e-8 * MU)


def test_a_membrane_refuses_the_small_strain_law():
    law = pt.materials.LinearElastic(mu=MU, density=1000.0, poisson=0.5)
    with pytest.raises(pt.InputError, match="must be a law of large strains"):
        pt.Membrane(pt.disc(0.1, 0.02), law, 1e-3)
