"""Write the tables of the docs from the committed result files, docs/validation/*.json.

    python docs/figures.py                rewrites every page whose tables are stale
    python docs/figures.py --show NAME    prints one block

A page has a block between two comments, ``<!-- figures: NAME -->`` and ``<!-- end -->``. Its text is the table that the
function of that name in `docs/figure_tables` returns, then the command, the result files, their commit and machine.
`tests/docs/test_figures.py` fails where a page and its result files differ.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from figure_tables import BLOCKS

DOCS = Path(__file__).parent
ROOT = DOCS.parent
RESULTS = DOCS / "validation"
NO_MACHINE = "machine not recorded"
BLOCK = re.compile(r"(<!-- figures: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def content(name: str) -> dict[str, Any]:
    """Return a result file: its ``results``, and ``made``, one entry for each command that wrote it."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def origin(name: str, command: str, page: Path) -> str:
    """Return a link to a result file, with the commit and machine of the last run of a command, or of commands.

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
    entry = possible[-1]
    link = Path(os.path.relpath(RESULTS / f"{name}.json", page.parent)).as_posix()
    return f"[{name}.json]({link}), commit {entry['commit']} of {entry['date']}, {entry.get('machine', NO_MACHINE)}"


def text(name: str, page: Path) -> str:
    """Return a block for a page: the table, and what made it."""
    block = BLOCKS[name]
    table = block.table(*(content(file)["results"] for file in block.files))
    origins = ";\n".join(origin(file, block.command, page) for file in block.files)
    return f"{table}\n\nMade by `{block.command}`:\n{origins}.\n"


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
    arguments = parser.parse_args()
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
