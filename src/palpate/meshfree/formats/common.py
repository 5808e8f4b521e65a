"""What the readers of surface files share: bounded numbers, counts and polygons."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats, Ints
from palpate.faults import FileFormatError, InputError
from palpate.files import shortened
from palpate.meshfree.surfaces import MOST_TRIANGLES

__all__ = ["Floats", "Ints", "Parts", "count_of", "fans", "numbers", "strips", "whole_numbers", "word"]

Parts = dict[str, Callable[[], tuple[Floats, Ints]]]  # vertices and triangles by the part's name, made when called

LARGEST_INDEX = 2**31


def word(text: bytes) -> str:
    """Return a word of a file for a message."""
    return repr(shortened(text.decode("utf-8", "replace"), 30))


def count_of(text: bytes | str, what: str, most: int) -> int:
    """Return a count written in decimal digits, at most `most`: what the size of the file has room for."""
    text = text.encode("utf-8", "replace") if isinstance(text, str) else text
    if not re.fullmatch(rb"\d{1,18}", text):
        raise FileFormatError(f"the number of {what} must be a whole number, got {word(text)}")
    count = int(text)
    if what == "triangles" and count > MOST_TRIANGLES:
        raise too_many(count)
    if count > most:
        raise FileFormatError(f"it states {count} {what} and has room for {most}")
    return count


def too_many(count: int) -> InputError:
    """Return the error of a file of too many triangles."""
    return InputError(
        f"it has {count} triangles; at most {MOST_TRIANGLES} are read; decimate it first (30,000 are enough)"
    )


def numbers(text: bytes) -> Floats:
    """Return the numbers of a text, which are separated by white space."""
    if not text.strip():
        return np.zeros(0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return np.fromstring(text, sep=" ")
    except (ValueError, DeprecationWarning):
        raise FileFormatError("it holds text where numbers are required") from None


def whole_numbers(values: NDArray[Any], what: str) -> Ints:
    """Return whole numbers from 0 to 2^31 as they are, and refuse others."""
    if values.size and not (values.min() >= 0 and values.max() < LARGEST_INDEX):  # false of NaN, too
        raise FileFormatError(f"its {what} must be from 0 to {LARGEST_INDEX - 1}")
    whole = values.astype(np.int64)
    if values.dtype.kind == "f" and np.any(whole != values):
        raise FileFormatError(f"its {what} must be whole numbers")
    return whole


def fans(corners: Ints, sizes: Ints) -> Ints:
    """Return the triangles (t, 3) of polygons, each a fan about its first corner.

    Parameters
    ----------
    corners : (c,) array
        Of all polygons in turn.
    sizes : (p,) array
        Numbers of corners, c in all; polygons of fewer than three have no triangles.
    """
    first, k = _within(corners, sizes)
    return np.column_stack([corners[first], corners[first + k + 1], corners[first + k + 2]])


def strips(corners: Ints, sizes: Ints) -> Ints:
    """Return the triangles (t, 3) of strips, every other one turned; parameters as of `fans`."""
    first, k = _within(corners, sizes)
    at, odd = first + k, k % 2
    return np.column_stack([corners[at], corners[at + 1 + odd], corners[at + 2 - odd]])


def _within(corners: Ints, sizes: Ints) -> tuple[Ints, Ints]:
    """First corner of each triangle's polygon, and the triangle's number in it."""
    if sizes.sum() != len(corners):
        raise FileFormatError(f"its polygons have {sizes.sum()} corners in all, but {len(corners)} are given")
    count = np.maximum(sizes - 2, 0)
    total = int(count.sum())
    if total > MOST_TRIANGLES:
        raise too_many(total)
    first = np.repeat(np.cumsum(sizes) - sizes, count)
    return first, np.arange(total) - np.repeat(np.cumsum(count) - count, count)
