"""Reduced models that have learnt from forceps: led through their runs, and pulled elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.contact.compliance import contact_displacements, secant_factor
from palpate.reduction.training.calibrate_contact import _correction, calibrate_contact
from palpate.reduction.training.fit_compliance import _follow_run

pytestmark = pytest.mark.slow

SIZE, BALL, PRESS_SECONDS = (0.06, 0.06, 0.03), 0.015, 0.16


def share(time):
    """Of a way: out and back again."""
    return np.sin(np.pi * min(time / PRESS_SECONDS, 1.0)) ** 2


def press(x, y, depth=0.004):
    motion = lambda time: (x, y, SIZE[2] + BALL + 0.001 - share(time) * (depth + 0.001))  # noqa: E731
    return [pt.tools.Contact(pt.tools.Sphere(BALL), motion)]


def grasp(x, y, pull, turn=(0.0, 0.0, 0.0), radius=0.010):
    place = np.array([x, y, SIZE[2]])
    motion = lambda time: (place + share(time) * np.array(pull), share(time) * np.array(turn))  # noqa: E731
    return [pt.tools.Grasp(place, radius, motion, until=0.19)]


LEARNT = [press(0.021, 0.027), grasp(0.036, 0.024, (0.0, 0.0, 0.003), (0.0, 0.0, 0.3))]
OTHERS = {
    "press": press(0.024, 0.038),
    "grasp": grasp(0.040, 0.030, (-0.001, 0.002, 0.003), (0.1, 0.1, 0.0), radius=0.008),
}


def run(model, loads):
    return pt.rollout(model, loads, duration=0.2, every=0.005)


@pytest.fixture(scope="module")
def body():
    cloud = pt.box(SIZE, spacing=0.006)
    return pt.Solid(
        cloud,
        pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000, poisson=0.4),
        "z-",
        form="energy",
        stiffness_damping=1e-4,
    )


@pytest.fixture(scope="module")
def runs(body):
    return [run(body, loads) for loads in LEARNT]


@pytest.fixture(scope="module")
def smooth(body):
    return pt.vibration_modes(body, 24)[0]


@pytest.fixture(scope="module")
def model(body, runs, smooth):
    return pt.hyper_reduce(body, runs, modes=0, enrichment=smooth)


def missed(own, full):
    """Difference of the forces over the full one, where that is at least a tenth of its largest."""
    (name,) = full.reactions.keys() - {"z-"}
    size = np.linalg.norm(full.reactions[name], axis=1)
    on = size > 0.1 * size.max()
    return np.linalg.norm(own.reactions[name] - full.reactions[name], axis=1)[on] / size[on]


@pytest.mark.parametrize(("kind", "most"), [("grasp", 0.04), ("press", 0.15)])
def test_a_model_trained_on_one_press_and_one_grasp_predicts_others(body, model, kind, most):
    full, own = run(body, OTHERS[kind]), run(model, OTHERS[kind])
    assert np.quantile(missed(own, full), 0.95) < most
    assert np.abs(own.balance).max() < 0.05 * own.external.max()


def test_nodal_forces_of_a_run_reproduce_a_grasp(runs, model):
    """Its modes are where those of the full run are; without these forces they would stay at rest."""
    full = runs[1]
    expected = model.body.project(full.displacements)
    led = _follow_run(model, full)
    size = np.linalg.norm(expected)
    assert np.linalg.norm(led - expected) < 0.1 * size
    bare = _follow_run(model, replace(full, contact_forces=np.zeros((0, 5)), bonded=np.zeros(0, dtype=bool)))
    assert np.linalg.norm(bare - expected) > 0.9 * size


def test_pulls_do_not_stiffen_the_surface_and_have_their_own_scale(body, runs, smooth, model):
    compliance = model.data.compliance
    assert 0.5 < compliance.bonded_scale < 2.0
    points, push = body.cloud.points, np.zeros((1, len(compliance.nodes), 3))
    push[0, len(compliance.nodes) // 2] = (0.0, 0.0, 1.0)
    one, ten = (contact_displacements(compliance, points, size * push, [True]) for size in (1.0, 10.0))
    np.testing.assert_allclose(ten[0], 10 * one[0])
    assert ten[1] == pytest.approx(100 * one[1])
    assert one[1] == pytest.approx(0.5 * np.sum(push[0] * one[0][compliance.nodes]))
    scaled = pt.hyper_reduce(body, runs, modes=0, enrichment=smooth, repeated=[(LEARNT[0], runs[0])])
    factor = scaled.report["force_factor"]
    assert abs(np.log(factor)) > 0.01
    # both are rounded, each in steps of its own scale
    again, step = contact_displacements(scaled.data.compliance, points, push, [True])[0], 2e-3 * np.abs(one[0]).max()
    np.testing.assert_allclose(again, one[0], rtol=1e-5, atol=step)


def test_calibration_matches_the_forces_of_forceps(runs, model):
    compliance = model.data.compliance
    off = pt.ReducedModel(
        replace(model.data, compliance=compliance._replace(bonded_scale=1.4 * compliance.bonded_scale))
    )
    made, told = calibrate_contact(off, [(LEARNT[1], runs[1])])
    before, *_, after = told["force_ratios"]
    assert before < 0.93
    assert abs(np.log(after)) < 0.02
    assert made.data.compliance.bonded_scale < 1.2 * compliance.bonded_scale
    assert told["force_factor"] == 1.0  # presses keep what they had
    np.testing.assert_array_equal(made.data.compliance.flexibility, compliance.flexibility)
    np.testing.assert_array_equal(made.data.compliance.stiffening, compliance.stiffening)


def test_an_outlier_run_changes_the_calibration_little(model):
    compliance = model.data.compliance._replace(stiffening=np.array([0.3, 1.0]))
    theirs = np.tile(np.linspace(0.1, 2.0, 40), 8)
    few = 1.03 * theirs
    few[:40] *= 0.7
    factor, stiffening = _correction(compliance, np.array([few, theirs]))
    change = factor * secant_factor(stiffening, theirs) / secant_factor(compliance.stiffening, theirs)
    np.testing.assert_allclose(change, 1.03**1.4, atol=0.015)  # by the mean it would be 0.98


def test_bonded_scale_and_bonded_nodes_are_stored(model, tmp_path):
    pt.save(model, tmp_path / "block.rom")
    loaded = pt.load(tmp_path / "block.rom")
    assert loaded.data.compliance.bonded_scale == model.data.compliance.bonded_scale
    loads = [*OTHERS["grasp"], replace(press(0.015, 0.03)[0], name="ball")]
    short = pt.rollout(loaded, loads, duration=0.05, every=0.01, file=tmp_path / "run.h5")
    held = OTHERS["grasp"][0].with_group(model.cloud).group("grasp")
    np.testing.assert_array_equal(np.unique(short.contact_forces[short.bonded, 1]), held)
    assert not short.bonded.all()
    np.testing.assert_array_equal(pt.Trajectory.load(tmp_path / "run.h5").bonded, short.bonded)
