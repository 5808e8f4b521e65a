"""The contact stiffness of a full body in the engine: its limits in storms of poses, its slope, and what it forgets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.jit import kernel_njit
from palpate.compiled.reference import StoredRecord
from palpate.dynamics.contact.stiffness import limit_stiffness

pytestmark = pytest.mark.slow

SIZE, SPACING, BALL = (0.03, 0.03, 0.02), 0.005, 0.012  # [m]
HOME = np.array([0.015, 0.015, SIZE[2] + BALL + 0.0005])
LAW = pt.materials.MooneyRivlin(C1=1e3, C2=0.0, density=1000.0, poisson=0.45)
PLANE_MODULUS = 2.0 * LAW.shear_modulus / (1.0 - LAW.poisson)  # E / (1 - nu^2)
EVERY = 50  # periods between two values


@pytest.fixture(scope="module")
def block() -> pt.Solid:
    return pt.Solid(pt.box(SIZE, SPACING), LAW, "z-")


@pytest.fixture(scope="module")
def damped() -> pt.Solid:
    return pt.Solid(pt.box(SIZE, SPACING), LAW, "z-", mass_damping=60.0)


class Pressed:
    """A body under balls, in the periods of an engine."""

    def __init__(self, body, *places):
        balls = [
            pt.tools.Contact(pt.tools.Sphere(BALL), tuple(place), friction=0.3, name=f"ball {k}")
            for k, place in enumerate(places or [HOME])
        ]
        self.model: Any = pt.realtime_model(body, contact=balls)
        self.q, self.v = np.zeros((2, len(self.model.rest)))
        self.target, self.report = np.zeros(12 * len(balls)), np.zeros(8 + 12 * len(balls))
        self.data, self.out = StoredRecord(self.model.data), np.zeros((12 * len(balls), 12))

    def to(self, *displacements, period=1e-3):
        for t, displacement in enumerate(displacements):
            self.target[12 * t : 12 * t + 3] = displacement
        self.model.advance(self.data, self.q, self.v, self.target, period, self.report)
        return self.report[8:].reshape(-1, 12)[:, :3].copy()

    def stiffness(self):
        self.model.stiffness(self.model.data, self.q, self.out)
        return self.out.reshape(-1, 12, 12)[:, :3, :3].copy()

    def press(self, depth, periods=300):
        for k in range(periods):
            self.to((0.0, 0.0, -depth * (k + 1) / periods))
            if k % EVERY == 0:
                self.stiffness()


def storm(kind):
    """Yield the displacements of the ball, and the periods [s], of 800 periods."""
    random, at = np.random.default_rng(7), np.array([0.0, 0.0, -0.003])
    for k in range(800):
        period = 1e-3
        if kind == "jitter":
            at = np.array([0.0, 0.0, -0.003]) + 1e-4 * random.standard_normal(3)
        elif kind == "tiny jitter":
            at = np.array([0.0, 0.0, -0.003]) + 1e-6 * random.standard_normal(3)
        elif kind == "walk":
            at = np.clip(at + 2e-4 * random.standard_normal(3), (-0.008, -0.008, -0.005), (0.008, 0.008, 0.001))
        elif kind == "teleports" and k % 37 == 0:
            at = np.array([*random.uniform(-0.01, 0.01, 2), random.uniform(-0.005, 0.002)])
        elif kind == "repeated" and k % 10 == 0:
            at = np.array([0.0, 0.0, -0.003 - 0.001 * np.sin(k / 40)])
        elif kind == "bursts":
            period = random.choice([2e-4, 1e-3, 0.02])  # fewer than one step, some, and many
            at = np.array([0.0, 0.0, -0.003]) + 3e-4 * random.standard_normal(3)
        elif kind == "hits":
            at = np.array([0.0, 0.0, -0.004 * min(1.0, k % 200 / 20)])
        yield at, period


@pytest.mark.parametrize("kind", ["jitter", "tiny jitter", "walk", "teleports", "repeated", "bursts", "hits"])
@pytest.mark.parametrize("damping", ["block", "damped"])
def test_in_a_storm_of_poses_the_stiffness_has_no_negative_eigenvalue_and_is_at_most_that_of_the_tissue(
    kind, damping, request
):
    pressed, random = Pressed(request.getfixturevalue(damping)), np.random.default_rng(1)
    until = 0
    for k, (at, period) in enumerate(storm(kind)):
        force = pressed.to(at, period=period)
        if k < until:
            continue
        until = k + random.integers(5, 2 * EVERY)
        (stiffness,) = pressed.stiffness()
        np.testing.assert_array_equal(stiffness, stiffness.T)
        values = np.linalg.eigvalsh(stiffness)
        assert values[0] >= -1e-12 * max(1.0, values[-1])
        # a block of four radii of the contact: less than three times a half-space under the widest contact
        assert values[-1] <= 3.0 * 2.0 * PLANE_MODULUS * 0.01
        if not force.any():
            assert not stiffness.any()


def test_a_ball_at_rest_keeps_its_stiffness_while_it_trembles(damped):
    pressed, random = Pressed(damped), np.random.default_rng(0)
    pressed.press(0.003)
    (before,) = pressed.stiffness()
    assert before[2, 2] > 30.0
    for _ in range(10):
        for _ in range(EVERY):
            pressed.to(np.array([0.0, 0.0, -0.003]) + 1e-5 * random.standard_normal(3))
        np.testing.assert_allclose(pressed.stiffness()[0], before, atol=0.05 * before[2, 2])


@pytest.mark.parametrize("frequency", [1.0, 3.0])
def test_the_stiffness_of_a_moving_ball_is_the_slope_of_the_force_at_rest(damped, frequency):
    slow = Pressed(damped)
    depths = 0.0045 * np.arange(2000) / 2000
    forces = np.array([slow.to((0.0, 0.0, -depth))[0, 2] for depth in depths])
    fit = np.polynomial.Polynomial.fit(depths[200:], np.abs(forces[200:]), 4)
    pressed, ratios = Pressed(damped), []
    pressed.press(0.003)
    for k in range(1000):
        depth = 0.003 + 0.001 * np.sin(2 * np.pi * frequency * 1e-3 * k)
        pressed.to((0.0, 0.0, -depth))
        if k % EVERY == 0:
            ratios.append(pressed.stiffness()[0, 2, 2] / fit.deriv()(depth))
    assert np.median(ratios[2:]) == pytest.approx(1.0, abs=0.1)


def test_what_was_known_of_other_tissue_and_of_a_deep_press_is_forgotten(damped):
    pressed = Pressed(damped)
    pressed.press(0.005, 500)
    deep = pressed.stiffness()[0, 2, 2]
    assert deep > 50.0
    for k in range(500):  # up again, to a light touch
        pressed.to((0.0, 0.0, -0.005 + 0.0038 * (k + 1) / 500))
        if k % EVERY == 0:
            pressed.stiffness()
    assert pressed.stiffness()[0, 2, 2] < 0.5 * deep
    pressed.to((0.0, 0.0, 0.02))
    pressed.to((0.0, 0.0, 0.02))
    assert not pressed.stiffness().any()
    pressed.to((0.0, 0.0, -0.002))
    assert not pressed.stiffness().any()  # nothing is known of a new contact


def test_no_stiffness_follows_where_a_force_falls_as_the_tool_moves_on(damped):
    pressed = Pressed(damped)
    pressed.press(0.003)
    secant, force = pressed.model.data.tools.secant, pressed.model.data.tools.force
    assert pressed.stiffness()[0, 2, 2] > 30.0
    for _ in range(500):  # to rest
        pressed.to((0.0, 0.0, -0.003))
    pressed.stiffness()
    secant.positions[2] += 3e-4  # as if it had moved down by 0.3 mm, and the force had halved
    secant.forces[2] = 2.0 * force[2]
    assert abs(pressed.stiffness()[0, 2, 2]) < 1e-9


def test_the_stiffness_of_each_of_two_tools_is_limited_and_that_of_one_at_rest_is_kept(damped):
    pressed = Pressed(damped, HOME - np.array([0.009, 0.0, 0.0]), HOME + np.array([0.016, 0.0, 0.0]))
    for k in range(600):
        depth = 0.003 * min(1.0, k / 300) + 0.0008 * np.sin(0.01 * max(0, k - 300))
        other = 0.003 * min(1.0, k / 300) + 0.0008 * np.sin(0.014 * max(0, min(k, 450) - 300))
        pressed.to((0.0, 0.0, -depth), (0.0, 0.0, -other))
        if k % EVERY == 0:
            both = pressed.stiffness()
            for stiffness, bound in zip(both, pressed.model.data.tools.secant.bound, strict=True):
                values = np.linalg.eigvalsh(stiffness)
                assert -1e-12 * max(1.0, bound) <= values[0]
                assert values[-1] <= bound * (1 + 1e-9)
        if k == 450:
            resting = both[1]
    assert both[0, 2, 2] > 20.0
    assert resting[2, 2] > 10.0
    np.testing.assert_allclose(both[1], resting, atol=0.2 * resting[2, 2])


@kernel_njit()
def limit(matrix, largest):
    """Limit a matrix (3, 3)."""
    limit_stiffness((matrix[0], matrix[1], matrix[2]), largest)


def test_a_stiffness_is_limited_to_eigenvalues_from_zero_to_the_largest():
    random = np.random.default_rng(0)
    for _ in range(200):
        matrix = random.standard_normal((3, 3)) * 10.0 ** random.integers(-3, 4)
        values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
        found = matrix.copy()
        limit(found, 5.0)
        expected = (vectors * np.clip(values, 0.0, 5.0)) @ vectors.T
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(matrix).max())
        np.testing.assert_array_equal(found, found.T)
    limit(found, 0.0)
    assert not found.any()
    for valid in (np.zeros((3, 3)), 2.0 * np.eye(3), np.diag([1.0, 2.0, 5.0])):
        found = valid.copy()
        limit(found, 5.0)
        np.testing.assert_allclose(found, valid, atol=1e-14)
