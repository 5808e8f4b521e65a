"""Tables of README and docs are those that docs/figures.py makes from the committed result files."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.lint

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "docs"))
figures = __import__("figures")
sys.path.append(str(ROOT / "validation"))
result_files = __import__("result_files")

PAGES = [page for page in figures.pages() if "<!-- figures: " in page.read_text(encoding="utf-8")]
FILES = sorted((ROOT / "docs" / "validation").glob("*.json"))


def names(page):
    return [match[2] for match in figures.BLOCK.finditer(page.read_text(encoding="utf-8"))]


def test_every_block_of_a_page_is_what_its_result_files_make():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert figures.rewritten(page) == text, f"stale figures in {page.name}; run: python docs/figures.py"
        assert len(names(page)) == text.count("<!-- figures: "), f"a block of {page.name} has no end"


def test_every_block_and_every_result_file_is_on_a_page():
    used = {name for page in PAGES for name in names(page)}
    assert used <= set(figures.BLOCKS)
    shown = {file for name in used for file in figures.BLOCKS[name].files}
    assert shown == {path.stem for path in FILES}


def test_result_files_name_what_made_them():
    for path in FILES:
        content = json.loads(path.read_text(encoding="utf-8"))
        assert set(content) == {"made", "results"}, path.name
        for entry in content["made"]:
            assert re.fullmatch(r"[0-9a-f]{7,}\+?", entry["commit"]), path.name
            assert re.fullmatch(r"\d{4}-\d\d-\d\d", entry["date"]), path.name
        assert path.read_text(encoding="utf-8") == result_files.text(content), path.name


def test_a_changed_result_changes_its_block(monkeypatch):
    page = ROOT / "README.md"
    before = figures.text("frequencies_energy", page)
    content = figures.content("frequencies")
    for row in content["results"]:
        row["bending_error"] += 0.1
    monkeypatch.setattr(figures, "content", lambda name: content)
    assert figures.text("frequencies_energy", page) != before


def test_a_table_names_the_last_run_of_its_command(monkeypatch):
    old, part, whole = (
        {"commit": commit, "date": "2026-01-01", **command}
        for commit, command in (
            ("1111111", {}), ("2222222", {"command": "a.py b"}), ("3333333", {"command": "a.py"})
        )
    )  # fmt: skip
    page = ROOT / "README.md"
    for made, command, commit in (
        ([old], "a.py b", old), ([old, part], "a.py b", part), ([old, part], "a.py c", old),
        ([old, part, whole], "a.py b", whole), ([old, whole, part], "a.py c", whole),
        ([old, part], "z.py` and `a.py b", part), ([old, whole], "a.pyx", old),
    ):  # fmt: skip
        monkeypatch.setattr(figures, "content", lambda name, made=made: {"made": made})
        assert commit["commit"] in figures.origin("tips", command, page)
    monkeypatch.setattr(figures, "content", lambda name: {"made": [part]})
    with pytest.raises(ValueError, match=r"tips\.json must have a run of a\.py c"):
        figures.origin("tips", "a.py c", page)


def test_written_results_are_read_again_with_their_origin(tmp_path, monkeypatch):
    monkeypatch.setattr(result_files, "FOLDER", tmp_path)
    assert result_files.read("heights", []) == []
    for height in (1.0, 2.0):
        result_files.write("heights", [{"height": height}], "python heights.py")
    result_files.write("heights", [{"height": 2.0}, {"height": 3.0}], "python heights.py --more")
    assert result_files.read("heights", []) == [{"height": 2.0}, {"height": 3.0}]
    made = json.loads((tmp_path / "heights.json").read_text(encoding="utf-8"))["made"]
    assert [entry["command"] for entry in made] == ["python heights.py", "python heights.py --more"]
    assert all(entry["machine"] and entry["commit"] for entry in made)


SHARES = {0.0: "0 %", 3e-8: "< 0.001 %", 0.00123: "0.12 %", 0.0999: "10 %", 0.236: "24 %", 1.0316: "103 %"}


def test_shares_have_two_significant_digits():
    percent = sys.modules["figure_tables.cells"].percent
    assert {value: percent(value) for value in SHARES} == SHARES
