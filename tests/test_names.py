"""Names say what they hold: no vague locals and parameters, and no further module constants of one word."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import palpate

pytestmark = pytest.mark.lint

SOURCES = Path(palpate.__file__).parent
VAGUE = {"own", "found", "whole", "of"}
PUBLIC_KEYWORDS = {  # function and parameter that users pass by name
    ("reduction/hyper/model.py", "expected_error", "of"),
    ("reduction/hyper/error_indicator.py", "expected_error", "of"),
}
# Constants of one word that were there when this test was written. They number entries of a record, or are states,
# colours, or names that several modules share. A further one needs a second word: of what it is, or its unit.
STATES = """
    AT BLADE BONDED CAPSULE CLAMP COMPILED COMPILING COUPLED COVERED DEFECT DIED DIVERGED DONE FAILED FIXED FREE FULL
    HELD IGNORE INTERRUPTED ISOCHORIC LAWS OFFERED PAUSED PLANE PRESCRIBED PROJECTED PUNCH QUADRATIC READY RECORDED
    RELAXATION RUNNING SLIDING STOP STOPPED TRAINED TRAINING UNCOVERED UNREACHABLE UNTRUSTED USED WARN
"""
ENTRIES = """
    AHEAD BEHIND CLAMPED COFACTOR COMPUTING COORDINATES COUNT DAMPING DILATATION DROPPED ELASTIC END ENERGIES ENERGY
    ESTIMATE FAILURES FAN FORCE FORCES FREQUENCY FRESH GAINED GEOMETRY GIVEN HOME ITERATIONS KINETIC LIMITED
    LOAD LOST MASS MEAN MISSED MOMENT OVERLAY OVERRUN PAIRS PERIODS POSE POSITION PRESENT PREVIEW PREVIOUS PROBE RATE
    REPEATED RESTED ROWS SAVED SECANT SEQUENCE START STATE STATUS STEP STEPS STIFFNESS STRAIN STRESS STRIP SWEEPS
    TANGENTS TARGET TIME TRIAL TRIANGLES TRUST TRUSTED UNCONVERGED UNKNOWNS UPDATE WORK
"""
PICTURES = """
    ABOVE BELOW BLUE COLOURS ELEVATION EYE FILL FRONT GREEN GREY INK KEY MARKS ORANGE PINK PIXELS QUIET RED SAMPLES
    SIDES SKY STEEL STOPS STYLE SUPPORT TISSUE TITLES YELLOW
"""
SHARED = """
    AFTER AFTERWARDS AXES BODIES COLUMNS DURATION EVERY FIGURES FILES FORMAT LANES LEAVES LOOPBACK MODES PHASES RADIUS
    REASONS REPORTS SERIES SNAPSHOTS STATES VERSION _HOME _MODULES _TOOL
"""
SINGLE_WORDS = {"TOOLS", *STATES.split(), *ENTRIES.split(), *PICTURES.split(), *SHARED.split()}


@pytest.fixture(scope="module")
def modules() -> dict[str, ast.Module]:
    """Return the syntax tree of every module by its path below src/palpate."""
    paths = sorted(SOURCES.rglob("*.py"))
    return {path.relative_to(SOURCES).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def parameters(function: ast.AST) -> list[str]:
    """Return the names of the parameters of a function or lambda."""
    if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
        return []
    arguments = function.args
    listed = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
    return [each.arg for each in listed if each is not None]


def vague_names(path: str, tree: ast.Module) -> list[str]:
    """Return the places of vague locals and parameters in a module; fields of classes are not locals."""
    nodes = list(ast.walk(tree))
    bodies = [each for node in nodes if isinstance(node, ast.ClassDef) for each in node.body]
    fields = {id(each.target) for each in bodies if isinstance(each, ast.AnnAssign)}
    places = []
    for node in nodes:
        for name in VAGUE.intersection(parameters(node)):
            if (path, getattr(node, "name", "lambda"), name) not in PUBLIC_KEYWORDS:
                places.append(f"{path}:{node.lineno} parameter {name}")
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and id(node) not in fields:
            places += [f"{path}:{node.lineno} local {node.id}"] if node.id in VAGUE else []
    return places


def module_constants(tree: ast.Module) -> set[str]:
    """Return the names in upper case that a module assigns at its top level."""
    assigned = [node for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign)]
    targets = [each for node in assigned for each in (node.targets if isinstance(node, ast.Assign) else [node.target])]
    return {
        name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name) and name.id.isupper()
    }


def test_no_local_or_parameter_is_called_own_found_whole_or_of(modules):
    places = [place for path, tree in modules.items() for place in vague_names(path, tree)]
    assert not places, f"name what it holds, such as own_file or matches: {places}"


def test_new_module_constants_have_more_than_one_word(modules):
    single = {
        f"{path}: {name}"
        for path, tree in modules.items()
        for name in module_constants(tree)
        if re.fullmatch(r"_?[A-Z][A-Z0-9]*", name) and name not in SINGLE_WORDS
    }
    assert not single, f"name of what it is, and its unit if it has one, such as MIN_SLIDE_SPEED: {sorted(single)}"


def test_vague_names_are_noticed_in_every_kind_of_binding():
    source = (
        "class A:\n    own: int\n"
        "def f(of, *, whole=1):\n    own = 1\n    [found for found in of]\n    return lambda own: 1"
    )
    names = [place.split()[-1] for place in vague_names("some.py", ast.parse(source))]
    assert sorted(names) == ["found", "of", "own", "own", "whole"]
