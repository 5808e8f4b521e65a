"""The worked examples of docs/howto/extending_*.md hold: applied to a copy of the sources, their tests pass."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GUIDES = ROOT / "docs" / "howto"
PAGES = [GUIDES / f"extending{kind}.md" for kind in ("", "_law", "_load", "_tool", "_scene")]
STEP = re.compile(
    r"^(?:Create `(?P<created>\S+)`"
    r"|In `(?P<edited>\S+)`, (?P<action>after|replace) the line with `(?P<line>[^\n]*)`"
    r"|Run):\n\n```\w+\n(?P<block>.*?)```\n",
    re.DOTALL | re.MULTILINE,
)


def pages() -> str:
    """Return the text of the pages."""
    return "\n".join(page.read_text(encoding="utf-8") for page in PAGES)


def sections() -> dict[str, str]:
    """Return the text of each worked example by its heading."""
    parts = re.split(r"^## (.*)\n", pages(), flags=re.MULTILINE)
    examples = dict(zip(parts[1::2], parts[2::2], strict=True))
    return {heading: text for heading, text in examples.items() if STEP.search(text)}


def edit(root: Path, step: re.Match[str]) -> None:
    """Create a file, or insert lines after the one line with a text, or replace that line."""
    if step["created"]:
        path = root / step["created"]
        assert not path.exists(), f"{path} exists"
        path.write_text(step["block"], encoding="utf-8")
        return
    path = root / step["edited"]
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    places = [number for number, line in enumerate(lines) if step["line"] in line]
    assert len(places) == 1, f"{step['line']!r} must be in one line of {path}, is in {len(places)}"
    place = places[0]
    lines[place : place + 1] = [lines[place], step["block"]] if step["action"] == "after" else [step["block"]]
    path.write_text("".join(lines), encoding="utf-8")


@pytest.fixture
def copy(tmp_path):
    """A copy of sources and tests, with compiled kernels."""
    for name in ("src", "tests", "docs", "validation", "benchmarks"):
        skip = shutil.ignore_patterns("images", "node_modules")
        shutil.copytree(ROOT / name, tmp_path / name, ignore=skip)
    for name in ("pyproject.toml", "README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "Makefile"):
        shutil.copy2(ROOT / name, tmp_path / name)
    return tmp_path


# files that an example creates or edits, at most
MAX_FILES = {"A law": 5, "A load": 5, "A tool": 4, "A scene": 2, "A key of a scene file": 2}


@pytest.mark.lint
def test_the_pages_have_examples_of_all_kinds_that_touch_few_files():
    assert sorted(GUIDES.glob("extending*.md")) == sorted(PAGES)
    assert [heading.split(":")[0] for heading in sections()] == list(MAX_FILES)
    for heading, text in sections().items():
        files = {step["created"] or step["edited"] for step in STEP.finditer(text)} - {None}
        assert len(files) <= MAX_FILES[heading.split(":")[0]], sorted(files)
        assert text.count("\nRun:\n") == 1
        assert len(STEP.findall(text)) == text.count("\n```") / 2


@pytest.mark.lint
def test_every_source_that_the_pages_name_exists_or_is_created():
    text = pages()
    created = {step["created"] for step in STEP.finditer(text)}
    named = set(re.findall(r"`((?:src|tests)/[^`\s]+)`", text))
    assert [path for path in named - created if not (ROOT / path).exists()] == []


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize("heading", sections())
def test_an_example_applied_to_the_sources_passes_its_tests(copy, heading):
    for step in STEP.finditer(sections()[heading]):
        if step["created"] or step["edited"]:
            edit(copy, step)
            continue
        environment = os.environ | {"PYTHONPATH": str(copy / "src"), "PYTHONSAFEPATH": "1"}
        for line in step["block"].splitlines():
            program, *arguments = shlex.split(line)
            module = "palpate" if program.endswith("palpate") else "pytest"
            arguments = arguments if module == "palpate" else [*arguments[2:], "-p", "no:cacheprovider"]
            command = [sys.executable, "-m", module, *arguments]
            done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{line}\n{done.stdout[-3000:]}\n{done.stderr[-2000:]}"
            if module == "pytest":
                assert re.search(r"\d+ passed", done.stdout), done.stdout[-500:]
