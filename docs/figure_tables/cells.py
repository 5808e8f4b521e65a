"""Cells and tables, and the register of blocks."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

Row = dict[str, Any]
ERRORS = ("displacement", "velocity", "energy", "reaction")
MIN_SHARE = 1e-5  # smaller shares are below it


@dataclass(frozen=True)
class Block:
    """A generated part of a page."""

    table: Callable[..., str]  # takes the results of each file
    files: tuple[str, ...]  # names of result files, without .json
    command: str  # that makes them
    timed: bool  # it has times, which depend on what else the machine did


BLOCKS: dict[str, Block] = {}


def block(*files: str, command: str, timed: bool = False) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Register a function of results as the block of its name."""

    def register(table: Callable[..., str]) -> Callable[..., str]:
        BLOCKS[table.__name__] = Block(table, files, command, timed)
        return table

    return register


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def significant(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits, or more where it has more before the point."""
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "–"
    if abs(value) >= 10**digits:
        return f"{value:,.0f}".replace("-", "−")
    places = digits - 1 - math.floor(math.log10(float(f"{abs(value):.{digits - 1}e}")))  # 9.99 has those of 10
    return f"{round(value, places):.{max(places, 0)}f}".replace("-", "−")


def percent(value: float, digits: int = 2) -> str:
    """Return a share in per cent, with so many significant digits; from 100 % on without decimals."""
    if 0 < abs(value) < MIN_SHARE:
        return f"< {100 * MIN_SHARE:g} %"
    return f"{100 * value:.0f} %" if abs(value) >= 1 else f"{significant(100 * value, digits)} %"


def signed(value: float, places: int = 1, unit: str = " %") -> str:
    """Return a signed error in per cent; what rounds to zero has the sign +."""
    return f"{round(100 * value, places) + 0.0:+.{places}f}{unit}".replace("-", "−")


def span(values: Iterable[float], cell: Callable[[float], str]) -> str:
    """Return the least and the largest of some values, or one where both print alike."""
    every = sorted(values)
    least, most = cell(every[0]), cell(every[-1])
    return least if least == most else f"{least} to {most}"


def largest(values: Iterable[float], places: int = 1) -> str:
    """Return the largest absolute value of some shares, in per cent without the sign."""
    return f"{100 * max(map(abs, values)):.{places}f}"


def microseconds(duration: float) -> str:
    """Return a duration in microseconds."""
    return f"{significant(1e6 * duration)} µs"


def millimetres(spacing: float) -> str:
    """Return a length in millimetres."""
    return f"{significant(1e3 * spacing, 3).rstrip('0').rstrip('.')} mm"


def distinct(values: Iterable[Any], reverse: bool = True) -> list[Any]:
    """Return distinct values in order; spacings from large to small."""
    return sorted(set(values), reverse=reverse)


def find(rows: Iterable[Row], **key: Any) -> Row | None:
    """Return the first row that has these values, numbers to 1e-6 of themselves."""
    return next((row for row in rows if all(_equal(row.get(name), value) for name, value in key.items())), None)


def _equal(one: Any, other: Any) -> bool:
    numbers = isinstance(one, float) and isinstance(other, float)
    return math.isclose(one, other, rel_tol=1e-6) if numbers else one == other
