"""Kernels without a wrapper for calls from Python: such a call would end the process."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
DECORATORS = ("kernel_njit", "law_njit")


def options(node):
    """Return the options of a kernel's decorator by name; None for another function."""
    for call in getattr(node, "decorator_list", ()):
        if isinstance(call, ast.Call) and getattr(call.func, "id", None) in DECORATORS:
            return {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
    return None


def inner_kernels(tree):
    """Return the names of a module's kernels without a wrapper."""
    return {node.name for node in ast.walk(tree) if (options(node) or {}).get("inner") == "True"}


def python_calls(node):
    """Yield the calls of plain names outside kernels."""
    for child in ast.iter_child_nodes(node):
        if options(child) is None:
            if isinstance(child, ast.Call) and isinstance(child.func, ast.Name):
                yield child
            yield from python_calls(child)


def faults(tree, module, kernels):
    """Return the calls in a module, as (line, name), of kernels without a wrapper."""
    found = {name: name for name in kernels.get(module, ())}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            inner = kernels.get(node.module, ())
            found |= {alias.asname or alias.name: alias.name for alias in node.names if alias.name in inner}
    return [(call.lineno, found[call.func.id]) for call in python_calls(tree) if call.func.id in found]


@pytest.fixture(scope="module")
def trees():
    """Syntax trees of all Python files by path."""
    folders = [ROOT / name for name in ("src/palpate", "tests", "benchmarks", "validation", "examples")]
    files = [path for folder in folders for path in folder.rglob("*.py")]
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in files}


@pytest.fixture(scope="module")
def kernels(trees):
    """Names of kernels without a wrapper by module."""
    source = ROOT / "src"
    inside = {path: tree for path, tree in trees.items() if path.is_relative_to(source)}
    return {module_name(path): inner_kernels(tree) for path, tree in inside.items()}


def module_name(path):
    """Return the name by which a source is imported."""
    return ".".join(path.relative_to(ROOT / "src").with_suffix("").parts) if path.is_relative_to(ROOT / "src") else ""


def test_only_compiled_code_calls_kernels_without_a_wrapper(trees, kernels):
    assert sum(map(len, kernels.values())) > 80
    found = {path: faults(tree, module_name(path), kernels) for path, tree in trees.items()}
    assert {str(path): calls for path, calls in found.items() if calls} == {}


@pytest.mark.parametrize("name", ["press", "set_tool_paths as move"])
def test_a_call_from_python_is_detected(name, kernels):
    called = name.split()[-1]
    text = f"from palpate.reduction.contact.gauss_seidel import {name}\n\ndef f():\n    return {called}(1)\n"
    assert faults(ast.parse(text), "", kernels) == [(4, name.split()[0])]


def test_a_call_from_a_kernel_is_allowed(kernels):
    text = "from palpate.reduction.contact.gauss_seidel import press\n\n@kernel_njit()\ndef f():\n    return press(1)\n"
    assert faults(ast.parse(text), "", kernels) == []
