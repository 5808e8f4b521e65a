"""Fail the n-th write, flush or rename of every writer of files, and see what is left.

    python validation/fault_writers.py

A writer replaces a file while one call of the operating system fails for lack of space: the n-th
`write`, `fsync` or `replace`, for every n until the writer ends without a fault. Each trial is a
process of its own. Afterwards the file must be the old or the new one, no other file may be there,
and the error must be an `OSError` of one line that names the file. The script prints the counts and
ends with status 1 if there is a fault.
"""

from __future__ import annotations

import argparse
import builtins
import errno
import io
import json
import os
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kill_writers import Writer, writers  # isort: skip  # first, because it sets the number of threads
from fuzz_kinds import fingerprint

KINDS = ("write", "fsync", "replace")
MAX_FAULTS = 60  # of a kind and a writer


class Faults:
    """Counts calls of a kind, and fails the n-th; after a write also all later ones, as on a full disk."""

    def __init__(self, kind: str, number: int) -> None:
        self.kind, self.number, self.count = kind, number, 0

    def check(self, kind: str) -> None:
        if kind != self.kind:
            return
        self.count += 1
        if self.count == self.number or (kind == "write" and self.count > self.number):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def install(self) -> None:
        """Let the functions of the operating system fail in this process."""
        fsync, replace, opened = os.fsync, os.replace, io.open
        faults = self

        def failing_fsync(file: Any) -> None:
            faults.check("fsync")
            fsync(file)

        def failing_replace(*arguments: Any, **options: Any) -> None:
            faults.check("replace")
            replace(*arguments, **options)

        def failing_open(file: Any, mode: str = "r", *arguments: Any, **options: Any) -> Any:
            found = opened(file, mode, *arguments, **options)
            if isinstance(file, str | os.PathLike) and set(mode) & set("wax+"):
                return _FailingFile(found, faults)
            return found

        os.fsync, os.replace = failing_fsync, failing_replace
        io.open = builtins.open = failing_open  # type: ignore[assignment]


class _FailingFile:
    """A file whose writes may fail after half of their bytes."""

    def __init__(self, file: Any, faults: Faults) -> None:
        self._file, self._faults = file, faults

    def write(self, content: Any) -> Any:
        try:
            self._faults.check("write")
        except OSError:
            self._file.write(content[: len(content) // 2])
            raise
        return self._file.write(content)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> _FailingFile:
        self._file.__enter__()
        return self

    def __exit__(self, *error: Any) -> Any:
        return self._file.__exit__(*error)

    def __iter__(self) -> Any:
        return iter(self._file)


def attempt(write: Callable[[Path, int], None], path: Path, kind: str, number: int) -> dict[str, Any]:
    """Write content 1 in a process in which a call fails; return the calls of the kind, and the error."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        faults, answer = Faults(kind, number), {"error": "", "type": ""}
        try:
            faults.install()
            write(path, 1)
        except BaseException as error:
            answer = {"error": str(error), "type": type(error).__name__}
        os.write(writing, json.dumps({**answer, "count": faults.count}).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return json.loads(text) if text else {"error": "the process ended", "type": "crash", "count": 0}


def check(title: str, writer: Writer, kind: str, number: int) -> tuple[str, bool]:
    """Return what a fault left, and whether the writer came as far as the fault."""
    name, write, load = writer
    with TemporaryDirectory(prefix="palpate-fault-") as place:
        path = Path(place) / name
        write(path, 1)
        new = fingerprint(load(path))
        before = sorted(each.name for each in Path(place).iterdir())
        write(path, 0)
        old = fingerprint(load(path))
        found = attempt(write, path, kind, number)
        if found["count"] < number:
            return "", False
        if not found["error"]:
            return "no error", True
        if found["type"] not in ("OSError", "SurfaceFileError") or "\n" in found["error"]:
            return f"{found['type']}: {found['error'][:100]}", True
        try:
            content = fingerprint(load(path))
        except Exception as error:
            return f"{kind} {number}: not loaded ({type(error).__name__}: {str(error)[:80]})", True
        if content not in (old, new) and title != "run":
            return f"{kind} {number}: neither", True
        after = sorted(each.name for each in Path(place).iterdir())
        if after != before:
            return f"{kind} {number}: files {', '.join(set(after) ^ set(before))}", True
    return "old" if content == old else "new", True


def study(names: list[str]) -> tuple[dict[str, dict[str, int]], int]:
    """Fail every call of every writer; return the counts by writer, and the number of faults."""
    found, faults = {}, 0
    for title, writer in writers().items():
        if names and title not in names:
            continue
        counts: Counter[str] = Counter()
        for kind in KINDS:
            for number in range(1, MAX_FAULTS + 1):
                what, reached = check(title, writer, kind, number)
                if not reached:
                    break
                counts[what] += 1
        found[title] = dict(counts)
        faults += sum(count for what, count in counts.items() if what not in ("old", "new"))
    return found, faults


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("writers", nargs="*", help="names of writers; by default all")
    options = parser.parse_args()
    found, faults = study(options.writers)
    for title, counts in found.items():
        print(title, json.dumps(counts))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
