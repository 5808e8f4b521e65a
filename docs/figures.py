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
NO_MACHINE = "machine not recorded"
BLOCK = re.compile(r"(<!-- figures: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def content(name: str) -> dict[str, Any]:
    """Return a result file: its ``results``, and ``made``, one entry for each command that wrote it."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def run_of(name: str, command: str) -> dict[str, Any]:
    """Return the last run of a command, or of commands, that made a result file: an entry of its ``made``.

    A run of all parts of a study counts for each. Where no run of the command is known, it is the oldest entry, which
    names none.

    Raises
    ------
    ValueError
        Only other commands made the file.
    """
    made = content(name)["made"]
    wanted = re.split(r"`[^`]*`", command)
    runs = [each for each in made if any(f"{one} ".startswith(f"{each.get('command')} ") for one in wanted)]
    possible = runs or [each for each in made if "command" not in each]
    if not possible:
        raise ValueError(f"{name}.json must have a run of {command}, got {[each['command'] for each in made]}; run it")
    return possible[-1]


def provenance(entry: dict[str, Any], timed: bool) -> str:
    """Return the commit, date and machine of a run, and for a table of times whether the machine had other work."""
    machine = re.sub(r"\(R\)| Processor| @|, Linux$", "", entry.get("machine", NO_MACHINE)).replace("cores, ", "cores ")
    note = [entry["note"]] if timed and "note" in entry else []
    return ", ".join([f"commit {entry['commit']}", entry["date"], machine, *note])


def origin(block: Block, page: Path, table: str) -> str:
    """Return the line below a table: command, commit, date, machine and result files.

    Commands that the table has in its rows are left out. Files of one run share its text.
    """
    files: dict[str, list[str]] = {}
    for name in block.files:
        link = Path(os.path.relpath(RESULTS / f"{name}.json", page.parent)).as_posix()
        files.setdefault(provenance(run_of(name, block.command), block.timed), []).append(f"[{name}]({link})")
    listed = all(f"`{one}`" in table for one in re.split(r"`[^`]*`", block.command))
    runs = "; ".join(f"{run} ({', '.join(links)})" for run, links in files.items())
    return runs if listed else f"`{block.command}`, {runs}"


def text(name: str, page: Path) -> str:
    """Return a block for a page: the table, and the line of what made it."""
    block = BLOCKS[name]
    table = block.table(*(content(file)["results"] for file in block.files))
    return f"{table}\n\n{origin(block, page, table)}\n"


def shown() -> dict[tuple[str, str], dict[str, Any]]:
    """Return the runs behind the tables of all pages, by result file and command."""
    names = {match[2] for page in pages() for match in BLOCK.finditer(page.read_text(encoding="utf-8"))}
    blocks = [BLOCKS[name] for name in sorted(names)]
    runs = {(file, block.command): run_of(file, block.command) for block in blocks for file in block.files}
    return {(file, run.get("command", command)): run for (file, command), run in sorted(runs.items())}


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
