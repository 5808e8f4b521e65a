"""Write the tables of the docs from the committed result files, docs/validation/*.json.

    python docs/figures.py                rewrites every page whose tables differ from the result files
    python docs/figures.py --show NAME    prints one block
    python docs/figures.py --stale        lists the results that are older than the code which they judge

A page has a block between two comments, ``<!-- figures: NAME -->`` and ``<!-- end -->``. Its text is the table that the
function of that name in `docs/figure_tables` returns, then a line with the command, its commit, date and machine, and
the result files. `tests/docs/test_figures.py` fails where a page and its result files differ. No test fails where a
result is older than the code; the site lists these results when it is built.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from figure_tables import BLOCKS, Block, cells

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.append(str(ROOT / "validation"))
import result_files  # noqa: E402

RESULTS = DOCS / "validation"
BLOCK = re.compile(r"(<!-- figures: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def content(name: str) -> dict[str, Any]:
    """Return a result file: its ``results``, and ``made``, one entry for each command that wrote it."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def commands_of(block: Block) -> list[str]:
    """Return the commands of a block, whose text joins them by words between backticks."""
    return re.split(r"`[^`]*`", block.command)


def runs_of(name: str, block: Block) -> list[tuple[str, dict[str, Any]]]:
    """Return the commands of a block that made a result file, each with its last run: an entry of the file's ``made``.

    A run of all parts of a study counts for each.

    Raises
    ------
    ValueError
        Only other commands made the file.
    """
    made, runs = content(name)["made"], []
    for command in commands_of(block):
        known = [each for each in made if f"{command} ".startswith(f"{each['command']} ")]
        runs += [(command, each) for each in known[-1:]]
    if not runs:
        raise ValueError(f"{name}.json must have a run of {block.command}, got {[each['command'] for each in made]}")
    return runs


def provenance(entry: dict[str, Any], timed: bool) -> str:
    """Return the commit, date and machine of a run, and for a table of times whether the machine had other work."""
    machine = re.sub(r"\(R\)| Processor| @|, Linux$", "", entry["machine"]).replace("cores, ", "cores ")
    note = [entry["note"]] if timed and "note" in entry else []
    return ", ".join([f"commit {entry['commit']}", entry["date"], machine, *note])


def origin(block: Block, page: Path, table: str) -> str:
    """Return the line below a table: command, commit, date, machine and result files.

    What was made at the same place and time is stated once. Commands that the table has in its rows are left out.
    """
    commands, links = dict[str, list[str]](), dict[str, list[str]]()
    for name in block.files:
        link = Path(os.path.relpath(RESULTS / f"{name}.json", page.parent)).as_posix()
        for command, run in runs_of(name, block):
            key = provenance(run, block.timed)
            for each, word in ((commands, f"`{command}`"), (links, f"[{name}]({link})")):
                each.setdefault(key, []).extend([word] * (word not in each.get(key, [])))
    if all(f"`{command}`" in table for command in commands_of(block)):
        commands = {}
    elif len({tuple(each) for each in commands.values()}) == 1:
        commands = {next(iter(commands)): [f"`{block.command}`"]}
    shared = len({tuple(names) for names in links.values()}) == 1
    parts = [", ".join([*([" and ".join(commands[key])] if key in commands else []), key]) for key in links]
    files = [f" ({', '.join(names)})" for names in links.values()]
    ends = [""] * (len(files) - 1) + files[-1:] if shared else files
    return "; ".join(part + end for part, end in zip(parts, ends, strict=True))


def text(name: str, page: Path) -> str:
    """Return a block for a page: the table, and the line of what made it."""
    block = BLOCKS[name]
    table = block.table(*(content(file)["results"] for file in block.files))
    return f"{table}\n\n{origin(block, page, table)}\n"


def shown() -> dict[tuple[str, str], dict[str, Any]]:
    """Return the runs behind the tables of all pages, by result file and command."""
    names = {match[2] for page in pages() for match in BLOCK.finditer(page.read_text(encoding="utf-8"))}
    found = {}
    for block in (BLOCKS[name] for name in names):
        for file in block.files:
            found |= {(file, run.get("command", command)): run for command, run in runs_of(file, block)}
    return dict(sorted(found.items()))


def stale() -> str:
    """Return which results are older than the code: a table of what has changed, and the results without a digest."""
    lines, before = [], dict[str, str]()
    for (file, command), run in shown().items():
        changed = result_files.changed(run)
        if changed is None:
            before[file] = max(run["date"], before.get(file, ""))
        elif changed:
            places = ", ".join(f"`{place.removeprefix('src/palpate/')}`" for place in changed)
            lines.append([file, f"`{command}`", run["date"], places])
    parts = [cells.markdown(["result", "command", "made", "changed since"], lines)] if lines else []
    if before:
        parts.append(f"Made until {max(before.values())}, before digests were kept: {', '.join(before)}.")
    return "\n\n".join(parts) or "None."


def pages() -> Iterator[Path]:
    """Yield the README and the pages of the docs."""
    yield ROOT / "README.md"
    yield from sorted(path for path in DOCS.rglob("*.md") if not {"_build", "validation"} & set(path.parts))


def rewritten(page: Path) -> str:
    """Return the text of a page with its blocks made again."""
    source = page.read_text(encoding="utf-8")
    return BLOCK.sub(lambda match: f"{match[1]}{text(match[2], page)}{match[3]}", source)


def main() -> None:
    """Rewrite the pages, or print a block."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--show", choices=sorted(BLOCKS), metavar="NAME", help="print a block and end")
    parser.add_argument("--stale", action="store_true", help="list results that are older than the code, and end")
    arguments = parser.parse_args()
    if arguments.stale:
        print(stale())
        return
    if arguments.show:
        print(text(arguments.show, ROOT / "README.md"))
        return
    for page in pages():
        new = rewritten(page)
        if new != page.read_text(encoding="utf-8"):
            page.write_text(new, encoding="utf-8")
            print(page.relative_to(ROOT))


if __name__ == "__main__":
    main()
