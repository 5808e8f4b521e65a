"""The black box: what happened in the last seconds, kept in a ring and written to a file."""

from __future__ import annotations

import io
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.files import whole_file
from palpate.realtime.exchange import flags, get_flag, read_barrier, set_flag, write_barrier
from palpate.realtime.row import HEAD, UNITS, WIDTH

__all__ = ["MOST_COORDINATES", "Ring", "keep", "newest", "write_black_box"]

Floats = NDArray[np.float64]

MOST_COORDINATES = 64  # that are kept of every period
FORMAT, VERSION = "palpate black box", 1


class Ring(NamedTuple):
    """The last rows, of which the oldest is written over.

    Parameters
    ----------
    written : flags
        The first counts the rows written since the ring was made.
    rows : (r, w) float64
        Row k stands at k modulo r.
    """

    written: NDArray[np.int64]
    rows: Floats

    @classmethod
    def of(cls, count: int, coordinates: int) -> Ring:
        """Make a ring that keeps `count` rows with so many coordinates, or as many as it may."""
        return cls(flags(), np.zeros((count + 1, WIDTH + min(coordinates, MOST_COORDINATES))))


@njit(cache=True)
def keep(ring, row):  # type: ignore[no-untyped-def]
    """Add the beginning of a row."""
    written = get_flag(ring.written, 0)
    place = written % ring.rows.shape[0]
    write_barrier()  # who sees the new row below knows that the old one is gone
    for i in range(ring.rows.shape[1]):
        ring.rows[place, i] = row[i]
    set_flag(ring.written, 0, written + 1)


def newest(ring: Ring) -> Floats:
    """Return the rows (k, w) that the ring holds, oldest first, while it is written or not."""
    capacity = len(ring.rows) - 1  # one row may just be written
    before = get_flag(ring.written, 0)
    rows = ring.rows[np.arange(max(0, before - capacity), before) % len(ring.rows)]
    read_barrier()
    lost = get_flag(ring.written, 0) - capacity - max(0, before - capacity)  # written over while they were copied
    return np.asarray(rows[max(0, lost) :])


def write_black_box(path: str | Path, ring: Ring, about: dict[str, Any]) -> None:
    """Write the rows of a ring to an HDF5 file, whole or not at all.

    Parameters
    ----------
    path : str or Path
    ring : Ring
    about : dict
        Attributes of the file.

    Raises
    ------
    OSError
        The file cannot be written; names it.
    """
    import h5py

    rows, path, content = newest(ring), Path(path), io.BytesIO()
    heads = np.ascontiguousarray(rows[:, :WIDTH]).view(HEAD)[:, 0]
    with h5py.File(content, "w") as file:  # in memory: HDF5 does not survive a full disk
        for name in HEAD.names or ():
            file[name] = heads[name]
            if name in UNITS:
                file[name].attrs["unit"] = UNITS[name]
        file["coordinates"] = rows[:, WIDTH:]
        file.attrs.update(format=FORMAT, version=VERSION, written=time.strftime("%Y-%m-%dT%H:%M:%S%z"), **about)
    with whole_file(path) as partial:
        partial.write_bytes(content.getvalue())
