"""What a run refuses, how it stops, and what it leaves."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
import palpate.dynamics.run.rollout as rollout_module
from palpate.dynamics.run.model import Model

PULL = pt.SurfaceForce("x+", force=(1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"duration": 0.0}, "duration must be .*, got 0.0"),
        ({"duration": np.inf}, "duration must be .*, got inf"),
        ({"every": 0.0}, "every must be .*, got 0.0"),
        ({"every": 2e-3}, r"every must be in \(0, 0.001\] s, got 0.002"),
        ({"every": np.nan}, "every must be .*, got nan"),
        ({"step": 0.0}, "step must be .*, got 0.0"),
        ({"step": 1e-3}, "step must be .*, got 0.001"),
        ({"step": -1e-5}, "step must be .*, got -1e-05"),
        ({"displacement": np.zeros((5, 3))}, r"initial displacement must have shape \(112, 3\), got \(5, 3\)"),
        ({"velocity": np.full((112, 3), np.nan)}, "initial velocity must be finite"),
    ],
)
def test_arguments_out_of_range_are_refused_by_name(held, arguments, message):
    with pytest.raises(pt.InputError, match=message):
        pt.rollout(held, [PULL], **({"duration": 1e-3, "every": 5e-4} | arguments))


def test_a_refused_run_leaves_no_file(held, tmp_path):
    for arguments in ({"every": 2.0}, {"displacement": np.zeros(3)}):
        with pytest.raises(pt.InputError):
            pt.rollout(held, [PULL], **({"duration": 1e-3, "every": 5e-4} | arguments), file=tmp_path / "run.h5")
    assert list(tmp_path.iterdir()) == []


def test_an_error_of_a_persons_load_keeps_its_type(held):
    broken = pt.SurfaceForce("x+", force=lambda t: (1.0 / (t - t), 0.0, 0.0) if t > 5e-4 else (0.0, 0.0, 0.0))
    with pytest.raises(ZeroDivisionError):
        pt.rollout(held, [broken], duration=1e-3, every=5e-4)


def test_equations_without_a_solution_end_a_run_as_a_divergence(held, monkeypatch):
    def singular(*_):
        return np.linalg.inv(np.zeros((2, 2)))

    monkeypatch.setattr(type(held), "advance", singular)
    with pytest.raises(pt.DivergenceError, match="no solution"):
        pt.rollout(held, [PULL], duration=1e-3, every=5e-4)


def test_snapshots_are_at_the_requested_times(run):
    np.testing.assert_allclose(run.times, np.arange(61) * 0.0005, rtol=1e-12, atol=1e-15)
    assert run.displacements.shape == run.velocities.shape == (61, 112, 3)
    assert run.reactions["x-"].shape == (61, 3)
    assert np.all(np.diff(run.steps) > 0)
    assert run.complete
    assert run.model == "full"
    assert run.wall_seconds > 0


def test_a_fixed_step_is_used(held):
    run = pt.rollout(held, [PULL], duration=1e-3, every=5e-4, step=1e-5)
    np.testing.assert_array_equal(run.steps, [0, 50, 100])


@pytest.mark.slow
def test_halving_the_step_changes_little(held, pull):
    ends = [pt.rollout(held, [pull], duration=0.005, every=0.005, step=h).displacements[-1] for h in (4e-5, 2e-5, 1e-5)]
    assert np.abs(ends[1] - ends[2]).max() < 0.6 * np.abs(ends[0] - ends[1]).max()
    np.testing.assert_allclose(ends[1], ends[2], atol=5e-3 * np.abs(ends[2]).max())


def test_a_divergence_names_time_node_step_and_damping_and_keeps_the_frames(held, tmp_path):
    path = tmp_path / "run.h5"
    strong = pt.SurfaceForce("x+", force=lambda t: (1.0, 0, 0) if t < 2e-3 else (5e4, 0, 0))
    with pytest.raises(pt.DivergenceError) as caught, np.errstate(all="ignore"):
        pt.rollout(held, [strong], duration=0.05, every=1e-3, step=5e-5, file=path)
    assert str(caught.value).startswith("SurfaceForce on 'x+' is too large for the tissue with 5e+04 N; the state")
    for word in ("t = ", "node ", "step 5e-05 s", f"stiffness damping {held.stiffness_damping:.3g} s", "smaller load"):
        assert word in str(caught.value)
    assert "more damping" not in str(caught.value)
    partial = caught.value.trajectory
    assert 2 < len(partial.times) < 50
    assert not partial.complete
    assert np.isfinite(partial.displacements).all()
    saved = pt.Trajectory.load(path)
    np.testing.assert_array_equal(saved.displacements, partial.displacements)
    assert not saved.complete


def test_a_step_far_too_long_diverges(held):
    with (
        pytest.raises(pt.DivergenceError, match=r"step must be at most .* s, the stable one .*, got 0\.0005 s; omit"),
        np.errstate(all="ignore"),
    ):
        pt.rollout(held, [PULL], duration=0.1, every=5e-4, step=5e-4)


def test_a_run_of_a_diverging_body_is_stopped(free):
    apart = 1e4 * np.random.default_rng(0).standard_normal((64, 3))
    with pytest.raises(pt.DivergenceError) as caught:
        pt.rollout(free, velocity=apart, duration=0.01, every=0.005)
    assert "The body is free: no support holds it" in str(caught.value)
    assert "Start from" in str(caught.value)


@pytest.mark.filterwarnings("ignore")
def test_a_body_turned_inside_out_is_stopped(held):
    u = np.zeros((112, 3))
    u[:, 0] = -1.5 * held.cloud.points[:, 0]
    with pytest.raises(pt.DivergenceError, match="inside out"):
        pt.rollout(held, displacement=u, duration=1e-6, every=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [6e-3, 4e-3])
def test_a_plane_that_crushes_a_block_ends_the_run_while_its_force_still_rises(spacing):
    tissue = pt.materials.MooneyRivlin(C1=2.2e3, C2=0, density=1060, poisson=0.45)
    block = pt.Solid(pt.box((0.03, 0.03, 0.024), spacing), tissue, fixed="z-", mass_damping=8)
    down = pt.tools.Contact(pt.tools.Plane(), lambda t: ((0.015, 0.015, 0.025 - 0.1 * min(t, 0.2)), (np.pi, 0, 0)))
    with pytest.raises(pt.DivergenceError, match="of the cells between nodes are turned inside out") as error:
        pt.rollout(block, [down], duration=0.4, every=0.01, progress=False)
    force = -error.value.trajectory.reactions["tool"][1:, 2]
    assert np.all(np.diff(force) > 0)
    assert force[-1] == pytest.approx(6.4, rel=0.05)  # at both spacings, at 54 % of the height


@pytest.fixture(scope="module")
def crushed():
    """A block pushed in by 85 % of its height and let go: J falls below 0.1, and snaps back."""
    cloud = pt.box((0.02,) * 3, 0.02 / 6, jitter=0.2, seed=1).within("tool", (0.01, 0.01, 0.02), 0.0053, margin=0.0)
    model = pt.Solid(cloud, pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45), "z-", form="energy")
    poke = pt.PrescribedMotion("tool", lambda points, t: (0.0, 0.0, -0.017 * min(1.0, t / 0.05)), until=0.1)
    return model, [poke]


@pytest.mark.slow
def test_steps_are_shortened_as_crushed_tissue_is_released(crushed, monkeypatch):
    model, poke = crushed
    monkeypatch.setattr(rollout_module, "MAX_INVERTED", 1.0)  # cells under the poke are turned
    run = pt.rollout(model, poke, duration=0.2, every=0.01, progress=False)
    assert run.complete
    energy = run.kinetic + run.strain
    assert np.all(np.diff(energy[run.times > 0.105]) < 0)
    assert np.abs(run.balance).max() < 0.02 * np.abs(run.external).max()
    again = pt.rollout(model, poke, duration=0.2, every=0.01, progress=False)
    np.testing.assert_array_equal(again.steps, run.steps)  # whatever ran before
    # steps that are believed whatever comes of them end it
    monkeypatch.setattr(type(model), "accept_step", Model.accept_step)
    with pytest.raises(pt.DivergenceError):
        pt.rollout(model, poke, duration=0.2, every=0.01, progress=False)


@pytest.mark.slow
def test_steps_of_a_given_length_are_not_shortened(crushed):
    model, poke = crushed
    with pytest.raises(pt.DivergenceError):
        pt.rollout(model, poke, duration=0.2, every=0.01, step=model.stability.step, progress=False)


def test_divergence_comes_without_a_warning(held):
    u = np.zeros((112, 3))
    u[:, 0] = -1.5 * held.cloud.points[:, 0]
    with pytest.raises(pt.DivergenceError):
        pt.rollout(held, displacement=u, duration=1e-6, every=1e-6)


def test_an_interrupted_run_keeps_its_frames(held, tmp_path):
    path = tmp_path / "run.h5"

    def force(t):
        if t > 3e-3:
            raise KeyboardInterrupt
        return (1.0, 0.0, 0.0)

    with pytest.raises(KeyboardInterrupt):
        pt.rollout(held, [pt.SurfaceForce("x+", force=force)], duration=0.01, every=5e-4, file=path)
    partial = pt.Trajectory.load(path)
    assert not partial.complete
    assert 5 <= len(partial.times) <= 7
    whole = pt.rollout(held, [PULL], duration=partial.times[-1], every=5e-4)
    np.testing.assert_allclose(partial.displacements[-1], whole.displacements[-1], atol=1e-12)


def test_a_streamed_run_equals_the_returned_run(held, tmp_path):
    path = tmp_path / "run.h5"
    returned = pt.rollout(held, [PULL], duration=2e-3, every=5e-4, file=path)
    read = pt.Trajectory.load(path)
    assert read.complete
    for name in (
        "times",
        "displacements",
        "velocities",
        "kinetic",
        "strain",
        "external",
        "dissipated",
        "steps",
        "points",
    ):
        np.testing.assert_array_equal(getattr(read, name), getattr(returned, name))
    np.testing.assert_array_equal(read.reactions["x-"], returned.reactions["x-"])


@pytest.mark.parametrize("variable", [None, "FORCE_COLOR"])  # notebooks and build servers set it
def test_no_progress_bar_is_shown_without_a_terminal(held, capfd, monkeypatch, variable):
    if variable:
        monkeypatch.setenv(variable, "1")
    pt.rollout(held, [PULL], duration=1e-3, every=5e-4)
    out, err = capfd.readouterr()
    assert out == ""
    assert err.strip() == ""


def test_progress_is_called_at_every_snapshot(held):
    told = []
    run = pt.rollout(
        held, [PULL], duration=1e-3, every=2.5e-4, start=0.1, progress=lambda *reached: told.append(reached)
    )
    times, walls = zip(*told, strict=True)
    np.testing.assert_allclose(times, run.times[1:] - 0.1, atol=1e-12)
    assert 0 < walls[0] < walls[-1] <= run.wall_seconds


def test_short_intervals_between_snapshots_need_no_shorter_steps(held):
    """Steps are at most a twentieth of 5 ms, and need not be below 0.1 ms; both resolve the motion of a load."""
    pull = [pt.SurfaceForce("x+", force=lambda time: (np.sin(np.pi * time / 0.02) ** 2, 0.0, 0.0))]
    model = pt.galerkin(held, pt.rollout(held, pull, duration=0.02, every=0.001), modes=2)
    sparse, dense = (pt.rollout(model, pull, duration=0.02, every=every) for every in (0.005, 0.001))
    assert sparse.steps[-1] == 80
    assert dense.steps[-1] == 200
    fine = pt.rollout(model, pull, duration=0.02, every=0.001, step=1e-5)
    np.testing.assert_allclose(dense.displacements, fine.displacements, atol=0.01 * np.abs(fine.displacements).max())
