"""The stress-free shape of a body that was given under loads: a round trip, finite elements, and bad input."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt

SIZE, SPACING = (0.06, 0.02, 0.02), 0.004
WEIGHT = pt.Gravity((0.0, 0.0, -9.81))
TISSUE = pt.materials.NeoHookean(C1=6e3, density=1060.0, poisson=0.45)
pytestmark = pytest.mark.slow


def sag_of(field):
    return np.linalg.norm(field, axis=1).max()


def test_the_equilibrium_of_the_unloaded_body_is_the_given_shape():
    scanned = pt.Solid(pt.box(SIZE, SPACING), TISSUE, fixed="x-", mass_damping=3.0)
    rest = pt.unloaded(scanned, [WEIGHT])
    again = pt.equilibrium(rest.body, [WEIGHT])
    sag = sag_of(again.displacements)
    assert sag > 0.1 * SIZE[0]
    assert sag_of(rest.body.cloud.points + again.displacements - scanned.cloud.points) < 1e-3 * sag
    assert rest.distance < 1e-3 * sag
    assert rest.body.mass_damping == 3.0
    assert rest.body.cloud.points[:, 2].max() > scanned.cloud.points[:, 2].max() + 0.5 * sag  # it was bent down


def test_a_run_from_the_unloaded_body_stays_in_the_given_shape():
    scanned = pt.Solid(pt.box(SIZE, SPACING), TISSUE, fixed="x-")
    rest = pt.unloaded(scanned, [WEIGHT])
    run = pt.rollout(rest.body, [WEIGHT], duration=0.05, every=0.01, displacement=rest.displacements, progress=False)
    moved = run.displacements - run.displacements[0]
    assert np.linalg.norm(moved, axis=2).max() < 2e-3 * sag_of(rest.displacements)


def test_a_moved_body_has_the_energy_of_the_body_in_the_same_deformation():
    cloud = pt.fill(pt.liver_surface(resolution=0.008, volume=2e-4), spacing=0.01)
    body = pt.Solid(cloud, TISSUE)
    turn = np.array([[1.1, 0.05, 0.0], [0.0, 0.95, 0.1], [0.05, 0.0, 1.0]])
    moved = body.moved(cloud.points @ turn.T - cloud.points)
    ratio = np.linalg.det(turn)
    np.testing.assert_allclose(moved.volumes, ratio * body.volumes, rtol=1e-9)
    stretched = moved.cloud.points @ np.diag([1.1, 1.0, 0.95]) - moved.cloud.points
    F = moved.deformation_gradient(stretched)
    np.testing.assert_allclose(F, np.broadcast_to(np.diag([1.1, 1.0, 0.95]), F.shape), atol=1e-9)
    bar = pt.Solid(pt.box((0.03, 0.03, 0.03), 0.01), TISSUE)
    reference = bar.strain_energy(bar.cloud.points @ np.diag([0.1, 0.0, -0.05])) / 2.7e-5
    assert moved.strain_energy(stretched) == pytest.approx(reference * ratio * cloud.volumes.sum(), rel=1e-6)


def elements_shape(cells=(24, 8, 8)):
    """Corners and triangles of the surface of a hung block by FElupe's quadratic hexahedra, and its sag."""
    fem = pytest.importorskip("felupe")
    mesh = fem.Cube(b=SIZE, n=tuple(c // 2 + 1 for c in cells)).add_midpoints_edges().add_midpoints_faces()
    mesh = mesh.add_midpoints_volumes()
    field = fem.FieldContainer([fem.Field(fem.RegionTriQuadraticHexahedron(mesh), dim=3)])
    dof0, dof1 = fem.dof.partition(field, {"fixed": fem.Boundary(field[0], fx=0.0)})
    solid = fem.SolidBody(fem.NeoHookeCompressible(mu=TISSUE.shear_modulus, lmbda=TISSUE.lame), field)
    weight = fem.SolidBodyForce(field, values=[0.0, 0.0, -9.81], scale=TISSUE.density)
    solve = getattr(fem, "newtonraphson", None) or fem.newtonrhapson  # its old name
    solve(items=[solid, weight], dof0=dof0, dof1=dof1, verbose=0)
    lattice = pt.box(SIZE, SIZE[0] / cells[0])
    order = np.array([np.linalg.norm(mesh.points - x, axis=1).argmin() for x in lattice.points])
    u = field[0].values[order]
    return lattice.points + u, lattice.triangles, np.linalg.norm(u, axis=1).max()


def test_the_unloaded_shape_is_that_which_finite_elements_have_bent():
    corners, triangles, sag = elements_shape()
    cloud = pt.fill((corners, triangles), spacing=0.0035)
    cloud = cloud.with_group("held", pt.near_plane(cloud, (0, 0, 0), (1, 0, 0), 1e-4))
    rest = pt.unloaded(pt.Solid(cloud, TISSUE, fixed="held"), [WEIGHT])
    surface = rest.body.cloud.points[rest.body.cloud.group("surface")]
    outside = np.maximum(np.maximum(-surface, surface - SIZE), 0.0)
    inside = np.minimum(surface, SIZE - surface).min(axis=1)
    distance = np.maximum(np.linalg.norm(outside, axis=1), np.maximum(inside, 0.0))

    assert distance.max() < 0.04 * sag


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"body": "strong"}, pt.InputError, "body must be a Solid in the energy form"),
        ({"loads": "motion"}, pt.InputError, "loads of unloaded"),
        ({"loads": "heavy"}, pt.DivergenceError, "no stress-free shape was found: one exists up to"),
        ({"tolerance": 0.5}, pt.InputError, "tolerance must be"),
    ],
)
def test_bad_input_is_refused(change, error, message):
    cloud = pt.box((0.03, 0.01, 0.01), 0.0033)
    bodies = {"strong": pt.Solid(cloud, TISSUE, fixed="x-", form="strong")}
    body = bodies.get(change.get("body"), pt.Solid(cloud, TISSUE, fixed="x-"))
    loads = {"motion": [pt.PrescribedMotion("x+", lambda points, t: 0 * points)], "heavy": [pt.Gravity((0, 0, -5e3))]}
    with pytest.raises(error, match=message):
        pt.unloaded(body, loads.get(change.get("loads"), [WEIGHT]), tolerance=change.get("tolerance", 1e-3))


def test_cut_bodies_and_inverted_cells_are_refused():
    body = pt.Solid(pt.box((0.03, 0.01, 0.01), 0.0033), TISSUE, fixed="x-")
    with pytest.raises(pt.CloudError, match=r"the cell of node \d+ would have -"):
        body.moved(-2.0 * body.cloud.points)
    opened = pt.cut(body, [[(0.02, -0.01, 0.012), (0.02, 0.02, 0.012), (0.02, 0.005, 0.004)]])
    with pytest.raises(pt.InputError, match="model must have no cut"):
        opened.moved(0.0 * body.cloud.points)
