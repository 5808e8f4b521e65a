"""Every snippet of the docs runs as it stands: a page in a namespace and a folder of its own, all in this process.

`tests/test_public.py` runs that of the README, of which package.md has a part. The build of the site runs the
tutorials.
"""

from __future__ import annotations

import re
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    path for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "tutorials" and path.name != "package.md"
)
EXAMPLES = ("law", "load", "tool", "scene")
FRAGMENTS = {f"docs/howto/extending_{kind}.md" for kind in EXAMPLES}  # pieces of files: test_extending.py applies them
RELEASE = {"docs/howto/laws.md"}  # compiles six laws
PACKAGES = {"pandas": "pandas", "websockets": "websockets", "pyvista": "pyvista", "pymor": "pymor"}
FENCE = re.compile(
    r"^(?:<!-- not run: (?P<reason>[^\n]+?) -->\n+)?^```python\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL
)


class Snippet(NamedTuple):
    """Code of a page, the line at which it begins, and why it is not run, if it is not."""

    line: int
    code: str
    reason: str


def snippets(text):
    """Return the Python snippets of a page."""
    return [
        Snippet(text.count("\n", 0, found.start("code")) + 1, found["code"], found["reason"] or "")
        for found in FENCE.finditer(text)
    ]


def program(text):
    """Return the snippets of a page as one program, each at its line of the page."""
    lines = [""] * (text.count("\n") + 1)
    for snippet in snippets(text):
        if not snippet.reason:
            code = snippet.code.split("\n")
            lines[snippet.line - 1 : snippet.line - 1 + len(code)] = code
    return "\n".join(lines)


def page_name(path):
    return path.relative_to(ROOT).as_posix()


def cases():
    """Yield the pages with snippets that run."""
    for path in PAGES:
        name = page_name(path)
        if name not in FRAGMENTS and program(path.read_text(encoding="utf-8")).strip():
            yield pytest.param(path, id=name, marks=[pytest.mark.release] * (name in RELEASE))


def required_packages(code):
    """Return the optional packages that a program imports."""
    imported = set(re.findall(r"^\s*(?:import|from)\s+(\w+)", code, re.MULTILINE))
    return sorted(imported & PACKAGES.keys())


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a program in an empty folder and a new namespace; what it changes in this process is restored."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setenv("PYTHONSAFEPATH", "1")  # of programs that a page starts
    monkeypatch.setattr(sys, "argv", ["page.py"])
    monkeypatch.setattr(sys, "path", list(sys.path))
    modules = set(sys.modules)

    def run(code, name):
        namespace = {"__name__": "__main__"}
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            exec(compile(code, name, "exec"), namespace)
        return namespace

    yield run
    for name in set(sys.modules) - modules:
        if str(getattr(sys.modules[name], "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.mark.slow
@pytest.mark.parametrize("path", list(cases()))
def test_the_snippets_of_a_page_run_as_they_stand(path, run):
    code = program(path.read_text(encoding="utf-8"))
    for package in required_packages(code):
        pytest.importorskip(package)
    run(code, str(path))  # an error names its line of the page


def test_a_page_leaves_no_name_and_no_filter_of_warnings_to_the_next(run):
    filters = list(warnings.filters)
    run("import warnings\nwarnings.simplefilter('ignore')\nleft = 1", "a page")
    assert "left" not in run("", "the next page")
    assert warnings.filters == filters


@pytest.mark.lint
def test_every_python_fence_is_found():
    for path in PAGES:
        text = path.read_text(encoding="utf-8")
        assert len(snippets(text)) == len(re.findall(r"^```python", text, re.MULTILINE)), page_name(path)


@pytest.mark.lint
def test_a_snippet_runs_at_its_line_and_a_marked_one_is_left_out():
    text = "# Page\n\n```python\na = 1\n```\n\n<!-- not run: needs a file -->\n```python\na = open('x')\n```\n"
    assert program(text).split("\n")[3] == "a = 1"
    assert "open" not in program(text)
    assert [(each.line, each.reason) for each in snippets(text)] == [(4, ""), (9, "needs a file")]
