"""Wrap the prose of the README and the docs at 100 characters.

    python docs/wrap.py            rewrites pages whose prose has longer lines
    python docs/wrap.py PAGE ...   rewrites these pages

Tables, code, headings, comments, images and generated blocks stay as they are. `tests/docs/test_prose.py` fails where a
line of prose is longer, unless it cannot be broken.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
WIDTH = 100  # characters of a line of prose
FENCE = re.compile(r"\s*(`{3,}|~{3,}|:{3,}|\$\$$|\\begin\{[\w*]+\})")  # of code, a directive or an equation
ITEM = re.compile(r"\s*(?:[-*+]|\d+[.)])\s+")
KEPT = re.compile(r"\s*(?:\||#|<|!\[|\([\w-]+\)=$|\[[^\]]+\]: |[-=]{3,}$)")  # tables, headings, comments, images ...
WORD = re.compile(r"(?:`[^`\n]*`|\S)+")  # a span of code is one word
MARKS_A_BLOCK = re.compile(r"[-+*>#=]+|\d+[.)]|[|%].*")  # at a line's beginning: a list, heading, table or comment


def pages() -> Iterator[Path]:
    """Yield the pages whose prose is wrapped."""
    yield from (ROOT / name for name in ("README.md", "CONTRIBUTING.md", "ARCHITECTURE.md"))
    yield from sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)


def blocks(text: str) -> Iterator[tuple[bool, list[str]]]:
    """Yield the blocks of a page: whether a block is prose (a paragraph or an item of a list), and its lines."""
    lines = text.split("\n")
    at, after_blank = 0, True
    if lines[0] == "---" and "---" in lines[1:]:  # the head of a notebook
        at = lines.index("---", 1) + 1
        yield False, lines[:at]
    while at < len(lines):
        first, start = lines[at], at
        fence = FENCE.match(first)
        at += 1
        if fence:
            last = fence[1].replace("begin", "end")
            while at < len(lines) and not lines[at].strip().startswith(last):
                at += 1
            at += 1
            yield False, lines[start:at]
        elif first.startswith("<!-- figures: "):
            while not lines[at - 1].startswith("<!-- end"):
                at += 1
            yield False, lines[start:at]
        elif not first.strip() or KEPT.match(first) or (after_blank and re.match(r" {4}|\t", first)):
            yield False, [first]
            after_blank = after_blank if re.match(r" {4}|\t", first) else not first.strip()
            continue
        else:
            while at < len(lines) and lines[at].strip() and not lines[at - 1].endswith("  "):
                if KEPT.match(lines[at]) or FENCE.match(lines[at]) or ITEM.match(lines[at]):
                    break
                at += 1
            yield True, lines[start:at]
        after_blank = False


def filled(lines: list[str]) -> list[str]:
    """Return a paragraph, or an item of a list, in lines of at most `WIDTH` characters."""
    mark = ITEM.match(lines[0])
    head = mark[0] if mark else re.match(r"\s*", lines[0])[0]
    words: list[str] = []
    for word in WORD.findall(" ".join([lines[0][len(head) :], *lines[1:]])):
        if words and MARKS_A_BLOCK.fullmatch(word):
            words[-1] += f" {word}"
        else:
            words.append(word)
    out, line = [], head
    for number, word in enumerate(words):
        if number and len(line) + 1 + len(word) > WIDTH:
            out.append(line)
            line = " " * len(head) + word
        else:
            line += f" {word}" if number else word
    return [*out, line + "  " * lines[-1].endswith("  ")]


def wrapped(text: str) -> str:
    """Return a page with blocks of prose filled again where a line is too long, or is a comment of MyST."""
    out: list[str] = []
    for prose, lines in blocks(text):
        again = prose and any(len(line) > WIDTH or line.lstrip().startswith("%") for line in lines)
        out += filled(lines) if again else lines
    return "\n".join(out)


def main() -> None:
    """Rewrite pages."""
    for page in map(Path, sys.argv[1:]) if sys.argv[1:] else pages():
        text = page.read_text(encoding="utf-8")
        if wrapped(text) != text:
            page.write_text(wrapped(text), encoding="utf-8")
            print(page)


if __name__ == "__main__":
    main()
