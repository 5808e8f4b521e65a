"""Counting deadlines: what was late, and whose fault it was."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.realtime.statistics import Histograms, Statistics, count_step

PERIOD = 1_000_000  # [ns]


def counted(steps, max_backlog=0):
    """Count steps of (wake-up latency, computing time, duration) [s], and return the statistics and the deadlines."""
    tally, deadline, deadlines, ended = Histograms.zeros(), 0, [], 0
    for wakeup_latency, computing, duration in steps:
        began = max(deadline + round(1e9 * wakeup_latency), ended if max_backlog else 0)
        ended = began + round(1e9 * duration)
        deadline = count_step(tally, computing, wakeup_latency, ended, deadline, PERIOD, max_backlog)
        deadlines.append(deadline)
    return Statistics.from_histograms(tally, 1e-9 * PERIOD), deadlines


def test_steps_in_time_miss_nothing():
    statistics, deadlines = counted([(2e-6, 3e-4, 3.1e-4)] * 10)
    assert (statistics.count, statistics.missed, statistics.dropped, statistics.overrun) == (10, 0, 0, 0)
    assert deadlines == [PERIOD * k for k in range(1, 11)]
    assert statistics.is_real_time
    assert "is in real time" in statistics.status


@pytest.mark.parametrize(("duration", "dropped"), [(0.999e-3, 0), (1.001e-3, 0), (2.5e-3, 1), (5.5e-3, 4)])
def test_a_step_that_takes_several_periods_drops_those_it_ran_over(duration, dropped):
    statistics, deadlines = counted([(0.0, 1e-4, duration)])
    assert statistics.dropped == dropped
    assert statistics.missed == (duration > 1e-3)
    assert statistics.overrun == 0  # the scheduler took the time
    assert deadlines == [PERIOD * (1 + dropped)]


def test_a_model_that_may_be_late_takes_long_periods_without_dropping_others():
    statistics, deadlines = counted([(0.0, 5e-4, 1.6e-3), (0.0, 5e-4, 0.3e-3)] * 20, max_backlog=4)
    assert statistics.dropped == 0
    assert deadlines == [PERIOD * k for k in range(1, 41)]
    assert statistics.real_time_factor == 1.0


def test_the_time_of_a_slow_model_runs_evenly_slower():
    statistics, deadlines = counted([(0.0, 1.25e-3, 1.25e-3)] * 400, max_backlog=4)
    assert statistics.real_time_factor == pytest.approx(0.8, abs=0.02)
    steps = np.diff(deadlines[50:])
    assert set(steps.tolist()) == {PERIOD, 2 * PERIOD}


def test_a_slow_model_is_distinguished_from_a_busy_machine():
    slow, _ = counted([(0.0, 1.2e-3, 1.3e-3)] * 3 + [(0.0, 5e-4, 5e-4)] * 97)
    busy, _ = counted([(0.0, 5e-4, 3.3e-3)] * 3 + [(0.0, 5e-4, 5e-4)] * 97)
    assert (slow.missed, slow.overrun, slow.is_real_time) == (3, 3, False)
    assert (busy.missed, busy.overrun, busy.is_real_time) == (3, 0, True)
    assert "is not in real time" in slow.status
    assert "other threads" in busy.status


def test_one_slow_step_in_a_hundred_still_sustains_the_rate():
    assert counted([(0.0, 1.2e-3, 1.2e-3)] + [(0.0, 5e-4, 5e-4)] * 99)[0].is_real_time
    assert not counted([(0.0, 1.2e-3, 1.2e-3)] + [(0.0, 5e-4, 5e-4)] * 98)[0].is_real_time


def test_percentiles_are_those_of_the_durations_to_the_width_of_a_bin():
    durations = np.random.default_rng(5).lognormal(np.log(2e-5), 1.5, 5000)
    statistics, _ = counted([(duration, 1e-5, 0.0) for duration in durations])
    exact = np.percentile(durations, [50, 95, 99, 99.9], method="inverted_cdf")
    estimates = np.array(list(statistics.wakeup_latency.percentiles.values()))
    assert np.all(estimates >= exact * (1 - 1e-12))
    assert np.all(estimates <= exact * 1.06)
    assert statistics.wakeup_latency.maximum == durations.max()
    assert statistics.wakeup_latency.counts.sum() == statistics.computing.counts.sum() == 5000


def test_durations_beyond_the_bins_are_counted_too():
    statistics, _ = counted([(0.0, 1e-9, 0.0), (100.0, 1e-9, 0.0)])
    assert statistics.wakeup_latency.counts[0] == statistics.wakeup_latency.counts[-1] == 1
    assert statistics.wakeup_latency.percentile(100) == 100.0


def test_the_status_without_steps_states_that():
    statistics, _ = counted([])
    assert "no step" in statistics.status
    assert statistics.wakeup_latency.percentile(99) == 0.0
    assert statistics.is_real_time
