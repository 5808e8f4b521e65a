"""Measurements of this machine that are kept for later commands."""

from __future__ import annotations

import pytest

from palpate.app.common import machine
from palpate.app.common.machine import keep, kept_seconds, kept_text


@pytest.fixture
def file(tmp_path, monkeypatch):
    """The file of an empty cache folder."""
    monkeypatch.setattr(machine, "cache_folder", lambda: tmp_path / "palpate")
    return tmp_path / "palpate" / "machine.json"


def test_times_and_texts_are_kept_and_the_last_ones_count(file):
    assert (kept_seconds("step"), kept_text("code")) == (None, "")
    keep("step", 2.0)
    keep("code", "ab")
    keep("step", 3.0)
    assert (kept_seconds("step"), kept_text("code")) == (3.0, "ab")
    assert (kept_seconds("code"), kept_text("step")) == (None, "")


@pytest.mark.parametrize("content", ["", "[1]", '{"step": "2 s"}', '{"step": 1e9}', '{"step": -1.0}', "\x00" * 9])
def test_a_damaged_file_counts_as_none(file, content):
    file.parent.mkdir()
    file.write_text(content)
    assert kept_seconds("step") is None
    keep("step", 2.0)
    assert kept_seconds("step") == 2.0


def test_a_folder_that_cannot_be_made_keeps_nothing(file):
    file.parent.write_text("a file")
    keep("step", 2.0)
    assert kept_seconds("step") is None
