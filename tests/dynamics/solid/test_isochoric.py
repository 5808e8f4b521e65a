"""Bodies whose law is isochoric: the compiled forces are those of the law."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.material.kinematics import Kinematics
from palpate.reduction.hyper.material_point import material_point

pytestmark = pytest.mark.slow

GENT = pt.materials.Gent(mu=10e3, Jm=3.0, density=1000.0, poisson=0.45, split="isochoric")
OGDEN = pt.materials.Ogden(C=(800.0, 120.0), alpha=(4.0, -7.5), density=1000.0, poisson=0.45, split="isochoric")
F = np.eye(3) + np.array([[0.2, 0.1, 0.0], [-0.05, 0.1, 0.1], [0.1, 0.0, 0.15]])


@pytest.mark.each_kind(material=[GENT], form=["energy"])
@pytest.mark.parametrize(("material", "form"), [(GENT, "energy"), (GENT, "strong"), (OGDEN, "energy")])
def test_uniform_deformation_has_the_stress_of_the_law(material, form):
    cloud = pt.box((0.02, 0.02, 0.02), 0.005)
    body = pt.Solid(cloud, material, form=form, stiffness_damping=1e-5)
    u = cloud.points @ (F - np.eye(3)).T
    expected = material.stress(F)
    np.testing.assert_allclose(body.stress(u).mean(axis=0), expected, atol=1e-9 * np.abs(expected).max())
    if form == "strong":  # and the divergence is that of the stress of a bent body
        inside = np.linalg.norm(cloud.points - 0.01, axis=1).argmin()
        bend = np.zeros((3, 3, 3))  # triangular: J is linear, so that smoothing the pressure changes nothing
        for (i, j, k), value in {
            (0, 0, 0): 4.0,
            (0, 1, 2): 6.0,
            (0, 2, 2): -8.0,
            (0, 1, 1): 5.0,
            (1, 2, 2): 9.0,
        }.items():
            bend[i, j, k] = bend[i, k, j] = value
        G = np.einsum("ai,ijk->ajk", F, bend)
        X = cloud.points - cloud.points[inside]
        force = body.force(X @ (F - np.eye(3)).T + 0.5 * np.einsum("cde,nd,ne->nc", G, X, X))[inside]
        step, divergence = 1e-6, np.zeros(3)
        for d in range(3):
            ahead, behind = (material.shear_stress(F + s * step * G[:, :, d]) for s in (1, -1))
            divergence += (ahead - behind)[:, d] / (2 * step)
        J = np.linalg.det
        cofactor = material.cofactor(F)
        slope = np.array([(J(F + step * G[:, :, d]) - J(F - step * G[:, :, d])) / (2 * step) for d in range(3)])
        divergence += material.lame * cofactor @ slope
        np.testing.assert_allclose(force, divergence, atol=1e-5 * np.abs(divergence).max())


@pytest.mark.each_kind(material=[GENT])
@pytest.mark.parametrize("material", [GENT, OGDEN])
def test_a_crushed_point_has_an_energy_bounded_below_and_its_slope(material):
    law, coefficients = material_point(material, Kinematics())
    random = np.random.default_rng(1)
    for scale in (0.3, 0.9, 1.5):
        d = scale * random.uniform(-1, 1, 9)
        stress, _, _ = law.stress(*d, coefficients)
        energy = [law.density(*(d + s * t), coefficients)[0] for t in 1e-6 * np.eye(9) for s in (1, -1)]
        slope = (np.array(energy[::2]) - energy[1::2]) / 2e-6
        np.testing.assert_allclose(stress, slope, atol=1e-5 * np.abs(slope).max())
    flat = [law.density(0, 0, 0, 0, 0, 0, 0, 0, z, coefficients)[0] for z in (-0.5, -0.95, -1.0, -1.5, -3.0)]
    assert min(np.diff(flat)) > 0
