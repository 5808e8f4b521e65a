"""JSON schema of scene files, for editors, from the same sections that read them."""

from __future__ import annotations

import math
import types
import typing
from dataclasses import MISSING, is_dataclass
from typing import Any

from palpate.core.parameters import FACTORS_BY_UNIT, fields_of
from palpate.scenes.description import Description

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of a scene file."""
    return {"$schema": SCHEMA_DIALECT, "title": "palpate scene"} | _section(Description)


def _section(section: type) -> dict[str, Any]:
    """Return the schema of a section."""
    properties, required = {}, []
    for name, (field, kind) in fields_of(section).items():
        about: dict[str, Any] = _value(kind, field.metadata)
        if field.metadata["help"]:
            about["description"] = _sentence(field.metadata["help"], field.metadata["unit"])
        if isinstance(field.default, bool | int | float | str) and field.default != "":
            about["default"] = field.default
        properties[name] = about
        if field.default is MISSING and field.default_factory is MISSING:
            required.append(name)
    made: dict[str, Any] = {"type": "object", "properties": properties, "additionalProperties": False}
    return made | {"required": required} if required else made


def _sentence(text: str, unit: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{f' [{unit}]' if unit else ''}."


def _value(kind: Any, about: Any) -> dict[str, Any]:
    """Return the schema of a value of a setting."""
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        kinds = [each for each in typing.get_args(kind) if each is not type(None)]
        return _value(kinds[0], about)
    if is_dataclass(kind):
        return _section(typing.cast(type, kind))
    if origin is tuple:
        inner = typing.get_args(kind)
        made: dict[str, Any] = {"type": "array", "items": _value(inner[0], {**about, "length": None})}
        length = about["length"] or (len(inner) if inner[-1] is not Ellipsis else None)
        return made | ({"minItems": length, "maxItems": length} if length else {})
    if origin is dict:
        return {"type": "object", "additionalProperties": {"type": ["number", "string", "array"]}}
    if kind is bool:
        return {"type": "boolean"}
    if kind is str:
        return {"type": "string"} | ({"enum": list(about["choices"])} if about["choices"] else {})
    number = _range(about) | {"type": "integer" if kind is int else "number"}
    if kind is int:
        return number
    units = "|".join(unit.replace("^", r"\^") for unit in FACTORS_BY_UNIT[about["unit"]])
    text = {"type": "string", "pattern": rf"^\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*({units})?\s*$"}
    return {"anyOf": [number, text]}


def _range(about: Any) -> dict[str, Any]:
    limits = {}
    if math.isfinite(about["low"]):
        limits["exclusiveMinimum" if about["open_low"] else "minimum"] = about["low"]
    if math.isfinite(about["high"]):
        limits["maximum"] = about["high"]
    return limits
