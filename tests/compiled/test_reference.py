"""Records that compiled functions pass by their address."""

from __future__ import annotations

import gc
import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from palpate.compiled.reference import StoredRecord, reference


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


class Mixed(NamedTuple):
    flag: bool
    inner: Inner
    pair: tuple[int, bool]
    last: bool
    table: np.ndarray
    empty: np.ndarray
    factor: float


@njit
def read_all(record):
    inner, table, (third, second) = record.inner, record.table, record.pair
    table[1, 2] = 7.0
    total = 100.0 * third + record.factor + inner.factor + record.empty.shape[0] + table.shape[0]
    for k in range(inner.values.shape[0]):
        total += inner.values[k]
    return record.flag and record.last, second, total


@pytest.mark.parametrize("flag", [False, True])
def test_compiled_code_reads_a_record_that_python_stored(flag):
    record = Mixed(flag, Inner(np.arange(4.0), 0.5), (3, not flag), flag, np.zeros((2, 3)), np.zeros((0, 2)), 0.25)
    assert read_all(StoredRecord(record)) == (flag, not flag, 300.0 + 0.25 + 0.5 + 0.0 + 2.0 + 6.0)
    assert record.table[1, 2] == 7.0
    assert read_all.signatures  # of a reference, not of all numbers of the record
    assert "Reference" in str(read_all.signatures[0][0])


@pytest.mark.parametrize("record", [Inner("text", 0.5), Inner(np.zeros(2), 1j), np.zeros(3)])
def test_records_of_other_fields_cannot_be_stored(record):
    with pytest.raises(TypeError, match=r"record must be|fields of a record must be"):
        StoredRecord(record)
