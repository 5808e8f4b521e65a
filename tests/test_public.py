"""The public names: one place each, the same for editors, type checkers and programs, and complete."""

from __future__ import annotations

import ast
import functools
import inspect
import re
import subprocess
import sys
import tomllib
import types
import typing
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import palpate as pt

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src" / "palpate"
MODULES = ("io", "lti", "materials", "tools", "typing")
INNER_TYPES = {  # prepared data and scratch arrays, in attributes and methods that palpate itself uses
    "ContactState",
    "EnergyModel",
    "Fields",
    "ForcePattern",
    "Formulation",
    "GalerkinWork",
    "Histograms",
    "Kinematics",
    "LoadHistory",
    "Mirror",
    "MirrorPlane",
    "NodalFields",
    "NodalWork",
    "ReducedData",
    "ReducedWork",
    "SupportedNodes",
    "TissueField",
}


def stubbed() -> dict[str, str]:
    """Return the module of every name that the stub imports."""
    tree = ast.parse((SOURCES / "__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert all(name.asname == name.name for node in imports for name in node.names), "an import `as` itself is public"
    return {name.name: node.module for node in imports for name in node.names}


def test_the_stub_and_the_lazy_table_name_the_same_objects():
    names = stubbed()
    assert sorted(names) == pt.__all__
    for name, module in names.items():
        if module == "palpate":
            assert getattr(pt, name) is import_module(f"palpate.{name}")
        else:
            assert getattr(pt, name) is getattr(import_module(module), name)


def test_every_public_name_has_one_place():
    places = [(name, module) for module in MODULES for name in getattr(pt, module).__all__]
    names = [name for name, _ in places] + [name for name in pt.__all__ if name not in MODULES]
    assert sorted(names) == sorted(set(names))
    for name, module in places:
        assert hasattr(getattr(pt, module), name)
        with pytest.raises(AttributeError, match=rf"it is palpate\.{module}\.{name}$"):
            getattr(pt, name)
    with pytest.raises(AttributeError, match=r"has no attribute 'nonsense'$"):
        pt.nonsense  # noqa: B018


def test_an_earlier_name_is_the_same_object_with_a_warning():
    with pytest.warns(DeprecationWarning, match=r"use the new name") as warned:
        from palpate.typing import OrganScene
    assert OrganScene is pt.typing.Scene
    assert [each.filename for each in warned] == [__file__]
    assert "OrganScene" not in pt.typing.__all__
    with pytest.raises(AttributeError, match=r"^module 'palpate.typing' has no attribute 'nonsense'$"):
        pt.typing.nonsense  # noqa: B018


def test_the_import_loads_no_numerics_and_submodules_are_attributes():
    code = (
        "import palpate, sys; print({'numpy', 'scipy', 'numba', 'rich'} & {*sys.modules}, palpate.tools.Sphere(0.01))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("set() Sphere(")


# types in signatures


def defined() -> dict[str, Any]:
    """Return the classes and type aliases of all modules by name, for annotations that only type checkers evaluate."""
    found: dict[str, Any] = {}
    for path in sorted(SOURCES.rglob("*.py")):
        if "app" in path.parts or path.stem == "__main__":
            continue
        module = import_module(
            ".".join(path.relative_to(SOURCES.parent).with_suffix("").parts).removesuffix(".__init__")
        )
        found |= {name: value for name, value in vars(module).items() if isinstance(value, type)}
    return found


def annotated(owner: Any) -> list[Any]:
    """Return what of an object has annotations: the function; or the class, its methods and properties."""
    if not isinstance(owner, type):
        return [owner]
    found = [owner]
    for name, value in inspect.getmembers_static(owner):
        if not name.startswith("_") or name == "__init__":
            inner = value.fget if isinstance(value, property) else value
            inner = inner.func if isinstance(inner, functools.cached_property) else inner
            inner = inner.__func__ if isinstance(inner, classmethod | staticmethod) else inner
            if inspect.isfunction(inner) and inner.__module__.startswith("palpate"):
                found.append(inner)
    return found


def classes_in(hint: Any) -> set[type]:
    """Return palpate's classes in a type."""
    if isinstance(hint, type) and not isinstance(hint, types.GenericAlias):
        return {hint} if hint.__module__.startswith("palpate") else set()
    if isinstance(hint, list | tuple):
        return set().union(*map(classes_in, hint))
    return classes_in(typing.get_args(hint))


def test_every_type_that_a_public_function_takes_or_returns_is_public_or_an_inner_type():
    known = defined()
    public = {name: getattr(pt, name) for name in pt.__all__ if name not in MODULES}
    reachable = [*public.values()]
    for module in MODULES:
        own = {name: getattr(getattr(pt, module), name) for name in getattr(pt, module).__all__}
        reachable += own.values()
        if module != "typing":  # whose own methods are for palpate itself
            public |= own
    allowed = {part for each in reachable for part in classes_in(each)}
    missing: dict[str, set[str]] = {}
    for name, each in public.items():
        for part in annotated(each):
            hints = typing.get_type_hints(part, localns=known | vars(sys.modules[part.__module__]))
            for kind in set().union(*map(classes_in, hints.values())) - allowed:
                if kind.__name__ not in INNER_TYPES:
                    missing.setdefault(f"{kind.__module__}.{kind.__name__}", set()).add(f"{name}: {part.__qualname__}")
    assert not missing


def test_the_public_names_are_few():
    assert sum(len(getattr(pt, module).__all__) for module in MODULES) + len(pt.__all__) - len(MODULES) <= 131


def test_the_page_for_a_package_index_has_no_relative_links_and_the_example_of_the_readme():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (ROOT / project["readme"]).read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]*)\)", text)
    assert links
    assert all(link.startswith("https://") for link in links)
    shown = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1].splitlines()
    statements = {line.partition("  #")[0] for line in example().splitlines()}
    assert {line.partition("  #")[0] for line in shown} <= statements


# the example of the README, as a type checker sees it


def example() -> str:
    """Return the first Python example of the README."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    match = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert match is not None
    return match[1]


@pytest.mark.lint
def test_the_readme_is_read_in_one_sitting():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 100
    assert len([line for line in lines if ".webp" in line]) == 1


@pytest.mark.slow
def test_the_example_prints_the_errors_that_the_readme_shows(capsys):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.search(r"`print` shows `(Errors\(.*\))`", text)
    assert shown is not None
    namespace: dict[str, Any] = {}
    exec(compile(example(), "README.md", "exec"), namespace)
    assert capsys.readouterr().out.splitlines()[-1] == shown[1]
    assert f"{len(namespace['rom'].data.cubature.nodes)} sampled nodes of 1,025" in text


@pytest.mark.lint
def test_the_example_of_the_readme_passes_mypy(tmp_path):
    pytest.importorskip("mypy")
    source = example()
    tree = ast.parse(source)
    assigned = [node.targets[0].id for node in tree.body if isinstance(node, ast.Assign)]
    assert len(assigned) >= 6
    path = tmp_path / "example.py"
    path.write_text(source + "".join(f"reveal_type({name})\n" for name in assigned), encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    revealed = re.findall(r'Revealed type is "(.*)"', done.stdout)
    assert len(revealed) == len(assigned)
    for name, kind in zip(assigned, revealed, strict=True):
        assert kind.startswith("palpate."), f"{name} is {kind}"
        assert "Any" not in kind, f"{name} is {kind}"
    written = path.read_text(encoding="utf-8").replace("pt.box(", "pt.boks(")
    path.write_text(written, encoding="utf-8")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert 'Module has no attribute "boks"' in done.stdout
