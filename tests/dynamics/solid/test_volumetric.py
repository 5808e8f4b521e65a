"""Solids whose volume is held in another form than the quadratic one, in both forms of a solid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import palpate as pt

pytestmark = [pytest.mark.slow, pytest.mark.each_kind(material=[("neo-hookean", "mixed")])]

SIDE = 0.02
STRETCH = np.eye(3) + np.array([[0.3, 0.2, -0.1], [0.0, -0.2, 0.1], [0.1, 0.0, 0.1]])
CLOUDS = {j: pt.box((SIDE,) * 3, spacing=SIDE / 4, jitter=j) for j in (0.0, 0.2)}
LAWS = {
    "neo-hookean": (pt.materials.NeoHookean, {"C1": 20e3}),
    "ogden": (pt.materials.Ogden, {"C": (5e3, 300.0, 500.0), "alpha": (1.3, 5.0, -2.0)}),
}


@pytest.fixture(params=["logarithmic", "mixed"])
def form(request):
    return request.param


@pytest.fixture(params=[("neo-hookean", "mixed"), ("ogden", "logarithmic")], ids="-".join)  # compiling takes long
def material(request):
    law, form = request.param
    kind, parameters = LAWS[law]
    return kind(**parameters, density=1000, poisson=0.45, volumetric=form)


@pytest.fixture(params=CLOUDS, ids=lambda j: f"jitter{j}")
def cloud(request):
    return CLOUDS[request.param]


def some_state(cloud):
    random = np.random.default_rng(0)
    X = cloud.points
    smooth = 0.1 * SIDE * np.sin(X / SIDE @ random.uniform(-3, 3, (3, 3)))
    return X @ (STRETCH - np.eye(3)).T + smooth + 0.05 * cloud.spacing * random.normal(size=X.shape)


@pytest.mark.parametrize(
    "prony", [None, pt.materials.Prony(shares=0.5, times=0.01, bulk_shares=0.3)], ids=["eased", "relaxing"]
)
def test_forces_are_minus_the_slope_of_the_energy(cloud, material, prony):
    model = pt.Solid(cloud, replace(material, poisson=None, prony=prony), form="energy")
    u = some_state(cloud)
    direction, step = np.random.default_rng(1).normal(size=u.shape), 1e-6 * cloud.spacing
    ahead, behind = (model.strain_energy(u + s * step * direction) for s in (1, -1))
    work = -np.sum(model.volumes[:, None] * model.force(u) * direction)
    assert work == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)


@pytest.mark.parametrize("form", ["energy", "strong"])
def test_nodal_stresses_of_a_uniform_deformation_are_the_materials(cloud, material, form):
    model = pt.Solid(cloud, material, stiffness_damping=1e-5, form=form)
    u = cloud.points @ (STRETCH - np.eye(3)).T
    inside = np.abs(cloud.points - SIDE / 2).max(axis=1) < 0.3 * SIDE  # the transposed smoothing needs neighbours
    stress = model.stress(u)[inside]
    expected = np.broadcast_to(material.stress(STRETCH), stress.shape)
    np.testing.assert_allclose(stress, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.each_kind(form=["mixed"])
@pytest.mark.parametrize("solid", ["energy", "strong"])
def test_a_bar_under_the_closed_forms_stretch_is_at_rest_between_its_ends(form, solid):
    material = pt.materials.NeoHookean(C1=20e3, density=1000, poisson=0.45, volumetric=form)
    stretch = 1.4
    across = brentq(lambda a: material.stress(np.diag([stretch, a, a]))[1, 1], 0.5, 1.2, xtol=1e-14)
    cloud = pt.box((0.75 * SIDE, SIDE, SIDE), spacing=SIDE / 4)
    model = pt.Solid(cloud, material, form=solid, stiffness_damping=1e-5)
    force = model.force(cloud.points * (np.array([stretch, across, across]) - 1))
    scale = material.stress(np.diag([stretch, across, across]))[0, 0] / cloud.spacing
    between = (cloud.points[:, 0] > 1e-9) & (cloud.points[:, 0] < 0.75 * SIDE - 1e-9)
    if solid == "energy":  # whose smoothing is not exact near the boundary
        between &= np.abs(cloud.points - SIDE / 2).max(axis=1) < 0.3 * SIDE
    assert np.abs(force[between]).max() < 1e-6 * scale
