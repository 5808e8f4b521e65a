"""Sources, tests and docs use the words of docs/reference/glossary.md, and no retired ones."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.lint

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
    r"firm_\w+|\w*_firm": "tension-compression, shear-weighted",
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
    r"open_touched|training_scene_of|text_of_scene|parse_scene": "open_scene, training_of, json_of_scene",
    r"open_subject|learned_spacings?|keep_spacing|whole_body": "open_input, cached_spacing, resolve_labels",
    r"is_pressure|SurfaceForce\([^()]*pressure=.*": "Pressure",
    r"[Tt]rust numbers?|trust_numbers?": "error indicator",
    r"[Mm]ass tailoring|MassTailoring|tailored[_ ]mass": "selective mass scaling",
    r"[Bb]ond_paths|[Kk]ept_sums": "diffraction_lengths, consistency_correction",
    r"[Aa]lways[ _]taut": "tension-compression fibres",
    r"[Ll]ifting (?:vector|column)s?|lifting_vectors": "lifting function",
    r"[Ii]ntegration_points|IntegrationPoints": "cubature points",
    r"static_balance|StaticBalance": "equilibrium residual",
    r"[Oo]bservable(?:_\w+| model)|Observable(?:Model|Data)|make_observable": "instrumented model",
    r"Freshness|EnergyAccount|[Ee]nergy account": "Watchdog, passivity observer",
    r"Incision|an? incision": "cut front",
    r"_of_most_runs|_place_of": "_upper_quantile, _location",
    r"(?:MOST|LEAST)_\w+": "MAX_..., MIN_...",
}
ALLOWED = {"docs/reference/glossary.md", "tests/test_words.py"}  # name retired words themselves


def sources():
    """Yield the place and the text of each source, test and page; names of tests are words."""
    for path in [ROOT / "README.md", *(path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*")))]:
        name = path.relative_to(ROOT).as_posix()
        bundle = "app/view/page/" in name or "node_modules" in name
        if path.suffix in SUFFIXES and not bundle and name not in ALLOWED:
            text = path.read_text(encoding="utf-8")
            yield name, re.sub(r"^def test_.*", lambda line: line[0].replace("_", " "), text, flags=re.MULTILINE)


def test_no_retired_word_is_used():
    words = list(RETIRED)
    pattern = re.compile(rf"(?<!\w)(?:{'|'.join(f'(?P<word{k}>{word})' for k, word in enumerate(words))})(?!\w)")
    read, found = set(), []
    for name, text in sources():
        read.add(name)
        for match in pattern.finditer(text):
            word = words[int(match.lastgroup.removeprefix("word"))]
            line = text.count("\n", 0, match.start()) + 1
            found.append(f"{name}:{line}: use {RETIRED[word]} in place of {match[0]}")
    assert not found, "\n".join(found)
    every = {"README.md", "src/palpate/core/faults.py", "docs/howto/view.md", "page/src/main.js", "tests/conftest.py"}
    assert every | {"validation/land.py", "benchmarks/steps.py", "examples/haptic_client.py"} <= read
