"""Help texts and messages name pages that are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from palpate.app.cli import main
from palpate.app.documentation import documentation

pytestmark = pytest.mark.lint

SOURCES = Path(__file__).parents[2] / "src" / "palpate"


def test_every_page_that_the_package_names_exists():
    named = {
        name
        for path in SOURCES.rglob("*.py")
        for name in re.findall(r"docs/([a-z_/]+\.md)", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 5
    assert not {name for name in named if not (documentation() / name).is_file()}


def test_the_help_has_the_address_of_the_pages(capsys):
    assert main(["--help"]) == 0
    assert str(documentation()) in re.sub(r"\n\s*", "", capsys.readouterr().out).replace(" ", "")
