"""Cut bodies: uniform stress along a cut, separated pieces, shared tables, momentum, and bad input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.meshfree.cut.surface import swept

pytestmark = pytest.mark.slow

SPACING = 1e-3
SIZE = np.array([12, 11, 13]) * SPACING
TISSUE = pt.materials.MooneyRivlin(C1=500.0, C2=0.0, poisson=0.45, density=1000.0)


def rectangle(center, normal, length, reach=0.05):
    """Rectangle normal to a direction, from far behind to `length` beyond its centre along x."""
    normal = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    along = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    along /= np.linalg.norm(along)
    ends = np.array([center - reach * along, center + length * along])
    sides = reach * np.array([-1.0, 1.0])[:, None] * np.cross(normal, along)
    return swept(ends[:, None] + sides[None])


@pytest.fixture(scope="module", params=["lattice", "jittered"])
def block(request):
    cloud = pt.box(SIZE, SPACING, jitter=0.25 if request.param == "jittered" else 0.0, seed=1)
    return pt.Solid(cloud.with_group("all", np.unique(cloud.face_nodes)), TISSUE)


@pytest.fixture(scope="module")
def halved(block):
    """The block, cut through obliquely, and the nodes of one half."""
    center, normal = 0.5 * SIZE + (0, 0, 0.4e-3), np.array([0.3, 0.2, 1.0])
    return pt.cut(block, rectangle(center, normal, 0.05)), (block.cloud.points - center) @ normal > -1e-9


@pytest.mark.parametrize(
    ("height", "normal"), [(6.5, (0, 0, 1)), (6.0, (0, 0, 1)), (6.4, (0.3, 0.2, 1.0))], ids=["between", "on", "oblique"]
)
def test_uniform_stress_along_a_cut_moves_no_node(block, height, normal):
    normal = np.array(normal) / np.linalg.norm(normal)
    center = np.array([0.5 * SIZE[0], 0.5 * SIZE[1], height * SPACING])
    opened = pt.cut(block, rectangle(center, normal, 0.0))
    along = np.cross(normal, [0.0, 1.0, 0.0])
    along /= np.linalg.norm(along)
    lame, shear = TISSUE.lame, TISSUE.shear_modulus
    strain = 1e-6 * (np.outer(along, along) - lame / (lame + 2 * shear) * np.outer(normal, normal))
    stress = 2 * shear * strain + lame * np.trace(strain) * np.eye(3)
    inner = np.setdiff1d(np.arange(len(block.cloud)), block.cloud.group("all"))
    u = block.cloud.points @ strain
    before, after = (np.abs(body.force(u) * body.volumes[:, None])[inner].max() for body in (block, opened))
    assert after <= before * (1 + 1e-6) + 2e-5 * np.abs(stress).max() * SPACING**2
    assert np.any(opened.stencils.first[:, 0] != 0.0)


def test_halves_turn_apart_without_energy_and_force(halved):
    body, upper = halved
    points = body.cloud.points
    turned = [points @ Rotation.from_rotvec(way).as_matrix().T for way in ((0.4, -0.3, 0.8), (-0.7, 0.2, 0.1))]
    u = np.where(upper[:, None], turned[0] + (0.01, 0.0, 0.02), turned[1]) - points
    assert body.strain_energy(u) <= 1e-14 * TISSUE.shear_modulus * body.volumes.sum()
    force = np.abs(body.force(u) * body.volumes[:, None]).max()
    assert force <= 1e-10 * TISSUE.shear_modulus * SPACING**2


def test_forces_of_a_cut_body_are_the_derivative_of_its_energy_and_balance(block):
    body = pt.cut(block, rectangle(0.5 * SIZE + (0, 0, 0.3e-3), (0.3, 0.2, 1.0), 1e-3))
    random = np.random.default_rng(0)
    u, way = 0.02 * SPACING * random.normal(size=(2, len(body.cloud), 3))
    force = body.force(u) * body.volumes[:, None]
    step = 1e-3
    slope = (body.strain_energy(u + step * way) - body.strain_energy(u - step * way)) / (2 * step)
    assert np.sum(force * way) == pytest.approx(-slope, rel=1e-6)
    assert np.abs(force.sum(axis=0)).max() <= 1e-12 * np.abs(force).sum()
    moment = np.cross(body.cloud.points + u, force)
    assert np.abs(moment.sum(axis=0)).max() <= 1e-8 * np.abs(moment).sum()


def test_the_smoothing_keeps_integrals(block):
    body = pt.cut(block, rectangle(0.5 * SIZE, (0.3, 0.2, 1.0), 2e-3))
    field = np.random.default_rng(0).normal(size=len(body.cloud))
    assert body.volumes @ body.smooth(field) == pytest.approx(body.volumes @ field, rel=1e-9)
    weights = np.random.default_rng(1).normal(size=(1, len(field)))
    assert (body.smooth_transposed(weights) @ field)[0] == pytest.approx((weights @ body.smooth(field))[0], rel=1e-9)


def test_a_cut_outside_the_body_changes_no_bit(block):
    with pytest.warns(UserWarning, match="the cut parts nothing: its triangles reach from"):
        body = pt.cut(block, rectangle((0.5 * SIZE[0], 0.5 * SIZE[1], 4 * SIZE[2]), (0, 0, 1), 0.05))
    u = 0.01 * SPACING * np.random.default_rng(0).normal(size=(len(block.cloud), 3))
    np.testing.assert_array_equal(body.force(u), block.force(u))
    assert not len(body.released_nodes)


def test_a_body_does_not_change_when_it_is_cut(block):
    u = 0.01 * SPACING * np.random.default_rng(0).normal(size=(len(block.cloud), 3))
    before, first = block.force(u), pt.cut(block, rectangle(0.5 * SIZE, (0, 0, 1), -2e-3))
    opened = first.force(u)
    for end in (0.0, 2e-3):  # two further cuts of one body
        pt.cut(first, rectangle(0.5 * SIZE, (0, 0, 1), end))
    np.testing.assert_array_equal(block.force(u), before)
    np.testing.assert_array_equal(first.force(u), opened)
    assert len(block.cut_surface.triangles) == 0


def test_many_short_cuts_are_nearly_one_long_cut(block):
    center, across = 0.5 * SIZE + (0, 0, 0.3e-3), np.linspace(-0.05, 0.05, 41)
    ends = center[0] + SPACING * np.array([-50.0, -2.0, -1.75, -1.5, -1.25, -1.0])
    edges = np.array([np.column_stack([np.full(41, x), across, np.full(41, center[2])]) for x in ends])
    at_once, body = pt.cut(block, swept(edges)), block
    for k in range(len(edges) - 1):
        body = pt.cut(body, swept(edges[k : k + 2]))
    u = 0.05 * SPACING * np.tanh((block.cloud.points - center) / SPACING) * (0, 0, 1)
    assert body.strain_energy(u) == pytest.approx(at_once.strain_energy(u), rel=2e-3)
    assert block.strain_energy(u) != pytest.approx(at_once.strain_energy(u), rel=2e-2)


def test_a_sliver_of_one_layer_is_released(block):
    body = pt.cut(block, rectangle((0.5 * SIZE[0], 0.5 * SIZE[1], 0.5 * SPACING), (0, 0, 1), 0.05))
    bottom = np.flatnonzero(block.cloud.points[:, 2] < 0.5 * SPACING)
    assert len(body.released_nodes)
    assert np.isin(body.released_nodes, bottom).all()
    u = 0.01 * SPACING * np.random.default_rng(0).normal(size=(len(block.cloud), 3))
    assert not body.force(u)[body.released_nodes].any()
    moved = u.copy()
    moved[body.released_nodes] += SPACING
    assert body.strain_energy(moved) == body.strain_energy(u)


def test_weights_between_two_close_cuts_stay_bounded(block):
    """A slice of 0.75 spacings cannot keep the sums of uniform stress."""
    first = pt.cut(block, rectangle(0.5 * SIZE + (0, 0, 0.2e-3), (0.3, 0.2, 1.0), 2e-3))
    body = pt.cut(first, rectangle(0.5 * SIZE + (0, 0, 0.95e-3), (0.3, 0.2, 1.0), 3e-3))
    stencils, uncut = body.stencils, body._cut.uncut
    weights = SPACING * stencils.first[stencils.row]
    size = np.sum(weights**2, axis=(1, 2)) + np.sum(weights.sum(axis=1) ** 2, axis=1)
    assert np.all(size <= uncut.limit * (1 + 1e-9))
    assert body.stability.step >= block.stability.step / 1.5


def test_a_cut_body_has_a_stable_step_like_the_uncut_one(halved, block):
    assert halved[0].stability.step >= block.stability.step / 1.5


def test_halves_that_fly_apart_keep_their_momentum(halved):
    body, upper = halved
    velocity = np.where(upper[:, None], (0.0, 0.1, 0.3), (0.2, 0.0, -0.3))
    run = pt.rollout(body, duration=4e-3, every=2e-3, velocity=velocity, progress=False)
    momentum = np.einsum("n,tnc->tc", body.masses, run.velocities)
    np.testing.assert_allclose(momentum, momentum[:1].repeat(3, axis=0), rtol=0.0, atol=1e-9 * body.masses.sum())
    np.testing.assert_allclose(run.displacements[-1], 4e-3 * velocity, rtol=0.0, atol=1e-9)


BAD_CUTS = {
    "must be numbers of shape": [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
    "must be finite": [[(0, 0, 0), (1, 0, np.nan), (0, 1, 0)]],
    "must be at least .* wide": [[(0, 0, 0), (1, 0, 0), (1, 0, 0)]],
}


@pytest.mark.parametrize("message", BAD_CUTS)
def test_bad_triangles_are_refused(block, message):
    with pytest.raises((pt.InputError, pt.CloudError), match=message):
        pt.cut(block, BAD_CUTS[message])


def test_bodies_that_cannot_be_cut_are_refused():
    cloud = pt.box((6e-3, 6e-3, 6e-3), SPACING)
    triangles = rectangle((3e-3, 3e-3, 3e-3), (0, 0, 1), 0.0)
    with pytest.raises(pt.InputError, match="energy form"):
        pt.cut(pt.Solid(cloud, TISSUE, "x-", form="strong"), triangles)
    with pytest.raises(pt.InputError, match="planes of symmetry"):
        pt.cut(pt.Solid(cloud, TISSUE, pt.SymmetryPlane("x-")), triangles)


@pytest.mark.parametrize("inward", [True, False], ids=["together", "apart"])
def test_faces_of_a_cut_do_not_pass_through_each_other(block, inward):
    body = pt.cut(block, rectangle(0.5 * SIZE + (0, 0, 0.3e-3), (0, 0, 1), 0.05))
    upper = block.cloud.points[:, 2] > 0.5 * SIZE[2] + 0.3e-3
    velocity = np.where(upper[:, None], (0, 0, -0.05 if inward else 0.05), (0.0, 0.0, 0.0))
    run = pt.rollout(body, duration=8e-3, every=2e-3, velocity=velocity, progress=False)
    momentum = np.einsum("n,tnc->tc", body.masses, run.velocities)
    np.testing.assert_allclose(momentum, momentum[:1].repeat(5, axis=0), rtol=0.0, atol=1e-9 * body.masses.sum())
    heights = block.cloud.points[:, 2] + run.displacements[-1, :, 2]
    opening = heights[upper].min() - heights[~upper].max()
    if inward:
        assert opening >= -0.1 * SPACING  # the faces are penalised, so they overlap a little
        assert run.velocities[-1, ~upper, 2].mean() < -0.01  # pushed
        assert np.abs(run.balance).max() <= 0.1 * run.kinetic[0]
    else:
        assert opening >= 0.05 * 8e-3


def test_no_triangles_cut_nothing(block):
    assert len(pt.cut(block, np.zeros((0, 3, 3))).cut_surface.triangles) == 0


def test_a_cut_in_millimetres_warns_and_changes_nothing(block):
    with pytest.warns(UserWarning, match="give corners in metres"):
        body = pt.cut(block, 1e3 * rectangle(0.5 * SIZE, (0, 0, 1), 0.05) + 5.0)
    assert len(body.cut_surface.triangles) == 0


@pytest.mark.parametrize("side", ["z+", "z-", "x+"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_cut_along_a_face_releases_nothing(block, side, turned):
    axis = "xyz".index(side[0])
    middle = 0.5 * SIZE
    middle[axis] = SIZE[axis] if side[1] == "+" else 0.0
    across = np.eye(3)[[(axis + 1) % 3, (axis + 2) % 3]]
    a, b, c, d = (middle + x * across[0] + y * across[1] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    triangles = np.array([(a, b, c), (a, c, d)])
    with pytest.warns(UserWarning, match="parts nothing"):
        body = pt.cut(block, triangles[:, ::-1] if turned else triangles)
    assert not len(body.released_nodes)


def test_a_huge_triangle_cuts_as_one_of_the_size_of_the_body(block):
    def plane(width):
        x, y, z = 0.5 * SIZE + (0.3 * SPACING, 0.0, 0.0)
        return np.array([[(x, y - width, z - width), (x, y + width, z - width), (x, y, z + 2 * width)]])

    u = 0.01 * SPACING * np.random.default_rng(0).normal(size=(len(block.cloud), 3))
    near, far = (pt.cut(block, plane(width)) for width in (0.1, 1e6))
    np.testing.assert_allclose(far.force(u), near.force(u), rtol=1e-9, atol=1e-12)


def test_statics_names_a_piece_that_nothing_holds(block):
    held = pt.Solid(block.cloud, TISSUE, fixed="z-")
    body = pt.cut(held, rectangle(0.5 * SIZE + (0.0, 0.0, 0.3 * SPACING), (0, 0, 1), 1.0))
    assert len(body.loose_nodes) > 10
    with pytest.raises(pt.DivergenceError, match="nothing holds them; cut with detached='remove'"):
        pt.equilibrium(body, [pt.Gravity((0, 0, -9.81))])
