"""The time of a training, stated before it begins: what counts in it, and when a command asks."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from palpate.app.common import machine
from palpate.app.common.sample_block import sample_block
from palpate.app.train import estimate as estimates
from palpate.app.train.estimate import ASK_SECONDS, Estimate, confirm, estimate_training, keep_trained
from palpate.app.train.folder import Folder, jobs
from palpate.scenes.open_scene import open_scene

PACE = 1e-6


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """The liver on a machine of a known pace, of which nothing was kept before."""
    monkeypatch.setattr(machine, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(estimates, "measure_pace", lambda material: PACE)
    return open_scene("liver", {"spacing": "12 mm", "radius": "30 mm"})


def estimated(scene, folder, workers=1, **changes):
    from dataclasses import replace

    return estimate_training(scene, replace(scene.description.training, **changes), folder, workers)


def test_the_time_of_runs_is_that_of_their_steps_at_all_nodes(scene, tmp_path):
    few, many = (estimated(scene, tmp_path, paths=paths, held_out=0) for paths in (4, 8))
    finer = estimated(open_scene("liver", {"spacing": "11.25 mm"}), tmp_path, paths=4, held_out=0)
    assert many.seconds["runs"] == pytest.approx(2 * few.seconds["runs"])
    assert finer.seconds["runs"] == pytest.approx((12 / 11.25) ** 4 * few.seconds["runs"])
    assert estimated(scene, tmp_path, 2, paths=4, held_out=0).seconds["runs"] == few.seconds["runs"] / 2
    wave = 0.012 / 4.78  # [s]: of a pressure wave in this tissue over a spacing
    assert few.seconds["runs"] == pytest.approx(4 * 0.6 / wave * 1260 * PACE, rel=0.03)
    assert "about 1,259 nodes, 4 runs of its full body, and a training of 40 modes" in few.lines()[0]
    assert "(as measured here): " in few.lines()[1]


def test_kept_runs_are_stated_and_not_made_again(scene, tmp_path):
    folder = Folder(tmp_path, {})
    folder.runs.mkdir()
    before = estimated(scene, tmp_path, paths=4, held_out=0)
    for job in jobs(0, range(3), 0):
        folder.file(job).touch()
    after = estimated(scene, tmp_path, paths=4, held_out=0)
    assert "4 runs of its full body (3 of them kept from before)" in after.what
    assert after.seconds["runs"] == pytest.approx(before.seconds["runs"] / 4)
    assert after.seconds["training"] == before.seconds["training"]  # on all of them


def test_what_has_to_be_compiled_counts_until_a_training_has_ended(scene, tmp_path, monkeypatch):
    assert estimated(scene, tmp_path).seconds["compiling once"] > 0
    keep_trained(scene)
    assert estimated(scene, tmp_path).seconds["compiling once"] == 0
    monkeypatch.setattr(estimates, "measure_pace", lambda material: None)  # the folder of compiled code was emptied
    later = estimated(scene, tmp_path)
    assert later.seconds["compiling once"] > 0
    assert not later.is_guess  # the pace was kept
    monkeypatch.setattr(machine, "cache_folder", lambda: tmp_path / "of another machine")
    assert "a guess until all of it is measured here" in estimated(scene, tmp_path).lines()[1]


def test_nothing_is_compiled_to_measure(tmp_path):
    cache = tmp_path / "cache"
    cache.mkdir(mode=0o700)
    code = (
        "import palpate as pt; from palpate.app.train.estimate import measure_pace\n"
        "print(measure_pace(pt.materials.NeoHookean(C1=1100.0, density=1060.0, poisson=0.45)))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "None\n"
    assert not list(cache.rglob("*.code"))


def test_a_block_measures_the_pace():
    material = open_scene("liver").material
    estimates.press(sample_block(material))  # compiles what is not compiled
    pace = estimates.measure_pace(material)
    assert 1e-8 < pace < 1e-3


@pytest.mark.parametrize(
    ("seconds", "yes", "asked"), [(ASK_SECONDS, False, 1), (ASK_SECONDS, True, 0), (0.9 * ASK_SECONDS, False, 0)]
)
def test_a_command_asks_before_minutes_unless_yes_is_given(seconds, yes, asked):
    said, questions = [], []
    console = SimpleNamespace(say=said.append, confirm=questions.append)
    confirm(console, Estimate("Liver: 3 runs", {"runs": seconds}), "Train?", yes)
    assert len(said) == 2
    assert questions == ["Train?"] * asked


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="uses a pseudo-terminal")
def test_a_no_at_a_terminal_changes_nothing(tmp_path):
    import pty

    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "palpate", "train", "liver", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True)
    os.close(theirs)
    os.write(ours, b"n\n")
    shown = b""
    try:
        while not any(end in shown for end in (b"changed", b"making the model ready")):
            shown += os.read(ours, 1000)
        process.wait()
    finally:
        process.kill()
        os.close(ours)
    assert process.wait() == 1
    assert b"Train? [Y/n]" in shown
    assert b"stopped before it began; nothing was changed" in shown
    assert not (tmp_path / "out").exists()
