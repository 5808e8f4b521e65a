"""Voxels of label maps: unpacked within the size that a header states, and checked to be labels."""

from __future__ import annotations

import math
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.faults import FileFormatError
from palpate.surface.formats.common import printable_word
from palpate.surface.formats.first_bytes import GZIP_MAGIC
from palpate.surface.labels.label_map import Segment

MAX_VOXELS = 2**29  # of a file, stated in its header
MAX_AXIS = 2**20  # voxels along an axis
CHUNK_BYTES, CHUNK_VOXELS = 1 << 16, 1 << 22  # read or checked at a time
MAX_EXPANSION = 1032  # of deflate, the most that it can do
MAX_MEMBERS = 20_000  # of a gzip file
ROUNDING_DISTANCE = 0.02  # distance of a value from a whole number, which is rounded
MAX_LABELS = 2000  # different values of a label map; images of intensities have more
FEW_LABELS = 64  # as many values are labels, whatever their order
MIN_EQUAL_SHARE = 0.3  # of neighbouring voxels along an axis, in an image of more labels
MAX_VALUE = 2**31 - 1


def checked_shape(sizes: Sequence[int], what: str = "its size") -> tuple[int, ...]:
    """Return numbers of voxels along axes, each of at least one, with at most 2^29 in all."""
    sizes = [int(each) for each in sizes]
    if any(not 1 <= each <= MAX_AXIS for each in sizes) or math.prod(sizes) > MAX_VOXELS:
        raise FileFormatError(
            f"{what} must be axes of 1 to {MAX_AXIS} voxels, at most 2^29 in all, got "
            f"{' x '.join(map(str, sizes))[:60]}; crop or resample the image"
        )
    return tuple(sizes)


def numbers_of(text: bytes, count: int, what: str) -> NDArray[np.float64]:
    """Return numbers of a header, separated by white space."""
    try:
        values = np.array([float(word) for word in text.split()[: count + 1]])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count:
        raise FileFormatError(f"{what} must be {count} numbers, got {printable_word(text)}")
    return values


class Unpacker:
    """Bytes of a file, or of what it holds packed, read in turn without unpacking more than is asked for.

    `packed` bytes are compressed by gzip or zlib.
    """

    def __init__(self, data: bytes | memoryview, packed: bool) -> None:
        self._data, self._at, self._members = memoryview(data), 0, 0
        self._stream = zlib.decompressobj(32 + zlib.MAX_WBITS) if packed else None

    def read(self, size: int) -> bytearray:
        """Return the next bytes, `size` of them."""
        if self._stream is None:
            content = bytearray(self._data[self._at : self._at + size])
            self._at += size
        else:
            content = self._unpacked(size)
        if len(content) < size:
            raise FileFormatError(f"it is cut short: it must hold {size} bytes here, got {len(content)}; copy it again")
        return content

    def ends(self) -> bool:
        """Return whether nothing follows; raise `FileFormatError` where checksums do not match."""
        return not (self._unpacked(1) if self._stream else self._data[self._at :])

    def _unpacked(self, size: int) -> bytearray:
        assert self._stream is not None
        if size > MAX_EXPANSION * (len(self._data) + 1):
            raise FileFormatError(f"it is cut short: it must unpack to {size} bytes, got {len(self._data)} packed ones")
        content, filled = bytearray(size), 0
        try:
            while filled < size:
                if self._stream.eof:  # a gzip file may have several members
                    self._at -= len(self._stream.unused_data)
                    self._members += 1
                    if bytes(self._data[self._at : self._at + 2]) != GZIP_MAGIC or self._members > MAX_MEMBERS:
                        break
                    self._stream = zlib.decompressobj(32 + zlib.MAX_WBITS)
                source = self._stream.unconsumed_tail
                if not source:
                    source = bytes(self._data[self._at : self._at + CHUNK_BYTES])
                    self._at += len(source)
                part = self._stream.decompress(source, size - filled)
                if not part and not source and not self._stream.eof:
                    raise FileFormatError("it is cut short; copy it again")
                content[filled : filled + len(part)] = part
                filled += len(part)
        except zlib.error as error:
            raise FileFormatError(f"its compressed data are damaged ({error}); compress it again") from None
        del content[filled:]
        return content


def label_values(values: NDArray[Any]) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Return an array of whole numbers of at least 0, and notes; raise for images that are not of labels.

    Values within 0.02 of a whole number are rounded. One negative number is taken as outside.
    """
    if values.dtype.kind == "f":
        values = _rounded(values)
    elif not values.dtype.isnative:
        values = values.astype(values.dtype.newbyteorder("="))
    low, high, notes = int(values.min()), int(values.max()), tuple[str, ...]()
    if high > MAX_VALUE:
        raise _intensities(low, high)
    if low < 0:
        values, note = _without_negative(values, high)
        notes = (note,)
    return (values.astype(np.int32) if values.dtype.itemsize > 4 else values), notes


def _without_negative(values: NDArray[Any], high: int) -> tuple[NDArray[Any], str]:
    """Return values of which the only negative one is 0, and a note; raise for several ones."""
    different = np.zeros(0, dtype=values.dtype)
    for part in _chunks(values):
        different = np.union1d(different, np.unique(part))
        if len(different) > MAX_LABELS:
            break
    negative = different[different < 0]
    if len(negative) > 1:
        if len(different) > FEW_LABELS:
            raise _intensities(int(different[0]), high)
        raise FileFormatError(
            f"its labels must be at least 0, got {len(negative)} negative ones from {negative[0]} to {negative[-1]}; "
            "write 0 for what is outside, and numbers above 127 with more than 8 bits"
        )
    if high <= 0:
        raise FileFormatError(
            f"it must hold a label of at least 1, got voxels of {' and '.join(map(str, different))} alone; save the "
            "segmentation again"
        )
    outside = values == negative[0]
    note = f"its voxels of {negative[0]}, {outside.mean():.0%} of all, are taken as outside, as those of 0"
    return np.where(outside, values.dtype.type(0), values), note


def _chunks(values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the voxels in the order of memory, in parts: views of a contiguous array."""
    flat = values.ravel(order="K")
    return [flat[k : k + CHUNK_VOXELS] for k in range(0, len(flat), CHUNK_VOXELS)]


def _rounded(values: NDArray[Any]) -> NDArray[Any]:
    integers = np.empty(values.shape, dtype=np.int32, order="F" if values.flags.f_contiguous else "C")
    for part, into in zip(_chunks(values), _chunks(integers), strict=True):
        with np.errstate(all="ignore"):
            nearest = np.rint(part)
            strange = ~(np.abs(part - nearest) <= ROUNDING_DISTANCE)
            far = np.abs(nearest) > MAX_VALUE
        if strange.any() or far.any():
            if not np.isfinite(part).all():
                count = np.count_nonzero(~np.isfinite(values))
                raise FileFormatError(
                    f"its values must be finite numbers of labels, got NaN or infinity in {count} voxels; write 0 there"
                )
            low, high = float(np.min(values)), float(np.max(values))
            if low >= 0 and high <= 1:
                raise FileFormatError(
                    f"its values must be nearest numbers of labels, got probabilities from {low:.3g} to {high:.3g}; "
                    "threshold them first, such as at 0.5"
                )
            raise _intensities(low, high)
        into[:] = nearest
    return integers


def _intensities(low: float, high: float) -> FileFormatError:
    return FileFormatError(
        f"its values must be numbers of labels, got an image of intensities from {low:.6g} to {high:.6g}, such as a "
        "CT; segment it first, with TotalSegmentator or 3D Slicer"
    )


def segments_of(
    layers: Sequence[NDArray[Any]], names: dict[tuple[int, int], tuple[int, str]]
) -> tuple[tuple[NDArray[Any], ...], tuple[Segment, ...], tuple[str, ...]]:
    """Return layers and their segments, and the names of those without voxels.

    Large values of the layers (nx, ny, nz) come back as smaller ones. `names` has number and name by layer and value;
    others have their value and ``"label 5"``. Numbers that several layers use become new ones beyond all others.
    """
    smaller, segments, seen = [], list[Segment](), set[tuple[int, int]]()
    for number, layer in enumerate(layers):
        values, counts = _counted(layer)
        if len(values) > FEW_LABELS and equal_share(layer) < MIN_EQUAL_SHARE:
            raise _intensities(int(values[0]), int(values[-1]))
        marks = values
        if len(values) and values[-1] > 0xFFFF:
            marks = np.arange(len(values)) + (values[0] > 0)
            layer = np.searchsorted(values, layer) + (values[0] > 0)
        smaller.append(layer.astype(np.uint8 if marks[-1] <= 0xFF else np.uint16))
        for value, mark, count in zip(values.tolist(), marks.tolist(), counts.tolist(), strict=True):
            if value:
                label, name = names.get((number, value), (value, ""))
                segments.append(Segment(label, name or f"label {label}", number, mark, count))
                seen.add((number, value))
    if not segments:
        raise FileFormatError("it must hold a label, got voxels of 0 alone; save the segmentation again")
    segments = _renumbered(segments)
    absent = tuple(dict.fromkeys(name for key, (_, name) in names.items() if key not in seen and key[1] and name))
    return tuple(smaller), tuple(sorted(segments, key=lambda each: each.number)), absent


def _renumbered(segments: list[Segment]) -> list[Segment]:
    """Return segments of different numbers: those that share one between layers have new ones beyond all others."""
    times, unused = Counter(each.number for each in segments), 1 + max(each.number for each in segments)
    result = []
    for each in segments:
        if times[each.number] > 1:
            each, unused = replace(each, number=unused, label=each.number), unused + 1
        result.append(each)
    return result


def counts_of_values(layer: NDArray[Any]) -> NDArray[np.int64]:
    """Return how many voxels have each value from 0 to the largest."""
    counts = np.zeros(int(layer.max()) + 1, dtype=np.int64)
    for part in _chunks(layer):
        counts += np.bincount(part, minlength=len(counts))
    return counts


def _counted(layer: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the values of a layer in ascending order, and how many voxels have each."""
    if layer.dtype.itemsize <= 2 or layer.max() < 1 << 20:
        counts = counts_of_values(layer)
        values = np.flatnonzero(counts)
        counts = counts[values]
    else:
        values, counts = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        for part in _chunks(layer):
            more, times = np.unique(part, return_counts=True)
            values, place = np.unique(np.concatenate([values, more]), return_inverse=True)
            counts = np.bincount(place, np.concatenate([counts, times]), len(values)).astype(np.int64)
            if len(values) > MAX_LABELS:
                break
    if len(values) > MAX_LABELS:
        raise _intensities(int(values[0]), int(values[-1]))
    return values, counts


def equal_share(layer: NDArray[Any]) -> float:
    """Return the share of neighbours in memory with equal values, of those in which one has a label."""
    same = total = 0
    for part in _chunks(layer):
        either = (part[1:] != 0) | (part[:-1] != 0)
        total += int(np.count_nonzero(either))
        same += int(np.count_nonzero(either & (part[1:] == part[:-1])))
    return same / max(total, 1)
