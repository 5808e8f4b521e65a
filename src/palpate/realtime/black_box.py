"""Black box: a ring buffer with the records of the last seconds, and its HDF5 file."""

from __future__ import annotations

import io
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats
from palpate.core.files import whole_file
from palpate.realtime.record import HEADER_DTYPE, HEADER_SIZE, PERIOD_FIELDS, TOOL_DTYPE, TOOL_SIZE
from palpate.realtime.seqlock import acquire_fence, get_flag, make_flags, release_fence, set_flag

MAX_COORDINATES = 64  # reduced coordinates stored of each record
FORMAT, VERSION = "palpate black box", 3


class RingBuffer(NamedTuple):
    """The most recent records; a new record replaces the oldest one."""

    written: NDArray[np.int64]  # element 0 counts the records written since the buffer was made
    records: Floats  # (r, w) float64: record k is stored in row k modulo r

    @classmethod
    def empty(cls, count: int, coordinates: int, tools: int = 1) -> RingBuffer:
        """Make a buffer for `count` records of some tools with up to `MAX_COORDINATES` coordinates each."""
        numbers = HEADER_SIZE + TOOL_SIZE * tools + min(coordinates, MAX_COORDINATES)
        return cls(make_flags(), np.zeros((count + 1, numbers)))


@kernel_njit()
def append_record(buffer, record):
    """Append the first numbers of a record, as many as the buffer stores."""
    written = get_flag(buffer.written, 0)
    row = written % buffer.records.shape[0]
    release_fence()  # a reader that sees new numbers below also sees that the old record is being replaced
    for i in range(buffer.records.shape[1]):
        buffer.records[row, i] = record[i]
    set_flag(buffer.written, 0, written + 1)


def latest_records(buffer: RingBuffer) -> Floats:
    """Return the stored records (k, w), oldest first; safe while another thread appends."""
    capacity = len(buffer.records) - 1  # one row may be incomplete
    before = get_flag(buffer.written, 0)
    records = buffer.records[np.arange(max(0, before - capacity), before) % len(buffer.records)]
    acquire_fence()
    replaced = get_flag(buffer.written, 0) - capacity - max(0, before - capacity)  # while they were copied
    return np.asarray(records[max(0, replaced) :])


def write_black_box(path: str | Path, buffer: RingBuffer, tools: int, attributes: dict[str, Any]) -> None:
    """Write the records of a ring buffer, of a number of tools, to an HDF5 file with attributes, atomically."""
    import h5py

    records, path, content = latest_records(buffer), Path(path), io.BytesIO()
    headers = np.ascontiguousarray(records[:, :HEADER_SIZE]).view(HEADER_DTYPE)[:, 0]
    with h5py.File(content, "w") as file:  # in memory, because HDF5 does not survive a full disk
        for name in HEADER_DTYPE.names or ():
            file[name] = headers[name]
            if PERIOD_FIELDS[name].unit:
                file[name].attrs["unit"] = PERIOD_FIELDS[name].unit
        first = HEADER_SIZE + TOOL_SIZE * tools
        parts = np.ascontiguousarray(records[:, HEADER_SIZE:first]).view(TOOL_DTYPE)  # (k, tools)
        for name in TOOL_DTYPE.names or ():
            file[f"tools/{name}"] = parts[name]
            if PERIOD_FIELDS[name].unit:
                file[f"tools/{name}"].attrs["unit"] = PERIOD_FIELDS[name].unit
        file["coordinates"] = records[:, first:]
        file.attrs.update(format=FORMAT, version=VERSION, written=time.strftime("%Y-%m-%dT%H:%M:%S%z"), **attributes)
    with whole_file(path) as partial:
        partial.write_bytes(content.getvalue())
