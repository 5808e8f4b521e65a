"""`benchmarks/speed.py`: what it measures, on bodies small enough for a test, and what it leaves."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import speed
from speed_cases import _with_samples
from timing import force_seconds, median_seconds, read_seconds, step_seconds

import palpate as pt
from palpate.app.common.console import Console
from palpate.app.common.report import REPORTS
from palpate.scenes.beam import beam

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sampled(bar, tissue, pull):
    """A hyper-reduced model of the bar."""
    full = pt.Solid(bar, tissue, fixed="x-", form="energy")
    return pt.hyper_reduce(full, pt.rollout(full, [pull], duration=0.01, every=0.0005), modes=5)


def test_calls_take_turns_and_the_median_ignores_a_slow_round(monkeypatch):
    clock, order, takes = [0.0], [], [9.0, 0.2, 5.0, 0.1]  # [s], the first to warm up
    monkeypatch.setattr("timing.perf_counter", lambda: clock[0])

    def first():
        clock[0] += takes[len(order) // 2]
        order.append("a")

    def second():
        clock[0] += 1.0
        order.append("b")

    assert median_seconds(first, second, repeats=3) == pytest.approx([0.2, 1.0])
    assert order == ["a", "b"] * 4


@pytest.mark.parametrize("count", [4, 37, 400])
def test_evaluating_nodes_in_several_parts_keeps_force_and_energy(sampled, count):
    own = len(sampled.data.cubature.nodes)
    model = _with_samples(sampled, count)
    assert len(model.data.cubature.nodes) == count
    coordinates = 0.1 * sampled.data.training_states[-1]
    if count >= own:
        np.testing.assert_allclose(model.body.force(coordinates), sampled.body.force(coordinates), rtol=1e-6)
        assert model.body.energy(coordinates) == pytest.approx(sampled.body.energy(coordinates), rel=1e-6)
    else:
        share = model.data.cubature.weights.sum() / sampled.data.cubature.weights.sum()
        assert count / own < share < 1  # the heaviest ones


def test_timing_compiled_loops_does_not_change_the_model(sampled, pull):
    prepared = sampled.prepare([pull])
    state = sampled.state(prepared)
    before = sampled.advance(state, prepared, 1e-5, 10)[0]
    force, reading = force_seconds(sampled, repeats=2)
    (step,) = step_seconds((sampled, prepared, state), steps=50, repeats=2)
    assert min(force, reading, step, read_seconds(np.ones(10**4), repeats=2)) > 0
    assert not state.coordinates.any()
    np.testing.assert_array_equal(sampled.advance(state, prepared, 1e-5, 10)[0].coordinates, before.coordinates)


@pytest.fixture
def small(monkeypatch):
    """Let the command measure small bodies in short runs."""
    monkeypatch.setattr("speed_cases.beam", lambda spacing: replace(beam(spacing=0.02 / 3, load=2.0), duration=0.05))
    sizes = {"BLOCK_EDGE_NODES": (4, 5), "LARGE_MODEL_MODES": 6, "LARGE_MODEL_NODES": 24, "BEAM_MODES": 3}
    for name, value in sizes.items():
        monkeypatch.setattr(f"speed_cases.{name}", value)
    monkeypatch.setattr("pressed_liver.NODE_SPACING", 0.016)
    monkeypatch.setattr("pressed_liver.PRESS_SECONDS", 0.1)


@pytest.mark.release
def test_the_report_and_the_table_hold_every_ratio_of_one_run(small, tmp_path, capsys, monkeypatch):
    out = tmp_path / "results" / "bench"
    monkeypatch.setattr("sys.argv", ["speed.py", "--repeats", "2", "--out", str(out)])
    speed.main()
    report = json.loads((out / "report.json").read_text())
    assert {path.name for path in out.iterdir()} == set(REPORTS)
    assert "round 2 of 2: energy" in capsys.readouterr().err
    (case,), large = report["beam"], report["large"]
    fast = case["hyper_reduced"]
    assert case["nodes"] == 496
    assert (fast["modes"], large["modes"], large["nodes"]) == (3, 6, 24)
    for form in ("strong", "energy"):
        full = case["full"][form]
        assert full["real_time_factor"] == pytest.approx(0.05 / full["wall_seconds"])
        assert full["steps_per_second"] == pytest.approx(full["steps"] / full["wall_seconds"])
        assert fast["ratio"][form] == pytest.approx(fast["wall_seconds"] / full["wall_seconds"])
    assert large["table_bytes"] == 24 * 6 * 9 * 4
    assert large["force_over_reading"] == pytest.approx(large["force_seconds"] / large["read_seconds"])
    expected = large["force_seconds"] / large["memory_read_seconds"]
    assert large["force_over_memory_reading"] == pytest.approx(expected)
    first, second = large["bodies"]
    assert (first["nodes"], second["nodes"]) == (64, 125)
    ratio = second["compiled_seconds_per_step"] / first["compiled_seconds_per_step"]
    assert large["compiled_step_ratio"] == pytest.approx(ratio)
    full = report["full_body"]
    for each in full["threads"]:
        assert 0 < each["median_seconds"] <= each["seconds_99"]
        assert each["nodes_in_real_time"] == pytest.approx(full["nodes"] * (1e-3 / each["mean_seconds"]) ** 0.75)
    assert [each["threads"] for each in full["threads"]] == sorted({1, report["machine"]["threads"]})
    table = [line for line in (out / "report.md").read_text().splitlines() if line.startswith("|")]
    assert all(line.count("|") == 3 for line in table)
    assert f"{100 * fast['ratio']['strong']:.2g} % (strong form)" in "".join(table)


def test_measurements_before_a_diverged_run_are_kept(small, capsys, monkeypatch):
    def diverged(*_):
        raise pt.DivergenceError("no step is stable at t = 0.1 s")

    monkeypatch.setattr("speed.beam_case", diverged)
    report = speed.measure(False, 1, Console())
    assert report["beam"] == []
    assert report["large"]["force_seconds"] > 0
    assert "5 mm: failed: no step is stable" in capsys.readouterr().err
