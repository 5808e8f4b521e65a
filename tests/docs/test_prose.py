"""Prose in the README and the docs: lines of at most 100 characters, and short sentences."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.lint

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "docs"))
wrap = __import__("wrap")


MAX_WORDS = 45  # of a sentence between marks; 25 is the aim, which a count of words cannot judge alone
SITE_ENDS = "<!-- The site shows what stands above. -->"
LISTS_OF_FIELDS = {"protocol.md", "ARCHITECTURE.md"}  # pages with items that list the fields of a message or a flow


def test_prose_is_wrapped():
    texts = {page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8") for page in wrap.pages()}
    long = [name for name, text in texts.items() if wrap.wrapped(text) != text]
    assert not long, f"lines of prose are too long in {long}; run: python docs/wrap.py"


def test_sentences_are_short():
    for page in wrap.pages():
        if page.name in LISTS_OF_FIELDS:
            continue
        prose = (" ".join(lines) for is_prose, lines in wrap.blocks(page.read_text(encoding="utf-8")) if is_prose)
        sentences = [sentence for block in prose for sentence in re.split(r"(?<=[.!?:;])\s+", block)]
        assert [sentence for sentence in sentences if len(sentence.split()) > MAX_WORDS] == [], page.name


def test_the_site_shows_the_newest_changes_alone():
    site, mark, more = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").partition(SITE_ENDS)
    assert mark, "CHANGELOG.md must have the mark where the site's page ends"
    assert len(site.split()) <= 600, "the site's changelog has more than 600 words"
    assert "\n## 0.1.0" in more
    assert SITE_ENDS in (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")


def test_prose_is_filled_and_the_rest_is_kept():
    long = " ".join(["word"] * 30)
    table, code, block = f"| {long} |", f"    {long}", f"<!-- figures: tips -->\n{long}\n<!-- end -->"
    page = f"# {long}\n\n{long}\n\n- {long}\n  more\n- short\n\n{table}\n\n{code}\n\n```\n{long}\n```\n\n{block}\n"
    new = wrap.wrapped(page)
    assert new.split() == page.split()
    assert {line for line in new.split("\n") if len(line) > wrap.WIDTH} == {f"# {long}", table, code, long}
    assert new.count(long) == 5  # heading, table, code twice, block
    assert "\n  word" in new  # the item keeps its indent
    assert wrap.wrapped(new) == new


def test_equations_are_kept():
    long = " + ".join(["x"] * 60)
    page = f"Text\n\n$$\n{long}\n{long}\n$$\n\n\\begin{{equation*}}\n{long}\n{long}\n\\end{{equation*}}\n"
    assert wrap.wrapped(page) == page


def test_code_is_not_broken_and_a_dash_begins_no_line():
    page = ("x" * 97) + " - y `a b` " + ("z" * 90) + " `one two three`\n"
    assert [line.strip() for line in wrap.wrapped(page).splitlines()] == [
        "x" * 97 + " -", "y `a b` " + "z" * 90, "`one two three`",
    ]  # fmt: skip


def test_no_line_begins_with_the_mark_of_a_comment():
    assert wrap.wrapped(f"{'x' * 97} 30\n% of it\n") == f"{'x' * 97}\n30 % of it\n"
    for page in wrap.pages():
        prose = [
            line for is_prose, lines in wrap.blocks(page.read_text(encoding="utf-8")) if is_prose for line in lines
        ]
        assert not [line for line in prose if line.lstrip().startswith("%")], page.name  # the site would not show it


def test_wrapping_keeps_the_words_of_every_page(monkeypatch):
    monkeypatch.setattr(wrap, "WIDTH", 40)
    for page in wrap.pages():
        text = page.read_text(encoding="utf-8")
        assert wrap.wrapped(text).split() == text.split()
