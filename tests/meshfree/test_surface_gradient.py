"""Fits in the depth below curved surfaces: exactness, the forms of a ball, rotation, and the compliance of a ball."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy.sparse as sparse
from closed_surfaces import ball
from scipy.spatial.transform import Rotation
from scipy.special import eval_legendre

import palpate as pt
from palpate.dynamics.solid.cutting.cut import uncut_state
from palpate.meshfree import consistent
from palpate.meshfree.cut.points import inside_body
from palpate.meshfree.cut.stencils import QUADRATIC_FIT, fit_rows
from palpate.meshfree.cut.surface import NO_CUT, cut_surface, swept
from palpate.meshfree.surface_gradient import surface_forms, with_surface_gradient
from palpate.reduction.basis.linear_modes import stiffness_blocks

RADIUS, SPACING = 0.02, 0.005
TISSUE = pt.materials.MooneyRivlin(C1=1100.0, C2=0.0, density=1060.0, poisson=0.45)


@pytest.fixture(scope="module")
def cloud():
    """A filled ball of four spacings."""
    return pt.fill(ball(RADIUS, 0.001), SPACING, seed=0)


@pytest.fixture(scope="module")
def fits(cloud):
    """Its stencils before and after."""
    before = pt.moving_least_squares(cloud.points, order=2, neighbours=42)
    return before, with_surface_gradient(before, cloud)


def test_linear_fields_are_differentiated_exactly(cloud, fits):
    slope = np.random.default_rng(0).normal(size=(3, 2))
    expected = np.broadcast_to(slope.T, (len(cloud), 2, 3))
    np.testing.assert_allclose(fits[1].gradient(1.0 + cloud.points @ slope), expected, atol=1e-9)


def test_only_nodes_of_the_surface_change(cloud, fits):
    changed = np.any(fits[0].first != fits[1].first, axis=(1, 2))
    np.testing.assert_array_equal(np.flatnonzero(changed), np.unique(cloud.face_nodes))


def test_nothing_changes_on_faces_edges_and_corners_of_a_box():
    cloud = pt.box((0.05, 0.04, 0.04), SPACING, jitter=0.25)
    before = pt.moving_least_squares(cloud.points, order=2, neighbours=42)
    after = with_surface_gradient(before, cloud)
    np.testing.assert_allclose(after.first, before.first, atol=1e-9 / SPACING)


def test_a_lattice_has_no_forms():
    cloud = pt.box((0.04, 0.03, 0.03), SPACING)
    stencils = pt.moving_least_squares(cloud.points, order=2, neighbours=42)
    assert with_surface_gradient(stencils, cloud) is stencils
    assert not surface_forms(cloud, stencils).form.any()


def test_forms_of_a_ball_are_those_of_its_curvature(cloud, fits):
    """The surface is below its tangent plane by the square of the distance over the diameter, and 7 % more far away."""
    normal, form = surface_forms(cloud, fits[0])
    surface = np.unique(cloud.face_nodes)
    radial = cloud.points[surface] / np.linalg.norm(cloud.points[surface], axis=1)[:, None]
    assert np.sum(normal[surface] * radial, axis=1).min() > 0.98
    np.testing.assert_allclose(np.einsum("nij,nj->ni", form, normal), 0.0, atol=1e-12 / RADIUS)
    plane = np.eye(3) - normal[surface, :, None] * normal[surface, None, :]
    error = np.linalg.norm(2 * RADIUS * form[surface] + plane, axis=(1, 2)) / np.sqrt(2)
    assert error.max() < 0.12
    inside = np.setdiff1d(np.arange(len(cloud)), surface)
    assert not form[inside].any()
    assert not normal[inside].any()


def test_a_rotation_of_the_cloud_turns_the_weights(cloud, fits):
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    turned = replace(cloud, points=cloud.points @ turn.T, face_normals=cloud.face_normals @ turn.T)
    after = with_surface_gradient(replace(fits[0], first=fits[0].first @ turn.T), turned)
    np.testing.assert_allclose(after.first, fits[1].first @ turn.T, atol=1e-8 / SPACING)


def wave_compliance(cloud, degree):
    """Return a ball's compliance under pressures of a Legendre polynomial, over Lur'e's, as a mean over 20 axes.

    Pressures act through the patches; the displacement that counts is their work.
    """
    body, n, x = pt.Solid(cloud, TISSUE), len(cloud), cloud.points
    blocks = stiffness_blocks(body)
    stiffness = sparse.bmat(
        [[blocks[a, b] if a <= b else blocks[b, a].T for b in range(3)] for a in range(3)]
    ).toarray()
    turns = [np.cross(axis, x).T.ravel() for axis in np.eye(3)]
    rigid = np.linalg.qr(np.column_stack([np.repeat(np.eye(3), n, axis=0), *turns]))[0]
    stiffness += np.trace(stiffness) / n * rigid @ rigid.T
    areas = np.zeros(n)
    np.add.at(areas, cloud.face_nodes, cloud.face_areas)
    radial = x / np.maximum(np.linalg.norm(x, axis=1), 1e-12)[:, None]
    axes = np.random.default_rng(0).normal(size=(20, 3))
    wave = eval_legendre(degree, radial @ (axes / np.linalg.norm(axes, axis=1)[:, None]).T)
    loads = [(body.patches.T @ ((areas * each)[:, None] * radial)).T.ravel() for each in wave.T]
    loads = np.stack(loads, axis=1)
    loads -= rigid @ (rigid.T @ loads)
    work = np.sum(loads * np.linalg.solve(stiffness, loads), axis=0)
    return np.mean(work / (areas @ wave**2)) / lure_compliance(degree)


def lure_compliance(n):
    """Return radial displacement over radial stress [m/Pa] on a ball (Lur'e, 1964)."""
    nu = TISSUE.poisson
    ratio = n * (n**2 + 2 * n - 1 + 2 * nu) / (n - 1)
    stress = 2 * TISSUE.shear_modulus * ((n + 1) * (n**2 - n - 2 - 2 * nu) - (n - 1) * ratio)
    return RADIUS * ((n + 1) * (n - 2 + 4 * nu) - ratio) / stress


def test_a_ball_yields_to_a_wave_of_six_spacings_as_in_theory(cloud, monkeypatch):
    assert wave_compliance(cloud, 4) == pytest.approx(1.0, abs=0.07)
    monkeypatch.setattr(consistent, "with_surface_gradient", lambda stencils, cloud: stencils)
    assert wave_compliance(cloud, 4) < 0.85


@pytest.mark.slow
def test_a_cut_that_barely_lengthens_a_bond_keeps_the_fit_of_a_surface_node(cloud):
    body = pt.Solid(cloud, TISSUE)
    state, n, surface_nodes = uncut_state(body), len(cloud), np.unique(cloud.face_nodes)
    is_inside = partial(inside_body, state.uncut, cloud.points[cloud.triangles])
    place = np.array([-RADIUS, 0.0, -0.3 * SPACING])
    node = surface_nodes[np.argmin(np.linalg.norm(cloud.points[surface_nodes] - place, axis=1))]

    def rows_under(end):
        """Return the row of the node, if a rectangle in the ball from the middle to x = end touches it."""
        edges = np.array([[(x, y, 0.2 * SPACING) for y in np.linspace(-1.5, 1.5, 4) * SPACING] for x in (0.0, end)])
        surface = cut_surface(NO_CUT, swept(edges), is_inside, SPACING)
        return fit_rows(state, surface, np.array([node]), np.zeros(n, dtype=bool))

    short, long = -0.2 * RADIUS, -0.9 * RADIUS
    assert not len(rows_under(short).nodes)
    while abs(long - short) > 0.01 * SPACING:
        middle = 0.5 * (short + long)
        short, long = (short, middle) if len(rows_under(middle).nodes) else (middle, long)
    rows = rows_under(long)
    assert rows.kind == [QUADRATIC_FIT]
    before = pt.moving_least_squares(cloud.points, order=2, neighbours=body.neighbours)
    found, exact, plain = np.zeros((3, n, 3))
    found[rows.near] = rows.first
    for weights, stencils in ((exact, with_surface_gradient(before, cloud)), (plain, before)):
        weights[stencils.neighbours[node]] = stencils.first[node]
    np.testing.assert_allclose(found, exact, atol=1e-3 / SPACING)
    assert np.abs(plain - exact).max() > 1e-2 / SPACING
