"""Supports that leave nodes free to slide: rollers of any normal, alone, together and with tools."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.dynamics.loads.supports import supported_nodes
from palpate.reduction.contact.near_field import _Piece
from palpate.reduction.contact.residual_flexibility import residual_flexibility

pytestmark = pytest.mark.slow

TURN = Rotation.from_rotvec([0.4, -0.3, 0.7]).as_matrix()
SOFT = pt.materials.MooneyRivlin(C1=500.0, C2=0.0, density=1000.0, poisson=0.3)
SIDES = ("y-", "y+", "z-", "z+")


def bar(length: float = 0.03, width: float = 0.015) -> pt.Cloud:
    return pt.box((length, width, width), 0.005)


def turned(cloud: pt.Cloud) -> pt.Cloud:
    return replace(cloud, points=cloud.points @ TURN.T, face_normals=cloud.face_normals @ TURN.T)


def on_rollers(cloud: pt.Cloud, form: str = "strong") -> pt.Solid:
    return pt.Solid(cloud, SOFT, [pt.Roller(name) for name in ("x-", "y-", "z-")], form=form)


def pull(size: float = 0.02, turn: np.ndarray | None = None) -> pt.SurfaceForce:
    axis = np.eye(3)[0]
    return pt.SurfaceForce("x+", force=size * (axis if turn is None else turn @ axis))


@pytest.mark.quick
def test_a_pulled_bar_on_rollers_has_the_stretch_of_the_law():
    """The state is homogeneous: the closed form of uniaxial tension, with lateral faces free of stress."""
    model, size = on_rollers(bar()), 0.02
    settled = pt.equilibrium(model, [pull(size)], tolerance=1e-10)
    F = model.deformation_gradient(settled.displacements)
    np.testing.assert_allclose(F, np.broadcast_to(np.diag(np.diag(F[0])), F.shape), atol=1e-7)
    assert F[0, 0, 0] > 1.03
    stress = model.stress(settled.displacements)
    np.testing.assert_allclose(stress, np.broadcast_to(np.diag([size / 0.015**2, 0.0, 0.0]), F.shape), atol=1e-4)
    np.testing.assert_allclose(settled.reactions["x-"], [-size, 0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(settled.reactions["y-"], 0.0, atol=1e-7)


def test_the_motion_of_a_turned_body_is_the_turned_motion():
    """Normals are those of the turned faces; no direction of space is special."""
    cloud = bar()
    straight, oblique = on_rollers(cloud), on_rollers(turned(cloud))
    options = {"duration": 0.02, "every": 0.005, "progress": False, "step": 1e-4}
    one = pt.rollout(straight, [pull()], **options)
    two = pt.rollout(oblique, [pull(turn=TURN)], **options)
    size = np.abs(one.displacements).max()
    np.testing.assert_allclose(two.displacements, one.displacements @ TURN.T, atol=1e-9 * size)
    for name, force in one.reactions.items():
        np.testing.assert_allclose(two.reactions[name], force @ TURN.T, atol=1e-8)


def test_rollers_on_all_sides_leave_waves_along_the_bar():
    """Vibrations of a bar that cannot widen are those of a rod with the modulus lambda + 2 mu."""
    length, errors = 0.06, []
    speed = np.sqrt((2 * SOFT.shear_modulus + SOFT.lame) / SOFT.density)
    for spacing in (0.005, 0.0025):
        cloud = pt.box((length, 0.015, 0.015), spacing)
        model = pt.Solid(cloud, SOFT, ["x-", *(pt.Roller(name) for name in SIDES)])
        modes, frequencies = pt.vibration_modes(model, 2)
        errors.append(frequencies / (np.array([1, 3]) * np.pi / 2 * speed / length) - 1)
    assert np.all(np.abs(errors[1]) < [0.015, 0.03])
    assert np.all(np.abs(errors[1]) < 0.4 * np.abs(errors[0]))
    shape = np.sin(np.pi / 2 * cloud.points[:, 0] / length)
    np.testing.assert_allclose(np.abs(modes[0, :, 0]), shape, atol=0.03)
    np.testing.assert_allclose(modes[0, :, 1:], 0.0, atol=0.02)


def test_a_linear_model_has_the_static_response_of_the_full_one():
    model, force = on_rollers(bar(), "energy"), 1e-6
    system = pt.lti.linearise(model, [pull(force)], ["x+", "x-"])
    static = np.linalg.solve(system.stiffness.toarray(), system.input.toarray()[:, 0] * force)
    expected = pt.equilibrium(model, [pull(force)], tolerance=1e-9).displacements
    np.testing.assert_allclose(system.fields(static[:, None])[0], expected, atol=1e-5 * np.abs(expected).max())
    response = system.transfer([0.0])[0]
    names = list(system.outputs)
    np.testing.assert_allclose(response[names.index("force x of x-"), 0], -1.0, rtol=1e-9)
    assert response[names.index("force y of x-"), 0] == 0.0


@pytest.mark.quick
def test_shared_nodes_obey_all_their_supports():
    cloud = bar()
    fixed = [pt.Roller("x-"), pt.Roller("y-", (1.0, 1.0, 0.0)), pt.Roller("z-")]
    nodes = supported_nodes(cloud, pt.Solid(cloud, SOFT, fixed).supports)
    corner = np.flatnonzero(np.linalg.norm(cloud.points, axis=1) < 1e-9)
    edge = np.flatnonzero((cloud.points[:, 0] < 1e-9) & (cloud.points[:, 1] < 1e-9) & (cloud.points[:, 2] > 1e-9))[0]
    field = nodes.project(np.ones((len(cloud), 3)))
    np.testing.assert_array_equal(field[corner], 0.0)
    np.testing.assert_allclose(field[edge], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_array_equal(field[np.all(cloud.points > 1e-9, axis=1)], 1.0)


def test_forces_of_supports_that_share_nodes_add_up():
    """Rollers of oblique normals, next to a clamp: their forces and the load balance, each along its own normals."""
    cloud = bar()
    fixed = ["x-", pt.Roller("y-", (0.0, 0.8, 0.6)), pt.Roller("z-", (0.0, 0.6, 0.8))]
    model = pt.Solid(cloud, SOFT, fixed)
    load = pt.SurfaceForce("x+", force=(0.01, -0.005, 0.003))
    settled = pt.equilibrium(model, [load], tolerance=1e-9)
    np.testing.assert_allclose(sum(settled.reactions.values()), [-0.01, 0.005, -0.003], atol=1e-7)
    for name in ("y-", "z-"):
        assert settled.reactions[name][0] == pytest.approx(0.0, abs=1e-12)
    moved = settled.displacements[cloud.group("y-")]
    np.testing.assert_allclose(moved @ [0.0, 0.8, 0.6], 0.0, atol=1e-15)


def test_a_tool_may_move_nodes_along_their_supports_and_not_across():
    model = pt.Solid(bar(), SOFT, ["x-", pt.Roller("y-")])
    along = pt.PrescribedMotion("x+", lambda points, t: np.array([0.1 * t, 0.0, 0.05 * t]), until=0.01)
    run = pt.rollout(model, [along], duration=0.02, every=0.005, progress=False)
    group = model.cloud.group("x+")
    np.testing.assert_allclose(run.displacements[2, group], [[1e-3, 0.0, 0.5e-3]] * len(group), atol=1e-12)
    np.testing.assert_array_equal(run.displacements[:, model.cloud.group("y-"), 1], 0.0)  # after the release, too
    with pytest.raises(pt.InputError, match=r"must stay on the supports of its nodes, got 0\.001 m across"):
        pt.rollout(model, [pt.PrescribedMotion("x+", (0.0, 1e-3, 0.0))], duration=0.01, every=0.01)


def test_a_reduced_model_on_rollers_keeps_its_supports_and_forces(tmp_path):
    model = on_rollers(bar(), "energy")
    load = pt.SurfaceForce("x+", force=lambda t: 0.02 * np.sin(40.0 * t) ** 2 * np.array([1.0, 0.2, 0.1]))
    options = {"duration": 0.08, "every": 0.002, "progress": False}
    full = pt.rollout(model, [load], **options)
    reduced = pt.hyper_reduce(model, full, modes=12)
    run = pt.rollout(reduced, [load], **options)
    size = np.abs(full.displacements).max()
    assert np.abs(run.displacements - full.displacements).max() < 0.03 * size
    for name in ("x-", "y-", "z-"):
        across = run.displacements[:, model.cloud.group(name), "xyz".index(name[0])]
        assert np.abs(across).max() < 1e-6 * size
        error = np.linalg.norm(run.reactions[name] - full.reactions[name], axis=1).max()
        assert error < 0.1 * np.linalg.norm(full.reactions["x-"], axis=1).max(), name
    pt.save(reduced, tmp_path / "model.h5")
    again = pt.load(tmp_path / "model.h5")
    assert again.supports == reduced.supports == model.supports
    np.testing.assert_array_equal(pt.rollout(again, [load], **options).displacements, run.displacements)


def test_the_surface_compliance_respects_rollers():
    """Modes and residual flexibility together are the inverse of the stiffness, also in pieces of the body."""
    model = pt.Solid(bar(), SOFT, ["x-", pt.Roller("y-", (0.1, 0.9, 0.2))])
    cloud, free = model.cloud, model.free_directions
    held = np.union1d(cloud.group("x-"), cloud.group("y-"))
    nodes = np.setdiff1d(np.unique(cloud.face_nodes), held)
    modes = pt.vibration_modes(model, 6)[0]
    system = pt.lti.linearise(model, [pull()], ["x+"])
    rows = (3 * nodes[:, None] + np.arange(3)).ravel()
    response = free @ np.linalg.solve(system.stiffness.toarray(), free.T.toarray())
    across = np.array([0.1, 0.9, 0.2]) @ response.reshape(len(cloud), 3, -1)[cloud.group("y-")]
    np.testing.assert_allclose(across, 0.0, atol=1e-12 * np.abs(response).max())
    whole = response[np.ix_(rows, rows)]
    own = modes.reshape(6, -1)
    modal = own[:, rows].T @ np.linalg.solve(own @ (system.whole @ own.T), own[:, rows])
    found = residual_flexibility(model, nodes, cloud.points, modes)
    np.testing.assert_allclose(found + modal, whole, atol=1e-9 * np.abs(whole).max())
    piece = _Piece(model).compliance(cloud.points[nodes[0]], 1.0, nodes[:5], nodes)
    expected = whole.reshape(len(nodes), 3, len(nodes), 3)[:5]
    np.testing.assert_allclose(piece, expected, atol=1e-4 * np.abs(whole).max())


def test_a_rail_is_two_rollers():
    """Its nodes move along the line only, with the forces of the rollers across it."""
    cloud, axis = bar(), np.array([1.0, 2.0, 2.0]) / 3
    load = pt.SurfaceForce("x+", force=lambda t: 0.02 * np.sin(60.0 * t) * np.array([1.0, 0.5, 0.2]))
    across = [(2.0, -1.0, 0.0), (0.0, 1.0, -1.0)]
    both = replace(cloud, groups={**cloud.groups, "again": cloud.group("x+")})
    runs = [
        pt.rollout(pt.Solid(both, SOFT, fixed), [load], duration=0.02, every=0.005, step=1e-4, progress=False)
        for fixed in (["x-", pt.Rail("x+", axis)], ["x-", pt.Roller("x+", across[0]), pt.Roller("again", across[1])])
    ]
    size = np.abs(runs[0].displacements).max()
    np.testing.assert_allclose(runs[1].displacements, runs[0].displacements, atol=1e-12 * size)
    moved = runs[0].displacements[-1, cloud.group("x+")]
    np.testing.assert_allclose(moved, np.outer(moved @ axis, axis), atol=1e-12 * size)
    assert np.abs(moved).max() > 0.1 * size
    np.testing.assert_allclose(runs[1].reactions["x+"], runs[0].reactions["x+"], atol=1e-9)
    with pytest.raises(pt.InputError, match=r"axis of Rail on .x\+. must be three finite numbers"):
        pt.Rail("x+", "x")


@pytest.mark.quick
def test_invalid_supports_are_refused():
    cloud = bar()
    with pytest.raises(
        pt.InputError, match=r"normal of Roller on 'y-' must be three finite numbers .* got \(0, 0, 0\)"
    ):
        pt.Roller("y-", (0, 0, 0))
    with pytest.raises(pt.InputError, match="normal of Roller on 'y-' must be three finite numbers"):
        pt.Roller("y-", (0, np.nan, 1))
    middle = int(np.argmin(np.linalg.norm(cloud.points - [0.015, 0.005, 0.005], axis=1)))
    inside = replace(cloud, groups={**cloud.groups, "inside": np.array([middle])})
    with pytest.raises(pt.InputError, match="normal of Roller on 'inside' must be given"):
        pt.Solid(inside, SOFT, [pt.Roller("inside")])
    with pytest.raises(pt.InputError, match="fixed must name each group once, got 'y-' 2 times"):
        pt.Solid(cloud, SOFT, ["y-", pt.Roller("y-")])
    with pytest.raises(pt.InputError, match="fixed must list group names and supports"):
        pt.Solid(cloud, SOFT, [3])
    with pytest.raises(pt.InputError, match="got a body with 3 free rigid motions and no Foundation"):
        pt.equilibrium(pt.Solid(cloud, SOFT, [pt.Roller("y-")]), [pull()])
    with pytest.raises(pt.InputError, match="body must have supports for a static response, got 3 free rigid motions"):
        pt.vibration_modes(pt.Solid(cloud, SOFT, [pt.Roller("y-")]), 3)
