"""How long the steps took and how late they began.

Lateness is measured by the clock on the wall, from a deadline to the beginning of its step: it is the scheduler's.
Computing time is what a processor spent on the step: it is the model's. A deadline is missed where a step was not
finished one period after it; only where the computing time alone exceeds the period is that the model's fault.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.describe import Described, Fact
from palpate.realtime.clock import ABSOLUTE

__all__ = ["Distribution", "Statistics", "Tally", "count_step"]

LOWEST, DECADES, BINS_PER_DECADE = 1e-7, 8, 40  # from 0.1 us to 10 s, each bin 6 % wide
BINS = DECADES * BINS_PER_DECADE
EDGES = LOWEST * 10 ** (np.arange(BINS + 1) / BINS_PER_DECADE)
COMPUTING, LATENESS = 0, 1
MISSED, OVERRUN, DROPPED = 0, 1, 2
TOLERATED = 0.01  # share of steps that may compute for longer than a period


class Tally(NamedTuple):
    """What the loop counts.

    Parameters
    ----------
    bins : (2, BINS) int64
        Steps by computing time and by lateness.
    most : (2,) float64 [s]
    counts : (3,) int64
        Deadlines missed, steps that computed for longer than a period, periods without a step.
    """

    bins: NDArray[np.int64]
    most: NDArray[np.float64]
    counts: NDArray[np.int64]

    @classmethod
    def new(cls) -> Tally:
        """Count nothing yet."""
        return cls(np.zeros((2, BINS), dtype=np.int64), np.zeros(2), np.zeros(3, dtype=np.int64))

    def clear(self) -> None:
        """Begin anew."""
        for array in self:
            array[:] = 0


@njit(cache=True)
def count_step(tally, computing, lateness, ended, deadline, period):  # type: ignore[no-untyped-def]
    """Count a step; return the next deadline [ns], the first one of the grid whose period has not gone by.

    Parameters
    ----------
    computing, lateness : float [s]
    ended, deadline, period : int [ns]
    """
    for k, seconds in ((COMPUTING, computing), (LATENESS, lateness)):
        place = int(BINS_PER_DECADE * np.log10(max(seconds, LOWEST) / LOWEST))
        tally.bins[k, min(place, BINS - 1)] += 1
        tally.most[k] = max(tally.most[k], seconds)
    behind = (ended - deadline) // period
    if behind > 0:
        tally.counts[MISSED] += 1
        tally.counts[DROPPED] += behind - 1
    if computing > 1e-9 * period:
        tally.counts[OVERRUN] += 1
    return deadline + max(behind, 1) * period


@dataclass(frozen=True)
class Distribution(Described):
    """Durations, counted in logarithmic bins.

    Parameters
    ----------
    edges : (b + 1,) array [s]
        The first and the last bin hold what lies beyond them, too.
    counts : (b,) array
    maximum : float [s]
    """

    edges: NDArray[np.float64]
    counts: NDArray[np.int64]
    maximum: float

    def _facts(self) -> list[Fact]:
        return [
            ("steps", int(self.counts.sum()), ""),
            *((f"{percent:g} %", value, "s") for percent, value in self.percentiles.items()),
            ("maximum", self.maximum, "s"),
        ]

    def percentile(self, percent: float) -> float:
        """Return the duration [s] that so many of a hundred do not exceed, rounded up to the edge of a bin."""
        total = int(self.counts.sum())
        if total == 0:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self.counts), percent / 100 * total * (1 - 1e-12)))
        last = place == len(self.counts) - 1
        return self.maximum if last else min(float(self.edges[place + 1]), self.maximum)

    @property
    def percentiles(self) -> dict[float, float]:
        """The percentiles 50, 95, 99 and 99.9 [s]."""
        return {percent: self.percentile(percent) for percent in (50, 95, 99, 99.9)}


@dataclass(frozen=True)
class Statistics(Described):
    """How an engine kept its deadlines since it was started.

    Parameters
    ----------
    period : float [s]
    count : int
        Steps.
    missed : int
        Steps that were not finished one period after their deadline.
    dropped : int
        Periods that went by without a step, as the step before took so long; the body's time stands still in them.
    overrun : int
        Steps whose computing time alone exceeded the period.
    computing, lateness : Distribution
        Computing time of the steps, and how long after their deadline they began.
    """

    period: float
    count: int
    missed: int
    dropped: int
    overrun: int
    computing: Distribution
    lateness: Distribution

    @classmethod
    def of(cls, tally: Tally, period: float) -> Statistics:
        """Read a tally, while it goes on or not; its numbers may then differ by a step."""
        computing, lateness = (
            Distribution(EDGES, tally.bins[k].copy(), float(tally.most[k])) for k in (COMPUTING, LATENESS)
        )
        missed, overrun, dropped = (int(tally.counts[k]) for k in (MISSED, OVERRUN, DROPPED))
        return cls(period, int(computing.counts.sum()), missed, dropped, overrun, computing, lateness)

    def _facts(self) -> list[Fact]:
        return [
            ("steps", self.count, ""),
            ("rate", 1 / self.period, "Hz"),
            ("deadlines missed", self.missed, ""),
            ("computing time, median", self.computing.percentile(50), "s"),
            ("99 %", self.computing.percentile(99), "s"),
            ("rate held", self.held if self.count else None, ""),
            ("steps longer than a period", self.overrun, ""),
            ("periods dropped", self.dropped, ""),
            ("verdict", self.verdict, ""),
        ]

    @property
    def held(self) -> bool:
        """Whether the rate can be held: no more than 1 % of the steps compute for longer than a period."""
        return self.overrun <= TOLERATED * self.count

    @property
    def verdict(self) -> str:
        """Say whether the rate is held, and what is at fault if not."""
        if not self.count:
            return "no step has been taken yet"
        usual, slow = 1e3 * self.computing.percentile(50), 1e3 * self.computing.percentile(99)
        took = f"steps compute for {usual:.3g} ms (99 %: {slow:.3g} ms), the period is {1e3 * self.period:.3g} ms"
        late = self.missed - self.overrun
        if not self.held:
            text = f"{1 / self.period:g} Hz cannot be held: {took}; take fewer modes or a lower rate"
        elif late > TOLERATED * self.count:
            text = (
                f"{1 / self.period:g} Hz is within the model's reach ({took}), but other threads and programs kept "
                f"{late} of {self.count} steps from their deadlines; leave the engine a processor of its own"
            )
        else:
            text = f"{1 / self.period:g} Hz is held: {took}; {self.missed} of {self.count} deadlines were missed"
        return text if ABSOLUTE else f"{text} (without clock_nanosleep: this system's waits are less exact)"
