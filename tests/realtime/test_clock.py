"""The compiled clocks are the system's."""

from __future__ import annotations

import time

import numpy as np
from numba import njit

from palpate.realtime.clock import now, sleep_until, thread_time, use_precise_sleep


@njit
def sleep_long_after(start, pause, count):
    """Wake-up times [ns] after `count` sleeps, counted from when each should have ended."""
    late = np.empty(count, dtype=np.int64)
    for k in range(count):
        start = max(start + pause, now())
        sleep_until(start)
        late[k] = now() - start
    return late


def test_now_equals_the_monotonic_clock():
    before, inside, after = time.monotonic_ns(), now(), time.monotonic_ns()
    assert before <= inside <= after


def test_computing_time_is_the_threads_own_and_stands_still_in_sleep():
    before, inside, after = time.thread_time_ns(), thread_time(), time.thread_time_ns()
    assert before <= inside <= after
    wall, computed, own = now(), thread_time(), time.thread_time_ns()
    time.sleep(0.05)
    asleep = thread_time() - computed
    assert now() - wall >= 50e6
    assert asleep <= time.thread_time_ns() - own + computed - before  # what the system counts, and no more


def test_sleep_ends_after_its_time_and_not_before():
    use_precise_sleep()
    late = sleep_long_after(now(), 1_000_000, 50)
    assert late.min() >= 0


def test_sleep_until_the_past_returns():
    sleep_until(now() - 10**15)  # an hour would be 3.6e12 ns
    sleep_until(0)
