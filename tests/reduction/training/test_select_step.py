"""The step rule that costs least at equal error; what it costs is told by a clock of the test's own."""

from __future__ import annotations

from itertools import chain

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.training.select_step import TRIED_STEPS, _fastest_step

pytestmark = pytest.mark.slow

DURATION, EVERY = 0.04, 0.002
LOADS = [pt.SurfaceForce("x+", force=lambda t: (4.0 * np.sin(80 * t) ** 2, 0.2 * np.sin(80 * t) ** 2, 0.0))]


@pytest.fixture(scope="module")
def rom():
    tissue = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.45)
    body = pt.Solid(pt.box((0.04, 0.015, 0.015), 0.005), tissue, "x-", form="energy", stiffness_damping=2e-4)
    return pt.hyper_reduce(body, pt.rollout(body, LOADS, duration=DURATION, every=EVERY, progress=False), modes=6)


def ticking(*seconds):
    """A clock after which each rule in turn takes so many seconds."""
    ends = np.cumsum(seconds)
    return chain.from_iterable(zip([0.0, *ends[:-1]], ends, strict=True)).__next__


def chosen(rom, *seconds, repeats=1, **options):
    clock = ticking(*seconds)
    return pt.select_time_step(rom, LOADS, duration=DURATION, every=EVERY, repeats=repeats, clock=clock, **options)


def test_errors_are_those_against_small_steps_and_fall_with_the_step(rom):
    rules = chosen(rom, 1, 1, 1, 1, tolerance=1.0).report["stepping"]["rules"]
    assert [row["step"] for row in rules] == list(TRIED_STEPS)
    assert [row["steps"] for row in rules[1:]] == [40, 80, 160]
    fine = pt.rollout(rom, LOADS, duration=DURATION, every=EVERY, step=5e-6, progress=False)
    for row in rules:
        run = pt.rollout(rom.with_step(row["step"]), LOADS, duration=DURATION, every=EVERY, progress=False)
        for name, error in (("velocities", row["velocity"]), ("displacements", row["displacement"])):
            expected, found = getattr(fine, name), getattr(run, name)
            missed = np.linalg.norm(found - expected) / np.linalg.norm(expected)
            assert error == pytest.approx(missed, rel=0.1, abs=1e-4)
    for name in ("velocity", "displacement"):
        errors = [row[name] for row in rules[1:]]
        assert errors[0] > 2 * errors[1] > 4 * errors[2] > 0


def test_the_fastest_rule_within_the_tolerance_is_selected(rom):
    seconds = (4.0, 1.0, 2.0, 3.0)  # explicit; 1, 0.5, 0.25 ms
    errors = [max(row["velocity"], row["displacement"]) for row in chosen(rom, *seconds).report["stepping"]["rules"]]
    for k in (1, 2, 3):
        found = chosen(rom, *seconds, tolerance=1.01 * errors[k])
        assert found.step == TRIED_STEPS[k]
        assert found.report["stepping"]["step"] == TRIED_STEPS[k]
    assert chosen(rom, 0.5, *seconds[1:], tolerance=1.0).step is None


def test_the_shortest_of_repeated_times_counts(rom):
    found = chosen(rom, 5, 6, 7, 8, 9, 1, 8, 7, repeats=2, tolerance=1.0)
    assert [row["seconds"] for row in found.report["stepping"]["rules"]] == [5, 1, 7, 7]
    assert found.step == 1e-3


def test_the_selected_model_differs_only_in_its_step_and_the_given_one_is_not_changed(rom, tmp_path):
    double = pt.ReducedModel(rom.data, single=False)
    found = chosen(double, 2, 1, 2, 2, tolerance=1.0)
    assert (found.step, found.single) == (1e-3, False)
    assert "stepping" not in rom.report
    assert found.report["nodes"] == rom.report["nodes"]
    pt.save(found, tmp_path / "body.rom")
    loaded = pt.load(tmp_path / "body.rom")
    assert (loaded.step, loaded.single) == (1e-3, False)
    assert loaded.report["stepping"] == found.report["stepping"]


def test_a_tolerance_that_no_rule_meets_is_refused_with_the_errors_of_all():
    table = [{"step": step, "seconds": 1.0, "velocity": 0.02, "displacement": 0.03} for step in TRIED_STEPS]
    with pytest.raises(pt.InputError, match=r"tolerance of 1.00% .*\(explicit: 2.00% and 3.00%, 1 ms: 2.00% and"):
        _fastest_step(table, 0.01)


def test_a_rule_that_fails_is_not_selected(rom, monkeypatch):
    advance = pt.ReducedModel.advance

    def failing(self, *arguments):
        result, report = advance(self, *arguments)
        if self.step == 1e-3:
            result.coordinates[:] = np.nan
        return result, report

    monkeypatch.setattr(pt.ReducedModel, "advance", failing)
    found = chosen(rom, 4, 3, 2, tolerance=1.0)
    assert found.step == 0.25e-3
    failed = found.report["stepping"]["rules"][1]
    assert failed["velocity"] == failed["displacement"] == failed["seconds"] == np.inf


@pytest.mark.parametrize("options", [{"tolerance": 0.0}, {"tolerance": 2.0}, {"repeats": 0}, {"duration": -1.0}])
def test_invalid_arguments_are_refused_by_name(rom, options):
    with pytest.raises(pt.InputError, match=f"{next(iter(options))} must be .*, got .*"):
        pt.select_time_step(rom, LOADS, **{"duration": DURATION} | options)
