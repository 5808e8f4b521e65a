"""The ring keeps the last rows, whole; its file is written whole or not at all."""

from __future__ import annotations

import threading
import time

import h5py
import numpy as np
import pytest
from numba import njit

from palpate.realtime.black_box import MAX_COORDINATES, RingBuffer, append_record, latest_records, write_black_box
from palpate.realtime.record import HEADER_DTYPE, TOOL_DTYPE, record_size
from palpate.realtime.seqlock import get_flag, make_flags, set_flag


@njit(nogil=True)
def keep_until_told(ring, row, told):
    """Keep rows full of one number each, 1, 2, and so on."""
    while get_flag(told, 0) == 0:
        for i in range(len(row)):
            row[i] += 1.0
        append_record(ring, row)


def filled(count, capacity=10, coordinates=3):
    ring = RingBuffer.empty(capacity, coordinates)
    for k in range(count):
        append_record(ring, np.full(record_size(coordinates, 1), float(k)))
    return ring


@pytest.mark.parametrize("count", [0, 1, 9, 10, 11, 35])
def test_the_last_rows_are_kept_in_order(count):
    rows = latest_records(filled(count))
    assert np.array_equal(rows[:, 0], np.arange(max(0, count - 10), count))
    assert rows.shape[1] == record_size(0, 1) + 3


def test_rows_read_while_others_are_written_are_whole():
    ring, told = RingBuffer.empty(50, 40), make_flags()
    writer = threading.Thread(target=keep_until_told, args=(ring, np.zeros(record_size(40, 1)), told))
    writer.start()
    try:
        while get_flag(ring.written, 0) < 100:
            pass
        start, reads = time.monotonic(), [latest_records(ring)]
        while len(reads) < 200 or (len(reads[-1]) == 50 and time.monotonic() < start + 20.0):
            reads.append(latest_records(ring))
    finally:
        set_flag(told, 0, 1)
        writer.join()
    rows = [row for read in reads for row in read]
    assert all(row.min() == row.max() for row in rows)
    assert all(np.all(np.diff(read[:, 0]) == 1) for read in reads)
    assert any(len(read) < 50 for read in reads)  # rows were written meanwhile


def test_a_file_holds_the_rows_with_their_units(tmp_path):
    path = tmp_path / "flight.h5"
    write_black_box(path, filled(4), 1, {"period": 1e-3})
    with h5py.File(path) as file:
        assert set(file) == {*HEADER_DTYPE.names, "coordinates", "tools"}
        assert file["force"].shape == (4, 3)
        assert file["force"].attrs["unit"] == "N"
        assert np.array_equal(file["time"], np.arange(4.0))
        assert np.array_equal(file["coordinates"][:, 1], np.arange(4.0))
        assert file.attrs["period"] == 1e-3
    assert [p.name for p in tmp_path.iterdir()] == ["flight.h5"]


def test_of_many_coordinates_the_first_are_kept():
    assert latest_records(filled(2, coordinates=100)).shape == (2, record_size(0, 1) + MAX_COORDINATES)


def test_an_old_file_survives_a_failed_write(tmp_path, monkeypatch):
    path = tmp_path / "flight.h5"
    write_black_box(path, filled(4), 1, {})
    before = path.read_bytes()

    def full(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match=r"cannot write .*flight\.h5: No space left"):
        write_black_box(path, filled(9), 1, {})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["flight.h5"]


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(OSError, match="nowhere"):
        write_black_box(tmp_path / "nowhere" / "flight.h5", filled(1), 1, {})


def test_the_file_of_two_tools_holds_both(tmp_path):
    path, ring = tmp_path / "flight.h5", RingBuffer.empty(10, 2, tools=2)
    append_record(ring, np.arange(float(record_size(2, 2))))
    write_black_box(path, ring, 2, {})
    first = record_size(0, 1)  # of the second tool
    with h5py.File(path) as file:
        assert set(file["tools"]) == set(TOOL_DTYPE.names)
        assert file["tools/position"][0, 1].tolist() == [first, first + 1, first + 2]
        assert file["tools/force"].attrs["unit"] == "N"
        assert file["coordinates"][0].tolist() == [record_size(0, 2), record_size(0, 2) + 1]
