"""A coarser model made of a body's own surface: its shape, supports, properties and statics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

import palpate as pt
from palpate.dynamics.loads.supports import free_directions
from palpate.reduction.basis.linear_modes import rest_stiffness
from palpate.reduction.contact.coarse_body import coarse_body

TISSUE = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000, poisson=0.4)
SIZE = (0.04, 0.04, 0.02)


@pytest.fixture(scope="module")
def body():
    cloud = pt.box(SIZE, spacing=0.004).within("pin", (0.0, 0.0, 0.0), 0.001)
    return pt.Solid(cloud, TISSUE, ["z-", pt.Roller("x-")], mass_damping=3.0)


@pytest.fixture(scope="module")
def coarse(body):
    return coarse_body(body, 0.0055)


def sag(body):
    """Displacement [m] of the body's middle under its own weight, by statics at rest."""
    free = free_directions(body.supported)[0]
    load = np.repeat(body.masses[:, None], 3, axis=1) * [9.81, 0.0, 0.0]
    moved = free @ spsolve((free.T @ rest_stiffness(body) @ free).tocsc(), free.T @ load.ravel())
    return float(body.masses @ moved.reshape(-1, 3)[:, 0] / body.masses.sum())


@pytest.mark.slow
def test_a_coarse_body_has_the_shape_and_the_statics_of_the_fine_one(body, coarse):
    assert 100 < len(coarse.cloud) < 0.7 * len(body.cloud)
    assert coarse.cloud.volumes.sum() == pytest.approx(np.prod(SIZE), rel=1e-6)
    assert (coarse.material, coarse.mass_damping) == (body.material, 3.0)
    assert sag(coarse) == pytest.approx(sag(body), rel=0.05)


def test_supports_are_carried_to_the_nearest_nodes(body, coarse):
    at = coarse.cloud.points
    assert at[coarse.cloud.group("z-"), 2].max() < 0.5 * coarse.cloud.spacing
    np.testing.assert_array_equal(coarse.cloud.group("z-"), np.flatnonzero(coarse.fixed_mask))
    clamp, roller = coarse.supports
    assert (clamp.group, roller.group, roller.normal) == ("z-", "x-", (-1.0, 0.0, 0.0))
    on_roller = np.setdiff1d(coarse.cloud.group("x-"), coarse.cloud.group("z-"))
    np.testing.assert_array_equal(coarse.supported.sliding, on_roller)
    pin = coarse.cloud.group("pin")  # smaller than a spacing
    assert len(pin) == 1
    assert np.linalg.norm(at[pin]) == np.linalg.norm(at, axis=1).min()


@pytest.mark.slow
def test_regions_fibres_and_stiffness_factors_are_those_of_the_nearest_nodes(body):
    stiff = pt.materials.MooneyRivlin(C1=5e3, C2=0, density=1000, poisson=0.4)
    height = body.cloud.points[:, 2] > 0.011
    turned = np.stack([np.cos(40 * body.cloud.points[:, 1]), np.sin(40 * body.cloud.points[:, 1]), 0 * height], axis=1)
    fine = pt.Solid(
        body.cloud.with_group("top", height), {"": TISSUE, "top": stiff}, "z-", stiffness=np.where(height, 2.0, 1.0),
        fibres=pt.materials.Fibres(k1=1e3, k2=1.0, directions=turned),
    )  # fmt: skip
    coarse = coarse_body(fine, 0.0055)
    inside = coarse.cloud.group("inside")
    others = np.setdiff1d(np.arange(len(fine.cloud)), fine.cloud.face_nodes)
    nearest = others[cKDTree(fine.cloud.points[others]).query(coarse.cloud.points[inside])[1]]
    for name in ("shear_modulus", "lame"):
        np.testing.assert_array_equal(coarse.tissue.moduli(name)[inside], fine.tissue.moduli(name)[nearest])
    np.testing.assert_array_equal(coarse.tissue.stiffness[inside], fine.tissue.stiffness[nearest])
    np.testing.assert_array_equal(coarse.fibres.directions[0, inside], turned[nearest])


def test_the_number_of_nodes_has_a_limit(body):
    assert 0.4 * 400 < len(coarse_body(body, most=400).cloud) <= 400


@pytest.mark.parametrize(("kind", "reason"), [("triangles", "no boundary triangles"), ("open", "closed surface"),
                                              ("plane", "planes of symmetry"), ("few", "spacing must")])  # fmt: skip
def test_a_body_whose_surface_cannot_be_filled_again_is_refused(body, kind, reason):
    cloud, supports, most = body.cloud, body.supports, 400
    if kind in ("triangles", "open"):
        cloud = replace(cloud, triangles=cloud.triangles[: 0 if kind == "triangles" else -1])
    elif kind == "plane":
        supports = [pt.SymmetryPlane("x-"), "z-"]
    else:
        most = 40
    with pytest.raises(
        pt.InputError, match=f"coarse must be given .* more than {most} nodes.*{reason}.*larger spacing"
    ):
        coarse_body(pt.Solid(cloud, TISSUE, supports), most=most)
