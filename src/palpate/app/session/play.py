"""Play of a session: its tool goes along a path, or a script drives it, in real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.session.messages import Message, validate_message
from palpate.app.session.session import Session
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import json_of, read_text
from palpate.dynamics.run.progress import progress_bar

ToolPath = Callable[[Session, float], None]  # moves the tool of a session at a time [s] since the start
Poses = Callable[[float], Any]  # at times [s], as `palpate.DummyDevice` takes them

SCRIPT_MESSAGES = ("pose", "tool", "pin", "release", "control", "speed", "follow", "material", "record")
MAX_TIME = 1e6  # [s] of a message
TICK_INTERVAL = 0.1  # [s] between two ticks of the session, and updates of the progress bar


def play(session: Session, path: ToolPath, seconds: float) -> None:
    """Move the tool of a started session along a path for a time [s], once per period if Python is fast enough."""
    period, last, start, now = session.engine.period, 0.0, time.perf_counter(), 0.0
    with progress_bar("real time", seconds, True) as show_progress:
        while now < seconds:
            path(session, now)
            if now > last + TICK_INTERVAL:
                last = now
                session.tick()
                show_progress(now, now)
            ahead = (np.floor(now / period) + 1) * period - (time.perf_counter() - start)
            time.sleep(max(ahead, 0.0))
            now = time.perf_counter() - start


def follow(poses: Poses) -> ToolPath:
    """Return the path of a tool along poses relative to where it was put down."""
    return lambda session, time: session.engine.set_pose(*poses(time))


class Script:
    """Drives a session by the messages of a file, each at its time; counts them, and notes those refused."""

    def __init__(self, messages: list[tuple[float, Message]]) -> None:
        self._messages, self.done = messages, 0
        self.refused: list[dict[str, Any]] = []

    def __call__(self, session: Session, now: float) -> None:
        """Handle all messages up to a time [s]."""
        while self.done < len(self._messages) and self._messages[self.done][0] <= now:
            due, message = self._messages[self.done]
            self.done += 1
            try:
                session.handle(message)
            except InputError as error:
                self.refused.append({"time": due, "reason": str(error)})


def read_script(path: Path) -> Script:
    """Return the script in a file: lines of JSON, messages of docs/reference/protocol.md with a ``"time"`` [s]."""
    messages = []
    for k, line in enumerate(read_text(path, "script").split("\n")):
        if not line.strip():
            continue
        try:
            content = json_of(line)
            message = validate_message(content)
            at = content.get("time")
            if isinstance(at, bool) or not isinstance(at, int | float) or not 0 <= at < MAX_TIME:
                raise InputError(
                    f"time must be a number from 0 to {MAX_TIME:g}, got {at!r}; give seconds since the start"
                )
            if message["type"] not in SCRIPT_MESSAGES:
                raise InputError(
                    f"type must be one of {', '.join(SCRIPT_MESSAGES)} in a script, got {message['type']!r}; "
                    "remove the line"
                )
        except InputError as error:
            raise FileFormatError(f"{path}, line {k + 1}: {error}") from None
        messages.append((float(at), message))
    return Script(sorted(messages, key=lambda pair: pair[0]))
