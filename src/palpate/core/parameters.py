"""Parameters: dataclass fields with unit, default, range and help, each declared once.

Tools, loads, materials and the sections of scene files are frozen dataclasses whose fields are made by `parameter`.
From these fields follow the check of a value and its message, the line that an object prints (`palpate.core.describe`),
the reading of a scene file, its JSON schema (`palpate.scenes.schema`), its table in docs/reference/scene_files.md, the
options of commands (`palpate.app.common.arguments.add_parameter`) and the sliders of the page.
"""

from __future__ import annotations

import dataclasses
import math
import re
import types
import typing
from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from decimal import Decimal
from difflib import get_close_matches
from typing import Any

from palpate.core.faults import InputError, brief, interval, number_in_range

# units that a text may carry, by the SI unit of the setting; a number without unit is in the SI unit
FACTORS_BY_UNIT: dict[str, dict[str, float]] = {
    "": {"%": 0.01},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "1/s": {"1/s": 1.0},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "N": {"N": 1.0, "mN": 1e-3},
    "N m": {"N m": 1.0, "mN m": 1e-3},
    "kg/m^3": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "m/s^2": {"m/s^2": 1.0},
    "m^3": {"m^3": 1.0, "l": 1e-3, "ml": 1e-6, "cm^3": 1e-6},
    "N/m^3": {"N/m^3": 1.0, "Pa/m": 1.0, "Pa/mm": 1e3, "kPa/cm": 1e5, "kPa/mm": 1e6, "N/cm^3": 1e6},
    "N s/m^3": {"N s/m^3": 1.0, "Pa s/m": 1.0, "kPa s/m": 1e3},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "J/m^2": {"J/m^2": 1.0, "mJ/cm^2": 10.0, "kJ/m^2": 1e3},
    "rad": {"rad": 1.0, "deg": math.pi / 180},
}
DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d", re.ASCII)
QUANTITY_PATTERN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*", re.ASCII)
MAX_TEXT_CHARACTERS, MAX_ENTRIES = 4000, 10_000  # of a text; of a list
MAX_PARAMETER_ENTRIES = 100  # of a list that is one parameter of a law


@dataclass(frozen=True)
class Fault(Exception):
    """A value of a scene file that is wrong: where it stands, and why."""

    path: tuple[str | int, ...]  # keys that lead to the value, and indices in lists
    message: str


def parameter(
    unit: str = "",
    default: Any = MISSING,
    help: str = "",
    *,
    low: float = -math.inf,
    high: float = math.inf,
    above: float | None = None,
    choices: tuple[str, ...] = (),
    length: int | None = None,
    most: int | None = None,
) -> Any:
    """Return the dataclass field of a parameter; one without default must be given.

    `unit` is the SI unit of its numbers, whose range is [low, high] or (above, high]. `choices` are the values of a
    text. A list has `length` entries, or at most `most`. `help` is for messages, options, tables and the schema.
    """
    low, open_low = (low, False) if above is None else (above, True)
    about = {"unit": unit, "help": help, "low": low, "high": high, "open_low": open_low, "choices": choices}
    about |= {"length": length, "most": most}
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default), metadata=about)
    return dataclasses.field(default=default, metadata=about)


def limits(about: Mapping[str, Any]) -> dict[str, Any]:
    """Return range, unit and remedy of a parameter, as arguments of `number_in_range`."""
    what, unit = re.split("[;:]", about["help"])[0], about["unit"]
    remedy = f"give {what}{f' [{unit}]' if unit else ''}" if what else "change it"
    return {name: about[name] for name in ("low", "high", "open_low", "unit")} | {"remedy": remedy}


def declared(kind: type) -> tuple[dataclasses.Field[Any], ...]:
    """Return the fields of a dataclass that are made by `parameter`."""
    return tuple(field for field in fields(kind) if "low" in field.metadata)


def check_parameters(record: Any, owner: str = "", left_out: Collection[str] = ()) -> None:
    """Check the numbers and texts of a dataclass by its declarations, and keep numbers as floats.

    `owner` follows the name of a parameter in messages, such as ``" of a Sphere"``. Parameters `left_out` are not
    checked.
    """
    for field in (each for each in declared(type(record)) if each.name not in left_out):
        value, about, kind = getattr(record, field.name), field.metadata, str(field.type)
        name = f"{field.name}{owner}"
        if (value is None and field.default is None) or ("Callable" in kind and callable(value)):
            continue
        if kind.startswith("tuple[float"):
            listed = list(value) if isinstance(value, list | tuple) or hasattr(value, "tolist") else [value]
            if about["most"] is not None and len(listed) > about["most"]:
                raise InputError(f"{name} must have at most {about['most']} entries, got {len(listed)}; leave some out")
            value = tuple(
                number_in_range(f"{field.name}[{i}]{owner}", x, **limits(about)) for i, x in enumerate(listed)
            )
        elif kind == "bool":
            if not isinstance(value, bool):
                raise InputError(f"{name} must be True or False, got {brief(value)}; give one of them")
        elif kind.startswith("float") or kind == "<class 'float'>":
            if not (isinstance(value, float) and value == field.default):  # which may be infinite
                value = number_in_range(name, value, **limits(about))
        else:
            continue
        object.__setattr__(record, field.name, value)


def fields_of(section: type) -> dict[str, tuple[dataclasses.Field[Any], Any]]:
    """Return the fields of a section by name, each with its type."""
    kinds = typing.get_type_hints(section)
    return {field.name: (field, kinds[field.name]) for field in fields(section)}


def read_section(section: type, table: Any, path: tuple[str | int, ...] = ()) -> Any:
    """Return a section from a table of a TOML file."""
    values = read_values(section, table, path)
    for name, (field, _) in fields_of(section).items():
        if name not in values and field.default is MISSING and field.default_factory is MISSING:
            raise Fault((*path, name), f"must be given in {_place(path)}; it is {field.metadata['help']}")
    try:
        return section(**values)
    except InputError as error:
        raise Fault(path, str(error)) from error


def read_values(section: type, table: Any, path: tuple[str | int, ...]) -> dict[str, Any]:
    """Return the values of some settings of a section by name; raise `Fault` as `read_section`."""
    if not isinstance(table, Mapping):
        raise Fault(path, f"must be a table, got {brief(table)}; write [{path[-1] if path else 'section'}]")
    fields_by_name = fields_of(section)
    values = {}
    for key, value in table.items():
        if key not in fields_by_name:
            near = get_close_matches(str(key)[:60], fields_by_name, 1)
            remedy = f"did you mean {near[0]}?" if near else f"known are {', '.join(fields_by_name)}"
            raise Fault((*path, key), f"is not a key of {_place(path)}; {remedy}")
        field, kind = fields_by_name[key]
        values[key] = _read(kind, field.metadata, value, (*path, key))
    return values


def written_section(section: Any) -> dict[str, Any]:
    """Return the values of a section that differ from their defaults, as `read_section` reads them."""
    return {
        name: written_value(getattr(section, name))
        for name, (field, _) in fields_of(type(section)).items()
        if field.default is MISSING or getattr(section, name) != field.default
    }


def written_value(value: Any) -> Any:
    """Return a value as a file has it."""
    if is_dataclass(value):
        return written_section(value)
    if isinstance(value, tuple):
        return [written_value(each) for each in value]
    return value


def quantity(value: Any, unit: str) -> float:
    """Return a number in the SI unit of a parameter, from a number or a text such as ``"4.5 mm"``."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:  # a whole number of hundreds of digits
            return math.inf if value > 0 else -math.inf
    factors = FACTORS_BY_UNIT[unit]
    example = f'"12 {next(iter(factors))}"' if unit else "0.3 or 30 %"
    match = QUANTITY_PATTERN.fullmatch(value) if isinstance(value, str) and len(value) <= MAX_TEXT_CHARACTERS else None
    if isinstance(value, str) and DECIMAL_COMMA.match(value):
        raise InputError(f"must have a decimal point, got {brief(value)}; write {value.replace(',', '.', 1)!r:.40}")
    if match is None:
        raise InputError(
            f"must be a number{f' [{unit}]' if unit else ''} or a text such as {example}, got {brief(value)}"
        )
    number, word = float(match[1]), match[2]
    if word is None:
        return number
    if word not in factors:
        raise InputError(f"must have one of the units {', '.join(factors)}, got {word!r:.40}; write it as {example}")
    if not (math.isfinite(number) and number):
        return number
    return float(Decimal(match[1]) * Decimal(repr(factors[word])))  # 9 mm are 0.009 m to the last bit


def check_number(value: Any, about: Mapping[str, Any]) -> float:
    """Return a number of a setting in SI units; raise `InputError` out of its range."""
    number, bounds = quantity(value, about["unit"]), limits(about)
    try:
        return number_in_range("", number, **bounds)
    except InputError:
        remedy = bounds.pop("remedy")
        raise InputError(f"must be in {interval(**bounds)}, got {brief(value)}; {remedy}") from None


def _read(kind: Any, about: Mapping[str, Any], value: Any, path: tuple[str | int, ...]) -> Any:
    """Return the value of a setting of a type."""
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        return _read_union(typing.get_args(kind), about, value, path)
    if is_dataclass(kind):
        return read_section(typing.cast(type, kind), value, path)
    if origin is tuple:
        return _read_list(typing.get_args(kind)[0], about, value, path)
    if origin is dict:
        if not isinstance(value, Mapping):
            raise Fault(path, f"must be a table such as {{ C1 = 1100 }}, got {brief(value)}")
        for key, each in value.items():
            if not _is_parameter(each):
                raise Fault((*path, key), f"must be a number, or a text with a unit, got {brief(each)}; change it")
        return dict(value)  # quantities whose units the law has
    try:
        return _read_scalar(kind, about, value)
    except InputError as error:
        raise Fault(path, str(error)) from error


def _read_union(kinds: tuple[Any, ...], about: Mapping[str, Any], value: Any, path: tuple[str | int, ...]) -> Any:
    """Return a value of one of several types; the kind of the value chooses among them."""
    kinds = tuple(kind for kind in kinds if kind is not type(None))
    for kind in kinds[:-1]:
        if (is_dataclass(kind) and isinstance(value, Mapping)) or (kind is bool and isinstance(value, bool)):
            return _read(kind, about, value, path)
    return _read(kinds[-1], about, value, path)


def _read_list(kind: Any, about: Mapping[str, Any], value: Any, path: tuple[str | int, ...]) -> tuple[Any, ...]:
    length = about["length"]
    count = "" if length is None else f" of {length}"
    if not isinstance(value, list | tuple) or len(value) > MAX_ENTRIES or length not in (None, len(value)):
        raise Fault(path, f"must be a list{count}, got {brief(value)}; write it in square brackets")
    inner = dict(about) | {"length": None}
    if typing.get_origin(kind) is tuple:  # of points
        inner["length"] = len(typing.get_args(kind))
    return tuple(_read(kind, inner, each, (*path, index)) for index, each in enumerate(value))


def _read_scalar(kind: Any, about: Mapping[str, Any], value: Any) -> Any:
    if kind is float:
        return check_number(value, about)
    if kind is bool:
        if not isinstance(value, bool):
            raise InputError(f"must be true or false, got {brief(value)}")
        return value
    if kind is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise InputError(f"must be a whole number, got {brief(value)}")
        return int(check_number(value, about))
    if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT_CHARACTERS:
        raise InputError(f"must be a text in quotes, got {brief(value)}")
    if about["choices"] and value not in about["choices"]:
        near = get_close_matches(value[:60], about["choices"], 1)
        remedy = f"did you mean {near[0]!r}?" if near else "use one of them"
        raise InputError(f"must be one of {', '.join(about['choices'])}, got {value!r:.60}; {remedy}")
    return value


def _is_parameter(value: Any) -> bool:
    """Return True for a number, a text, or a short list of them, whose unit and range a law checks."""
    if isinstance(value, list | tuple):
        return 0 < len(value) <= MAX_PARAMETER_ENTRIES and not any(
            isinstance(each, list | tuple) or not _is_parameter(each) for each in value
        )
    if isinstance(value, str):
        return len(value) <= MAX_TEXT_CHARACTERS
    return isinstance(value, int | float) and not isinstance(value, bool)


def _place(path: tuple[str | int, ...]) -> str:
    """Return the name of a table for messages."""
    names = [str(part) for part in path if isinstance(part, str)]
    return f"[{'.'.join(names)}]" if names else "the file"
