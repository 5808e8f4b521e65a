"""The command ``run beam``: once with the full and a reduced model, and in real time against a moving hand."""

from __future__ import annotations

import importlib.util
import json
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.common.console import Console
from palpate.app.common.report import REPORTS
from palpate.app.models.trained import model_file, trained_model
from palpate.app.run.realtime import FILES
from palpate.reduction.hyper.error_indicator import expected_error
from palpate.scenes.beam import MAX_SPACING, beam
from palpate.scenes.open_scene import open_scene

RUN = ["run", "beam"]
REALTIME = [*RUN, "--realtime", "--seconds", "0.5", "--rate", "200"]


def emulated_hand():
    """Return the module with an emulated service and its devices."""
    path = Path(__file__).parents[3] / "validation" / "emulated_hand.py"
    spec = importlib.util.spec_from_file_location("emulated_hand", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SHORT = {"paths": 2, "held_out": 1, "training.duration": 0.04, "training.every": 0.002}
SET = ["--set", *(f"{name}={value}" for name, value in SHORT.items())]


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """An empty cache."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.app.train.scene_folder.cache_folder", lambda: folder / "palpate")
        patch.setattr("palpate.app.models.trained.MAX_WORKERS", 1)
        yield folder


@pytest.fixture(scope="module")
def grasped(cache):
    """A beam whose end a tool holds, reduced."""
    return trained_model(open_scene("beam", SHORT | {"modes": 6}), Console())


@pytest.fixture(scope="module")
def file(grasped, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "beam.rom"
    pt.save(grasped, path)
    return path


@pytest.mark.slow
def test_a_trained_model_moves_the_prescribed_end_with_the_hand(grasped):
    hand = open_scene("beam").held_motion(9, 0.04)
    loads = [hand.load(grasped.cloud, "x+")]
    run = pt.rollout(grasped, loads, duration=0.02, every=0.005)
    nodes = grasped.cloud.group("x+")
    displacement = loads[0].displacement
    assert callable(displacement)
    expected = displacement(grasped.cloud.points[nodes], 0.02)
    np.testing.assert_allclose(run.displacements[-1, nodes], expected, atol=1e-6)
    assert np.abs(expected).max() > 1e-3


@pytest.mark.quick(modes=[4])
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
        stored = pt.Trajectory.load(tmp_path / f"{name}.h5")
        assert len(stored.times) == 6
        assert run["largest_displacement"] == pytest.approx(np.linalg.norm(stored.displacements, axis=2).max())
        assert run["real_time_factor"] == pytest.approx(0.05 / run["wall_seconds"])
        assert run["energy_balance"] < 0.05
    if modes is not None:
        assert report["errors"]["displacement"] < 0.05
        assert report["model"]["modes"] == modes


@pytest.fixture(scope="module")
def realtime(file, tmp_path_factory):
    """A run in real time of the model from the file: its folder and report."""
    out = tmp_path_factory.mktemp("realtime") / "results"
    assert main([*REALTIME, "--model", str(file), "--out", str(out)]) == 0
    return out, json.loads((out / "report.json").read_text())


@pytest.mark.slow
def test_the_report_has_the_statistics_of_a_hand(file, tmp_path, capsys):
    service = emulated_hand().Service("R001")
    try:
        options = ["--seconds", "2.5", "--model", str(file), "--device", f"haply:{service.port}"]
        assert main([*REALTIME, *options, "--out", str(tmp_path)]) == 0
    finally:
        service.close()
    said = capsys.readouterr()
    assert "haply: R001 moves tool 1" in said.err
    assert "largest force on tool 1" in said.out
    report = json.loads((tmp_path / "report.json").read_text())
    (hand,) = report["hands"].values()
    assert list(report["hands"]) == ["tool 1"]
    assert hand["device"] == "R001"
    assert 0.5 * hand["seconds"] <= hand["with_force"] + sum(hand["without_force"].values()) <= 1.001 * hand["seconds"]
    assert hand["messages"] <= len(service.devices[0].log) + 1
    assert hand["rate"] == pytest.approx(hand["messages"] / hand["seconds"])
    assert "messages of the service" in said.out


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
    assert (
        tool["expected_error"].keys()
        == curves.keys() - {"level", "least_level", "forgetting"}
        == {"displacement", "force"}
    )
    for of, found in tool["expected_error"].items():
        expected = expected_error(report["model"], float(trust.max()), of)
        assert [found[name] or np.inf for name in expected._fields] == pytest.approx(list(expected))
    assert 0 < tool["largest_displacement"] < 0.1
    assert tool["nodes_error"] is None  # no study has held groups
    assert re.search(
        r"error of the nodes, typical, not in the bound of the force\W+not known", (out / "report.md").read_text()
    )


@pytest.mark.slow
def test_a_model_of_another_size_stays_unless_a_size_is_asked_for(grasped, capsys):
    scene = open_scene("beam", {name: value for name, value in SHORT.items() if name.startswith("training.")})
    before = model_file(scene).read_bytes()
    assert trained_model(scene, Console()).report["modes"] == 6
    assert model_file(scene).read_bytes() == before
    printed = " ".join(capsys.readouterr().err.split())
    assert f"has 6 modes, not {scene.description.training.modes} and 2 paths, not " in printed
    assert "palpate train beam trains it again" in printed


@pytest.mark.slow
def test_a_model_is_trained_where_none_is_given_and_the_status_is_printed(grasped, tmp_path, capsys):
    runs = {file: file.stat().st_mtime_ns for file in model_file(open_scene("beam", SHORT)).parent.glob("runs/*.h5")}
    assert main([*REALTIME, *SET, "--modes", "5", "--out", str(tmp_path)]) == 0
    assert runs == {file: file.stat().st_mtime_ns for file in runs}  # the same runs serve another number of modes
    assert len(runs) == 3
    said = capsys.readouterr()
    assert "on paths not trained on" in " ".join(said.err.split())
    for part in ("Computation: ", "Scheduler: ", "Status: 200 Hz", "error indicator"):
        assert part in said.out
    assert json.loads((tmp_path / "report.json").read_text())["model"]["modes"] == 5


@pytest.mark.slow
def test_a_diverged_state_is_reported(file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("palpate.realtime.engine.Engine.state", property(lambda engine: "diverged"))
    assert main([*REALTIME, "--model", str(file), "--out", str(tmp_path)]) == 1
    assert "the state diverged" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--seconds", "3"], ["--seconds", "3", "--realtime"]),
        (["--rate", "3"], ["--rate", "3", "--realtime"]),
        (["--model", __file__], ["--model", "--realtime"]),
        (["--modes", "101"], ["--modes", "an integer in [1, 100]"]),
        (["--spacing", "0"], ["--spacing", "m, got '0'"]),
        (["--load", "-1"], ["--load"]),
        (["--spacing", "0.01"], ["--spacing", "0.00666667] m"]),
        (["--realtime", "--load", "3"], ["--load must be left out", "tool"]),
        (["--realtime", "--seconds", "0"], ["--seconds", "600] s"]),
        (["--realtime", "--rate", "1e5"], ["--rate", "20000] Hz"]),
        (["--realtime", "--modes", "1001"], ["--modes", "[1, 1000]"]),
        (["--realtime", "--spacing", "0.1"], ["--spacing"]),
        (["--realtime", "--model", "nowhere.rom"], ["--model must be an existing file", "nowhere.rom"]),
        (["--realtime", "--model", __file__], [Path(__file__).name, "must end in .rom"]),
        (["--realtime", "--model", __file__, "--modes", "3"], ["--modes must be left out with --model"]),
    ],
)
def test_bad_options_are_refused_in_one_line_and_no_file_is_left(tmp_path, assert_refused, options, parts):
    assert_refused([*RUN, *options, "--out", str(tmp_path / "out")], *parts)
    assert not (tmp_path / "out").exists()
