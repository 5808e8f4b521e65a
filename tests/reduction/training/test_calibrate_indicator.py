"""The trust number: what it measures, what it tells apart, and what errors it stands for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.hyper.error_indicator import residual_norm, training_distance
from palpate.reduction.hyper.reactions import projected_loads
from palpate.reduction.hyper.sampled_energy import scratch
from palpate.reduction.training.calibrate_indicator import error_table

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


def test_an_imbalance_is_the_displacement_that_the_witnesses_would_add(body, runs):
    """At rest under a small load: solve with the modes alone, and with modes and witnesses."""
    model = pt.hyper_reduce(body, runs, modes=8, cubature=0.0)
    prepared, modes, columns = (
        model.prepare([pt.SurfaceForce("x+", force=(0, 1e-4, 0))]),
        8,
        model.data.basis_vectors,
    )
    which = np.r_[:modes, len(columns) - model.data.residual_fields : len(columns)]
    load = projected_loads(model.body, prepared).at(np.zeros(1))[0, which]
    samples = model.data.integration_points(which, model.body.coefficients, model.single)
    stiffness = np.zeros((len(which), len(which)))
    sizes = 1e-8 / np.linalg.norm(columns[which], axis=2).max(axis=1)
    model.body.tangent(
        np.zeros(len(which)), sizes, samples, scratch(samples), np.zeros((3, len(which))), len(which), stiffness
    )
    kept = np.linalg.solve(stiffness[:modes, :modes], load[:modes])
    both = np.linalg.solve(stiffness, load)
    added = np.tensordot(both - np.r_[kept, np.zeros(len(which) - modes)], columns[which], 1)
    expected = np.sqrt((added**2).sum(axis=1) @ body.volumes / body.volumes.sum())
    assert residual_norm(model.body, pt.State(kept, np.zeros(modes)), prepared) == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_the_samples_measure_the_imbalance_that_all_nodes_measure(body, runs, rom, held):
    every = pt.hyper_reduce(body, runs, modes=10, cubature=0.0)
    loads, full = held[0]
    prepared = rom.prepare(loads)
    found, expected = (np.array([residual_norm(m.body, s, prepared) for s in states(rom, full)]) for m in (rom, every))
    assert len(rom.data.cubature.nodes) < 0.7 * len(body.cloud)
    assert np.linalg.norm(found - expected) < 0.25 * np.linalg.norm(expected)


def test_witnesses_add_no_nodes_and_change_no_motion(body, rom):
    count = rom.count
    bare = replace(
        rom.data, residual_fields=0, basis_vectors=rom.data.basis_vectors[:-8], gradients=rom.data.gradients[:, :-8],
        constant=rom.data.constant[:-8, :-8],
    )  # fmt: skip
    other, loads = pt.ReducedModel(bare), pull(5.0, 0.2, -1.5e-3)
    assert rom.data.residual_fields == 8
    one, two = rollout(rom, loads), rollout(other, loads)
    np.testing.assert_allclose(one.displacements, two.displacements, atol=1e-12)
    prepared, state = rom.prepare(loads), pt.State(rom.data.training_states[30] * 1.1, np.zeros(count), 0.005)
    assert residual_norm(other.body, state, prepared) == 0.0
    distance = training_distance(rom.body, state) / rom.data.distance_scale
    assert other.trust(state, prepared) == max(distance, other.load_share(state, prepared) / other.data.load_scale)


def test_a_load_that_the_modes_cannot_follow_is_not_trusted_however_little_the_body_moves(rom, body):
    """The sides of the beam are pressed together: no training run did that."""
    pinch = [pt.SurfaceForce("z+", force=(0, 0, -30.0)), pt.SurfaceForce("z-", force=(0, 0, 30.0))]
    prepared, state = rom.prepare(pinch), pt.State(np.zeros(rom.count), np.zeros(rom.count))
    assert training_distance(rom.body, state) / rom.data.distance_scale < 0.01
    assert rom.trust(state, prepared) > 1


def test_the_engines_report_tells_the_same_number(body):
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
            alone = pt.ReducedModel(replace(model.data, distance_scale=1e9, load_scale=1.0), step=model.step)
            assert alone.trust(state, prepared) == pytest.approx(
                residual_norm(model.body, state, prepared) / model.data.residual_scale
            )


def test_errors_are_told_by_the_largest_trust_number_so_far():
    """An error stays when the number falls again, and belongs to what the number was."""
    numbers = [np.r_[np.full(50, 0.2), 2.0, np.full(49, 0.1)], np.full(100, 0.3)]
    missed = [np.r_[np.full(50, 0.01), np.full(50, 0.5)], np.full(100, 0.02)]
    table = error_table(numbers, missed)
    assert table == [
        {"trust": 0.2, "median": 0.01, "percentile_95": 0.01, "frames": 50},
        {"trust": 0.3, "median": 0.02, "percentile_95": 0.02, "frames": 100},
        {"trust": 2.0, "median": 0.5, "percentile_95": 0.5, "frames": 50},
    ]


def test_a_table_of_errors_rises_and_covers_them():
    rng = np.random.default_rng(0)
    numbers = [np.sort(rng.uniform(0, 1.5, 400)) for _ in range(5)]
    missed = [own * rng.uniform(0.0, 0.1, 400) for own in numbers]
    table = error_table(numbers, missed)
    for name in ("trust", "median", "percentile_95"):
        assert np.all(np.diff([row[name] for row in table]) >= 0)
    bounds = np.array([row["percentile_95"] for row in table])
    rows = np.searchsorted([row["trust"] for row in table], np.concatenate(numbers))
    assert np.mean(np.concatenate(missed) <= bounds[rows]) == pytest.approx(0.95, abs=0.01)


def test_expected_errors_rise_with_trust_and_are_unknown_above_all_that_was_met(rom):
    table = rom.report["held_out"]["trust"]
    found = [rom.expected_error(row["trust"]) for row in table]
    assert found == sorted(found)
    assert 0 <= found[0][0] <= found[0][1] <= found[-1][1] < 1
    assert rom.expected_error(0.0) == found[0]
    assert rom.expected_error(1.01 * table[-1]["trust"]) == (np.inf, np.inf)
    with pytest.raises(pt.InputError, match=r"trust must be .*, got -1"):
        rom.expected_error(-1)


def test_no_error_is_expected_without_held_out_runs(body, runs):
    with pytest.raises(pt.InputError, match="train with hyper_reduce"):
        pt.hyper_reduce(body, runs, modes=4).expected_error(0.5)


def test_a_basis_that_holds_all_snapshots_leaves_no_witness(body, runs):
    short = replace(runs[0], displacements=runs[0].displacements[[10, 20]], times=runs[0].times[[10, 20]])
    model = pt.hyper_reduce(body, short, modes=2)
    assert model.data.residual_fields == 0
    prepared = model.prepare(pull(1.0, 0.0, 0.0))
    state = pt.State(2 * model.data.training_states[-1], np.zeros(2), 0.001)
    assert model.trust(state, prepared) == pytest.approx(
        training_distance(model.body, state) / model.data.distance_scale
    )
