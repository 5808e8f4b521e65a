"""The command ``run beam``: once with the full and a reduced model, and in real time against a moving hand."""

from __future__ import annotations

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.common.report import REPORTS
from palpate.app.models.quick_training import train
from palpate.app.run.realtime import FILES
from palpate.reduction.hyper.error_indicator import expected_error
from palpate.scenes.beam import MAX_SPACING, beam
from palpate.scenes.grasp import GROUP, Hand, grasped_beam

RUN = ["run", "beam"]
REALTIME = [*RUN, "--realtime", "--seconds", "0.5", "--rate", "200"]


@pytest.fixture(scope="module")
def short():
    """Let training take few short runs."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "run.grasp.RUN_SECONDS": 0.04,
            "run.grasp.EVERY": 0.002,
            "models.quick_training.TRAINING": 2,
            "models.quick_training.HELD_OUT": 1,
        }.items():
            patch.setattr(f"palpate.app.{name}", value)
        yield


@pytest.fixture(scope="module")
def grasped(short):
    """A beam whose end a tool holds, reduced."""
    return train(grasped_beam(lasting=0.04, every=0.002), 6)


@pytest.fixture(scope="module")
def file(grasped, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "beam.rom"
    pt.save(grasped, path)
    return path


def test_the_path_of_the_hand_is_smooth_and_starts_and_ends_at_rest():
    hand = Hand(3, 0.4)
    for time in (0.0, 0.4, 0.8):
        moved, quaternion = hand(time)
        np.testing.assert_allclose(moved, 0.0, atol=1e-15)
        np.testing.assert_allclose(np.abs(quaternion), [1, 0, 0, 0], atol=1e-15)
    near = np.array([hand(1e-4)[0], hand(2e-4)[0]])
    np.testing.assert_allclose(near[1], 4 * near[0], rtol=1e-4)  # its speed is zero there
    assert np.linalg.norm(hand(0.13)[0]) > 1e-3


def test_the_load_of_the_hand_is_the_rigid_motion_of_its_pose(bar):
    hand, nodes = Hand(5, 0.4), bar.group(GROUP)
    points, centre = bar.points[nodes], bar.points[nodes].mean(axis=0)
    displacement = hand.load(bar).displacement
    assert callable(displacement)
    placed = points + displacement(points, 0.17)
    moved, (w, *v) = hand(0.17)
    arms = points - centre
    turned = arms + 2 * np.cross(v, np.cross(v, arms) + w * arms)
    np.testing.assert_allclose(placed, centre + moved + turned, atol=1e-12)


def test_a_trained_model_moves_the_prescribed_end_with_the_hand(grasped):
    hand = Hand(9, 0.04)
    loads = [hand.load(grasped.cloud)]
    run = pt.rollout(grasped, loads, duration=0.02, every=0.005)
    nodes = grasped.cloud.group(GROUP)
    displacement = loads[0].displacement
    assert callable(displacement)
    expected = displacement(grasped.cloud.points[nodes], 0.02)
    np.testing.assert_allclose(run.displacements[-1, nodes], expected, atol=1e-6)
    assert np.abs(expected).max() > 1e-3


@pytest.mark.parametrize("modes", [None, 4])
def test_a_run_writes_trajectories_and_a_report(tmp_path, capsys, monkeypatch, modes):
    monkeypatch.setattr("palpate.app.run.command.beam", lambda **given: replace(beam(**given), duration=0.05))
    (tmp_path / "reduced.h5").write_text("of an earlier run")
    options = [] if modes is None else ["--modes", str(modes)]
    done = main([*RUN, "--spacing", str(MAX_SPACING), "--load", "5", *options, "--json", "--out", str(tmp_path)])
    assert done == 0
    report = json.loads(capsys.readouterr().out)
    assert report == json.loads((tmp_path / "report.json").read_text())
    names = ["full"] if modes is None else ["full", "reduced"]
    assert {path.name for path in tmp_path.iterdir()} == {*REPORTS, *(f"{name}.h5" for name in names)}
    assert report["form"] == ("strong" if modes is None else "energy")
    assert list(report["runs"]) == names
    for name, run in report["runs"].items():
        kept = pt.Trajectory.load(tmp_path / f"{name}.h5")
        assert len(kept.times) == 6
        assert run["largest_displacement"] == pytest.approx(np.linalg.norm(kept.displacements, axis=2).max())
        assert run["real_time_factor"] == pytest.approx(0.05 / run["wall_seconds"])
        assert run["energy_balance"] < 0.05
    if modes is not None:
        assert report["errors"]["displacement"] < 0.05
        assert report["model"]["modes"] == modes


@pytest.fixture(scope="module")
def realtime(short, file, tmp_path_factory):
    """A run in real time of the model from the file: its folder and report."""
    out = tmp_path_factory.mktemp("realtime") / "results"
    assert main([*REALTIME, "--model", str(file), "--out", str(out)]) == 0
    return out, json.loads((out / "report.json").read_text())


@pytest.mark.slow
def test_histograms_count_every_period(realtime):
    out, report = realtime
    assert {path.name for path in out.iterdir()} == set(FILES)
    timing = report["timing"]
    assert timing["period"] == pytest.approx(0.005)
    assert timing["periods"] + timing["dropped"] >= 90  # the tool moves for 100 periods
    assert timing["missed_by_computing"] <= timing["missed"] <= timing["periods"]
    for kind in ("computing", "lateness"):
        times = timing[kind]
        histogram = times["histogram"]
        assert sum(histogram["counts"]) == timing["periods"]
        assert len(histogram["edges"]) == len(histogram["counts"]) + 1
        percentiles = list(times["percentiles"].values())
        assert percentiles == sorted(percentiles)
        assert percentiles[-1] <= times["maximum"]


@pytest.mark.slow
def test_the_reported_force_and_trust_are_those_of_all_periods(realtime):
    out, report = realtime
    tool = report["tool"]
    with h5py.File(out / "black_box.h5") as file:
        force, trust = file["force"][:], file["trust"][:]
    assert len(force) == min(report["timing"]["periods"], 100)
    assert tool["largest_force"] == pytest.approx(np.linalg.norm(force, axis=1).max())
    assert tool["largest_force"] > 0
    assert tool["untrained_share"] == pytest.approx(np.mean(trust > 1))
    curves = report["model"]["held_out"]["expected_error"]
    assert tool["expected_error"].keys() == curves.keys() - {"level"} == {"displacement", "force"}
    for of, found in tool["expected_error"].items():
        expected = expected_error(report["model"], float(trust.max()), of)
        assert [found[name] or np.inf for name in ("median", "bound", "level")] == pytest.approx(list(expected))
    assert 0 < tool["largest_displacement"] < 0.1


@pytest.mark.slow
def test_a_model_is_trained_where_none_is_given_and_the_verdict_is_printed(short, tmp_path, capsys):
    assert main([*REALTIME, "--modes", "5", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "on motions not trained on" in " ".join(said.err.split())
    for part in ("Computation: ", "Scheduler: ", "Verdict: 200 Hz", "trust number"):
        assert part in said.out
    assert json.loads((tmp_path / "report.json").read_text())["model"]["modes"] == 5


@pytest.mark.slow
def test_a_diverged_state_is_reported(short, file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("palpate.app.run.realtime.Engine.state", property(lambda engine: "diverged"))
    assert main([*REALTIME, "--model", str(file), "--out", str(tmp_path)]) == 1
    assert "the state diverged" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--seconds", "3"], ["--seconds", "3", "--realtime"]),
        (["--rate", "3"], ["--rate", "3", "--realtime"]),
        (["--model", __file__], ["--model", "--realtime"]),
        (["--modes", "0"], ["--modes", "an integer in [1, 100]"]),
        (["--spacing", "0.01"], ["--spacing", "0.00666667] m"]),
        (["--realtime", "--load", "3"], ["--load must be left out", "tool"]),
        (["--realtime", "--seconds", "0"], ["--seconds", "600] s"]),
        (["--realtime", "--rate", "1e5"], ["--rate", "20000] Hz"]),
        (["--realtime", "--modes", "97"], ["--modes", "an integer in [1, 96]"]),
        (["--realtime", "--spacing", "0.1"], ["--spacing"]),
        (["--realtime", "--model", "nowhere.rom"], ["--model must be an existing file", "nowhere.rom"]),
        (["--realtime", "--model", __file__], [__file__, "not a palpate reduced model"]),
        (["--realtime", "--model", __file__, "--modes", "3"], ["--modes must be left out with --model"]),
    ],
)
def test_bad_options_are_refused_in_one_line_and_no_file_is_left(tmp_path, assert_refused, options, parts):
    assert_refused([*RUN, *options, "--out", str(tmp_path / "out")], *parts)
    assert not (tmp_path / "out").exists()
