"""A bent block against finite elements."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.nodal.stability import stiffness

pytestmark = pytest.mark.slow

SIZE, FORCE = (0.03, 0.015, 0.015), 1e-3


def by_differences(fem, material):
    """A material of FElupe's with a law's stress, and its tangent by central differences."""

    def stress(x):
        return [np.moveaxis(material.stress(np.moveaxis(x[0], (0, 1), (-2, -1))), (-2, -1), (0, 1)), x[-1]]

    def tangent(x):
        A, step = np.empty((3, 3, *x[0].shape)), 1e-6
        for k, m in np.ndindex(3, 3):
            change = np.zeros_like(x[0])
            change[k, m] = step
            A[:, :, k, m] = (stress([x[0] + change, None])[0] - stress([x[0] - change, None])[0]) / (2 * step)
        return [A]

    return fem.Material(stress=stress, elasticity=tangent)


def finite_elements(material, cells, force=FORCE):
    """Mean end displacement of the held block under a sideways end force, by FElupe's quadratic hexahedra."""
    fem = pytest.importorskip("felupe")
    mesh = fem.Cube(b=SIZE, n=tuple(c + 1 for c in cells)).add_midpoints_edges().add_midpoints_faces()
    mesh = mesh.add_midpoints_volumes()
    field = fem.FieldContainer([fem.Field(fem.RegionTriQuadraticHexahedron(mesh), dim=3)])
    boundaries = {"fixed": fem.Boundary(field[0], fx=0.0)}
    dof0, dof1 = fem.dof.partition(field, boundaries)
    if isinstance(material, pt.materials.NeoHookean):
        law = fem.NeoHookeCompressible(mu=material.shear_modulus, lmbda=material.lame)
    else:
        law = by_differences(fem, material)
    solid = fem.SolidBody(law, field)
    end = np.flatnonzero(np.isclose(mesh.points[:, 0], SIZE[0]))
    # Simpson's rule: the nodal shares of an even traction on quadratic faces
    shares = np.ones(len(end))
    for axis in (1, 2):
        place = np.rint(mesh.points[end, axis] / SIZE[axis] * 2 * cells[axis]).astype(int)
        shares *= np.where(place % 2, 4, np.where((place == 0) | (place == 2 * cells[axis]), 1, 2))
    shares /= shares.sum()
    load = fem.PointLoad(field, end, values=shares[:, None] * np.array([0, 0, force]))
    solve = getattr(fem, "newtonraphson", None) or fem.newtonrhapson  # its old name
    solve(items=[solid, load], dof0=dof0, dof1=dof1, verbose=0)
    return shares @ field[0].values[end]


@pytest.mark.parametrize("poisson", [0.3, 0.45])
def test_a_block_bends_as_far_as_in_finite_elements(poisson):
    material = pt.materials.NeoHookean(C1=20e3, density=1000, poisson=poisson)
    expected = finite_elements(material, (6, 3, 3))
    cloud = pt.box(SIZE, spacing=0.0025)
    model = pt.Solid(cloud, material, form="strong", fixed="x-", stiffness_damping=0.0)
    prepared = model.prepare([pt.SurfaceForce("x+", force=(0, 0, FORCE))])
    # so small a load that one Newton step ends at rest
    last = np.zeros_like(cloud.points)
    push = model.acceleration(model.state(prepared), prepared)[~model.fixed_mask]
    last[~model.fixed_mask] = np.linalg.solve(stiffness(model), push.ravel()).reshape(-1, 3)
    shares = np.linalg.norm(cloud.area_vectors("x+"), axis=1)
    tip = shares / shares.sum() @ last[cloud.group("x+")]
    assert tip[2] == pytest.approx(expected[2], rel=0.05)


@pytest.mark.release
@pytest.mark.parametrize(("form", "error"), [("strong", 0.05), ("energy", 0.08)])
def test_a_block_of_stiffening_tissue_bends_far_as_in_finite_elements(form, error):
    """By a quarter of its length; the law is one of the principal stretches, the errors those of the 3 mm."""
    material = pt.materials.Logarithmic(C1=10e3, C2=0.35, C3=3e3, alpha1=2.0, alpha2=1.5, density=1000, poisson=0.4)
    force = 0.1
    expected = finite_elements(material, (4, 2, 2), force)
    cloud = pt.box(SIZE, spacing=0.003)
    model = pt.Solid(cloud, material, fixed="x-", form=form, stiffness_damping=0.0)
    last = pt.equilibrium(model, [pt.SurfaceForce("x+", force=(0, 0, force))]).displacements
    shares = np.linalg.norm(cloud.area_vectors("x+"), axis=1)
    tip = shares / shares.sum() @ last[cloud.group("x+")]
    assert expected[2] > SIZE[0] / 4
    np.testing.assert_allclose(tip, expected, atol=error * expected[2])
