"""Rigid tools on reduced models: contact forces on a compliant surface, and runs compared with the full model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.dynamics.contact.geometry import gap
from palpate.reduction.basis.linear_modes import interpolated_modes
from palpate.reduction.basis.strain_pod import join
from palpate.reduction.contact.coarse_body import coarse_body
from palpate.reduction.contact.compliance import NO_COMPLIANCE, contact_displacements
from palpate.reduction.contact.gauss_seidel import solve_contact, tool_energy
from palpate.reduction.contact.surface import PAIRS, RigidTools, contact_scratch, contact_surface, rigid_tools
from palpate.reduction.training.round_compliance import MAX_STEP

pytestmark = pytest.mark.slow

SPACING, RADIUS = 0.002, 0.008
HELD = np.zeros((3, 3))  # an inverse mass matrix of modes that do not respond
SIZE, BALL = (0.06, 0.06, 0.03), 0.015


def flat_skin():
    x, y = np.meshgrid(SPACING * np.arange(-6, 7), SPACING * np.arange(-6, 7), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    columns = np.random.default_rng(0).standard_normal((3, len(points), 3))
    compliance = falling(points, np.arange(len(points)), [0.004], [0.01], 0.005)
    none, count = np.zeros((0, 3)), len(points)
    cloud = pt.Cloud(
        points, np.full(count, SPACING**3), none[:, 0].astype(int), none, none[:, 0], {}, none.astype(int), SPACING
    )
    return contact_surface(compliance, cloud, columns)


def falling(points, nodes, lengths, compliances, own):
    """A compliance that falls off exponentially between places, the same along all directions."""
    apart = cdist(points[nodes], points[nodes])
    between = own * np.eye(len(nodes)) + np.exp(-apart[:, :, None] / lengths) @ np.array(compliances)
    return NO_COMPLIANCE._replace(
        nodes=nodes, carriers=np.arange(len(nodes))[:, None], weights=np.ones((len(nodes), 1)),
        flexibility=np.kron(between, np.eye(3)).astype(np.float32),
        patches=np.arange(len(nodes))[:, None], shares=np.ones((len(nodes), 1)),
    )  # fmt: skip


def ball(of, friction=0.0, tools=1):
    frames = np.zeros((tools, 2, 3, 4))
    frames[:, :, :, :3] = np.eye(3)
    return RigidTools(
        np.zeros(tools, dtype=np.int64), np.tile([RADIUS, 0.0, 0.0], (tools, 1)), np.full(tools, friction),
        np.zeros((tools, 3)), frames, np.zeros(3), np.zeros(3), np.zeros((tools, 6)),
        np.zeros((len(of.nodes), 3)), rigid_tools(None, of).held, np.zeros((tools, 3, 3, 4)),
    )  # fmt: skip


def moved(tools, before, after):
    tools.frames[0, 0, :, 3], tools.frames[0, 1, :, 3] = before, after


def gaps(contact, tools):
    count = contact.numbers[0]
    return np.array(
        [gap(0, tools.sizes[t], tools.frames[t, 1], *contact.now[e]) for e, t in enumerate(contact.tool[:count])]
    )


def test_no_node_is_inside_the_tool_and_no_force_pulls():
    of = flat_skin()
    contact, tools = contact_scratch(of, 1), ball(of)
    moved(tools, (0, 0, RADIUS), (0.0005, 0, RADIUS - 0.002))
    solve_contact(of, contact, tools, np.zeros(3), np.zeros(3), 1e-3, HELD, 3)
    found, forces = gaps(contact, tools), contact.push[: contact.numbers[0]]
    assert contact.numbers[0] > 20
    assert found[:, 0].min() > -2e-3 * 0.002
    along = np.sum(forces * found[:, 1:], axis=1)
    assert along.min() >= 0
    assert along.max() > 0
    np.testing.assert_allclose(forces, along[:, None] * found[:, 1:], atol=2e-3 * along.max())  # no friction
    on = along > 1e-3 * along.max()
    np.testing.assert_allclose(found[on, 0], 0.0, atol=2e-3 * 0.002)  # where it is pushed it touches


def test_tool_forces_equal_those_on_nodes_and_coordinates():
    of = flat_skin()
    contact, tools = contact_scratch(of, 1), ball(of, friction=0.4)
    moved(tools, (0, 0, RADIUS), (0.001, 0.0004, RADIUS - 0.002))
    step = 1e-3
    work, lost = solve_contact(of, contact, tools, np.zeros(3), np.zeros(3), step, HELD, 3)
    forces, places = contact.force[0], contact.place[0]
    np.testing.assert_allclose(tools.impulses[0, :3], step * forces.sum(axis=0), rtol=1e-12)
    on = forces.any(axis=1)
    arms = places[on] - tools.frames[0, 1, :, 3]
    np.testing.assert_allclose(
        tools.impulses[0, 3:], step * np.cross(arms, forces[on]).sum(axis=0), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(tools.load, np.einsum("kcm,kc->m", of.columns, forces), rtol=1e-6)
    np.testing.assert_allclose(tools.nodal_impulses, step * forces)
    assert 0 <= lost < work


def test_a_dragged_ball_slides_at_coulombs_limit_and_sticks_below_it():
    of = flat_skin()
    contact, tools = contact_scratch(of, 1), ball(of, friction=0.3)
    place = np.array([0.0, 0.0, RADIUS])
    for way in [np.array([0, 0, -0.00025])] * 8 + [np.array([0.0002, 0, 0])] * 30:
        moved(tools, place, place + way)
        solve_contact(of, contact, tools, np.zeros(3), np.zeros(3), 1e-3, HELD, 3)
        place = place + way
        found, forces = gaps(contact, tools), contact.push[: contact.numbers[0]]
        along = np.sum(forces * found[:, 1:], axis=1)
        across = np.linalg.norm(forces - along[:, None] * found[:, 1:], axis=1)
        assert np.all(across <= 0.3 * along + 2e-3 * along.max())
    np.testing.assert_allclose(across.sum(), 0.3 * along.sum(), rtol=0.05)


def test_two_equal_tools_have_equal_forces_and_a_tool_without_contact_has_none():
    of = flat_skin()
    contact, tools = contact_scratch(of, 2), ball(of, tools=2)
    for t, x in enumerate((-0.006, 0.006)):
        tools.frames[t, :, :, 3] = (x, 0, RADIUS - 0.001)
    solve_contact(of, contact, tools, np.zeros(3), np.zeros(3), 1e-3, HELD, 3)
    np.testing.assert_allclose(tools.impulses[0, 2], tools.impulses[1, 2], rtol=2e-3)  # alike
    tools.frames[:, :, 2, 3] += 1.0
    solve_contact(of, contact, tools, np.zeros(3), np.zeros(3), 1e-3, HELD, 3)
    assert not contact.force.any()
    assert not tools.load.any()


def test_energies_of_tools_have_what_they_share_and_are_those_of_a_run():
    """Two balls near each other: half of the forces times all displacements, in the engine and in a run."""
    of = flat_skin()
    contact, tools = contact_scratch(of, 2), ball(of, tools=2)
    for t, x in enumerate((-0.006, 0.006)):
        tools.frames[t, :, :, 3] = (x, 0, RADIUS - 0.001)
    solve_contact(of, contact, tools, np.zeros(3), np.zeros(3), 1e-3, HELD, 3)
    found = [tool_energy.py_func(of, contact, t) for t in range(2)]
    expected = [
        0.5 * sum(contact.push[e] @ (contact.now[e] - contact.modal[e])
                  for e in range(contact.numbers[PAIRS]) if contact.tool[e] == t)
        for t in range(2)
    ]  # fmt: skip
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    points = np.random.default_rng(1).random((30, 3))
    compliance, pushes = falling(points, np.arange(30), [0.1, 0.4], [2.0, 3.0], 1.0), np.zeros((2, 30, 3))
    pushes[0, 7], pushes[1, 20] = (1.0, 0.0, 2.0), (0.0, -1.0, 0.5)
    moved, energies = contact_displacements(compliance, points, pushes, [False, False])
    one, alone = contact_displacements(compliance, points, pushes[:1], [False])
    np.testing.assert_allclose(energies, 0.5 * np.einsum("tkc,kc->t", pushes, moved), rtol=1e-12)
    assert energies[0] - alone[0] == pytest.approx(0.5 * pushes[0, 7] @ (moved - one)[7])
    assert energies.sum() == pytest.approx(
        contact_displacements(compliance, points, pushes.sum(axis=0)[None], [False])[1][0]
    )


@pytest.mark.quick
def test_contact_displacements_are_the_compliance_times_the_forces():
    points = np.random.default_rng(1).random((30, 3))
    compliance = falling(points, np.arange(5, 30), [0.1, 0.4], [2.0, 3.0], 1.0)
    forces = np.zeros((30, 3))
    forces[[7, 20]] = [[1.0, 0.0, 2.0], [0.0, -1.0, 0.5]]
    found, energy = contact_displacements(compliance, points, forces[None, 5:], [False])
    far = np.linalg.norm(points[7] - points[20])
    g = 2 * np.exp(-far / 0.1) + 3 * np.exp(-far / 0.4)
    np.testing.assert_allclose(found[7], 6.0 * forces[7] + g * forces[20], rtol=1e-6)
    assert not found[:5].any()
    assert energy == pytest.approx(0.5 * np.sum(found * forces))


# runs


def press(x, y, depth=0.004):
    def motion(time):
        share = np.sin(np.pi * min(time / 0.16, 1.0)) ** 2
        return x, y, SIZE[2] + BALL + 0.001 - share * (depth + 0.001)

    return [pt.tools.Contact(pt.tools.Sphere(BALL), motion)]


@pytest.fixture(scope="module")
def pressed():
    """A block, runs of presses, and a model trained on all but the last."""
    cloud = pt.box(SIZE, spacing=0.006)
    tissue = pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000, poisson=0.4)
    body = pt.Solid(cloud, tissue, "z-", form="energy", stiffness_damping=1e-4)
    places = [(0.021, 0.027), (0.039, 0.033), (0.030, 0.040), (0.024, 0.038)]
    runs = [pt.rollout(body, press(*place), duration=0.2, every=0.005) for place in places]
    model = pt.hyper_reduce(body, runs[:-1], modes=0, enrichment=pt.vibration_modes(body, 24)[0])
    return body, runs, model


def test_contact_forces_of_a_run_sum_to_the_reactions_and_are_stored(pressed, tmp_path):
    _, (run, *_), _ = pressed
    pushes = np.zeros((len(run.times), 3))
    np.add.at(pushes, run.contact_forces[:, 0].astype(int), run.contact_forces[:, 2:])
    np.testing.assert_allclose(pushes, run.reactions["tool"], atol=1e-9)
    run.save(tmp_path / "run.h5")
    np.testing.assert_array_equal(pt.Trajectory.load(tmp_path / "run.h5").contact_forces, run.contact_forces)


@pytest.mark.quick
def test_force_and_surface_of_a_press_it_was_not_trained_on(pressed):
    body, runs, model = pressed
    run = pt.rollout(model, press(0.024, 0.038), duration=0.2, every=0.005)
    mine, full = run.reactions["tool"][:, 2], runs[-1].reactions["tool"][:, 2]
    peak = np.abs(full).max()
    assert np.abs(mine - full).max() < 0.15 * peak
    on = np.abs(full) > 0.1 * peak
    assert np.median(np.abs(mine[on] / full[on] - 1)) < 0.1
    top = body.cloud.group("z+")
    missed = np.linalg.norm(run.displacements[:, top] - runs[-1].displacements[:, top], axis=2)
    assert np.quantile(missed, 0.95) < 0.07 * 0.004
    assert not run.reactions["tool"][-1].any()  # it has left
    assert np.abs(run.balance).max() < 0.05 * run.external.max()


def test_rounding_of_the_compliance_adds_little_error_to_a_press_it_was_not_trained_on(pressed, monkeypatch):
    body, runs, model = pressed
    monkeypatch.setattr("palpate.reduction.training.reduce.round_compliance", lambda compliance: compliance)
    exact = pt.hyper_reduce(body, runs[:-1], modes=0, enrichment=pt.vibration_modes(body, 24)[0])
    assert not np.array_equal(exact.data.compliance.flexibility, model.data.compliance.flexibility)
    expected, found = (pt.rollout(m, press(0.024, 0.038), duration=0.2, every=0.005) for m in (exact, model))
    force, displacements = expected.reactions["tool"], expected.displacements
    assert np.abs(found.reactions["tool"] - force).max() < 0.003 * np.abs(force).max()
    assert np.abs(found.displacements - displacements).max() < 0.008 * np.abs(displacements).max()


def test_interior_nodes_follow_the_contact_displacements(pressed):
    """Where the modes alone are half the press away, and the surface, forces and energy are what they were."""
    body, runs, model = pressed
    alone = pt.ReducedModel(replace(model.data, compliance=model.data.compliance._replace(interior=None)))
    own, bare = (pt.rollout(m, press(0.024, 0.038), duration=0.2, every=0.005) for m in (model, alone))
    within, nodes = (
        model.data.compliance.interior.nodes,
        np.setdiff1d(np.arange(len(body.cloud)), body.cloud.group("z-")),
    )
    surface = np.setdiff1d(nodes, within)
    np.testing.assert_array_equal(own.displacements[:, surface], bare.displacements[:, surface])
    np.testing.assert_array_equal(own.reactions["tool"], bare.reactions["tool"])
    np.testing.assert_array_equal(own.strain, bare.strain)
    on = np.abs(runs[-1].reactions["tool"][:, 2]) > 0.1 * np.abs(runs[-1].reactions["tool"]).max()
    mine, without = (
        np.linalg.norm(run.displacements[on][:, within] - runs[-1].displacements[on][:, within], axis=2)
        for run in (own, bare)
    )
    distance_scale = np.linalg.norm(runs[-1].displacements, axis=2).max()
    print(
        mine.max() / distance_scale,
        without.max() / distance_scale,
        mine.sum() / without.sum(),
        np.quantile(mine, 0.95) / distance_scale,
    )
    assert pt.relative_errors(runs[-1], own).displacement < pt.relative_errors(runs[-1], bare).displacement


def test_calibration_matches_the_forces_of_full_runs(pressed):
    body, runs, model = pressed
    trials = [(press(0.021, 0.027), runs[0])]
    measured = pt.hyper_reduce(body, runs[:-1], modes=0, enrichment=pt.vibration_modes(body, 24)[0], repeated=trials)
    before, *_, after = measured.report["force_ratios"]
    assert abs(np.log(after)) <= min(0.02, abs(np.log(before)))
    factor = measured.report["force_factor"]
    found, expected = measured.data.compliance.flexibility, factor * model.data.compliance.flexibility
    np.testing.assert_allclose(found, expected, atol=1.01 * MAX_STEP * np.median(np.diagonal(expected)))  # both rounded
    with pytest.raises(pt.InputError, match="must be runs with contact"):
        pt.hyper_reduce(body, runs[:1], modes=4, repeated=[([], run_without(runs[0]))])


def force_error(body_run, run) -> float:
    """Return the median error of the tool's force where it presses, relative."""
    full, mine = body_run.reactions["tool"][:, 2], run.reactions["tool"][:, 2]
    pressing = np.abs(full) > 0.1 * np.abs(full).max()
    return float(np.median(np.abs(mine[pressing] / full[pressing] - 1)))


def test_runs_with_tools_are_reduced_to_vibrations_by_default(pressed):
    body, runs, _ = pressed
    model = pt.hyper_reduce(body, runs[:-1], modes=24)
    shapes = interpolated_modes(body, body, 24)
    by_hand = pt.hyper_reduce(body, runs[:-1], modes=0, enrichment=shapes)
    np.testing.assert_array_equal(model.data.trial_and_test_basis, by_hand.data.trial_and_test_basis)
    run = pt.rollout(model, press(0.024, 0.038), duration=0.2, every=0.005)
    assert force_error(runs[-1], run) < 0.1
    with pytest.warns(pt.TrustWarning, match="use basis='vibrations'"):
        pod = pt.hyper_reduce(body, runs[:-1], modes=24, basis="pod")
    other = pt.rollout(pod, press(0.024, 0.038), duration=0.2, every=0.005)
    assert force_error(runs[-1], other) > 2 * force_error(runs[-1], run)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"basis": "modes"}, "basis must be 'pod' or 'vibrations', got 'modes'"),
        ({"basis": "vibrations", "enrichment": np.zeros((1, 396, 3))}, "basis must be 'pod' .* with enrichment"),
    ],
)
def test_a_basis_that_does_not_exist_is_refused(pressed, options, message):
    body, runs, _ = pressed
    with pytest.raises(pt.InputError, match=message):
        pt.hyper_reduce(body, runs[:-1], modes=4, **options)


def test_a_large_body_with_tools_has_a_coarse_one_made_of_its_surface(pressed, monkeypatch):
    body, runs, _ = pressed
    most = len(body.cloud) - 1
    monkeypatch.setattr("palpate.reduction.contact.coarse_body.MAX_NODES", most)
    model = pt.hyper_reduce(body, runs[:-1], modes=12)
    coarse = coarse_body(body, most=most)
    assert len(coarse.cloud) < most
    shapes = join(body, None, interpolated_modes(coarse, body, 12))
    np.testing.assert_array_equal(model.data.trial_and_test_basis[:12], shapes.astype(np.float32))
    carriers = 3 * len(np.setdiff1d(coarse.cloud.face_nodes, coarse.cloud.group("z-")))
    assert model.data.compliance.flexibility.shape == (carriers, carriers)
    assert model.report["cubature"] == 0.01
    run = pt.rollout(model, press(0.024, 0.038), duration=0.2, every=0.005)
    assert force_error(runs[-1], run) < 0.2
    open_body = pt.Solid(replace(body.cloud, triangles=body.cloud.triangles[1:]), body.material, "z-")
    with pytest.raises(pt.InputError, match="coarse must be given for tools in contact"):
        pt.hyper_reduce(open_body, runs[:-1], modes=12)


@pytest.mark.parametrize("longer", [0.0, 1e9, -1.0])
def test_training_runs_that_no_model_can_follow_are_refused(pressed, longer):
    body, runs, _ = pressed
    with pytest.raises(pt.InputError, match="runs that the model can follow"):
        pt.hyper_reduce(
            body, [replace(runs[0], times=longer * runs[0].times)], modes=0, enrichment=pt.vibration_modes(body, 24)[0]
        )


def test_without_surface_compliance_the_force_is_far_too_large(pressed):
    """What the modes alone, without the surface's compliance, make of it: a far too large force."""
    _body, runs, model = pressed
    stiff = pt.ReducedModel(replace(model.data, compliance=model.data.compliance.scaled(1e-3)))
    run = pt.rollout(stiff, press(0.024, 0.038), duration=0.2, every=0.005)
    assert np.abs(run.reactions["tool"]).max() > 1.3 * np.abs(runs[-1].reactions["tool"]).max()


def test_a_loaded_model_has_the_same_run(pressed, tmp_path):
    _, _, model = pressed
    pt.save(model, tmp_path / "block.rom")
    first, second = (
        pt.rollout(m, press(0.024, 0.038), duration=0.08, every=0.01) for m in (model, pt.load(tmp_path / "block.rom"))
    )
    np.testing.assert_array_equal(first.displacements, second.displacements)
    np.testing.assert_array_equal(first.reactions["tool"], second.reactions["tool"])


def test_invalid_contact_of_a_reduced_model_is_refused(pressed):
    body, runs, model = pressed
    with pytest.raises(pt.InputError, match="must start outside the body"):
        pt.rollout(model, [pt.tools.Contact(pt.tools.Sphere(BALL), (0.03, 0.03, SIZE[2]))], duration=0.01, every=0.01)
    with pytest.raises(pt.InputError, match="stepped explicitly"):
        pt.rollout(model.with_step(1e-3), press(0.03, 0.03), duration=0.01, every=0.01)
    bare = pt.hyper_reduce(body, [run_without(runs[0])], modes=4)
    with pytest.raises(pt.InputError, match="train it with a Contact"):
        pt.rollout(bare, press(0.03, 0.03), duration=0.01, every=0.01)
    shapes, other = pt.vibration_modes(body, 4)[0], pt.box((0.03, 0.06, 0.03), spacing=0.006)
    elsewhere = pt.Solid(other, body.material, "z-", form="energy")
    with pytest.raises(pt.InputError, match="coarse must have the bounds"):
        pt.hyper_reduce(body, runs[:1], modes=0, enrichment=shapes, coarse=elsewhere)
    held = pt.ReducedModel(replace(model.data, prescribed=("z+",)))
    with pytest.raises(pt.InputError, match="model with prescribed groups"):
        pt.rollout(held, press(0.03, 0.03), duration=0.01, every=0.01)


def run_without(run):
    return replace(run, contact_forces=np.zeros((0, 5)))


def test_the_engine_has_the_tool_force_of_a_run(pressed):
    """Periods of the compiled step of the engine and `rollout`: equal paths of a ball give equal forces."""
    _, _, model = pressed
    depth, rate, home = 0.004, 1000, (0.024, 0.038, SIZE[2] + BALL + 0.001)
    slow = pt.tools.Contact(
        pt.tools.Sphere(BALL), lambda time: (*home[:2], home[2] - (depth + 0.001) * min(time / 0.1, 1.0))
    )
    run = pt.rollout(model, [slow], duration=0.2, every=0.01)
    ready = pt.realtime_model(model, contact=pt.tools.Contact(pt.tools.Sphere(BALL), home))
    q, v, report = ready.rest.copy(), np.zeros_like(ready.rest), np.zeros(20)
    felt, moments = [], []
    for k in range(200):
        target = np.zeros(12)
        target[2] = -(depth + 0.001) * min((k + 1) / rate / 0.1, 1.0)
        ready.advance(ready.data, q, v, ready.tool @ target, 1.0 / rate, report)
        assert report[0] == 0.0
        felt.append(report[8:11].copy())
        moments.append(report[11:20].reshape(3, 3).copy())
    means = np.array(felt).reshape(20, 10, 3).mean(axis=1)
    peak = np.abs(run.reactions["tool"]).max()
    np.testing.assert_allclose(means, run.reactions["tool"][1:], atol=0.03 * peak)
    # of G on R = 1 the moment is the sum over j of R_j x G_j
    last = np.mean([np.cross(np.eye(3), g.T).sum(axis=0) for g in moments[-10:]], axis=0)
    np.testing.assert_allclose(last, run.moments["tool"][-1], atol=0.03 * peak * BALL)


def test_the_engine_turns_a_tool_from_its_pose_at_the_start(pressed):
    """A capsule that lies across the block and is turned further, in periods of the engine and in `rollout`."""
    _, _, model = pressed
    shape, above = pt.tools.Capsule(0.008, 0.03), SIZE[2] + 0.009
    lying = Rotation.from_euler("y", 90, degrees=True)
    down = lambda time: -0.004 * min(time / 0.1, 1.0)  # noqa: E731
    turn = lambda time: Rotation.from_rotvec([0.0, 0.0, 0.6 * min(time / 0.1, 1.0)])  # noqa: E731

    def motion(time):
        return (0.024, 0.038, above + down(time)), (turn(time) * lying).as_quat(scalar_first=True)

    run = pt.rollout(model, [pt.tools.Contact(shape, motion)], duration=0.2, every=0.01)
    ready = pt.realtime_model(model, contact=pt.tools.Contact(shape, motion))
    q, v, report, felt = ready.rest.copy(), np.zeros_like(ready.rest), np.zeros(20), []
    for k in range(200):
        time = (k + 1) / 1000
        target = np.concatenate([(0.0, 0.0, down(time)), (turn(time).as_matrix() - np.eye(3)).ravel()])
        ready.advance(ready.data, q, v, ready.tool @ target, 1e-3, report)
        assert report[0] == 0.0
        felt.append(report[8:11].copy())
    means = np.array(felt).reshape(20, 10, 3).mean(axis=1)
    peak = np.abs(run.reactions["tool"]).max()
    assert peak > 0.1
    np.testing.assert_allclose(means, run.reactions["tool"][1:], atol=0.05 * peak)


@pytest.mark.xfail(
    reason="contact of a model of one press misses 0.1 to 7 of the tool's work on filled and jittered clouds, and on "
    "lattices since their patches are as narrow"
)
def test_a_stiffening_surface_produces_no_energy():
    """A model of one press, whose surface stiffens fifty times: its force must not lag behind its depth."""
    tissue = pt.materials.MooneyRivlin(C1=1e3, C2=0.0, density=1000.0, poisson=0.45)
    body = pt.Solid(pt.box((0.06, 0.06, 0.03), spacing=0.006), tissue, "z-", form="energy", stiffness_damping=1e-4)
    height = lambda time: 0.046 - 0.006 * np.sin(np.pi * min(time / 0.1, 1.0))  # noqa: E731
    press = [pt.tools.Contact(pt.tools.Sphere(0.015), lambda time: (0.03, 0.03, height(time)))]
    run = pt.rollout(body, press, duration=0.1, every=0.005)
    model = pt.hyper_reduce(body, [run], modes=8, basis="pod")
    assert model.data.compliance.stiffening[0] > 0.5
    for step in (2.5e-4, 1e-4, 5e-5):
        own = pt.rollout(model, press, duration=0.1, every=0.001, step=step)
        assert np.abs(own.balance).max() < 0.1 * own.external.max()
        assert np.abs(own.displacements).max() < 0.006


def grasped(lift=0.003, until=np.inf):
    """Forceps that lift and turn a place of the top."""

    def motion(time):
        share = np.sin(np.pi / 2 * min(time / 0.08, 1.0)) ** 2
        return (0.024, 0.038, SIZE[2] + share * lift), (0.0, 0.0, 0.3 * share)

    return [pt.tools.Grasp((0.024, 0.038, SIZE[2]), 0.010, motion, until=until)]


def test_a_grasp_at_any_point_agrees_with_the_full_model(pressed):
    body, _, model = pressed
    full, own = (pt.rollout(m, grasped(), duration=0.2, every=0.01) for m in (body, model))
    late = full.times > 0.05
    theirs, mine = full.reactions["grasp"][late, 2], own.reactions["grasp"][late, 2]
    assert theirs.min() > 0
    np.testing.assert_allclose(mine, theirs, rtol=0.15)
    held = grasped()[0].with_group(body.cloud).group("grasp")
    wanted = grasped()[0].displacement(body.cloud.points[held], 0.2)
    np.testing.assert_allclose(own.displacements[-1, held], wanted, atol=1e-2 * 0.003)
    top = body.cloud.group("z+")
    missed = np.linalg.norm(own.displacements - full.displacements, axis=2)[late][:, top]
    assert np.quantile(missed, 0.95) < 0.07 * 0.003


def test_a_grasp_is_released_and_acts_together_with_a_ball(pressed):
    _, _, model = pressed
    loads = [*grasped(until=0.1), replace(press(0.042, 0.02)[0], name="ball")]
    run = pt.rollout(model, loads, duration=0.2, every=0.01)
    after = run.times > 0.115
    assert not run.reactions["grasp"][after].any()
    assert run.reactions["grasp"][run.times < 0.095][-1, 2] > 0
    assert run.reactions["ball"][:, 2].min() < 0
    pushes = np.zeros((len(run.times), 3))
    np.add.at(pushes, run.contact_forces[:, 0].astype(int), run.contact_forces[:, 2:5])
    np.testing.assert_allclose(pushes, run.reactions["grasp"] + run.reactions["ball"], atol=1e-9)


@pytest.mark.quick
def test_a_grasp_of_fixed_nodes_or_of_no_nodes_is_refused(pressed):
    _, _, model = pressed
    with pytest.raises(pt.InputError, match="fixed nodes within"):
        pt.rollout(model, [pt.tools.Grasp((0.0, 0.0, 0.0), 0.01, (0.0, 0.0, 0.0))], duration=0.01, every=0.01)
    with pytest.raises(pt.InputError, match="groups of the body, got 'z\\+'"):
        pt.rollout(model, [replace(grasped()[0], name="z+")], duration=0.01, every=0.01)
    with pytest.raises(pt.InputError, match=r"must hold a node|must reach a node"):
        pt.rollout(model, [pt.tools.Grasp((0.03, 0.03, 0.05), 0.001, (0.03, 0.03, 0.05))], duration=0.01, every=0.01)


def test_two_tools_of_the_engine_are_those_of_a_run(pressed):
    _, _, model = pressed
    homes = [np.array([x, 0.03, SIZE[2] + BALL + 0.001]) for x in (0.014, 0.046)]
    depths = (0.004, 0.003)

    def way(t, depth):
        return np.array([0.0, 0.0, -depth * min(t / 0.1, 1.0)])

    def tools(moving):
        return [
            pt.tools.Contact(
                pt.tools.Sphere(BALL), (lambda t, h=home, d=depth: h + way(t, d)) if moving else home, name=f"{home[0]}"
            )
            for home, depth in zip(homes, depths, strict=True)
        ]

    run = pt.rollout(model, tools(True), duration=0.12, every=0.005, progress=False)
    ready = pt.realtime_model(model, contact=tools(False))
    q, v, report, target = ready.rest.copy(), np.zeros_like(ready.rest), np.zeros(32), np.zeros(24)
    forces = []
    for k in range(120):
        for t, depth in enumerate(depths):
            target[12 * t : 12 * t + 3] = way(1e-3 * (k + 1), depth)
        ready.advance(ready.data, q, v, target, 1e-3, report)
        forces.append(report[8:].reshape(2, 12)[:, :3].copy())
    for t, home in enumerate(homes):
        means, pushed = np.reshape(forces, (24, 5, 2, 3)).mean(axis=1)[:, t], run.reactions[f"{home[0]}"][1:]
        assert np.abs(pushed).max() > 0.05
        np.testing.assert_allclose(means, pushed, atol=0.03 * np.abs(pushed).max())


def test_an_engine_presses_and_releases(pressed):
    _, _, model = pressed
    home = (0.03, 0.03, SIZE[2] + BALL + 0.001)
    with pt.Engine(
        pt.realtime_model(model, contact=pt.tools.Contact(pt.tools.Sphere(BALL), home)), out_of_training="warn"
    ) as engine:
        engine.set_pose((0.0, 0.0, -0.004))
        import time
        import warnings

        def waited(what):
            for _ in range(300):
                time.sleep(0.02)
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    force = engine.read().force
                if what(force):
                    return force
            return force

        assert waited(lambda force: force[2] > 0.01)[2] > 0.01  # the body pushes the tool up
        engine.set_pose((0.0, 0.0, 0.001))
        assert np.abs(waited(lambda force: not np.abs(force).any())).max() == 0.0
