"""What `palpate view` does with its options and its end: recordings are written, and cost no other file."""

from __future__ import annotations

import os
import signal
import threading
import time

import h5py
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.models.trained import model_file
from palpate.app.recordings.recording import load_recording, save_recording
from palpate.app.session.session import Session
from palpate.app.view import command
from palpate.app.view.body_menu import has_menu
from palpate.app.view.refinement import is_trained
from palpate.app.view.server.host import Host

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def file(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "block.rom"
    pt.save(model, path)
    return path


@pytest.fixture
def ended(monkeypatch):
    """A function that sends this process a signal once a session has recorded something."""
    made, sent, is_served = [], [], threading.Event()
    start, wait_for_viewers = Session.start, Host.wait
    monkeypatch.setattr(Session, "start", lambda self: (made.append(self), start(self)))
    monkeypatch.setattr(Host, "wait", lambda self: (is_served.set(), wait_for_viewers(self)))

    def saving(path, recording):
        for number in sent:  # once more, while the recording is written
            os.kill(os.getpid(), number)
        save_recording(path, recording)

    monkeypatch.setattr("palpate.app.session.recordings.save_recording", saving)

    def send(number, *, begin=False):
        def wait():
            while not made:
                time.sleep(0.01)
            if begin:
                made[0].recordings.start()
                is_served.wait()  # before that an interrupt ends the preparation
            while made[0].recordings.recorder is None or len(made[0].recordings.recorder.times) < 5:
                time.sleep(0.01)
            sent.extend([number] if number != signal.SIGINT else [])
            os.kill(os.getpid(), number)

        threading.Thread(target=wait, daemon=True).start()

    return send


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
@pytest.mark.parametrize(
    "more", [["run", "--script", "none.jsonl", "--seconds", "60"], ["view", "--no-browser", "--port", "18990"]]
)
def test_a_recording_survives_the_signals_that_end_a_program(file, tmp_path, ended, name, more, monkeypatch):
    number = getattr(signal, name)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "none.jsonl").write_text("")
    before = signal.signal(number, signal.SIG_DFL)  # ignored where the tests run under nohup
    try:
        ended(number)
        with pytest.raises(SystemExit) as end:
            main([more[0], str(file), "--record", str(tmp_path / "run.h5"), *more[1:]])
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, before)
    assert end.value.code == 128 + number
    assert len(load_recording(tmp_path / "run.h5").snapshots) >= 5


def test_a_recording_of_the_page_survives_the_end_of_the_server(file, tmp_path, ended, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background
    try:
        ended(signal.SIGINT, begin=True)
        assert main(["view", str(file), "--no-browser", "--port", "18990"]) == 0
    finally:
        signal.signal(signal.SIGINT, before)
    (written,) = (tmp_path / "out" / "view").glob("*.h5")
    assert len(load_recording(written).snapshots) >= 5
    assert "recorded" in capsys.readouterr().err


def test_a_recording_overwrites_no_other_file(file, tmp_path, assert_refused):
    (tmp_path / "none.jsonl").write_text("")
    run = ["run", str(file), "--script", str(tmp_path / "none.jsonl"), "--out", str(tmp_path / "out")]
    run += ["--seconds", "0.1", "--record"]
    content = file.read_bytes()
    assert_refused([*run, str(file)], "record must end in .h5")
    assert_refused([*run, str(tmp_path / "r.vtkhdf")], "record must end in .h5")
    (tmp_path / "link.h5").symlink_to(file)
    assert_refused([*run, str(tmp_path / "link.h5")], "another file than the model")
    (tmp_path / "text.h5").write_text("precious")
    assert_refused([*run, str(tmp_path / "text.h5")], "text.h5 is another file")
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other.attrs["format"] = "another"
    assert_refused([*run, str(tmp_path / "other.h5")], "other.h5 is another file")
    (tmp_path / "folder.h5").mkdir()
    assert_refused([*run, str(tmp_path / "folder.h5")], "folder.h5 is another file")
    (tmp_path / "fresh.vtkhdf").write_text("precious")
    assert_refused([*run, str(tmp_path / "fresh.h5")], "fresh.vtkhdf is another file")
    assert file.read_bytes() == content
    assert (tmp_path / "text.h5").read_text() == (tmp_path / "fresh.vtkhdf").read_text() == "precious"
    assert main([*run, str(tmp_path / "new.h5")]) == 0
    assert main([*run, str(tmp_path / "new.h5")]) == 0  # an earlier recording gives way


def test_a_recording_that_was_not_written_ends_with_status_1(file, tmp_path, monkeypatch, capsys):
    def full(path, recording):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("palpate.app.session.recordings.save_recording", full)
    path = tmp_path / "new.h5"
    (tmp_path / "none.jsonl").write_text("")
    run = ["run", str(file), "--script", str(tmp_path / "none.jsonl"), "--out", str(tmp_path / "out")]
    assert main([*run, "--seconds", "0.3", "--record", str(path)]) == 1
    said = capsys.readouterr().err
    assert "the recording was not written" in said
    assert load_recording(path).snapshots
    monkeypatch.undo()
    main([*run, "--seconds", "0.1", "--record", str(path)])  # replaces the journal


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\xff\xfe{}", "not text in UTF-8"),
        (b'{"time": 0, "type": "release"}\n' + b"[" * 30_000, "line 2"),
        (b'{"time": 1e999, "type": "release"}', "line 1"),
        (b'{"time": true, "type": "release"}', "line 1"),
        (b'{"time": 0, "type": "force", "rate": 1}', "in a script"),
    ],
)
def test_invalid_scripts_are_refused(file, tmp_path, assert_refused, content, said):
    (tmp_path / "script.jsonl").write_bytes(content)
    assert_refused(["run", str(file), "--script", str(tmp_path / "script.jsonl")], said)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes of a name")
def test_a_script_that_is_a_pipe_is_refused_at_once(file, tmp_path, assert_refused):
    os.mkfifo(tmp_path / "script.jsonl")
    script = str(tmp_path / "script.jsonl")
    assert_refused(["run", str(file), "--script", script], "must be a regular file")


@pytest.fixture
def shown(monkeypatch):
    """A function that runs the command, and returns its input, whether the full body is shown, and if it is refined."""

    def run(*words):
        found = []
        monkeypatch.setattr(command, "_show", lambda each, *more: found.append((each.opened, each.full, more[3])) or [])
        assert main(["view", *words, "--no-browser"]) == 0
        return found[0]

    return run


@pytest.mark.quick
@pytest.mark.parametrize("name", ["beam", "liver", "membrane"])
def test_a_scene_of_the_package_shows_its_full_body_at_once(shown, name):
    opened, full, refined = shown(name)
    assert (opened.scene.name, full, refined) == (name, True, False)


@pytest.mark.quick
def test_forceps_pull_the_end_of_a_held_solid_which_is_damped_unless_a_user_sets_it(shown):
    for words, end, damping in (
        (["beam"], "x+", 8.0), (["beam", "--set", "mass_damping=0"], "x+", 0.0), (["membrane"], "", 0.0),
    ):  # fmt: skip
        opened = command.damped(shown(*words)[0])
        assert command.end_of(opened) == end
        assert opened.scene.description.tissue.mass_damping == damping
    assert not has_menu(pt.open_scene("membrane"))
    assert has_menu(pt.open_scene("beam"))


@pytest.mark.quick
def test_the_reduced_model_is_waited_for_on_request(shown, assert_refused, capsys):
    opened, full, _ = shown("liver", "--reduced")
    assert opened.scene is not None
    assert not full
    assert "30 runs of its full body" in capsys.readouterr().err  # the estimate of the training
    assert_refused(["view", "liver", "--reduced", "--refine"], "--refine must be left out unless a page shows a full")


@pytest.mark.quick
def test_a_kept_model_takes_over_if_tools_touch_its_body(monkeypatch, tmp_path):
    monkeypatch.setattr("palpate.app.train.scene_folder.cache_folder", lambda: tmp_path)
    for name, takes_over in (("liver", True), ("beam", False), ("membrane", False)):
        scene = pt.open_scene(name)
        assert not is_trained(scene)
        model_file(scene).parent.mkdir()
        model_file(scene).write_bytes(b"")
        assert is_trained(scene) == takes_over
    monkeypatch.setattr("palpate.app.train.scene_folder.cache_folder", lambda: None)
    assert not is_trained(pt.open_scene("liver"))
