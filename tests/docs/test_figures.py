"""Tables of README and docs are those that docs/figures.py makes from the committed result files."""

from __future__ import annotations

import importlib
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
BEFORE_DIGESTS = "2026-11-30"  # runs until then have none
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


def block_of(command, *files, timed=False):
    return figures.Block(len, files, command, timed)


def test_a_table_names_the_last_run_of_its_command(monkeypatch):
    old, part, whole = (
        {"commit": commit, "date": "2026-01-01", **command}
        for commit, command in (
            ("1111111", {"command": "a.py"}), ("2222222", {"command": "a.py b"}), ("3333333", {"command": "a.py"})
        )
    )  # fmt: skip
    for made, command, commit in (
        ([old], "a.py b", old), ([old, part], "a.py b", part), ([old, part], "a.py c", old),
        ([old, part, whole], "a.py b", whole), ([old, whole, part], "a.py c", whole),
        ([old, part], "z.py` and `a.py b", part),
    ):  # fmt: skip
        monkeypatch.setattr(figures, "content", lambda name, made=made: {"made": made})
        assert [run for _, run in figures.runs_of("tips", block_of(command))][-1] is commit
    monkeypatch.setattr(figures, "content", lambda name: {"made": [part]})
    with pytest.raises(ValueError, match=r"tips\.json must have a run of a\.py c"):
        figures.runs_of("tips", block_of("a.py c"))


RUN = {
    "command": "a.py", "commit": "1111111", "date": "2026-12-01", "note": "next to other work (load 9)",
    "machine": "2 cores, Intel(R) Xeon(R) Processor @ 2.50GHz, Linux",
}  # fmt: skip
ONE = "commit 1111111, 2026-12-01, 2 cores Intel Xeon 2.50GHz"


def origin(monkeypatch, table="| a |", timed=False, **runs):
    monkeypatch.setattr(figures, "content", lambda name: {"made": [runs[name]]})
    return figures.origin(block_of("a.py", *runs, timed=timed), ROOT / "docs" / "claims" / "page.md", table)


def test_the_line_below_a_table_has_command_commit_date_machine_and_file(monkeypatch):
    assert origin(monkeypatch, tips=RUN) == f"`a.py`, {ONE} ([tips](../validation/tips.json))"


def test_files_of_one_run_share_its_line_and_others_follow(monkeypatch):
    links = [f"[{name}](../validation/{name}.json)" for name in ("tips", "land")]
    assert origin(monkeypatch, tips=RUN, land=RUN) == f"`a.py`, {ONE} ({', '.join(links)})"
    other = {**RUN, "commit": "2222222"}
    both = f"`a.py`, {ONE} ({links[0]}); {ONE.replace('1111111', '2222222')} ({links[1]})"
    assert origin(monkeypatch, tips=RUN, land=other) == both


def test_a_file_of_two_runs_has_both_with_their_commands(monkeypatch):
    other = {**RUN, "command": "b.py", "commit": "2222222"}
    monkeypatch.setattr(figures, "content", lambda name: {"made": [RUN, other]})
    line = figures.origin(block_of("a.py` and `b.py", "tips"), ROOT / "README.md", "")
    link = "([tips](docs/validation/tips.json))"
    assert line == f"`a.py`, {ONE}; `b.py`, {ONE.replace('1111111', '2222222')} {link}"


def test_other_work_is_stated_below_tables_of_times_alone(monkeypatch):
    assert "other work" not in origin(monkeypatch, tips=RUN)
    assert f"{ONE}, next to other work (load 9)" in origin(monkeypatch, timed=True, tips=RUN)


def test_a_command_that_the_table_has_is_not_repeated(monkeypatch):
    assert origin(monkeypatch, table="| `a.py` |", tips=RUN) == f"{ONE} ([tips](../validation/tips.json))"


def test_results_older_than_the_code_are_listed_with_what_changed(monkeypatch):
    changes = {"1111111": [], "2222222": ["src/palpate/dynamics/solid", "validation/tips.py"], "3333333": None}
    runs = {("tips", "a.py"): "1111111", ("land", "b.py"): "2222222", ("bench", "c.py"): "3333333"}
    entries = {key: {"commit": commit, "date": "2026-12-01"} for key, commit in runs.items()}
    monkeypatch.setattr(figures, "shown", lambda: entries)
    monkeypatch.setattr(figures.result_files, "changed", lambda run: changes[run["commit"]])
    text = figures.stale()
    assert "| land | `b.py` | 2026-12-01 | `dynamics/solid`, `validation/tips.py` |" in text
    assert "Made until 2026-12-01, before digests were kept: bench." in text
    assert "tips |" not in text
    monkeypatch.setattr(figures, "shown", lambda: {("tips", "a.py"): entries["tips", "a.py"]})
    assert figures.stale() == "None."


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_run_has_a_command_a_commit_a_machine_and_a_date(path):
    for run in json.loads(path.read_text(encoding="utf-8"))["made"]:
        assert all(run[key] for key in ("command", "commit", "machine", "date")), run


def test_runs_behind_the_pages_have_a_digest_since_digests_are_kept():
    for (file, command), run in figures.shown().items():
        assert "code" in run or run["date"] <= BEFORE_DIGESTS, f"{file}.json: {command}"


def test_written_results_are_read_again_with_their_origin(tmp_path, monkeypatch):
    monkeypatch.setattr(result_files, "FOLDER", tmp_path)
    assert result_files.read("heights", []) == []
    for height in (1.0, 2.0):
        result_files.write("heights", [{"height": height}], "python heights.py")
    result_files.write("heights", [{"height": 2.0}, {"height": 3.0}], "python heights.py --more")
    assert result_files.read("heights", []) == [{"height": 2.0}, {"height": 3.0}]
    made = json.loads((tmp_path / "heights.json").read_text(encoding="utf-8"))["made"]
    assert [entry["command"] for entry in made] == ["python heights.py", "python heights.py --more"]
    assert all(entry["machine"] and entry["commit"] and entry["code"] for entry in made)


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A folder with a room of the package and a study, in place of the repository."""
    for place, source in {
        "src/palpate/dynamics/force.py": "def force(u):\n    return 2 * u\n",
        "src/palpate/core/faults.py": "LIMIT = 3\n",
        "validation/study.py": "import palpate\n",
    }.items():
        (tmp_path / place).parent.mkdir(parents=True)
        (tmp_path / place).write_text(source, encoding="utf-8")
    monkeypatch.setattr(result_files, "ROOT", tmp_path)
    result_files.digest.cache_clear()
    yield tmp_path
    result_files.digest.cache_clear()


def after(clone, place, source):
    """Return what differs from a run's code once a file has another source."""
    entry = {"code": result_files.code("python validation/study.py")}
    assert result_files.changed(entry) == []
    (clone / place).write_text(source, encoding="utf-8")
    result_files.digest.cache_clear()
    return result_files.changed(entry)


FORCE, ROOM = "src/palpate/dynamics/force.py", "src/palpate/dynamics"


def test_a_run_without_mechanics_depends_on_all_rooms_but_core_and_on_its_script(clone):
    assert set(result_files.code("python validation/study.py --fast")) == {ROOM, "validation/study.py"}


def test_a_run_depends_on_the_rooms_that_it_has_imported():
    importlib.import_module("palpate.dynamics.nodal.equilibrium")
    places = result_files.code("python validation/tips.py")
    assert {"src/palpate/dynamics/nodal", "validation/tips.py"} <= set(places)
    assert all(re.fullmatch(r"[0-9a-f]{8}", each) for each in places.values())
    assert not any(place in ("src/palpate", "src/palpate/core", "validation/result_files.py") for place in places)


@pytest.mark.parametrize(
    "source",
    [
        "def force(u):\n    return 3 * u\n",
        "def force(u):\n    return 2 * u + 0\n",
        "def force(u):\n    return 2 * u\n\n\nLIMIT = 1\n",
    ],
)
def test_changed_code_is_found(clone, source):
    assert after(clone, FORCE, source) == [ROOM]


def test_a_changed_study_and_a_room_that_went_are_found(clone):
    assert after(clone, "validation/study.py", "import palpate.lti\n") == ["validation/study.py"]
    entry = {"code": result_files.code("python validation/study.py")}
    (clone / FORCE).unlink()
    result_files.digest.cache_clear()
    assert result_files.changed(entry) == [ROOM]


@pytest.mark.parametrize(
    "source",
    [
        '"""Forces."""\n\n\ndef force(u: float) -> float:\n    """Return the force."""\n    return 2 * u  # [N]\n',
        "def force(\n    u,\n):\n    return (2 * u)\n",
    ],
)
def test_words_about_code_are_not_a_change(clone, source):
    assert after(clone, FORCE, source) == []


def test_the_text_of_an_error_is_not_a_change(clone):
    (clone / FORCE).write_text("def force(u):\n    raise ValueError('too large')\n", encoding="utf-8")
    assert after(clone, FORCE, "def force(u):\n    raise ValueError('must be smaller')\n") == []


def test_what_was_made_before_digests_is_known_as_such():
    assert result_files.changed({"command": "python validation/tips.py"}) is None


SHARES = {0.0: "0 %", 3e-8: "< 0.001 %", 0.00123: "0.12 %", 0.0999: "10 %", 0.236: "24 %", 1.0316: "103 %"}


def test_shares_have_two_significant_digits():
    percent = sys.modules["figure_tables.cells"].percent
    assert {value: percent(value) for value in SHARES} == SHARES
