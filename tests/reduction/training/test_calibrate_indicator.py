"""The error indicator: what it measures, what it tells apart, and what errors it stands for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.hyper.body import points_of
from palpate.reduction.hyper.data import Scales
from palpate.reduction.hyper.error_indicator import (
    curve_errors,
    expected_error,
    mean_size,
    remembered_trust,
    residual_norm,
    training_distance,
)
from palpate.reduction.hyper.reactions import constraint_forces
from palpate.reduction.hyper.sampled_energy import scratch
from palpate.reduction.training.calibrate_indicator import (
    Frames,
    Measures,
    calibrate_scales,
    error_curves,
    error_indicators,
)

pytestmark = pytest.mark.slow

EVERY, DURATION = 0.0005, 0.02


@pytest.fixture(scope="module")
def body():
    tissue = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.49)
    return pt.Solid(pt.box((0.04, 0.015, 0.015), 0.005), tissue, "x-", form="energy", stiffness_damping=2e-5)


def pull(x, y, twist, rate=300.0):
    def course(t):
        return np.sin(rate * t) ** 2

    return [
        pt.SurfaceForce(
            "x+", force=lambda t: course(t) * np.array([x, y, -y]), moment=lambda t: (twist * course(t), 0, 0)
        )
    ]


def rollout(model, loads):
    return pt.rollout(model, loads, duration=DURATION, every=EVERY, progress=False)


@pytest.fixture(scope="module")
def runs(body):
    return [rollout(body, pull(*p)) for p in ((8.0, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 3e-3), (6.0, -0.3, 2e-3))]


@pytest.fixture(scope="module")
def held(body):
    return [(loads, rollout(body, loads)) for loads in (pull(5.0, 0.2, -1.5e-3), pull(3.0, -0.3, 1e-3, 260.0))]


@pytest.fixture(scope="module")
def rom(body, runs, held):
    return pt.hyper_reduce(body, runs, modes=10, held_out=held)


def states(model, run):
    coordinates, velocities = model.body.project(run.displacements), model.body.project(run.velocities)
    return [pt.State(a, v, float(t)) for a, v, t in zip(coordinates, velocities, run.times, strict=True)]


def unbalanced(model, state, prepared) -> float:
    return residual_norm(model.data, constraint_forces(model.body, state, prepared))


def test_the_residual_norm_is_the_displacement_that_the_residual_fields_would_add(body, runs):
    """At rest under a small load: solve with the modes alone, and with modes and residual fields."""
    model = pt.hyper_reduce(body, runs, modes=8, cubature=0.0)
    prepared, modes, columns = (
        model.prepare([pt.SurfaceForce("x+", force=(0, 1e-4, 0))]),
        8,
        model.data.trial_and_test_basis,
    )
    which = np.r_[:modes, len(columns) - model.data.residual_fields : len(columns)]
    load = prepared.forces(np.zeros(1))[0, which]
    samples = points_of(model.data, which, model.body.coefficients, model.single)
    stiffness = np.zeros((len(which), len(which)))
    sizes = 1e-8 / np.linalg.norm(columns[which], axis=2).max(axis=1)
    model.body.tangent(
        np.zeros(len(which)), sizes, samples, scratch(samples), np.zeros((3, len(which))), len(which), stiffness
    )
    reduced = np.linalg.solve(stiffness[:modes, :modes], load[:modes])
    both = np.linalg.solve(stiffness, load)
    added = np.tensordot(both - np.r_[reduced, np.zeros(len(which) - modes)], columns[which], 1)
    expected = np.sqrt((added**2).sum(axis=1) @ body.volumes / body.volumes.sum())
    assert unbalanced(model, pt.State(reduced, np.zeros(modes)), prepared) == pytest.approx(expected, rel=0.02)


def test_the_cubature_points_give_the_residual_norm_of_all_nodes(body, runs, rom, held):
    every = pt.hyper_reduce(body, runs, modes=10, cubature=0.0)
    loads, full = held[0]
    found, expected = (np.array([unbalanced(m, s, m.prepare(loads)) for s in states(rom, full)]) for m in (rom, every))
    assert len(rom.data.cubature.nodes) < 0.7 * len(body.cloud)
    assert np.linalg.norm(found - expected) < 0.25 * np.linalg.norm(expected)


def test_residual_fields_add_no_nodes_and_do_not_change_the_motion(body, rom):
    count = rom.count
    basis, sampled = rom.data.basis, rom.data.sampled
    bare = replace(
        rom.data,
        basis=replace(basis, vectors=basis.vectors[:-8], residual_fields=0),
        sampled=replace(sampled, gradients=sampled.gradients[:, :-8], constant=sampled.constant[:-8, :-8]),
    )
    other, loads = pt.ReducedModel(bare), pull(5.0, 0.2, -1.5e-3)
    assert rom.data.residual_fields == 8
    one, two = rollout(rom, loads), rollout(other, loads)
    np.testing.assert_allclose(one.displacements, two.displacements, atol=1e-12)
    prepared, state = other.prepare(loads), pt.State(rom.data.training_states[30] * 1.1, np.zeros(count), 0.005)
    assert unbalanced(other, state, prepared) == 0.0
    distance = training_distance(rom.body, state) / rom.data.scales.distance_scale
    assert other.trust(state, prepared) == max(
        distance, other.load_share(state, prepared) / other.data.scales.load_scale
    )


def test_a_load_that_the_modes_cannot_follow_is_not_trusted_however_little_the_body_moves(rom, body):
    """The sides of the beam are pressed together: no training run did that."""
    pinch = [pt.SurfaceForce("z+", force=(0, 0, -30.0)), pt.SurfaceForce("z-", force=(0, 0, 30.0))]
    prepared, state = rom.prepare(pinch), pt.State(np.zeros(rom.count), np.zeros(rom.count))
    assert training_distance(rom.body, state) / rom.data.scales.distance_scale < 0.01
    assert rom.trust(state, prepared) > 1


def test_the_report_of_the_engine_has_the_same_error_indicator(body):
    turn = [pt.PrescribedMotion("x+", lambda _, t: 1e-3 * np.sin(200 * t) ** 2 * np.array([1.0, 1.0, 0.0]))]
    rom = pt.hyper_reduce(body, rollout(body, turn), modes=6, prescribed="x+")
    for model in (rom, rom.with_step(2.5e-4)):
        speed, ready = np.array([0.5, 0.2, 0.0]), pt.realtime_model(model)
        report = np.zeros(8 + model.data.lifting_count)
        prepared = model.prepare([pt.PrescribedMotion("x+", lambda _, t: speed * t)])  # noqa: B023
        q, v = np.zeros(model.count), np.zeros(model.count)
        for period in range(1, 6):
            target = ready.tool @ np.r_[speed * period * 1e-3, np.zeros(9)]
            ready.advance(ready.data, q, v, target, 1e-3, report)
            state = pt.State(q, v, period * 1e-3)
            assert report[1] == pytest.approx(model.trust(state, prepared), rel=1e-3)
            scales = model.data.with_scales(distance_scale=1e9, load_scale=1.0, speed_scale=1e9)
            alone = pt.ReducedModel(scales, step=model.step)
            assert alone.trust(state, prepared) == pytest.approx(
                unbalanced(model, state, prepared) / model.data.scales.residual_scale
            )


def drawn_run(random, spread=0.5) -> Frames:
    """A run of 60 frames whose error grows with its error indicator; runs differ, frames of one run err together."""
    trust = np.maximum.accumulate(random.uniform(0.2, 2.0) * random.random(60))
    error = 0.03 * trust * np.exp(spread * random.standard_normal() + 0.2 * random.standard_normal(60))
    size = np.linspace(0.0, random.uniform(1.0, 3.0), 60)
    measures = Measures(trust, *np.zeros((2, 60)), *np.zeros((2, 60, 1)), *np.zeros((2, 60)))
    return Frames(measures, np.linspace(0.0, 0.6, 60), {"displacement": error * (size + 2.0)}, {"displacement": size})


def keeps(run: Frames, scales: Scales, curves) -> bool:
    worst = remembered_trust(error_indicators(run.measures, scales), run.times, curves["forgetting"])
    bounds = curve_errors(curves["displacement"], "bound", worst)
    size = mean_size(run.sizes["displacement"], curves["displacement"]["typical_size"])
    return bool(np.all(run.errors["displacement"] <= bounds * size))


def test_the_largest_error_indicator_decays_as_vibrations_do():
    times = np.array([0.0, 0.1, 0.2, 0.5, 10.0])
    found = remembered_trust(np.array([0.0, 3.0, 0.5, 0.2, 0.1]), times, 4.0)
    np.testing.assert_allclose(found, [0.0, 3.0, 3.0 * np.exp(-0.4), 3.0 * np.exp(-1.6), 0.1])
    np.testing.assert_allclose(remembered_trust(np.array([0.3, 0.1, 0.2]), times[:3], 0.0), 0.3)


@pytest.mark.parametrize("forgetting", [0.0, 4.0])
@pytest.mark.parametrize(("count", "level"), [(4, 0.8), (19, 0.95), (39, 0.95)])
def test_error_bounds_hold_for_their_level_of_new_runs(count, level, forgetting):
    """Many calibrations on few runs each, judged on runs of the same kind."""
    random, holds = np.random.default_rng(0), []
    for _ in range(60):
        runs = [drawn_run(random) for _ in range(count)]
        scales = calibrate_scales([run.measures for run in runs], 0.95)
        curves = error_curves(runs, scales, forgetting)
        assert curves["level"] == pytest.approx(level)
        holds += [keeps(drawn_run(random), scales, curves) for _ in range(20)]
    assert level - 0.03 < np.mean(holds) < level + (0.03 if count > 4 else 0.1)  # few runs leave more unknown


def test_an_error_bound_increases_with_the_error_indicator_and_is_infinite_from_2_on():
    random = np.random.default_rng(1)
    runs = [drawn_run(random, spread=0.1) for _ in range(19)]
    scales = calibrate_scales([run.measures for run in runs], 0.95)
    curve = error_curves(runs, scales)["displacement"]
    assert 0.7 < curve["exponent"] < 1.3  # errors are proportional to the error indicator here
    assert curve["largest_trust"] == pytest.approx(2.0, abs=2e-3)
    report = {"held_out": {"expected_error": {"level": 0.95, "least_level": 0.9, "displacement": curve}}}
    found = [expected_error(report, number) for number in (0.0, 0.3, 1.0, 1.9)]
    assert found == sorted(found)
    assert all(0 < each.median < each.bound < 1 for each in found)
    assert expected_error(report, 2.0)[:4] == (np.inf, np.inf, 0.95, 0.9)


def test_a_campaign_keeps_its_least_level_with_a_confidence_of_nine_in_ten():
    """The share of new runs that keep the bound is known for every campaign: runs differ by one factor only."""
    random, above = np.random.default_rng(3), []
    for count in (9, 19, 45):
        for _ in range(60):
            runs = [drawn_run(random) for _ in range(count)]
            scales = calibrate_scales([run.measures for run in runs], 0.95)
            curves = error_curves(runs, scales)
            shares = [keeps(drawn_run(random), scales, curves) for _ in range(100)]
            above.append(np.mean(shares) >= curves["least_level"] - 0.02)
    assert np.mean(above) > 0.85


@pytest.mark.parametrize(("count", "least"), [(1, 0.1), (9, 0.774), (20, 0.891), (45, 0.917)])
def test_the_least_level_is_a_percentile_of_a_beta_distribution(count, least):
    """Of the largest of n uniform numbers, the tenth percentile is 0.1^(1/n)."""
    random = np.random.default_rng(0)
    runs = [drawn_run(random) for _ in range(count)]
    curves = error_curves(runs, calibrate_scales([run.measures for run in runs], 0.95))
    assert curves["least_level"] == pytest.approx(least, abs=2e-3)


def test_error_indicators_are_at_most_1_in_most_calibration_runs():
    random = np.random.default_rng(2)
    sizes, runs = np.array([1.0, 1e-3, 0.02, 1e-6, 0.1, 0.3]), []
    for scale in random.uniform(0.5, 2.0, 40):
        values = random.gamma(2.0, scale, (6, 30)) * sizes[:, None]
        runs.append(Measures(*values[:3], *values[3:5, :, None], values[5], np.ones(30)))
    scales = calibrate_scales(runs, 0.95)
    assert sum(error_indicators(run, scales).max() <= 1 + 1e-9 for run in runs) in (38, 39, 40)


def test_runs_without_error_have_a_zero_bound_and_one_run_has_level_one_half():
    measures = Measures(*np.zeros((3, 5)), *np.zeros((2, 5, 1)), *np.zeros((2, 5)))
    still = Frames(measures, np.arange(5.0), {"displacement": np.zeros(5)}, {"displacement": np.zeros(5)})
    curves = error_curves([still], calibrate_scales([still.measures], 0.95))
    assert curves["level"] == 0.5
    assert curves["displacement"]["bound"] <= 1e-12


def test_expected_errors_of_a_model_are_those_of_its_held_out_runs(rom):
    curve = rom.report["held_out"]["expected_error"]["displacement"]
    known = rom.expected_error(0.9 * curve["largest_trust"])
    assert 0 < known.median <= known.bound < 1
    assert known.level == pytest.approx(2 / 3)  # of two held-out runs
    assert rom.expected_error(1.01 * curve["largest_trust"])[:2] == (np.inf, np.inf)
    with pytest.raises(pt.InputError, match=r"trust must be .*, got -1"):
        rom.expected_error(-1)
    with pytest.raises(pt.InputError, match="of must be 'displacement' for a model whose held-out runs have no tool"):
        rom.expected_error(0.5, "force")
    with pytest.raises(pt.InputError, match="of must be 'displacement' or 'force', got 'moment'"):
        rom.expected_error(0.5, "moment")


def test_the_bounds_of_a_run_hold_displacements_and_tool_forces(body):
    def turn(size: float) -> list[pt.PrescribedMotion]:
        return [pt.PrescribedMotion("x+", lambda _, t: size * np.sin(150 * t) ** 2 * np.array([1e-3, 1e-3, 0.0]))]

    held = [(turn(size), rollout(body, turn(size))) for size in (0.3, 0.6, 0.8, 0.9)]
    rom = pt.hyper_reduce(body, rollout(body, turn(1.0)), modes=6, prescribed="x+", held_out=held)
    own, full = (rollout(model, turn(0.7)) for model in (rom, body))
    missed = np.sqrt(((own.displacements - full.displacements) ** 2).sum(axis=2) @ rom.volumes / rom.volumes.sum())
    apart = np.linalg.norm(own.reactions["x+"] - full.reactions["x+"], axis=1)
    for bounds, errors in ((own.displacement_bounds, missed), (own.force_bounds, apart)):
        assert bounds.shape == own.times.shape
        assert np.all(errors <= bounds)
        assert np.isfinite(bounds).all()
    assert rom.expected_error(0.5, "force").level == pytest.approx(0.8)
    size = float(np.linalg.norm(own.reactions["x+"][-1]))
    worst = float(own.trust.max())
    assert pt.realtime_model(rom).force_bound(worst, size) == pytest.approx(own.force_bounds[-1])


def test_no_error_is_expected_without_held_out_runs(body, runs):
    with pytest.raises(pt.InputError, match="train with hyper_reduce"):
        pt.hyper_reduce(body, runs, modes=4).expected_error(0.5)


def test_a_basis_that_spans_all_snapshots_has_no_residual_fields(body, runs):
    short = replace(runs[0], displacements=runs[0].displacements[[10, 20]], times=runs[0].times[[10, 20]])
    model = pt.hyper_reduce(body, short, modes=2)
    assert model.data.residual_fields == 0
    prepared = model.prepare(pull(1.0, 0.0, 0.0))
    state = pt.State(2 * model.data.training_states[-1], np.zeros(2), 0.001)
    assert model.trust(state, prepared) == pytest.approx(
        training_distance(model.body, state) / model.data.scales.distance_scale
    )
