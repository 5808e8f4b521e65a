"""The parameters of a law as one vector, whatever its fields: numbers, or sequences of numbers of any depth.

A number in a sequence is named by its place: `C[0]`, or `terms[1][0]`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.faults import InputError
from palpate.tissue.materials import Material

__all__ = ["Layout", "field_metadata", "flatten", "is_sequence", "own_fields"]

INDEX = re.compile(r"\[(\d+)\]")


def own_fields(law: type[Material]) -> list[str]:
    """Return the names of the fields in which a law differs from other materials."""
    base = {f.name for f in fields(Material)}
    return [f.name for f in fields(law) if f.name not in base]


def is_sequence(law: type[Material], field: str) -> bool:
    """Return whether a law's field takes several numbers."""
    declared = str(law.__dataclass_fields__[field].type)
    return "tuple" in declared or "Sequence" in declared


def field_metadata(law: type[Material], name: str) -> Mapping[str, Any]:
    """Return what the law's field says about a parameter beyond its name, such as its unit."""
    return law.__dataclass_fields__[INDEX.sub("", name)].metadata


def flatten(tree: Mapping[str, Any]) -> dict[str, float]:
    """Return numbers and sequences of numbers by field as numbers by name."""
    return {name: number for field, value in tree.items() for name, number in _leaves(field, value)}


def _leaves(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, list | tuple | np.ndarray):
        for i, item in enumerate(value):
            yield from _leaves(f"{name}[{i}]", item)
        return
    try:
        yield name, float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be a number, got {str(value)[:60]!r}") from None


class Layout:
    """The order of a law's parameters in a vector.

    Parameters
    ----------
    law : type of Material
    given : dict
        Values of fields. A field that is a sequence must be among them, to say how long it is; a number that is left
        out is 1, or its default.

    Attributes
    ----------
    names : tuple of str
    first : (k,) array
        The values given.

    Raises
    ------
    InputError
        A field the law does not have, something that is not a number, or a sequence left out.
    """

    def __init__(self, law: type[Material], given: Mapping[str, Any]) -> None:
        own = own_fields(law)
        unknown = [name for name in given if name not in own]
        if unknown:
            raise InputError(f"{unknown[0]} is no parameter of {law.__name__}: allowed are {', '.join(own)}")
        self.law = law
        self._tree = {f.name: self._value(f, given) for f in fields(law) if f.name in own}
        numbers = flatten(self._tree)
        self.names, self.first = tuple(numbers), np.array(list(numbers.values()))

    def _value(self, field: Any, given: Mapping[str, Any]) -> Any:
        if field.name in given:
            return given[field.name]
        if field.default is not MISSING:
            return field.default
        if is_sequence(self.law, field.name):
            raise InputError(
                f"{field.name} of {self.law.__name__} is a sequence: give values to start from, to say how long it is"
            )
        return 1.0

    def arguments(self, vector: NDArray[np.float64]) -> dict[str, Any]:
        """Return the law's own arguments for a vector of parameters."""
        left = iter(vector)
        return {name: _filled(value, left) for name, value in self._tree.items()}

    def places(self, name: str) -> list[int]:
        """Return where a parameter stands in the vector; all places of its sequence for the name of a field.

        Raises
        ------
        InputError
            There is no parameter of this name.
        """
        found = [i for i, own in enumerate(self.names) if own == name or own.startswith(f"{name}[")]
        if not found:
            raise InputError(f"{name} is no parameter of {self.law.__name__}: allowed are {', '.join(self.names)}")
        return found


def _filled(value: Any, left: Iterator[float]) -> Any:
    if isinstance(value, list | tuple | np.ndarray):
        return tuple(_filled(item, left) for item in value)
    return float(next(left))
