"""Atomic writing and bounded reading of files.

Every file that palpate writes goes through `whole_file`; every file that it reads goes through `read_bytes` or is
opened after `regular_file`. JSON from outside goes through `json_of`, which accepts only plain, finite, shallow values.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import stat
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4

from palpate.core.faults import FileFormatError, InputError, brief

STALE_AGE = 86400.0  # [s] of temporary files of dead writers
MAX_DEPTH = 32  # of nested lists and objects in JSON
MAX_TEXT_BYTES = 16 << 20
MAX_EXPANSION = 64  # of a packed file; text of coordinates expands less than 10 times
UNFINISHED_ENDING = ".partial"  # ending of a file that a writer renames when it is whole
MAX_INTEGER = 2**53  # larger integers are not exact in other programs
# a string or a comment of JSON or TOML, or a bracket outside of them
BRACKET_PATTERN = re.compile(
    r""""{3}(?:\\.|[^\\])*?"{3}|'{3}.*?'{3}|"(?:\\.|[^"\\])*+"|'[^'\n]*+'|#[^\n]*+|([\[{])|([\]}])""", re.DOTALL
)


def check_ending(path: str | Path, endings: Mapping[str, str], what: str, required: bool = False) -> str:
    """Return the ending of a name; refuse one that states another format than those of `what`.

    `endings` have what a file of each holds. The first is that of a name without an ending, which is refused if one is
    `required`. Names that end as files of writers that did not end are allowed.
    """
    ending = Path(path).suffix.lower()
    if ending in ("", UNFINISHED_ENDING) and not required:
        return next(iter(endings))
    if ending not in endings:
        listed = " or ".join(f"{each} ({holds})" for each, holds in endings.items())
        raise InputError(f"{what} must end in {listed}, got {brief(Path(path).name)}; change the ending")
    return ending


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a new temporary name next to `path`, with the same suffix; rename it to `path` on success.

    The content is on the disk before the rename, so that `path` is either the old file or the whole new one, whatever
    stops the process or the machine. Two writers of one path do not share a temporary name.
    """
    if not path.name or "\0" in path.name:
        raise OSError(f"cannot write {str(path)!r}: this is not a file name; choose another name")
    partial = path.with_name(f".{path.stem}.{uuid4().hex[:12]}.partial{path.suffix}")
    _remove_stale(path)
    try:
        if path.exists() and not path.is_file():
            raise OSError(f"cannot write {path}: it exists and is not a regular file; choose another name")
        yield partial
        flush_and_rename(partial, path)
    except OSError as error:
        if error.strerror is None and str(error).startswith("cannot write"):
            raise
        why = error.strerror or error
        raise OSError(f"cannot write {path}: {why}; free some space or choose another folder") from error
    finally:
        with suppress(OSError):
            partial.unlink()


def _remove_stale(path: Path) -> None:
    """Remove stale temporary files of killed writers."""
    name = re.compile(rf"\.{re.escape(path.stem)}\.[0-9a-f]{{12}}\.partial{re.escape(path.suffix)}")
    with suppress(OSError):
        for entry in os.scandir(path.parent):
            if name.fullmatch(entry.name) and time.time() - entry.stat().st_mtime > STALE_AGE:
                os.unlink(entry)


def flush_and_rename(partial: Path, path: Path) -> None:
    """Rename a written file after flushing it to the disk."""
    with partial.open("rb+") as file:
        os.fsync(file.fileno())
    os.replace(partial, path)
    if os.name == "posix":  # elsewhere folders cannot be opened
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    with whole_file(path) as partial:
        partial.write_bytes(content)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file, whole or not at all."""
    with whole_file(path) as partial:
        partial.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def regular_file(path: Path, what: str, most: int | None = None) -> int:
    """Return the size of a file [bytes], which must be a regular file: not a folder, pipe, socket or device.

    `what` is the kind of the file, for messages: ``"recording"``. `most` is the largest allowed size [bytes].
    """
    try:
        status = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(f"there is no {what} at {path}") from None
    except (OSError, ValueError) as error:  # a name that is too long, or holds a null byte
        raise FileFormatError(f"{str(path)!r} cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not stat.S_ISREG(status.st_mode):
        raise FileFormatError(f"{path} is not a regular file; give the {what} itself")
    if most is not None and status.st_size > most:
        raise FileFormatError(f"{path} has {status.st_size} bytes; a {what} has at most {most}")
    return status.st_size


def read_bytes(path: Path, what: str, most: int | None = None) -> bytes:
    """Return the content of a regular file; raises what `regular_file` raises."""
    regular_file(path, what, most)
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileFormatError(f"{path} cannot be read ({error.strerror or error})") from error


def unpack_gzip(data: bytes, path: Path, most: int) -> bytes:
    """Return the content of one gzip file, of at most `most` bytes and 64 times the size of the file.

    `path` is for messages.
    """
    most = min(most, MAX_EXPANSION * len(data))
    stream = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        content = stream.decompress(data, most + 1)
    except zlib.error as error:
        raise FileFormatError(f"{path} is not a whole gzip file ({error}); compress it again") from None
    if len(content) > most:
        raise FileFormatError(
            f"{path} must unpack to at most {most} bytes ({MAX_EXPANSION} times its size), got more; unpack it first"
        )
    if not stream.eof or stream.unused_data:
        what = "is cut off" if not stream.eof else "has data after its end"
        raise FileFormatError(f"{path} is not a whole gzip file: it {what}; compress it again")
    return content


def read_text(path: Path, what: str, most: int = MAX_TEXT_BYTES) -> str:
    """Return the text of a file in UTF-8; raises what `regular_file` raises, and `FileFormatError` for other bytes."""
    try:
        return read_bytes(path, what, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path} is not text in UTF-8 (byte {error.start}); save it in UTF-8") from None


def json_of(text: str | bytes) -> Any:
    """Return the value of a JSON text."""
    try:
        text = text if isinstance(text, str) else text.decode()
        check_nesting(text, "JSON")
        value = json.loads(
            text,
            parse_constant=_refuse_constant,
            parse_float=_finite,
            parse_int=_integer,
            object_pairs_hook=_unique_keys,
        )
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"this is not valid JSON: {shortened(str(error), 150)}") from None
    _check_plain(value)
    return value


def check_nesting(text: str, form: str) -> None:
    """Check that a text in JSON or TOML has at most 32 nested levels, before it is parsed.

    The parsers recurse by level. At the recursion limit, finalizers of other objects fail too.
    """
    if text.count("[") + text.count("{") <= MAX_DEPTH:
        return
    depth = 0
    for bracket in BRACKET_PATTERN.finditer(text):
        depth += (bracket[1] is not None) - (bracket[2] is not None)
        if depth > MAX_DEPTH:
            raise InputError(f"the {form} text has more than {MAX_DEPTH} nested levels")


def read_json(path: Path, what: str, most: int = MAX_TEXT_BYTES) -> dict[str, Any]:
    """Return the object in a JSON file; raises what `read_text` raises, and `FileFormatError` for anything else."""
    try:
        value = json_of(read_text(path, what, most))
    except FileFormatError:
        raise
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error
    if not isinstance(value, dict):
        raise FileFormatError(f"{path} holds no JSON object")
    return value


def digest_of(value: Any) -> str:
    """Return the SHA-256 of a JSON value, independent of the order of keys."""
    return sha256(json.dumps(value, sort_keys=True, allow_nan=False).encode()).hexdigest()


def write_sealed_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file with the digest of its content under ``"sha256"``, whole or not at all."""
    write_json(path, content | {"sha256": digest_of(content)})


def read_sealed_json(path: Path, what: str, most: int = MAX_TEXT_BYTES) -> dict[str, Any]:
    """Return the content of a file of `write_sealed_json`."""
    content = read_json(path, what, most)
    if content.pop("sha256", None) != digest_of(content):
        raise FileFormatError(f"{path} does not match its checksum: the {what} is damaged or was edited")
    return content


def plain(value: Any) -> Any:
    """Return a value in JSON types: arrays as lists, NumPy numbers as Python's, None for non-finite numbers."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def shortened(text: str, most: int = 60) -> str:
    """Return a text shortened for a message, without unprintable characters."""
    text = text if len(text) <= most else text[: most - 3] + "..."
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not a number")


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{shortened(text)} is not finite")
    return number


def _integer(text: str) -> int:
    if len(text) > 17 or abs(int(text)) > MAX_INTEGER:
        raise ValueError(f"{shortened(text)} is beyond 2^53")
    return int(text)


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError("an object has the same key twice")
    return value


def _check_plain(value: Any) -> None:
    """Check that text can be encoded."""
    if isinstance(value, str):
        try:
            value.encode("utf-8")
        except UnicodeEncodeError:
            raise InputError("the JSON text holds half a surrogate pair") from None
    elif isinstance(value, dict):
        for key, entry in value.items():
            _check_plain(key)
            _check_plain(entry)
    elif isinstance(value, list):
        for entry in value:
            _check_plain(entry)


def check_folder(folder: Path, name: str = "out") -> None:
    """Check that a folder exists or can be created, and is writable; `name` is that of the option."""
    existing = _existing(folder)
    if not existing.is_dir():
        raise InputError(
            f"{name} = {str(folder)!r}: {existing} is not a folder; allowed is a folder that can be written"
        )
    try:
        with TemporaryDirectory(prefix=".palpate-", dir=existing) as probe:
            (Path(probe) / "probe").write_bytes(bytes(4096))
    except OSError as error:
        why = (error.strerror or str(error)).lower()
        raise InputError(f"{name} = {str(folder)!r}: {existing} cannot be written ({why}); choose another") from error


def check_space(folder: Path, needed: int, name: str = "out") -> None:
    """Check that the disk of a folder has space for a number of bytes; `name` is that of the option."""
    free = shutil.disk_usage(_existing(folder)).free
    if free < needed:
        need, has = needed / 1e6, free / 1e6
        raise InputError(f"{name} = {str(folder)!r}: this run writes about {need:.0f} MB, {has:.0f} MB are free")


def _existing(folder: Path) -> Path:
    """Return the folder or its nearest existing parent."""
    existing = folder.absolute()
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    return existing
