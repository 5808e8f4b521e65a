"""Training campaigns: stopped and gone on with, with failures, on workers here and on a cluster."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.models.input import open_input
from palpate.app.recordings.recording import Recording, save_recording
from palpate.app.recordings.snapshot import Snapshot, ToolSnapshot, training_errors
from palpate.app.train import folder as folders
from palpate.app.train.campaign import Campaign
from palpate.app.train.choose import choose
from palpate.app.train.report import _by_load
from palpate.core.files import read_sealed_json, write_sealed_json
from palpate.core.sealed import open_sealed
from palpate.dynamics.run.trajectory import FORMAT, VERSION
from palpate.scenes.training import open_training

SCENE = "training_scenes:bar"
RUNS = [*(f"train_{k:06d}.h5" for k in range(4)), "held_out_000000.h5"]


@pytest.fixture(autouse=True)
def known(monkeypatch):
    """Let this process and those it starts import the scene."""
    folder = str(Path(__file__).parent)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([folder, *os.environ.get("PYTHONPATH", "").split(os.pathsep)]))


def command(folder, *options):
    sizes = ["--paths", "4", "--held-out", "1", "--modes", "6"]
    return ["train", SCENE, *sizes, "--out", str(folder), *options]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a campaign that two workers have made in one go."""
    folder = tmp_path_factory.mktemp("campaign") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parent))
        assert main(command(folder, "--workers", "2")) == 0
    return folder


def datasets(path):
    """All that a file holds, byte by byte, less how long it took."""
    found = {}
    with h5py.File(path, "r") as file:
        file.visititems(lambda name, item: found.update({name: item[:].tobytes()} if hasattr(item, "dtype") else {}))
        found |= {name: value for name, value in file.attrs.items() if name != "wall_seconds"}
    return found


def assert_same_runs(folder, other):
    for name in RUNS:
        assert datasets(folder / "runs" / name) == datasets(other / "runs" / name)
        assert pt.Trajectory.load(folder / "runs" / name).complete


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def waited(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def children(pid):
    path = Path(f"/proc/{pid}/task/{pid}/children")
    return path.read_text().split() if path.exists() else []


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")")[-1].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_campaign_writes_its_runs_a_model_and_a_report(whole, assert_drawn):
    report = json.loads((whole / "report.json").read_text())
    assert sorted(path.name for path in (whole / "runs").iterdir()) == sorted(RUNS)
    assert [run["seed"] for run in report["runs"]] == [0, 1, 2, 3, folders.MAX_PATHS]
    assert report["failed"] == []
    assert report["model"]["training_runs"] == 4
    assert report["model"]["snapshots"] == 44
    model = pt.load(whole / "model.rom")
    held, scene = report["model"]["held_out"]["runs"], open_training(SCENE, {})
    loads, duration = scene.path(folders.MAX_PATHS)
    again = pt.rollout(model, loads, duration=duration, every=scene.every)
    expected = pt.relative_errors(pt.Trajectory.load(whole / "runs" / RUNS[-1]), again)
    assert len(held) == 1
    assert held[0]["displacement"] == pytest.approx(expected.displacement, rel=1e-6)
    assert held[0]["displacement"] < 0.3
    text = (whole / "report.md").read_text()
    assert "| held_out_000000 | PrescribedMotion |" in text
    assert "held-out paths with a" not in text  # all have one kind of load
    assert f"{report['model']['projection_error']:.2%}" in text
    assert_drawn(whole / "errors.png")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills processes as POSIX does")
def test_a_killed_campaign_resumes_where_it_stopped(whole, tmp_path):
    folder = tmp_path / "killed"
    runs = folder / "runs"
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen([sys.executable, "-m", "palpate", *command(folder, "--workers", "2")], stderr=log)
        try:
            waited(
                lambda: (list(runs.glob("train_*.h5")) and list(runs.glob(".*.partial"))) or process.poll() is not None
            )
            workers = children(process.pid)
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
    waited(lambda: not any(map(alive, workers)))  # none is left behind
    assert process.returncode == -signal.SIGKILL
    assert workers or not Path("/proc").exists()
    before = {path.name: (path.stat().st_mtime_ns, path.stat().st_ino) for path in runs.glob("[!.]*")}
    assert 1 <= len(before) < len(RUNS)
    for name in before:
        assert datasets(runs / name) == datasets(whole / "runs" / name)
    assert main(command(folder)) == 0
    assert_same_runs(folder, whole)
    assert sorted(path.name for path in runs.iterdir()) == sorted(RUNS)  # and nothing half done
    for name, stamp in before.items():
        assert ((runs / name).stat().st_mtime_ns, (runs / name).stat().st_ino) == stamp


@pytest.mark.slow
def test_runs_do_not_depend_on_the_number_of_workers_and_restarts(whole, tmp_path, capsys):
    folder = tmp_path / "grown"
    assert main(command(folder, "--paths", "1", "--held-out", "0")) == 0
    stamp = (folder / "runs" / RUNS[0]).stat().st_mtime_ns
    assert json.loads((folder / "report.json").read_text())["model"]["training_runs"] == 1
    capsys.readouterr()
    assert main(command(folder, "--json")) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((folder / "report.json").read_text())
    assert (folder / "runs" / RUNS[0]).stat().st_mtime_ns == stamp
    assert_same_runs(folder, whole)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="interrupts processes as POSIX does")
def test_an_interrupt_keeps_finished_runs(tmp_path, capsys, monkeypatch):
    def interrupted(self, outcome):
        raise KeyboardInterrupt

    monkeypatch.setattr("palpate.app.train.bar.Bar.done", interrupted)
    before = children(os.getpid())  # such as the tracker of shared memory of another test
    assert main(command(tmp_path / "interrupted")) == 130
    assert "1 of 5 runs are kept; the same command continues from there" in capsys.readouterr().err
    assert (tmp_path / "interrupted" / "runs" / RUNS[0]).exists()
    assert not set(children(os.getpid())) - set(before)


@pytest.mark.slow
def test_a_training_states_its_runs_and_their_time_before_it_begins(tmp_path, capsys, monkeypatch):
    def refused(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("palpate.app.train.campaign.run_local", refused)
    assert main(["train", "beam", "--set", "spacing=6.6mm", "--out", str(tmp_path / "beam")]) == 130
    said = capsys.readouterr().err
    assert "Beam: about 496 nodes, 26 runs of its full body, and a training of 24 modes on them" in said
    assert re.search(r"takes about \d+ (s|min) if nothing else runs here \((as measured|a guess).*\): runs ", said)
    assert re.search(r"runs; \d+ on 1 process, about \d+ (s|min) if nothing else runs here; Ctrl-C stops them", said)


@pytest.mark.slow
def test_failed_runs_are_recorded_and_the_others_continue(tmp_path, capsys):
    folder = tmp_path / "failing"
    options = ["--set", "diverging=1", "--set", "deadly=2"]
    assert main(command(folder, *options, "--json")) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["failed"] == ["train_000001", "train_000002"]
    diverged, died = report["runs"][1:3]
    assert "inside out" in diverged["reason"] or "stable" in diverged["reason"] or "non-finite" in diverged["reason"]
    assert "process died 2 times (exit code 3)" in died["reason"]
    stored = pt.Trajectory.load(folder / "runs" / "train_000001.failed.h5")
    assert not stored.complete
    assert len(stored.times) == diverged["frames"] >= 5
    assert all(not name.endswith(".partial") for name in contents(folder))
    assert report["model"]["training_runs"] == 2
    assert "train_000001 failed after" in (folder / "report.md").read_text()
    stamps = {path: path.stat().st_mtime_ns for path in (folder / "runs").iterdir()}
    assert main(command(folder, *options)) == 0
    captured = capsys.readouterr()
    assert "train_000001 failed: " in captured.out
    changed = [path.name for path, stamp in stamps.items() if path.stat().st_mtime_ns != stamp]
    assert changed == ["train_000002.failed.json"]  # only a process that died is tried again


def test_a_model_with_large_errors_ends_with_a_status_of_its_own_and_says_what_to_change(whole, tmp_path, capsys):
    folder = tmp_path / "few"
    shutil.copytree(whole, folder)
    assert main(command(folder, "--modes", "1")) == 3
    captured = capsys.readouterr()
    last = captured.err.splitlines()[-1]
    model, report = pt.load(folder / "model.rom"), json.loads((folder / "report.json").read_text())
    mean = model.report["held_out"]["mean"]
    assert max(mean["displacement"], mean["reaction"]) > 0.3
    assert last == f"palpate: warning: {model.report['advice']}"
    assert f"errs by {mean['displacement']:.0%} in displacement" in last
    assert report["model"]["advice"] == model.report["advice"]
    assert model.report["advice"] in (folder / "report.md").read_text()
    assert model.report["advice"] in " ".join(captured.out.split())
    printed = []
    open_input(str(folder / "model.rom")).reduced(SimpleNamespace(say=printed.append))
    assert printed == [f"warning: {model.report['advice']}"]
    assert training_errors(model)["advice"] == model.report["advice"]
    assert training_errors(pt.load(whole / "model.rom"))["advice"] is None
    open_input(str(whole / "model.rom")).reduced(SimpleNamespace(say=printed.append))
    assert len(printed) == 1


@pytest.mark.parametrize(
    ("scene", "options", "part"),
    [
        ("pad", ["--paths", "3"], "--paths must be at least 4 where tools touch the body anywhere, got 3"),
        ("pad", ["--modes", "7"], "--modes must be at least 8 where tools touch the body anywhere, got 7"),
        ("pad", ["--modes", "908"], "--modes must be at most 907, half the degrees of freedom"),
        ("bar", ["--modes", "45"], "--modes must be at most 44, the number of snapshots of 4 runs, got 45"),
    ],
)
def test_sizes_from_which_no_model_can_be_trained_are_refused_before_the_runs(tmp_path, capsys, scene, options, part):
    argv = ["train", f"training_scenes:{scene}", "--paths", "4", "--held-out", "1", "--modes", "8"]
    assert_stopped([*argv, *options, "--out", str(tmp_path / "new")], capsys, part)
    assert not list((tmp_path / "new" / "runs").glob("*"))


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--paths", "3"], "--paths must be at least 4 where tools touch the body anywhere, got 3"),
        (["--modes", "7"], "--modes must be at least 8 where tools touch the body anywhere, got 7"),
        (["--set", "tool.radius=20mm", "spacing=15mm"], "radius of [tool] must be at least 2 spacings"),
    ],
)
def test_sizes_of_a_scene_are_refused_before_its_body_is_made(tmp_path, capsys, monkeypatch, options, part):
    monkeypatch.setattr("palpate.scenes.scene.Scene.cloud", None)
    assert_stopped(["train", "liver", *options, "--out", str(tmp_path / "new")], capsys, part)


@pytest.mark.slow
def test_a_large_body_is_trained_on_its_own_surface_filled_again(tmp_path, monkeypatch):
    monkeypatch.setattr("palpate.reduction.contact.coarse_body.MAX_NODES", 700)
    folder = tmp_path / "pad"
    argv = ["train", "training_scenes:pad", "--set", "springs=1e5", "--paths", "4", "--held-out", "2", "--modes", "12"]
    assert main([*argv, "--out", str(folder)]) == 0
    report, text = json.loads((folder / "report.json").read_text()), (folder / "report.md").read_text()
    assert report["campaign"]["nodes"] == 726
    assert 300 < report["supports"]["nodes"] < 700
    assert report["model"]["cubature"] == 0.01
    assert report["model"]["held_out"]["contact"]["mean"]["force"] < 0.15
    assert report["supports"]["springs"]["halved"]["largest"] < 0 < report["supports"]["springs"]["doubled"]["largest"]
    assert "if the springs of foundations are halved or doubled: " in text
    assert "the border of the supports moves" in text


def test_a_large_body_that_cannot_be_filled_again_is_refused_before_the_runs(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("palpate.reduction.contact.coarse_body.MAX_NODES", 60)
    argv = ["train", "training_scenes:pad", "--paths", "4", "--held-out", "0", "--modes", "8"]
    assert_stopped([*argv, "--out", str(tmp_path / "new")], capsys, "coarse must be given", "more than 60 nodes")
    assert not list((tmp_path / "new" / "runs").glob("*"))


def test_errors_of_forces_are_reported_by_kind_of_load():
    kinds = [["Contact"], ["Grasp"], ["Contact"], ["Grasp"], ["Contact"], ["Grasp"]]
    runs = [{"kind": "train", "failed": False, "loads": ["Grasp"]}]
    runs += [{"kind": "held_out", "failed": k == 4, "loads": loads} for k, loads in enumerate(kinds)]
    errors = [0.1, 0.3, 0.2, 0.5, None]  # of the runs that were finished; the reduced model failed on the last
    found = [{"failed": error is None, "reaction": error} for error in errors]
    told = _by_load({"runs": runs, "model": {"held_out": {"runs": found}}})
    head, tail = "error of reaction on the 2 held-out paths with a", "mean; 95 % below"
    assert told == {f"{head} Contact, {tail}": "15.00%; 19.50%", f"{head} Grasp, {tail}": "40.00%; 49.00%"}


@pytest.mark.slow
def test_with_a_tolerance_paths_are_added_until_it_is_met(tmp_path, capsys):
    folder = tmp_path / "chosen"
    argv = ["train", SCENE, "--paths", "9", "--held-out", "2", "--modes", "6", "--workers", "2", "--out", str(folder)]
    assert main([*argv, "--tolerance", "1e-6", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [each["runs"] for each in report["rounds"]] == [4, 6, 9]
    assert report["model"]["training_runs"] == 9
    (first, second, third) = read_sealed_json(folder / "rounds.json", "chosen paths")["rounds"]
    assert first == [0, 1, 2, 3]
    assert set(second) <= set(range(4, 12))  # four candidates for every path that is chosen
    assert set(third) <= set(range(max(second) + 1, max(second) + 13))
    before = {path.name: path.stat().st_mtime_ns for path in (folder / "runs").iterdir()}
    assert {f"train_{k:06d}.h5" for k in (*first, *second, *third)} <= before.keys()
    assert main([*argv, "--tolerance", "1e-6"]) == 0  # nothing is left to do
    assert "not kept" in capsys.readouterr().out
    assert {path.name: path.stat().st_mtime_ns for path in (folder / "runs").iterdir()} == before
    (folder / "rounds.json").unlink()
    assert main([*argv, "--tolerance", "0.9"]) == 0
    assert "kept" in capsys.readouterr().out
    assert read_sealed_json(folder / "rounds.json", "chosen paths")["rounds"] == [first]
    assert pt.load(folder / "model.rom").report["training_runs"] == 4


@pytest.mark.parametrize(
    ("tolerance", "expected"), [(0.05, [24]), (0.025, [24, 32, 48]), (0.001, [24, 32, 48, 66, 96])]
)
def test_more_modes_are_tried_on_the_same_runs(monkeypatch, tolerance, expected):
    """A model errs by one over its number of modes; all paths are there at once."""
    told, trained = [], []

    def train(self, jobs):
        trained.append(jobs)
        return SimpleNamespace(data=SimpleNamespace(modes=self.modes))

    monkeypatch.setattr(Campaign, "train", train)
    monkeypatch.setattr(Campaign, "jobs", lambda self, paths, held_out: [*paths])
    monkeypatch.setattr("palpate.app.train.campaign._held_out_error", lambda model: 1 / model.data.modes)
    folder = SimpleNamespace(rounds=list, write_rounds=lambda numbers: None)
    campaign = Campaign(folder, None, SimpleNamespace(say=told.append), modes=24)
    jobs, model, rounds = campaign.train_to_tolerance(tolerance, 4, 2, more_modes=True)
    assert [each.modes for each in rounds] == expected
    assert model.data.modes == expected[-1]
    assert all(each == jobs == [0, 1, 2, 3] for each in trained)
    assert len(told) == len(expected)
    _, _, alone = campaign.train_to_tolerance(tolerance, 4, 2)
    assert [each.modes for each in alone] == [24]


def test_chosen_paths_differ_from_the_training_and_each_other(whole):
    """Of four candidates, one of the training and two that are the same: the two others."""
    model, scene = pt.load(whole / "model.rom"), open_training(SCENE, {})
    far = [np.zeros(3), np.array([0.0, 0.006, 0.0]), np.array([0.0, 0.0061, 0.0]), np.array([0.0, 0.0, 0.005])]

    def path(seed):
        aim = far[seed % 1000]
        return (pt.PrescribedMotion("x+", lambda points, t: aim * np.sin(100 * np.pi * t) ** 2),), 0.01

    candidates = [folders.Job(folders.TRAINED, k, k) for k in range(4)]
    folder = folders.Folder(whole, {})
    jobs = choose(model, folder, dataclasses.replace(scene, path=path), candidates, 2)
    assert [job.number for job in jobs] == [2, 3]


def further(model, reach, duration=0.2):
    """A recording of a motion of the end of the bar by some distance."""
    zeros, centre = np.zeros(3), model.cloud.points[model.cloud.group("x+")].mean(axis=0)
    poses = [centre + np.array([reach, 0.0, 0.0]) * np.sin(np.pi * k / 20) ** 2 for k in range(21)]
    tools = [
        ToolSnapshot(
            force=zeros, moment=zeros, stiffness=np.eye(3), position=pose, quaternion=np.array([1.0, 0, 0, 0]),
            sequence=k, device_force=zeros, kind="group",
        )
        for k, pose in enumerate(poses)
    ]  # fmt: skip
    snapshots = [
        Snapshot(
            time=duration * k / 20, steps=k, trust=3.0, kinetic=0.0, strain=0.0, computing=0.0, lateness=0.0,
            coordinates=np.zeros(model.count), state="running", modulus_ratio=1.0,
            contact_nodes=np.zeros(0, dtype=np.int64), contact_forces=np.zeros((0, 3)),
            contact_tools=np.zeros(0, dtype=np.int64), tools=(tool,),
        )
        for k, tool in enumerate(tools)
    ]  # fmt: skip
    tool = {"kind": "group", "radius": 0.0, "length": 0.0, "friction": 0.0, "stiffness": None, "index": 0}
    tool["start"] = 0
    return Recording("Bar", model, np.arange(21) * duration / 20, snapshots, [tool], {})


@pytest.mark.slow
def test_a_recorded_path_beyond_trust_is_added_to_the_training(whole, tmp_path, capsys, assert_refused):
    folder, file = tmp_path / "more", tmp_path / "session.h5"
    shutil.copytree(whole, folder)
    before = pt.load(folder / "model.rom")
    recording = further(before, 0.008)
    save_recording(file, recording)
    assert main(command(folder, "--more", str(file), "--json")) == 0
    report = json.loads(capsys.readouterr().out)
    (run,) = (run for run in report["runs"] if run["kind"] == "recorded")
    assert not run["failed"]
    after = pt.load(folder / "model.rom")
    assert after.report["training_runs"] == before.report["training_runs"] + 1
    pull = pt.PrescribedMotion("x+", lambda points, t: np.array([0.008, 0, 0]) * np.sin(np.pi * t / 0.2) ** 2)
    trust = {}
    for name, model in (("before", before), ("after", after)):
        with warnings.catch_warnings(action="ignore", category=pt.TrustWarning):
            trust[name] = pt.rollout(model, [pull], duration=0.2, every=0.005, progress=False).trust.max()
    assert trust["before"] > 1.5
    assert trust["after"] < 0.7 * trust["before"]
    assert main(command(folder, "--more", str(file))) == 0  # it is there already
    assert main(command(folder)) == 0  # and it stays
    assert pt.load(folder / "model.rom").report["training_runs"] == after.report["training_runs"]
    assert len(list((folder / "recordings").iterdir())) == 1
    capsys.readouterr()
    within = dataclasses.replace(recording, snapshots=[dataclasses.replace(s, trust=0.5) for s in recording.snapshots])
    save_recording(tmp_path / "within.h5", within)
    assert_refused(command(folder, "--more", str(tmp_path / "within.h5")), "beyond trust", "0.5")
    assert_refused(command(folder, "--more", str(folder / "model.rom")), "not a palpate recording")
    other = ["train", "beam", "--set", "spacing=0.006", "--paths", "1", "--out", str(tmp_path / "other")]
    assert main([*other, "--more", str(file)]) == 2
    assert "campaign's body" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.slow
def test_no_model_is_written_if_all_runs_fail(tmp_path, capsys):
    options = ["--set", "diverging=0", "--paths", "1", "--held-out", "0"]
    assert main(command(tmp_path / "none", *options)) == 1
    assert "no training run was finished; the first: " in capsys.readouterr().err
    assert (tmp_path / "none" / "runs" / "train_000000.failed.h5").exists()


@pytest.mark.parametrize(
    ("options", "edit", "parts"),
    [
        (["--seed", "1"], {}, ["seed is 0 there, 1 here"]),
        (["--set", "lasting=0.02"], {}, ["lasting is 0.01 there, 0.02 here"]),
        ([], {"version": 0}, ["version is 0 there, 2 here"]),
        ([], {"palpate": "0.0.1", "scene": "liver"}, ["palpate is '0.0.1' there", "scene is 'liver' there"]),
        ([], {"format": "recipes"}, ["campaign.json: this is not a palpate campaign", "another folder"]),
    ],
)
def test_the_folder_of_another_campaign_is_refused_and_not_changed(tmp_path, assert_refused, options, edit, parts):
    manifest = {
        "format": "palpate campaign", "version": 2, "palpate": pt.__version__, "scene": SCENE,
        "parameters": {"lasting": 0.01, "diverging": "", "deadly": ""}, "seed": 0, "every": 0.001, "nodes": 112,
    }  # fmt: skip
    (tmp_path / "runs").mkdir()
    write_sealed_json(tmp_path / "campaign.json", manifest | edit)
    (tmp_path / "runs" / "train_000000.h5").write_text("a run")
    (tmp_path / "runs" / ".train_000001.abc.partial").write_text("a part of a run")
    before = contents(tmp_path)
    assert_refused(command(tmp_path, *options), *parts)
    assert contents(tmp_path) == before


def test_a_folder_in_use_is_refused(whole, assert_refused):
    manifest = read_sealed_json(whole / "campaign.json", "campaign")
    with folders.open_campaign(whole, manifest):
        assert_refused(command(whole), "is in use by a campaign that runs")


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"", "not valid JSON"),
        (b"{}", "does not match its checksum"),
        (b"[]", "holds no JSON object"),
        (b"[" * 100_000, "nested levels"),
        (b'{"seed": ' + b"9" * 5000 + b"}", "not valid JSON"),
        (b"\xff\xfe", "not text in UTF-8"),
    ],
)
def test_a_damaged_manifest_is_refused_in_one_line(tmp_path, assert_refused, content, part):
    (tmp_path / "runs").mkdir()
    (tmp_path / "campaign.json").write_bytes(content)
    assert_refused(command(tmp_path), "campaign.json", part, "another folder")


@pytest.mark.parametrize(
    "edit", [{"parameters": []}, {"parameters": {"lasting": [1]}}, {"parameters": None}, {"scene": "os:system"}]
)
def test_a_forged_manifest_is_refused_and_not_followed(tmp_path, assert_refused, edit):
    manifest = {
        "format": "palpate campaign", "version": 2, "palpate": pt.__version__, "scene": SCENE,
        "parameters": {"lasting": 0.01, "diverging": "", "deadly": ""}, "seed": 0, "every": 0.001, "nodes": 112,
    }  # fmt: skip
    (tmp_path / "runs").mkdir()
    write_sealed_json(tmp_path / "campaign.json", manifest | edit)
    assert_refused(command(tmp_path), "another folder" if edit.get("parameters", 1) in ([], None) else "Choose another")


def assert_stopped(argv, capsys, *parts):
    """Assert that a command which has begun ends with one line and exit status 2."""
    assert main(argv) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("palpate: ")
    assert all(part in last for part in parts)


@pytest.mark.parametrize("content", [b"", b"{", b'{"retry": 1}'])
def test_a_damaged_record_of_a_failed_run_is_refused_in_one_line(whole, tmp_path, capsys, content):
    shutil.copytree(whole, tmp_path / "copy")
    (tmp_path / "copy" / "runs" / "train_000001.h5").unlink()
    (tmp_path / "copy" / "runs" / "train_000001.failed.json").write_bytes(content)
    assert_stopped(command(tmp_path / "copy"), capsys, "train_000001.failed.json", "delete the file")


def test_swapped_run_files_are_refused(whole, tmp_path, capsys):
    shutil.copytree(whole, tmp_path / "copy")
    one, two = (tmp_path / "copy" / "runs" / f"train_00000{k}.h5" for k in (0, 1))
    content = one.read_bytes()
    one.write_bytes(two.read_bytes())
    two.write_bytes(content)
    assert_stopped(command(tmp_path / "copy"), capsys, "train_000000.h5 is the file of another run", "delete it")


def test_a_damaged_run_is_refused(whole, tmp_path, capsys):
    shutil.copytree(whole, tmp_path / "copy")
    path = tmp_path / "copy" / "runs" / "train_000001.h5"
    content = bytearray(path.read_bytes())
    content[open_sealed(path, FORMAT, VERSION).arrays["displacements"].offset + 999] ^= 1
    path.write_bytes(content)
    assert_stopped(command(tmp_path / "copy"), capsys, "train_000001.h5", "does not match its checksum")


def test_runs_without_a_campaign_file_are_refused(tmp_path, assert_refused):
    (tmp_path / "runs").mkdir()
    assert_refused(command(tmp_path), "holds runs, but no campaign.json")


@pytest.mark.parametrize(
    ("argv", "part"),
    [
        (["train", "horse"], "SCENE"),
        (["train", "no.such:scene"], "No module named 'no'"),
        (["train", "beam", "--set", "spacing"], "--set must be NAME=VALUE"),
        (["train", "beam", "--set", "spacing=wide"], "--set spacing must be a number [m]"),
        (["train", "beam", "--set", "width=1"], "must be keys of the scene, got 'width'"),
        (["train", "beam", "--set", "spacing=1"], "--set spacing"),
        (["train", "beam", "--paths", "0"], "--paths"),
        (["train", "beam", "--workers", "0"], "--workers"),
        (["train", "beam", "--cubature", "2"], "--cubature"),
    ],
)
def test_bad_options_are_refused(tmp_path, assert_refused, argv, part):
    assert_refused([*argv, "--out", str(tmp_path / "new")], part)
    assert not (tmp_path / "new").exists()


def test_without_dask_a_cluster_is_refused_with_the_way_to_install_it(tmp_path, assert_refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert_refused(command(tmp_path / "new", "--cluster", "tcp://localhost:1"), "pip install 'palpate[cluster]'")


@pytest.fixture
def cluster():
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed: palpate[cluster]")
    made = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    with made:
        yield made


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_makes_the_same_runs(whole, tmp_path, cluster):
    folder, lost, stop = tmp_path / "cluster", [], Event()
    first = next(iter(cluster.workers.values()))

    def kill_one():
        while not stop.wait(0.01):
            if list((folder / "runs").glob("train_*.h5")):
                lost.append(first.pid)
                os.kill(first.pid, signal.SIGKILL)
                return

    killer = Thread(target=kill_one)
    killer.start()
    try:
        assert main(command(folder, "--cluster", cluster.scheduler_address)) == 0
    finally:
        stop.set()
        killer.join()
    assert lost
    assert_same_runs(folder, whole)
    both = [pt.load(path / "model.rom").data.trial_and_test_basis for path in (folder, whole)]
    np.testing.assert_array_equal(*both)


def test_an_unreachable_cluster_is_refused(tmp_path, assert_refused, monkeypatch):
    pytest.importorskip("distributed", reason="dask.distributed is not installed: palpate[cluster]")
    monkeypatch.setattr("palpate.app.train.cluster.ANSWER_SECONDS", 0.5)
    assert_refused(
        command(tmp_path / "new", "--cluster", "tcp://127.0.0.1:1"), "--cluster must be the address of a Dask scheduler"
    )


def test_a_run_file_with_forged_times_is_refused(whole, tmp_path, capsys, forge):
    shutil.copytree(whole, tmp_path / "copy")
    path = tmp_path / "copy" / "runs" / "train_000000.h5"
    forge(path, lambda header, arrays: arrays["times"].__imul__(1e9), FORMAT, VERSION)
    assert_stopped(command(tmp_path / "copy"), capsys, "train_000000.h5 has other times", "delete it")


def test_a_lock_file_that_is_a_pipe_is_refused_without_waiting(whole, tmp_path, capsys):
    shutil.copytree(whole, tmp_path / "copy")
    (tmp_path / "copy" / ".lock").unlink(missing_ok=True)
    os.mkfifo(tmp_path / "copy" / ".lock")
    assert_stopped(command(tmp_path / "copy"), capsys, "not a regular file")


def test_a_lock_that_is_a_link_makes_no_file_elsewhere(tmp_path):
    from palpate.app.train.folder import _open_lock

    (tmp_path / ".lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(pt.InputError, match="must be a regular file, got a link"):
        _open_lock(tmp_path / ".lock")
    assert not (tmp_path / "elsewhere").exists()
    (tmp_path / ".lock").unlink()
    with _open_lock(tmp_path / ".lock") as lock:
        assert lock.writable()
