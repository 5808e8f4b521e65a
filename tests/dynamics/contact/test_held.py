"""Tools on nodes that a support holds: the force of the tissue over the support, and who bears it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.reference import StoredRecord
from palpate.dynamics.run.period_report import FORCES, STATUS

pytestmark = pytest.mark.slow

SPACING, RADIUS, DEPTH, TIME = 0.005, 0.015, 2e-3, 0.1
MIDDLE = np.array([0.015, 0.015, 0.0075])
LAW = pt.materials.MooneyRivlin(C1=2e3, C2=0.0, density=1000.0, poisson=0.45)


@cache
def block(form: str = "energy") -> pt.Solid:
    """A block that is held at its lower face."""
    return pt.Solid(pt.box((0.03, 0.03, 0.015), SPACING), LAW, "z-", form=form, mass_damping=40.0)


def press(side: int, depth: float = DEPTH, slide: float = 0.0, friction: float = 0.0) -> pt.tools.Contact:
    """A ball that presses the upper (1) or lower (-1) face by a depth within `TIME`, and then slides along x [m/s]."""
    start = MIDDLE + side * np.array([0.0, 0.0, 0.0075 + RADIUS])

    def motion(t: float) -> np.ndarray:
        down = depth * min(t / TIME, 1.0)
        return start + np.array([slide * max(t - TIME, 0.0), 0.0, -side * down])

    return pt.tools.Contact(pt.tools.Sphere(RADIUS), motion, friction=friction)


def run(model, tool, duration: float = TIME, **options) -> pt.Trajectory:
    return pt.rollout(model, [tool], **({"duration": duration, "every": TIME / 20, "progress": False} | options))


@cache
def lower_press() -> pt.Trajectory:
    return run(block(), press(-1))


@cache
def reduced() -> pt.ReducedModel:
    full = block()
    return pt.hyper_reduce(full, run(full, press(1)), modes=0, enrichment=pt.vibration_modes(full, 8)[0])


def test_the_force_on_a_held_face_grows_with_the_depth_and_is_finite():
    force = lower_press().reactions["tool"][:, 2]
    assert np.diff(force[1:]).min() > 0
    assert 0 < force[-1] < 100


def test_tissue_over_a_support_is_at_least_as_stiff_as_free_tissue():
    free = -run(block(), press(1)).reactions["tool"][:, 2]
    assert np.all(lower_press().reactions["tool"][5:, 2] >= free[5:])


@pytest.mark.quick(form=["energy"])
@pytest.mark.parametrize("form", ["energy", pytest.param("strong", marks=pytest.mark.slow)])
def test_the_support_bears_the_force(form):
    found = lower_press() if form == "energy" else run(block(form), press(-1))
    tool, support = found.reactions["tool"], found.reactions["z-"]
    assert np.abs(found.displacements).max() == 0.0
    np.testing.assert_allclose(tool[1:-1] + tool[2:], -2 * support[1:-1], atol=0.06 * np.abs(tool).max())
    np.testing.assert_allclose(found.contact_forces[:, 2:].sum(axis=0), tool.sum(axis=0), rtol=1e-9, atol=1e-12)


def test_the_energy_is_in_the_tissue_over_the_support_and_comes_back():
    def motion(t: float) -> np.ndarray:
        return press(-1).motion(0.0) + np.array([0.0, 0.0, DEPTH * np.sin(np.pi * t / TIME) ** 2])

    found = run(block(), pt.tools.Contact(pt.tools.Sphere(RADIUS), motion))
    assert found.strain.max() > 0.99 * found.external.max() > 0
    assert np.abs(found.balance).max() < 0.02 * found.external.max()
    assert abs(found.external[-1]) < 0.02 * found.external.max()
    assert np.abs(found.dissipated).max() < 0.02 * found.external.max()


def test_friction_is_at_most_coulombs_and_reaches_it_in_a_fast_slide():
    tool = press(-1, slide=0.5, friction=0.3)
    found = run(block(), tool, duration=1.1 * TIME)
    force = found.reactions["tool"]
    along, normal = np.abs(force[:, 0]), force[:, 2]
    assert np.all(along <= 0.3 * normal * 1.1 + 1e-12)  # normals lean by up to 10 degrees after the slide
    assert along[-1] > 0.25 * normal[-1]
    assert force[-1, 0] > 0  # on the body, in the direction of the slide
    assert found.dissipated[-1] == pytest.approx(found.external[-1] - found.strain[-1], rel=0.02)


def test_the_moment_on_the_tool_is_that_of_its_forces():
    centre = press(-1).motion(TIME)
    found = lower_press()
    rows = found.contact_forces[found.contact_forces[:, 0] == 20]
    arms = block().cloud.points[rows[:, 1].astype(int)] - centre
    moment = np.cross(arms, rows[:, 2:]).sum(axis=0)
    size = np.linalg.norm(rows[:, 2:].sum(axis=0)) * RADIUS
    np.testing.assert_allclose(found.moments["tool"][20], moment, atol=0.02 * size)


@pytest.mark.quick
def test_a_tool_must_start_outside_held_nodes_too():
    with pytest.raises(pt.InputError, match="must start outside the body"):
        run(block(), pt.tools.Contact(pt.tools.Sphere(RADIUS), press(-1).motion(TIME)))


def test_a_reduced_model_has_the_same_force():
    found = run(reduced(), press(-1))
    np.testing.assert_allclose(found.reactions["tool"], lower_press().reactions["tool"], rtol=1e-2, atol=1e-3)
    np.testing.assert_allclose(found.strain, lower_press().strain, rtol=1e-2, atol=1e-9)
    tool, support = found.reactions["tool"], found.reactions["z-"]
    np.testing.assert_allclose(tool[1:-1] + tool[2:], -2 * support[1:-1], atol=0.06 * np.abs(tool).max())


@pytest.mark.parametrize("make", [block, reduced], ids=["full", "reduced"])
def test_the_engine_has_the_same_force(make):
    tool = press(-1)
    made = pt.realtime_model(make(), contact=pt.tools.Contact(tool.tool, tuple(tool.motion(0.0))))
    q, v, report, forces = made.rest.copy(), np.zeros(len(made.rest)), np.zeros(20), []
    data = StoredRecord(made.data)
    for k in range(100):
        pose = np.zeros(12)
        pose[:3] = tool.motion(1e-3 * (k + 1)) - tool.motion(0.0)
        made.advance(data, q, v, pose, 1e-3, report)
        assert report[STATUS] == 0.0
        forces.append(report[FORCES + 2])
    wanted = lower_press().reactions["tool"][1:, 2]
    np.testing.assert_allclose(np.array(forces).reshape(20, 5).mean(axis=1), wanted, atol=0.03 * wanted.max())
