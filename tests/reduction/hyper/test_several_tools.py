"""The error indicator and the error bounds of several tools at once, by numbers alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import betaincinv

from palpate.reduction.contact.gauss_seidel import contact_nearness
from palpate.reduction.contact.surface import HELD_NEARNESS
from palpate.reduction.hyper.error_indicator import (
    Measures,
    Scales,
    curve_bound,
    error_indicators,
    support_nearness,
    touch_speed,
)
from palpate.reduction.training.calibrate_indicator import Frames, calibrate_scales, error_curves

SCALES = Scales(1.0, 1.0, 1.0, 4.0, 0.1, 1.0, trained_tools=1)
CURVE = ("bound", "least_trust", "exponent", "largest_trust", "typical_size")


def measures(energies=(0.0,), speeds=(0.0,), tools=1) -> Measures:
    return Measures(0.0, 0.0, 0.0, np.array(energies), np.array(speeds), 0.0, tools)


def test_a_tool_that_presses_does_not_hide_the_speed_of_another():
    alone = error_indicators(measures((0.0,), (0.3,)), SCALES)
    assert alone == pytest.approx(3.0)
    for order in (slice(None), slice(None, None, -1)):
        both = measures((1.0, 0.0)[order], (0.0, 0.3)[order])
        assert error_indicators(both, SCALES) == pytest.approx(alone)
    assert touch_speed(0.3, 1.0, SCALES.flexibility_scale) < 0.2  # what it would be with the other's energy


def test_energies_of_tools_add():
    assert error_indicators(measures((4.0, 12.0), (0.0, 0.0)), SCALES) == pytest.approx(2.0)


def test_more_tools_than_in_held_out_runs_have_an_error_indicator_of_two_or_more():
    numbers = [float(error_indicators(measures(tools=count), SCALES)) for count in range(5)]
    assert numbers == [0.0, 0.0, 2.0, 3.0, 4.0]
    both = SCALES._replace(trained_tools=2)
    assert [float(error_indicators(measures(tools=count), both)) for count in range(4)] == [0.0, 0.0, 0.0, 2.0]


def test_the_nearness_to_supports_is_that_of_the_nearest_tool():
    """A large force far from supports does not hide a small one next to them, in a run and in the engine."""
    nearness, forces = np.array([0.1, 0.1, 2.0]), np.zeros((3, 3, 3))
    forces[0, :2, 2], forces[2, 1:, 0] = 50.0, 0.01
    expected = 0.5 * (0.1 + 2.0)
    assert support_nearness(nearness, forces) == pytest.approx(expected)
    tool, node = np.nonzero(forces.any(axis=2))
    pairs = SimpleNamespace(numbers=[len(tool)], tool=tool, node=node, push=forces[tool, node])
    engine = [contact_nearness.py_func(nearness, pairs, t) for t in range(3)]
    assert [touches for _, touches in engine] == [1, 0, 1]
    assert max(near for near, _ in engine) == pytest.approx(expected)
    for some in (forces[:0], forces[1:2], 0.0 * forces):
        assert support_nearness(nearness, some) == 0.0


def test_a_tool_on_held_nodes_is_nearer_to_supports_than_any_other():
    nearness, forces = np.array([0.1, 4.0]), np.zeros((2, 2, 3))
    forces[0, 1, 2] = 3.0
    held = np.array([0.0, 0.5])
    assert support_nearness(nearness, forces, held) == HELD_NEARNESS > 2 * nearness.max()
    pairs = SimpleNamespace(numbers=[1], tool=[0], node=[1], push=forces[0, 1:])
    assert contact_nearness.py_func(nearness, pairs, 1, held[1]) == (HELD_NEARNESS, 1)
    assert contact_nearness.py_func(nearness, pairs, 0, 3.0) == (0.5 * (4.0 + HELD_NEARNESS), 1)


def drawn_run(random, tools: int) -> Frames:
    """A run of 40 frames with an error indicator of some 1 at the end; runs of two tools err three times as much."""
    trust, zero = np.sort(random.uniform(0.2, 1.0, 40)), np.zeros(40)
    size = np.full(40, 2.0)
    error = (0.02 if tools == 1 else 0.06) * size * trust * np.exp(0.4 * random.standard_normal())
    of_tools = np.zeros((40, tools))
    counted = np.where(np.arange(40) < 10, 1, tools)
    weak = np.full(tools, 0.5)  # tools of half the error and size, but for the first
    weak[0] = 1.0
    return Frames(
        Measures(trust, zero, zero, of_tools, of_tools, zero, counted), np.linspace(0.0, 0.4, 40),
        {"displacement": error, "force": error[:, None] * weak}, {"displacement": size, "force": size[:, None] * weak},
    )  # fmt: skip


def keeps(run: Frames, scales: Scales, curves) -> tuple[bool, bool]:
    """Return whether a run keeps the bound of its force, and whether that is known in all frames."""
    worst = np.maximum.accumulate(error_indicators(run.measures, scales))
    curve = np.array([curves["force"][name] for name in CURVE])
    bounds = np.array(
        [
            [curve_bound(curve, trust, size) for size in sizes]
            for trust, sizes in zip(worst, run.sizes["force"], strict=True)
        ]
    )
    return bool(np.all(run.errors["force"] <= bounds)), bool(np.isfinite(bounds).all())


def test_bounds_hold_for_runs_of_either_number_of_tools():
    """Few runs with two tools among many with one, which a common factor would not cover."""
    random = np.random.default_rng(0)
    holds, common = [], []
    for _ in range(40):
        one, two = ([drawn_run(random, tools) for _ in range(count)] for tools, count in ((1, 60), (2, 19)))
        scales = calibrate_scales([run.measures for run in one + two], 0.95)
        assert scales.trained_tools == 2
        curves = error_curves(one + two, scales)
        assert curves["level"] == pytest.approx(0.95)
        assert curves["least_level"] == pytest.approx(betaincinv(76, 4, 0.1))  # of all 79
        further = [drawn_run(random, 2) for _ in range(20)]
        holds += [keeps(run, scales, curves)[0] for run in further]
        pooled = np.quantile([np.max(run.errors["force"] / run.sizes["force"]) for run in one + two], 0.95)
        common += [np.max(run.errors["force"] / run.sizes["force"]) <= pooled for run in further]
    assert np.mean(holds) > 0.92
    assert np.mean(common) < 0.88


def test_few_runs_of_one_kind_raise_the_bound_and_the_level_is_that_of_all():
    """Runs with two tools err more here: even a single one is in the bound, of which it has the largest factor."""
    random = np.random.default_rng(1)
    one, two = [drawn_run(random, 1) for _ in range(39)], drawn_run(random, 2)
    two = two._replace(errors={name: 10.0 * values for name, values in two.errors.items()})
    scales = calibrate_scales([run.measures for run in [*one, two]], 0.95)
    curves = error_curves([*one, two], scales)
    assert curves["level"] == 0.95
    assert keeps(two, scales, curves)[0]
    assert curves["force"]["bound"] > 3 * error_curves(one, scales)["force"]["bound"]


def test_the_bound_is_unknown_with_two_tools_where_held_out_runs_had_one():
    random = np.random.default_rng(2)
    runs = [drawn_run(random, 1) for _ in range(39)]
    runs.append(runs[0]._replace(measures=runs[0].measures._replace(distances=30 * runs[0].measures.distances)))
    scales = calibrate_scales([run.measures for run in runs], 0.95)  # one run is far above an error indicator of 2
    curves = error_curves(runs, scales)
    assert error_indicators(runs[-1].measures, scales).max() > 10
    assert keeps(drawn_run(random, 1), scales, curves)[1]
    assert keeps(drawn_run(random, 2), scales, curves) == (True, False)
