"""The liver by the command line: trained on presses of a ball, and pressed in real time, with a cache or a file."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.models import trained as trained_models
from palpate.app.run import tool_motion
from palpate.app.train import scene_folder
from palpate.reduction.training.errors import contact_errors
from palpate.scenes.open_scene import open_scene
from palpate.scenes.training import open_training

pytestmark = pytest.mark.slow

COARSE = {"spacing": 0.012, "radius": 0.03, "depth": 0.012, "cubature": 0.05}
SMALL = COARSE | {"paths": 4, "held_out": 1, "modes": 8}
REALTIME = ["run", "liver", "--realtime", "--seconds", "0.5", "--rate", "200"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a campaign on a very coarse liver."""
    folder = tmp_path_factory.mktemp("campaign") / "liver"
    settings = [f"{name}={value}" for name, value in COARSE.items()]
    sizes = ["--paths", "4", "--held-out", "1", "--modes", "8", "--cubature", "0.05"]
    assert main(["train", "liver", "--set", *settings, *sizes, "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def swift(monkeypatch):
    """Let a press take half a second."""
    monkeypatch.setattr(tool_motion, "PRESS_SECONDS", 0.5)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, into which next to nothing will be trained."""
    monkeypatch.setattr(trained_models, "MAX_WORKERS", 1)
    monkeypatch.setattr(scene_folder, "cache_folder", lambda: tmp_path / "palpate")
    return scene_folder.training_folder(open_scene("liver", SMALL))


def test_a_campaign_on_the_liver_reports_its_sampled_nodes_and_the_tolerance(trained):
    report = json.loads((trained / "report.json").read_text())
    model = pt.load(trained / "model.rom")
    assert report["failed"] == []
    assert report["model"]["cubature"] == 0.05
    assert 0 < report["model"]["cubature_residual"] <= 0.05
    assert f"{report['model']['nodes']}; 0.05" in (trained / "report.md").read_text()
    assert report["model"]["scene"] == {"name": "liver", "parameters": report["campaign"]["parameters"]}
    assert len(model.data.cubature.nodes) == report["model"]["nodes"] < 0.1 * len(model.cloud)
    assert model.data.compliance is not None
    assert 0.5 < report["model"]["compliance_explained"] <= 1
    assert report["model"]["held_out"]["mean"]["reaction"] < 0.5
    run = pt.Trajectory.load(trained / "runs" / "train_000000.h5")
    assert np.linalg.norm(run.reactions["tool"], axis=1).max() > 0.05


def test_the_report_has_the_changes_of_the_force_by_the_supports(trained):
    report, text = json.loads((trained / "report.json").read_text()), (trained / "report.md").read_text()
    found, scene = report["supports"], open_training("liver", COARSE)
    assert (found["springs"], found["nodes"]) == (None, len(scene.model.cloud))
    assert 0.008 < found["border"]["distance"] < 0.014
    assert found["border"]["inward"]["largest"] < 0 < found["border"]["outward"]["largest"] < 1
    worst = max(found["border"]["inward"], found["border"]["outward"], key=lambda change: abs(change["largest"]))
    place = ", ".join(f"{1e3 * x:.0f}" for x in worst["place"])
    assert f"changes by up to {abs(worst['largest']):.0%}, at ({place}) mm, if the border of the supports moves" in text
    assert report["seconds"]["supports"] > 0


def test_the_report_has_the_errors_of_the_tool_force_and_the_surface(trained):
    report, scene = json.loads((trained / "report.json").read_text()), open_training("liver", COARSE)
    model, found = pt.load(trained / "model.rom"), report["model"]["held_out"]
    loads, duration = scene.path(next(run["seed"] for run in report["runs"] if run["kind"] == "held_out"))
    full = pt.Trajectory.load(trained / "runs" / "held_out_000000.h5")
    own = pt.rollout(model, loads, duration=duration, every=scene.every)
    expected = contact_errors(full, own, ["tool"], model.data.compliance.nodes).as_dict()
    assert found["runs"][0] == found["runs"][0] | {n: pytest.approx(v, rel=1e-6) for n, v in expected.items()}
    assert found["contact"]["mean"] == pytest.approx(expected, rel=1e-6)
    assert f"{expected['force_95']:.2%}" in (trained / "report.md").read_text()


def test_the_ball_starts_outside_presses_to_the_trained_depth_and_leaves(trained):
    model = pt.load(trained / "model.rom")
    poses, ball = tool_motion.pressing_ball(open_scene("liver", COARSE), model)
    times = np.linspace(0.0, 2 * tool_motion.PRESS_SECONDS, 81)
    moved, turned = (np.array(part) for part in zip(*map(poses, times), strict=True))
    np.testing.assert_array_equal(turned, np.tile([1.0, 0.0, 0.0, 0.0], (81, 1)))
    np.testing.assert_allclose(moved[[0, 40, 80]], 0.0, atol=1e-15)  # again and again from one place
    np.testing.assert_allclose(moved[:40], moved[40:80], atol=1e-12)
    depth = ball.tool.radius - np.linalg.norm(model.cloud.points[:, None] - ball.motion - moved, axis=2).min(axis=0)
    assert depth[0] < -0.003
    assert depth[39] < 0
    assert 2 / 3 * 0.012 - 1e-9 <= depth.max() <= 0.0125


def test_the_full_liver_is_pressed_without_training(cache, tmp_path, capsys):
    options = ["--full", "--spacing", "0.012", "--seconds", "1", "--out", str(tmp_path)]
    assert main([*REALTIME[:3], *options]) == 0
    printed = capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["tool"]["largest_force"] > 0.1
    assert report["model"] == {"nodes": 1410}
    assert "trust" not in printed
    assert "largest force on tool 1" in printed
    assert not cache.exists()


def test_a_scalpel_goes_the_way_of_the_scene():
    settings = {"spacing": 0.012, "cut_depth": "8 mm", "cut_length": 0.03, "cut_speed": "10 mm/s", "toughness": 50}
    scene = open_scene("liver", settings)
    poses, contact = tool_motion.cutting_scalpel(scene.body, scene.description.cut)
    ways = np.array([poses(time)[0] for time in np.linspace(0.0, 10.0, 1001)])
    top, gap = scene.body.cloud.points[:, 2].max(), tool_motion.AIR_GAP
    assert contact.tool.toughness == 50
    np.testing.assert_allclose(np.ptp(ways, axis=0).max(), 0.03)
    np.testing.assert_allclose(ways[:, 2].min(), -(0.008 + gap))
    assert contact.motion[0][2] - gap <= top  # the depth is below the surface there
    np.testing.assert_allclose(np.linalg.norm(np.diff(ways, axis=0), axis=1).max(), 0.01 * 0.01)


def test_the_way_of_a_scalpel_changes_no_training():
    assert open_scene("liver", {"toughness": 50}).digest == open_scene("liver", {}).digest


def test_the_liver_is_cut_in_real_time(cache, tmp_path, capsys):
    options = ["--cut", "--set", "spacing=0.012", "cut_depth=10mm", "--seconds", "3", "--out", str(tmp_path)]
    assert main(["run", "liver", *options]) == 0
    printed = capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["cut"]["area"] > 2e-5
    assert report["cut"]["failure"] == ""
    assert "cut area" in printed
    assert not cache.exists()


def test_a_model_from_a_file_is_pressed_and_the_force_is_reported(trained, swift, tmp_path, capsys):
    file = trained / "model.rom"
    assert main([*REALTIME, "--model", str(file), "--out", str(tmp_path)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    report = json.loads((tmp_path / "report.json").read_text())
    with h5py.File(tmp_path / "black_box.h5") as box:
        force = np.linalg.norm(box["force"][:], axis=1)
    assert report["tool"]["largest_force"] == pytest.approx(force.max())
    assert f"largest force on tool 1 {force.max():.3g} N" in told
    assert "Computation: " in told
    assert "Status: 200 Hz" in told
    model = pt.load(file)
    poses, ball = tool_motion.pressing_ball(open_scene("liver"), model)
    again = pt.tools.Contact(ball.tool, lambda time: ball.motion + poses(time)[0], friction=ball.friction)
    run = pt.rollout(model, [again], duration=0.45, every=0.005)
    expected = np.linalg.norm(run.reactions["tool"], axis=1).max()
    assert 0.5 * expected < force.max() < 1.5 * expected  # periods that a busy machine drops make the tool jump


def test_the_first_start_trains_and_caches_a_model_and_resumes_after_an_interrupt(
    cache, swift, tmp_path, capsys, monkeypatch
):
    def interrupted(self, outcome):
        raise KeyboardInterrupt

    settings = ["--set", *(f"{name}={value}" for name, value in SMALL.items())]
    command = [*REALTIME, *settings, "--json", "--out", str(tmp_path / "out")]
    with monkeypatch.context() as patch:
        patch.setattr("palpate.app.train.bar.Bar.done", interrupted)
        assert main(command) == 130
    assert "1 of 5 runs are kept" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(command) == 0
    captured = capsys.readouterr()
    assert "5 runs, 1 of them done before" in captured.err
    report = json.loads(captured.out)
    assert report["model"]["modes"] == 8
    assert report["parameters"]["file"] == str(cache / "model.rom")
    assert report["tool"]["largest_force"] > 0.05
    assert f"-{pt.__version__}-" in cache.name
    assert {"model.rom", "campaign.json"} <= {path.name for path in cache.iterdir()}

    def refused(*_):
        raise pt.InputError("it was trained again")

    monkeypatch.setattr(trained_models, "training_of", refused)
    assert main(command) == 0
    capsys.readouterr()
    (cache / "model.rom").write_bytes((cache / "model.rom").read_bytes()[:-1])
    assert main(command) == 2
    told = capsys.readouterr().err
    assert "the file is truncated" in told
    assert "it was trained again" in told
    other = open_scene("liver", SMALL | {"poisson": 0.4})  # another body has another folder
    assert not scene_folder.training_folder(other).exists()


def test_a_cache_that_cannot_be_written_is_reported(cache, tmp_path, assert_refused):
    cache.parent.write_text("no folder")
    assert_refused(
        [*REALTIME, "--out", str(tmp_path / "out")], "cache = ", "is not a folder", "palpate train liver --out FOLDER"
    )
    assert not (tmp_path / "out").exists()


def test_a_model_without_contact_is_refused(run, held, tmp_path, assert_refused):
    file, out = tmp_path / "bar.rom", tmp_path / "out"
    pt.save(pt.hyper_reduce(held, run, modes=2), file)
    assert_refused([*REALTIME, "--model", str(file), "--out", str(out)], str(file), "palpate train liver")
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--seconds", "1"], ["--seconds must be left out of a single run", "--realtime"]),
        (["--realtime", "--seconds", "0"], ["--seconds", "600] s"]),
        (["--realtime", "--rate", "1"], ["--rate", "20000] Hz"]),
        (["--realtime", "--model", "nowhere.rom"], ["--model must be an existing file", "nowhere.rom"]),
        (["--realtime", "--model", __file__], [Path(__file__).name, "must end in .rom"]),
        (["--realtime", "--full", "--model", __file__], ["--model must be left out with --full", __file__]),
        (["--realtime", "--model", __file__, "--spacing", "0.01"], ["--spacing must be left out with --model"]),
        (["--realtime", "--full", "--spacing", "0.1"], ["--spacing"]),
        (["--cut", "--set", "toughness=-1"], ["toughness", "J/m^2"]),
        (["--cut", "--model", __file__], ["--model must be left out with --cut", __file__]),
    ],
)
def test_bad_options_are_refused_in_one_line_and_no_file_is_left(cache, tmp_path, assert_refused, options, parts):
    assert_refused(["run", "liver", *options, "--out", str(tmp_path / "out")], *parts)
    assert list(tmp_path.iterdir()) == []
