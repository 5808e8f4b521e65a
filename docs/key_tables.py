"""Write the tables of keys in docs/reference/scene_files.md from the sections of scene files.

    python docs/key_tables.py

The table below the heading of a section has a row for each of its fields. `tests/scenes/test_scene_docs.py` fails
where the page and the sections differ.
"""

from __future__ import annotations

import re
from dataclasses import MISSING
from pathlib import Path
from typing import Any

from palpate.core.parameters import fields_of
from palpate.scenes import description as sections

PAGE = Path(__file__).parent / "reference" / "scene_files.md"
HEADS = {
    "[surface]": sections.Shape, "[body]": sections.Body, "[tissue]": sections.Tissue,
    "[tissue] relaxation = { ... }": sections.Relaxation, "[tissue] fibres = { ... }": sections.Fibre,
    "[[region]]": sections.Region, "[[support]]": sections.Support, "place = { ... }": sections.Place,
    "plane = { ... }": sections.Plane, "box = { ... }": sections.Box, "ball = { ... }": sections.Ball,
    "painted = { ... }": sections.Painted, "near = { ... }": sections.Near, "[tool]": sections.Tool,
    "[cut]": sections.Cut, "[[load]]": sections.Load, "[run]": sections.Run, "[training]": sections.Training,
}  # fmt: skip
TABLE = re.compile(r"^### `(.*)`\n(?:(?!^#).*\n)*?\| key \|.*\n\|---.*\n((?:\| .*\n)+)", re.MULTILINE)


def row(name: str, field: Any) -> str:
    """Return the row of a key."""
    about = field.metadata
    choices = f": {', '.join(f'`{each}`' for each in about['choices'])}" if about["choices"] else ""
    unit = f" [{about['unit']}]" if about["unit"] else ""
    return f"| `{name}`{unit} | {shown_default(field)} | {about['help']}{choices} |\n"


def shown_default(field: Any) -> str:
    """Return the default of a key as TOML, or nothing for one that means that nothing is given."""
    if field.default is MISSING:
        return "required" if field.default_factory is MISSING else ""
    if isinstance(field.default, bool):
        return str(field.default).lower()
    if isinstance(field.default, int | float):
        return f"{field.default:g}"
    return f'`"{field.default}"`' if isinstance(field.default, str) and field.default else ""


def rewritten(text: str) -> str:
    """Return the page with the rows of all tables."""

    def replaced(match: re.Match[str]) -> str:
        rows = "".join(row(name, field) for name, (field, _) in fields_of(HEADS[match[1]]).items())
        return match[0][: match.start(2) - match.start()] + rows

    return TABLE.sub(replaced, text)


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
