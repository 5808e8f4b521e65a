"""Recordings of a session: started, finished, and written in threads of their own."""

from __future__ import annotations

import contextlib
import itertools
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from palpate.app.recordings.recording import Recording, SurfaceFileError, save_recording
from palpate.app.recordings.recording_journal import RecordingJournal
from palpate.app.recordings.snapshot import Snapshot
from palpate.app.session.bodies import SessionBody
from palpate.app.session.snapshot_recorder import SnapshotRecorder
from palpate.core.arrays import Floats
from palpate.core.faults import InputError


class SessionRecordings:
    """Recordings of one body, of snapshots that `describe` returns for a `SnapshotRecorder`."""

    def __init__(
        self, title: str, body: SessionBody, describe: Callable[[], tuple[Snapshot, list[dict[str, Any]], Floats]]
    ) -> None:
        self._title, self._body, self._describe = title, body, describe
        self.folder = Path("out/view")  # of new files
        self.recorder: SnapshotRecorder | None = None  # of the present recording
        self.failures: list[str] = []  # one line each
        self.notifications: list[dict[str, Any]] = []  # messages still to be sent to all viewers
        self._writers: list[threading.Thread] = []

    @property
    def is_active(self) -> bool:
        """Whether a recording is in progress."""
        return self.recorder is not None

    def start(self, path: Path | None = None) -> None:
        """Start a recording in a file, by default a new one in the folder; raise OSError if it cannot be written."""
        if self.recorder is not None:
            raise InputError("record must be 'stop' during a recording, got 'start'; stop the present one first")
        journal = RecordingJournal(path or _create_file(self.folder), self._title, self._body.model)
        self.recorder = SnapshotRecorder(self._describe, journal, self._body.recording_interval)

    def start_file(self) -> None:
        """Start a recording in a new file, and raise `InputError` if the folder cannot be written."""
        try:
            self.start()
        except OSError as error:
            raise InputError(
                f"record must have a folder that can be written, got {str(self.folder)!r} ({error.strerror or error}); "
                "start palpate in another folder"
            ) from error

    def finish(self, path: Path | None = None, wait: bool = False) -> None:
        """Stop the recording and write it in its own thread, by default to the file that `start` began.

        `notifications` then has its path. With `wait`, return when it is written.
        """
        if self.recorder is None:
            raise InputError("record must be 'start' without a recording, got 'stop'; start one first")
        recorder, self.recorder = self.recorder, None
        recorder.stop()
        recording = Recording(
            self._title, self._body.model, np.array(recorder.times), recorder.snapshots, recorder.tools, {},
            recorder.cuts,
        )  # fmt: skip
        writer = threading.Thread(target=self._write, args=(path, recorder.journal, recording), name="palpate writer")
        self._writers = [*(each for each in self._writers if each.is_alive()), writer]
        writer.start()
        if wait:
            writer.join()

    def _write(self, given: Path | None, journal: RecordingJournal, recording: Recording) -> None:
        """Replace the journal by the recording; if that fails, write it to another place or keep the journal."""
        path = given or journal.path
        try:
            save_recording(path, recording)
            failure = ""
        except SurfaceFileError as error:
            failure = f"the file for ParaView was not written: {error}"
        except (InputError, OSError) as error:
            failure = f"the recording was not written: {error}"
            if isinstance(error, OSError) and (other := _save_elsewhere(path.name, recording)) is not None:
                failure += f"; it is in {other}"
            elif journal.count:
                failure += f"; its first {journal.count} snapshots are in {journal.path}"
        else:
            self.notifications.append({"type": "recorded", "file": str(path), "frames": len(recording.times)})
        if failure:
            self.failures.append(failure)
            self.notifications.append({"type": "error", "reason": failure})
        with contextlib.suppress(OSError):
            if journal.path.stat().st_size == 0 or (path != journal.path and journal.count and not failure):
                journal.path.unlink()

    def continue_from(self, former: SessionRecordings) -> None:
        """Finish the recording of another body, and take its folder, failures and notifications."""
        if former.is_active:
            former.finish()
        self.notifications, self.failures, self.folder = former.notifications, former.failures, former.folder
        self._writers = former._writers

    def close(self) -> None:
        """Finish the present recording, and wait until all are written."""
        if self.is_active:
            self.finish()
        for writer in self._writers:
            writer.join()


def _create_file(folder: Path) -> Path:
    """Create an empty file with a unique name for a recording."""
    folder.mkdir(parents=True, exist_ok=True)
    stem = time.strftime("recording-%Y%m%d-%H%M%S")
    for number in itertools.count(1):
        path = folder / (f"{stem}.h5" if number == 1 else f"{stem}-{number}.h5")
        with contextlib.suppress(FileExistsError):
            path.touch(exist_ok=False)
            break
    return path


def _save_elsewhere(name: str, recording: Recording) -> Path | None:
    """Save a recording in a new folder for temporary files, and return its path; None if that fails, too."""
    folder: Path | None = None
    try:
        folder = Path(mkdtemp(prefix="palpate-recording-"))
        save_recording(folder / name, recording)
    except SurfaceFileError:
        return None if folder is None else folder / name
    except OSError:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        return None
    return folder / name
