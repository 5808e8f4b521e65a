"""The reduced model: an energy sampled at few nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.reduction.basis.strain_pod import main_modes

EVERY, DURATION = 0.0005, 0.02
TISSUE = {"C1": 60e3, "C2": 1.2e3, "density": 1120.0}


@pytest.fixture(scope="module")
def body():
    cloud = pt.box((0.04, 0.015, 0.015), 0.005)
    return pt.Solid(
        cloud, pt.materials.MooneyRivlin(poisson=0.49, **TISSUE), "x-", form="energy", stiffness_damping=2e-5
    )


def pull(x=8.0, y=0.3, twist=2e-3, rate=300.0):
    def course(t):
        return np.sin(rate * t) ** 2

    return [
        pt.SurfaceForce(
            "x+", force=lambda t: course(t) * np.array([x, y, -y]), moment=lambda t: (twist * course(t), 0, 0)
        )
    ]


def rollout(model, loads, **options):
    return pt.rollout(model, loads, duration=DURATION, every=EVERY, progress=False, **options)


@pytest.fixture(scope="module")
def runs(body):
    return [rollout(body, pull(*p)) for p in ((8.0, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 3e-3), (6.0, -0.3, 2e-3))]


@pytest.fixture(scope="module")
def rom(body, runs):
    return pt.hyper_reduce(body, runs, modes=16)


@pytest.fixture(scope="module")
def whole(body, runs):
    """All nodes, their volumes, and as many pressure modes as there are."""
    return pt.hyper_reduce(body, runs, modes=8, cubature=0.0, pressures=1000)


def turned(points):
    def motion(_, t):
        angle = np.array([0.6, 0.2, -0.2]) * np.sin(250 * t) ** 2
        return (points - points.mean(axis=0)) @ (Rotation.from_rotvec(angle).as_matrix() - np.eye(3)).T + [
            1e-3 * np.sin(250 * t) ** 2, 2e-3 * np.sin(250 * t) ** 2, 0.0,
        ]  # fmt: skip

    return [pt.PrescribedMotion("x+", motion)]


@pytest.fixture(scope="module")
def grasped(body):
    loads = turned(body.cloud.points[body.cloud.group("x+")])
    run = rollout(body, loads)
    return loads, run, pt.hyper_reduce(body, run, modes=14, prescribed="x+")


def random_state(model, rng, size=2e-3):
    return size * rng.standard_normal(model.count) / model.body.sizes / np.sqrt(model.count)


@pytest.mark.slow
def test_all_nodes_with_their_volumes_are_the_galerkin_model(body, whole):
    rng, columns = np.random.default_rng(0), whole.data.trial_and_test_basis[: whole.count]
    precise = pt.ReducedModel(whole.data, single=False)
    for _ in range(5):
        a = random_state(whole, rng)
        u = np.tensordot(a, columns, 1)
        nodal = body.force(u) * body.volumes[:, None]
        expected = np.tensordot(columns, nodal, 2)
        scale = np.abs(expected).max()
        # the pressure modes are those of the runs; what they leave of a random state's pressure is small, not zero
        np.testing.assert_allclose(precise.body.force(a), expected, atol=0.02 * scale)
        np.testing.assert_allclose(precise.body.energy(a), body.strain_energy(u), rtol=0.02)


def test_the_force_is_minus_the_slope_of_the_energy(rom):
    rng = np.random.default_rng(1)
    precise = pt.ReducedModel(rom.data, single=False)
    a, d = random_state(rom, rng), 1e-6 * random_state(rom, rng)
    change = precise.body.energy(a + d) - precise.body.energy(a - d)
    assert change == pytest.approx(-2 * precise.body.force(a) @ d, rel=1e-5)


def test_the_tangent_is_symmetric_and_positive_at_rest(rom):
    tangent = rom.body.stiffness(np.zeros(rom.count))
    np.testing.assert_allclose(tangent, tangent.T, atol=1e-4 * np.abs(tangent).max())
    assert np.linalg.eigvalsh(tangent + tangent.T).min() > 0


def test_single_precision_of_the_table_changes_forces_negligibly(rom):
    rng, precise = np.random.default_rng(2), pt.ReducedModel(rom.data, single=False)
    for _ in range(5):
        a = random_state(rom, rng)
        expected = precise.body.force(a)
        assert np.linalg.norm(rom.body.force(a) - expected) < 3e-5 * np.linalg.norm(expected)


def test_few_nodes_are_chosen_and_weights_are_positive(body, rom):
    rule = rom.data.cubature
    assert len(rule.nodes) < 0.7 * len(body.cloud)
    assert np.all(rule.weights > 0)
    assert rule.residual <= 1e-3
    assert rule.weights.sum() == pytest.approx(body.volumes.sum(), rel=0.3)


def test_a_trained_motion_is_reproduced(rom, runs):
    errors = pt.relative_errors(runs[3], rollout(rom, pull(6.0, -0.3, 2e-3)))
    assert errors.displacement < 0.05
    assert errors.reaction < 0.02
    assert errors.energy < 0.01


@pytest.mark.slow
def test_untrained_motions_are_reproduced_better_with_more_modes(body, runs):
    loads = pull(5.0, 0.2, -1.5e-3, rate=260.0)
    full = rollout(body, loads)
    found = [pt.relative_errors(full, rollout(pt.hyper_reduce(body, runs, modes=m), loads)).velocity for m in (4, 24)]
    assert found[1] < 0.5 * found[0]
    assert found[1] < 0.15


@pytest.mark.slow
@pytest.mark.parametrize("modes", [2, 12, 40])
def test_runs_far_beyond_training_remain_bounded(body, runs, modes):
    """Loads that crush the body far beyond its training; the full model turns inside out under them."""
    rom = pt.hyper_reduce(body, runs, modes=modes)
    wild = [pt.SurfaceForce("x+", force=lambda t: (30 * np.sin(900 * t), 5 * np.cos(500 * t), 3.0))]
    made = [rollout(rom, wild), rollout(rom.with_step(1.25e-4), wild)]
    made += [pt.rollout(rom, wild, duration=DURATION, every=DURATION / parts, progress=False) for parts in (8, 3)]
    for run in made:
        assert run.complete
        largest = max(float(run.external.max()), float((run.kinetic + run.strain).max()))
        assert np.abs(run.balance).max() < 0.05 * largest


@pytest.mark.slow
def test_implicit_and_small_explicit_steps_agree(rom):
    fine = rollout(rom, pull(), step=2e-6)
    coarse = rollout(rom.with_step(5e-5), pull())
    scale = np.abs(fine.displacements).max()
    np.testing.assert_allclose(coarse.displacements, fine.displacements, atol=2e-3 * scale)
    halves = [rollout(rom.with_step(step), pull()).displacements[-1] for step in (2.5e-4, 1.25e-4)]
    missed = [np.abs(u - fine.displacements[-1]).max() for u in halves]
    assert missed[0] / missed[1] == pytest.approx(4.0, rel=0.35)  # second order


@pytest.mark.slow
def test_implicit_steps_keep_the_energy_of_a_free_body(body, runs):
    data = replace(pt.hyper_reduce(body, runs, modes=8).data, stiffness_damping=0.0)
    model = pt.ReducedModel(data, step=2e-4)
    run = pt.rollout(model, (), duration=0.4, every=0.002, displacement=runs[3].displacements[10], progress=False)
    energy = run.kinetic + run.strain
    assert run.kinetic.max() > 0.2 * energy[0]
    assert np.abs(energy / energy[0] - 1).max() < 1e-3


@pytest.mark.slow
def test_the_force_of_a_tool_is_that_of_the_full_model(grasped):
    loads, full, rom = grasped
    run = rollout(rom, loads)
    errors = pt.relative_errors(full, run)
    assert errors.displacement < 0.05
    assert errors.reaction < 0.08


@pytest.mark.slow
def test_the_force_of_a_tool_at_rest_is_the_derivative_of_the_energy(grasped):
    """Hold the tool still until the body rests; move it a little: the work is the energy."""
    _, _, rom = grasped
    calm = pt.ReducedModel(replace(rom.data, stiffness_damping=2e-3), step=1e-3)

    def rested(x):
        held = [pt.PrescribedMotion("x+", (x, 0.0, 0.0))]
        run = pt.rollout(calm, held, duration=0.3, every=0.3, progress=False)
        return run.strain[-1], run.reactions["x+"][-1, 0]

    (below, _), (_, force), (above, _) = (rested(x) for x in (0.9e-3, 1e-3, 1.1e-3))
    assert force == pytest.approx((above - below) / 0.2e-3, rel=2e-3)


@pytest.mark.slow
def test_after_release_the_body_moves_freely(grasped):
    loads, _, rom = grasped
    freed = [pt.PrescribedMotion("x+", loads[0].displacement, until=0.006)]
    run = rollout(rom.with_step(1e-4), freed)
    assert run.complete
    assert not run.reactions["x+"][-1].any()
    late = run.kinetic[-15:] + run.strain[-15:]
    assert late[-1] <= 1.001 * late[0]


@pytest.mark.slow
def test_in_the_engine_a_resting_tool_has_the_static_force(grasped):
    _, _, rom = grasped
    model = pt.ReducedModel(replace(rom.data, stiffness_damping=2e-3))
    data, q = pt.realtime_model(model), np.zeros(rom.count)
    v, report = np.zeros(rom.count), np.zeros(8 + rom.data.lifting_count)
    target = data.tool @ np.concatenate([[1e-3, 5e-4, 0.0], np.zeros(9)])
    for _ in range(400):
        data.advance(data.data, q, v, target, 1e-3, report)
        assert report[0] == 0
    held = [pt.PrescribedMotion("x+", (1e-3, 5e-4, 0.0))]
    expected = pt.rollout(model.with_step(1e-3), held, duration=0.3, every=0.3, progress=False).reactions["x+"][-1]
    force = data.tool[:, :3].T @ report[8:]
    np.testing.assert_allclose(force, expected, atol=0.01 * np.linalg.norm(expected))
    out = np.zeros((rom.data.lifting_count, rom.data.lifting_count))
    data.stiffness(data.data, q, out)
    around = data.tool[:, :3].T @ out @ data.tool[:, :3]
    nearby = [pt.PrescribedMotion("x+", (1.01e-3, 5e-4, 0.0))]
    moved = pt.rollout(model.with_step(1e-3), nearby, duration=0.3, every=0.3, progress=False).reactions["x+"][-1]
    np.testing.assert_allclose(around[:, 0], (moved - expected) / 1e-5, atol=0.03 * np.abs(around[0, 0]))


@pytest.mark.slow
def test_a_diverging_period_does_not_change_the_state(grasped):
    rom = pt.realtime_model(grasped[2])
    q, v, report = np.zeros(len(rom.rest)), np.zeros(len(rom.rest)), np.zeros(8 + rom.tool.shape[0])
    rom.advance(rom.data, q, v, np.full(rom.tool.shape[0], 1e6), 1e-3, report)
    assert report[0] == 1
    assert not q.any()
    assert not v.any()


def test_contact_without_training_is_refused(rom):
    with pytest.raises(pt.InputError, match="train it with a Contact"):
        rom.prepare([pt.tools.Contact(pt.tools.Plane(), (0, 0, -1))])


def test_trust_is_small_in_training_and_large_far_from_it(body, runs, rom):
    prepared = rom.prepare(pull())
    inside = rom.trust(rom.state(prepared, runs[3].displacements[20]), prepared)
    outside = rom.trust(rom.state(prepared, 20 * runs[0].displacements[20]), prepared)
    assert inside < 1 < outside


@pytest.mark.slow
def test_held_out_runs_calibrate_trust_and_are_reported(body, runs):
    loads = pull(5.0, 0.2, -1.5e-3)
    full = rollout(body, loads)
    rom = pt.hyper_reduce(body, runs, modes=12, held_out=[(loads, full)])
    found = rom.report["held_out"]
    assert found["mean"]["velocity"] == pytest.approx(pt.relative_errors(full, rollout(rom, loads)).velocity, rel=1e-6)
    prepared = rom.prepare(loads)
    run = rollout(rom, loads)
    states = zip(rom.body.project(run.displacements), rom.body.project(run.velocities), run.times, strict=True)
    numbers = [rom.trust(pt.State(*state), prepared) for state in states]
    assert np.quantile(numbers, 0.95) == pytest.approx(1.0, rel=0.02)


def test_entries_of_a_report_are_added_to_another_model(rom):
    before = dict(rom.report)
    other = rom.with_report({"scene": "mine", "modes": 3})
    assert rom.report == before
    assert other.report == before | {"scene": "mine", "modes": 3}


@pytest.mark.slow
def test_a_tolerance_selects_the_fewest_modes_that_meet_it(body, runs):
    held = [(pull(6.0, -0.3, 2e-3), runs[3])]
    rom = pt.hyper_reduce(body, runs, tolerance=0.1, held_out=held)
    found = rom.report["held_out"]["mean"]
    assert max(found[name] for name in ("displacement", "velocity", "reaction")) <= 0.1
    with pytest.raises(pt.InputError, match="tolerance must be attainable"):
        pt.hyper_reduce(body, runs[:1], tolerance=1e-9, held_out=held)


@pytest.mark.slow
def test_a_strong_form_is_reduced_in_the_energy_form(body, runs):
    strong = pt.Solid(body.cloud, body.material, "x-", form="strong", stiffness_damping=6e-5)
    slow = pull(8.0, 0.0, 0.0, rate=60.0)
    run = rollout(strong, slow)
    rom = pt.hyper_reduce(strong, run, modes=6)
    assert rom.stiffness_damping == strong.stiffness_damping
    assert pt.relative_errors(run, rollout(rom, slow)).displacement < 0.12


@pytest.mark.slow
def test_modes_of_strain_are_orthonormal_and_optimal_for_strain(body, runs):
    snapshots = np.concatenate([run.displacements for run in runs])
    modes, lost = main_modes(body, snapshots, 8)
    assert lost == 0.0
    gram = np.einsum("mnc,n,knc->mk", modes, body.volumes, modes)
    np.testing.assert_allclose(gram, np.eye(8), atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"modes": None}, "modes or tolerance must be given"),
        ({"modes": None, "tolerance": 0.1}, "give held_out"),
        ({"modes": 1000}, "independent shapes"),
        ({"modes": 4, "prescribed": "x+"}, "groups that move rigidly"),
        ({"modes": 4, "enrichment": np.zeros((1, 3, 3))}, "enrichment must have shape"),
        ({"modes": 4, "cubature": 2.0}, "cubature"),
    ],
)
def test_bad_training_is_refused(body, runs, change, message):
    with pytest.raises(pt.InputError, match=message):
        pt.hyper_reduce(body, runs, **change)


def test_unsupported_loads_are_refused(body, rom, grasped):
    with pytest.raises(pt.InputError, match=r"got Pressure\(.*; run the full model or palpate.galerkin"):
        rollout(rom, [pt.Pressure("z+", 10.0)])
    with pytest.raises(pt.InputError, match="prescribe the motion of no group"):
        rollout(rom, [pt.PrescribedMotion("x+", (0.0, 0.0, 0.0))])
    with pytest.raises(pt.InputError, match="give the model those motions"):
        rollout(grasped[2], pull())
    with pytest.raises(pt.InputError, match="rigid tool"):
        rollout(grasped[2], [pt.PrescribedMotion("x+", lambda X, t: 1e3 * t * X**2)])
    with pytest.raises(pt.InputError, match="one prescribed group for the engine"):
        pt.realtime_model(rom)
    with pytest.raises(pt.InputError, match=r"step must be .*, got 1e-30"):
        pt.realtime_model(grasped[2].with_step(1e-30))


def test_an_unknown_cloud_is_refused(runs):
    other = pt.Solid(
        pt.box((0.04, 0.02, 0.015), 0.005), pt.materials.MooneyRivlin(poisson=0.3, **TISSUE), "x-", form="energy"
    )
    with pytest.raises(pt.InputError, match="another cloud"):
        pt.hyper_reduce(other, runs, modes=2)
