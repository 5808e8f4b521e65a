"""Rows of a report for people: a label, and a template filled from the JSON of the report.

The template ``"{cloud/spacing:.3g mm} between {cloud/nodes} nodes"`` names values by their keys in the report, which
are in SI units, and says with which digits and in which unit they are printed. A list is printed as ``1 x 2 x 3 mm``. A
row is left out where the report has no such value, and is ``-`` where the value is None. A function of the report
may stand in place of a template; it raises `KeyError` where its value is missing.
"""

from __future__ import annotations

import string
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from palpate.app.common.console import Table, quantities_table

Values = Mapping[str, Any]
Rows = dict[str, str | Callable[[Values], str]]  # templates, or functions of the values, by label

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
        return _look_up(kwargs, field_name.split("/")), field_name

    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None:
            raise _Unknown
        digits, _, unit = format_spec.partition(" ")
        numbers = value if isinstance(value, list) else [value]
        return f"{' x '.join(_digits(number, digits, unit) for number in numbers)} {unit}".rstrip()


def _look_up(values: Values, keys: Sequence[str]) -> Any:
    """Return the value under some keys, of which those of lists are indices; raise `KeyError` without one."""
    value: Any = values
    for key in keys:
        if not isinstance(value, Mapping | list):
            raise KeyError(key)
        value = value[int(key)] if isinstance(value, list) else value[key]
    return value


def _digits(value: Any, digits: str, unit: str) -> str:
    if digits.endswith("%") and value >= LARGEST_SHARE:
        return f"> {LARGEST_SHARE:.0%}"
    if unit in UNIT_SCALES:
        value = UNIT_SCALES[unit] * value
    if unit and not digits:  # three digits, but no power of ten
        digits = ",.3g" if abs(value) < 1000 else ",.0f"
    return f"{value:{digits}}"


def fill_template(template: str, values: Values) -> str:
    """Return a template filled with values; ``-`` if one is None; raise `KeyError` if there is none of its keys."""
    try:
        return _Template().vformat(template, (), values)
    except _Unknown:
        return "-"


def named_rows(label: str, keys: str, template: str, names: Iterable[str]) -> Rows:
    """Return a row for each name of a mapping, whose names may be a person's own.

    `label` has ``{}`` for the name, `template` one ``{value}``; `keys` are those of the mapping in the report.
    """

    def text_of(name: str) -> Callable[[Values], str]:
        return lambda values: fill_template(template, {"value": _look_up(values, [*keys.split("/"), name])})

    return {label.format(name): text_of(name) for name in names}


def rows_of(rows: Rows, *entries: Values) -> dict[str, list[str]]:
    """Return the rows that at least one entry has values for, by label, with a text for every entry."""
    texts = {label: [_text(each, entry) for entry in entries] for label, each in rows.items()}
    return {label: [text or "-" for text in row] for label, row in texts.items() if any(text for text in row)}


def _text(row: str | Callable[[Values], str], values: Values) -> str | None:
    try:
        return row(values) if callable(row) else fill_template(row, values)
    except KeyError:
        return None


def quantities(title: str, rows: Rows, entries: Mapping[str, Values], first: str = "quantity") -> Table:
    """Return a table of rows with a column for every entry, under its name."""
    return quantities_table(title, list(entries), rows_of(rows, *entries.values()), first)
