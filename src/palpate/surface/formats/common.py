"""Shared helpers of the surface readers: bounded numbers, counts and polygons."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import shortened
from palpate.surface.surface import MAX_TRIANGLES

Parts = dict[str, Callable[[], tuple[Floats, Ints]]]  # functions that return vertices and triangles, by the part's name

MAX_INDEX = 2**31


def printable_word(text: bytes) -> str:
    """Return a word of a file for a message."""
    return repr(shortened(text.decode("utf-8", "replace"), 30))


def read_count(text: bytes | str, what: str, most: int) -> int:
    """Return a count in decimal digits, at most `most`, the limit set by the file size."""
    text = text.encode("utf-8", "replace") if isinstance(text, str) else text
    if not re.fullmatch(rb"\d{1,18}", text):
        raise FileFormatError(f"the number of {what} must be an integer, got {printable_word(text)}")
    count = int(text)
    if what == "triangles" and count > MAX_TRIANGLES:
        raise triangle_count_error(count)
    if count > most:
        raise FileFormatError(f"the number of {what} must be at most {most} for the size of the file, got {count}")
    return count


def triangle_count_error(count: int) -> InputError:
    """Return the error of a file with too many triangles."""
    return InputError(
        f"it must have at most {MAX_TRIANGLES} triangles, got {count}; decimate it first (30,000 are enough)"
    )


def read_numbers(text: bytes) -> Floats:
    """Return the numbers of a text, separated by white space."""
    if not text.strip():
        return np.zeros(0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return np.fromstring(text, sep=" ")
    except (ValueError, DeprecationWarning):
        raise FileFormatError("it holds text where numbers are required") from None


def check_indices(values: NDArray[Any], what: str) -> Ints:
    """Return integer indices in [0, 2^31); raise `FileFormatError` for other values."""
    if values.size and not (values.min() >= 0 and values.max() < MAX_INDEX):  # false of NaN, too
        raise FileFormatError(f"its {what} must be from 0 to {MAX_INDEX - 1}")
    integers = values.astype(np.int64)
    if values.dtype.kind == "f" and np.any(integers != values):
        raise FileFormatError(f"its {what} must be integers")
    return integers


def fans(corners: Ints, sizes: Ints) -> Ints:
    """Return the triangles (t, 3) of polygons, each a fan about its first corner.

    The corners (c,) of all polygons follow one after the other. Polygons have `sizes` (p,) corners; those of fewer than
    three have no triangles.
    """
    first, k = _fan_indices(corners, sizes)
    return np.column_stack([corners[first], corners[first + k + 1], corners[first + k + 2]])


def strips(corners: Ints, sizes: Ints) -> Ints:
    """Return the triangles (t, 3) of strips, every other one reversed; the parameters are those of `fans`."""
    first, k = _fan_indices(corners, sizes)
    at, odd = first + k, k % 2
    return np.column_stack([corners[at], corners[at + 1 + odd], corners[at + 2 - odd]])


def _fan_indices(corners: Ints, sizes: Ints) -> tuple[Ints, Ints]:
    """Return the first corner of each triangle's polygon, and the triangle's index in it."""
    if sizes.sum() != len(corners):
        raise FileFormatError(f"its polygons must have {sizes.sum()} corners in total, got {len(corners)}")
    count = np.maximum(sizes - 2, 0)
    total = int(count.sum())
    if total > MAX_TRIANGLES:
        raise triangle_count_error(total)
    first = np.repeat(np.cumsum(sizes) - sizes, count)
    return first, np.arange(total) - np.repeat(np.cumsum(count) - count, count)
