"""How the force on a tool rises with its displacement: compared with the force of slow motion and with dense equations.

Springs under a pressed block stand here as well, as its force and stiffness know them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.run.period_report import TRUST
from palpate.reduction.contact.compliance import pair

pytestmark = pytest.mark.slow

SIZE, BALL, DEPTH = (0.06, 0.06, 0.03), 0.015, 0.004
AT = (0.024, 0.038, SIZE[2])
DEEP = 0.0042  # where no patch comes to the tool or leaves it within 0.05 mm: there the stiffness jumps
HOME = (0.024, 0.038, SIZE[2] + BALL + 0.001)
SPRINGS = pt.Foundation("x-", 1e6, 100.0)
HANDS = pytest.mark.parametrize(("friction", "foundations"), [(0.0, ()), (0.3, ()), (0.0, (SPRINGS,))])


def press(x, y):
    def motion(time):
        share = np.sin(np.pi * min(time / 0.16, 1.0)) ** 2
        return x, y, SIZE[2] + BALL + 0.001 - share * (DEPTH + 0.001)

    return pt.tools.Contact(pt.tools.Sphere(BALL), motion)


@pytest.fixture(scope="module")
def pressed():
    """A block that is clamped below, and a model trained on presses of a ball."""
    cloud = pt.box(SIZE, spacing=0.006)
    body = pt.Solid(
        cloud,
        pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000, poisson=0.4),
        "z-",
        form="energy",
        stiffness_damping=1e-4,
    )
    runs = [pt.rollout(body, [press(*at)], duration=0.2, every=0.005) for at in ((0.021, 0.027), (0.030, 0.040))]
    return body, pt.hyper_reduce(body, runs, modes=0, enrichment=pt.vibration_modes(body, 24)[0])


def slow(model, **parts):
    """A model so viscous that it soon comes to rest."""
    return pt.ReducedModel(replace(model.data, stiffness_damping=3e-3, **parts))


class Hand:
    """A slow hand with a tool on a body in real time; other tools stay at a displacement."""

    def __init__(self, model, contact, other=None, **options):
        self.ready = pt.realtime_model(model, contact=contact, **options)
        tools = len(self.ready.tool) if self.ready.tool.ndim == 3 else 1
        self.q, self.v, self.report = self.ready.rest.copy(), np.zeros_like(self.ready.rest), np.zeros(8 + 12 * tools)
        self.others = np.zeros((tools - 1, 12))
        self.others[:, :3] = np.zeros(3) if other is None else other

    def goes(self, place, periods=400):
        """Hold the tool at a displacement; return the force on the body in the end."""
        target = np.concatenate([place, np.zeros(9), self.others.ravel()])
        for _ in range(periods):
            self.ready.advance(self.ready.data, self.q, self.v, target, 1e-3, self.report)
        assert self.report[0] == 0.0
        return self.report[8:11].copy()

    def presses(self, place):
        for share in np.linspace(0.0, 1.0, 60):
            self.goes(share * np.asarray(place), 1)
        return self.goes(place)

    def pushed(self):
        """Return the patches or nodes that the tool pushes."""
        contact = self.ready.data.contact_work
        return {
            int(i) for i, force in zip(contact.point, contact.push[: contact.numbers[0]], strict=False) if force.any()
        }

    def feels(self, place, by):
        """Return the derivative of the force by displacements to either side, between which it pushes the same."""
        columns, pushed = [], self.pushed()
        for way in by * np.eye(3):
            sides = []
            for side in (place + way, place - way):
                sides.append(self.goes(side))
                assert self.pushed() == pushed
                self.goes(place)
            columns.append((sides[0] - sides[1]) / (2 * by))
        return np.column_stack(columns)

    def told(self):
        """Return the contact stiffness, and in how many calls it was found."""
        out, numbers, calls = np.zeros((len(self.report) - 8, 12)), self.ready.data.system.numbers, 0
        numbers[:] = 0
        while calls == 0 or numbers[2] < numbers[1]:
            assert not out.any()
            self.ready.stiffness(self.ready.data, self.q, out)
            calls += 1
        assert not out[3:12].any()
        assert not out[:, 3:].any()
        return out[:3, :3], calls


@HANDS
def test_the_contact_stiffness_is_the_derivative_of_the_force_in_slow_motion(pressed, friction, foundations):
    hand = Hand(
        slow(pressed[1]), pt.tools.Contact(pt.tools.Sphere(BALL), HOME, friction=friction), foundations=foundations
    )
    deep = np.array((0.0, 0.0, -DEEP))
    hand.presses(deep)
    found, _ = hand.told()
    felt = hand.feels(deep, 5e-5)
    within = 0.05 if friction else 0.01  # some patches begin to slide
    np.testing.assert_allclose(found, felt, atol=within * felt[2, 2])
    hand.goes(np.zeros(3))
    out = found.copy()
    hand.ready.stiffness(hand.ready.data, hand.q, out)
    assert not out.any()  # nothing is touched


@pytest.mark.parametrize("bonded", [False, True])
def test_the_contact_stiffness_next_to_another_tool_is_the_derivative_of_the_force(pressed, bonded):
    """The other tool rests; without it the stiffness is another one."""
    body = slow(pressed[1])
    first = pt.tools.Contact(pt.tools.Sphere(BALL), HOME, name="first")
    near = (HOME[0] + 0.022, HOME[1] - 0.022, HOME[2])
    if bonded:
        second = pt.tools.Grasp((near[0], near[1], SIZE[2]), 0.008, (near[0], near[1], SIZE[2]), name="second")
    else:
        second = pt.tools.Contact(pt.tools.Sphere(BALL), near, name="second")
    hand = Hand(body, [first, second], other=(0.0, 0.0, 0.002 if bonded else -0.004))
    deep = np.array((0.0, 0.0, -0.0044 if bonded else -DEEP))  # where the same patches are pushed around it
    hand.presses(deep)
    found, _ = hand.told()
    felt = hand.feels(deep, 2e-5)
    np.testing.assert_allclose(found, felt, atol=0.01 * felt[2, 2])
    if bonded:  # too far away to change much
        return
    alone = Hand(body, first)
    alone.presses(deep)
    assert np.abs(alone.told()[0] - found).max() > 0.005 * felt[2, 2]


@HANDS
def test_the_stiffness_integrates_to_the_force_while_patches_come_into_contact(pressed, friction, foundations):
    hand = Hand(
        slow(pressed[1]), pt.tools.Contact(pt.tools.Sphere(BALL), HOME, friction=friction), foundations=foundations
    )
    depths, forces, told, pushed = np.linspace(0.0036, 0.0046, 21), [], [], []
    hand.presses((0.0, 0.0, -depths[0]))
    for depth in depths:
        forces.append(hand.goes((0.0, 0.0, -depth))[2])
        told.append(hand.told()[0][2, 2])
        pushed.append(len(hand.pushed()))
    assert pushed[-1] > pushed[0]
    rise = np.trapezoid(told, -depths)
    assert rise == pytest.approx(forces[-1] - forces[0], rel=0.05 if friction else 0.02)  # some patches slide


@pytest.mark.parametrize("at", [(0.024, 0.036), (0.026, 0.039), (0.027, 0.039)])  # a node, and between nodes
def test_a_small_ball_is_held_where_it_would_pass_between_the_nodes(pressed, at):
    radius = 0.0061
    hand = Hand(slow(pressed[1]), pt.tools.Contact(pt.tools.Sphere(radius), (*at, SIZE[2] + radius + 0.001)))
    hand.presses((0.0, 0.0, -0.001 - 0.3 * radius))
    deep = 0.03
    for share in np.linspace(0.3 * radius / deep, 1.0, 100):
        target = np.concatenate([(0.0, 0.0, -share * deep), np.zeros(9)])
        for _ in range(5):
            hand.ready.advance(hand.ready.data, hand.q, hand.v, target, 1e-3, hand.report)
    assert hand.report[TRUST] > 1.0
    assert hand.report[8:11][2] < -0.02  # the body still pushes the ball out
    assert -target[2] < 2.2 * radius  # and the ball stays there
    hand.goes((0.0, 0.0, 0.01))
    assert hand.report[8:11].tolist() == [0.0, 0.0, 0.0]


def test_a_run_ends_where_a_small_ball_passes_between_the_nodes(pressed):
    radius = 0.0061
    ball = pt.tools.Contact(
        pt.tools.Sphere(radius), lambda t: (0.026, 0.039, SIZE[2] + radius + 0.0001 - 0.02 * t), name="small ball"
    )
    with pytest.raises(pt.DivergenceError, match="'small ball' passed between the nodes"):
        pt.rollout(slow(pressed[1]), [ball], duration=1.0, every=0.02, progress=False)


def test_the_stiffness_of_forceps_is_the_derivative_of_their_force(pressed):
    hand = Hand(slow(pressed[1]), pt.tools.Grasp(AT, 0.010, AT))
    up = np.array((0.0, 0.001, 0.003))
    hand.presses(up)
    found, _ = hand.told()
    felt = hand.feels(up, 2e-4)
    np.testing.assert_allclose(found, felt, atol=0.01 * np.abs(felt).max())


def dense(hand):
    """Return the stiffness where all patches stick, by inverses of whole matrices."""
    data = hand.ready.data
    contact, stiffening = data.contact_work, data.contact_surface.compliance.stiffening
    on = [e for e in range(contact.numbers[0]) if contact.push[e].any()]
    pushes, block = contact.push[on], np.zeros((3, 3))
    matrix = np.zeros((len(on), 3, len(on), 3))
    for i, e in enumerate(on):
        for j, f in enumerate(on):
            pair(data.contact_surface.compliance, contact.point[e], contact.point[f], block)
            matrix[i, :, j] = contact.active.factor[0] * block
    columns = data.contact_surface.columns[contact.node[on]].reshape(-1, data.modes).astype(float)
    matrix = (
        matrix.reshape(3 * len(on), -1) - 1e-6 * columns @ data.body.constants.constrained_inverse_mass @ columns.T
    )  # steps of 1 ms
    matrix += columns @ np.linalg.solve(0.5 * (data.tangent.matrix + data.tangent.matrix.T), columns.T)
    each, whole = np.tile(np.eye(3), (len(on), 1)), pushes.sum(axis=0)
    size = np.linalg.norm(whole)
    displacement = (contact.now[on] - contact.modal[on]).ravel()
    matrix += np.outer(-stiffening[0] / (stiffening[1] + size) * displacement, each @ whole / size)
    return each.T @ np.linalg.solve(matrix, each), 3 * len(on)


def test_the_stiffness_of_many_patches_equals_that_of_dense_equations_after_several_calls(pressed):
    softening = pressed[1].data.compliance._replace(stiffening=np.array([0.3, 5.0]))
    above = (0.03, 0.03, SIZE[2] + 0.001), (np.pi, 0.0, 0.0)  # facing down
    hand = Hand(slow(pressed[1], compliance=softening), pt.tools.Contact(pt.tools.Plane(), above, friction=2.0))
    hand.presses((0.0003, 0.0, -0.003))
    expected, rows = dense(hand)
    found, calls = hand.told()
    assert hand.ready.data.system.numbers[0] == rows > 90
    assert calls > 1
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


# springs


def test_a_pressed_reduced_block_on_springs_agrees_with_the_full_one(pressed):
    body, model = pressed
    loads = [press(0.024, 0.038), SPRINGS]
    full, own = (pt.rollout(m, loads, duration=0.2, every=0.005, progress=False) for m in (body, model))
    mine, theirs = own.reactions["tool"][:, 2], full.reactions["tool"][:, 2]
    assert np.abs(mine - theirs).max() < 0.15 * np.abs(theirs).max()
    missed = np.linalg.norm(own.displacements - full.displacements, axis=2)
    assert np.quantile(missed[:, body.cloud.group("x-")], 0.95) < 0.05 * DEPTH
    assert np.abs(own.balance).max() < 0.05 * np.abs(own.external).max()


def test_the_engine_has_the_force_of_a_run_on_springs(pressed):
    _, model = pressed
    hand = Hand(model, pt.tools.Contact(pt.tools.Sphere(BALL), HOME), foundations=[SPRINGS])
    down = lambda time: -(DEPTH + 0.001) * min(time / 0.1, 1.0)  # noqa: E731
    ball = pt.tools.Contact(pt.tools.Sphere(BALL), lambda time: (*HOME[:2], HOME[2] + down(time)))
    run = pt.rollout(model, [ball, SPRINGS], duration=0.2, every=0.01, progress=False)
    felt = [hand.goes((0.0, 0.0, down(1e-3 * (k + 1))), 1) for k in range(200)]
    means = np.array(felt).reshape(20, 10, 3).mean(axis=1)
    np.testing.assert_allclose(means, run.reactions["tool"][1:], atol=0.03 * np.abs(run.reactions["tool"]).max())
