"""Parts of the site that come of the code: public names, options of all commands, and results older than the code."""

from __future__ import annotations

import argparse
import inspect
import re
from importlib import import_module
from pathlib import Path

REFERENCE_FOLDER = Path(__file__).parent / "reference"
NAME_DIRECTIVE = re.compile(r"\.\. (?:auto(?:function|class|exception)|py:type):: (\w+)")


def documented_names(page: Path) -> list[str]:
    """Return the public names that a reference page describes, such as ``palpate.tools.Sphere``, in order."""
    names, module = [], ""
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith(".. currentmodule::"):
            module = line.split()[-1]
        elif described := NAME_DIRECTIVE.match(line):
            names.append(f"{module}.{described[1]}")
    return names


def names() -> str:
    """Return tables of all public names with the first lines of their docstrings, a table for each reference page."""
    parts = []
    for page in ordered_pages():
        title = page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        rows = [
            f"| {{py:obj}}`{name.removeprefix('palpate.')} <{name}>` | {escaped(summary(name))} |"
            for name in documented_names(page)
        ]
        parts.append("\n".join([f"## {title}", "", "| name | summary |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


def summary(name: str) -> str:
    """Return the first line of the docstring of a public name."""
    if name in UNION_SUMMARIES:
        return UNION_SUMMARIES[name]
    module, _, own_name = name.rpartition(".")
    return (inspect.getdoc(getattr(import_module(module), own_name)) or "").partition("\n")[0]


UNION_SUMMARIES = {  # types without a docstring
    "palpate.typing.Load": "Type of loads.",
    "palpate.typing.Motion": "Type of the motion of a tool.",
    "palpate.typing.Tool": "Type of rigid tools.",
}


def ordered_pages() -> list[Path]:
    """Return the reference pages with public names in the order of the index."""
    index = (REFERENCE_FOLDER.parent / "index.md").read_text(encoding="utf-8")
    order = {name: place for place, name in enumerate(re.findall(r"^reference/(\w+)\*?$", index, re.MULTILINE))}
    pages = [page for page in REFERENCE_FOLDER.glob("*.md") if documented_names(page)]
    return sorted(pages, key=lambda page: (order.get(page.stem, len(order)), page.stem))


def commands() -> str:
    """Return the options of all commands from their parsers."""
    from palpate.app.cli import build_parser

    return "\n".join(section for path, parser in subcommands(build_parser()) for section in described(path, parser))


def subcommands(parser: argparse.ArgumentParser, path: str = "palpate") -> list[tuple[str, argparse.ArgumentParser]]:
    """Return the commands below a parser and their own parsers, in the order of ``--help``."""
    parsers: list[tuple[str, argparse.ArgumentParser]] = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                parsers += [(f"{path} {name}", inner), *subcommands(inner, f"{path} {name}")]
    return parsers


def described(path: str, parser: argparse.ArgumentParser) -> list[str]:
    """Return the section of a command: what it does, its usage and its options."""
    formatter = parser._get_formatter()
    level = "#" * path.count(" ")
    lines = [f"#{level} {path}", ""]
    if parser.description:
        lines += [linked(escaped(" ".join(parser.description.split()))), ""]
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction | argparse._HelpAction) or action.help == argparse.SUPPRESS:
            continue
        invocation = formatter._format_action_invocation(action)
        text = " ".join(formatter._expand_help(action).split()) if action.help else ""
        rows.append(f"| `{invocation.replace('|', chr(92) + '|')}` | {linked(escaped(text))} |")
    if rows:
        lines += ["| option | meaning |", "|---|---|", *rows, ""]
    return lines


def escaped(text: str) -> str:
    """Return text of a help message with the characters that Markdown would read as marks."""
    return re.sub(r"([*_<>|\[\]])", r"\\\1", text)


def linked(text: str) -> str:
    """Return text in which docs/NAME.md is a link to that page."""
    return re.sub(r"docs/(\w+)\.md(#[\w-]+)?", r"[\1](../\1.md\2)", text)


def stale_results() -> str:
    """Return the results that are older than the code."""
    import figures

    return figures.stale()


GENERATED_PARTS = {"names": names, "commands": commands, "stale_results": stale_results}


def fill(text: str) -> str:
    """Return the text of a page with its marks ``<!-- generated: ... -->`` replaced."""
    return re.sub(r"<!-- generated: (\w+) -->", lambda mark: GENERATED_PARTS[mark[1]](), text)
