"""Sources, tests and docs use the words of docs/glossary.md, and no retired ones."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("src/palpate", "docs", "examples", "benchmarks", "validation", "page/src", "tests")
SUFFIXES = (".py", ".pyi", ".md", ".js", ".css", ".html")
RETIRED = {  # word: its place is taken by
    r"[Dd]ents?|[Dd]ented": "compliance, contact displacement, indentation",
    r"[Ww]itness(?:es|ed)?": "residual field",
    r"[Ll]eeway": "residual scale",
    r"[Ii]mbalances?": "residual norm",
    r"[Cc]loseness": "near-field correction",
    r"FullModel|ProjectedModel|ReducedParts": "Solid, GalerkinModel, ReducedData",
    r"load_linear\b(?=\()|quickest": "load, select_time_step",
    r"own_law": "symbolic law",
    r"firm_\w+|\w*_firm": "always taut, shear-weighted",
    r"untouched(?=\()|touch_of|Handling": "no_contact, ContactTools",
    r"usual_imbalance|retool(?:ing|ed)?": "typical residual, change_tool",
    r"fullrun|inbox|Hung": "full-model replay, queue, virtual coupling",
    r"anew": "again, reset",
    r"dear(?:er)?": "expensive",
    r"[Mm]end(?:ed|s|ing)?": "repair, fix",
    r"at (?:its )?ease": "in equilibrium",
    r"softness": "secant factor",
    r"heeded": "processed",
    r"drive(?=\()": "prepare",
    r"sound(?=\()": "accept_step",
    r"[Vv]iscosity": "stiffness damping",
    r"such that": "so that, for which",
    r"beside": "next to, adjacent, additional",
    r"(?<!here )(?:is|are) no (?!(?:less|more|longer|such)\b)\w+": "is not a",
    r"to_pymor(?=\(\))": "lti.to_pymor(system)",
    r"[Dd]riven": "prescribed, moved",
    r"aria-[a-z]*[A-Z]\w*": "an attribute of WAI-ARIA, which is in lower case",
    r"[Bb]ooks": "energy balance, totals",
    r"CRUSHED_RATIO|MOST_STIFF|TRIALS_OF_ENERGY": "MAX_MOVING_RATIO, MAX_FREQUENCY_RATIO, MAX_ENERGY_ATTEMPTS",
    r"(?:settle|succeed)(?=\()": "flush_and_rename, solve_contact, continue_from",
    r"SceneSource|(?:named|described|refined|fitting|surface|organ|training)_scene|scene_(?:source|body)": "Scene",
    r"open_touched|training_scene_of|text_of_scene|parse_scene": "open_surface, training_of, json_of_scene",
    r"is_pressure|SurfaceForce\([^()]*pressure=.*": "Pressure",
}
ALLOWED = {"docs/glossary.md", "tests/test_words.py"}  # name retired words themselves


def lines():
    """Yield every line of sources, tests and docs with its place; names of tests are words."""
    for path in [ROOT / "README.md", *(path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*")))]:
        name = path.relative_to(ROOT).as_posix()
        bundle = "app/view/page/" in name or "node_modules" in name
        if path.suffix in SUFFIXES and not bundle and name not in ALLOWED:
            for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
                yield f"{name}:{number}", line.replace("_", " ") if line.startswith("def test_") else line


@pytest.mark.parametrize("word", RETIRED)
def test_no_retired_word_is_used(word):
    pattern = re.compile(rf"(?<!\w)(?:{word})(?!\w)")
    found = [place for place, line in lines() if pattern.search(line)]
    assert not found, f"use {RETIRED[word]} in place of {word}: {found[:20]}"


def test_the_search_reads_sources_tests_and_docs():
    places = {place.split(":")[0] for place, _ in lines()}
    every = {"README.md", "src/palpate/faults.py", "docs/contact.md", "page/src/main.js", "tests/conftest.py"}
    assert every | {"validation/land.py", "benchmarks/steps.py", "examples/haptic_client.py"} <= places
