"""What commands compile: a change must not add functions that a body does not need, unseen."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from compiled_functions import COMMANDS, compiled_functions

KEPT = Path(__file__).parents[2] / "docs" / "validation" / "compiled_functions.json"
SLACK = 1.1  # of the number of functions over the kept one; `python benchmarks/compiled_functions.py beam` names them
UNTOUCHED = (
    "contact.impulses:push",
    "blade",
    "grip",
    "gauss_seidel:",
    "relaxation:overstress",
    "relax_volume",
    "crossings:_divide",
)


@pytest.mark.slow
def test_a_beam_without_tools_compiles_no_contact_relaxation_or_cuts():
    found = compiled_functions("beam")
    needless = [name for name in found["by_function"] if any(word in name for word in UNTOUCHED)]
    assert needless == []
    stored = json.loads(KEPT.read_text(encoding="utf-8"))["results"]["beam"]
    assert found["functions"] <= SLACK * stored["functions"]


def test_counts_of_all_commands_are_kept():
    assert set(json.loads(KEPT.read_text(encoding="utf-8"))["results"]) == set(COMMANDS)
