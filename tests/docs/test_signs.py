"""Forces have the signs of the table in docs/howto/engine.md: on the body in runs, on the tool in the engine."""

from __future__ import annotations

import time

import numpy as np
import pytest

import palpate as pt

RADIUS, TOP = 0.012, 0.02  # [m]
DEPTH = 0.003  # [m] of the press along -z, towards +x of the middle


@pytest.fixture(scope="module")
def block():
    cloud = pt.box((0.04, 0.04, TOP), spacing=0.005)
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0.0, density=1000, poisson=0.45)
    return pt.Solid(cloud, tissue, fixed="z-", mass_damping=50)


@pytest.fixture(scope="module")
def press(block):
    def centre(t):
        return 0.02, 0.02, TOP + RADIUS - DEPTH * min(1.0, t / 0.05)

    return pt.rollout(block, [pt.tools.Contact(pt.tools.Sphere(RADIUS), centre, name="ball")], duration=0.1, every=0.01)


def test_a_run_reports_the_force_of_a_tool_and_of_a_support_on_the_body(press):
    assert press.reactions["ball"][-1, 2] < -0.01
    assert press.reactions["z-"][-1, 2] > 0.01
    forces = press.contact_forces[press.contact_forces[:, 0] == len(press.times) - 1]
    np.testing.assert_allclose(forces[:, 2:].sum(axis=0), press.reactions["ball"][-1], atol=1e-9)


def test_the_moment_of_a_run_is_that_of_the_forces_on_the_body_about_the_origin_of_the_tool(block):
    plane = pt.tools.Contact(pt.tools.Plane(), lambda t: ((0.0, 0.02, TOP - 0.02 * t), (np.pi, 0, 0)), name="plane")
    run = pt.rollout(block, [plane], duration=0.05, every=0.01)
    arm = np.array([0.02, 0.0, 0.0])  # from the origin of the plane to the middle of the face
    expected = np.cross(arm, run.reactions["plane"][-1])
    assert expected[1] > 0
    np.testing.assert_allclose(run.moments["plane"][-1, 1], expected[1], rtol=0.05)


def test_an_equilibrium_has_the_force_of_supports_on_the_body_and_a_pressure_acts_against_the_normal(block):
    pressed = pt.equilibrium(block, [pt.Pressure("z+", 50.0)])
    assert pressed.displacements[block.cloud.group("z+"), 2].mean() < 0
    assert pressed.reactions["z-"][2] == pytest.approx(50.0 * 0.04 * 0.04, rel=1e-2)
    pulled = pt.equilibrium(block, [pt.SurfaceForce("z+", force=(0.0, 0.0, 0.05))])
    assert pulled.reactions["z-"][2] == pytest.approx(-0.05, rel=1e-4)
    hung = pt.equilibrium(block, [pt.Gravity((0.0, 0.0, -9.81))])
    assert hung.reactions["z-"][2] > 0


def test_the_engine_reports_the_force_of_the_body_on_the_tool_and_a_stiffness_that_pushes_back(block, press):
    ball = pt.tools.Contact(pt.tools.Sphere(RADIUS), (0.02, 0.02, TOP + RADIUS))
    with pt.Engine(pt.realtime_model(block, contact=ball), max_speed=0.03) as engine:
        engine.set_pose((0.0, 0.0, -DEPTH))
        reading = engine.read()
        for _ in range(3000):  # as often as a busy machine needs
            reading = engine.read()
            if reading.time > 0.25 and reading.stiffness[2, 2] != 0:
                break
            time.sleep(0.01)
    assert reading.force[2] == pytest.approx(-press.reactions["ball"][-1, 2], rel=0.1)
    assert reading.stiffness[2, 2] > 0  # of a slow press; a fast one adds inertia
