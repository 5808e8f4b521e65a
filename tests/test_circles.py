"""No module imports itself by way of others."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import palpate

pytestmark = pytest.mark.lint

ROOT = Path(palpate.__file__).parent
IMPORT = re.compile(r"^\s*from (palpate[\w.]*) import (\([^)]*\)|[^\n(]+)", re.MULTILINE)


def graph(root):
    """Return the modules that each module imports: at the top, in functions, and for types alone."""
    found = {}
    for path in root.rglob("*.py"):
        name = ".".join(("palpate", *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__")
        found[name] = set()
        for module, words in IMPORT.findall(path.read_text(encoding="utf-8")):
            found[name] |= {module, *(f"{module}.{word}" for word in re.findall(r"\w+", words))}
    return {name: {other for other in others if other in found and other != name} for name, others in found.items()}


def circles(modules):
    """Return the modules that remain when those that import none of the others are removed, again and again."""
    left = {name: set(others) - {"palpate"} for name, others in modules.items()}
    while free := {name for name, others in left.items() if not others & left.keys()}:
        left = {name: others for name, others in left.items() if name not in free}
    return sorted(left)


def test_imports_have_no_circles():
    assert circles(graph(ROOT)) == []


def test_a_circle_through_a_lazy_import_is_detected(tmp_path):
    (tmp_path / "one.py").write_text("from palpate.two import x\n")
    (tmp_path / "two.py").write_text("def f():\n    from palpate import one\n    return one\n")
    (tmp_path / "three.py").write_text("import os\n")
    assert circles(graph(tmp_path)) == ["palpate.one", "palpate.two"]
