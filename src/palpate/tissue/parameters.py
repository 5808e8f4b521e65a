"""Parameters of a law as a vector.

A field is a number or a nested sequence of numbers. The name of a number in a sequence holds its
index: `C[0]`, or `terms[1][0]`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.faults import InputError, brief
from palpate.tissue.materials import Material

INDEX_PATTERN = re.compile(r"\[(\d+)\]")


def own_fields(law: type[Material]) -> list[str]:
    """Return the names of the fields of a law beyond those of `Material`."""
    base = {f.name for f in fields(Material)}
    return [f.name for f in fields(law) if f.name not in base]


def is_sequence(law: type[Material], field: str) -> bool:
    """Return whether a law's field takes several numbers."""
    declared = str(law.__dataclass_fields__[field].type)
    return "tuple" in declared or "Sequence" in declared


def field_metadata(law: type[Material], name: str) -> Mapping[str, Any]:
    """Return the metadata of a parameter's field, such as its unit."""
    return law.__dataclass_fields__[INDEX_PATTERN.sub("", name)].metadata


def flatten(tree: Mapping[str, Any]) -> dict[str, float]:
    """Return nested sequences of numbers by field as numbers by name."""
    return {name: number for field, value in tree.items() for name, number in _leaves(field, value)}


def _leaves(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, list | tuple | np.ndarray):
        for i, item in enumerate(value):
            yield from _leaves(f"{name}[{i}]", item)
        return
    try:
        yield name, float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be a number, got {brief(value)}") from None


class Layout:
    """Order of a law's parameters in a vector, whose values are `first` (k,).

    `given` are values of fields. A sequence must be given, because it defines the length. A missing number is 1, or its
    default.
    """

    def __init__(self, law: type[Material], values: Mapping[str, Any]) -> None:
        names = own_fields(law)
        unknown = [name for name in values if name not in names]
        if unknown:
            raise InputError(f"a parameter of {law.__name__} must be one of {', '.join(names)}, got {unknown[0]}")
        self.law = law
        self._tree = {f.name: self._value(f, values) for f in fields(law) if f.name in names}
        numbers = flatten(self._tree)
        self.names, self.first = tuple(numbers), np.array(list(numbers.values()))

    def _value(self, field: Any, values: Mapping[str, Any]) -> Any:
        if field.name in values:
            return values[field.name]
        if field.default is not MISSING:
            return field.default
        if is_sequence(self.law, field.name):
            raise InputError(
                f"{field.name} of {self.law.__name__} must have start values, got none; they define the length of the "
                "sequence"
            )
        return 1.0

    def arguments(self, vector: NDArray[np.float64]) -> dict[str, Any]:
        """Return the arguments of the law for a vector of parameters."""
        left = iter(vector)
        return {name: _fill(value, left) for name, value in self._tree.items()}

    def places(self, name: str) -> list[int]:
        """Return the indices of a parameter in the vector; all indices of a sequence for the name of a field."""
        indices = [i for i, entry in enumerate(self.names) if entry == name or entry.startswith(f"{name}[")]
        if not indices:
            raise InputError(f"a parameter of {self.law.__name__} must be one of {', '.join(self.names)}, got {name}")
        return indices


def _fill(value: Any, left: Iterator[float]) -> Any:
    if isinstance(value, list | tuple | np.ndarray):
        return tuple(_fill(item, left) for item in value)
    return float(next(left))
