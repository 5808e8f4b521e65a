"""A bent block against finite elements."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.stability import stiffness

SIZE, FORCE = (0.03, 0.015, 0.015), 1e-3


def finite_elements(material, cells):
    """Mean end displacement of the held block under a sideways end force, by FElupe's quadratic hexahedra."""
    fem = pytest.importorskip("felupe")
    mesh = fem.Cube(b=SIZE, n=tuple(c + 1 for c in cells)).add_midpoints_edges().add_midpoints_faces()
    mesh = mesh.add_midpoints_volumes()
    field = fem.FieldContainer([fem.Field(fem.RegionTriQuadraticHexahedron(mesh), dim=3)])
    boundaries = {"fixed": fem.Boundary(field[0], fx=0.0)}
    dof0, dof1 = fem.dof.partition(field, boundaries)
    lame = material.bulk_modulus - 2 / 3 * material.shear_modulus
    solid = fem.SolidBody(fem.NeoHookeCompressible(mu=material.shear_modulus, lmbda=lame), field)
    end = np.flatnonzero(np.isclose(mesh.points[:, 0], SIZE[0]))
    # Simpson's rule: the nodal shares of an even traction on quadratic faces
    shares = np.ones(len(end))
    for axis in (1, 2):
        place = np.rint(mesh.points[end, axis] / SIZE[axis] * 2 * cells[axis]).astype(int)
        shares *= np.where(place % 2, 4, np.where((place == 0) | (place == 2 * cells[axis]), 1, 2))
    shares /= shares.sum()
    load = fem.PointLoad(field, end, values=shares[:, None] * np.array([0, 0, FORCE]))
    solve = getattr(fem, "newtonraphson", None) or fem.newtonrhapson  # its old name
    solve(items=[solid, load], dof0=dof0, dof1=dof1, verbose=0)
    return shares @ field[0].values[end]


@pytest.mark.parametrize("poisson", [0.3, 0.45])
def test_a_block_bends_as_far_as_in_finite_elements(poisson):
    material = pt.NeoHookean(C1=20e3, density=1000, poisson=poisson)
    expected = finite_elements(material, (6, 3, 3))
    cloud = pt.box(SIZE, spacing=0.0025)
    model = pt.FullModel(cloud, material, fixed="x-", viscosity=0.0)
    drive = model.drive([pt.Traction("x+", force=(0, 0, FORCE))])
    # so small a load that one Newton step ends at rest
    last = np.zeros_like(cloud.points)
    push = model.acceleration(model.state(drive), drive)[~model.held]
    last[~model.held] = np.linalg.solve(stiffness(model), push.ravel()).reshape(-1, 3)
    shares = np.linalg.norm(cloud.area_vectors("x+"), axis=1)
    tip = shares / shares.sum() @ last[cloud.group("x+")]
    assert tip[2] == pytest.approx(expected[2], rel=0.05)
