"""The site describes every public name and command; examples run, and functions named on pages exist."""

from __future__ import annotations

import doctest
import functools
import inspect
import re
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import palpate as pt
from palpate.core.describe import listed_names

DOCS_FOLDER = Path(__file__).parents[1] / "docs"
sys.path.insert(0, str(DOCS_FOLDER))

from generated_parts import UNION_SUMMARIES, commands, documented_names, names, ordered_pages, subcommands  # noqa: E402

PUBLIC_MODULES = ("io", "lti", "materials", "tools", "typing")
PUBLIC_NAMES = sorted(
    [f"palpate.{name}" for name in pt.__all__ if name not in PUBLIC_MODULES]
    + [f"palpate.{module}.{name}" for module in PUBLIC_MODULES for name in getattr(pt, module).__all__]
)
COMPILING_CALLS = r"pt\.(Solid|Membrane|open_scene|Engine|lti)\b"  # examples with a body: kernels and runs
SLOW_EXAMPLES = {"palpate.io.read_painted"}  # a process with VTK


def public_object(name: str) -> Any:
    """Return the object of a public name such as ``palpate.tools.Sphere``."""
    module, _, own_name = name.rpartition(".")
    return getattr(import_module(module), own_name)


def example(name: str) -> str:
    """Return the section Examples of a public name: of its docstring, or of the reference page of a type alias."""
    if name in UNION_SUMMARIES:
        page = (DOCS_FOLDER / "reference" / "types.md").read_text(encoding="utf-8")
        text = page.partition(f".. py:type:: {name.rpartition('.')[2]}\n")[2].partition(".. py:type::")[0]
        return inspect.cleandoc(text.partition(".. rubric:: Examples\n")[2].partition("```")[0])
    return (inspect.getdoc(public_object(name)) or "").partition("Examples\n--------\n")[2]


def examples() -> list[Any]:
    """Return all public names as parameters, those whose examples take long with the marker ``slow``."""
    slow = {name for name in PUBLIC_NAMES if name in SLOW_EXAMPLES or re.search(COMPILING_CALLS, example(name))}
    return [pytest.param(name, marks=[pytest.mark.slow] if name in slow else []) for name in PUBLIC_NAMES]


@pytest.mark.lint
def test_every_public_name_is_on_one_reference_page():
    described = [name for page in ordered_pages() for name in documented_names(page)]
    assert sorted(described) == PUBLIC_NAMES


@pytest.mark.lint
def test_the_list_of_names_has_a_summary_of_each():
    rows = dict(re.findall(r"^\| \{py:obj\}`[\w.]+ <([\w.]+)>` \| (.+) \|$", names(), re.MULTILINE))
    assert sorted(rows) == PUBLIC_NAMES
    assert all(re.search(r"[.:]$", text) for text in rows.values())


@pytest.mark.lint
def test_every_public_name_has_an_example_with_a_result():
    read = doctest.DocTestParser().get_examples
    assert [name for name in PUBLIC_NAMES if not any(each.want for each in read(example(name)))] == []


@pytest.mark.parametrize("name", examples())
def test_the_example_of_a_public_name_runs_as_printed(name, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    test = doctest.DocTestParser().get_doctest(example(name), {"__name__": "__main__"}, name, None, None)
    messages: list[str] = []
    doctest.DocTestRunner(verbose=False).run(test, out=messages.append)
    assert not messages, "".join(messages)


# names of an object

AUTOCLASS = re.compile(r"^\.\. autoclass:: (\w+)\n((?:   :.*\n)*)", re.MULTILINE)
PAGE_TEXT = "\n".join(page.read_text(encoding="utf-8") for page in ordered_pages())
OPTIONS_BY_CLASS = dict(AUTOCLASS.findall(PAGE_TEXT))
PUBLIC_CLASSES = [
    name
    for name in PUBLIC_NAMES
    if isinstance(public_object(name), type) and not issubclass(public_object(name), BaseException)
]


def option_names(options: str, option: str) -> set[str] | None:
    """Return the names of an option of a directive; None without the option, and an empty set for all."""
    found = re.search(rf"^   :{option}:(.*)$", options, re.MULTILINE)
    return None if found is None else set(re.findall(r"\w+", found[1]))


def names_on_pages(kind: type) -> set[str]:
    """Return the names of an object that the reference lists: in docstrings of its class and bases, and as members."""
    listed: set[str] = set()
    for base in kind.__mro__:
        if base.__name__ not in OPTIONS_BY_CLASS or not base.__module__.startswith("palpate"):
            continue
        listed |= documented_parameters(inspect.cleandoc(base.__doc__ or ""))
        options = OPTIONS_BY_CLASS[base.__name__]
        members, excluded = option_names(options, "members"), option_names(options, "exclude-members") or set()
        if members is not None:
            names = dir(base) if ":inherited-members:" in options else vars(base)
            own = {name for name in names if inspect.getdoc(getattr(base, name))}
            listed |= (own & members if members else own) - excluded
    return listed


def unlisted_names(kind: type, names: list[str]) -> list[str]:
    """Return those of the names in `dir` of objects of a class that the reference does not list."""
    public = {name for name in names if not name.startswith("_") and not hasattr(tuple, name)}
    former = {
        name for name in public if str(getattr(getattr(kind, name, None), "__doc__", "")).startswith("Former name")
    }
    return sorted(public - former - names_on_pages(kind))


@pytest.mark.lint
@pytest.mark.parametrize("name", PUBLIC_CLASSES)
def test_every_public_name_of_a_class_is_in_the_reference(name):
    kind = public_object(name)
    assert unlisted_names(kind, listed_names(kind, dir(kind))) == []


def test_completion_lists_public_names_of_objects_alone(bar, tissue, held, run):
    solid = pt.Solid(bar, tissue, fixed="x-")
    reduced, projected = pt.hyper_reduce(solid, run, modes=3), pt.galerkin(held, run, modes=3)
    prepared = solid.prepare([pt.Gravity()])
    objects = [bar, solid, held, run, reduced, projected, solid.state(prepared), solid.stability, solid.stencils]
    objects += [tissue, pt.equilibrium(solid, pt.Gravity()), pt.open_scene("beam"), pt.pod(run, held.weights, modes=2)]
    for thing in objects:
        assert unlisted_names(type(thing), dir(thing)) == [], type(thing).__name__
    assert {"plot", "show", "save", "to_pyvista", "evaluate", "cut_surface"} <= {*dir(solid)}
    assert {"slot", "step_body"}.isdisjoint(dir(solid))
    assert hasattr(solid, "slot")


def test_completion_lists_the_names_of_a_users_class():
    class Own(pt.materials.NeoHookean):
        stiffening = 2.0

    assert {"stiffening", "C1", "shear_modulus"} <= {*dir(Own(C1=1e3, density=1060, poisson=0.45))}


@pytest.mark.lint
def test_every_command_and_option_is_on_the_page_of_commands():
    from palpate.app.cli import build_parser

    text = commands()
    parsers = subcommands(build_parser())
    assert len(parsers) > 10
    for path, parser in parsers:
        section = text.partition(f" {path}\n")[2].partition("\n#")[0]
        for action in parser._actions:
            for option in action.option_strings:
                assert f"{option}" in section or option in ("-h", "--help"), f"{path} {option}"


@pytest.mark.lint
def test_functions_named_on_pages_of_explanation_exist():
    """A name in code, such as ``palpate.meshfree.stencils.moving_least_squares``, is a module or is in one."""
    pages = [page.read_text(encoding="utf-8") for page in (DOCS_FOLDER / "explanation").glob("*.md")]
    for name in {name for page in pages for name in re.findall(r"`(palpate(?:\.\w+)+)`", page)}:
        parts = name.split(".")
        for count in range(len(parts), 0, -1):
            try:
                holder: Any = import_module(".".join(parts[:count]))
            except ModuleNotFoundError:
                continue
            break
        for part in parts[count:]:
            assert hasattr(holder, part), f"a page of explanation names {name}, which does not exist"
            holder = getattr(holder, part)


@pytest.mark.lint
def test_the_page_of_the_method_has_all_equations_of_the_paper_and_functions_for_each():
    text = (DOCS_FOLDER / "explanation" / "method.md").read_text(encoding="utf-8")
    assert [int(number) for number in re.findall(r"\\tag\{(\d+)\}", text)] == list(range(1, 35))
    for section in re.findall(r"\\tag\{.*?(?=\n## )", text, re.DOTALL):
        assert "| computed by |" in section


@pytest.mark.lint
def test_the_index_lists_every_page():
    index = (DOCS_FOLDER / "index.md").read_text(encoding="utf-8")
    pages = (path.relative_to(DOCS_FOLDER).with_suffix("").as_posix() for path in DOCS_FOLDER.rglob("*.md"))
    missing = [page for page in pages if not re.search(rf"^{page}$", index, re.MULTILINE)]
    assert sorted(missing) == ["index", "package"]


@pytest.mark.lint
def test_the_index_leads_three_readers_by_five_links_each():
    index = (DOCS_FOLDER / "index.md").read_text(encoding="utf-8")
    readers = re.findall(r"^\*\*You .*\*\*\n\n((?:\d\. .*\n)+)", index, re.MULTILINE)
    assert [len(re.findall(r"\]\([\w/]+\.md\)", each)) for each in readers] == [5, 5, 5]


# parameters and results


def sections(text: str) -> dict[str, str]:
    """Return the sections of a NumPy docstring by title."""
    parts = re.split(r"\n(\w+)\n-+\n", f"\n{text}")
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def documented_parameters(docstring: str) -> set[str]:
    """Return the names in the sections Parameters and Attributes."""
    described: set[str] = set()
    for title in ("Parameters", "Attributes"):
        for line in sections(docstring).get(title, "").splitlines():
            if line and not line.startswith(" "):
                described |= {name.strip().lstrip("*") for name in line.split(" : ")[0].split(",")}
    return described


def parameters(thing: Any) -> set[str]:
    """Return the names of the parameters of a function, or of the constructor of a class."""
    if isinstance(thing, type) and not issubclass(thing, tuple):
        thing = functools.partial(thing.__init__, None)
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return {each.name for each in inspect.signature(thing).parameters.values() if each.kind not in kinds}


@pytest.mark.lint
def test_every_parameter_and_result_of_a_public_name_is_described():
    for name in PUBLIC_NAMES:
        thing = None if name in UNION_SUMMARIES else public_object(name)
        if thing is None or (isinstance(thing, type) and issubclass(thing, BaseException)):
            continue
        docstring = inspect.getdoc(thing) or ""
        described = documented_parameters(docstring)
        if name.startswith("palpate.materials."):
            described |= documented_parameters(inspect.getdoc(pt.materials.Material) or "")  # of all laws
        assert parameters(thing) <= described, name
        if not isinstance(thing, type) and inspect.signature(thing).return_annotation not in (None, "None"):
            assert "Returns" in sections(docstring) or docstring.startswith("Return "), name
