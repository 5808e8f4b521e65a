"""What is read together was written together."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from numba import njit

from palpate.realtime.seqlock import Slot, fetch, get_flag, make_flags, publish, set_flag, snapshot

SIZE = 64
ENOUGH = 20.0  # [s]


@njit(nogil=True)
def write_until_told(slot, told):
    """Write slots full of one number each, 1, 2, and so on; return the last one."""
    values = np.zeros(SIZE)
    while get_flag(told, 0) == 0:
        for i in range(SIZE):
            values[i] += 1.0
        publish(slot, values)
    return values[0]


@njit(nogil=True)
def read_many(slot, count):
    """Read until `count` reads were whole; return those that mixed writes, those that went back, those torn."""
    out = np.empty(SIZE)
    mixed, back, torn, last = 0, 0, 0, -1.0
    while count > 0:
        if not fetch(slot, out):
            torn += 1
            continue
        count -= 1
        for i in range(SIZE):
            mixed += int(out[i] != out[0])
        back += int(out[0] < last)
        last = out[0]
    return mixed, back, torn


@njit(nogil=True)
def count_and_flag(flag, value, count):
    """Write 1, 2, and so on up to `count`, and flag each."""
    for k in range(1, count + 1):
        value[0] = k
        set_flag(flag, 0, k)


@njit(nogil=True)
def watch_flagged(flag, value, count):
    """Watch the flag until it is `count`; return how often the value was older than the flag."""
    old, flagged = 0, 0
    while flagged < count:
        flagged = get_flag(flag, 0)
        old += int(value[0] < flagged)
    return old


@pytest.mark.slow
def test_compiled_reads_never_mix_writes():
    slot, told = Slot.zeros(SIZE), make_flags()
    writer = threading.Thread(target=write_until_told, args=(slot, told))
    writer.start()
    try:
        while not snapshot(slot)[0]:  # compiles
            pass
        start, rounds, met = time.monotonic(), 0, 0
        while (rounds < 50 or met < 10) and time.monotonic() < start + ENOUGH:
            mixed, back, torn = read_many(slot, 1000)
            assert (mixed, back) == (0, 0)
            rounds, met = rounds + 1, met + (torn > 0)
    finally:
        set_flag(told, 0, 1)
        writer.join()
    assert met >= 10  # reads and writes did fall together


@pytest.mark.slow
def test_reads_from_python_never_mix_writes():
    slot, told = Slot.zeros(SIZE), make_flags()
    writer = threading.Thread(target=write_until_told, args=(slot, told))
    writer.start()
    try:
        start, reads = time.monotonic(), [snapshot(slot)]
        while len(reads) < 2000 or (reads[-1][0] == reads[0][0] and time.monotonic() < start + ENOUGH):
            reads.append(snapshot(slot))
    finally:
        set_flag(told, 0, 1)
        writer.join()
    assert all(read.min() == read.max() for read in reads)
    assert np.all(np.diff([read[0] for read in reads]) >= 0)
    assert reads[-1][0] > reads[0][0]


def test_a_reader_in_the_middle_of_a_write_is_refused_and_does_not_stop_the_writer():
    slot, out = Slot.zeros(3), np.empty(3)
    publish(slot, np.ones(3))
    assert fetch(slot, out)
    slot.version[0] += 1  # as in a write
    assert not fetch(slot, out)
    slot.version[0] += 1
    publish(slot, np.full(3, 2.0))
    assert fetch(slot, out)
    assert np.array_equal(out, [2.0, 2.0, 2.0])


def test_a_flag_carries_what_was_written_before_it():
    flag, value, count = make_flags(), np.zeros(1), 1_000_000
    count_and_flag(flag, value, 1)  # compiles
    writer = threading.Thread(target=count_and_flag, args=(flag, value, count))
    writer.start()
    assert watch_flagged(flag, value, count) == 0
    writer.join()
