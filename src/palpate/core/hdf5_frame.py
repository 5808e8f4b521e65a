"""HDF5 structures in memory, with space reserved for arrays and their offsets."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from io import RawIOBase
from typing import Any, BinaryIO

import numpy as np

HEAD_BYTES = 512  # bytes before HDF5's datatype, which it leaves to its users
DEFLATE_LEVEL = 4  # of deflate; 6 takes three times as long to save 2 %
MAX_ATTRIBUTE_CHARACTERS = 32_000  # limit of an object's header in HDF5


class Frame(RawIOBase):
    """Sparse file in memory that stores written pages only.

    HDF5 crashes on a full disk. So it writes here, and plain writes copy the pages.
    """

    PAGE = 4096  # bytes

    def __init__(self) -> None:
        self.pages: dict[int, bytearray] = {}
        self.at = self.size = 0

    def seek(self, offset: int, whence: int = 0) -> int:
        self.at = offset + (0, self.at, self.size)[whence]
        return self.at

    def tell(self) -> int:
        return self.at

    def truncate(self, size: int | None = None) -> int:
        self.size = self.at if size is None else size
        return self.size

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        count = max(0, min(len(view), self.size - self.at))
        for k, number, start, size in self._parts(count):
            page = self.pages.get(number)
            view[k : k + size] = page[start : start + size] if page else bytes(size)
        self.at += count
        return count

    def write(self, content: Any) -> int:
        view = memoryview(content).cast("B")
        for k, number, start, size in self._parts(len(view)):
            self.pages.setdefault(number, bytearray(self.PAGE))[start : start + size] = view[k : k + size]
        self.at += len(view)
        self.size = max(self.size, self.at)
        return len(view)

    def _parts(self, count: int) -> Iterator[tuple[int, int, int, int]]:
        """Yield place, page, first byte in the page and size of the parts of the next bytes."""
        k = 0
        while k < count:
            number, start = divmod(self.at + k, self.PAGE)
            size = min(count - k, self.PAGE - start)
            yield k, number, start, size
            k += size

    def copy_to(self, file: BinaryIO) -> None:
        """Write the pages to a file of the same size."""
        file.truncate(self.size)
        for number, page in self.pages.items():
            file.seek(number * self.PAGE)
            file.write(page[: self.size - number * self.PAGE])


def lay_out(
    types: Mapping[str, str],
    shapes: Mapping[str, tuple[int, ...]],
    attributes: Mapping[str, str | bool | float],
    deflated: Mapping[str, bytes],
) -> tuple[Frame, dict[str, int]]:
    """Return an HDF5 file with space for contiguous arrays and with compressed ones, and their offsets.

    `types` are in NumPy's notation; slashes in a name make groups. Attributes of the file that HDF5 cannot hold are
    left out: long ones, and text with null characters. `deflated` has arrays after the filters shuffle and deflate of
    HDF5, each of them one chunk.

    The file has zeros for contiguous arrays. The offsets are those of the first byte of every array, and that after the
    head for empty ones.
    """
    import h5py

    frame, offsets = Frame(), {}
    with h5py.File(frame, "w", userblock_size=HEAD_BYTES) as file:
        chunked = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        chunked.set_shuffle()
        chunked.set_deflate(DEFLATE_LEVEL)
        chunked.set_obj_track_times(False)
        layout, parents = h5py.h5p.create(h5py.h5p.DATASET_CREATE), h5py.h5p.create(h5py.h5p.LINK_CREATE)
        layout.set_layout(h5py.h5d.CONTIGUOUS)
        layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        layout.set_obj_track_times(False)  # equal content makes equal files
        parents.set_create_intermediate_group(True)
        for name, shape in shapes.items():
            datatype, space = h5py.h5t.py_create(np.dtype(types[name]), logical=True), h5py.h5s.create_simple(shape)
            if name in deflated:
                chunked.set_chunk(shape)
                dataset = h5py.h5d.create(file.id, name.encode(), datatype, space, chunked, parents)
                dataset.write_direct_chunk((0,) * len(shape), deflated[name])
                offsets[name] = dataset.get_chunk_info(0).byte_offset
                continue
            dataset = h5py.h5d.create(file.id, name.encode(), datatype, space, layout, parents)
            offsets[name] = dataset.get_offset() if math.prod(shape) else HEAD_BYTES
        short = {
            name: v for name, v in attributes.items() if len(str(v)) < MAX_ATTRIBUTE_CHARACTERS and "\0" not in str(v)
        }
        file.attrs.update(short)
    return frame, offsets
