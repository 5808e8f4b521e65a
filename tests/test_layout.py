"""Tests mirror the sources, or tests/README.md says where a module is tested."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import palpate

pytestmark = pytest.mark.lint

TESTS, SOURCES = Path(__file__).parent, Path(palpate.__file__).parent
SECTION = "## Where a module is tested"


@pytest.fixture(scope="module")
def table():
    """The tests of each module that has a row, by the module's path below src/palpate."""
    _, text = (TESTS / "README.md").read_text(encoding="utf-8").split(SECTION)
    found = {}
    for row in re.findall(r"^\| (`.*`) \| (`.*`) \|$", text.split("\n## ")[0], re.MULTILINE):
        modules, tests = (re.findall(r"`([^`]+)`", cell) for cell in row)
        for module in modules:
            assert module not in found, f"two rows name {module}"
            found[module] = tests
    return found


def test_every_module_has_a_test_file_of_its_name_or_a_row(table):
    missing = []
    for path in sorted(SOURCES.rglob("*.py")):
        module = path.relative_to(SOURCES)
        mirrored = TESTS / module.parent / f"test_{module.name}"
        if path.name != "__init__.py" and not mirrored.is_file() and module.as_posix() not in table:
            missing.append(module.as_posix())
    assert not missing, f"these modules need a test file or a row in tests/README.md: {missing}"


def test_rows_name_modules_and_tests_that_exist(table):
    assert [module for module in table if not (SOURCES / module).is_file()] == []
    assert [test for tests in table.values() for test in tests if not (TESTS / test).is_file()] == []
