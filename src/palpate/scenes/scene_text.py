"""Scene files as text: read into a `Description`, and faults placed by line."""

from __future__ import annotations

import contextlib
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import check_nesting, read_text, shortened
from palpate.core.parameters import Fault, read_section
from palpate.scenes.description import Description

MAX_BYTES = 1 << 20  # of a scene file
# keys of more parts than a scene has; tomllib takes hours for one of 100,000
LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){16}""")
# each repetition ends at one place: no backtracking
SECTION_PATTERN = re.compile(r"\[(\[?)([^\[\],=]+)\]\]?\s*(?:#.*)?")


def parse_description(text: str, name: str) -> Description:
    """Return the description in the text of a scene file; `name` stands for it in messages."""
    long = LONG_KEY.search(text)
    if long:
        line = text.count("\n", 0, long.start()) + 1
        raise FileFormatError(
            f"{name}, line {line}: a key must have at most 16 parts, got {long[0][:40]}...; shorten it"
        )
    try:
        check_nesting(text, "TOML")
        table = tomllib.loads(text)
    except ValueError as error:  # also a whole number of thousands of digits
        why = shortened(str(error), 150)
        raise FileFormatError(f"{name} must be a scene file in TOML, got a text that is not: {why}") from error
    try:
        description: Description = read_section(Description, table)
    except Fault as fault:
        line = line_of(text, fault.path)
        keys = ".".join(words_of(fault.path)) or "the file"
        raise InputError(f"{name}, line {line}: {keys} {fault.message}") from fault
    return description


@contextlib.contextmanager
def at_entry(*keys: str | int) -> Iterator[None]:
    """Raise an `InputError` about an entry of a description as a `Fault` at its keys; errors of files stay."""
    try:
        yield
    except FileFormatError:
        raise
    except InputError as error:
        raise Fault(keys, str(error)) from error


def words_of(path: tuple[str | int, ...]) -> list[str]:
    """Return the keys of a path, with the number of an entry, from 1, behind its list."""
    words: list[str] = []
    for part in path:
        if isinstance(part, int):
            words[-1] += f"[{part + 1}]"
        else:
            words.append(part)
    return words


def _split(key: str) -> tuple[str, ...]:
    """Return the parts of a dotted key."""
    return tuple(part.strip(" \t\"'") for part in key.split("."))


def line_of_file(path: Path, keys: tuple[str | int, ...]) -> int:
    """Return the line of keys in a scene file, as `line_of` does; 1 if the file can no longer be read."""
    try:
        return line_of(read_text(path, "scene file", MAX_BYTES), keys)
    except (OSError, InputError):
        return 1


def line_of(text: str, path: tuple[str | int, ...]) -> int:
    """Return the line, from 1, of the deepest key of a path that stands at the beginning of a line."""
    tables: dict[str, int] = {}
    prefix: tuple[str | int, ...] = ()
    best, depth = 1, 0
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        header = SECTION_PATTERN.fullmatch(line)
        if header:
            names = _split(header[2])
            prefix = names
            if header[1]:
                index = tables.get(names[-1], 0)
                tables[names[-1]] = index + 1
                prefix = (*names, index)
            elif names[0] in tables:  # a table of the last entry of a list
                prefix = (names[0], tables[names[0]] - 1, *names[1:])
            key_path = prefix
        elif "=" in line:
            key_path = (*prefix, *_split(line.partition("=")[0]))
        else:
            continue
        if len(key_path) > depth and key_path == path[: len(key_path)]:
            best, depth = number, len(key_path)
    return best
