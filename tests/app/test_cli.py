"""The command line: start, help, defaults, suggestions, names of options in messages, interrupts."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from palpate.app.cli import build_parser, main
from palpate.app.common.arguments import Parser, add_command, in_option_words
from palpate.app.common.exit_status import system_error
from palpate.scenes.names import PACKAGE_SCENES


def leaves(parser, before=()):
    """The commands of a parser: their words, and their own parsers."""
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not inner:
        yield before, parser
    for action in inner:
        for name, own in action.choices.items():
            yield from leaves(own, (*before, name))


COMMANDS = dict(leaves(build_parser()))
STUDIES = [words for words in COMMANDS if words[0] not in ("view", "replay", "laws", "new", "export")]


def test_the_command_without_arguments_prints_help_with_first_steps(capsys, tmp_path, monkeypatch):
    assert main([]) == 0
    printed, words = capsys.readouterr().out, ("first", "second", "third", "then")
    steps = [re.search(rf"^  palpate (.*?)  +{word}: ", printed, re.MULTILINE)[1] for word in words]
    assert steps == ["reproduce beam", "view beam", "view organ.stl", "new organ.stl"]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "organ.stl").touch()
    for step in steps:
        build_parser().parse_args(step.split())


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ("check --spacng 0.01 x.stl", ["palpate check: '--spacng'", "mean --spacing?", "(see palpate check --help)"]),
        ("run liver --realtme", ["'--realtme'", "mean --realtime?", "(see palpate run --help)"]),
        ("fit --boundz=C1=1 x", ["'--boundz'", "mean --bounds?", "(see palpate fit --help)"]),
        ("train beam --qqq red", ["'--qqq' is not an option of palpate train (see palpate train --help)"]),
        ("trian beam", ["COMMAND must be one of ", "got 'trian'; did you mean train?", "(see palpate --help)"]),
        (
            "run livr",
            ["SCENE|FILE must be beam, liver, membrane", "got 'livr'; did you mean liver?"],
        ),
        ("--cache run", ["palpate: --cache must be one of show, json, empty, got 'run'"]),
        ("run", ["SCENE|FILE must be given (see palpate run --help)"]),
        ("reproduce membrane --after hodl", ["--after must be one of", "did you mean hold?"]),
        ("laws more", ["palpate laws: 'more' is not expected here (see palpate laws --help)"]),
        ("reproduce beam --load", ["--load must be followed by a value"]),
        ("reproduce beam --load=", ["--load must be a number, got ''"]),
        ("laws --json=1", ["--json must be given without a value, got '1'"]),
        ("train beam --folder out", ["--folder is now called --out; give --out instead"]),
        ("view livr", ["SCENE|FILE must be beam, liver, membrane", "got 'livr'; did you mean liver?"]),
        ("fit NeoHooken pyproject.toml", ["LAW must be one of", "did you mean NeoHookean?"]),
        ("reproduce beam --poisson 0.6", ["palpate: --poisson "]),
        ("reproduce membrane --tool-radius -1", ["palpate: --tool-radius "]),
        ("train beam --held-out -1", ["palpate train: --held-out "]),
        ("train beam --set spacing=1", ["palpate: --set spacing "]),
        ("check nowhere.stl", ["FILE must be an existing file, got 'nowhere.stl'; there is no such file"]),
        ("view nowhere.rom", ["nowhere.rom"]),
    ],
)
def test_errors_name_options_as_typed(line, parts, assert_refused, tmp_path):
    words = line.split()
    options = [*words, "--out", str(tmp_path / "out")] if words[0] == "train" and "--folder" not in words else words
    assert_refused(options, *parts)


def test_a_missing_part_of_a_surface_is_named_with_its_option(assert_refused, tmp_path):
    triangles = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n{}f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    right = "v 5 0 0\nv 6 0 0\nv 5 1 0\nv 5 0 1\no right\nf 5 7 6\nf 5 6 8\nf 6 7 8\nf 5 8 7\n"
    (tmp_path / "two.obj").write_text(triangles.format("o left\n") + right)
    line = ["check", str(tmp_path / "two.obj"), "--units", "m", "--out", str(tmp_path / "out")]
    assert_refused(line, ": --part must be given for a file of 2 parts; choose one of left, right")


@pytest.fixture
def parser():
    commands = Parser("palpate").add_subparsers()
    own = add_command(commands, "carve", "builtins:print", summary="", description="")
    own.add_argument("file", metavar="FILE")
    own.add_argument("--tool-radius")
    own.add_argument("--part")
    own.add_argument("--set", dest="given")
    own.synonyms["close"] = "--repair"
    own.assignments["given"] = "--set"
    return own


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("tool_radius must be positive, got -1", "--tool-radius must be positive, got -1"),
        ("tool_radius = -1 is out of range", "--tool-radius = -1 is out of range"),
        ("it has two parts: choose one with part='a'", "it has two parts: choose one with --part 'a'"),
        ("choose one with part=: a, b", "choose one with --part: a, b"),
        ("close it with close=True, or by hand", "close it with --repair, or by hand"),
        ("file must be a surface", "FILE must be a surface"),
        ("depth must be positive", "--set depth must be positive"),
        ("the file is truncated; the part=1.5 of it is left", "the file is truncated; the --part 1.5 of it is left"),
        ("liver.part must be closed; counterpart=3", "liver.part must be closed; counterpart=3"),
        ("a part must be closed", "a part must be closed"),
    ],
)
def test_messages_of_the_library_are_translated_to_options(parser, message, expected):
    assert in_option_words(message, parser, {"given": ["depth=-1"]}) == expected


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_option_is_described_and_shows_its_default_in_one_form(words):
    parser = COMMANDS[words]
    for action in parser._actions:
        assert action.help, action
        text = parser._get_formatter()._expand_help(action)
        own = action.default
        if action.dest != "help" and own not in (None, []) and not isinstance(own, bool):
            shown = " ".join(map(str, own)) if isinstance(own, list) else own
            shown = f"{shown:g}" if isinstance(shown, float) else shown
            assert text.endswith(f" (default: {shown})"), text
        assert text.count("(default: ") <= 1
        assert not re.search(r"\((?!default: |[a-z]+ only)[\w., ]*\d[\w., ]*\)$", text), text


@pytest.mark.parametrize("command", ["train", "view"])
def test_the_help_names_every_scene_to_train_on(command):
    (scene,) = (action for action in COMMANDS[command,]._actions if not action.option_strings)
    assert set(PACKAGE_SCENES) <= set(re.findall(r"[a-z]+", scene.help))


@pytest.mark.parametrize("words", STUDIES, ids=" ".join)
def test_every_study_has_the_option_out(words):
    options = COMMANDS[words]._option_string_actions
    assert {"--out", "--json"} <= options.keys()
    assert options["--out"].metavar == "FOLDER"


def test_system_errors_have_readable_messages(tmp_path):
    with pytest.raises(FileNotFoundError) as missing:
        (tmp_path / "nowhere").read_text()
    assert system_error(missing.value) == f"there is no file {str(tmp_path / 'nowhere')!r}"
    assert system_error(PermissionError(13, "Permission denied", "locked")) == "'locked': permission denied"
    assert (
        system_error(OSError("cannot write here; choose another folder")) == "cannot write here; choose another folder"
    )


@pytest.mark.parametrize(
    "option", [["--help"], ["--version"], ["reproduce", "membrane", "--help"], ["run", "beam", "--help"]]
)
def test_help_and_version_load_nothing_heavy(option):
    code = (
        "import sys\nfrom palpate.app.cli import main\n"
        f"try:\n    main({option!r})\nexcept SystemExit as end:\n    assert not end.code\n"
        "print(*sorted({name.split('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stderr.split())
    assert not loaded & {
        "numba",
        "numpy",
        "scipy",
        "h5py",
        "matplotlib",
        "pyvista",
        "vtkmodules",
        "rich",
        "argcomplete",
    }
    assert "palpate" in run.stdout


@pytest.mark.parametrize("swallows", [False, True])
def test_an_interrupt_while_modules_are_imported_is_one_line(swallows, tmp_path):
    """A slow module in the place of one that every study imports, which may turn an interrupt into another error."""
    kind = "BaseException" if swallows else "ZeroDivisionError"
    begin = "print('importing', flush=True)\n    import time; time.sleep(60)"
    text = f"try:\n    {begin}\nexcept {kind}:\n    raise ImportError"
    (tmp_path / "rich.py").write_text(text)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)])}
    command = [sys.executable, "-m", "palpate", "reproduce", "beam", "--out", str(tmp_path / "out")]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:  # fmt: skip
        assert process.stdout.readline() == "importing\n"
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 130
    assert said == "palpate: interrupted\n"
    assert not (tmp_path / "out").exists()


def test_completion_is_loaded_only_on_request_of_a_shell(monkeypatch, capsys):
    asked = []
    monkeypatch.setitem(sys.modules, "argcomplete", SimpleNamespace(autocomplete=asked.append))
    assert main([]) == 0
    assert asked == []
    capsys.readouterr()
    monkeypatch.setenv("_ARGCOMPLETE", "1")
    assert main(["laws"]) == 0
    assert isinstance(asked[0], Parser)
    monkeypatch.setitem(sys.modules, "argcomplete", None)
    assert main(["laws"]) == 1
    assert capsys.readouterr().out == ""
