"""Records that compiled functions pass by their address."""

from __future__ import annotations

import gc
import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from palpate.dynamics.compiled.reference import reference


class Inner(NamedTuple):
    values: np.ndarray
    factor: float


class Outer(NamedTuple):
    inner: Inner
    total: np.ndarray
    count: int


@njit
def add(record):
    inner = record.inner
    for k in range(inner.values.shape[0]):
        record.total[0] += inner.factor * inner.values[k] * record.count
    return inner.values


@njit
def add_many(record, times):
    by_address, last = reference(record), record.inner.values
    for _ in range(times):
        last = add(reference(by_address))
    return last


def record():
    return Outer(Inner(np.arange(4.0), 0.5), np.zeros(1), 3)


def test_a_function_reads_and_changes_the_arrays_of_a_record():
    own = record()
    add_many(own, 10)
    assert own.total[0] == 10 * 0.5 * 6.0 * 3


def test_references_neither_free_nor_keep_the_arrays():
    own = record()
    values, before = own.inner.values, sys.getrefcount(own.inner.values)
    for _ in range(50):
        assert add_many(own, 20) is not None
    gc.collect()
    np.testing.assert_array_equal(values, np.arange(4.0))
    assert sys.getrefcount(values) == before


def test_a_field_that_a_record_lacks_is_refused():
    @njit
    def read(record):
        return reference(record).missing

    with pytest.raises(TypingError, match="missing"):
        read(record())
