"""A reduced model of a cut body, against the full model of the same cut."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.contact.coarse_body import coarse_body

pytestmark = pytest.mark.slow

A, B, C, D = (0.0155, -0.01, 0.0075), (0.0155, 0.04, 0.0075), (0.0155, 0.04, 0.025), (0.0155, -0.01, 0.025)
TRIANGLES = [(A, B, C), (A, C, D)]  # half through a block, from above
RUN = {"duration": 0.2, "every": 0.01, "progress": False}
PULL = pt.SurfaceForce("x+", force=lambda t: (1.5 * min(t, 0.1), 0, 0))
BEND = pt.SurfaceForce("x+", force=lambda t: (0, 0, -0.25 * min(t, 0.1)))


def block(fixed="x-"):
    cloud = pt.box((0.03, 0.03, 0.015), spacing=0.003)
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    return pt.Solid(cloud, tissue, fixed=fixed, mass_damping=20)


@pytest.fixture(scope="module")
def opened():
    return pt.cut(block(), TRIANGLES)


@pytest.fixture(scope="module")
def runs(opened):
    return [pt.rollout(opened, [load], **RUN) for load in (PULL, BEND)]


@pytest.fixture(scope="module")
def model(opened, runs):
    return pt.hyper_reduce(opened, runs, modes=8)


def test_runs_agree_with_the_full_model_of_the_cut(opened, model):
    both = pt.SurfaceForce("x+", force=lambda t: (0.7 * min(t, 0.1), 0, -0.15 * min(t, 0.1)))
    exact = pt.rollout(opened, [both], **RUN)
    error = pt.relative_errors(exact, pt.rollout(model, [both], **RUN))
    assert error.displacement < 0.02
    assert error.reaction < 0.02


def test_the_model_opens_as_far_as_the_cut_and_not_as_the_uncut_body(model, runs):
    whole = pt.rollout(block(), [PULL], **RUN)
    wound = pt.rollout(model, [PULL], **RUN)
    largest = [abs(run.displacements[-1]).max() for run in (whole, runs[0], wound)]
    assert largest[1] > 1.3 * largest[0]
    assert largest[2] == pytest.approx(largest[1], rel=0.02)


def test_a_saved_model_steps_like_the_one_in_memory(model, tmp_path):
    pt.save(model, tmp_path / "cut.rom")
    loaded = pt.load(tmp_path / "cut.rom")
    short = {**RUN, "duration": 0.02}
    one, other = (pt.rollout(each, [PULL], **short).displacements for each in (model, loaded))
    np.testing.assert_array_equal(one, other)


def test_the_surface_of_a_cut_body_is_not_filled_again(opened):
    with pytest.raises(pt.InputError, match="the body is cut"):
        coarse_body(opened)


def test_the_engine_steps_a_cut_model_under_a_tool():
    opened = pt.cut(block("z-"), TRIANGLES)
    ball = pt.tools.Contact(pt.tools.Sphere(radius=0.008), lambda t: (0.009, 0.015, 0.0232 - 0.03 * min(t, 0.1)))
    run = pt.rollout(opened, [ball], **RUN)
    model = pt.hyper_reduce(opened, run, modes=12)
    exact = run.reactions["tool"][-1]
    pressed = pt.rollout(model, [ball], **RUN).reactions["tool"][-1]
    assert np.linalg.norm(pressed - exact) < 0.1 * np.linalg.norm(exact)
    ready = pt.realtime_model(model, contact=pt.tools.Contact(ball.tool, (0.009, 0.015, 0.0232)))
    with pt.Engine(ready) as engine:
        engine.set_pose((0.0, 0.0, -0.003))
        while not (reading := engine.read()).force.any():
            pass
    assert np.isfinite(reading.force).all()
