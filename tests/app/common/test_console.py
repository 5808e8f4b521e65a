"""Questions of a command at a terminal."""

from __future__ import annotations

import io

import pytest

from palpate.app.common import console as consoles
from palpate.app.common.console import Console
from palpate.app.common.exit_status import RunError


def ask(monkeypatch, words, reads=True, is_terminal=True):
    monkeypatch.setattr("sys.stdin", io.StringIO(words))
    monkeypatch.setattr(consoles, "_reads_terminal", lambda: reads)
    console, shown = Console(), []
    terminal = type("Screen", (), {"is_terminal": is_terminal, "print": lambda _, text, end="": shown.append(text)})
    console._console = terminal()
    console.confirm("Train?")
    return shown


@pytest.mark.parametrize("words", ["\n", "y\n", "Yes\n"])
def test_a_yes_goes_on(monkeypatch, words):
    assert ask(monkeypatch, words) == ["Train? [Y/n] "]


@pytest.mark.parametrize("words", ["n\n", "NO\n", ""])
def test_a_no_and_the_end_of_the_input_stop(monkeypatch, words):
    with pytest.raises(RunError, match="nothing was changed"):
        ask(monkeypatch, words)


def test_another_answer_is_asked_again(monkeypatch):
    assert len(ask(monkeypatch, "perhaps\ny\n")) == 2


def test_nobody_is_asked_where_nobody_can_answer(monkeypatch):
    assert ask(monkeypatch, "n\n", reads=False) == []
    assert ask(monkeypatch, "n\n", is_terminal=False) == []
