"""The trust number and the force's error bound of a body that a tool touches, trained on its top alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt

pytestmark = pytest.mark.slow

SIZE, BALL = np.array([0.048, 0.048, 0.036]), 0.012


def press(x: float, y: float, depth: float, axis: int = 2) -> list[pt.tools.Contact]:
    """A ball that presses the top (axis 2) or the side at x+ (axis 0) to a depth [m] in 0.1 s."""
    start = np.array([x, y, SIZE[2]]) if axis == 2 else np.array([SIZE[0], x, y])

    def motion(time: float) -> tuple[float, ...]:
        return tuple(start + np.eye(3)[axis] * (BALL + 0.001 - (0.001 + depth) * min(time / 0.1, 1.0)))

    return [pt.tools.Contact(pt.tools.Sphere(BALL), motion, name="ball")]


def run(model, loads) -> pt.Trajectory:
    return pt.rollout(model, loads, duration=0.12, every=0.005, progress=False)


@pytest.fixture(scope="module")
def body() -> pt.Solid:
    tissue = pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000, poisson=0.4)
    return pt.Solid(pt.box(tuple(SIZE), 0.006), tissue, "z-", stiffness_damping=1e-4)


@pytest.fixture(scope="module")
def model(body) -> pt.ReducedModel:
    """Trained on the top, in smooth modes of those runs and vibrations."""
    random = np.random.default_rng(0)
    draws = [(*random.uniform(0.016, 0.032, 2), random.uniform(0.003, 0.006)) for _ in range(10)]
    runs = [run(body, press(*draw)) for draw in draws[:4]]
    held = [(press(*draw), run(body, press(*draw))) for draw in draws[4:]]
    return pt.hyper_reduce(body, runs, modes=0, enrichment=pt.vibration_modes(body, 16)[0], held_out=held)


def test_presses_like_those_of_the_training_keep_the_bound_of_the_force(model, body):
    loads = press(0.024, 0.022, 0.0045)
    own, full = run(model, loads), run(body, loads)
    apart = np.linalg.norm(own.reactions["ball"] - full.reactions["ball"], axis=1)
    assert own.trust.max() <= 1.1
    assert np.all(apart <= own.force_bounds)
    assert np.isfinite(own.force_bounds[:10]).all()
    assert own.force_bounds[12] < 0.6 * np.linalg.norm(own.reactions["ball"], axis=1).max()


def test_a_press_deeper_than_all_training_is_not_trusted(model):
    own = run(model, press(0.024, 0.024, 0.012))
    assert own.trust.max() > 1.5
    assert np.isinf(own.force_bounds[-1])


def test_a_tool_on_another_side_than_in_training_is_not_trusted(model):
    """The modes have not moved there; the surface compliance carries the press."""
    own = run(model, press(0.024, 0.03, 0.006, axis=0))
    assert own.trust.max() > 1
    assert np.isinf(own.force_bounds[-1])


def test_the_engine_has_the_same_trust_number_as_a_run(model):
    """All other measures are made small, so that the compliance alone counts."""
    others = ("distance_scale", "residual_scale", "speed_scale", "nearness_scale")
    alone = pt.ReducedModel(replace(model.data, **dict.fromkeys(others, 1e9)))
    home = press(0.024, 0.03, 0.0, axis=0)[0].motion(0.0)
    ready = pt.realtime_model(alone, contact=pt.tools.Contact(pt.tools.Sphere(BALL), home))
    q, v, report, largest = np.zeros(model.count), np.zeros(model.count), np.zeros(20), 0.0
    for period in range(1, 111):
        depth = 0.007 * min(period / 100, 1.0)
        ready.advance(ready.data, q, v, np.r_[-depth, np.zeros(11)], 1e-3, report)
        largest = max(largest, report[1])
    assert report[0] == 0.0
    assert largest > 0.5
    assert largest == pytest.approx(run(alone, press(0.024, 0.03, 0.006, axis=0)).trust.max(), rel=0.1)


def test_a_reading_has_the_bound_of_its_force(model):
    home = press(0.024, 0.024, 0.0)[0].motion(0.0)
    engine = pt.Engine(pt.realtime_model(model, contact=pt.tools.Contact(pt.tools.Sphere(BALL), home)))
    bound = engine.read().force_bound
    curve = model.report["held_out"]["expected_error"]["force"]
    assert bound == pytest.approx(model.expected_error(0.0, "force").bound * 0.5 * curve["typical_size"])
    bare = engine._force_bound
    size = 0.5 * (3.0 + curve["typical_size"])
    assert bare(0.5, 3.0) == pytest.approx(model.expected_error(0.5, "force").bound * size)
    assert bare(1.01 * curve["largest_trust"], 3.0) == np.inf
