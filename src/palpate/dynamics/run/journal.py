"""Journals: append-only files of the frames of a run.

A journal begins with two lines of text for its format and version. Each record consists of its
length, a check of the length, a header of plain values, arrays, and a SHA-256 digest. The digest
covers the record and all previous ones. So a reader finds the last complete record after any
interruption, and distinguishes a truncated journal from a damaged one.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from palpate.core.faults import InputError
from palpate.core.files import json_of, regular_file
from palpate.core.sealed import array_of, checked_shape

Arrays = Mapping[str, NDArray[Any]]
Record = tuple[dict[str, Any], dict[str, NDArray[Any]]]

FIRST_BYTES = b"palpate journal\nversion 1\n"
LENGTH_STRUCT = struct.Struct("<Q8s")  # of a record's content, and the first bytes of its digest
DIGEST_BYTES = 32  # bytes
TABLE_STRUCT = struct.Struct("<I")


class Journal:
    """A writer of a journal, under a temporary name in the same folder until `rename`."""

    def __init__(self, path: Path) -> None:
        self.path = path.with_name(f".{path.stem}.{uuid4().hex[:12]}.partial{path.suffix}")
        self._file = self.path.open("wb", buffering=0)
        self._chain, self._end, self.named = sha256(FIRST_BYTES).digest(), len(FIRST_BYTES), False
        try:
            self._write(FIRST_BYTES)
        except OSError:
            self.close()
            raise

    def add(self, header: Mapping[str, Any], arrays: Arrays) -> None:
        """Append a record and pass it to the operating system.

        An error leaves the previous records complete.
        """
        content = _pack(header, arrays)
        chain = sha256(self._chain + content).digest()
        try:
            self._file.seek(self._end)
            self._file.truncate()  # the part of a record that an error has left
            self._write(_pack_length(self._chain, len(content)) + content + chain)
        except OSError:
            with suppress(OSError):
                self._file.truncate(self._end)
            raise
        self._chain, self._end = chain, self._end + LENGTH_STRUCT.size + len(content) + DIGEST_BYTES

    def rename(self, path: Path) -> None:
        """Rename the journal, replace an older file, and continue writing there."""
        self._file.close()
        try:
            os.replace(self.path, path)
            self.path, self.named = path, True
        finally:
            self._file = self.path.open("r+b", buffering=0)
            self._file.seek(self._end)

    def flush(self) -> None:
        """Flush all records to the disk, where a power cut leaves them."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file, and remove it unless it was renamed."""
        self._file.close()
        if not self.named:
            self.path.unlink(missing_ok=True)

    def _write(self, content: bytes) -> None:
        rest = memoryview(content)
        while rest:
            rest = rest[self._file.write(rest) :]


def is_journal(path: Path) -> bool:
    """Return True if a file begins like a journal."""
    with path.open("rb") as file:
        return file.read(len(FIRST_BYTES)) == FIRST_BYTES


def records(path: Path) -> Iterator[tuple[int, bytes, Record]]:
    """Yield the complete records of a journal, each after its offset [bytes] and the digest of the previous records.

    `read_record` takes the offset.
    """
    size, count = regular_file(path, "journal"), 0
    with path.open("rb") as file:
        if file.read(len(FIRST_BYTES)) != FIRST_BYTES:
            raise InputError("this is not a palpate journal")
        chain = sha256(FIRST_BYTES).digest()
        while size - file.tell() >= LENGTH_STRUCT.size:
            position = file.tell()
            try:
                read = _read_next(file, size, chain)
            except InputError as error:
                raise InputError(f"{error}; {count} records before it are whole") from None
            if read is None:
                return
            record, digest = read
            yield position, chain, record
            chain, count = digest, count + 1


def read_record(path: Path, position: int, chain: bytes) -> Record:
    """Return the record at a position [bytes] of a journal."""
    with path.open("rb") as file:
        file.seek(position)
        read = _read_next(file, regular_file(path, "journal"), chain)
    if read is None:
        raise InputError("the journal was truncated after it was opened")
    return read[0]


def _read_next(file: BinaryIO, size: int, chain: bytes) -> tuple[Record, bytes] | None:
    """Return the next record and its digest; None for a truncated record."""
    head = file.read(LENGTH_STRUCT.size)
    length, _ = LENGTH_STRUCT.unpack(head)
    if head != _pack_length(chain, length):
        raise InputError("the length of a record does not match its check: the journal is damaged")
    if file.tell() + length + DIGEST_BYTES > size:
        return None
    content, digest = file.read(length), file.read(DIGEST_BYTES)
    if sha256(chain + content).digest() != digest:
        raise InputError("a record does not match its checksum: the journal is damaged")
    return _unpack(content), digest


def _pack_length(chain: bytes, length: int) -> bytes:
    return LENGTH_STRUCT.pack(length, sha256(chain + length.to_bytes(8, "little")).digest()[:8])


def _pack(header: Mapping[str, Any], arrays: Arrays) -> bytes:
    listed = {name: [values.dtype.str, list(values.shape)] for name, values in arrays.items()}
    table = json.dumps({"header": dict(header), "arrays": listed}, allow_nan=False).encode()
    json_of(table)  # raises an error for a header that cannot be read back
    return b"".join(
        [TABLE_STRUCT.pack(len(table)), table, *(np.ascontiguousarray(each).tobytes() for each in arrays.values())]
    )


def _unpack(content: bytes) -> Record:
    if len(content) < TABLE_STRUCT.size or len(content) < TABLE_STRUCT.size + TABLE_STRUCT.unpack_from(content)[0]:
        raise InputError("a record is shorter than its table")
    at = TABLE_STRUCT.size + TABLE_STRUCT.unpack_from(content)[0]
    table = json_of(content[TABLE_STRUCT.size : at])
    header, listed = (table.get("header"), table.get("arrays")) if isinstance(table, dict) else (None, None)
    if not isinstance(header, dict) or not isinstance(listed, dict):
        raise InputError("the table of a record has no header and arrays")
    arrays = {}
    for name, about in listed.items():
        if not isinstance(about, list) or len(about) != 2:
            raise InputError(f"the table of a record describes array {name} by {about!r:.60}")
        kind, shape = checked_shape(name, about[0], about[1], len(content))
        end = at + int(np.prod(shape, dtype=np.int64)) * np.dtype(kind).itemsize
        arrays[name] = array_of(name, kind, shape, memoryview(content)[at:end])
        at = end
    return header, arrays
