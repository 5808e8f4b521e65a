"""Take snapshots of a session at a fixed interval in one thread, and keep them in a journal in another."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from palpate.app.recordings.recording import MAX_DURATION, RECORDING_INTERVAL, Cut
from palpate.app.recordings.recording_journal import RecordingJournal
from palpate.app.recordings.snapshot import Snapshot
from palpate.core.arrays import Floats
from palpate.core.faults import InputError

JOURNAL_INTERVAL = 0.5  # [s]

NOT_RECORDED = ("position", "quaternion", "active", "outline", "pinned")  # of the description of a tool


class SnapshotRecorder:
    """Records snapshots of a session, with an interval [s] between two, until it is stopped.

    `describe_period` returns the present snapshot, the descriptions of the selected tools by index, and the triangles
    (t, 3, 3) of the cut. It is called from the recorder's thread. `journal` receives the snapshots twice a second, and
    the rest at the end.
    """

    def __init__(
        self,
        describe_period: Callable[[], tuple[Snapshot, list[dict[str, Any]], Floats]],
        journal: RecordingJournal,
        interval: float = RECORDING_INTERVAL,
    ) -> None:
        self._describe_period, self.journal, self._interval = describe_period, journal, interval
        self.times: list[float] = []
        self.snapshots: list[Snapshot] = []
        self.tools: list[dict[str, Any]] = []
        self._selected: dict[int, dict[str, Any]] = {}  # by index
        self.cuts: list[Cut] = []
        self._triangles: Floats = np.zeros((0, 3, 3))
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="palpate recorder", daemon=True)
        self._writer = threading.Thread(target=self._keep_journal, name="palpate journal", daemon=True)
        self._thread.start()
        self._writer.start()

    def stop(self) -> None:
        """Stop recording and wait for the threads."""
        self._end.set()
        self._thread.join()
        self._writer.join()

    def _keep_journal(self) -> None:
        """Write snapshots until the end; on a full disk, try again later with all missing ones."""
        while not self._end.wait(JOURNAL_INTERVAL):
            self._write_new()
        self._thread.join()
        self._write_new()
        self.journal.close()

    def _write_new(self) -> None:
        first, last = self.journal.count, len(self.times)
        if first == last:
            return
        tools = [tool for tool in list(self.tools) if first <= tool["start"] < last]
        with suppress(OSError, InputError):  # the snapshots stay in memory, and the end writes them
            self.journal.add(self.times[first:last], self.snapshots[first:last], tools)

    def _add_cut(self, triangles: Floats) -> None:
        """Note a change of the cut, at the snapshot that comes next."""
        if triangles is self._triangles:
            return
        common = min(len(triangles), len(self._triangles))
        differs = np.flatnonzero(np.any(triangles[:common] != self._triangles[:common], axis=(1, 2)))
        kept = int(differs[0]) if differs.size else common
        if kept < max(len(triangles), len(self._triangles)):
            self.cuts.append(Cut(len(self.times), kept, triangles[kept:].copy()))
        self._triangles = triangles

    def _run(self) -> None:
        start, due = time.monotonic(), 0.0
        while not self._end.is_set() and due < MAX_DURATION:
            now = time.monotonic() - start
            if now > MAX_DURATION:  # the machine slept
                return
            snapshot, tools, triangles = self._describe_period()
            self._add_cut(triangles)
            for index, about in enumerate(tools):
                tool = {name: value for name, value in about.items() if name not in NOT_RECORDED}
                if self._selected.get(index) != tool:
                    self._selected[index] = tool
                    self.tools.append({**tool, "index": index, "start": len(self.times)})
            self.snapshots.append(snapshot)
            self.times.append(now)
            due = max(due + self._interval, now)
            self._end.wait(max(0.0, due - (time.monotonic() - start)))
