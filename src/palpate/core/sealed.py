"""Sealed files: HDF5 files whose arrays are located and verified by a table with digests.

A sealed file is an HDF5 file, which any program can open. Every array is contiguous, or one chunk with the filters
shuffle and deflate of HDF5: the bytes of its values by significance, compressed. Its first 512 bytes, which HDF5 leaves
to its users, name the kind of the file, the version, and the place and SHA-256 of a table at the end of the file. The
table is JSON: a header of plain values, the type, shape, place and SHA-256 of every array, and a SHA-256 of all bytes
between the arrays. palpate reads the table and the arrays themselves, never the structures of HDF5: so links, external
data, other filters and damaged HDF5 tables have no effect, and every length is checked against the size of the file
before anything is allocated. A compressed array has at most `MAX_RATIO` bytes for each in the file.

A digest shows damage. It does not show forgery: who writes a file can also write its digests. What is read from a file
is therefore data only, and every loader checks each value.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import json_of, regular_file, shortened, whole_file
from palpate.core.hdf5_frame import DEFLATE_LEVEL, HEAD_BYTES, lay_out

__all__ = [
    "HEAD_BYTES",
    "MIN_POSITIVE",
    "Array",
    "ArrayEntry",
    "ArrayFile",
    "SealedFile",
    "array_of",
    "check_arrays",
    "check_names",
    "checked_shape",
    "kind_of_file",
    "loading",
    "open_sealed",
    "typed",
    "write_sealed",
]

Values = NDArray[Any]

ARRAY_TYPES = ("<f8", "<f4", "<i8", "<u2", "|u1", "|b1")
MAX_DIMENSIONS = 4
BLOCK_BYTES = 1 << 20  # read at once
MIN_DEFLATED_BYTES, MIN_SAVING = 4096, 0.1  # of arrays that are compressed; smallest share that it saves
MAX_RATIO = 64  # bytes of an array for each compressed one
RESERVED_BYTES = 1 << 16  # of the disk that stay free
DIGEST_PATTERN = re.compile(r"[0-9a-f]{64}")
LARGEST_NUMBER = float(np.finfo(float).max)  # that is finite
MIN_POSITIVE = float(np.nextafter(0.0, 1.0))


@dataclass(frozen=True)
class Array:
    """Declaration of an array of a file, which `typed` writes by and `check_arrays` reads by."""

    shape: tuple[int | str, ...]  # arrays share the sizes that have names
    type: str = "<f8"  # one of `ARRAY_TYPES`
    # low, most: least number, and largest size of a number; `MIN_POSITIVE` and `LARGEST_NUMBER` are the limits of
    # each
    low: float = -math.inf
    most: float = LARGEST_NUMBER
    unit: str = ""
    index_of: str = ""  # name of the size that the entries are indices of
    rising: bool = False  # whether no entry is less than the one before


def typed(values: Mapping[str, Any], declared: Mapping[str, Array]) -> dict[str, Values]:
    """Return the declared arrays of some values, of their types."""
    return {name: np.asarray(values[name], dtype=each.type) for name, each in declared.items()}


def check_arrays(arrays: Mapping[str, Values], declared: Mapping[str, Array], sizes: Mapping[str, int]) -> None:
    """Refuse other arrays than the declared ones, of other types, shapes or numbers; sizes that are not given agree."""
    check_names(arrays, declared)
    known = dict(sizes)
    for name, each in declared.items():
        array = arrays[name]
        expected = tuple(known.get(size, size) if isinstance(size, str) else size for size in each.shape)
        fits = len(expected) == array.ndim and all(
            length == size or isinstance(size, str) for length, size in zip(array.shape, expected, strict=True)
        )
        if not fits or array.dtype != each.type:
            shape, got = ", ".join(map(str, expected)), f"{array.shape} of {array.dtype.str}"
            raise InputError(f"array {name} must have shape ({shape}) of {each.type}, got {got}")
        known |= {size: length for size, length in zip(each.shape, array.shape, strict=True) if isinstance(size, str)}
    for name, each in declared.items():
        array, low = arrays[name], max(each.low, -each.most)
        if each.index_of and not ((array >= 0) & (array < known[each.index_of])).all():
            raise InputError(f"array {name} must have indices from 0 to {known[each.index_of] - 1}, got others")
        if array.dtype != bool and not ((array >= low) & (array <= each.most)).all():
            least = "positive, up" if low == MIN_POSITIVE else f"from {low:g}"
            most = f"{each.most:g} {each.unit}".rstrip()
            raise InputError(f"array {name} must be finite, {least} to {most}, got other numbers")
        if each.rising and np.any(np.diff(array) < 0):
            raise InputError(f"array {name} must not decrease, got smaller numbers after larger ones")


def check_names(arrays: Iterable[str], declared: Mapping[str, Array]) -> None:
    """Refuse other names than those of the declared arrays."""
    for odd in sorted(declared.keys() ^ set(arrays)):
        raise InputError(f"array {shortened(odd)} is {'missing' if odd in declared else 'not one of such a file'}")


@dataclass(frozen=True)
class ArrayEntry:
    """Array of a sealed file."""

    type: str  # one of `ARRAY_TYPES`, in NumPy's notation
    shape: tuple[int, ...]
    offset: int  # first byte in the file
    digests: tuple[str, ...]  # SHA-256 of the whole array; or of every row, of one that is read by row
    by_row: bool
    deflated: int | None = None  # number of bytes in the file, of an array that is compressed

    @property
    def size(self) -> int:
        """Number of bytes in the file."""
        return math.prod(self.shape) * np.dtype(self.type).itemsize if self.deflated is None else self.deflated


class ArrayFile(Protocol):
    """A header of plain values and arrays by name, from any kind of file."""

    @property
    def header(self) -> dict[str, Any]:
        """Plain values."""
        ...

    @property
    def arrays(self) -> Mapping[str, Any]:
        """Arrays or their entries, by name."""
        ...

    def read(self, name: str) -> Values:
        """Return an array."""
        ...


@dataclass(frozen=True)
class SealedFile:
    """Sealed file with a verified table; arrays are verified on reading."""

    path: Path
    header: dict[str, Any]  # plain values
    arrays: dict[str, ArrayEntry]  # by name

    def read(self, name: str) -> Values:
        """Return an array."""
        entry = self._entry(name)
        if entry.by_row:
            return np.array([self.row(name, k) for k in range(entry.shape[0])], entry.type).reshape(entry.shape)
        return self._read_verified(name, entry, entry.offset, entry.shape, entry.digests[0])

    def row(self, name: str, k: int) -> Values:
        """Return row k of an array that is stored by row; raises what `read` raises."""
        entry = self._entry(name)
        if not entry.by_row or not 0 <= k < entry.shape[0]:
            raise InputError(f"array {name} has no row {k}")
        size = entry.size // entry.shape[0]
        return self._read_verified(
            f"{name}, row {k}", entry, entry.offset + k * size, entry.shape[1:], entry.digests[k]
        )

    def _entry(self, name: str) -> ArrayEntry:
        if name not in self.arrays:
            raise InputError(f"array {name} is missing")
        return self.arrays[name]

    def _read_verified(self, what: str, entry: ArrayEntry, offset: int, shape: tuple[int, ...], digest: str) -> Values:
        values = np.empty(shape, entry.type) if entry.deflated is None else np.empty(entry.deflated, "|u1")
        with self.path.open("rb") as file:
            file.seek(offset)
            count = file.readinto(_bytes_of(values))
        if count != values.nbytes or sha256(_bytes_of(values)).hexdigest() != digest:
            raise InputError(f"array {what} does not match its checksum: the file is truncated or damaged")
        if entry.deflated is not None:
            values = _inflate(what, entry, _bytes_of(values))
        return _check_flags(what, values)


def array_of(what: str, kind: str, shape: tuple[int, ...], content: memoryview) -> Values:
    """Return a copy of bytes as an array."""
    if len(content) != math.prod(shape) * np.dtype(kind).itemsize:
        raise InputError(f"array {what} of shape {shape} does not have {len(content)} bytes")
    return _check_flags(what, np.frombuffer(content, kind).reshape(shape).copy())


def checked_shape(what: str, kind: Any, shape: Any, room: int) -> tuple[str, tuple[int, ...]]:
    """Return the type and shape of an array that a file names, which must fit into so many bytes."""
    if kind not in ARRAY_TYPES:
        raise InputError(f"array {what} has type {shortened(repr(kind))}; allowed are {', '.join(ARRAY_TYPES)}")
    valid = isinstance(shape, list) and len(shape) <= MAX_DIMENSIONS
    if not valid or not all(type(size) is int and 0 <= size <= room for size in shape):
        raise InputError(f"array {what} has shape {shortened(repr(shape))}, which does not fit into {room} bytes")
    if math.prod(shape) * np.dtype(kind).itemsize > room:
        raise InputError(f"array {what} has shape {tuple(shape)}, which does not fit into {room} bytes")
    return kind, tuple(shape)


# reading


@contextmanager
def loading(path: Path, remedy: str) -> Iterator[None]:
    """Convert any error of a file's content into a `FileFormatError` with the file and the remedy.

    A remedy is, for example, ``"train the model again"``.
    """
    try:
        yield
    except (FileNotFoundError, MemoryError):
        raise
    except InputError as error:
        text = str(error) if str(error).startswith(str(path)) else f"{path}: {error}"
        raise FileFormatError(text if remedy in text else f"{text}; {remedy}") from error
    except Exception as error:  # no value in a file may end in another error
        text = shortened(" ".join(str(error).split()), 200)
        raise FileFormatError(f"{path}: its content does not fit together ({text}); {remedy}") from error


def open_sealed(path: Path, kind: str, version: int, older: tuple[int, ...] = ()) -> SealedFile:
    """Open a sealed file of a kind, such as ``"palpate reduced model"``, and verify its table.

    Files of the `older` versions are also read.
    """
    size = regular_file(path, kind.removeprefix("palpate "))
    with path.open("rb") as file:
        found_version, offset, length, digest = _place_of_table(file.read(HEAD_BYTES), kind, version, older)
        if offset < HEAD_BYTES or offset + length != size:
            raise InputError("the file is truncated, or something was appended to it")
        file.seek(offset)
        text = file.read(length)
    if sha256(text).hexdigest() != digest:
        raise InputError("the table does not match its checksum: the file is damaged")
    table = json_of(text)
    if not isinstance(table, dict) or table.keys() != {"kind", "version", "header", "arrays", "rest"}:
        raise InputError("the table has other entries than kind, version, header, arrays and rest")
    if (table["kind"], table["version"]) != (kind, found_version):
        raise InputError("the first bytes and the table disagree about the kind of the file")
    header, listed = table["header"], table["arrays"]
    if not isinstance(header, dict) or not isinstance(listed, dict):
        raise InputError("header and arrays of the table are not objects")
    arrays = {name: _entry(name, about, offset) for name, about in listed.items()}
    if _digest_of_rest(path, arrays, offset) != table["rest"]:
        raise InputError("the bytes between the arrays do not match their checksum: the file is damaged")
    return SealedFile(path, header, arrays)


def kind_of_file(path: Path) -> str:
    """Return the kind that the first line of a sealed file names, unchecked; empty for any other file, or none."""
    try:
        regular_file(path, "file")
        with path.open("rb") as file:
            match = re.match(rb"(palpate [a-z ]{1,60})\nversion ", file.read(HEAD_BYTES))
    except (OSError, InputError):  # the loader says what is wrong
        return ""
    return match[1].decode() if match else ""


def _place_of_table(head: bytes, kind: str, version: int, older: tuple[int, ...]) -> tuple[int, int, int, str]:
    """Return the version of a file, and the offset, length and digest of its table."""
    match = re.match(rf"{re.escape(kind)}\nversion (\d{{1,9}})\n".encode(), head)
    if not match:
        old = "; it may be of an older version" if head.startswith(b"\x89HDF") else ""
        raise InputError(f"this is not a {kind}{old}")
    if int(match[1]) not in (version, *older):
        raise InputError(f"this is of version {int(match[1])}, and version {version} is the one that is read")
    place = re.fullmatch(rb"table (\d{1,18}) (\d{1,18}) ([0-9a-f]{64})\n\0*", head[match.end() :])
    if not place or len(head) != HEAD_BYTES:
        raise InputError("the first bytes are damaged")
    return int(match[1]), int(place[1]), int(place[2]), place[3].decode()


def _digest_of_rest(path: Path, arrays: Mapping[str, ArrayEntry], end: int) -> str:
    """Return the SHA-256 of what lies between the head and the table and belongs to no array."""
    digest = sha256()
    with path.open("rb") as file:
        at = HEAD_BYTES
        for entry in sorted((each for each in arrays.values() if each.size), key=lambda each: each.offset):
            if entry.offset < at:
                raise InputError("the arrays of the table overlap")
            _update_digest(digest, file, at, entry.offset)
            at = entry.offset + entry.size
        _update_digest(digest, file, at, end)
    return digest.hexdigest()


def _update_digest(digest: Any, file: BinaryIO, start: int, stop: int) -> None:
    file.seek(start)
    for at in range(start, stop, BLOCK_BYTES):
        digest.update(file.read(min(BLOCK_BYTES, stop - at)))


def _entry(name: str, about: Any, end: int) -> ArrayEntry:
    """Return an entry of the table, whose bytes must lie between the head and the table."""
    what = shortened(name)
    if not isinstance(about, dict) or about.keys() - {"deflated"} != {"type", "shape", "offset", "sha256"}:
        raise InputError(f"the table's entry of array {what} has not type, shape, offset and sha256")
    digests, offset, deflated = about["sha256"], about["offset"], about.get("deflated")
    if "deflated" in about and not (type(deflated) is int and 0 < deflated <= end):
        raise InputError(f"array {what} has {shortened(repr(deflated))} compressed bytes, which the file does not have")
    kind, shape = checked_shape(what, about["type"], about["shape"], MAX_RATIO * deflated if deflated else end)
    by_row = isinstance(digests, list)
    if by_row and deflated:
        raise InputError(f"array {what} is stored by row and compressed")
    entry = ArrayEntry(kind, shape, offset, tuple(digests) if by_row else (digests,), by_row, deflated)
    if by_row and (not shape or len(digests) != shape[0]):
        raise InputError(f"array {what} has not one checksum for every row")
    if not all(isinstance(digest, str) and DIGEST_PATTERN.fullmatch(digest) for digest in entry.digests):
        raise InputError(f"array {what} has a checksum that is not a SHA-256")
    if type(offset) is not int or offset < HEAD_BYTES or offset + entry.size > end:
        raise InputError(f"array {what} lies outside the file")
    return entry


def _inflate(what: str, entry: ArrayEntry, content: memoryview) -> Values:
    """Return an array from its bytes after shuffle and deflate; refuse others than it needs."""
    kind, size = np.dtype(entry.type), math.prod(entry.shape) * np.dtype(entry.type).itemsize
    inflater = zlib.decompressobj()
    try:
        planes = inflater.decompress(content, size + 1)
    except zlib.error as error:
        raise InputError(f"array {what} cannot be decompressed: {error}") from error
    if len(planes) != size or not inflater.eof or inflater.unused_data:
        raise InputError(f"array {what} of shape {entry.shape} does not have the bytes that it is decompressed to")
    values = np.empty(entry.shape, kind)
    values.reshape(-1).view("u1").reshape(-1, kind.itemsize).T[:] = np.frombuffer(planes, "u1").reshape(
        kind.itemsize, -1
    )
    return values


def _deflate(values: Values) -> bytes | None:
    """Return the bytes of an array after shuffle and deflate; None where they are hardly fewer, or too few."""
    if values.nbytes < MIN_DEFLATED_BYTES:
        return None
    planes = np.ascontiguousarray(values.reshape(-1).view("u1").reshape(-1, values.itemsize).T)
    deflater = zlib.compressobj(DEFLATE_LEVEL, strategy=zlib.Z_FILTERED)  # values are noisy: code them, and copy little
    content = deflater.compress(planes.data) + deflater.flush()
    return content if values.nbytes / MAX_RATIO <= len(content) <= (1 - MIN_SAVING) * values.nbytes else None


def _check_flags(what: str, values: Values) -> Values:
    if values.dtype == bool and values.size and values.view("u1").max() > 1:
        raise InputError(f"array {what} holds truth values that are neither 0 nor 1")
    return values


# writing


def write_sealed(
    path: Path,
    kind: str,
    version: int,
    header: Mapping[str, Any],
    arrays: Mapping[str, Any],
    rows: Mapping[str, Sequence[Any]] | None = None,
    *,
    deflate: bool = False,
) -> None:
    """Write a sealed file, whole or not at all.

    The values of `header` are those that JSON has, all finite. `arrays` have types of `ARRAY_TYPES`; slashes in a name
    are groups in HDF5. `rows` are arrays that are stored by row, each row under its own digest; they are given row by
    row, at least one. `deflate` compresses the arrays that are not stored by row, where it makes them smaller.
    """
    _json([dict(header), *arrays, *(rows or {})])  # names, too, must be text that can be read again
    blocks: dict[str, tuple[Values, ...]] = {name: (_plain(values),) for name, values in arrays.items()}
    shapes = {name: block[0].shape for name, block in blocks.items()}
    for name, values in (rows or {}).items():
        blocks[name] = tuple(_plain(row) for row in values)
        shapes[name] = (len(values), *blocks[name][0].shape)
    types = {name: block[0].dtype.str for name, block in blocks.items()}
    packed = {name: _deflate(block[0]) for name, block in blocks.items() if deflate and name in arrays}
    deflated = {name: content for name, content in packed.items() if content is not None}
    blocks |= {name: (np.frombuffer(content, "u1"),) for name, content in deflated.items()}
    needed = sum(part.nbytes for block in blocks.values() for part in block) + RESERVED_BYTES
    free = shutil.disk_usage(path.absolute().parent).free if path.absolute().parent.is_dir() else needed
    if free < needed:
        raise OSError(
            f"cannot write {path}: the disk is full ({free / 1e6:.1f} MB left, {needed / 1e6:.1f} MB needed); free "
            f"some space or choose another folder"
        )
    with whole_file(path) as partial:
        attributes = {name: value if isinstance(value, str | bool | float) else _json(value).decode()
                for name, value in header.items()}  # fmt: skip
        frame, offsets = lay_out(
            types, shapes, attributes | {"format": kind, "version": version, "units": "SI"}, deflated
        )
        entries = {}
        with partial.open("w+b") as file:
            frame.copy_to(file)
            for name, parts in blocks.items():
                file.seek(offsets[name])
                digests = []
                for part in parts:
                    file.write(_bytes_of(part))
                    digests.append(sha256(_bytes_of(part)).hexdigest())
                by_row = name in (rows or {})
                stored = len(deflated[name]) if name in deflated else None
                entries[name] = ArrayEntry(types[name], shapes[name], offsets[name], tuple(digests), by_row, stored)
            file.flush()
            place = file.seek(0, 2)
            rest = _digest_of_rest(partial, entries, place)
            listed = {name: _table_entry(entry) for name, entry in entries.items()}
            table = _json({"kind": kind, "version": version, "header": dict(header), "arrays": listed, "rest": rest})
            file.write(table)
            file.seek(0)
            file.write(f"{kind}\nversion {version}\ntable {place} {len(table)} {sha256(table).hexdigest()}\n".encode())


def _table_entry(entry: ArrayEntry) -> dict[str, Any]:
    digests: Any = list(entry.digests) if entry.by_row else entry.digests[0]
    about = {"type": entry.type, "shape": list(entry.shape), "offset": entry.offset, "sha256": digests}
    return about if entry.deflated is None else about | {"deflated": entry.deflated}


def _json(value: Any) -> bytes:
    """Return the JSON of a value, as `json_of` reads it."""
    try:
        text = json.dumps(value, allow_nan=False).encode()
        json_of(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"the header of the file cannot be written: {error}") from error
    return text


def _plain(values: Any) -> Values:
    array = np.ascontiguousarray(values)
    array = array.astype(array.dtype.newbyteorder("<"), copy=False).reshape(np.shape(values))
    if array.dtype.str not in ARRAY_TYPES:
        raise InputError(f"arrays of a file have one of the types {', '.join(ARRAY_TYPES)}, got {array.dtype.str}")
    return array


def _bytes_of(values: Values) -> memoryview:
    return values.reshape(-1).view("u1").data
