"""Journals of recordings: a session stores its snapshots on the disk as it runs.

The first record of the journal (`palpate.dynamics.run.journal`) has the model, each other one the
snapshots since the last, in the arrays of the finished file. So a recording survives the end of its
process, a full disk and, up to the last seconds, a power cut.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.recordings.snapshot import Snapshot
from palpate.app.recordings.snapshot_arrays import FORMAT, MAX_TITLE_LENGTH, OLDER_VERSIONS, VERSION, snapshot_arrays
from palpate.core.faults import InputError
from palpate.core.files import plain, shortened
from palpate.core.sealed import kind_of_file
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.journal import Journal, is_journal, records
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.solid import body_contents


class RecordingJournal:
    """A writer of the journal of a recording; the file has its name from the first snapshot on."""

    def __init__(self, path: Path, title: str, model: ReducedModel | NodalModel) -> None:
        self.path, self.count = path, 0  # of snapshots in the file
        self._title, self._model = shortened(title, MAX_TITLE_LENGTH), model
        self._journal: Journal | None = None

    def add(self, times: Sequence[float], snapshots: Sequence[Snapshot], tools: Sequence[Mapping[str, Any]]) -> None:
        """Append snapshots and the tools that were selected in them, and flush them to the disk.

        After an error the file has all previous snapshots, and the same ones may be added again.
        """
        if self._journal is None:
            self._journal = self._begin()
        self._journal.add({"tools": plain(list(tools))}, snapshot_arrays(times, snapshots, self._model))
        self.count += len(times)
        if not self._journal.named:
            self._journal.rename(self.path)
        self._journal.flush()

    def _begin(self) -> Journal:
        header, arrays = body_contents(self._model)
        journal = Journal(self.path)
        try:
            about = {"kind": FORMAT, "version": VERSION, "title": self._title, "model": header}
            journal.add(about, {f"model/{name}": values for name, values in arrays.items()})
        except BaseException:
            journal.close()
            raise
        return journal

    def close(self) -> None:
        """Close the file; it is removed if it has no snapshots."""
        if self._journal is not None:
            self._journal.close()
            self._journal = None


@dataclass(frozen=True)
class JournalFile:
    """Header and arrays of a recording, as of a sealed file."""

    header: dict[str, Any]
    arrays: dict[str, NDArray[Any]]

    def read(self, name: str) -> NDArray[Any]:
        """Return an array."""
        return self.arrays[name]


def read_journal(path: Path) -> JournalFile:
    """Return the whole records of a journal as the content of a recording."""
    records_read = [record for _, _, record in records(path)]
    if not records_read or not _is_header(records_read[0][0]):
        raise InputError(f"this is not the journal of a {FORMAT} of version {VERSION}")
    (about, arrays), batches = records_read[0], records_read[1:]
    if not batches:
        raise InputError("the recording ended before its first snapshot")
    tools = [tool for header, _ in batches for tool in header["tools"]]
    names = batches[0][1].keys() - {"contact/start"}
    arrays = arrays | {name: np.concatenate([batch[name] for _, batch in batches]) for name in names}
    sizes = [np.diff(batch["contact/start"]) for _, batch in batches]
    arrays["contact/start"] = np.cumsum(np.concatenate([[0], *sizes]), dtype="<i8")
    header = {"title": about["title"], "tools": tools, "model": about["model"], "errors": None, "written": ""}
    return JournalFile(header, arrays)


def _is_header(header: dict[str, Any]) -> bool:
    same = header.keys() == {"kind", "version", "title", "model"}
    return same and header["kind"] == FORMAT and header["version"] in (VERSION, *OLDER_VERSIONS)


def is_recording(path: Path) -> bool:
    """Return True if a file begins like a recording or the journal of one."""
    if kind_of_file(path) == FORMAT:
        return True
    try:
        if not path.is_file() or not is_journal(path):
            return False
        _, _, (header, _) = next(records(path))
    except (InputError, OSError, StopIteration):
        return False
    return _is_header(header)
