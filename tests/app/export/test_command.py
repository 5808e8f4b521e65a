"""What `palpate export` checks before it works, and that a library and a page are of one compilation."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from palpate.app.cli import main
from palpate.app.export import command
from palpate.app.train.estimate import Estimate


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ([], "--c or --web must be given, got neither"),
        (["--web", "new", "--relaxed"], "--web must be with --c where name, target or relaxed is given"),
        (["--c", "new", "--tools", "9"], "--tools must be an integer in [1, 4], got 9"),
        (["--c", "new", "--name", "9 lives"], "--name must be an identifier of C, got '9 lives'"),
        (["--c", "full"], "--c must be new or empty"),
        (["--c", "new", "--web", "full"], "--web must be new or empty"),
        (["--c", "new", "--web", "./new"], "--web must be another folder than that of --c"),
    ],
)
def test_options_are_checked_before_a_model_is_opened(tmp_path, monkeypatch, assert_refused, options, part):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "open_input", None)
    assert_refused(["export", "liver", *options], part)


def test_the_page_must_be_built_before_a_model_is_opened(tmp_path, monkeypatch, assert_refused):
    monkeypatch.setattr(command, "open_input", None)
    monkeypatch.setattr("palpate.app.export.web.PAGE_FOLDER", tmp_path)
    assert_refused(["export", "liver", "--web", str(tmp_path / "page")], "the page must be built")


def test_a_library_and_a_page_are_of_one_compilation(tmp_path, monkeypatch, capsys):
    lowered, written = [], []

    def lower(model, name, tools):
        lowered.append((model, name, tools))
        return SimpleNamespace(name=name)

    def write(library, folder, **options):
        written.append((library, folder, options.get("targets")))
        return {}

    opened = SimpleNamespace(title="Liver", training_needed=lambda console: None, reduced=lambda console: "the model")
    monkeypatch.setattr(command, "open_input", lambda *words, **options: opened)
    monkeypatch.setattr(command, "lower_model", lower)
    monkeypatch.setattr(command, "export_c", write)
    monkeypatch.setattr(command, "export_web", lambda library, folder, title: write(library, folder))
    monkeypatch.setattr(command, "check_page", lambda: None)
    monkeypatch.setattr(command, "keep", lambda name, seconds: None)
    library, page = tmp_path / "library", tmp_path / "page"
    options = ["--target", "host", "--target", "windows-x86-64", "--tools", "3"]
    assert main(["export", "liver.rom", "--c", str(library), "--web", str(page), *options]) == 0
    assert lowered == [("the model", "liver", 3)]
    assert written == [
        (written[0][0], library, ["host", "windows-x86-64"]),
        (written[0][0], page, None),
    ]
    said = capsys.readouterr().err
    assert "Liver: compiling of its step for this machine, windows-x86-64, browsers" in said
    assert "takes about" in said


def test_an_interrupt_states_what_is_complete(tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    trained = Estimate("Liver: 3 runs", {"runs": 3.0})
    opened = SimpleNamespace(title="Liver", training_needed=lambda console: trained, reduced=lambda console: "a model")
    monkeypatch.setattr(command, "open_input", lambda *words, **options: opened)
    monkeypatch.setattr(command, "lower_model", lambda *_: SimpleNamespace(name="liver"))
    monkeypatch.setattr(command, "export_c", lambda *words, **options: {})
    monkeypatch.setattr(command, "export_web", interrupted)
    monkeypatch.setattr(command, "check_page", lambda: None)
    monkeypatch.setattr(command, "keep", lambda name, seconds: None)
    library = tmp_path / "library"
    assert main(["export", "liver", "--c", str(library), "--web", str(tmp_path / "page")]) == 130
    said = capsys.readouterr().err
    assert f"interrupted the trained model is kept; {library} is complete" in said
    assert "Liver: 3 runs; then compiling of its step for this machine, browsers" in said


@pytest.mark.parametrize("missing", [None, command.STEP_TIME, command.MACHINE_TIME])
def test_the_time_is_a_guess_until_all_of_it_was_measured(monkeypatch, missing):
    monkeypatch.setattr(command, "kept_seconds", lambda name: None if name == missing else 20.0)
    estimate = command._estimate(["host"], False)
    assert estimate.is_guess == (missing is not None)
    assert ("as measured here" in estimate.lines()[1]) == (missing is None)
