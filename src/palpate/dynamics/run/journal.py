"""Journals: the frames of a run while it goes on, one record after the other.

A journal begins with a line that names it. Then follow records, each of which holds its length, a check of the length,
a header of plain values and arrays, and a SHA-256 over the record and all records before it. So a reader finds the last
whole record, whatever stopped the writer, and distinguishes a journal that was cut off from one that is damaged.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from palpate.faults import InputError
from palpate.files import json_of, regular_file
from palpate.sealed import array_of, checked_shape

__all__ = ["Journal", "Record", "is_journal", "read_record", "records"]

Arrays = Mapping[str, NDArray[Any]]
Record = tuple[dict[str, Any], dict[str, NDArray[Any]]]

BEGIN = b"palpate journal\nversion 1\n"
LENGTH = struct.Struct("<Q8s")  # of a record's content, and the first bytes of the digest of that
DIGEST = 32  # bytes
TABLE = struct.Struct("<I")


class Journal:
    """A journal that is being written, under a temporary name until it is renamed.

    Parameters
    ----------
    path : path
        Next to which it lies.

    Raises
    ------
    OSError
        The file cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.with_name(f".{path.stem}.{uuid4().hex[:12]}.partial{path.suffix}")
        self._file = self.path.open("wb", buffering=0)
        self._write(BEGIN)
        self._chain, self._end, self._named = sha256(BEGIN).digest(), len(BEGIN), False

    def add(self, header: Mapping[str, Any], arrays: Arrays) -> None:
        """Append a record and hand it to the operating system; after an error the records before it are whole.

        Raises
        ------
        InputError
            The header is not one that can be read again.
        OSError
            The disk is full.
        """
        content = _packed(header, arrays)
        chain = sha256(self._chain + content).digest()
        try:
            self._write(_length(self._chain, len(content)) + content + chain)
        except OSError:
            self._file.seek(self._end)
            self._file.truncate()
            raise
        self._chain, self._end = chain, self._end + LENGTH.size + len(content) + DIGEST

    def rename(self, path: Path) -> None:
        """Give the journal its name, in place of an older file, and go on with it there.

        Raises
        ------
        OSError
            The file cannot be renamed.
        """
        self._file.close()
        os.replace(self.path, path)
        self.path, self._named = path, True
        self._file = path.open("r+b", buffering=0)
        self._file.seek(self._end)

    def close(self) -> None:
        """Close the file; remove it if it never got its name."""
        self._file.close()
        if not self._named:
            self.path.unlink(missing_ok=True)

    def _write(self, content: bytes) -> None:
        rest = memoryview(content)
        while rest:
            rest = rest[self._file.write(rest) :]


def is_journal(path: Path) -> bool:
    """Return whether a file begins as a journal does."""
    with path.open("rb") as file:
        return file.read(len(BEGIN)) == BEGIN


def records(path: Path) -> Iterator[tuple[int, bytes, Record]]:
    """Yield the whole records of a journal, each with its place and the digest before it, for `read_record`.

    Raises
    ------
    InputError
        The file is not a journal, or a record is damaged; the message gives the number of whole ones before it.
    """
    size, count = regular_file(path, "journal"), 0
    with path.open("rb") as file:
        if file.read(len(BEGIN)) != BEGIN:
            raise InputError("this is not a palpate journal")
        chain = sha256(BEGIN).digest()
        while size - file.tell() >= LENGTH.size:
            place = file.tell()
            try:
                found = _next(file, size, chain)
            except InputError as error:
                raise InputError(f"{error}; {count} records before it are whole") from None
            if found is None:
                return
            record, digest = found
            yield place, chain, record
            chain, count = digest, count + 1


def read_record(path: Path, place: int, chain: bytes) -> Record:
    """Return the record at a place of a journal.

    Raises
    ------
    InputError
        It is damaged, or no longer there.
    """
    with path.open("rb") as file:
        file.seek(place)
        found = _next(file, regular_file(path, "journal"), chain)
    if found is None:
        raise InputError("the journal was cut off since it was opened")
    return found[0]


def _next(file: BinaryIO, size: int, chain: bytes) -> tuple[Record, bytes] | None:
    """Return the next record and its digest; None where the file ends before the record does."""
    head = file.read(LENGTH.size)
    length, _ = LENGTH.unpack(head)
    if head != _length(chain, length):
        raise InputError("the length of a record does not match its check: the journal is damaged")
    if file.tell() + length + DIGEST > size:
        return None
    content, digest = file.read(length), file.read(DIGEST)
    if sha256(chain + content).digest() != digest:
        raise InputError("a record does not match its checksum: the journal is damaged")
    return _unpacked(content), digest


def _length(chain: bytes, length: int) -> bytes:
    return LENGTH.pack(length, sha256(chain + length.to_bytes(8, "little")).digest()[:8])


def _packed(header: Mapping[str, Any], arrays: Arrays) -> bytes:
    listed = {name: [values.dtype.str, list(values.shape)] for name, values in arrays.items()}
    table = json.dumps({"header": dict(header), "arrays": listed}, allow_nan=False).encode()
    json_of(table)  # what cannot be read again is refused now
    return b"".join(
        [TABLE.pack(len(table)), table, *(np.ascontiguousarray(each).tobytes() for each in arrays.values())]
    )


def _unpacked(content: bytes) -> Record:
    if len(content) < TABLE.size or len(content) < TABLE.size + TABLE.unpack_from(content)[0]:
        raise InputError("a record is shorter than its table")
    at = TABLE.size + TABLE.unpack_from(content)[0]
    table = json_of(content[TABLE.size : at])
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
