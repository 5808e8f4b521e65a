"""Changes of a tool's force by the supports, against closed forms and bodies with other supports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.basis.linear_modes import rest_stiffness
from palpate.reduction.contact.coarse_body import coarse_body
from palpate.reduction.contact.support_sensitivity import Press, select_presses, support_sensitivity

pytestmark = pytest.mark.slow

TISSUE = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000, poisson=0.4)
SIZE = (0.04, 0.04, 0.02)


@pytest.fixture(scope="module")
def cloud():
    """A block of which a disc in the middle of the lower face is held."""
    made = pt.box(SIZE, spacing=0.005)
    below = made.points[:, 2] == 0
    return made.with_group("disc", below & (np.linalg.norm(made.points[:, :2] - 0.02, axis=1) < 0.0112))


def press(cloud, x, y, radius=0.007):
    """A press of 1 N downwards on the upper face."""
    at = (cloud.points[:, 2] == SIZE[2]) & (np.linalg.norm(cloud.points[:, :2] - [x, y], axis=1) < radius)
    nodes = np.flatnonzero(at)
    return Press(nodes, np.tile([0.0, 0.0, -1.0 / len(nodes)], (len(nodes), 1)))


def compliance(body, pressed):
    load = np.zeros((len(body.cloud), 3))
    load[pressed.nodes] = pressed.forces
    free = np.flatnonzero(np.repeat(~body.fixed_mask, 3))
    stiffness = rest_stiffness(body)[free][:, free].toarray()
    return float(load.ravel()[free] @ np.linalg.solve(stiffness, load.ravel()[free]))


def test_a_moved_border_is_a_body_with_other_supports(cloud):
    body, pressed = pt.Solid(cloud, TISSUE, "disc"), press(cloud, 0.02, 0.025)
    changes = support_sensitivity(body, cloud.points, [pressed])
    assert changes["springs"] is None
    assert changes["border"]["distance"] == pytest.approx(0.005, rel=0.3)
    pairs = cloud.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    within = np.isin(pairs, cloud.group("disc"))
    ring = pairs[within[:, 0] & ~within[:, 1]]
    for way, nodes in (("outward", np.union1d(cloud.group("disc"), ring[:, 1])),
                       ("inward", np.setdiff1d(cloud.group("disc"), ring[:, 0]))):  # fmt: skip
        other = pt.Solid(replace(cloud, groups={"disc": nodes}), TISSUE, "disc")
        expected = compliance(body, pressed) / compliance(other, pressed) - 1
        assert changes["border"][way]["largest"] == pytest.approx(expected, rel=1e-6)
        assert changes["border"][way]["median"] == changes["border"][way]["largest"]
    assert changes["border"]["outward"]["largest"] > 0.02  # more held nodes, a larger force
    assert changes["border"]["inward"]["largest"] < -0.02


def test_the_force_is_proportional_to_springs_that_are_much_softer_than_the_body(cloud):
    body, presses = pt.Solid(cloud, TISSUE), [press(cloud, 0.02, 0.02)]
    changes = support_sensitivity(body, cloud.points, presses, [pt.Foundation("z-", 10.0)])
    assert changes["border"] is None
    assert changes["springs"]["halved"]["largest"] == pytest.approx(-0.5, abs=2e-3)
    assert changes["springs"]["doubled"]["largest"] == pytest.approx(1.0, abs=5e-3)
    np.testing.assert_allclose(changes["springs"]["doubled"]["place"], [0.02, 0.02, SIZE[2]], atol=1e-9)


def test_median_and_largest_change_are_those_of_the_presses(cloud):
    body = pt.Solid(cloud, TISSUE, "x-")
    presses = [press(cloud, x, 0.02) for x in (0.012, 0.025, 0.035)]
    found = support_sensitivity(body, cloud.points, presses)
    each = [support_sensitivity(body, cloud.points, [one])["border"]["outward"] for one in presses]
    changes = [one["largest"] for one in each]
    assert found["presses"] == 3
    assert found["border"]["outward"]["largest"] == pytest.approx(max(changes))
    assert found["border"]["outward"]["median"] == pytest.approx(np.median(changes))
    assert found["border"]["outward"]["place"] == each[int(np.argmax(changes))]["place"]
    on_border = press(cloud, 0.003, 0.02)  # on nodes that would be held
    assert support_sensitivity(body, cloud.points, [on_border]) is None
    assert support_sensitivity(body, cloud.points, [*presses, on_border])["presses"] == 3


def test_a_border_that_holds_the_body_alone_cannot_move_inward(cloud):
    ring = cloud.within("pin", (0.02, 0.02, 0.0), 0.0055)
    changes = support_sensitivity(pt.Solid(ring, TISSUE, "pin"), ring.points, [press(ring, 0.02, 0.02)])
    assert changes["border"]["inward"] is None  # one node is left, about which the body turns
    assert changes["border"]["outward"]["largest"] > 0
    free = pt.Solid(cloud, TISSUE)
    assert support_sensitivity(free, cloud.points, [press(cloud, 0.02, 0.02)]) is None


def test_a_coarser_body_has_similar_changes(cloud):
    fine = pt.Solid(cloud.with_group("half", cloud.points[:, 0] < 0.011), TISSUE, "half")
    presses = [press(cloud, x, 0.02, 0.009) for x in (0.027, 0.033)]
    ours, own = (
        support_sensitivity(body, cloud.points, presses)["border"] for body in (coarse_body(fine, 0.0065), fine)
    )
    for way in ("outward", "inward"):
        per_distance = [each[way]["median"] / each["distance"] for each in (ours, own)]
        assert per_distance[0] == pytest.approx(per_distance[1], rel=0.4)


def test_presses_are_the_strongest_of_runs_at_places_far_from_each_other():
    class Run:
        points = np.arange(12.0).reshape(4, 3)

        def __init__(self, *rows):
            self.contact_forces = np.array(rows, dtype=float).reshape(-1, 5)

    runs = [
        Run([1, 0, 0, 0, 1], [2, 1, 0, 0, 2], [2, 0, 0, 0, 2], [3, 0, 0, 0, 3]),
        Run([5, 1, 0, 0, 1]), Run(), Run([1, 2, 0, 0, 0]), Run([1, 3, 0, 0, 1]),
    ]  # fmt: skip
    first, second = select_presses(runs, 2)
    np.testing.assert_array_equal(first.nodes, [1, 0])  # of frame 2, with 4 N
    np.testing.assert_array_equal(first.forces, [[0, 0, 2], [0, 0, 2]])
    np.testing.assert_array_equal(second.nodes, [3])
    assert len(select_presses(runs, 5)) == 3
    assert select_presses(runs[2:4]) == []
