"""Recorder: takes snapshots of a session at a fixed interval, in its own thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from palpate.app.recordings.recording import MAX_DURATION, RECORDING_INTERVAL
from palpate.app.recordings.snapshot import Snapshot

__all__ = ["Recorder"]


class Recorder:
    """Records snapshots of a session until it is stopped.

    Parameters
    ----------
    describe_period : function
        Returns the present snapshot and the description of the selected tool; called from the recorder's thread.
    """

    def __init__(self, describe_period: Callable[[], tuple[Snapshot, dict[str, Any]]]) -> None:
        self._describe_period = describe_period
        self.times: list[float] = []
        self.snapshots: list[Snapshot] = []
        self.tools: list[dict[str, Any]] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="palpate recorder", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop recording and wait for the thread."""
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        start, due = time.monotonic(), 0.0
        while not self._end.is_set() and due < MAX_DURATION:
            now = time.monotonic() - start
            if now > MAX_DURATION:  # the machine slept
                return
            snapshot, tool = self._describe_period()
            tool = {name: value for name, value in tool.items() if name not in ("position", "quaternion", "active")}
            if not self.tools or any(self.tools[-1][name] != value for name, value in tool.items()):
                self.tools.append({**tool, "start": len(self.times)})
            self.snapshots.append(snapshot)
            self.times.append(now)
            due = max(due + RECORDING_INTERVAL, now)
            self._end.wait(max(0.0, due - (time.monotonic() - start)))
