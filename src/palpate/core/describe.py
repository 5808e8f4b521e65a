"""One line and one table for every object that prints.

An object lists facts: a name, a value and an SI unit each. `Described` joins them to one line for a terminal and to a
table for a notebook, with figures of three digits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, ClassVar, TypeVar

import numpy as np

from palpate.core.parameters import check_parameters, declared

Fact = tuple[str, Any, str]  # name, value, SI unit; a value of None is left out
Kind = TypeVar("Kind")

MAX_LINE_CHARACTERS = 160  # characters of a repr
MAX_VALUE_CHARACTERS = 120  # characters of one value
MAX_LISTED_NUMBERS = 6  # of a sequence that is printed in full
PREFIX_BY_POWER = {-9: "n", -6: "\u00b5", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
LENGTH_BY_POWER = {-6: "\u00b5m", -3: "mm", -2: "cm", 0: "m", 3: "km"}  # for areas and volumes
PREFIXED_UNITS = {"m", "s", "Pa", "N", "J", "Hz", "m/s", "N m", "N/m"}  # units that take a prefix
POWER_BY_UNIT = {"m^2": 2, "m^3": 3}


class Described:
    """An object that prints as one line, and as a table in a notebook.

    A subclass returns its facts from `_facts`, and may return a picture from `_picture`. A dataclass without `_facts`
    of its own lists its fields, arrays by their shape. The parameters of a dataclass are checked when it is made
    (`palpate.core.parameters.parameter`), unless it has a `__post_init__` of its own.
    """

    _title: ClassVar[str] = ""  # name of a class that stands behind another one
    _public: ClassVar[tuple[str, ...]]  # names that the reference lists, besides fields and those of bases; absent: all

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in cls.__dict__:
            cls.__repr__ = Described.__repr__  # type: ignore[method-assign]  # a dataclass keeps one of its own class

    def __post_init__(self) -> None:
        if declared(type(self)):
            check_parameters(self, self._owner())

    def _owner(self) -> str:
        """Return what follows the name of a parameter in messages."""
        kind = type(self).__name__
        if hasattr(self, "name"):
            return f" of {kind} {self.name!r}"
        return f" of {kind} on {self.group!r}" if hasattr(self, "group") else f" of a {kind}"

    def _facts(self) -> Sequence[Fact]:
        """Return the facts, the most useful first: by default the fields, without limits at infinity."""
        listed: Any = fields(self) if is_dataclass(self) else ()
        facts = []
        for each in listed:
            value, unit = getattr(self, each.name), each.metadata.get("unit")
            if each.repr and not (unit is not None and isinstance(value, float) and value == np.inf):
                facts.append((each.name.replace("_", " ") if unit is None else each.name, value, unit or ""))
        return facts

    def _picture(self) -> str:
        """Return a picture as SVG text, or nothing."""
        return ""

    def __repr__(self) -> str:
        name = self._title or type(self).__name__
        try:
            facts = self._facts()
        except AttributeError:  # an object whose construction has not ended
            return f"{name}(incomplete)"
        line = f"{name}("
        for place, (what, value, unit) in enumerate(fact for fact in facts if fact[1] is not None):
            longer = f"{line}{', ' if place else ''}{_said(what, value, unit)}"
            if len(longer) > MAX_LINE_CHARACTERS - 6:
                return f"{line}, ...)" if place else f"{longer[: MAX_LINE_CHARACTERS - 4]}...)"
            line = longer
        return f"{line})"

    def __dir__(self) -> list[str]:
        return listed_names(type(self), object.__dir__(self))

    def _repr_html_(self) -> str:
        rows = "".join(
            f'<tr><th style="text-align:left;padding-right:1em">{escape(_plain(what))}</th>'
            f'<td style="text-align:left">{escape(format_quantity(value, unit))}</td></tr>'
            for what, value, unit in self._facts()
            if value is not None
        )
        title = escape(self._title or type(self).__name__)
        table = f'<table><caption style="text-align:left"><b>{title}</b></caption><tbody>{rows}</tbody></table>'
        return f'<div style="display:flex;flex-wrap:wrap;gap:1em;align-items:center">{table}{self._picture()}</div>'


def listed_names(kind: type, names: Iterable[str]) -> list[str]:
    """Return the names of an object of a class for `dir`, those with an underscore included.

    Where a class or a base has `_public`, they are these names, the fields, and the names of a user's class.
    """
    public = [vars(base)["_public"] for base in kind.__mro__ if "_public" in vars(base)]
    if not public:
        return list(names)
    listed = {each.name for each in fields(kind)} if is_dataclass(kind) else set()
    listed |= {name for base in kind.__mro__ if not base.__module__.startswith("palpate") for name in vars(base)}
    return [name for name in names if name.startswith("_") or name in listed.union(*public)]


def described_tuple(kind: type[Kind]) -> type[Kind]:
    """Let a named tuple, which has no base class of its own, print its `_facts` as a `Described` object does."""
    for name in ("__repr__", "_repr_html_", "_picture", "_title"):
        setattr(kind, name, getattr(Described, name))
    return kind


def _said(name: str, value: Any, unit: str) -> str:
    """Return a fact as part of a line: `13 nodes`, `spacing=5 mm`, `shear modulus 10 kPa`, or a status alone."""
    said = format_quantity(value, unit)
    if name == "status":
        return said
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and not unit and value != 1:
        return f"{said} {name}"
    return f"{name}{'=' if name.isidentifier() else ' '}{said}"


def format_quantity(value: Any, unit: str = "") -> str:
    """Return a value with its unit in one short line: numbers with three digits, arrays by their shape."""
    tail = f" {unit}" if unit else ""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | np.integer):
        return f"{int(value):,}{tail}"
    if isinstance(value, float | np.floating):
        scale, scaled_unit = scaled(abs(float(value)), unit)
        return f"{_three(float(value) / scale)}{f' {scaled_unit}' if scaled_unit else ''}"
    if callable(value):
        return f"a function{f' [{unit}]' if unit else ''}"
    if isinstance(value, np.ndarray) and (value.ndim != 1 or len(value) > MAX_LISTED_NUMBERS):
        return f"array of shape {value.shape}"
    if isinstance(value, Mapping):
        return _joined(value, f"{len(value)} entries")
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes):
        if len(value) and all(isinstance(each, float | np.floating) or type(each) is int for each in value):
            return _numbers([float(each) for each in value], unit)
        return _joined(value, f"{len(value)} entries")
    return _plain(str(value) if isinstance(value, str) else repr(value)) + tail


def _joined(values: Any, otherwise: str) -> str:
    """Return a few names, or how many there are."""
    short = len(values) <= MAX_LISTED_NUMBERS and all(isinstance(each, str) for each in values)
    return _plain(", ".join(values) or "none") if short else "none" if not len(values) else otherwise


def _numbers(values: list[float], unit: str) -> str:
    scale, scaled_unit = scaled(max(map(abs, values)), unit)
    shown = ", ".join(_three(each / scale) for each in values[:MAX_LISTED_NUMBERS])
    more = ", ..." if len(values) > MAX_LISTED_NUMBERS else ""
    return f"{shown if len(values) == 1 else f'({shown}{more})'}{f' {scaled_unit}' if scaled_unit else ''}"


def scaled(size: float, unit: str) -> tuple[float, str]:
    """Return a divisor, and the unit with its prefix, so that a size lies from 1 to 1000 if possible."""
    power = POWER_BY_UNIT.get(unit, 1)
    prefixes = LENGTH_BY_POWER if unit in POWER_BY_UNIT else PREFIX_BY_POWER if unit in PREFIXED_UNITS else {0: unit}
    if not 0 < size < np.inf or len(prefixes) == 1:
        return 1.0, unit
    fits = [exponent for exponent in prefixes if size >= 0.9995 * 10.0 ** (power * exponent)] or [min(prefixes)]
    name = f"{prefixes[max(fits)]}^{power}" if unit in POWER_BY_UNIT else f"{prefixes[max(fits)]}{unit}"
    return 10.0 ** (power * max(fits)), name


def _three(value: float) -> str:
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e6 else f"{value:.3g}"


def _plain(text: str) -> str:
    """Return text in one line of printable characters, shortened."""
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(text.split()))
    return line if len(line) <= MAX_VALUE_CHARACTERS else f"{line[: MAX_VALUE_CHARACTERS - 3]}..."
