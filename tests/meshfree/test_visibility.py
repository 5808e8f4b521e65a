"""Stencils do not cross a cleft."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree.visibility import is_pair

pytestmark = pytest.mark.slow

SPACING, ARM = 0.006, 0.018
# mean displacement [mm] of the lower arm's end where the upper one's moves by 3 mm: linear elasticity, hexahedra of
# order 2 with edges of 3 mm
MOVED = {0.5: 0.077, 1.0: 0.120, 1.5: 0.144, 2.0: 0.153, 3.0: 0.144, 4.0: 0.116}


def cells_surface(solid, xs, ys, zs):
    """Return the surface (vertices, triangles) of the solid cells (a, b, c) of a grid of planes."""
    number, faces = {}, []
    for cell in zip(*np.nonzero(solid), strict=True):
        for axis in range(3):
            for side in (0, 1):
                other = list(cell)
                other[axis] += 1 if side else -1
                if all(0 <= other[a] < solid.shape[a] for a in range(3)) and solid[tuple(other)]:
                    continue
                corner = list(cell)
                corner[axis] += side
                u, v = (axis + 1) % 3, (axis + 2) % 3
                ring = []
                for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    place = corner.copy()
                    place[u] += du
                    place[v] += dv
                    ring.append(number.setdefault(tuple(place), len(number)))
                a, b, c, d = ring if side else ring[::-1]
                faces += [(a, b, c), (a, c, d)]
    return np.array([(xs[i], ys[j], zs[k]) for i, j, k in number]), np.array(faces)


def c_shape(gap):
    """Return the surface of a C: a back 18 mm thick, and two arms 42 mm long and 18 mm thick."""
    solid = np.ones((2, 1, 3), bool)
    solid[1, 0, 1] = False
    return cells_surface(solid, [0, ARM, 0.06], [0, 0.03], [0, ARM, ARM + gap, 2 * ARM + gap])


def moved_arm(gap, spacing=SPACING):
    """Return the mean displacement [mm] of the lower arm's end as the end of the upper one rises by 3 mm."""
    cloud = pt.fill(pt.Surface(*c_shape(gap)), spacing=spacing)
    upper = cloud.points[:, 2] > ARM + gap / 2
    ends = cloud.points[:, 0] > 0.055
    cloud = cloud.with_group("end", ends & upper).with_group("back", cloud.points[:, 0] < 0.003)
    tissue = pt.materials.MooneyRivlin(C1=2.2e3, C2=0, density=1060, poisson=0.45)
    body = pt.Solid(cloud, tissue, fixed="back")
    rest = pt.equilibrium(body, [pt.PrescribedMotion("end", (0, 0, 0.003))])
    return 1e3 * rest.displacements[ends & ~upper, 2].mean()


@pytest.mark.parametrize(("gap", "error"), [(2.0, 0.06), (3.0, 0.06), pytest.param(4.0, 0.06, marks=pytest.mark.slow),
                                            pytest.param(1.5, 0.15, marks=pytest.mark.slow),
                                            pytest.param(1.0, 0.25, marks=pytest.mark.slow), (0.5, 0.3)])  # fmt: skip
def test_one_arm_hardly_moves_the_other_as_in_finite_elements(gap, error):
    assert moved_arm(gap * SPACING) == pytest.approx(MOVED[gap], abs=error)


@pytest.mark.quick
def test_no_stencil_crosses_a_cleft():
    gap = SPACING
    cloud = pt.fill(pt.Surface(*c_shape(gap)), spacing=SPACING)
    body = pt.Solid(cloud, pt.materials.MooneyRivlin(C1=2.2e3, C2=0, density=1060, poisson=0.45))
    upper, arm = cloud.points[:, 2] > ARM + gap / 2, cloud.points[:, 0] > ARM + 1.5 * SPACING
    for near in (body.stencils.neighbours, body.smoothing.neighbours):
        crossing = (upper[near] != upper[:, None]) & arm[near] & arm[:, None]
        assert not crossing.any()
    patches = body.patches.tocoo()
    assert not (arm[patches.row] & arm[patches.col] & (upper[patches.row] != upper[patches.col])).any()


def test_a_slit_opens_a_ring():
    """A ring with a slit of one spacing is a curved beam: its ends do not move together."""
    angle = np.linspace(0.02, 2 * np.pi - 0.02, 60)
    inner, outer, height = 0.04, 0.06, 0.02
    corners = [(r, z) for r, z in ((inner, 0), (outer, 0), (outer, height), (inner, height))]
    points = np.array([(r * np.cos(a), r * np.sin(a), z) for a in angle for r, z in corners])
    faces = [(0, 1, 2), (0, 2, 3)]
    last = 4 * (len(angle) - 1)
    faces += [(last, last + 2, last + 1), (last, last + 3, last + 2)]
    for k in range(len(angle) - 1):
        for c in range(4):
            a, b = 4 * k + c, 4 * k + (c + 1) % 4
            faces += [(a, a + 4, b + 4), (a, b + 4, b)]
    surface = pt.Surface(points, np.array(faces))
    if surface.volume < 0:
        surface = pt.Surface(points, np.array(faces)[:, ::-1])
    cloud = pt.fill(surface, spacing=0.005)
    near_slit, above = cloud.points[:, 0] > 0.035, cloud.points[:, 1] > 0
    node = np.arange(len(cloud))
    pairs = np.array([(i, j) for i in node[near_slit & above] for j in node[near_slit & ~above]])
    close = np.linalg.norm(cloud.points[pairs[:, 0]] - cloud.points[pairs[:, 1]], axis=1) < 3 * cloud.spacing
    assert close.sum() > 50
    assert is_pair(cloud.hidden, *pairs[close].T).all()


@pytest.mark.quick
def test_pairs_are_hidden_both_ways_and_in_mirror_images():
    cloud = pt.fill(pt.Surface(*c_shape(SPACING)), spacing=SPACING)
    assert (cloud.hidden != cloud.hidden.T).nnz == 0
    assert cloud.hidden.nnz > 1000


@pytest.mark.quick
def test_all_nodes_of_a_convex_body_see_each_other():
    assert pt.box((0.03, 0.02, 0.02), spacing=0.005).hidden.nnz == 0
    assert pt.sheet(0.02 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]), 0.004).hidden.nnz == 0


def test_a_right_angle_keeps_most_of_its_stencils():
    """The concave edge of an L does not count as a cleft: near nodes across it remain neighbours."""
    solid = np.ones((2, 1, 2), bool)
    solid[1, 0, 1] = False
    cloud = pt.fill(pt.Surface(*cells_surface(solid, [0, 0.03, 0.06], [0, 0.03], [0, 0.03, 0.06])), spacing=SPACING)
    near = np.linalg.norm(cloud.points[:, None, ::2] - 0.03, axis=2)[:, 0] < 1.5 * SPACING
    hidden = cloud.hidden[near][:, near]
    assert hidden.nnz < 0.05 * near.sum() ** 2


@pytest.mark.quick
def test_pairs_of_other_points_are_refused():
    cloud = pt.box((0.03, 0.02, 0.02), spacing=0.005)
    with pytest.raises(pt.InputError, match=r"hidden must have shape \(4, 4\)"):
        pt.moving_least_squares(cloud.points[:4], order=1, neighbours=4, hidden=cloud.hidden)
