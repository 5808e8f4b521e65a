"""Planes of symmetry: one part of a body, with the images of its nodes, moves as the whole body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.meshfree.mirror import MirrorPlane, mirror_images
from palpate.reduction.basis.linear_modes import rest_stiffness
from palpate.reduction.lti.stiffness import nodal_stiffness

pytestmark = pytest.mark.slow

TURN = Rotation.from_rotvec([0.4, -0.3, 0.7]).as_matrix()
SOFT = pt.materials.MooneyRivlin(C1=1000.0, C2=0, density=1000.0, poisson=0.45)
H, SIZE = 0.005, np.array([0.04, 0.015, 0.02])
FORMS = ("energy", "strong")
DAMPING = 2e-4


def quarter() -> pt.Cloud:
    return pt.box(tuple(SIZE), H)


def whole() -> pt.Cloud:
    """The bar of which the quarter is a part, in its place."""
    cloud = pt.box((SIZE[0], 2 * SIZE[1], 2 * SIZE[2]), H)
    return replace(cloud, points=cloud.points - [0.0, SIZE[1], SIZE[2]])


def same_nodes(part: pt.Cloud, body: pt.Cloud) -> np.ndarray:
    distance, nodes = cKDTree(body.points).query(part.points)
    assert distance.max() < 1e-12
    return nodes


def mirrored(cloud: pt.Cloud, form: str = "energy", material=SOFT, end="x-", **options) -> pt.Solid:
    fixed = [end, pt.SymmetryPlane("y-"), pt.SymmetryPlane("z-")]
    return pt.Solid(cloud, material, fixed, form=form, stiffness_damping=DAMPING, **options)


def pull(share: float, turn: np.ndarray | None = None) -> pt.SurfaceForce:
    axis = np.eye(3)[0] if turn is None else turn[:, 0]
    return pt.SurfaceForce("x+", force=lambda t: share * 1.0 * np.sin(200 * t) ** 2 * axis)


def run(model, load, **options):
    return pt.rollout(model, [load], duration=0.02, every=0.004, step=5e-5, progress=False, **options)


@pytest.mark.parametrize("form", FORMS)
def test_a_quarter_of_a_bar_moves_as_the_whole_bar(form):
    part, body = quarter(), whole()
    nodes = same_nodes(part, body)
    small = run(mirrored(part, form), pull(0.25))
    large = run(pt.Solid(body, SOFT, "x-", form=form, stiffness_damping=DAMPING), pull(1.0))
    assert np.abs(large.displacements).max() > 0.5 * H
    error = 1e-6 if form == "energy" else 1e-12  # steps of the energy form are in single precision
    for name in ("displacements", "velocities"):
        expected = getattr(large, name)[:, nodes]
        np.testing.assert_allclose(getattr(small, name), expected, atol=error * np.abs(expected).max(), err_msg=name)
    for name in ("kinetic", "strain", "external", "dissipated"):
        expected = getattr(large, name)
        np.testing.assert_allclose(
            4 * getattr(small, name), expected, atol=100 * error * np.abs(large.external).max(), err_msg=name
        )
    clamped = large.reactions["x-"]
    np.testing.assert_allclose(4 * small.reactions["x-"][:, 0], clamped[:, 0], atol=100 * error * np.abs(clamped).max())


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("sides", ["--", "++", "+-"])
@pytest.mark.parametrize(
    ("size", "spacing"), [((0.1, 0.02, 0.02), 0.005), ((0.05, 0.01, 0.01), 0.0025), ((0.04, 0.025, 0.025), 0.005)]
)
def test_a_quarter_has_the_accelerations_and_pressures_of_the_whole(size, spacing, sides, form):
    """In some sizes all nodes of a block of lanes have images of themselves in their smoothing stencils."""
    part, body = pt.box(size, spacing), pt.box((size[0], 2 * size[1], 2 * size[2]), spacing)
    planes = [pt.SymmetryPlane(axis + side) for axis, side in zip("yz", sides, strict=True)]
    centre = np.array([0.0, *(0.0 if side == "-" else size[k + 1] for k, side in enumerate(sides))])
    part = replace(part, points=part.points - centre)
    body = replace(body, points=body.points - [0.0, size[1], size[2]])
    nodes = same_nodes(part, body)

    def state_of(model):
        x, y, z = 30 * model.cloud.points.T
        field = 0.1 * size[1] * np.column_stack([np.sin(x) * np.cos(y) * np.cos(z), np.sin(y) * x, -np.sin(z) * x * x])
        prepared = model.prepare(())
        state = model.state(prepared, displacement=field)
        return model.acceleration(state, prepared), model, state.coordinates

    own, small, u = state_of(pt.Solid(part, SOFT, ["x-", *planes], form=form, stiffness_damping=DAMPING))
    every, large, v = state_of(pt.Solid(body, SOFT, "x-", form=form, stiffness_damping=DAMPING))
    np.testing.assert_allclose(own, every[nodes], atol=1e-11 * np.abs(every).max())
    expected = large.evaluate(v).pressure
    np.testing.assert_allclose(small.evaluate(u).pressure, expected[nodes], atol=1e-12 * np.abs(expected).max())
    recovered = large.recovered_pressure(v)[nodes]
    np.testing.assert_allclose(small.recovered_pressure(u), recovered, atol=1e-12 * np.abs(recovered).max())


def test_tissue_may_differ_from_node_to_node():
    """Relaxation, regions, stiffness factors and fibres of two families, whose images are reflected."""
    part, body = quarter(), whole()
    nodes = same_nodes(part, body)
    prony = pt.materials.Prony(shares=0.4, times=0.01)
    signs = np.sign(np.where(np.abs(body.points) < 1e-9, 1.0, body.points))[:, 1:]
    directions = np.column_stack([np.full(len(body), 0.8), 0.6 * signs[:, 0], 0.0 * signs[:, 1]])
    on_plane = np.abs(body.points[:, 1]) < 1e-9
    directions[on_plane] = (1.0, 0.0, 0.0)  # a direction in a plane of symmetry or across it has no other image
    factors = 1.0 + (body.points[:, 0] / SIZE[0]) ** 2
    laws = [
        pt.materials.MooneyRivlin(C1=800.0 + 4e4 * x, C2=0, density=1000.0, poisson=0.45, prony=prony)
        for x in body.points[:, 0]
    ]

    def model(cloud, where, fixed):
        fibres = pt.materials.Fibres(k1=2e3, k2=1.0, dispersion=0.1, directions=directions[where])
        return pt.Solid(
            cloud, [laws[i] for i in where], fixed, stiffness=factors[where], fibres=fibres, stiffness_damping=DAMPING
        )

    large = run(model(body, np.arange(len(body)), "x-"), pull(1.0))
    small = run(model(part, nodes, ["x-", pt.SymmetryPlane("y-"), pt.SymmetryPlane("z-")]), pull(0.25))
    expected = large.displacements[:, nodes]
    np.testing.assert_allclose(small.displacements, expected, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(4 * small.dissipated, large.dissipated, atol=1e-5 * large.external.max())


@pytest.mark.parametrize("form", FORMS)
def test_the_equilibrium_is_that_of_the_whole_bar(form):
    """The planes bear what the images exert: forces balance, and a plane across the load bears all of it."""
    part, body, size = quarter(), whole(), 0.2
    nodes = same_nodes(part, body)
    load = [pt.SurfaceForce("x+", force=(size, 0.0, 0.0))]
    settled = pt.equilibrium(mirrored(part, form), load, tolerance=1e-9)
    large = pt.equilibrium(
        pt.Solid(body, SOFT, "x-", form=form, stiffness_damping=DAMPING),
        [pt.SurfaceForce("x+", force=(4 * size, 0.0, 0.0))],
        tolerance=1e-9,
    )
    expected = large.displacements[nodes]
    np.testing.assert_allclose(settled.displacements, expected, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(sum(settled.reactions.values()), (-size, 0.0, 0.0), atol=1e-6 * size)
    assert settled.reactions["y-"][1] < -1e-2 * size  # the clamp hinders the bar's contraction
    free = pt.equilibrium(mirrored(part, form, end=pt.SymmetryPlane("x-")), load, tolerance=1e-9)
    np.testing.assert_allclose(free.reactions["x-"], (-size, 0.0, 0.0), atol=1e-6 * size)
    F = mirrored(part, form, end=pt.SymmetryPlane("x-")).deformation_gradient(free.displacements)
    inner = part.points[:, 0] < SIZE[0] / 2
    np.testing.assert_allclose(F[inner], np.broadcast_to(np.diag(np.diag(F[0])), F[inner].shape), atol=5e-3)


def test_the_motion_of_a_turned_part_is_the_turned_motion():
    """No direction of space is special."""
    cloud = quarter()
    oblique = replace(cloud, points=cloud.points @ TURN.T, face_normals=cloud.face_normals @ TURN.T)
    one, two = run(mirrored(cloud, "strong"), pull(0.25)), run(mirrored(oblique, "strong"), pull(0.25, TURN))
    size = np.abs(one.displacements).max()
    np.testing.assert_allclose(two.displacements, one.displacements @ TURN.T, atol=1e-9 * size)
    for name, force in one.reactions.items():
        np.testing.assert_allclose(two.reactions[name], force @ TURN.T, atol=1e-8 * np.abs(one.reactions["x-"]).max())


def test_the_stiffness_is_the_slope_of_the_forces_and_has_the_frequencies_of_the_whole_bar():
    part, body = quarter(), whole()
    oblique = replace(part, points=part.points @ TURN.T, face_normals=part.face_normals @ TURN.T)
    for cloud in (part, oblique):
        model = mirrored(cloud)
        free = model.free_directions
        stiffness = free.T @ rest_stiffness(model) @ free
        by_differences = free.T @ nodal_stiffness(model, np.zeros((len(cloud), 3))) @ free
        assert abs(stiffness - stiffness.T).max() < 1e-12 * abs(stiffness).max()
        assert abs(stiffness - by_differences).max() < 1e-6 * abs(stiffness).max()
    own = pt.vibration_modes(mirrored(part), 4)[1]
    every = pt.vibration_modes(pt.Solid(body, SOFT, "x-", stiffness_damping=DAMPING), 40)[1]
    assert np.abs(own[:, None] - every).min(axis=1).max() < 1e-6 * own[0]


def test_reduced_models_of_a_part_have_its_motion_and_its_reactions(tmp_path):
    model, load = mirrored(quarter()), pull(0.25)
    options = {"duration": 0.04, "every": 0.002, "progress": False}
    full = pt.rollout(model, [load], **options)
    exact = pt.hyper_reduce(model, full, modes=10, cubature=0.0, pressures=1000)
    sampled = pt.hyper_reduce(model, full, modes=10, pressures=8)
    size, largest = np.abs(full.displacements).max(), np.abs(full.reactions["x-"]).max()
    # the cubature fits the energy to some per cent, and a reaction is its slope
    for reduced, displacement, force in ((exact, 0.02, 0.05), (sampled, 0.04, 0.08)):
        run = pt.rollout(reduced, [load], **options)
        assert np.abs(run.displacements - full.displacements).max() < displacement * size
        for name in full.reactions:
            error = np.sqrt(np.mean((run.reactions[name] - full.reactions[name]) ** 2))
            assert error < force * largest, name
    pt.save(sampled, tmp_path / "part.rom")
    again = pt.load(tmp_path / "part.rom")
    assert again.supports == model.supports
    u = full.displacements[-1]
    np.testing.assert_allclose(again.stress(u), sampled.stress(u), rtol=1e-12)
    images = mirror_images(model.cloud, model.planes)
    mirror, fit = images.own(pt.moving_least_squares(images.cloud.points, neighbours=42))
    gradient = fit.gradient(mirror.vectors(u))
    np.testing.assert_allclose(sampled.body.gradient(u), gradient, atol=1e-9 * np.abs(gradient).max())


def test_a_linear_system_has_the_forces_of_the_planes():
    """A plane across the load bears all of it, and those along it nothing."""
    model, load = mirrored(quarter(), end=pt.SymmetryPlane("x-")), pull(1e-3)
    system = pt.lti.linearise(model, (load,), ["x+", "x-", "y-"])
    response = system.transfer([0.0])[0].real @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(response[3:], [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.quick
def test_images_have_the_volume_faces_and_stencils_of_the_whole():
    part, body = quarter(), whole()
    nodes = same_nodes(part, body)
    planes = [MirrorPlane(name, part.group(name), -np.eye(3)[k]) for k, name in ((1, "y-"), (2, "z-"))]
    images = mirror_images(part, planes)
    assert len(images.cloud) == len(body)
    np.testing.assert_allclose(images.cloud.points[: len(part)], part.points)
    np.testing.assert_allclose(images.cloud.volumes.sum(), body.volumes.sum())
    np.testing.assert_allclose(images.cloud.boundary_vectors()[: len(part)], body.boundary_vectors()[nodes], atol=1e-9)
    assert sorted(np.unique(images.copies)) == [1.0, 2.0, 4.0]
    u = np.random.default_rng(0).standard_normal((len(part), 3))
    mirror, _ = images.own(pt.moving_least_squares(images.cloud.points, neighbours=42))
    extended, w = mirror.vectors(u), np.random.default_rng(1).standard_normal((len(part) + len(mirror.source), 3))
    np.testing.assert_allclose(mirror.matrix(len(part)) @ u.ravel(), extended.ravel())
    assert np.sum(extended * w) == pytest.approx(np.sum(u * mirror.fold(w)))


@pytest.mark.quick
@pytest.mark.parametrize(
    ("fixed", "message"),
    [
        ([pt.SymmetryPlane("x-", (1.0, 1.0, 0.0))], "must be in one plane, got one"),
        ([pt.SymmetryPlane("some", (0.0, 1.0, 0.0))], "must be on one side of it"),
        ([pt.SymmetryPlane("middle", (0.0, 1.0, 0.0))], "must be on one side of it"),
    ],
)
def test_planes_that_do_not_bound_the_body_are_refused(fixed, message):
    cloud = pt.box((0.04, 0.02, 0.02), H)
    middle = np.flatnonzero(np.abs(cloud.points[:, 1] - 0.01) < 1e-9)
    cloud = replace(cloud, groups={**cloud.groups, "middle": middle, "some": cloud.group("y-")[:7]})
    with pytest.raises(pt.InputError, match=message):
        pt.Solid(cloud, SOFT, fixed)


@pytest.mark.quick
def test_planes_must_be_at_right_angles_and_belong_to_a_solid():
    corners = np.array([[0.0, 0.0], [0.02, 0.0], [0.02, 0.02], [0.0, 0.02]])
    sheet = pt.sheet(corners, 0.004)
    sheet = replace(sheet, groups={**sheet.groups, "left": np.flatnonzero(sheet.points[:, 0] < 1e-6)})
    law = pt.materials.NeoHookean(C1=1e4, density=1000.0, poisson=0.5)
    with pytest.raises(pt.InputError, match="must hold no SymmetryPlane, got 'left'; use Roller"):
        pt.Membrane(sheet, law, 1e-3, ["outer", pt.SymmetryPlane("left", (1, 0, 0))])
    cloud = quarter()
    skew = MirrorPlane("x-", cloud.group("x-"), np.array([-1.0, 0.0, 0.0]))
    with pytest.raises(pt.InputError, match="must be at right angles, got 'x-' and 'again'"):
        mirror_images(cloud, [skew, MirrorPlane("again", cloud.group("x-"), np.array([-0.8, -0.6, 0.0]))])
