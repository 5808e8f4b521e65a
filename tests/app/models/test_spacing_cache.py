"""Spacings that are kept for the next start of a view."""

from __future__ import annotations

import json

import pytest

from palpate.app.common import machine
from palpate.app.common.machine import MAX_VALUES
from palpate.app.models.spacing_cache import cache_spacing, cached_spacing


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """The file of an empty cache folder."""
    monkeypatch.setattr(machine, "cache_folder", lambda: tmp_path / "palpate")
    return tmp_path / "palpate" / "spacings.json"


def test_a_spacing_is_kept_and_the_last_one_counts(kept):
    assert cached_spacing("organ") is None
    cache_spacing("organ", 0.005)
    cache_spacing("other", 0.007)
    cache_spacing("organ", 0.006)
    assert (cached_spacing("organ"), cached_spacing("other")) == (0.006, 0.007)


def test_the_oldest_are_dropped(kept):
    kept.parent.mkdir()
    kept.write_text(json.dumps({str(k): 0.004 for k in range(MAX_VALUES)}))
    cache_spacing("new", 0.005)
    assert cached_spacing("0") is None
    assert cached_spacing("1") == 0.004
    assert cached_spacing("new") == 0.005


@pytest.mark.parametrize("content", ["", "[1]", '{"organ": "5 mm"}', '{"organ": 1e9}', '{"organ": -1.0}', "\x00" * 9])
def test_a_damaged_file_counts_as_none(kept, content):
    kept.parent.mkdir()
    kept.write_text(content)
    assert cached_spacing("organ") is None
    cache_spacing("organ", 0.005)
    assert cached_spacing("organ") == 0.005


def test_a_folder_that_cannot_be_made_keeps_nothing(kept):
    kept.parent.write_text("a file")
    cache_spacing("organ", 0.005)
    assert cached_spacing("organ") is None
