"""What a coarser surface misses between close nodes, against the fine body's own statics."""

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.basis.linear_modes import rest_stiffness, vibration_modes
from palpate.reduction.contact.compliance import NO_COMPLIANCE, contact_displacements
from palpate.reduction.contact.near_field import add_own_compliance, near_field_compliance
from palpate.reduction.contact.residual_flexibility import carriers, residual_flexibility

pytestmark = pytest.mark.slow

SIDE = 0.04


def block(spacing):
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000, poisson=0.45)
    return pt.Solid(pt.box((SIDE, SIDE, SIDE / 2), spacing=spacing), tissue, fixed="z-", form="energy")


def free_surface(body):
    return np.setdiff1d(np.unique(body.cloud.face_nodes), body.cloud.group("z-"))


@pytest.fixture(scope="module")
def surfaces():
    """A fine block's own statics, and those of a coarse one with what it misses."""
    fine, coarse = block(SIDE / 12), block(SIDE / 8)
    modes = vibration_modes(fine, 10)[0]
    nodes, those = free_surface(fine), free_surface(coarse)
    own = residual_flexibility(fine, nodes, fine.cloud.points, modes)
    places, weights = carriers(coarse.cloud, those, fine.cloud, nodes)
    rest = residual_flexibility(coarse, those, fine.cloud.points, modes)
    nearby, near_field = near_field_compliance(fine, nodes, coarse, those, places, weights)
    compliance = NO_COMPLIANCE._replace(
        nodes=nodes, carriers=places, weights=weights, flexibility=rest.astype(np.float32), nearby=nearby,
        near_field=near_field,
    )  # fmt: skip
    return fine, nodes, own, compliance


@pytest.mark.parametrize("radius", [0.002, 0.005, 0.009])  # of the patch that is pressed [m]: one node, and more
@pytest.mark.parametrize("place", [(0.02, 0.02, 0.02), (0.032, 0.012, 0.02), (0.04, 0.02, 0.012)])
def test_with_the_near_field_a_coarser_surface_agrees_with_the_fine_one(surfaces, radius, place):
    fine, nodes, own, compliance = surfaces
    pressed = np.linalg.norm(fine.cloud.points[nodes] - place, axis=1) < radius
    force = np.zeros((len(nodes), 3))
    force[pressed] = np.array([0.1, 0.2, -1.0]) / pressed.sum()
    wanted = (own @ force.reshape(-1)).reshape(-1, 3)
    alone = compliance._replace(nearby=np.zeros((0, 0), dtype=int), near_field=np.zeros((0, 0, 3, 3), dtype=np.float32))
    missed = {}
    for name, known in (("alone", alone), ("with it", compliance)):
        found = contact_displacements(known, fine.cloud.points, force[None], [True])[0][nodes]
        missed[name] = np.linalg.norm(found - wanted) / np.linalg.norm(wanted)
    print(radius, place, pressed.sum(), missed)
    assert missed["with it"] < 0.15
    assert missed["with it"] < 0.5 * missed["alone"]


def test_near_field_plus_coarser_flexibility_is_symmetric_and_positive(surfaces):
    _, nodes, _, compliance = surfaces
    count = len(nodes)
    spread = np.zeros((count, len(compliance.flexibility) // 3))
    np.add.at(spread, (np.arange(count)[:, None], compliance.carriers), compliance.weights)
    spread = np.kron(spread, np.eye(3))
    far, lowest = spread @ compliance.flexibility @ spread.T, []
    indefinite = compliance.near_field.copy()
    for i in range(count):
        indefinite[i, compliance.nearby[i] == i] -= 0.015 * np.eye(3, dtype=np.float32)
    raised = add_own_compliance(
        compliance.flexibility, compliance.carriers, compliance.weights, compliance.nearby, indefinite
    )
    for near_field in (compliance.near_field, indefinite, raised):
        whole = np.zeros((count, 3, count, 3))
        for i in range(count):
            for j, part in zip(compliance.nearby[i], near_field[i], strict=True):
                whole[i, :, j] += part
        whole = whole.reshape(3 * count, -1)
        np.testing.assert_allclose(whole, whole.T, atol=1e-6 * whole.max())
        lowest.append(np.linalg.eigvalsh(whole + far)[0])
    own = np.diagonal(whole + far).mean()
    assert lowest[0] > -0.02 * own
    assert lowest[1] < 0
    assert 0 < lowest[2] < 0.1 * own


def test_stiffness_blocks_are_those_of_the_whole_matrix():
    from palpate.reduction.basis.linear_modes import stiffness_blocks

    body = block(SIDE / 8)
    whole, blocks = rest_stiffness(body).toarray(), stiffness_blocks(body, np.float32)
    for (c, e), part in blocks.items():
        np.testing.assert_allclose(part.toarray(), whole[c::3, e::3], atol=1e-5 * abs(whole).max())
