"""Every option of every command with hostile values: done or refused, in one line, without a traceback."""

from __future__ import annotations

import argparse
import itertools
import os
import subprocess
import sys

import pytest

import palpate as pt
from palpate.app.cli import build_parser, main

WORDS = (
    "", " ", "-1", "0", "nan", "inf", "-inf", "1e999", "1e-320", "5e-324", "1e-9", "1e308", "1" + "0" * 400, "0x10",
    "\u0661\u0662", "1_0", "x" * 300, "x" * 5000, "a/" * 2500, "null\0byte", "two\nlines", "\x1b[31m", "\ud800",
    "\udcff", "=", "spacing=nan", "spacing=1e-9", "spacing=" + "9" * 5000, "C1=1", "C1=nan,1e999", "a=b=c", "{}",
    "C1=" + "[" * 4000, "spacing=1 kg", "every=1", "region=3",
    "os:system", "../..", "/", "/dev/null", "/dev/zero", "~", "%s%n", "--", "127.0.0.1", "::1%lo",
)  # fmt: skip
POSITIONAL = {"scene": "beam", "source": "beam", "law": "NeoHookean"}  # of others: a file that is missing


class Reached(pt.InputError):
    """The command has accepted its options and begins to work."""


@pytest.fixture
def idle(monkeypatch, tmp_path):
    """Commands that stop, refused, where they would begin to work."""

    def stop(*_arguments, **_options):
        raise Reached("nothing is computed here")

    for place in (
        "palpate.scenes.beam.Solid", "palpate.scenes.body.Solid", "palpate.scenes.body.Membrane",
        "palpate.scenes.membrane.Membrane", "palpate.scenes.body.fill",
        "palpate.app.fit.command.fit",
        "palpate.app.run.realtime.running_session", "palpate.app.train.command.open_campaign",
        "palpate.app.models.input.Input.training_needed", "palpate.app.train.command.estimate_training",
        "palpate.app.view.command._show",
        "palpate.app.view.server.host.serve_source",
    ):  # fmt: skip
        monkeypatch.setattr(place, stop)
    monkeypatch.setattr("palpate.app.train.command.check_dask", stop)
    monkeypatch.setattr("palpate.app.cli.build_parser", lambda: PARSER)  # building it takes most of the time
    monkeypatch.chdir(tmp_path)


def leaves(parser, before=()):
    """The commands of a parser: their words, and their own parsers."""
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not inner:
        yield before, parser
    for action in inner:
        for name, own in action.choices.items():
            yield from leaves(own, (*before, name))


PARSER = build_parser()
COMMANDS = dict(leaves(PARSER))


def command_line(words, parser, tried, value):
    """A command line in which one action has a value, and others only what they must have."""
    line = list(words)
    for action in parser._actions:
        if action is tried:
            line += [*action.option_strings[-1:], *([] if action.nargs == 0 else [value])]
        elif action.option_strings:
            line += action.option_strings[-1:] if action.required else []
        else:
            choices = list(action.choices or [])
            line.append((choices or [POSITIONAL.get(action.dest, "missing.csv")])[0])
    return line


def outcome(line, capsys):
    try:
        code = main(line)
    except SystemExit as end:
        code = end.code
    return code, [text for text in capsys.readouterr().err.splitlines() if not text.endswith(" ...")]


@pytest.mark.slow
@pytest.mark.quick(words=[("fit",), ("laws",)])
@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_no_value_of_any_option_ends_in_a_traceback(words, idle, capsys):
    parser = COMMANDS[words]
    for action, value in itertools.product(parser._actions, WORDS):
        if isinstance(action, argparse._HelpAction):
            continue
        line = command_line(words, parser, action, value)
        code, said = outcome(line, capsys)
        assert code in (0, 2), (line, code, said)
        assert len(said) == (code == 2), (line, said)
        if said:
            assert said[0].startswith("palpate"), (line, said)
            assert len(said[0]) < 1200, line
            assert said[0].isprintable(), line


def test_the_tests_cover_all_commands():
    assert {words[0] for words in COMMANDS} >= {"reproduce", "run", "train", "view", "replay", "fit", "check"}
    assert len(COMMANDS) >= 11


@pytest.mark.parametrize("option", ["run beam --realtime --model", "run beam --script", "check", "replay",
                                    "fit NeoHookean"])  # fmt: skip
def test_pipes_and_folders_are_refused_as_input_files(option, idle, tmp_path, assert_refused):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for place in (pipe, tmp_path):
        assert_refused([*option.split(), str(place)], str(place), "must be a regular file")
    assert_refused([*option.split(), str(tmp_path / "none")], str(tmp_path / "none"), "must be an existing file")


@pytest.mark.parametrize("text", [b"\xff\xfe", b"[" * 100_000, b'{"type": "pose", "time": 1e999}', b"[9, " * 20])
def test_invalid_scripts_are_refused_with_the_line(text, idle, tmp_path, assert_refused):
    script = tmp_path / "script.jsonl"
    script.write_bytes(text)
    assert_refused(["run", "beam", "--script", str(script)], str(script))


def test_an_internal_error_prints_one_line_and_writes_its_traceback_to_a_file(monkeypatch, capsys, tmp_path):
    def fail(as_json):
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.setattr("palpate.app.laws.command.laws", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    code, said = outcome(["laws"], capsys)
    (file,) = tmp_path.iterdir()
    assert code == 70
    assert said == [f"palpate: internal error: ZeroDivisionError: division by zero; report it with {file}"]
    assert "Traceback" in file.read_text()
    monkeypatch.setenv("PALPATE_DEBUG", "1")
    code, said = outcome(["laws"], capsys)
    assert code == 70
    assert said[0] == "Traceback (most recent call last):"


def test_running_out_of_memory_prints_one_line(monkeypatch, capsys):
    def fail(as_json):
        raise MemoryError

    monkeypatch.setattr("palpate.app.laws.command.laws", fail)
    code, said = outcome(["laws"], capsys)
    assert code == 1
    assert said == ["palpate: out of memory; take a larger spacing, fewer modes, or fewer snapshots"]


@pytest.mark.parametrize(("to", "code"), [("closed pipe", 1), ("/dev/full", 1)])
def test_output_to_a_closed_pipe_ends_quietly(to, code):
    if to == "closed pipe":
        read, write = os.pipe()
        os.close(read)
    else:
        write = os.open(to, os.O_WRONLY)
    done = subprocess.run([sys.executable, "-m", "palpate", "laws"], stdout=write, stderr=subprocess.PIPE, check=False)
    os.close(write)
    assert done.returncode == code
    said = done.stderr.decode().splitlines()
    assert len(said) == (to != "closed pipe")


OWN = {
    "raises": "raise RuntimeError('no')", "exits": "raise SystemExit(3)", "wrong": "def scene(:",
    "none": "other = 1", "returns": "def scene(a=1): return a", "fails": "def scene(a=1): return a / 0",
    "bare": "def scene(a): return a", "listed": "def scene(a=()): return a",
}  # fmt: skip


@pytest.mark.parametrize("kind", OWN)
def test_a_failing_user_scene_is_refused_by_name(kind, tmp_path, monkeypatch, assert_refused):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    module = f"own_{kind}_scene"
    (tmp_path / f"{module}.py").write_text(OWN[kind])
    assert_refused(["train", f"{module}:scene"], f"{module}:scene")


def test_a_scene_in_the_current_folder_is_found(tmp_path, monkeypatch, assert_refused):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    (tmp_path / "own_found_scene.py").write_text(
        "from palpate.core.faults import InputError\ndef scene(size=1.0):\n    raise InputError(f'found with {size}')"
    )
    assert_refused(["train", "own_found_scene:scene", "--set", "size=2"], "found with 2.0")


@pytest.mark.parametrize(
    "given", ["spacing=nan", "spacing=1e999", "spacing=1e-9", "every=1e-320", "lasting=inf", "poisson=" + "9" * 5000]
)
def test_parameters_of_scenes_are_checked_before_memory_is_allocated(given, tmp_path, monkeypatch, assert_refused):
    monkeypatch.chdir(tmp_path)
    assert_refused(["train", "beam", "--set", given], given.partition("=")[0])
