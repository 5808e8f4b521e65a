"""Displacements of interior nodes under contact forces: residual statics, interpolated to finer nodes."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.contact.tools import surface_nodes
from palpate.reduction.basis.linear_modes import vibration_modes
from palpate.reduction.contact.compliance import NO_COMPLIANCE, contact_displacements
from palpate.reduction.contact.interior import _linear_fits, interior_flexibility
from palpate.reduction.contact.residual_flexibility import carriers, residual_flexibility
from palpate.reduction.training.fit_compliance import _free_nodes

pytestmark = pytest.mark.slow

TISSUE = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000, poisson=0.4)
SIZE = (0.06, 0.06, 0.03)


def block(spacing):
    return pt.Solid(pt.box(SIZE, spacing=spacing), TISSUE, "z-", form="energy")


@pytest.fixture(scope="module")
def fine():
    body = block(0.005)
    return body, vibration_modes(body, 10)[0]


def compliance_from(statics, body, modes):
    """The compliance of a body's surface and inside by the statics of a model of it."""
    (those, deeper), (nodes, deep) = (_free_nodes(of) for of in (statics, body))
    rows = residual_flexibility(statics, those, body.cloud.points, modes, deeper)
    places, weights = carriers(statics.cloud, those, body.cloud, nodes)
    count = 3 * len(those)
    return NO_COMPLIANCE._replace(
        nodes=nodes, carriers=places, weights=weights, flexibility=rows[:count].astype(np.float32),
        interior=interior_flexibility(statics.cloud, deeper, those, rows[count:], body.cloud, deep),
    )  # fmt: skip


@pytest.fixture(scope="module")
def own(fine):
    return compliance_from(fine[0], *fine)


def pressed(compliance, points):
    """Forces on the nodes about the middle of the top, those nodes, and what they do."""
    middle = np.linalg.norm(points[compliance.nodes] - (0.03, 0.03, SIZE[2]), axis=1) < 0.0076
    forces = np.zeros((len(compliance.nodes), 3))
    forces[middle] = np.array([0.1, 0.0, -1.0]) / middle.sum()
    return forces, compliance.nodes[middle], contact_displacements(compliance, points, forces[None], [True])[0]


def test_every_free_node_is_a_surface_node_or_follows_the_surface(own, fine):
    cloud = fine[0].cloud
    assert not np.intersect1d(own.nodes, own.interior.nodes).size
    np.testing.assert_array_equal(
        np.union1d(own.nodes, own.interior.nodes), np.setdiff1d(np.arange(len(cloud)), cloud.group("z-"))
    )
    assert np.isin(own.nodes, surface_nodes(cloud)).all()


def test_interior_displacements_of_statics_are_those_of_the_static_response(own, fine):
    body, modes = fine
    forces, _, found = pressed(own, body.cloud.points)
    load = np.zeros((len(body.cloud), 3))
    load[own.nodes] = forces
    every = np.flatnonzero(~body.fixed_mask)
    rows = residual_flexibility(body, every, body.cloud.points, modes)  # of all nodes, as if all were of the surface
    wanted = (rows @ load[every].reshape(-1)).reshape(-1, 3)
    np.testing.assert_allclose(found[every], wanted, atol=1e-3 * np.abs(wanted).max())


def test_the_interior_does_not_change_the_surface_and_the_energy(own, fine):
    forces, _, found = pressed(own, fine[0].cloud.points)
    bare, energy = contact_displacements(own._replace(interior=None), fine[0].cloud.points, forces[None], [True])
    np.testing.assert_array_equal(found[own.nodes], bare[own.nodes])
    assert not bare[own.interior.nodes].any()
    assert contact_displacements(own, fine[0].cloud.points, forces[None], [True])[1] == energy


def test_interior_displacements_of_two_tools_add_up(own, fine):
    points = fine[0].cloud.points
    forces, _, one = pressed(own, points)
    other = np.roll(forces, 3, axis=0)
    both = contact_displacements(own, points, np.stack([forces, other]), [True, True])[0]
    alone = contact_displacements(own, points, other[None], [True])[0]
    np.testing.assert_allclose(both, one + alone, atol=1e-12)


def test_scaling_the_surface_compliance_does_not_change_the_interior(own, fine):
    body, modes = fine
    carried = compliance_from(block(0.0075), body, modes)
    for compliance in (own, carried):
        _, _, whole = pressed(compliance, body.cloud.points)
        _, _, half = pressed(compliance.scaled(0.5), body.cloud.points)
        np.testing.assert_allclose(half[compliance.nodes], 0.5 * whole[compliance.nodes], rtol=1e-6)
        np.testing.assert_allclose(
            half[compliance.interior.nodes], whole[compliance.interior.nodes], rtol=1e-5, atol=1e-12
        )


def test_linear_fields_are_interpolated_exactly():
    """By fits to known nodes; those that lie in a plane leave no slope undefined."""
    random = np.random.default_rng(0)
    known, points = random.random((400, 3)), 0.2 + 0.6 * random.random((50, 3))
    slope = random.standard_normal((3, 3))
    sources, shares = _linear_fits(points, known, 0.14)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=0.02)
    np.testing.assert_allclose(np.einsum("iw,iwc->ic", shares, known[sources] @ slope), points @ slope, atol=0.03)
    known[:, 2] = 0.5
    sources, shares = _linear_fits(points, known, 0.14)
    assert np.isfinite(shares).all()
    assert np.abs(shares).max() < 2.0


def test_the_interior_of_a_coarser_model_agrees_with_that_of_the_finer(own, fine):
    body, modes = fine
    carried = compliance_from(block(0.0075), body, modes)
    _, _, wanted = pressed(own, body.cloud.points)
    _, _, found = pressed(carried, body.cloud.points)
    within = own.interior.nodes
    missed = np.linalg.norm(found[within] - wanted[within], axis=1)
    assert np.sum(missed) < 0.3 * np.sum(np.linalg.norm(wanted[within], axis=1))
