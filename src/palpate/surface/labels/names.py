"""Names of labels from files: JSON, color tables of 3D Slicer (.ctbl), and descriptions of ITK-SNAP (.txt)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from palpate.core.faults import FileFormatError
from palpate.core.files import json_of, read_text, shortened

MAX_BYTES = 1 << 20
MAX_NUMBER = 2**31 - 1
SNAP_LINE = re.compile(r'(\d{1,10})\s[^"]*"([^"]*)"')  # number, colours, "name"
TABLE_LINE = re.compile(r"(\d{1,10})[\s,;:]+(\S.*)")  # number, name, colours
COLOURS = re.compile(r"(?:\s+\d+(?:\.\d+)?){3,4}$")


def read_names(path: str | Path) -> dict[int, str]:
    """Return names by the numbers of labels.

    The file is JSON, a color table of 3D Slicer, or lines of a number and a name. JSON is ``{"5": "liver"}``,
    ``{"liver": 5}``, or one of them under ``"labels"``, as in nnU-Net's ``dataset.json``.
    """
    path = Path(path)
    text = read_text(path, "file of names", MAX_BYTES)
    try:
        names = _of_json(text) if text.lstrip()[:1] == "{" else _of_lines(text)
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from error
    if not names:
        raise FileFormatError(f"{path} must have numbers and names of labels, got none; give lines such as '5 liver'")
    return names


def _of_json(text: str) -> dict[int, str]:
    value = json_of(text)
    table: Any = value.get("labels", value)
    pairs: list[tuple[Any, Any]] = list(table.items()) if isinstance(table, dict) else []
    names = {}
    for key, name in pairs:
        number, word = (key, name) if str(key).isdecimal() else (name, key)
        if str(number).isdecimal() and int(number) <= MAX_NUMBER and isinstance(word, str):
            names[int(number)] = word
    return names


def _of_lines(text: str) -> dict[int, str]:
    names = {}
    for line in text.splitlines():
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        match = SNAP_LINE.match(line) or TABLE_LINE.fullmatch(line)
        if match is None or int(match[1]) > MAX_NUMBER:
            raise FileFormatError(f"lines of names must be such as '5 liver', got {shortened(repr(line))}")
        name = match[2] if '"' in line else COLOURS.sub("", match[2]).strip()
        names[int(match[1])] = name
    return names
