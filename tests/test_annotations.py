"""Functions state the types of their arguments and results, but for those that Numba compiles, which infers them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import palpate

pytestmark = pytest.mark.lint

SOURCES = Path(palpate.__file__).parent
COMPILED = {"cached_njit", "intrinsic", "kernel_njit", "law_njit", "register_jitable", "staticmethod"}
# modules in which functions are compiled by those that take them
TAKEN = {
    "dynamics/compiled/lanes.py", "dynamics/compiled/rows.py", "dynamics/material/material_fields.py",
    "dynamics/membrane/additional_stress.py", "realtime/exchange.py", "realtime/windows_clock.py",
    "reduction/hyper/material_point.py", "tissue/isochoric.py", "tissue/volumetric.py",
}  # fmt: skip


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
    missing = []
    for path in sorted(SOURCES.rglob("*.py")):
        if path.relative_to(SOURCES).as_posix() in TAKEN:
            continue
        for function in bare_functions(ast.parse(path.read_text(encoding="utf-8"))):
            if not decorators(function) & COMPILED:
                missing.append(f"{path.relative_to(SOURCES)}:{function.lineno} {function.name}")
    assert not missing, f"these functions need annotations: {missing}"
