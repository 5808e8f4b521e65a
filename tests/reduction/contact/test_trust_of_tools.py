"""The error indicator and the force's error bound of a body that a tool touches, trained on its top alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.hyper.error_indicator import approach_speeds

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


@pytest.mark.parametrize("measure", ["flexibility_scale", "residual_scale"])
def test_the_engine_has_the_same_error_indicator_as_a_run(model, measure):
    """All other measures are made small, so that one alone counts: the compliance, or the residual norm."""
    alone = only(model, measure)
    home = press(0.024, 0.022, 0.0)[0].motion(0.0)
    ready = pt.realtime_model(alone, contact=pt.tools.Contact(pt.tools.Sphere(BALL), home))
    q, v, report, trust = np.zeros(model.count), np.zeros(model.count), np.zeros(20), []
    for period in range(1, 121):
        depth = 0.006 * min(period / 100, 1.0)
        ready.advance(ready.data, q, v, np.r_[0.0, 0.0, -depth, np.zeros(9)], 1e-3, report)
        trust.append(report[1])
    assert report[0] == 0.0
    expected = pt.rollout(alone, press(0.024, 0.022, 0.005), duration=0.12, every=1e-3, progress=False).trust[1:]
    assert max(expected) > 0.5
    np.testing.assert_allclose(trust, expected, atol=0.03 * max(expected))


@pytest.mark.parametrize("step", [None, 2.5e-4])
def test_a_period_without_residual_fields_writes_nothing_for_them(body, step):
    """The loops over basis vectors run at least once: without a check they would write beyond the arrays."""
    held = rollout_along(body)
    trained = pt.hyper_reduce(body, held, modes=2, prescribed="z+")
    data, w, basis, sampled = trained.data, trained.data.residual_fields, trained.data.basis, trained.data.sampled
    without = replace(
        data,
        basis=replace(basis, vectors=basis.vectors[:-w], residual_fields=0),
        sampled=replace(sampled, gradients=sampled.gradients[:, :-w], constant=sampled.constant[:-w, :-w]),
    )
    bare = pt.ReducedModel(without, step=step)
    ready = pt.realtime_model(bare)
    partial = np.full((1, ready.data.indicator.residual_fields.partial.shape[1]), 7.0)
    fields = ready.data.indicator.residual_fields._replace(partial=partial[:0])
    watched = ready.data._replace(indicator=ready.data.indicator._replace(residual_fields=fields))
    q, v, report = np.zeros(bare.count), np.zeros(bare.count), np.zeros(8 + data.lifting_count)
    for period in range(1, 6):
        ready.advance(watched, q, v, ready.tool @ np.r_[1e-4 * period, np.zeros(11)], 1e-3, report)
        assert report[0] == 0.0
    np.testing.assert_array_equal(partial, 7.0)
    assert report[1] > 0


def rollout_along(body) -> pt.Trajectory:
    """A run in which the top moves sideways."""
    aside = pt.PrescribedMotion("z+", lambda _, t: np.array([0.02 * t, 0.0, 0.0]))
    return pt.rollout(body, [aside], duration=0.05, every=0.005, progress=False)


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


def only(model, *names: str) -> pt.ReducedModel:
    """The model with all other measures made small."""
    every = {"distance_scale", "residual_scale", "flexibility_scale", "speed_scale", "nearness_scale"}
    large = dict.fromkeys(every.difference(names), 1e30)
    return pt.ReducedModel(model.data.with_scales(load_scale=1.0, **large))


def test_a_tool_next_to_a_support_is_not_trusted(model):
    """The lowest nodes of the side are next to the fixed ones, and training pressed the top."""
    near = only(model, "nearness_scale")
    low, high = (run(near, press(0.024, height, 0.003, axis=0)).trust.max() for height in (0.008, 0.03))
    assert low > 4 * high
    assert high < 1.5
    assert run(near, press(0.024, 0.024, 0.003)).trust.max() <= 1.1


def timed_press(factor: float, depth: float = 0.004) -> list[pt.tools.Contact]:
    slow = press(0.024, 0.022, depth)[0]
    return [pt.tools.Contact(slow.tool, lambda t: slow.motion(factor * t), friction=slow.friction)]


def test_a_tool_faster_than_in_training_is_not_trusted_from_touch_on(model):
    fast = only(model, "speed_scale")
    assert run(fast, timed_press(1.0)).trust.max() <= 1.1
    quick = pt.rollout(fast, timed_press(8.0), duration=0.02, every=1e-3)
    touched = np.flatnonzero(quick.reactions[timed_press(8.0)[0].name].any(axis=1))
    assert len(touched)
    assert np.all(np.maximum.accumulate(quick.trust)[touched] > 1)


def test_a_tool_that_moves_back_has_no_speed(model):
    forces = np.array([[[0.0, 0.0, -2.0]], [[0.0, 0.0, -2.0]], [[0.0, 0.0, 0.0]]])
    up = model.prepare([pt.tools.Contact(pt.tools.Sphere(BALL), lambda t: (0.024, 0.024, 0.05 + 0.3 * t))])
    down = model.prepare([pt.tools.Contact(pt.tools.Sphere(BALL), lambda t: (0.024, 0.024, 0.05 - 0.3 * t))])
    times = np.array([0.0, 0.01, 0.02])
    np.testing.assert_allclose(approach_speeds(down, times, forces)[:, 0], [0.3, 0.3, 0.0], rtol=1e-6)
    np.testing.assert_array_equal(approach_speeds(up, times, forces), 0.0)


def test_the_engine_has_the_same_speed_and_nearness_as_a_run(model):
    alone, depth = only(model, "speed_scale", "nearness_scale"), 0.004
    home = press(0.024, 0.022, 0.0)[0].motion(0.0)
    ready = pt.realtime_model(alone, contact=pt.tools.Contact(pt.tools.Sphere(BALL), home))
    q, v, report, trust = np.zeros(model.count), np.zeros(model.count), np.zeros(20), []
    for period in range(1, 51):
        move = -depth * np.sin(20.0 * period * 1e-3) ** 2
        ready.advance(ready.data, q, v, np.r_[0.0, 0.0, move, np.zeros(9)], 1e-3, report)
        trust.append(report[1])
    down = np.array([0.0, 0.0, -depth])
    contact = pt.tools.Contact(pt.tools.Sphere(BALL), lambda t: np.array(home) + down * np.sin(20.0 * t) ** 2)
    expected = pt.rollout(alone, [contact], duration=0.05, every=1e-3).trust[1:]
    assert max(trust) > 0
    np.testing.assert_allclose(trust[10:], expected[10:], rtol=0.1, atol=0.02 * max(trust))


def two_presses(one: tuple[float, ...], two: tuple[float, ...]) -> list[pt.tools.Contact]:
    """Two balls that press the top, the second of them after the first."""
    first, later = press(*one)[0], press(*two)[0]
    return [first, pt.tools.Contact(later.tool, lambda t: later.motion(max(t - 0.02, 0.0)), name="second")]


def drawn_pair(random) -> list[pt.tools.Contact]:
    low, high = random.uniform(0.010, 0.014, 2), random.uniform(0.034, 0.038, 2)
    return two_presses((*low, random.uniform(0.003, 0.005)), (*high, random.uniform(0.003, 0.005)))


def both_touch(run) -> np.ndarray:
    """Return the frames in which both balls have touched the body at once so far."""
    forces = [np.linalg.norm(run.reactions[name], axis=1) for name in ("ball", "second")]
    return np.maximum.accumulate((forces[0] > 0) & (forces[1] > 0))


def test_the_bound_is_unknown_from_the_second_tool_on_where_held_out_runs_had_one(model):
    own = run(model, drawn_pair(np.random.default_rng(5)))
    both = both_touch(own)
    assert model.data.scales.trained_tools == 1
    assert 0 < np.count_nonzero(both) < len(both) - 2
    assert np.all(own.trust[both & (own.reactions["second"].any(axis=1))] >= 2.0)
    assert np.isinf(own.force_bounds[both]).all()
    assert np.isinf(own.displacement_bounds[both]).all()
    assert np.isfinite(own.force_bounds[:3]).all()


def test_bounds_of_held_out_pairs_hold_for_the_force_on_each_tool(model, body):
    random = np.random.default_rng(6)
    draws = [(*random.uniform(0.012, 0.036, 2), random.uniform(0.003, 0.006)) for _ in range(10)]
    trained = [run(body, press(*draw)) for draw in draws[:4]]
    loads = [*(press(*draw) for draw in draws[4:]), *(drawn_pair(random) for _ in range(6))]
    held_out = [(each, run(body, each)) for each in loads]
    modes = pt.vibration_modes(body, 16)[0]
    both = pt.hyper_reduce(body, trained, modes=0, enrichment=modes, held_out=held_out)
    assert both.data.scales.trained_tools == 2
    assert both.expected_error(0.5, "force").level == pytest.approx(12 / 13)  # of six of either kind
    further = drawn_pair(random)
    own, full = run(both, further), run(body, further)
    assert both_touch(own)[-1]
    assert own.trust.max() < 2.0
    for name in ("ball", "second"):
        missed = np.linalg.norm(own.reactions[name] - full.reactions[name], axis=1)
        assert missed.max() > 0
        assert np.all(missed <= own.force_bounds)


def lift(time: float) -> np.ndarray:
    """A ball that presses the held lower face from below, by 1 mm in 0.05 s."""
    return np.array([0.024, 0.024, -BALL - 0.0005 + 0.0015 * min(time / 0.05, 1.0)])


def test_the_force_of_a_tool_on_held_nodes_alone_has_no_known_error(model, body):
    """The coordinates do not move, and all other measures are zero: they say nothing of this force."""
    loads = [pt.tools.Contact(pt.tools.Sphere(BALL), lift, name="ball")]
    own = pt.rollout(model, loads, duration=0.06, every=0.005, progress=False)
    pushed = np.linalg.norm(own.reactions["ball"], axis=1) > 0
    assert pushed[-6:].all()
    assert (own.trust[-6:] >= 2.0).all()
    assert np.isinf(own.force_bounds[-6:]).all()
    assert not own.trust[~pushed].any()
    assert np.isfinite(own.force_bounds[0])


def test_the_engine_says_that_the_error_on_held_nodes_is_not_known(model):
    ready = pt.realtime_model(model, contact=pt.tools.Contact(pt.tools.Sphere(BALL), tuple(lift(0.0))))
    q, v, report = np.zeros(model.count), np.zeros(model.count), np.zeros(20)
    for period in range(1, 61):
        ready.advance(ready.data, q, v, np.r_[lift(1e-3 * period) - lift(0.0), np.zeros(9)], 1e-3, report)
        assert report[0] == 0.0
        assert report[1] >= 2.0 or not report[8:11].any()
    assert report[8:11].any()
    assert ready.force_bound(report[1], 1.0) == np.inf


def test_held_nodes_in_held_out_runs_are_trusted(body):
    """The runs have such a tool, so that their errors count it."""
    loads = [pt.tools.Contact(pt.tools.Sphere(BALL), lift, name="ball")]
    top = [run(body, press(0.024, 0.024, depth)) for depth in (0.003, 0.005)]
    below = pt.rollout(body, loads, duration=0.06, every=0.005, progress=False)
    trained = pt.hyper_reduce(body, top, modes=6, held_out=[(loads, below), (press(0.024, 0.024, 0.004), run(
        body, press(0.024, 0.024, 0.004)))])  # fmt: skip
    assert pt.rollout(trained, loads, duration=0.06, every=0.005, progress=False).trust.max() <= 1.0
