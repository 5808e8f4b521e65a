"""Deadline statistics: computing time and wake-up latency of the steps.

Wake-up latency is the wall-clock time from a deadline to the start of its step; it measures the scheduler. Computing
time is the processor time of the step; it measures the model. A deadline is missed if its step is not finished one
period later. The model causes a miss only if its computing time alone exceeds the period.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.core.deprecation import renamed_attribute
from palpate.core.describe import Described, Fact
from palpate.realtime.clock import HAS_ABSOLUTE_SLEEP

FIRST_EDGE, BIN_DECADES, BINS_PER_DECADE = 1e-7, 8, 40  # [s]: bins from 0.1 us to 10 s, each 6 % wide
BIN_COUNT = BIN_DECADES * BINS_PER_DECADE
BIN_EDGES = FIRST_EDGE * 10 ** (np.arange(BIN_COUNT + 1) / BINS_PER_DECADE)
COMPUTING, WAKEUP_LATENCY = 0, 1  # rows of `Histograms.bins`
MISSED, OVERRUN, DROPPED = 0, 1, 2  # indices in `Histograms.counts`
MAX_OVERRUN_SHARE = 0.01  # of the steps of a model in real time


class Histograms(NamedTuple):
    """Counts of the loop, by computing time and wake-up latency."""

    bins: NDArray[np.int64]  # (2, BINS) int64: steps per bin, by computing time and by wake-up latency
    maxima: NDArray[np.float64]  # (2,) float64 [s]: largest computing time and wake-up latency
    # (3,) int64: missed deadlines, steps that computed for longer than a period, periods without a step
    counts: NDArray[np.int64]

    @classmethod
    def zeros(cls) -> Histograms:
        """Make empty histograms."""
        return cls(np.zeros((2, BIN_COUNT), dtype=np.int64), np.zeros(2), np.zeros(3, dtype=np.int64))

    def clear(self) -> None:
        """Set all counts to zero."""
        for array in self:
            array[:] = 0


@kernel_njit()
def count_step(histograms, computing, wakeup_latency, ended, deadline, period, max_backlog):
    """Count a step and return the next deadline [ns].

    It is the first on the grid whose period is not over; or an earlier one, by up to `max_backlog` periods, which then
    follow each other without a pause. `computing` and `wakeup_latency` are in s, the other times in ns.
    """
    for k, seconds in ((COMPUTING, computing), (WAKEUP_LATENCY, wakeup_latency)):
        bin_index = int(BINS_PER_DECADE * np.log10(max(seconds, FIRST_EDGE) / FIRST_EDGE))
        histograms.bins[k, min(bin_index, BIN_COUNT - 1)] += 1
        histograms.maxima[k] = max(histograms.maxima[k], seconds)
    behind = (ended - deadline) // period
    if behind > 0:
        histograms.counts[MISSED] += 1
        histograms.counts[DROPPED] += max(behind - 1 - max_backlog, 0)
    if computing > 1e-9 * period:
        histograms.counts[OVERRUN] += 1
    return deadline + max(behind - max_backlog, 1) * period


@dataclass(frozen=True)
class Distribution(Described):
    """Histogram of durations in logarithmic bins.

    Parameters
    ----------
    edges : (b + 1,) array [s]
        The first and the last bin also count durations beyond them.
    counts : (b,) array
    maximum : float [s]

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> edges = np.array([1e-4, 2e-4, 4e-4])
    >>> pt.typing.Distribution(edges, np.array([9, 1]), maximum=3e-4).percentile(90)
    0.0002
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
        """Return a percentile [s] of the durations, rounded up to the edge of a bin."""
        total = int(self.counts.sum())
        if total == 0:
            return 0.0
        bin_number = int(np.searchsorted(np.cumsum(self.counts), percent / 100 * total * (1 - 1e-12)))
        last = bin_number == len(self.counts) - 1
        return self.maximum if last else min(float(self.edges[bin_number + 1]), self.maximum)

    @property
    def percentiles(self) -> dict[float, float]:
        """The percentiles 50, 95, 99 and 99.9 [s]."""
        return {percent: self.percentile(percent) for percent in (50, 95, 99, 99.9)}


@dataclass(frozen=True)
class Statistics(Described):
    """Deadline statistics of an engine since its start.

    Parameters
    ----------
    period : float [s]
    count : int
        Number of steps.
    missed : int
        Steps that were not finished one period after their deadline.
    dropped : int
        Periods without a step, because the previous step took too long; model time stands still in them.
    overrun : int
        Steps whose computing time alone exceeded the period.
    computing, wakeup_latency : Distribution
        Computing time of the steps, and the delay from their deadlines to their starts.

    Examples
    --------
    >>> import time
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
    >>> with pt.Engine(pt.realtime_model(block, contact=ball)) as engine:
    ...     time.sleep(0.2)
    ...     statistics = engine.statistics()
    >>> statistics.count > 0, statistics.period
    (True, 0.001)
    """

    period: float
    count: int
    missed: int
    dropped: int
    overrun: int
    computing: Distribution
    wakeup_latency: Distribution

    lateness = renamed_attribute("Statistics", "lateness", "wakeup_latency")
    sustained = renamed_attribute("Statistics", "sustained", "is_real_time")
    pace = renamed_attribute("Statistics", "pace", "real_time_factor")
    verdict = renamed_attribute("Statistics", "verdict", "status")

    @classmethod
    def from_histograms(cls, histograms: Histograms, period: float) -> Statistics:
        """Read histograms; while the loop runs, the numbers may differ by one step."""
        computing, wakeup_latency = (
            Distribution(BIN_EDGES, histograms.bins[k].copy(), float(histograms.maxima[k]))
            for k in (COMPUTING, WAKEUP_LATENCY)
        )
        missed, overrun, dropped = (int(histograms.counts[k]) for k in (MISSED, OVERRUN, DROPPED))
        return cls(period, int(computing.counts.sum()), missed, dropped, overrun, computing, wakeup_latency)

    def _facts(self) -> list[Fact]:
        return [
            ("steps", self.count, ""),
            ("rate", 1 / self.period, "Hz"),
            ("deadlines missed", self.missed, ""),
            ("computing time, median", self.computing.percentile(50), "s"),
            ("99 %", self.computing.percentile(99), "s"),
            ("in real time", self.is_real_time if self.count else None, ""),
            ("steps longer than a period", self.overrun, ""),
            ("periods dropped", self.dropped, ""),
            ("real-time factor", self.real_time_factor, ""),
            ("status", self.status, ""),
        ]

    @property
    def is_real_time(self) -> bool:
        """Whether the model runs in real time: at most 1 % of the steps compute for longer than a period."""
        return self.overrun <= MAX_OVERRUN_SHARE * self.count

    @property
    def real_time_factor(self) -> float:
        """Real-time factor, model time over wall-clock time: 1 unless periods were dropped."""
        return self.count / max(self.count + self.dropped, 1)

    @property
    def status(self) -> str:
        """Text that states whether the model runs in real time, and the cause if not."""
        if not self.count:
            return "no steps yet"
        usual, slow = 1e3 * self.computing.percentile(50), 1e3 * self.computing.percentile(99)
        took = f"steps compute for {usual:.3g} ms (99 %: {slow:.3g} ms), the period is {1e3 * self.period:.3g} ms"
        late = self.missed - self.overrun
        if not self.is_real_time:
            factor = f"the real-time factor is {self.real_time_factor:.2g}"
            text = f"{1 / self.period:g} Hz is not in real time: {took}; {factor}"
        elif late > MAX_OVERRUN_SHARE * self.count:
            text = (
                f"{1 / self.period:g} Hz is within the model's capacity ({took}), but other threads and programs "
                f"delayed {late} of {self.count} steps past their deadlines; reserve a processor for the engine"
            )
        else:
            text = (
                f"{1 / self.period:g} Hz is in real time: {took}; {self.missed} of {self.count} deadlines were missed"
            )
        return (
            text
            if HAS_ABSOLUTE_SLEEP
            else f"{text} (this system has no clock_nanosleep, so its sleeps are less precise)"
        )
