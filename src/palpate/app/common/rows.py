"""Rows of a report for people: a label, and a template filled from the JSON of the report.

The template ``"{cloud/spacing:.3g mm} between {cloud/nodes} nodes"`` names values by their keys in the report, which
are in SI units, and says with which digits and in which unit they are printed. A row is left out where the report has
no such value, and is ``-`` where the value is None.
"""

from __future__ import annotations

import string
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from palpate.app.common.console import Table, quantities_table

__all__ = ["Rows", "fill_template", "quantities", "rows_of"]

Values = Mapping[str, Any]
Rows = Mapping[str, str | Callable[[Values], str]]  # templates, or functions of the values, by label

UNIT_SCALES = {
    "mm": 1e3, "mm^2": 1e6, "cm^2": 1e4, "litres": 1e3, "ms": 1e3, "us": 1e6, "mN": 1e3, "mJ": 1e3, "kPa": 1e-3,
    "MB": 1e-6,
}  # of units that are not SI units  # fmt: skip
LARGEST_SHARE = 10.0  # from which percentages are not printed


class _Unknown(Exception):
    """A value of a template is None."""


class _Template(string.Formatter):
    """Formatter of ``{key/key:digits unit}``."""

    def get_field(self, field_name: str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        value: Any = kwargs
        for key in field_name.split("/"):
            if not isinstance(value, Mapping):
                raise KeyError(field_name)
            value = value[key]
        return value, field_name

    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None:
            raise _Unknown
        digits, _, unit = format_spec.partition(" ")
        if digits.endswith("%") and value >= LARGEST_SHARE:
            return f"> {LARGEST_SHARE:.0%}"
        if unit in UNIT_SCALES:
            value = UNIT_SCALES[unit] * value
        if unit and not digits:  # three digits, but no power of ten
            digits = ",.3g" if abs(value) < 1000 else ",.0f"
        return f"{value:{digits}} {unit}".rstrip()


def fill_template(template: str, values: Values) -> str | None:
    """Return a template filled with values; None if they lack one of its keys, ``-`` if one is None."""
    try:
        return _Template().vformat(template, (), values)
    except KeyError:
        return None
    except _Unknown:
        return "-"


def rows_of(rows: Rows, *entries: Values) -> dict[str, list[str]]:
    """Return the rows that at least one entry has values for, by label, with a text for every entry."""
    texts = {
        label: [each(entry) if callable(each) else fill_template(each, entry) for entry in entries]
        for label, each in rows.items()
    }
    return {label: [text or "-" for text in row] for label, row in texts.items() if any(text for text in row)}


def quantities(title: str, rows: Rows, entries: Mapping[str, Values]) -> Table:
    """Return a table of rows with a column for every entry, under its name."""
    return quantities_table(title, list(entries), rows_of(rows, *entries.values()))
