"""A cut in a reduced model, against the full model of the same cut."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt

A, B, C, D = (0.0155, -0.01, 0.0075), (0.0155, 0.04, 0.0075), (0.0155, 0.04, 0.025), (0.0155, -0.01, 0.025)
TRIANGLES = [(A, B, C), (A, C, D)]  # half through a block, from above
RUN = {"duration": 0.2, "every": 0.01, "progress": False}
PULL = pt.SurfaceForce("x+", force=lambda t: (1.5 * min(t, 0.1), 0, 0))
BEND = pt.SurfaceForce("x+", force=lambda t: (0, 0, -0.25 * min(t, 0.1)))


@pytest.fixture(scope="module")
def block():
    cloud = pt.box((0.03, 0.03, 0.015), spacing=0.003)
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    return pt.Solid(cloud, tissue, fixed="x-", mass_damping=20)


@pytest.fixture(scope="module")
def model(block):
    return pt.hyper_reduce(block, [pt.rollout(block, [load], **RUN) for load in (PULL, BEND)], modes=8)


@pytest.fixture(scope="module")
def opened(model, block):
    return pt.cut_reduced(model, block, TRIANGLES, columns=6)


@pytest.mark.filterwarnings("ignore::palpate.TrustWarning")
@pytest.mark.parametrize("load", [PULL, BEND])
def test_runs_agree_with_the_full_model_of_the_cut(block, model, opened, load):
    exact = pt.rollout(pt.cut(block, TRIANGLES), [load], **RUN)
    error = pt.relative_errors(exact, pt.rollout(opened, [load], **RUN))
    uncut = pt.relative_errors(exact, pt.rollout(model, [load], **RUN))
    assert error.displacement < 0.05
    assert error.reaction < 0.05
    assert uncut.displacement > 0.3


def test_weights_are_positive_and_changed_nodes_have_their_volumes(block, opened):
    rule, changed = opened.data.cubature, pt.cut(block, TRIANGLES).cut_state.touched
    assert np.all(rule.weights > 0)
    assert np.all(np.isin(np.flatnonzero(changed), rule.nodes))
    here = changed[rule.nodes]
    np.testing.assert_allclose(rule.weights[here], block.volumes[rule.nodes[here]])


def test_the_uncut_model_stays(model, opened):
    assert model.count == 8
    assert opened.count > model.count
    assert opened.data.cloud is model.data.cloud
    assert "held_out" not in opened.report


def test_a_cut_outside_the_body_returns_the_model(model, block):
    with pytest.warns(UserWarning, match="the cut parts nothing"):
        assert pt.cut_reduced(model, block, np.array(TRIANGLES) + 1.0) is model


def test_a_saved_model_steps_like_the_one_in_memory(opened, tmp_path):
    pt.save(opened, tmp_path / "cut.rom")
    loaded = pt.load(tmp_path / "cut.rom")
    short = {**RUN, "duration": 0.02}
    one, other = (pt.rollout(each, [PULL], **short).displacements for each in (opened, loaded))
    np.testing.assert_array_equal(one, other)


def test_the_trust_number_rises_with_the_load(opened):
    short = {**RUN, "duration": 0.1}
    small, large = (pt.SurfaceForce("x+", force=lambda t, f=factor: (0, 0, -f * min(t, 0.1))) for factor in (0.05, 1.0))
    number = pt.rollout(opened, [small], **short).trust.max()
    with pytest.warns(pt.TrustWarning):
        beyond = pt.rollout(opened, [large], **short).trust.max()
    assert number < 1 < beyond


def test_other_bodies_and_cut_bodies_are_refused(model, block):
    with pytest.raises(pt.InputError, match="model must be a ReducedModel"):
        pt.cut_reduced(block, block, TRIANGLES)
    with pytest.raises(pt.InputError, match="body must be uncut"):
        pt.cut_reduced(model, pt.cut(block, TRIANGLES), TRIANGLES)
    with pytest.raises(pt.InputError, match="columns"):
        pt.cut_reduced(model, block, TRIANGLES, columns=0)
    other = pt.Solid(pt.box((0.03, 0.03, 0.015), spacing=0.005), block.material, fixed="x-")
    with pytest.raises(pt.InputError, match="other points"):
        pt.cut_reduced(model, other, TRIANGLES)


def test_a_piece_that_is_cut_off_is_refused(model, block):
    through = np.array(TRIANGLES)
    through[through[..., 2] < 0.01, 2] = -0.01
    with pytest.raises(pt.CloudError, match="one supported piece"):
        pt.cut_reduced(model, block, through)


def test_the_engine_steps_a_cut_model_under_a_tool(block):
    cloud = block.cloud
    standing = pt.Solid(cloud, block.material, fixed="z-", mass_damping=20)
    ball = pt.tools.Contact(pt.tools.Sphere(radius=0.008), lambda t: (0.009, 0.015, 0.0232 - 0.03 * min(t, 0.1)))
    run = pt.rollout(standing, [ball], **RUN)
    model = pt.hyper_reduce(standing, run, modes=12)
    opened = pt.cut_reduced(model, standing, TRIANGLES, columns=6)
    exact = pt.rollout(pt.cut(standing, TRIANGLES), [ball], **RUN).reactions["tool"][-1]
    pressed = pt.rollout(opened, [ball], **RUN).reactions["tool"][-1]
    assert np.linalg.norm(pressed - exact) < 0.1 * np.linalg.norm(exact)
    ready = pt.realtime_model(opened, contact=pt.tools.Contact(ball.tool, (0.009, 0.015, 0.0232)))
    with pt.Engine(ready) as engine:
        engine.set_pose((0.0, 0.0, -0.003))
        while not (reading := engine.read()).force.any():
            pass
    assert np.isfinite(reading.force).all()
