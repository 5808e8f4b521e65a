"""Runs of one reduced model in several threads: models are values, and compiled steps release Python's lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return the results of a function in the order of its items, computed in as many threads as Numba uses."""
    with ThreadPoolExecutor(numba.get_num_threads(), "palpate training") as threads:
        return list(threads.map(function, items))
