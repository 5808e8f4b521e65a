"""Nested levels of texts in JSON and TOML are counted before a parser recurses."""

from __future__ import annotations

import json
import tomllib

import pytest

import palpate as pt
from palpate.core.files import check_nesting, json_of

BRACKETS = "[" * 40


@pytest.mark.parametrize("opening", ["[" * 30_000, '{"a":' * 30_000, BRACKETS + "]" * 40, '["\\"", ' + BRACKETS])
def test_deep_json_is_refused_before_it_is_parsed(opening, monkeypatch):
    monkeypatch.setattr(json, "loads", lambda *_, **__: pytest.fail("the text was parsed"))
    with pytest.raises(pt.InputError, match="JSON text has more than 32 nested levels"):
        json_of(opening)


@pytest.mark.parametrize(
    "value", [[[]] * 1000, [BRACKETS], {'"' + BRACKETS: "\\" + BRACKETS}, ["'", BRACKETS], ["#", BRACKETS, '"""']]
)
def test_json_of_few_levels_is_read_whatever_its_strings_hold(value):
    assert json_of(json.dumps(value)) == value
    assert json_of(json.dumps(value).encode()) == value


@pytest.mark.parametrize(
    "text",
    [
        f"a = '''{BRACKETS}'' '''",
        f'a = """{BRACKETS}\\"""" # " {BRACKETS}',
        f"a = '\"' # {BRACKETS}\nb = '{BRACKETS}'",
        "a = [" + "[1], " * 100 + "]",
    ],
)
def test_toml_of_few_levels_passes_whatever_its_strings_and_comments_hold(text):
    tomllib.loads(text)
    check_nesting(text, "TOML")


def test_json_of_32_levels_is_read_and_of_33_is_refused():
    assert json_of("[" * 32 + "]" * 32)
    with pytest.raises(pt.InputError, match="32 nested levels"):
        json_of("[" * 33 + "]" * 33)
