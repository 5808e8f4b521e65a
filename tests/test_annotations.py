"""Functions state the types of their arguments and results, but for those that Numba compiles, which infers them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import palpate

pytestmark = pytest.mark.lint

SOURCES = Path(palpate.__file__).parent
COMPILED = {"cached_njit", "intrinsic", "kernel_njit", "law_njit", "register_jitable"}
# functions that are compiled by those that take them: modules, and the functions in each
TAKEN = {
    "compiled/lanes.py": {"codegen", "sums", "sums_2", "sums_3"},
    "compiled/rows.py": {"sums"},
    "dynamics/material/material_fields.py": {"at", "first"},
    "dynamics/membrane/additional_stress.py": {"_no_fibres"},
    "realtime/seqlock.py": {"fence", "load", "store"},
    "realtime/windows_clock.py": {"counter"},
    "reduction/hyper/material_point.py": {"extended"},
    "tissue/isochoric.py": {"energy", "first", "second"},
    "tissue/volumetric.py": {
        f"_{measure}_{what}" for measure in ("quadratic", "logarithmic", "mixed") for what in ("measure", "pressure")
    },
}


def bare_functions(node: ast.AST) -> Iterator[ast.FunctionDef]:
    """Functions without annotations, but not those inside them."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef):
            arguments = child.args.posonlyargs + child.args.args + child.args.kwonlyargs
            if child.returns is None and not any(each.annotation for each in arguments):
                yield child
                continue
        yield from bare_functions(child)


def decorators(function: ast.FunctionDef) -> set[str]:
    calls = [each.func if isinstance(each, ast.Call) else each for each in function.decorator_list]
    return {ast.unparse(each).rsplit(".", 1)[-1] for each in calls}


def test_functions_without_annotations_are_compiled():
    missing, taken = [], {(module, name) for module, names in TAKEN.items() for name in names}
    unused = set(taken)
    for path in sorted(SOURCES.rglob("*.py")):
        module = path.relative_to(SOURCES).as_posix()
        compiled = COMPILED | ({"staticmethod"} if module.startswith("tissue/") else set())  # formulas of laws
        for function in bare_functions(ast.parse(path.read_text(encoding="utf-8"))):
            unused.discard((module, function.name))
            if not decorators(function) & compiled and (module, function.name) not in taken:
                missing.append(f"{module}:{function.lineno} {function.name}")
    assert not missing, f"these functions need annotations: {missing}"
    assert not unused, f"remove from TAKEN: {sorted(unused)}"
